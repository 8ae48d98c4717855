# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Killed at any moment: what was finished is whole, and the same command again gives what it would have given."""

import json
import os
import random
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from addon.captures.exporters import export_capture
from addon.captures.pictures import picture_is_whole
from addon.captures.store import is_capture, read_capture
from addon.results.folder import REPORT, VOLUME, read_result
from addon.workflow import reconstruct
from tests.rigs import Ball, ring, write_ball_capture

ROOT = Path(__file__).resolve().parents[1]
RECONSTRUCT = ("import sys, pathlib; from addon.workflow import reconstruct; "
               "reconstruct(pathlib.Path(sys.argv[1]), 'visual-hull', pathlib.Path(sys.argv[2]), voxels=96)")
KILLS = 5


def run(*command, seconds=None):
    """Run a command to its end, or kill it after some seconds; return how long it took, or None if it was killed."""
    start = time.monotonic()
    process = subprocess.Popen([sys.executable, *map(str, command)], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        _, errors = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return None
    assert process.returncode == 0, errors.decode()
    return time.monotonic() - start


def moments(longest, seed):
    """Return times at which to kill: from before anything is written until everything is."""
    dice = random.Random(seed)
    return sorted(dice.uniform(0.3, 1.0) * longest for _ in range(KILLS))


@pytest.mark.parametrize("beside_an_older_result", [False, True])
def test_a_killed_reconstruction_leaves_a_whole_result_or_none(tmp_path, beside_an_older_result):
    capture, out = tmp_path / "capture", tmp_path / "out"
    write_ball_capture(capture, Ball((0.1, 0.0, 0.0), 0.6), ring(12, focal=400, size=(320, 240)))
    longest = run("-c", RECONSTRUCT, capture, tmp_path / "reference")
    expected = (tmp_path / "reference" / VOLUME).read_bytes()
    if beside_an_older_result:
        run("-c", RECONSTRUCT, capture, out)
        (out / REPORT).write_text((out / REPORT).read_text().replace('"voxels": 96', '"voxels": 95'))  # to tell it from a new one
    for moment in moments(longest, seed=beside_an_older_result):
        run("-c", RECONSTRUCT, capture, out, seconds=moment)
        assert is_capture(capture) and not read_capture(capture).missing
        assert out.exists() or not beside_an_older_result
        if out.exists():
            assert read_result(out).volume.count() > 0  # of the older or of the new one, but whole
    run("-c", RECONSTRUCT, capture, out)
    assert (out / VOLUME).read_bytes() == expected and read_result(out).report["voxels"] == 96


def test_a_killed_capture_is_taken_up_where_it_stopped_with_the_same_pictures(tmp_path):
    pytest.importorskip("bpy")
    script, stage = ROOT / "scripts" / "scanstage.py", tmp_path / "rig.blend"
    small = ["--set", "views=6", "--set", "resolution_x=160", "--set", "resolution_y=120"]
    run(script, "stage", "turntable", "--object", "knot", "--out", stage, *small)
    longest = run(script, "capture", stage, "--out", tmp_path / "reference")
    capture = tmp_path / "capture"
    for share in (0.5, 0.7, 0.85):
        run(script, "capture", stage, "--out", capture, seconds=share * longest)
        if is_capture(capture):
            found = read_capture(capture)
            for frame in found.frames:  # what is not named as missing is whole
                assert frame.id in found.missing or picture_is_whole(capture / frame.image, (160, 120))
    run(script, "capture", stage, "--out", capture)
    assert not read_capture(capture).missing
    for frame in read_capture(capture).frames:  # the renderer notes its time in each file; the pixels are the same
        ours, whole = (cv2.imread(str(folder / frame.image), cv2.IMREAD_UNCHANGED) for folder in (capture, tmp_path / "reference"))
        np.testing.assert_array_equal(ours, whole)


# --- killed before each step on the disk ---------------------------------------------------------------------------------------

def contents(folder: Path) -> dict[str, object]:
    """Return what a person finds in a folder: its files by name, hidden ones and what differs from run to run left out."""
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".") for part in name.parts):
            files[str(name)] = timeless(path)
    return files


def timeless(path: Path) -> object:
    import bpy

    if path.name == REPORT:
        return {key: value for key, value in json.loads(path.read_text()).items() if key not in ("seconds", "memory", "peak_memory")}
    if path.suffix == ".html":
        return re.sub(r"<h2>Seconds</h2>.*?</table>", "", path.read_text(), flags=re.DOTALL)
    if path.suffix == ".blend":  # holds addresses of memory; what it means is that it opens and what is in it
        from addon.results.blend import open_blend

        open_blend(path)
        return sorted((member.name, str(member.matrix_world)) for member in bpy.data.objects), bpy.context.scene.frame_end
    return path.read_bytes()


VERBS = {
    "mesh of two files": ("mesh result --out new.obj", "new.obj"), "mesh in place of another": ("mesh result --out old.ply", "old.ply"),
    "evaluate": ("evaluate result --set samples=1000 --page new.html", "new.html"),
    "import": ("import opencv photographs/cameras.yml --out new --set silhouette=threshold", "new/capture.json"),
    "import in place of another": ("import opencv photographs/cameras.yml --out capture --set silhouette=threshold", "capture/capture.json"),
    "export": ("export transforms capture --out new", "new/transforms.json"),
    "reconstruct in place of another": ("reconstruct capture visual-hull --out result --voxels 20", "result/result.json"),
    "stage": ("stage turntable --object knot --set views=3 --out new.blend", "new.blend"),
}


@pytest.fixture(scope="module")
def before(tmp_path_factory):
    """Return a folder with a capture set, a result of it, photographs with their calibration, and an older mesh."""
    pytest.importorskip("bpy")
    folder = tmp_path_factory.mktemp("before")
    write_ball_capture(folder / "capture", Ball((0.0, 0.0, 0.0), 0.6), ring(3, focal=70, size=(60, 45)))
    reconstruct(folder / "capture", "visual-hull", folder / "result", voxels=16)
    export_capture("opencv", folder / "capture", folder / "photographs")
    (folder / "old.ply").write_bytes(b"an older mesh")
    return folder


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("verb", VERBS)
def test_killed_before_any_step_nothing_is_half_there_and_the_same_command_finishes(tmp_path, before, verb):
    arguments, made = VERBS[verb]
    shutil.copytree(before, tmp_path / "before")
    done = subprocess.run([sys.executable, "-m", "tests.killing", tmp_path, str(KILLS), *arguments.split(), "--quiet"], cwd=ROOT,
                          capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    steps = [line.split() for line in (tmp_path / "steps").read_text().splitlines()]
    assert len(steps) > 1
    old, new = contents(tmp_path / "before"), contents(tmp_path / "whole")
    assert made in new and old.get(made) != new[made]
    for number, name in steps:
        left = contents(tmp_path / f"killed-{number}")
        # Of what the verb makes or replaces, each file is the old one or the new one, and what was there is there.
        assert old.keys() <= left.keys() or "in place of another" in verb and made in left, (number, name)
        for file, content in left.items():
            assert content in (old.get(file), new.get(file)), (number, name, file)
        assert contents(tmp_path / f"again-{number}") == new, (number, name)
