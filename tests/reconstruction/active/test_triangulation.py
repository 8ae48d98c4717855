# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points that two devices see come back from their pixels, whatever the lenses."""

import numpy as np
import pytest

from addon.reconstruction.active.triangulation import light_planes, meet_lines, meet_rays, pixel_width, rays_through, undistorted_pixels
from addon.reconstruction.geometry import Camera

RANDOM = np.random.default_rng(5)
POINTS = RANDOM.uniform((-0.4, -0.4, -0.3), (0.4, 0.4, 0.3), (500, 3))


@pytest.fixture(params=["plain", "distorted"])
def devices(request, camera, projector, bent):
    return (camera, projector) if request.param == "plain" else (bent(camera), bent(projector))


def test_undistorted_pixels_are_those_of_the_same_camera_without_distortion(camera, bent):
    skewed = Camera([[230, 3, 80], [0, 240, 60], [0, 0, 1]], camera.R, camera.t, camera.size, bent(camera).distortion)
    ideal = Camera(skewed.K, skewed.R, skewed.t, skewed.size)
    np.testing.assert_allclose(undistorted_pixels(skewed, skewed.project(POINTS)[0]), ideal.project(POINTS)[0], atol=1e-7)


def test_rays_that_meet_give_the_point_without_a_gap(devices):
    camera, projector = devices
    rays, beams = (rays_through(device, device.project(POINTS)[0]) for device in devices)
    meeting = meet_rays(camera.centre, rays, projector.centre, beams)
    np.testing.assert_allclose(meeting.points, POINTS, atol=1e-8)
    np.testing.assert_allclose(meeting.gap, 0, atol=1e-8)
    np.testing.assert_allclose(meeting.along, np.linalg.norm(POINTS - camera.centre, axis=1), atol=1e-8)
    np.testing.assert_allclose(meeting.beside, np.linalg.norm(POINTS - projector.centre, axis=1), atol=1e-8)


def test_the_gap_is_the_distance_of_skew_rays():
    ray, beam = np.array([[0.0, 1.0, 0.0]]), np.array([[-1.0, 0.0, 0.0]])
    meeting = meet_rays(np.zeros(3), ray, np.array([3.0, 5.0, 0.25]), beam)
    np.testing.assert_allclose(meeting.points, [[0, 5, 0.125]])
    assert (meeting.gap[0], meeting.along[0], meeting.beside[0], meeting.sine[0]) == (0.25, 5.0, 3.0, 1.0)


def test_parallel_rays_have_no_finite_point():
    ray = np.array([[0.0, 1.0, 0.0]])
    assert not np.isfinite(meet_rays(np.zeros(3), ray, np.array([1.0, 0, 0]), ray).points).any()


@pytest.mark.parametrize("axis", ["column", "row"])
def test_a_ray_meets_a_column_or_row_at_the_point(devices, axis):
    camera, projector = devices
    positions = projector.project(POINTS)[0][:, ["column", "row"].index(axis)]
    distance, sine = meet_lines(projector, axis, positions, camera.centre, rays_through(camera, camera.project(POINTS)[0]))
    true = np.linalg.norm(POINTS - camera.centre, axis=1)
    # A row's plane nearly holds the ray, for the baseline is level; what is left of a pixel is then enlarged by 1 / sine.
    assert (np.abs(distance - true) < 1e-6 / np.maximum(sine, 1e-3)).all()


def test_planes_of_light_hold_the_points_and_the_projector(projector):
    pixels = projector.project(POINTS)[0]
    planes = light_planes(projector, "column", pixels[:, 0])
    np.testing.assert_allclose((planes[:, :3] * POINTS).sum(1), planes[:, 3], atol=1e-10)
    np.testing.assert_allclose(planes[:, :3] @ projector.centre, planes[:, 3], atol=1e-10)


@pytest.mark.parametrize("axis", ["column", "row"])
def test_a_pixels_width_is_how_far_its_plane_moves(projector, axis):
    index = ["column", "row"].index(axis)
    pixels = projector.project(POINTS)[0]
    planes = light_planes(projector, axis, pixels[:, index] + 1e-4)
    moved = np.abs((planes[:, :3] * POINTS).sum(1) - planes[:, 3]) / np.linalg.norm(planes[:, :3], axis=1)
    np.testing.assert_allclose(pixel_width(projector, axis, POINTS), moved / 1e-4, rtol=1e-3)
