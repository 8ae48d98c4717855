# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What every importer can do: silhouettes as alpha, in a folder or made; lenses kept, or undone once."""

import dataclasses

import cv2
import numpy as np
import pytest

from addon.captures.contour_file import contours_text, read_contours
from addon.captures.importers import import_capture
from addon.captures.pictures import read_mask, read_picture, write_mask, write_picture
from addon.captures.scan import load_scan
from addon.captures.store import read_capture
from addon.errors import ScanstageError
from addon.reconstruction.geometry import Camera
from addon.reconstruction.undistortion import undistort_pixels
from tests.rigs import Ball, pixel_rays, silhouette
from tests.sources import OF_OBJECT, SIZE, write_source

DISC = np.hypot(*np.mgrid[-8:8, -11:9]) < 5


@pytest.mark.parametrize("case", OF_OBJECT)
@pytest.mark.parametrize("way", ["alpha", "masks", "outlines", "made"])
def test_silhouettes_come_as_alpha_in_a_folder_or_are_made(tmp_path, case, way):
    source = write_source(tmp_path / "set", case, alpha=DISC if way == "alpha" else None)
    cleaned = {"dilate": 0, "erode": 0}  # a Middlebury set has a recipe of its own
    options = {"masks": {"masks": "masks"}, "outlines": {"masks": str(tmp_path / "outlines")}, "alpha": {"silhouette": "alpha", **cleaned},
               "made": {"silhouette": "threshold", "threshold": 0.5, **cleaned}}[way]
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    (tmp_path / "outlines").mkdir()
    for n in (1, 2):
        write_mask(source / "masks" / f"view_{n}.png", DISC)
        (tmp_path / "outlines" / f"view_{n}.txt").write_bytes(contours_text([np.column_stack((11 + 4.9 * np.cos(angle), 8 + 4.9 * np.sin(angle)))]))
        if way == "made":
            write_picture(source / f"view_{n}.png", np.repeat(DISC[..., None], 3, axis=-1) * 0.9, encoding="srgb", bits=8)
    import_capture(case, source, tmp_path / "out", options)
    views = load_scan(tmp_path / "out", {"conservative": False}).views
    assert len(views) == 2
    for view in views:
        np.testing.assert_array_equal(view.mask, DISC)
        assert (view.contours is not None) == (way == "outlines")


def test_colmaps_names_of_masks_are_known(tmp_path):
    source = write_source(tmp_path / "set", "colmap")
    for n in (1, 2):
        write_mask(source / "masks" / f"view_{n}.png.png", DISC)
    capture = import_capture("colmap", source, tmp_path / "out", {"masks": "masks"})
    np.testing.assert_array_equal(read_mask(tmp_path / "out" / capture.frames[1].mask, size=SIZE), DISC)


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda folder: (folder / "view_2.png").unlink(), "view_2.png: no file of .* has its name; put its mask there"),
    (lambda folder: write_mask(folder / "view_2.png", DISC.T), "view_2.png: is 16x20 pixels, its picture 20x16"),
    (lambda folder: (folder / "view_2.png").write_bytes(b"P5 20 16 255\n..."), "view_2.png: is cut off"),
    (lambda folder: ((folder / "view_2.png").unlink(), (folder / "view_2.txt").write_text("1 2\n3 x\n")), "view_2.txt: line 2: must be"),
])
def test_a_mask_that_cannot_be_used_is_named(tmp_path, spoil, words):
    source = write_source(tmp_path / "set", "opencv")
    for n in (1, 2):
        write_mask(source / "masks" / f"view_{n}.png", DISC)
    spoil(source / "masks")
    with pytest.raises(ScanstageError, match=f"^{words}"):
        import_capture("opencv", source, tmp_path / "out", {"masks": "masks"})
    with pytest.raises(ScanstageError, match="^option masks: .*none is no folder"):
        import_capture("opencv", source, tmp_path / "out", {"masks": "none"})
    assert not (tmp_path / "out").exists()


# Lenses


LENSES = {"barrel": (-0.3, 0.1, 0.004, -0.006, 0), "pincushion": (0.25, 0, 0, 0.003, 0.01)}
BALL = Ball((0.1, 0.05, 4.0), 1.0)


def pattern(x, y):
    """Return a smooth picture of the normalised plane, so coarse that interpolation between pixels loses nothing to speak of."""
    return 0.5 + 0.2 * np.stack((np.sin(3 * x), np.cos(4 * y), np.sin(2 * x + 3 * y)), axis=-1)


def photographed(folder, lens):
    """Write what a camera with a lens sees, with a mask and exact outlines, and return its ideal camera."""
    size = (160, 120)
    camera = Camera([[150.0, 0.8, 77.0], [0, 152, 63], [0, 0, 1]], np.eye(3), np.zeros(3), size, LENSES[lens])
    pixels = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1).reshape(-1, 2).astype(float)
    straight = undistort_pixels(pixels, camera)[0].reshape(size[1], size[0], 2)
    ideal = Camera(camera.K, camera.R, camera.t, size)
    x, y = np.moveaxis(ideal.rays(straight), -1, 0)[:2]
    write_picture(folder / "view_1.png", pattern(x, y))
    write_mask(folder / "masks" / "view_1.png", BALL.hit_by(np.zeros(3), ideal.rays(straight)))
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    rim = np.column_stack((0.1 + 0.9 * np.cos(angle), 0.05 + 0.9 * np.sin(angle), np.full(90, 4.0)))
    (folder / "outlines").mkdir()
    (folder / "outlines" / "view_1.txt").write_bytes(contours_text([camera.project(rim)[0]]))
    write_calibration(folder / "camera.yml", camera)
    return camera, rim


def write_calibration(path, camera):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in {"K": camera.K, "distortion": np.array([camera.distortion]), "R": np.eye(3), "t": np.zeros((3, 1))}.items():
        storage.write(name, value)
    storage.release()


@pytest.mark.parametrize("lens", LENSES)
def test_the_lens_is_kept_or_undone(tmp_path, lens):
    camera, rim = photographed(tmp_path / "set", lens)
    options = {"encoding": "linear", "masks": "masks"}
    kept = import_capture("turntable", tmp_path / "set", tmp_path / "kept", options)
    np.testing.assert_array_equal(kept.cameras["camera"].distortion, camera.distortion)
    assert (tmp_path / "kept/images/view_1.png").read_bytes() == (tmp_path / "set/view_1.png").read_bytes()
    import_capture("turntable", tmp_path / "set", tmp_path / "undone", {**options, "undistort": True})
    capture = read_capture(tmp_path / "undone")
    frame, ideal = capture.frames[0], capture.cameras["camera"]
    assert not ideal.distorted and (ideal.K[:2, :2] == camera.K[:2, :2]).all() and min(ideal.size) > 90
    x, y = np.moveaxis(pixel_rays(ideal), -1, 0)[:2]
    found = read_picture(tmp_path / "undone" / frame.image, "linear", size=ideal.size)[0]
    np.testing.assert_allclose(found, pattern(x, y), atol=5e-4)  # OpenCV interpolates at 1/32 of a pixel
    difference = read_mask(tmp_path / "undone" / frame.mask, size=ideal.size) ^ silhouette(ideal, [BALL])
    border = cv2.morphologyEx(silhouette(ideal, [BALL]).astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    assert not difference[~border].any() and difference.sum() < 0.5 * border.sum()  # each pixel from its nearest
    # Nothing that the real picture does not show: the border is all within it.
    corners = np.array([(0, 0), (ideal.size[0] - 1, 0), (0, ideal.size[1] - 1), np.subtract(ideal.size, 1)], float)
    real = Camera(camera.K, camera.R, camera.t, camera.size, camera.distortion).project(ideal.rays(corners))[0]
    assert (real > -0.01).all() and (real < np.subtract(camera.size, 0.99)).all()
    import_capture("turntable", tmp_path / "set", tmp_path / "outlines", {**options, "masks": "outlines", "undistort": True})
    frame = read_capture(tmp_path / "outlines").frames[0]
    np.testing.assert_allclose(read_contours(tmp_path / "outlines" / frame.contours)[0], ideal.project(rim)[0], atol=1e-6)


def test_a_lens_that_folds_cannot_be_undone(tmp_path):
    camera, _ = photographed(tmp_path / "set", "barrel")
    write_calibration(tmp_path / "set/camera.yml", dataclasses.replace(camera, distortion=(-3.0, 0, 0, 0, 0)))
    with pytest.raises(ScanstageError, match="^camera camera: the lens distortion cannot be inverted at the picture's border"):
        import_capture("turntable", tmp_path / "set", tmp_path / "out", {"undistort": True})
    assert not (tmp_path / "out").exists()
