# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures whose poses come from a turntable, a trajectory or Bouguet's toolbox: each against the format's own formula."""

import math
import re

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.captures.contour_file import contours_text
from addon.captures.importers import import_capture
from addon.captures.importers.colmap import quaternion_to_rotation
from addon.captures.pictures import write_picture
from addon.captures.scan import load_scan
from addon.captures.store import read_capture
from addon.errors import ScanstageError
from addon.reconstruction.contours import centres_within
from addon.reconstruction.geometry import Camera, look_at, rotation_about

SIZE = (40, 30)
K = np.array([[60.0, 0, 19], [0, 61, 15], [0, 0, 1]])
LENS = np.array([-0.1, 0.02, 0.001, -0.002, 0.003])
POINTS = np.random.default_rng(4).uniform(-0.4, 0.4, (20, 3))


def write_pictures(folder, names):
    for name in names:
        write_picture(folder / f"{name}.png", np.zeros((SIZE[1], SIZE[0], 3)), bits=8)
    return folder


def write_storage(path, **matrices):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in matrices.items():
        storage.write(name, np.asarray(value, float))
    storage.release()


def refused(message, *arguments, **options):
    with pytest.raises(ScanstageError, match=f"^{re.escape(message)}") as caught:
        import_capture(*arguments, **options)
    assert "\n" not in str(caught.value)


# A turntable


TABLE = Camera(K, *look_at((3, 0.5, 1), (0, 0, 0)), SIZE, LENS)


@pytest.fixture
def table(tmp_path):
    source = write_pictures(tmp_path / "set", [f"shot {n}" for n in range(1, 13)])
    write_storage(source / "camera.yml", camera_matrix=K, distortion_coefficients=LENS[None], R=TABLE.R, t=TABLE.t[:, None])
    return source


@pytest.mark.parametrize(("step", "degrees"), [("0", 30), ("10", 10), ("-10", -10)])
def test_what_stands_on_the_table_turns_with_it(table, tmp_path, step, degrees):
    import_capture("turntable", table, tmp_path / "out", {"step": step})
    capture = read_capture(tmp_path / "out")
    assert [frame.image for frame in capture.frames] == [f"images/shot {n}.png" for n in range(1, 13)]  # 2 before 10
    for number, frame in enumerate(capture.frames):
        angle = math.radians(number * degrees)
        x, y, z = POINTS.T
        turned = np.column_stack((math.cos(angle) * x - math.sin(angle) * y, math.sin(angle) * x + math.cos(angle) * y, z))
        theirs = cv2.projectPoints(turned, cv2.Rodrigues(TABLE.R)[0], TABLE.t, K, LENS)[0][:, 0]
        np.testing.assert_allclose(capture.camera_of(frame).project(POINTS)[0], theirs, atol=1e-7)


def test_an_axis_in_the_cameras_own_frame_says_the_same(table, tmp_path):
    world = import_capture("turntable", table, tmp_path / "world", {"step": "20"})
    # The table's axis as the camera sees it: the world's origin and its z axis.
    write_storage(table / "camera.yml", K=K, distortion=LENS[None], axis_point=TABLE.t[None], axis_direction=5 * TABLE.R[:, 2][None])
    own = import_capture("turntable", table, tmp_path / "own", {"step": "20"})
    for first, second in zip(world.frames, own.frames, strict=True):
        theirs = world.camera_of(first).project(POINTS)[0]
        np.testing.assert_allclose(own.camera_of(second).project(POINTS @ TABLE.R.T + TABLE.t)[0], theirs, atol=1e-9)


def test_a_calibration_that_leaves_the_table_open_is_refused(table, tmp_path):
    out = tmp_path / "out"
    for nodes, message in [({"R": TABLE.R, "t": TABLE.t[None]}, "camera.yml: K: is missing"),
                           ({"K": K}, "camera.yml: says neither R and t nor axis_point and axis_direction"),
                           ({"K": K, "R": TABLE.R}, "camera.yml: t: is missing where R is given"),
                           ({"K": K, "axis_point": TABLE.t[None]}, "camera.yml: axis_direction: is missing"),
                           ({"K": K, "axis_point": TABLE.t[None], "axis_direction": np.zeros((1, 3))}, "camera.yml: axis_direction: has no length"),
                           ({"K": K, "axis_point": np.zeros((1, 2)), "axis_direction": np.ones((1, 3))}, "camera.yml: axis_point: must be three"),
                           ({"K": np.eye(2), "R": TABLE.R, "t": TABLE.t[None]}, "camera.yml: K must be a 3x3 matrix")]:
        write_storage(table / "camera.yml", **nodes)
        refused(message, "turntable", table, out)
    write_storage(table / "camera.yml", K=K, R=TABLE.R, t=TABLE.t[None])
    write_picture(table / "shot 5.png", np.zeros((31, 40, 3)), bits=8)
    refused("shot 5.png: is 40x31 pixels and shot 1.png 40x30", "turntable", table, out)
    for picture in table.glob("*.png"):
        picture.unlink()
    refused(f"{table}: holds no pictures", "turntable", table, out)
    assert not out.exists()


# A trajectory


unit = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1).map(lambda q: np.array(q) / np.linalg.norm(q))


@given(unit)
def test_a_quaternion_turns_as_hamiltons_product_does(q):
    def product(a, b):
        (ax, ay, az, aw), (bx, by, bz, bw) = a, b
        return np.array([aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
                         aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz])

    R = quaternion_to_rotation(np.roll(q, 1))
    for point in POINTS[:5]:
        turned = product(product(q, (*point, 0)), q * (-1, -1, -1, 1))
        np.testing.assert_allclose(R @ point, turned[:3], atol=1e-12)


@pytest.fixture
def trajectory(tmp_path):
    """Four poses, by hand: a quarter turn about each axis in turn, and none."""
    source = tmp_path / "set"
    write_pictures(source / "rgb", ["100.00", "100.10", "100.20", "100.30", "107.00"])
    half = math.sqrt(0.5)
    lines = ["# timestamp tx ty tz qx qy qz qw", f"100.19 1 2 3 0 {half!r} 0 {half!r}", "100.001 1 2 3 0 0 0 1", "",
             f"100.105 1 2 3 {half!r} 0 0 {half!r}", f"100.3 1 2 3 0 0 {half!r} {half!r}"]
    (source / "groundtruth.txt").write_text("\n".join(lines))
    write_storage(source / "camera.yml", K=K)
    return source


AHEAD = {"100.00": (0, 0, 1), "100.10": (0, -1, 0), "100.20": (1, 0, 0), "100.30": (0, 0, 1)}
RIGHT = {"100.00": (1, 0, 0), "100.10": (1, 0, 0), "100.20": (0, 0, -1), "100.30": (0, 1, 0)}


def test_a_camera_stands_and_looks_where_its_pose_says(trajectory, tmp_path):
    capture = import_capture("tum", trajectory, tmp_path / "out")
    assert [frame.id for frame in capture.frames] == list(AHEAD)  # the fifth picture has no pose
    for frame in capture.frames:
        camera = capture.camera_of(frame)
        np.testing.assert_allclose(camera.centre, (1, 2, 3), atol=1e-12)
        np.testing.assert_allclose(camera.R[2], AHEAD[frame.id], atol=1e-12)
        np.testing.assert_allclose(camera.R[0], RIGHT[frame.id], atol=1e-12)
        seen = camera.project(np.add((1, 2, 3), np.multiply(AHEAD[frame.id], 4) + RIGHT[frame.id]))[0]
        np.testing.assert_allclose(seen, (19 + 60 / 4, 15), atol=1e-9)  # cx + fx / depth
    tight = import_capture("tum", trajectory, tmp_path / "tight", {"tolerance": "0.007"})
    assert [frame.id for frame in tight.frames] == ["100.00", "100.10", "100.30"]


def test_rgb_txt_says_when_a_picture_was_taken(trajectory, tmp_path):
    (trajectory / "rgb.txt").write_text("# time file\n100.30 rgb/100.00.png\n100.0 rgb/107.00.png\n")
    capture = import_capture("tum", trajectory / "groundtruth.txt", tmp_path / "out")
    assert [frame.id for frame in capture.frames] == ["100.00", "107.00"]
    np.testing.assert_allclose(capture.camera_of(capture.frames[0]).R[0], RIGHT["100.30"], atol=1e-12)


@settings(max_examples=25)
@given(unit, st.lists(st.floats(-100, 100), min_size=3, max_size=3))
def test_a_pose_is_exact(tmp_path_factory, q, centre):
    source = tmp_path_factory.mktemp("tum")
    write_pictures(source, ["1.5"])
    (source / "trajectory.txt").write_text(f"1.5 {' '.join(map(repr, map(float, centre)))} {' '.join(map(repr, map(float, q)))}")
    write_storage(source / "camera.json", K=K)
    capture = import_capture("tum", source, source / "out")
    camera = capture.camera_of(capture.frames[0])
    vector = q[:3]
    angle = 2 * math.atan2(np.linalg.norm(vector), q[3])
    R = rotation_about(vector, angle) if np.linalg.norm(vector) > 1e-12 else np.eye(3)
    np.testing.assert_allclose(camera.R.T, R, atol=1e-9)
    np.testing.assert_allclose(camera.centre, centre, atol=1e-9)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("100.001 1 2 3 0 0 0 1", "100.001 1 2 3 0 0 0", "groundtruth.txt: line 3: has 7 words where 8"),
    ("100.001 1 2 3 0 0 0 1", "100.001 1 2 x 0 0 0 1", "groundtruth.txt: line 3: one of the values is no number"),
    ("100.001 1 2 3 0 0 0 1", "100.001 1 2 nan 0 0 0 1", "groundtruth.txt: line 3: a number is not finite"),
    ("100.001 1 2 3 0 0 0 1", "100.001 1 2 3 0 0 0 1.2", "groundtruth.txt: line 3: the quaternion has the length 1.2"),
    ("100.001 1 2 3 0 0 0 1", "100.19 1 2 3 0 0 0 1", "groundtruth.txt: line 3: the timestamp is given twice"),
])
def test_a_bad_pose_is_named_with_its_line(trajectory, tmp_path, old, new, message):
    path = trajectory / "groundtruth.txt"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    refused(message, "tum", trajectory, tmp_path / "out")


@pytest.mark.parametrize(("listing", "message"), [
    ("1 ../x.png", "rgb.txt: line 1: '../x.png' leaves the source's folder"),
    ("1 /etc/x.png", "rgb.txt: line 1: '/etc/x.png' leaves the source's folder"),
    ("1 rgb/none.png", "rgb.txt: line 1: the picture 'rgb/none.png' is not in"),
    (f"1 rgb/{'x' * 3000}.png", "rgb.txt: line 1: the picture 'rgb/xxx"),
    ("1 rgb/100.00.png\n2 rgb/100.00.png", "rgb.txt: line 2: 100.00.png is listed with another timestamp"),
    ("1", "rgb.txt: line 1: has 1 words where 2"),
    ("# nothing", "groundtruth.txt: no picture has a pose"),
    ("3 rgb/100.00.png", "groundtruth.txt: no picture has a pose"),
])
def test_a_bad_listing_is_named_with_its_line(trajectory, tmp_path, listing, message):
    (trajectory / "rgb.txt").write_text(listing)
    refused(message, "tum", trajectory, tmp_path / "out")


def test_a_link_out_of_the_folder_is_not_followed(trajectory, tmp_path):
    write_pictures(tmp_path / "elsewhere", ["secret"])
    (trajectory / "rgb" / "link.png").symlink_to(tmp_path / "elsewhere" / "secret.png")
    (trajectory / "rgb.txt").write_text("100.0 rgb/link.png")
    refused("rgb.txt: line 1: rgb/link.png is a link out of the source's folder", "tum", trajectory, tmp_path / "out")


# Bouguet's toolbox


SKEW = 0.01
POSES = {1: ((0.1, -2.0, 0.3), (0.2, -0.1, 4.0)), 3: ((1.9, 0.4, -0.2), (-0.3, 0.2, 5.0))}


def calibration(poses=POSES, **changes):
    values = {"fc": "[ 60.000000000000000 ; 61.0 ]", "cc": "[ 19 ; 15.5 ]", "alpha_c": f"{SKEW}",
              "kc": "[ -1.0e-01 ; 0.02 ; 0.001 ; -0.002 ; 0.003 ]", "fc_error": "[ 1 ; 1 ]", "nx": "40", "ny": "30", "n_ima": "3",
              **{f"omc_{n}": "[ " + " ; ".join(map(repr, omc)) + " ]" for n, (omc, _) in poses.items()},
              **{f"Tc_{n}": "[ " + " ; ".join(map(repr, t)) + " ]" for n, (_, t) in poses.items()},
              "omc_2": "[ NaN ; NaN ; NaN ]", "Tc_2": "[ NaN ; NaN ; NaN ]", **changes}
    lines = ["% Intrinsic and Extrinsic Camera Parameters", "", "%-- Focal length: fc = [ 1 ; 1 ];"]
    return "\n".join(lines + [f"{name} = {value};" for name, value in values.items() if value is not None] + ["est_fc = ones(2,1);"])


@pytest.fixture
def toolbox(tmp_path):
    source = write_pictures(tmp_path / "set", ["Image1", "Image2", "Image3", "notes"])
    (source / "Calib_Results.m").write_text(calibration())
    return source


def test_the_toolboxs_own_model_gives_the_same_pixels(toolbox, tmp_path):
    capture = import_capture("bouguet", toolbox, tmp_path / "out")
    assert [frame.id for frame in capture.frames] == ["Image1", "Image3"]
    k1, k2, p1, p2, k3 = LENS
    for frame, (omc, t) in zip(capture.frames, POSES.values(), strict=True):
        x, y, z = (rotation_about(omc, np.linalg.norm(omc)) @ POINTS.T + np.array(t)[:, None])
        a, b = x / z, y / z
        r2 = a * a + b * b
        radial = 1 + k1 * r2 + k2 * r2 ** 2 + k3 * r2 ** 3
        u = radial * a + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
        v = radial * b + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
        pixels = np.column_stack((60 * (u + SKEW * v) + 19, 61 * v + 15.5))
        found, depth = capture.camera_of(frame).project(POINTS)
        np.testing.assert_allclose(found, pixels, atol=1e-9)
        np.testing.assert_allclose(depth, z, atol=1e-9)


@pytest.mark.parametrize(("changes", "message"), [
    ({"fc": None}, "Calib_Results.m: fc: is missing or holds no plain numbers"),
    ({"fc": "[ 60 ; system('echo') ]"}, "Calib_Results.m: fc: is missing or holds no plain numbers"),
    ({"fc": "[ 60 ; 61 ; 62 ]"}, "Calib_Results.m: fc: has 3 values where 2"),
    ({"fc": "[ -60 ; 61 ]"}, "Calib_Results.m: omc_1: K must be upper triangular with positive focal lengths"),
    ({"cc": "[ Inf ; 1 ]"}, "Calib_Results.m: cc: a number is not finite"),
    ({"Tc_1": None}, "Calib_Results.m: Tc_1: is missing"),
    ({"Tc_1": "[ 0 ; NaN ; 1 ]"}, "Calib_Results.m: Tc_1: a number is not finite"),
    ({"nx": "41"}, "Image1.png: is 40x30 pixels and nx, ny of Calib_Results.m are 41, 30"),
    ({"omc_9": "[ 0 ; 0 ; 1 ]", "Tc_9": "[ 0 ; 0 ; 1 ]"}, "Calib_Results.m: omc_9: no picture in"),
    ({"omc_1": None, "omc_3": None}, "Calib_Results.m: holds no pose"),
    ({"cc": "[ 19 ; 15.5 ];\ncc = [ 1 ; 1 ]"}, "Calib_Results.m: cc: is given twice"),
])
def test_a_bad_toolbox_file_is_named_with_its_variable(toolbox, tmp_path, changes, message):
    (toolbox / "Calib_Results.m").write_text(calibration(**changes))
    refused(message, "bouguet", toolbox, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_two_pictures_of_one_number_are_refused(toolbox, tmp_path):
    write_pictures(toolbox, ["copy1"])
    refused("copy1.png: has the same number as Image1.png", "bouguet", toolbox, tmp_path / "out")


def test_outlines_beside_the_pictures_are_their_silhouettes(toolbox, tmp_path):
    """To the last digit, and as a mask where one is needed."""
    outline = np.array([(10.25, 5.5), (30.125, 6.75), (28.0, 24.0625), (12.0, 20.0)])
    hole = np.array([(18.0, 10.0), (22.0, 10.0), (20.0, 14.0)])
    for number in (1, 3):
        (toolbox / f"Image{number}.txt").write_bytes(contours_text([outline, hole + number]))
    import_capture("bouguet", toolbox, tmp_path / "out")
    views = load_scan(tmp_path / "out", {"conservative": False}).views
    for number, view in zip((1, 3), views, strict=True):
        np.testing.assert_array_equal(view.contours[0], outline)
        np.testing.assert_array_equal(view.contours[1], hole + number)
        np.testing.assert_array_equal(view.mask, centres_within([outline, hole + number], SIZE))
    chosen = {"silhouette": "chroma", "backdrop": "#ff0000"}  # black is too dark to be a backdrop: all is the object
    assert all(view.contours is None and view.mask.all() for view in load_scan(tmp_path / "out", chosen).views)
    (toolbox / "Image3.txt").write_text("1 2\n3\n")
    refused("Image3.txt: line 2: must be the two numbers x y", "bouguet", toolbox, tmp_path / "out")
