# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Two cameras: rectification against projection, and matching of a textured and of a plain ball."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.errors import ScanstageError
from addon.reconstruction.active.rectified_pair import rectified_picture, rectify
from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.methods import METHODS
from addon.reconstruction.scan import Scan, View
from tests.projection import Round, picture_rays
from tests.rigs import Ball

BOX = np.array([[-0.3] * 3, [0.3] * 3])
BALL = Round(Ball((0.0, 0.0, 0.0), 0.25))


def looking(x, y, z, distortion=()):
    return Camera([[400.0, 0, 161.0], [0, 405.0, 118.0], [0, 0, 1]], *look_at((x, y, z), (0.0, 0.0, 0.0)), (320, 240), distortion or np.zeros(5))


@settings(max_examples=25, deadline=None)
@given(st.floats(0.05, 0.6), st.floats(-0.3, 0.3), st.sampled_from([(), (-0.15, 0.03, 0.001, -0.002, 0.0)]))
def test_a_point_is_in_the_same_row_of_both_and_its_disparity_tells_its_depth(aside, up, distortion):
    first, second = looking(0.0, -1.5, 0.1, distortion), looking(aside, -1.45, 0.1 + up, distortion)
    pair = rectify(first, second, BOX, "test")
    points = np.random.default_rng(0).uniform(-0.28, 0.28, (200, 3))
    (left, depth), (right, _) = pair.first.project(points), pair.second.project(points)
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-6)
    disparity = left[:, 0] - right[:, 0]
    assert (disparity >= -1e-6).all() and (disparity <= pair.disparities).all()
    np.testing.assert_allclose(pair.depths(disparity), depth, rtol=1e-9)


def test_pixels_on_their_own_rays_get_the_depth_of_the_rectified_picture():
    first, second = looking(0.0, -1.5, 0.1, (-0.15, 0.03, 0.001, -0.002, 0.0)), looking(0.3, -1.5, 0.2)
    pair = rectify(first, second, BOX, "test")
    rows, columns = np.mgrid[:pair.first.size[1], :pair.first.size[0]]
    disparity = np.full(rows.shape, 40.0)
    points, reason = pair.points_seen(first, disparity, np.zeros(rows.shape, np.uint8))
    np.testing.assert_allclose((points - first.centre) @ pair.first.forward, pair.depths(np.array(40.0)), rtol=1e-9)
    seen = np.argwhere(reason == 0)[:, ::-1]
    np.testing.assert_allclose(first.project(points)[0], seen, atol=0.02)  # the lens's inverse is right to that


def test_a_rectified_picture_shows_what_the_ideal_camera_sees():
    first, second = looking(0.0, -1.5, 0.1), looking(0.3, -1.5, 0.2)
    pair = rectify(first, second, BOX, "test")
    picture = _paint(BALL, first)
    ours, ideal = rectified_picture(first, pair.first, picture), _paint(BALL, pair.first)
    both = (ours > 0.2) & (ideal > 0.2)
    assert both.sum() > 10_000 and np.abs(ours - ideal)[both].mean() < 0.01


def _paint(ball, camera, plain=False):
    """Return the ball's picture (h, w) float32: a texture fixed to its surface, smooth enough for the pixels."""
    rays = picture_rays(camera)
    distance = ball.distances(camera.centre, rays)
    points = camera.centre + np.where(np.isfinite(distance), distance, 0)[..., None] * rays
    texture = 0.55 + (0 if plain else 0.25 * np.prod(np.sin(60 * points + 1), axis=-1) + 0.15 * np.sin(90 * points[..., 2] + 50 * points[..., 0]))
    return np.where(np.isfinite(distance), texture, 0).astype(np.float32)


def pair_of_views(plain):
    views = []
    for number, aside in enumerate((-0.1, 0.1)):
        camera = looking(aside, -1.2, 0.0)
        image = np.repeat(_paint(BALL, camera, plain)[..., None], 3, axis=2)
        views.append(View(f"{number:04d}", camera, image[..., 0] > 0, lambda image=image: image))
    return Scan(tuple(views), BOX)


def test_a_textured_ball_is_matched_to_a_part_of_a_pixel():
    found = METHODS["stereo"].measure(pair_of_views(plain=False))
    error = np.abs(np.linalg.norm(found.cloud.positions, axis=1) - 0.25)
    pixel = 1.0 ** 2 / (400 * 0.2)  # metres of depth for a pixel of disparity
    assert len(found.cloud) > 0.5 * 2 * np.count_nonzero(pair_of_views(plain=False).views[0].mask)
    assert np.median(error) < 0.5 * pixel and np.quantile(error, 0.95) < 2 * pixel  # what semi-global matching is good for
    assert not found.warnings


def test_a_plain_ball_cannot_be_matched_and_the_error_says_why():
    with pytest.raises(ScanstageError, match="too little texture for stereo without a projector"):
        METHODS["stereo"].measure(pair_of_views(plain=True))


def test_bad_input_is_one_sentence():
    scan = pair_of_views(plain=False)
    with pytest.raises(ScanstageError, match="no two views are 1 to 5 degrees apart"):
        METHODS["stereo"].measure(scan, widest=np.radians(5.0))
    with pytest.raises(ScanstageError, match="stand in one place"):
        rectify(scan.views[0].camera, scan.views[0].camera, BOX, "frames 1 and 2")
