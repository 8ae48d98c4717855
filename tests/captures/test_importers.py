# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other people's formats: real sets where they are, and made-up ones with everything that can be wrong."""

import re
import shutil

import cv2
import numpy as np
import pytest

from addon.captures.importers import IMPORTERS, import_capture
from addon.captures.importers.sources import natural_key
from addon.captures.pictures import write_mask, write_picture
from addon.captures.scan import load_scan
from addon.captures.store import read_capture
from addon.errors import ScanstageError
from addon.reconstruction.geometry import Camera, look_at, rotation_about
from addon.reconstruction.methods import reconstruct
from tests.rigs import Ball, Box, camera_at, silhouette

SIZE = (40, 30)
K = np.array([[60.0, 0, 19], [0, 61, 15], [0, 0, 1]])


def ring(count):
    """Return cameras on a ring that look at the origin."""
    angles = np.arange(count) * 2 * np.pi / count
    return [Camera(K, *look_at((3 * np.cos(a), 3 * np.sin(a), 1), (0, 0, 0)), SIZE) for a in angles]


def pixel_difference(P, Q, points):
    """Return by how many pixels two projection matrices of any scale disagree about (n, 3) points."""
    image = [np.column_stack((points, np.ones(len(points)))) @ M.T for M in (np.asarray(P, float), Q)]
    return np.abs(image[0][:, :2] / image[0][:, 2:] - image[1][:, :2] / image[1][:, 2:]).max()


def write_pictures(folder, names):
    picture = np.zeros((SIZE[1], SIZE[0], 3))
    picture[10:20, 15:25] = 1
    for name in names:
        write_picture(folder / f"{name}.png", picture, bits=8)
    return folder


def write_storage(path, **nodes):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in nodes.items():
        if isinstance(value, dict):
            storage.startWriteStruct(name, cv2.FileNode_MAP)
            for key, item in value.items():
                storage.write(key, item)
            storage.endWriteStruct()
        else:
            storage.write(name, value)
    storage.release()


@pytest.fixture
def middlebury(tmp_path):
    folder = write_pictures(tmp_path / "set", ["x0001", "x0002", "x0010"])
    lines = ["3"]
    for name, camera in zip(("x0010", "x0002", "x0001"), ring(3), strict=True):
        numbers = np.concatenate((camera.K.ravel(), camera.R.ravel(), camera.t))
        lines.append(f"{name}.png " + " ".join(f"{n:.17g}" for n in numbers))
    (folder / "x_par.txt").write_text("\n".join(lines) + "\n")
    return folder


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_the_squirrel(real_captures, tmp_path):
    source = real_captures("turntable_squirrel")
    capture = import_capture("opencv", source, tmp_path / "set", {"silhouette": "threshold", "threshold": 30 / 255})
    # Read without OpenCV, whose FileNode.mat() rounds what is declared as float
    nodes = re.findall(r"<viff(\d+)_matrix.*?<data>(.*?)</data>", (source / "viff.xml").read_text(), re.DOTALL)
    matrices = {int(number): np.array(text.split(), float).reshape(3, 4) for number, text in nodes}
    assert [frame.image for frame in capture.frames] == [f"images/image_{n}.jpg" for n in range(36)]
    points = np.random.default_rng(0).uniform(-5, 5, (50, 3))  # about the object: the table's axis, in centimetres
    for number, frame in enumerate(capture.frames):
        camera = capture.camera_of(frame)
        assert pixel_difference(matrices[number], camera.P, points) < 1e-6
        assert (camera.project(points)[1] > 0).all() and camera.size == (1280, 960)
    scan = load_scan(tmp_path / "set")
    shares = [view.mask.mean() for view in scan.views]
    assert 0.02 < min(shares) and max(shares) < 0.6
    # The table's speed is even, so the silhouette's area cannot jump from one picture to the next.
    assert np.abs(np.diff(shares + shares[:1])).max() < 0.03


def test_the_dinosaur(real_captures, tmp_path):
    source = real_captures("dino_sparse_ring")
    capture = import_capture("middlebury", source / "dinoSR_par.txt", tmp_path / "set")
    lines = [line.split() for line in (source / "dinoSR_par.txt").read_text().splitlines()[1:]]
    np.testing.assert_array_equal(capture.bounds, [[-0.061897, -0.018874, -0.057845], [0.010897, 0.068227, 0.015495]])
    points = np.random.default_rng(0).uniform(*capture.bounds, (50, 3))
    assert len(capture.frames) == len(lines) == 16
    for words, frame in zip(lines, capture.frames, strict=True):
        values = np.array(words[1:], float)
        P = values[:9].reshape(3, 3) @ np.column_stack((values[9:18].reshape(3, 3), values[18:]))
        assert frame.image == f"images/{words[0]}"
        assert pixel_difference(P, capture.camera_of(frame).P, points) < 1e-6
    shares = [view.mask.mean() for view in load_scan(tmp_path / "set").views]
    assert 0.02 < min(shares) and max(shares) < 0.6
    good = import_capture("middlebury", source, tmp_path / "good", {"good_silhouettes": True})
    assert {frame.id for frame in capture.frames} - {frame.id for frame in good.frames} == {"dinoSR0006"}


def test_names_are_in_natural_order():
    assert sorted(["a10", "a2", "b1", "a1b", "2", "10"], key=natural_key) == ["2", "10", "a1b", "a2", "a10", "b1"]


def test_middlebury_keeps_cameras_boxes_and_options(middlebury, tmp_path):
    (middlebury / "readme.TXT").write_text("The Bounding\nBox is:\n (1.0, 2, 3e0)\n[-1 -.5 +2.5], roughly")
    import_capture("middlebury", middlebury, tmp_path / "out", {"dilate": 3, "encoding": "linear"})
    capture = read_capture(tmp_path / "out")
    assert [frame.id for frame in capture.frames] == ["x0001", "x0002", "x0010"]
    np.testing.assert_array_equal(capture.bounds, [[-1, -0.5, 2.5], [1, 2, 3]])
    assert capture.silhouette == {"silhouette": "threshold", "threshold": 0.19, "dilate": 3, "erode": 7}
    assert capture.encoding == "linear"
    for frame, camera in zip(capture.frames, ring(3)[::-1], strict=True):
        np.testing.assert_array_equal(capture.camera_of(frame).P, camera.P)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("3\n", "4\n", "x_par.txt: line 1 announces 4 pictures, 3 follow"),
    ("3\n", "many\n", "x_par.txt: line 1 must be the number of pictures"),
    ("x0002.png", "x0002.png 7", "x_par.txt: line 3 has 23 words"),
    ("x0002.png", "x0003.png", "x_par.txt: line 3: the picture 'x0003.png' is not in"),
    ("x0002.png", "../x0002.png", "x_par.txt: line 3: '../x0002.png' is no plain file name"),
    ("x0002.png 60", "x0002.png nan", "x_par.txt: line 3: a number is not finite"),
    ("x0002.png 60", "x0002.png K", "x_par.txt: line 3: one of the values is no number"),
    ("x0002.png 60", "x0002.png -60", "x_par.txt: line 3: K must be upper triangular"),
    ("x0002.png", "x0010.png", "x0010.png: has the same name"),
])
def test_a_bad_middlebury_file_is_named_with_its_line(middlebury, tmp_path, old, new, message):
    edit(middlebury / "x_par.txt", old, new)
    with pytest.raises(ScanstageError, match=f"^{re.escape(message)}"):
        import_capture("middlebury", middlebury, tmp_path / "out")
    assert not (tmp_path / "out").exists() and [item.name for item in tmp_path.iterdir()] == ["set"]


def test_a_rotation_of_few_digits_is_made_one_and_a_wrong_one_refused(middlebury, tmp_path):
    text = (middlebury / "x_par.txt").read_text()
    rounded = re.sub(r"0\.\d{4}\d+", lambda match: match[0][:6], text)
    (middlebury / "x_par.txt").write_text(rounded)
    capture = import_capture("middlebury", middlebury, tmp_path / "out")
    np.testing.assert_allclose(capture.cameras["x0010"].R, ring(3)[0].R, atol=2e-4)  # four digits, twice over
    words = text.splitlines()[1].split()
    words[10] = "0.9"
    (middlebury / "x_par.txt").write_text(text.replace(text.splitlines()[1], " ".join(words)))
    with pytest.raises(ScanstageError, match=r"^x_par.txt: line 2: R is not a rotation"):
        import_capture("middlebury", middlebury, tmp_path / "other")


@pytest.mark.parametrize("suffix", ["xml", "yml", "json"])
@pytest.mark.parametrize("scale", [1.0, -0.37])
@pytest.mark.parametrize("mirror", [False, True])
def test_projection_matrices_of_any_scale_and_handedness(tmp_path, suffix, scale, mirror):
    source = write_pictures(tmp_path / "set", [f"image_{n}" for n in range(12)])
    world = np.diag([1, 1, -1 if mirror else 1, 1])
    matrices = {f"viff{n:03d}_matrix": scale * camera.P @ world for n, camera in enumerate(ring(12))}
    write_storage(source / f"cameras.{suffix}", **matrices)
    capture = import_capture("opencv", source, tmp_path / "out")
    assert [frame.id for frame in capture.frames] == [f"image_{n}" for n in range(12)]
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
    for frame, P in zip(capture.frames, matrices.values(), strict=True):
        camera = capture.camera_of(frame)
        assert camera.mirrored == mirror and (camera.project(points)[1] > 0).all()
        assert pixel_difference(P, camera.P, points) < 1e-6
    read_capture(tmp_path / "out")


@pytest.mark.parametrize("suffix", ["xml", "yml", "json"])
def test_maps_of_k_r_t_with_shared_intrinsics(tmp_path, suffix):
    source = write_pictures(tmp_path / "set", ["image_0", "image_1", "image_2"])
    distortion = np.array([[-0.1, 0.01, 0.001, 0.002, 0.0]])
    first, second, third = ring(3)
    own = np.array([[50.0, 0, 20], [0, 50, 15], [0, 0, 1]])
    write_storage(source / f"cameras.{suffix}", camera_matrix=K, distortion_coefficients=distortion,
                  view_0={"R": first.R, "t": first.t.reshape(3, 1)},
                  view_1={"rvec": cv2.Rodrigues(second.R)[0], "tvec": second.t.reshape(3, 1), "K": own},
                  view_2={"P": third.P})
    capture = import_capture("opencv", source / f"cameras.{suffix}", tmp_path / "out")
    cameras = [capture.camera_of(frame) for frame in capture.frames]
    for found, camera, matrix in zip(cameras, ring(3), (K, own, K), strict=True):
        np.testing.assert_allclose(found.K, matrix, atol=1e-9)
        np.testing.assert_allclose(found.R, camera.R, atol=1e-9)
        np.testing.assert_allclose(found.t, camera.t, atol=1e-9)
    for camera in cameras[:2]:
        np.testing.assert_array_equal(camera.distortion, distortion[0])


def test_a_sequence_of_frames_that_name_their_pictures(tmp_path):
    source = write_pictures(tmp_path / "set", ["left", "right"])
    left, right = ring(4)[:2]
    storage = cv2.FileStorage(str(source / "rig.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("K", K)
    storage.startWriteStruct("frames", cv2.FileNode_SEQ)
    for name, camera in (("right", right), ("left", left)):
        storage.startWriteStruct("", cv2.FileNode_MAP)
        storage.write("image", f"{name}.png")
        storage.write("R", camera.R)
        storage.write("t", camera.t)
        storage.endWriteStruct()
    storage.endWriteStruct()
    storage.release()
    capture = import_capture("opencv", source, tmp_path / "out")
    np.testing.assert_allclose(capture.cameras["left"].P, left.P, atol=1e-12)
    np.testing.assert_allclose(capture.cameras["right"].P, right.P, atol=1e-12)


YAML = "%YAML:1.0\n---\n"


def test_whole_numbers_in_a_matrix_of_doubles_are_read_as_what_they_are(tmp_path):
    source = write_pictures(tmp_path / "set", ["image_0"])
    matrix = "P_0: !!opencv-matrix\n   rows: 3\n   cols: 4\n   dt: d\n"
    (source / "cameras.yml").write_text(YAML + matrix + "   data: [ 60, 0, 19.5, 1, 0, 61., 15, 2, 0, 0, 1, 3 ]\n")
    camera = import_capture("opencv", source, tmp_path / "out").cameras["image_0"]
    np.testing.assert_allclose(camera.K, [[60, 0, 19.5], [0, 61, 15], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(camera.P[:, 3], [1, 2, 3], atol=1e-12)


BAD_STORAGE = {
    "garbage": ("hello", "cameras.yml: is not a file of OpenCV's FileStorage"),
    "empty": ("", "cameras.yml: is not a file of OpenCV's FileStorage"),
    "cut off": ("<?xml version='1.0'?>\n<opencv_storage><a>1</a>", "cameras.yml: is not a file of OpenCV's FileStorage"),
    "deep xml": ("<?xml version='1.0'?>\n<opencv_storage>" + "<a>" * 99_999, "cameras.yml: is nested too deeply"),
    "deep yaml": (YAML + "a: " + "[" * 99_999, "cameras.yml: is nested too deeply"),
    "deep dashes": (YAML + "a:\n" + "- " * 99_999 + "1\n", "cameras.yml: is nested too deeply"),
    "nothing": (YAML + "a: 1\n", "cameras.yml: holds no 3x4 matrix"),
    "no picture": (YAML + "view_7: { R: [1, 0, 0], t: [1, 0, 0], K: [1] }\n", "cameras.yml: view_7: no picture in"),
    "bad K": (YAML + "view_0: { R: [1, 0, 0], t: [1, 0, 0], K: [1] }\n", "cameras.yml: view_0: K must be a 3x3 matrix"),
    "too large": (YAML + "P_0: !!opencv-matrix\n   rows: 100000\n   cols: 100000\n   dt: d\n   data: [1.]\n",
                  "cameras.yml: holds no 3x4 matrix"),
    "too few": (YAML + "P_0: !!opencv-matrix\n   rows: 3\n   cols: 4\n   dt: d\n   data: [1.]\n",
                "cameras.yml: P_0: does not hold 3x4 plain numbers"),
    "not finite": (YAML + "P_0: !!opencv-matrix\n   rows: 3\n   cols: 4\n   dt: d\n   data: [.Nan,0,0,0,0,0,0,0,0,0,0,0]\n",
                   "cameras.yml: P_0: a number is not finite"),
    "singular": (YAML + "P_0: !!opencv-matrix\n   rows: 3\n   cols: 4\n   dt: d\n   data: [0,0,0,1,0,0,0,1,0,0,0,1]\n",
                 "cameras.yml: P_0: P must have an invertible left 3x3 part"),
}


@pytest.mark.parametrize("case", BAD_STORAGE)
def test_a_bad_storage_is_named_with_its_node(tmp_path, case):
    text, message = BAD_STORAGE[case]
    source = write_pictures(tmp_path / "set", ["image_0"])
    (source / "cameras.yml").write_text(text)
    with pytest.raises(ScanstageError, match=f"^{re.escape(message)}"):
        import_capture("opencv", source, tmp_path / "out")
    assert [item.name for item in tmp_path.iterdir()] == ["set"]


def test_a_cut_picture_is_not_imported(middlebury, tmp_path):
    data = (middlebury / "x0002.png").read_bytes()
    (middlebury / "x0002.png").write_bytes(data[:-8])
    with pytest.raises(ScanstageError, match="^x0002.png: is cut off or damaged"):
        import_capture("middlebury", middlebury, tmp_path / "out")


def test_a_capture_set_is_replaced_and_other_folders_are_not(middlebury, tmp_path):
    out = tmp_path / "out"
    import_capture("middlebury", middlebury, out)
    (out / "stale.txt").write_text("of the old set")
    import_capture("middlebury", middlebury, out)
    assert sorted(item.name for item in out.iterdir()) == ["capture.json", "images"]
    (out / "capture.json").unlink()
    with pytest.raises(ScanstageError, match="holds files that are no capture set"):
        import_capture("middlebury", middlebury, out)
    shutil.rmtree(out)
    out.mkdir()
    import_capture("middlebury", middlebury, out)  # an empty folder is as good as none
    assert sorted(item.name for item in tmp_path.iterdir()) == ["out", "set"]


def test_the_source_is_never_replaced(middlebury):
    shutil.copy(middlebury / "x_par.txt", middlebury / "capture.json")
    with pytest.raises(ScanstageError, match="holds the source"):
        import_capture("middlebury", middlebury, middlebury)
    assert (middlebury / "x_par.txt").is_file()


def test_unknown_formats_options_and_sources(middlebury, tmp_path):
    with pytest.raises(ScanstageError, match="there is no import format 'colnap'; known are: middlebury, opencv"):
        import_capture("colnap", middlebury, tmp_path / "out")
    with pytest.raises(ScanstageError, match="import opencv has no option 'good_silhouettes'"):
        import_capture("opencv", middlebury, tmp_path / "out", {"good_silhouettes": True})
    with pytest.raises(ScanstageError, match="is not there"):
        import_capture("opencv", tmp_path / "nowhere", tmp_path / "out")
    assert all(name == importer.name for name, importer in IMPORTERS.items())


SHAPES = [Ball((0.1, -0.1, 0.25), 0.3), Box((0.0, 0.15, -0.2), (0.35, 0.15, 0.1), rotation_about((1, 2, 3), 0.5))]


def hull_of(folder, world, bounds):
    """Return the hull (nx, ny, nz), by the centres' rule, of shapes before cameras whose matrices are those of a world that is (4, 4)
    times ours, and the cameras."""
    folder.mkdir()
    for number, camera in enumerate(RING):
        write_mask(folder / f"image_{number}.png", silhouette(camera, SHAPES))
    write_storage(folder / "cameras.yml", **{f"P_{n}": (-1) ** n * 2.5 * camera.P @ np.linalg.inv(world) for n, camera in enumerate(RING)})
    capture = import_capture("opencv", folder, folder / "set", {"conservative": False, "silhouette": "threshold", "threshold": 0.5})
    found = reconstruct(load_scan(folder / "set"), "visual-hull", voxels=48, bounds=np.array(bounds), options={"rule": "center"})
    return found, [capture.camera_of(frame) for frame in capture.frames]


RING = [camera_at((3 * np.cos(a), 3 * np.sin(a), 1.1 + 0.3 * np.sin(3 * a)), focal=200, size=(160, 120)) for a in np.arange(9) * 0.71]
CUBE = [[-0.7, -0.7, -0.7], [0.7, 0.7, 0.7]]


def test_a_mirrored_world_gives_the_mirrored_hull(tmp_path):
    ours, _ = hull_of(tmp_path / "ours", np.eye(4), CUBE)
    mirrored, cameras = hull_of(tmp_path / "mirrored", np.diag((1, 1, -1, 1)), CUBE)
    assert all(camera.mirrored for camera in cameras) and 1000 < ours.volume.count() < 60_000
    np.testing.assert_array_equal(mirrored.volume.dense()[:, :, ::-1], ours.volume.dense())
    assert any("mirrored" in warning for warning in mirrored.report["warnings"])


@pytest.mark.parametrize("handed", [1, -1])
def test_a_world_that_is_not_even_metric_gives_its_own_hull(tmp_path, handed):
    """As of matrices that were found from points alone: each is right, and the world is a projective image of ours."""
    world = np.array([[1, 0.2, 0.1, 0.05], [0, 1.3, -0.2, 0], [0.1, 0, 0.8 * handed, 0.1], [0.06, -0.04, 0.08, 1]])
    found, cameras = hull_of(tmp_path / "set", world, [[-1, -1, -1], [1, 1, 1]])
    assert max(abs(camera.K[0, 1]) for camera in cameras) > 1 and all(camera.mirrored == (handed < 0) for camera in cameras)
    grid = found.volume.grid
    centres = grid.centres(np.indices(grid.shape).reshape(3, -1).T)
    back = np.column_stack((centres, np.ones(len(centres)))) @ np.linalg.inv(world).T
    inside = np.ones(len(centres), bool)
    for camera in RING:  # in our world, of which the importer has seen nothing
        column, row = np.rint(camera.project(back[:, :3] / back[:, 3:])[0]).astype(int).T
        in_picture = (column >= 0) & (row >= 0) & (column < 160) & (row < 120)
        mask = silhouette(camera, SHAPES)
        inside &= ~in_picture | mask[np.where(in_picture, row, 0), np.where(in_picture, column, 0)]
    assert 500 < np.count_nonzero(inside)
    assert np.count_nonzero(found.volume.dense().ravel() ^ inside) <= 3  # centres on a pixel's border, by the last digit


def test_what_cannot_be_decomposed_is_said(tmp_path):
    source = write_pictures(tmp_path / "set", ["image_0", "image_1"])
    write_storage(source / "cameras.yml", P_0=ring(2)[0].P, P_1=np.array([[60.0, 0, 0, 20], [0, 60, 0, 15], [0, 0, 0, 1]]))  # parallel rays
    with pytest.raises(ScanstageError, match="^cameras.yml: P_1: P must have an invertible left 3x3 part; correct the calibration"):
        import_capture("opencv", source, tmp_path / "out")
