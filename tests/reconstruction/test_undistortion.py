# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistorted silhouettes, against OpenCV's own lens model: nothing lost, nothing invented, nothing known that is not."""

import cv2
import numpy as np
import pytest

from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.silhouettes import cover_partial_pixels
from addon.reconstruction.undistortion import MAX_GROWTH, curvature_margin, injective_radius, undistorted_view

SIZE = (96, 72)
R, T = look_at((1.0, 2.0, 0.5), (0.0, 0.0, 0.0))
LENSES = {
    "barrel": (-0.3, 0.1, 0, 0, 0),
    "pincushion": (0.25, 0, 0, 0, 0),
    "tangential": (0, 0, 0.03, -0.02, 0),
    "all": (-0.25, 0.12, 0.004, -0.006, -0.03),
    "folding": (-0.8, 0, 0.01, 0.005, 0),
    "fisheye": (-0.45, 0.05, 0, 0, 0),
}


def lens(name, skew=0.0):
    return Camera([[80, skew, 46.0], [0, 83, 37.0], [0, 0, 1]], R, T, SIZE, LENSES.get(name, np.zeros(5)))


def blobs(seed):
    """Return a mask of blobs, thin lines and single pixels."""
    rng = np.random.default_rng(seed)
    mask = cv2.GaussianBlur(rng.random(SIZE[::-1]).astype(np.float32), (0, 0), 3) > 0.51
    mask[rng.integers(0, SIZE[1], 20), rng.integers(0, SIZE[0], 20)] = True
    mask[:, 30] = True
    return mask


def real_positions(camera, ideal, pixels):
    """Return where OpenCV puts (n, 2) pixels of the ideal camera in the real picture."""
    rays = np.column_stack((pixels, np.ones(len(pixels)))) @ np.linalg.inv(ideal.K).T
    # cv2.projectPoints knows no skew: it distorts in the normalised plane, K is applied here
    normalised = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), camera.distortion)[0].reshape(-1, 2)
    return normalised @ camera.K[:2, :2].T + camera.K[:2, 2]


def subpixels(known, count):
    """Return positions (n, 2) all over each known pixel, corners and edges included, and the pixels (n, 2) they lie in."""
    pixels = np.argwhere(known)[:, ::-1]
    offset = np.linspace(-0.5, 0.5, count)
    grid = np.stack(np.meshgrid(offset, offset), axis=-1).reshape(-1, 2)
    return (pixels[:, None] + grid).reshape(-1, 2), np.repeat(pixels, len(grid), axis=0)


@pytest.mark.parametrize("skew", [0.0, 4.0])
@pytest.mark.parametrize("name", LENSES)
def test_conservative_keeps_whatever_any_part_of_a_pixel_touches(name, skew):
    camera, mask = lens(name, skew), blobs(1)
    found, known, ideal = undistorted_view(mask, camera, conservative=True)
    positions, pixels = subpixels(known, 7)
    column, row = np.floor(real_positions(camera, ideal, positions) + 0.5).astype(int).T
    # Known means that no part of the pixel lies beyond the picture, nor in its outermost pixels.
    assert column.min() >= 1 and row.min() >= 1 and column.max() <= SIZE[0] - 2 and row.max() <= SIZE[1] - 2
    assert known.sum() > 1000
    lost = mask[row, column] & ~found[pixels[:, 1], pixels[:, 0]]
    assert not lost.any()
    assert not (found & ~known).any()


@pytest.mark.parametrize("name", ["barrel", "pincushion", "all"])
def test_conservative_invents_nothing_far_from_the_silhouette(name):
    camera, mask = lens(name), blobs(2)
    found, known, ideal = undistorted_view(mask, camera, conservative=True)
    pixels = np.argwhere(known)[:, ::-1]
    column, row = np.floor(real_positions(camera, ideal, pixels) + 0.5).astype(int).T
    # These lenses magnify by at most 1.6 along either axis here, so the footprint ends within 1.6 px of its centre's pixel
    near = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    assert not (found[pixels[:, 1], pixels[:, 0]] & ~near[row, column]).any()
    assert 0.02 < found[known].mean() < 0.98


@pytest.mark.parametrize("name", LENSES)
def test_otherwise_the_pixel_under_the_centre_decides(name):
    camera, mask = lens(name), blobs(3)
    found, known, ideal = undistorted_view(mask, camera, conservative=False)
    pixels = np.argwhere(known)[:, ::-1]
    column, row = np.floor(real_positions(camera, ideal, pixels) + 0.5).astype(int).T
    np.testing.assert_array_equal(found[pixels[:, 1], pixels[:, 0]], mask[row, column])
    assert not (found & ~known).any()


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("conservative", [False, True])
def test_points_of_the_scene_land_on_their_own_pixel(name, conservative):
    camera = lens(name)
    _, known, ideal = undistorted_view(blobs(0), camera, conservative=conservative)
    assert not ideal.distorted and ideal.size == known.shape[::-1]
    np.testing.assert_array_equal(ideal.R, R)
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (400, 3))
    straight, depth = ideal.project(points)
    real = cv2.projectPoints(points, cv2.Rodrigues(R)[0], T, camera.K, camera.distortion)[0].reshape(-1, 2)
    np.testing.assert_allclose(real_positions(camera, ideal, straight), real, atol=1e-8)  # float64, some hundred pixels


@pytest.mark.parametrize("name", ["barrel", "pincushion", "tangential", "all"])
def test_the_canvas_covers_the_whole_real_picture(name):
    camera = lens(name)
    _, _, ideal = undistorted_view(blobs(0), camera, conservative=False)
    x, y = np.linspace(-0.5, SIZE[0] - 0.5, 40), np.linspace(-0.5, SIZE[1] - 0.5, 40)
    border = np.concatenate([np.column_stack((x, np.full(40, edge))) for edge in (y[0], y[-1])]
                            + [np.column_stack((np.full(40, edge), y)) for edge in (x[0], x[-1])])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    straight = cv2.undistortPointsIter(border[:, None], camera.K, camera.distortion, None, ideal.K, criteria)[:, 0]
    assert (straight >= -0.5).all() and (straight <= np.array(ideal.size) - 0.5).all()


@pytest.mark.parametrize("k1", [-0.2, -0.45, -0.8, -3.0])
def test_beyond_the_fold_nothing_is_known(k1):
    camera = Camera([[40, 0, 46.0], [0, 40, 37.0], [0, 0, 1]], R, T, SIZE, (k1, 0, 0, 0, 0))
    fold = np.sqrt(-1 / (3 * k1))  # where r (1 + k1 r^2) turns back
    radius = injective_radius(camera)
    assert 0.98 * fold <= radius <= fold
    for conservative in (False, True):
        _, known, ideal = undistorted_view(blobs(0), camera, conservative=conservative)
        pixels = np.argwhere(known)[:, ::-1]
        assert len(pixels)
        rays = np.column_stack((pixels, np.ones(len(pixels)))) @ np.linalg.inv(ideal.K).T
        assert np.hypot(rays[:, 0], rays[:, 1]).max() <= fold


def test_no_two_known_rays_share_a_real_position():
    camera = Camera([[40, 0, 46.0], [0, 40, 37.0], [0, 0, 1]], R, T, SIZE, (-0.3, -0.05, 0.04, -0.03, 0.0))
    radius = injective_radius(camera)
    rng = np.random.default_rng(0)
    angle, r = rng.uniform(0, 2 * np.pi, 1000), radius * np.sqrt(rng.uniform(0, 1, 1000))
    rays = np.column_stack((r * np.cos(angle), r * np.sin(angle), np.ones(1000)))
    real = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), camera.distortion)[0].reshape(-1, 2)
    difference, image = rays[:, None, :2] - rays[None, :, :2], real[:, None] - real[None]
    # Monotone: the images of any two rays differ in the direction in which the rays differ
    agreement = (difference * image).sum(axis=-1)
    assert (agreement[~np.eye(1000, dtype=bool)] > 0).all()


def test_an_extreme_lens_is_cropped_at_the_stated_growth():
    camera = Camera([[30, 0, 47.5], [0, 30, 35.5], [0, 0, 1]], R, T, SIZE, (-0.32, 0.06, 0, 0, -0.0035))
    _, known, ideal = undistorted_view(blobs(0), camera, conservative=True)
    assert (np.array(ideal.size) <= MAX_GROWTH * np.array(SIZE) + 6).all() and known.any()


def test_the_margin_bounds_how_far_squares_bulge():
    for name in LENSES:
        camera = lens(name, 4.0)
        margin = curvature_margin(camera, injective_radius(camera))
        _, known, ideal = undistorted_view(np.ones(SIZE[::-1], bool), camera, conservative=True)
        positions, _ = subpixels(known, 5)
        real = real_positions(camera, ideal, positions).reshape(-1, 5, 5, 2)
        corners = real[:, ::4, ::4].reshape(len(real), 4, 2)
        bulge = np.maximum(real.max(axis=(1, 2)) - corners.max(axis=1), corners.min(axis=1) - real.min(axis=(1, 2)))
        assert bulge.max() <= margin


def test_without_distortion_the_picture_is_the_same_but_for_its_rim():
    camera, mask = lens("none"), blobs(4)
    same, known, ideal = undistorted_view(mask, camera, conservative=False)
    assert known.all()
    np.testing.assert_array_equal(same, mask)
    np.testing.assert_array_equal(ideal.P, camera.P)
    inner, known, ideal = undistorted_view(mask, camera, conservative=True)
    assert known.all() and ideal.size == (SIZE[0] - 2, SIZE[1] - 2)
    np.testing.assert_array_equal(inner, mask[1:-1, 1:-1])
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3))
    np.testing.assert_allclose(ideal.project(points)[0], camera.project(points)[0] - 1, atol=1e-9)
    whole, known, _ = undistorted_view(mask, camera, conservative=True, outside="empty")
    assert known.all()
    np.testing.assert_array_equal(whole, mask)


def test_the_rim_is_where_an_object_beyond_the_picture_may_hide():
    rows, columns = np.mgrid[-5:SIZE[1] + 5, -5:SIZE[0] + 5]
    radius, x, y = np.sqrt(0.5), -1.15, 20.3  # outside, and it touches pixels of column 0
    sampled = ((columns - x) ** 2 + (rows - y) ** 2 <= radius ** 2)[5:-5, 5:-5]
    touched = (np.maximum(np.abs(columns - x) - 0.5, 0) ** 2 + np.maximum(np.abs(rows - y) - 0.5, 0) ** 2
               <= radius ** 2)[5:-5, 5:-5]
    assert touched.any() and not cover_partial_pixels(sampled).any()
    assert not touched[1:-1, 1:-1].any()


def test_empty_outside_is_known_to_be_empty():
    camera, mask = lens("barrel"), np.ones(SIZE[::-1], bool)
    for conservative in (False, True):
        found, known, _ = undistorted_view(mask, camera, conservative=conservative, outside="empty")
        assert known.all() and found.any() and not found.all()


@pytest.mark.parametrize("size", [(1, 1), (2, 5), (3, 3)])
@pytest.mark.parametrize("name", ["none", "barrel"])
def test_tiny_pictures(size, name):
    camera = Camera([[2, 0, 0], [0, 2, 0], [0, 0, 1]], R, T, size, LENSES.get(name, np.zeros(5)))
    for conservative in (False, True):
        mask, known, ideal = undistorted_view(np.ones(size[::-1], bool), camera, conservative=conservative)
        assert mask.shape == known.shape == ideal.size[::-1]
        assert not (conservative and min(size) < 3 and known.any())  # such a picture is all rim


def test_wrong_calls():
    with pytest.raises(ValueError, match="the mask is 72x96, the camera 96x72"):
        undistorted_view(np.ones(SIZE, bool), lens("barrel"), conservative=True)
    with pytest.raises(ValueError, match="outside must be"):
        undistorted_view(np.ones(SIZE[::-1], bool), lens("barrel"), conservative=True, outside="white")
