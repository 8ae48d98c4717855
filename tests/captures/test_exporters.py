# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' formats, there and back: exact poses, half pixels and axes by each format's own formula, and nothing that breaks it."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon.captures.exporters import EXPORTERS, export_capture
from addon.captures.exporters.colmap import rotation_to_quaternion
from addon.captures.importers import import_capture
from addon.captures.importers.colmap import quaternion_to_rotation
from addon.captures.pictures import read_picture, write_picture
from addon.captures.schema import Capture, Frame
from addon.captures.store import read_capture, write_capture
from addon.errors import ScanstageError
from addon.reconstruction.geometry import Camera, look_at, rotation_about

SIZE = (16, 12)
POINTS = np.random.default_rng(1).uniform(-0.3, 0.3, (20, 3))
LENSES = {"colmap": [(), (-0.1, 0.02, 0.001, -0.002, 0.0)], "transforms": [(), (-0.1, 0.02, 0.001, -0.002, 0.003)],
          "opencv": [(), (-0.1, 0.02, 0.001, -0.002, 0.003)], "middlebury": [()], "tum": [(), (-0.1, 0.02, 0.001, -0.002, 0.003)]}
CASES = [(name, lens) for name, lenses in LENSES.items() for lens in lenses]
SOURCE = {"colmap": ".", "transforms": ".", "opencv": "cameras.yml", "middlebury": ".", "tum": "."}


def turning(folder, lens=(), masks=False, alike=False):
    """Write a set of two cameras before a table with three poses, whose second camera has another lens unless they are ``alike``."""
    cameras = {}
    for number, name in enumerate(("left", "right")):
        R, t = look_at((1.5 + number, 0.7, 0.4), (0.0, 0.1, 0.05))
        cameras[name] = Camera([[19.0 + number * (not alike), 0, 7.3], [0, 19.5, 5.1], [0, 0, 1]], R, t, SIZE, lens or np.zeros(5))
    frames = []
    for pose in range(3):
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = rotation_about((0.1, 0.2, 1.0), 2.0 * pose), (0.1, 0.0, -0.02)
        for name in cameras:
            id = f"{pose}-{name}"
            picture = np.random.default_rng(pose).random((SIZE[1], SIZE[0], 3)).astype(np.float32)
            write_picture(folder / "images" / f"{id}.png", picture)
            if masks:
                write_picture(folder / "given" / f"{id}.png", (picture > 0.5).astype(np.float32), encoding="srgb", bits=8)
            frames.append(Frame(id, f"images/{id}.png", name, motion, mask=f"given/{id}.png" if masks else None))
    write_capture(folder, Capture(cameras, tuple(frames)))
    return read_capture(folder)


@pytest.mark.parametrize(("name", "lens"), CASES)
def test_cameras_and_pictures_come_back_as_they_went(tmp_path, name, lens):
    ours = turning(tmp_path / "set", lens, alike=name == "tum")
    assert export_capture(name, tmp_path / "set", tmp_path / "out") == 6
    import_capture(name, tmp_path / "out" / SOURCE[name], tmp_path / "back")
    back = read_capture(tmp_path / "back")
    assert {frame.id for frame in back.frames} == {frame.id for frame in ours.frames}
    theirs = {frame.id: frame for frame in back.frames}
    for frame in ours.frames:
        a, b = ours.camera_of(frame), back.camera_of(theirs[frame.id])
        np.testing.assert_allclose(b.K, a.K, rtol=0, atol=1e-9)
        np.testing.assert_allclose(b.R, a.R, rtol=0, atol=1e-9)
        np.testing.assert_allclose(b.t, a.t, rtol=0, atol=1e-9)
        np.testing.assert_allclose(b.distortion, a.distortion, rtol=0, atol=1e-12)
        before, after = (read_picture(folder / one.image, encoding)[0] for folder, one, encoding in (
            (tmp_path / "set", frame, "linear"), (tmp_path / "back", theirs[frame.id], "srgb")))
        assert np.abs(before - after).max() < 0.01  # 8 bits, as screens have them


def test_colmaps_own_formula_projects_to_the_same_places(tmp_path):
    """x = f X / Z + c with c from the picture's corner, R from the quaternion w x y z, world to camera (COLMAP's documentation)."""
    capture = turning(tmp_path / "set")
    export_capture("colmap", tmp_path / "set", tmp_path / "out")
    lenses = {words[0]: np.array(words[4:], float) for words in map(str.split, (tmp_path / "out/sparse/0/cameras.txt").read_text().splitlines())
              if words[0] != "#"}
    lines = [line for line in (tmp_path / "out/sparse/0/images.txt").read_text().splitlines() if not line.startswith("#")]
    assert lines[1::2] == [""] * 6 and len(lenses) == 2
    frames = {f"{frame.id}.png": frame for frame in capture.frames}
    for line in lines[::2]:
        _, w, x, y, z, *t, lens, name = line.split()
        fx, fy, cx, cy = lenses[lens]
        rotation = cv2.Rodrigues(2 * np.arccos(float(w)) * np.array([x, y, z], float) / np.linalg.norm(np.array([x, y, z], float)))[0]
        local = POINTS @ rotation.T + np.array(t, float)
        corner = np.column_stack((fx * local[:, 0] / local[:, 2] + cx, fy * local[:, 1] / local[:, 2] + cy))
        np.testing.assert_allclose(corner - 0.5, capture.camera_of(frames[name]).project(POINTS)[0], atol=1e-6)


def test_nerfs_own_formula_gives_the_same_rays(tmp_path):
    """A ray of pixel (i, j) is c2w @ ((i + 0.5 - cx) / fl_x, -(j + 0.5 - cy) / fl_y, -1), from c2w's last column."""
    capture = turning(tmp_path / "set")
    export_capture("transforms", tmp_path / "set", tmp_path / "out")
    document = json.loads((tmp_path / "out/transforms.json").read_text())
    frames = {f"images/{frame.id}.png": frame for frame in capture.frames}
    for entry in document["frames"]:
        lens, c2w = {**document, **entry}, np.array(entry["transform_matrix"])
        i, j = 3, 7
        ray = c2w[:3, :3] @ ((i + 0.5 - lens["cx"]) / lens["fl_x"], -(j + 0.5 - lens["cy"]) / lens["fl_y"], -1.0)
        camera = capture.camera_of(frames[entry["file_path"]])
        np.testing.assert_allclose(c2w[:3, 3], camera.centre, atol=1e-12)
        np.testing.assert_allclose(np.cross(ray, camera.rays(np.array([i, j], float))), 0, atol=1e-9)
        assert camera.project(c2w[:3, 3] + ray)[1] > 0


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_quaternions_are_rotations_and_back(quaternion):
    R = quaternion_to_rotation(np.array(quaternion))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0
    np.testing.assert_allclose(quaternion_to_rotation(rotation_to_quaternion(R)), R, atol=1e-12)


def test_files_by_other_hands(tmp_path):
    """Endings left out, intrinsics in the frames, a field of view in place of a focal length, three rows of a matrix."""
    write_picture(tmp_path / "train/r_0.png", np.full((10, 20, 3), 0.5))
    (tmp_path / "transforms_train.json").write_text(json.dumps({"camera_angle_x": 0.6, "frames": [
        {"file_path": "./train/r_0", "rotation": 0.1, "transform_matrix": [[1, 0, 0, 0], [0, 0, -1, -3], [0, 1, 0, 0.5]]}]}))
    camera, = import_capture("transforms", tmp_path, tmp_path / "set").cameras.values()
    assert camera.K[0, 0] == pytest.approx(10 / np.tan(0.3)) == camera.K[1, 1]
    np.testing.assert_allclose(camera.K[:2, 2], (9.5, 4.5))
    np.testing.assert_allclose(camera.centre, (0, -3, 0.5), atol=1e-12)
    np.testing.assert_allclose(camera.forward, (0, 1, 0), atol=1e-12)


@pytest.mark.parametrize("name", EXPORTERS)
def test_masks_go_along(tmp_path, name):
    turning(tmp_path / "set", masks=True, alike=name == "tum")
    export_capture(name, tmp_path / "set", tmp_path / "out")
    back = import_capture(name, tmp_path / "out" / SOURCE[name], tmp_path / "back", {} if name == "transforms" else {"masks": "masks"})
    for frame in back.frames:
        assert (tmp_path / "back" / frame.mask).read_bytes() == (tmp_path / "set/given" / f"{frame.id}.png").read_bytes()


@pytest.mark.parametrize("name", EXPORTERS)
def test_a_place_that_is_taken_is_refused_and_left_alone(tmp_path, name):
    turning(tmp_path / "set")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("mine")
    with pytest.raises(ScanstageError, match="is there already and not an empty folder"):
        export_capture(name, tmp_path / "set", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_what_a_format_cannot_say_is_refused(tmp_path):
    turning(tmp_path / "set", (-0.1, 0.02, 0.001, -0.002, 0.003))
    with pytest.raises(ScanstageError, match="frame 0-left: COLMAP can say 4 of its lens's 5 terms"):
        export_capture("colmap", tmp_path / "set", tmp_path / "out")
    with pytest.raises(ScanstageError, match="Middlebury's format has no words for its lens"):
        export_capture("middlebury", tmp_path / "set", tmp_path / "out")
    with pytest.raises(ScanstageError, match="frame 0-right: was taken by another camera than frame 0-left"):
        export_capture("tum", tmp_path / "set", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("text", "problem"), [
    ("1 FISHEYE 16 12 1 2 3 4", "camera model 'FISHEYE' cannot be used"), ("1 PINHOLE 16 12 1 2 3", "takes 4 parameters"),
    ("1 PINHOLE 16 12 nan 2 3 4", "not finite"), ("1 PINHOLE 16 12 x 2 3 4", "no number"), ("1 PINHOLE 0 12 1 2 3 4", "no size"),
    ("2 PINHOLE 16 12 1 2 3 4", "camera '1' is not in cameras.txt"), ("1 PINHOLE 17 12 1 2 3 4", "is 16x12 and its camera 17x12")])
def test_a_bad_line_of_colmaps_is_named(tmp_path, text, problem):
    (tmp_path / "cameras.txt").write_text(f"# head\n{text}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 3 1 a.png\n\n")
    write_picture(tmp_path / "images/a.png", np.zeros((12, 16, 3)))
    with pytest.raises(ScanstageError, match=problem):
        import_capture("colmap", tmp_path, tmp_path / "set")


@pytest.mark.parametrize("name", ["../a.png", "/etc/passwd", "a\\b.png"])
def test_no_file_outside_is_read(tmp_path, name):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 16 12 1 2 3 4\n")
    (tmp_path / "images.txt").write_text(f"1 1 0 0 0 0 0 3 1 {name}\n\n")
    with pytest.raises(ScanstageError, match="leaves the source's folder"):
        import_capture("colmap", tmp_path, tmp_path / "set")
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 1, "frames": [{"file_path": name, "transform_matrix": np.eye(4).tolist()}]}))
    with pytest.raises(ScanstageError, match=r"frames\[0\].file_path"):
        import_capture("transforms", tmp_path, tmp_path / "set")


@pytest.mark.parametrize(("name", "file"), [("colmap", "sparse/0/images.txt"), ("colmap", "sparse/0/cameras.txt"), ("transforms", "transforms.json"),
                                            ("middlebury", "scanstage_par.txt"), ("opencv", "cameras.yml"), ("tum", "groundtruth.txt")])
@settings(max_examples=40, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_one_error_or_a_capture(tmp_path_factory, name, file, data):
    folder = tmp_path_factory.mktemp("fuzz")
    turning(folder / "set", alike=name == "tum")
    export_capture(name, folder / "set", folder / "out")
    text = bytearray((folder / "out" / file).read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(text) - 1))
        how = data.draw(st.sampled_from(["byte", "cut", "double", "big"]))
        if how == "byte":
            text[place] = data.draw(st.integers(0, 255))
        elif how == "cut":
            del text[place:place + data.draw(st.integers(1, 60))]
        elif how == "double":
            text[place:place] = text[place:place + 40]
        else:
            text[place:place] = b"9e999"
        if not text:
            break
    (folder / "out" / file).write_bytes(bytes(text))
    try:
        import_capture(name, folder / "out" / SOURCE[name], folder / "back")
    except ScanstageError as error:
        assert "\n" not in str(error) and not (folder / "back").exists()
