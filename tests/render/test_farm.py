# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames that a farm renders from the .blend, without the extension: taken in, told from others, and the same to the pixel."""

import os
import shlex
import shutil
import subprocess
import sys

import bpy

# isort: split
import cv2  # bpy first: both bring libraries of their own
import numpy as np
import pytest

from addon.captures.store import read_capture
from addon.errors import ScanstageError
from addon.render.capture import capture_frames
from addon.render.farm import FarmFrames
from addon.results.blend import open_blend, save_blend
from addon.stage import staging
from addon.stage.fingerprint import stamp

SMALL = {"views": 4, "lights": 2, "resolution_x": 96, "resolution_y": 72}
FRAMES = 12  # of each pose, one under both lights and one under each
RENDER = """
import bpy, sys
file, output, first, last = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.open_mainfile(filepath=file)
scene = bpy.context.scene
scene.render.filepath, scene.frame_start, scene.frame_end = output, int(first), int(last)
bpy.ops.render.render(animation=True)
"""
"""What `blender --background FILE --render-output OUTPUT --render-frame FIRST..LAST` does, where only Blender's module is there."""


def stage(path, **more):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    staging.build(scene, "shadow-array", "pot", {**SMALL, **more})
    stamp(scene)
    save_blend(path)


def module(file, output, first, last):
    """Render a chunk as a farm would, by Blender's module in a process that has never heard of the extension."""
    subprocess.run([sys.executable, "-c", RENDER, file, output, str(first), str(last)], check=True, capture_output=True, timeout=120)


def binary(file, output, first, last):
    """Render a chunk by the command that Flamenco's built-in Blender job runs."""
    command = shlex.split(os.environ.get("SCANSTAGE_BLENDER", "blender"))
    if shutil.which(command[0]) is None:
        pytest.skip("there is no Blender program here; name one in SCANSTAGE_BLENDER")
    version = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=60).stdout
    if bpy.app.version_string.rpartition(".")[0] not in version:
        pytest.skip(f"the Blender program here is no {bpy.app.version_string}")
    subprocess.run([*command, "--background", file, "--render-output", output, "--render-format", "PNG", "--render-frame",
                    f"{first}..{last}"], check=True, capture_output=True, timeout=120, cwd=os.path.dirname(file))


def pixels(folder):
    return {path.name: cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((folder / "images").glob("*.png"))}


def capture(file, folder, farm=None):
    open_blend(file)
    return list(capture_frames(bpy.context.scene, folder, farm=farm))


@pytest.fixture(scope="module")
def staged(tmp_path_factory):
    """Return a staged file, and the capture set that is rendered from it here."""
    folder = tmp_path_factory.mktemp("staged")
    stage(folder / "pot.blend")
    capture(folder / "pot.blend", folder / "here")
    return folder / "pot.blend", folder / "here"


@pytest.mark.parametrize("render", [module, binary])
def test_chunks_of_a_farm_give_what_capture_gives(staged, tmp_path, render):
    file, here = tmp_path / "pot.blend", staged[1]
    shutil.copy(staged[0], file)
    for first, last in ((7, 8), (10, 12), (1, 3), (4, 5), (1, 3)):  # out of order, one chunk twice, frames 6 and 9 never
        render(str(file), str(tmp_path / "farm" / "######"), first, last)
    cut = tmp_path / "farm" / "000004.png"
    cut.write_bytes(cut.read_bytes()[:-40])
    farm = FarmFrames(tmp_path / "farm")
    messages = [message for _, message in capture(file, tmp_path / "set", farm)]
    assert farm.taken == 9 and farm.refused == {str(cut): "is cut short or damaged"}
    rendered = [message.split()[1].rstrip(",") for message in messages if message.startswith("frame ")]
    assert rendered == ["0004", "0006", "0009"]
    found, expected = pixels(tmp_path / "set"), pixels(here)
    assert len(found) == FRAMES and list(found) == list(expected) and read_capture(tmp_path / "set").missing == ()
    difference = max(int(np.abs(found[name].astype(int) - expected[name]).max()) for name in found)
    assert difference <= (0 if render is module else 1)  # another build of Blender may round the last bit otherwise
    assert (tmp_path / "set" / "truth.ply").read_bytes() == (here / "truth.ply").read_bytes()


@pytest.mark.parametrize("change", [{"elevations": "25"}, {"resolution_x": 95}])
def test_frames_of_another_plan_are_not_taken(staged, tmp_path, change):
    stage(tmp_path / "other.blend", **change)
    farm = FarmFrames(staged[1])
    capture(tmp_path / "other.blend", tmp_path / "set", farm)
    assert farm.taken == 0 and len(farm.refused) == FRAMES
    assert all("another plan" in problem or "pixels instead of" in problem for problem in farm.refused.values())


def test_a_frame_under_another_number_is_not_taken(staged, tmp_path):
    (tmp_path / "farm").mkdir()
    shutil.copy(staged[1] / "images" / "0002.png", tmp_path / "farm" / "pot-0005.png")
    farm = FarmFrames(tmp_path / "farm")
    capture(staged[0], tmp_path / "set", farm)
    assert farm.taken == 0 and list(farm.refused.values()) == ["is of another plan or another frame"]
    for name, picture in pixels(staged[1]).items():
        np.testing.assert_array_equal(picture, pixels(tmp_path / "set")[name])


def test_pictures_of_an_earlier_stage_in_the_folder_are_rendered_again(staged, tmp_path):
    stage(tmp_path / "other.blend", focal_length=45.0)
    capture(tmp_path / "other.blend", tmp_path / "expected")
    shutil.copytree(staged[1] / "images", tmp_path / "set" / "images")
    capture(tmp_path / "other.blend", tmp_path / "set")
    for name, picture in pixels(tmp_path / "expected").items():
        np.testing.assert_array_equal(picture, pixels(tmp_path / "set")[name])


def test_a_plan_that_changed_after_saving_takes_nothing_and_writes_nothing(staged, tmp_path):
    open_blend(staged[0])
    bpy.context.scene.camera.location.x += 0.1
    with pytest.raises(ScanstageError, match="its plan has changed since"):
        list(capture_frames(bpy.context.scene, tmp_path / "set", farm=FarmFrames(staged[1])))
    assert not (tmp_path / "set").exists()


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ScanstageError, match="--frames-from: .* is not a folder"):
        FarmFrames(tmp_path / "nowhere")
