# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""On a disk that is full, or read-only, every verb says so in one sentence, with status 1, and leaves what was there and nothing else."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from addon.captures.exporters import export_capture
from addon.workflow import reconstruct
from tests.rigs import Ball, ring, write_ball_capture

ROOT = Path(__file__).resolve().parents[1]
# By the verb: what it is called with, the kilobytes that it can write before the disk is full, and what the sentence names.
VERBS = {
    "stage": ("stage turntable --object knot --set views=3 --out new.blend", 8, "new.blend"),
    "stage in place of another": ("stage turntable --object knot --set views=3 --out rig.blend", 8, "rig.blend"),
    "capture": ("capture rig.blend --out new", 330, "new"),
    "reconstruct": ("reconstruct capture visual-hull --voxels 24 --out new", 24, "new"),
    "reconstruct in place of another": ("reconstruct capture visual-hull --voxels 24 --out result", 24, "result"),
    **{f"mesh as {ending}": (f"mesh result --out new.{ending}", 0, f"new.{ending}") for ending in ("ply", "obj", "stl", "glb", "blend", "vox")},
    "mesh in place of another": ("mesh result --out old.ply", 0, "old.ply"),
    "page": ("evaluate result --set samples=1000 --page new.html", 8, "new.html|result.json"),
    "import": ("import opencv photographs/cameras.yml --out new --set silhouette=threshold", 4, "new"),
    "import in place of another": ("import opencv photographs/cameras.yml --out capture --set silhouette=threshold", 4, "capture"),
    "export": ("export transforms capture --out new", 4, "new"),
}
# A capture goes on from where it was stopped: what it has rendered stays, and capture.json says what is missing.
KEPT = {"capture": ("new", "new/capture.json", "new/images", "new/truth.ply")}
WROTE_BEFORE = {"page": ("result/result.json",)}  # the measures, which are noted in the result before the page is written


def can_mount() -> bool:
    return hasattr(os, "getuid") and os.getuid() == 0 and shutil.which("unshare") is not None and subprocess.run(
        ["unshare", "--mount", "mount", "-t", "tmpfs", "-o", "size=4096", "tmpfs", "/mnt"], capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Return for each case the exit status, what the verb said, and what changed."""
    pytest.importorskip("bpy")
    if not can_mount():
        pytest.skip("a disk of its own can be mounted by root on Linux only")
    folder = tmp_path_factory.mktemp("disk")
    before = folder / "before"
    write_ball_capture(before / "capture", Ball((0.0, 0.0, 0.0), 0.6), ring(3, focal=70, size=(60, 45)))
    reconstruct(before / "capture", "visual-hull", before / "result", voxels=16)
    export_capture("opencv", before / "capture", before / "photographs")
    (before / "old.ply").write_bytes(b"an older mesh")
    small = ["--set", "views=4", "--set", "resolution_x=80", "--set", "resolution_y=60"]
    subprocess.run([sys.executable, ROOT / "scripts" / "scanstage.py", "stage", "turntable", "--object", "knot", "--out", before / "rig.blend",
                    *small], check=True, capture_output=True)
    cases = [[f"{kind}: {verb}", free if kind == "full" else None, arguments.split()]
             for verb, (arguments, free, _) in VERBS.items() for kind in ("full", "read-only")]
    (folder / "cases.json").write_text(json.dumps(cases))
    done = subprocess.run(["unshare", "--mount", sys.executable, "-m", "tests.small_disk", folder, folder / "cases.json"], cwd=ROOT,
                          capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return {name: rest for name, *rest in map(json.loads, (folder / "found").read_text().splitlines())}


@pytest.mark.parametrize("kind", ["full", "read-only"])
@pytest.mark.parametrize("verb", VERBS)
def test_a_disk_that_takes_nothing_is_told_and_loses_nothing(found, kind, verb):
    status, said, changed = found[f"{kind}: {verb}"]
    errors = [line for line in said.splitlines() if line.startswith("scanstage: error: ")]
    assert status == 1 and len(errors) == 1 and "Traceback" not in said, said
    assert any(name in errors[0] for name in VERBS[verb][2].split("|")) and "/." not in errors[0], said  # the place that was asked for, and no temporary name
    kept = KEPT.get(verb, ()) if kind == "full" else ()
    left = [path for path in changed if path not in (*kept, *(WROTE_BEFORE.get(verb, ()) if kind == "full" else ()))
            and not path.startswith(tuple(f"{name}/" for name in kept))]
    assert not left, (left, said)
    assert not [path for path in changed if any(part.startswith(".") for part in Path(path).parts)]  # no temporary files
