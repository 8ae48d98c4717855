# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever is wrong with the input: exit status 1, one line that names it, and nothing half-written.

Every case is a call in a folder that holds a capture set, a result and a stage; some spoil one of them first.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from addon.captures.pictures import write_picture
from addon.cli import main
from tests.rigs import Ball, ring, write_ball_capture

SIZE = (60, 45)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make everything once: copying it is quicker."""
    folder = tmp_path_factory.mktemp("made")
    write_ball_capture(folder / "capture", Ball((0, 0, 0.1), 0.6), ring(3, focal=75, size=SIZE))
    assert main(["reconstruct", str(folder / "capture"), "visual-hull", "--out", str(folder / "result"), "--voxels", "8"]) == 0
    assert main(["stage", "turntable", "--object", "knot", "--out", str(folder / "stage.blend"),
                 "--set", "views=3", "--set", "resolution_x=32", "--set", "resolution_y=24"]) == 0
    (folder / "empty").mkdir()
    (folder / "mine").mkdir()
    (folder / "mine" / "thesis.txt").write_text("all of it")
    (folder / "file").write_text("a file")
    (folder / "garbage.blend").write_bytes(b"BLENDER, but no more")
    return folder


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    """Return a copy of all that is made, in which the test is: calls name files as a user would."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return all there is in a folder, but for the silhouettes that a capture set keeps to be looked at."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
            for path in sorted(folder.rglob("*")) if "masks" not in path.parts}


def refused(capfd, place: Path, arguments) -> str:
    """Call, and return what is said after ``scanstage: error: `` if all else is as it must be."""
    before = contents(place)
    capfd.readouterr()
    status = main([*arguments.split(), "--quiet"])
    out, error = capfd.readouterr()  # of the process, so that what Blender's own code prints counts
    assert status == 1 and out == ""
    assert error.startswith("scanstage: error: ") and error.endswith("\n") and error.count("\n") == 1
    assert contents(place) == before
    return error.removeprefix("scanstage: error: ").rstrip("\n")


def check(capfd, place, arguments, *named):
    said = refused(capfd, place, arguments)
    missing = [name for name in named if name not in said]
    assert not missing, said


RECONSTRUCT = "reconstruct capture visual-hull --out new"


# --- what is not there, or is something else ---------------------------------------------------------------------------------

@pytest.mark.parametrize(("arguments", "named"), [
    ("reconstruct empty visual-hull --out new", ["capture.json", "empty"]),
    ("reconstruct none visual-hull --out new", ["capture.json", "none"]),
    ("reconstruct file visual-hull --out new", ["capture.json", "file"]),
    ("reconstruct result visual-hull --out new", ["capture.json", "result"]),
    ("evaluate empty", ["empty/result.json"]), ("evaluate none", ["none/result.json"]), ("evaluate file", ["file/result.json"]),
    ("evaluate capture", ["capture/result.json"]),
    ("mesh empty --out new.ply", ["empty/result.json"]), ("mesh capture --out new.ply", ["capture/result.json"]),
    ("mesh file --out new.ply", ["file: is neither a result's folder nor a volume", ".npz or .vox"]),
    ("view empty --out new.blend", ["capture.json", "empty"]), ("view capture --out new.blend --result empty", ["empty/result.json"]),
    ("view capture --out new.txt", ["new.txt: a scene is saved as .blend"]),
    ("import turntable empty --out new", ["empty: holds 0 XML, YAML or JSON files"]), ("import tum empty --out new", ["groundtruth.txt"]),
    ("import bouguet empty --out new", ["empty: holds no Calib_Results.m"]),
    ("import opencv capture --out new --set masks=nowhere", ["capture.json: "]),
    ("capture none.blend --out new", ["none.blend: there is no such file", "scanstage stage"]),
    ("capture empty --out new", ["empty: there is no such file"]),
    ("capture garbage.blend --out new", ["garbage.blend: Blender cannot open it"]),
    ("capture file --out new", ["file: Blender cannot open it"]),
    ("stage turntable --object none.ply --out new.blend", ["none.ply: there is no such file"]),
    ("stage turntable --object file --out new.blend", ["object 'file' is neither built in"]),
    ("stage turntable --object garbage.blend --out new.blend", ["garbage.blend: Blender cannot read this file"]),
    ("import middlebury empty --out new", ["empty: ", "*_par.txt"]), ("import middlebury none --out new", ["none: is not there"]),
    ("import opencv file --out new", ["file: "]), ("import opencv none.yml --out new", ["none.yml: is not there"]),
    ("import opencv capture/capture.json --out new", ["capture.json: "]),
    ("calibrate empty --out new", ["capture.json", "empty"]), ("calibrate none --out new", ["capture.json", "none"]),
    ("calibrate capture --out new", ["capture.json: frames: none has a board_pose"]),
    ("calibrate capture --out mine", ["mine: holds files that are no capture set"]),
    ("import board empty --out new", ["empty: holds no pictures"]), ("import board file --out new", ["file: is a file"]),
    ("evaluate result --truth none.obj", ["none.obj: there is no such file"]),
    ("evaluate result --truth garbage.blend", ["garbage.blend: cannot be read"]),
    ("evaluate result --truth file", ["file: unknown ending"]),
    ("demo --out new --set object=none.glb", ["none.glb: there is no such file"]),
])
def test_what_is_not_there_or_something_else_is_named(capfd, place, arguments, named):
    check(capfd, place, arguments, *named)


@pytest.mark.parametrize(("arguments", "named"), [
    ("stage carousel --out new.blend", ["'carousel'", "turntable"]),
    ("stage turntable --object teapot --out new.blend", ["'teapot'", "dented-sphere"]),
    ("stage turntable --out new.blend --set speed=3", ["preset turntable has no option 'speed'", "views"]),
    ("stage turntable --out new.blend --set views=none", ["option views", "'none'"]),
    ("stage turntable --out new.blend --set views=0", ["option views", "1"]),
    ("stage turntable --out new.blend --set elevations=89", ["option elevations", "'89'", "85 degrees"]),
    ("stage turntable --out new.txt", ["new.txt: a scene is saved as .blend"]),
    ("capture stage.blend --out new --set views=3", ["capture has no options", "views"]),
    ("calibrate capture --out new --set lens=none", ["calibrate has no option 'lens'", "camera_lens"]),
    ("import board capture/images --out new --set square=0", ["option square"]),
    ("import meshroom capture --out new", ["'meshroom'", "middlebury"]),
    ("import opencv capture/capture.json --out new --set scale=2", ["import opencv has no option 'scale'"]),
    ("reconstruct capture marching-cubes --out new", ["'marching-cubes'", "visual-hull"]),
    (f"{RECONSTRUCT} --set detail=3", ["method visual-hull has no option 'detail'", "tolerance"]),
    (f"{RECONSTRUCT} --set rule=corners", ["option rule", "'corners'", "conservative, center"]),
    (f"{RECONSTRUCT} --set chroma_angle=100", ["option chroma_angle", "100 degrees", "90 degrees"]),
    (f"{RECONSTRUCT} --set silhouette=mask", ["images/0001.png", "silhouette=mask"]),
    (f"{RECONSTRUCT} --bounds 0 0 0 1 1 0", ["--bounds", "no volume"]),
    (f"{RECONSTRUCT} --bounds 1 1 1 0 0 0", ["--bounds", "no volume"]),
    (f"{RECONSTRUCT} --bounds nan 0 0 1 1 1", ["--bounds", "finite"]),
    (f"{RECONSTRUCT} --bounds 0 0 0 1 1 inf", ["--bounds"]),
    (f"{RECONSTRUCT} --bounds 5 5 5 5.1 5.1 5.1 --set outside=empty", ["the visual hull is empty", "bounds"]),
    (f"{RECONSTRUCT} --voxels 0", ["--voxels", "16384"]), (f"{RECONSTRUCT} --voxels -8", ["--voxels", "16384"]),
    (f"{RECONSTRUCT} --voxels 99999999999999999999", ["--voxels", "16384"]),
    (f"{RECONSTRUCT} --voxels 16384", ["--voxels", "GiB", "at most"]),
    ("evaluate result --set samples=1", ["option samples"]), ("evaluate result --set seed=1", ["evaluate has no option 'seed'"]),
    ("mesh result --out new.xyz", ["new.xyz", ".ply"]), ("mesh result --out new", ["new: ", ".ply"]),
    ("mesh result --out new.ply --set round=yes", ["mesh has no option 'round'"]),
    ("mesh result --out new.ply --set smooth=perhaps", ["option smooth", "'perhaps'"]),
    ("methods --set rule=center", ["methods has no options", "rule"]), ("presets --set views=3", ["presets has no options", "views"]),
    ("demo --out new --set views=2", ["option views"]), ("demo --out new --set camera=2", ["demo has no option 'camera'"]),
])
def test_what_is_unknown_or_not_allowed_is_named(capfd, place, arguments, named):
    check(capfd, place, arguments, *named)


# --- capture sets that are spoilt --------------------------------------------------------------------------------------------

def edited(change):
    """Return a function that spoils capture.json by changing its document."""
    def spoil(folder: Path):
        document = json.loads((folder / "capture.json").read_text())
        change(document)
        (folder / "capture.json").write_text(json.dumps(document))

    return spoil


def camera(field, value):
    return edited(lambda document: document["devices"]["cameras"]["0002"].update({field: value}))


def frame(field, value):
    return edited(lambda document: document["frames"][1].update({field: value}))


def top(field, value):
    return edited(lambda document: document.update({field: value}))


def truncate(path: Path):
    data = path.read_bytes()
    path.write_bytes(data[:len(data) // 2])


def clear(path: Path):
    write_picture(path, np.zeros((SIZE[1], SIZE[0], 3)), np.zeros((SIZE[1], SIZE[0])))


NAN_K = [[75, 0, float("nan")], [0, 75, 22], [0, 0, 1]]
SPOILT = {
    "no image": (lambda folder: (folder / "images/0002.png").unlink(), ["capture.json: frames[1].image", "images/0002.png"]),
    "an image cut off": (lambda folder: truncate(folder / "images/0002.png"), ["images/0002.png", "cut off"]),
    "an image of another size": (lambda folder: write_picture(folder / "images/0002.png", np.ones((9, 7, 3))),
                                 ["images/0002.png", "7x9", "60x45"]),
    "an image that is text": (lambda folder: (folder / "images/0002.png").write_text("none"), ["images/0002.png"]),
    "an image that is a folder": (lambda folder: ((folder / "images/0002.png").unlink(), (folder / "images/0002.png").mkdir()),
                                  ["images/0002.png"]),
    "an empty silhouette": (lambda folder: clear(folder / "images/0002.png"), ["images/0002.png", "silhouette of frame 0002 is empty"]),
    "no mask": (frame("mask", "given/0002.png"), ["capture.json: frames[1].mask", "given/0002.png"]),
    "an empty mask": (lambda folder: (frame("mask", "given.png")(folder), clear(folder / "given.png")), ["frame 0002 is empty"]),
    "a mask of another size": (lambda folder: (frame("mask", "given.png")(folder), write_picture(folder / "given.png", np.ones((9, 7, 3)))),
                               ["given.png", "7x9", "60x45"]),
    "NaN in K": (camera("K", NAN_K), ["capture.json: devices.cameras.0002.K[0][2]", "NaN|nan"]),
    "a negative focal length": (camera("K", [[-75, 0, 30], [0, 75, 22], [0, 0, 1]]), ["capture.json: devices.cameras.0002.K"]),
    "a rotation that is none": (camera("R", [[1, 0, 0], [0, 1, 0], [0, 0, 2]]), ["capture.json: devices.cameras.0002.R", "rotation"]),
    "a reflection": (camera("R", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]), ["capture.json: devices.cameras.0002.R", "determinant"]),
    "a motion that is none": (frame("object_to_world", (2 * np.eye(4)).tolist()), ["capture.json: frames[1].object_to_world", "rigid"]),
    "zero views": (top("frames", []), ["capture.json: frames", "empty"]),
    "frames to come": (top("missing", ["0003"]), ["capture.json: missing", "0003", "run capture again"]),
    "no cameras": (edited(lambda document: document["devices"].update(cameras={})), ["capture.json: frames[0].camera", "'0001'"]),
    "bounds of no volume": (top("bounds", [[0, 0, 0], [1, 0, 1]]), ["capture.json: bounds", "no volume"]),
    "an option it does not know": (top("silhouette", {"treshold": 0.2}), ["silhouette", "'treshold'"]),
    "another version": (top("version", 2), ["capture.json: version"]),
    "another format": (top("format", "holiday-pictures"), ["capture.json: format"]),
    "a path out of it": (frame("image", "../file"), ["capture.json: frames[1].image", "leaves the capture set"]),
    "no truth": (lambda folder: (folder / "truth.ply").unlink(), ["capture.json: truth.mesh", "truth.ply"]),
    "no JSON": (lambda folder: (folder / "capture.json").write_text("{"), ["capture.json", "line 1"]),
    "nothing in capture.json": (lambda folder: (folder / "capture.json").write_text(""), ["capture.json", "line 1"]),
    "a list in capture.json": (lambda folder: (folder / "capture.json").write_text("[]"), ["capture.json"]),
    "a bomb in capture.json": (lambda folder: (folder / "capture.json").write_text("[" * 100_000), ["capture.json"]),
    "bytes in capture.json": (lambda folder: (folder / "capture.json").write_bytes(b"\xff\xfe\x00"), ["capture.json"]),
}


@pytest.mark.parametrize("spoilt", SPOILT)
def test_a_spoilt_capture_set_is_told_by_file_and_field(capfd, place, spoilt):
    spoil, named = SPOILT[spoilt]
    spoil(place / "capture")
    said = refused(capfd, place, RECONSTRUCT)
    assert all(any(word in said for word in name.split("|")) for name in named), said


def test_a_result_whose_capture_set_has_gone_or_is_spoilt_is_told(capfd, place):
    report = place / "result" / "result.json"
    report.write_text(json.dumps({**json.loads(report.read_text()), "capture": str(place / "capture")}))
    (place / "capture" / "truth.ply").write_bytes(b"ply\ngarbage")
    check(capfd, place, "evaluate result", "truth.ply: ")
    (place / "capture" / "truth.ply").unlink()
    check(capfd, place, "evaluate result", "truth.ply")
    shutil.rmtree(place / "capture")
    check(capfd, place, "evaluate result", "result/result.json: capture", "--truth")


# --- results and stages that are spoilt --------------------------------------------------------------------------------------

@pytest.mark.parametrize("verb", ["evaluate result", "mesh result --out new.ply"])
@pytest.mark.parametrize(("spoil", "named"), [
    (lambda folder: (folder / "result.json").write_text("{}"), ["result/result.json", "format"]),
    (lambda folder: (folder / "result.json").write_text("{"), ["result/result.json", "JSON"]),
    (lambda folder: (folder / "volume.npz").unlink(), ["result/volume.npz"]),
    (lambda folder: truncate(folder / "volume.npz"), ["result/volume.npz", "damaged"]),
    (lambda folder: (folder / "volume.npz").write_bytes(b""), ["result/volume.npz"]),
], ids=["no format", "no JSON", "no volume", "half a volume", "an empty volume"])
def test_a_spoilt_result_is_told_by_file(capfd, place, verb, spoil, named):
    spoil(place / "result")
    check(capfd, place, verb, *named)


def test_a_scene_without_a_stage_is_told_by_file(capfd, place):
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(place / "scene.blend"))
    check(capfd, place, "capture scene.blend --out new", "scene.blend: ", "no stage", "scanstage stage PRESET --out scene.blend")


def test_a_truth_without_faces_is_told_by_file(capfd, place):
    (place / "points.ply").write_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
                                      "end_header\n0 0 0\n")
    check(capfd, place, "evaluate result --truth points.ply", "points.ply: holds no mesh")


# --- places that cannot be written -------------------------------------------------------------------------------------------

@pytest.mark.parametrize(("arguments", "named"), [
    ("stage turntable --out file/new.blend", ["file/new.blend", "cannot be written"]),
    ("stage turntable --out mine/thesis.txt/new.blend", ["new.blend", "cannot be written"]),
    ("capture stage.blend --out file", ["file: "]), ("capture stage.blend --out file/new", ["file/new: "]),
    ("reconstruct capture visual-hull --out file", ["file: is a file"]),
    ("reconstruct capture visual-hull --out file/new", ["file/new: cannot be made", "file is not a folder"]),
    ("reconstruct capture visual-hull --out mine", ["mine: is not empty and not a result"]),
    ("reconstruct capture visual-hull --out capture", ["capture: is not empty and not a result"]),
    ("reconstruct capture visual-hull --out .", ["is not empty and not a result"]),
    ("mesh result --out file/new.ply", ["file/new.ply: cannot be written"]),
    ("mesh result --out none/new.glb", ["none/new.glb: cannot be written"]),
    ("mesh result --out none/new.vox", ["none/new.vox: cannot be written"]),
    ("import opencv capture/capture.json --out mine", ["mine: holds files that are no capture set"]),
    ("import opencv capture/capture.json --out file", ["file: is a file"]),
    ("demo --out file", ["file"]), ("demo --out file/new", ["file/new"]),
    ("methods --report none/new.json", ["none/new.json", "--report"]), ("methods --report mine", ["mine", "--report"]),
    ("methods --report file/new.json", ["file/new.json", "--report"]),
    (f"{RECONSTRUCT} --report none/new.json", ["none/new.json", "--report"]),
    ("evaluate result --report mine", ["mine", "--report"]),
])
def test_a_place_that_cannot_be_written_is_named(capfd, place, arguments, named):
    check(capfd, place, arguments, *named)


def test_another_captures_folder_is_not_overwritten(capfd, place):
    check(capfd, place, "capture stage.blend --out capture", "capture: holds a capture of another plan")


@pytest.mark.parametrize("ending", ["ply", "obj", "stl", "glb", "blend", "vox"])
def test_a_folder_with_the_files_name_is_left_alone(capfd, place, ending):
    (place / f"new.{ending}").mkdir()
    check(capfd, place, f"mesh result --out new.{ending}", f"new.{ending}: cannot be written")
