# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras and grids, against OpenCV and against what they say about themselves."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addon.reconstruction.geometry import Camera, VoxelGrid, distort, look_at, rotation_about

K = np.array([[700.0, 2.5, 318.2], [0, 710.0, 241.7], [0, 0, 1]])
SIZE = (640, 480)
LENS = (-0.2, 0.05, 0.002, -0.003, 0.01)
ROUNDING = 1e-9  # float64 on numbers of some hundred


def camera(seed=0, distortion=(0, 0, 0, 0, 0), skew=2.5):
    rng = np.random.default_rng(seed)
    R, t = look_at(rng.uniform(2, 4, 3), rng.uniform(-0.2, 0.2, 3))
    matrix = K.copy()
    matrix[0, 1] = skew
    return Camera(matrix, R, t, SIZE, distortion)


def points(seed=0, count=60):
    return np.random.default_rng(seed).uniform(-0.7, 0.7, (count, 3))


def motion(seed=0):
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_about(rng.normal(size=3), rng.uniform(-3, 3))
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


@pytest.mark.parametrize("distortion", [(0, 0, 0, 0, 0), LENS])
@pytest.mark.parametrize("seed", range(3))
def test_projection_is_opencvs(seed, distortion):
    subject = camera(seed, distortion, skew=0)  # cv2.projectPoints ignores skew
    expected = cv2.projectPoints(points(), cv2.Rodrigues(subject.R)[0], subject.t, subject.K, subject.distortion)[0][:, 0]
    pixels, depth = subject.project(points())
    np.testing.assert_allclose(pixels, expected, atol=ROUNDING)
    np.testing.assert_allclose(depth, (points() - subject.centre) @ subject.forward, atol=ROUNDING)


def test_projection_with_skew_is_that_of_p():
    subject = camera()
    image = np.column_stack((points(), np.ones(60))) @ subject.P.T
    np.testing.assert_allclose(subject.project(points())[0], image[:, :2] / image[:, 2:], atol=ROUNDING)


def test_projection_keeps_the_leading_shape():
    pixels, depth = camera().project(points().reshape(3, 4, 5, 3))
    assert pixels.shape == (3, 4, 5, 2) and depth.shape == (3, 4, 5)


def test_rays_lead_through_the_points_they_come_from():
    subject = camera(1)
    pixels, depth = subject.project(points())
    np.testing.assert_allclose(subject.centre + subject.rays(pixels) * depth[:, None], points(), atol=ROUNDING)


def test_the_centre_projects_nowhere_without_a_warning():
    pixels, depth = camera().project(camera().centre)
    assert abs(depth) < ROUNDING and pixels.shape == (2,)


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("scale", [1.0, -1.0, 3e-4, -7e5])
@pytest.mark.parametrize("seed", range(3))
def test_a_projection_matrix_is_decomposed_whatever_its_scale_sign_and_handedness(seed, scale, mirror):
    original = camera(seed)
    P = scale * original.P @ np.diag([1, 1, -1 if mirror else 1, 1])
    found = Camera.from_projection(P, SIZE, towards=(0, 0, 0))
    assert found.mirrored == mirror
    np.testing.assert_allclose(found.K, K, atol=1e-7)  # the decomposition divides by P's third row
    np.testing.assert_allclose(found.P, original.P @ np.diag([1, 1, -1 if mirror else 1, 1]), atol=1e-7)
    assert (found.project(points())[1] > 0).all()


def test_without_a_point_in_front_the_sign_is_that_of_a_rotation():
    for scale in (1, -1):
        found = Camera.from_projection(scale * camera().P, SIZE)
        assert not found.mirrored
        np.testing.assert_allclose(found.R, camera().R, atol=ROUNDING)


@pytest.mark.parametrize("P", [np.zeros((3, 4)), np.eye(4)[:3] * [[1], [1], [0]], np.full((3, 4), np.nan), np.eye(3)])
def test_a_matrix_that_is_no_finite_cameras_is_refused(P):
    with pytest.raises(ValueError, match="^P must"):
        Camera.from_projection(P, SIZE)


@pytest.mark.parametrize("seed", range(3))
def test_a_moved_camera_sees_moved_points_as_before(seed):
    pose = motion(seed)
    world = points() @ pose[:3, :3].T + pose[:3, 3]
    expected, depth = camera(distortion=LENS).project(world)
    found, found_depth = camera(distortion=LENS).moved(pose).project(points())
    np.testing.assert_allclose(found, expected, atol=1e-8)  # points up to metres away, twice transformed
    np.testing.assert_allclose(found_depth, depth, atol=ROUNDING)


@pytest.mark.parametrize("factor", [0.5, 0.3, 2.0, 1.0])
def test_a_scaled_camera_keeps_the_outer_edges_of_the_picture(factor):
    small = camera(distortion=LENS).scaled(factor)
    np.testing.assert_allclose(small.project(points())[0] + 0.5, factor * (camera(distortion=LENS).project(points())[0] + 0.5),
                               atol=ROUNDING)
    assert small.size == (np.ceil(640 * factor - 1e-6), np.ceil(480 * factor - 1e-6))


def test_distortion_is_opencvs():
    plane = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 2))
    expected = cv2.projectPoints(np.column_stack((plane, np.ones(50))), np.zeros(3), np.zeros(3), np.eye(3), np.array(LENS))[0]
    np.testing.assert_allclose(distort(plane, LENS), expected[:, 0], atol=1e-12)


def test_look_at_puts_the_target_ahead_and_up_upward():
    R, t = look_at((3, -2, 1), (0.5, 0, 0))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0
    target = R @ (0.5, 0, 0) + t
    np.testing.assert_allclose(target, (0, 0, np.linalg.norm((2.5, -2, 1))), atol=1e-12)
    assert (R @ (0.5, 0, 0.1) + t)[1] < 0  # y points down


@pytest.mark.parametrize(("centre", "target"), [((0, 0, 1), (0, 0, 0)), ((1, 1, 1), (1, 1, 1))])
def test_look_at_refuses_directions_without_an_upward(centre, target):
    with pytest.raises(ValueError, match="viewing direction"):
        look_at(centre, target)


@pytest.mark.parametrize("seed", range(4))
def test_rotations_are_opencvs(seed):
    rng = np.random.default_rng(seed)
    axis, angle = rng.normal(size=3), rng.uniform(-3, 3)
    expected = cv2.Rodrigues(axis / np.linalg.norm(axis) * angle)[0]
    np.testing.assert_allclose(rotation_about(axis, angle), expected, atol=1e-12)


@pytest.mark.parametrize(("field", "value"), [
    ("K", np.eye(4)), ("K", np.full((3, 3), np.inf)), ("K", -np.eye(3)), ("K", 2 * np.eye(3)), ("K", np.tri(3)),
    ("R", np.ones((3, 3))), ("R", 1.001 * np.eye(3)), ("R", np.full((3, 3), np.nan)),
    ("t", (1, 2)), ("t", (0, 0, np.nan)), ("size", (0, 5)), ("size", (5, -1)), ("distortion", (1, 2, 3, 4))])
def test_a_camera_names_the_field_that_is_wrong(field, value):
    good = {"K": K, "R": np.eye(3), "t": (0, 0, 0), "size": SIZE}
    with pytest.raises(ValueError, match=f"^{field} must"):
        Camera(**{**good, field: value})


def test_a_camera_cannot_be_changed_from_outside():
    t = np.zeros(3)
    subject = Camera(K, np.eye(3), t, SIZE)
    t[0] = 9
    assert subject.t[0] == 0
    with pytest.raises(ValueError):
        subject.K[0, 0] = 1


SIDES = st.floats(0.01, 50)


@given(lower=st.tuples(*[st.floats(-10, 10)] * 3), extent=st.tuples(SIDES, SIDES, SIDES), voxels=st.integers(1, 300))
def test_a_grid_covers_its_bounds_and_no_more_than_it_must(lower, extent, voxels):
    lower, extent = np.array(lower), np.array(extent)
    grid = VoxelGrid.from_bounds(lower, lower + extent, voxels)
    slack = 2e-6 * grid.voxel_size + 1e-12  # from_bounds forgives a millionth of a voxel, float64 the rest
    np.testing.assert_array_equal(grid.origin, lower)
    assert (grid.upper >= lower + extent - slack).all()
    assert (grid.upper - grid.voxel_size <= lower + extent + slack).all()
    assert max(grid.shape) == voxels and grid.count == np.prod(grid.shape)


def test_voxel_centres():
    grid = VoxelGrid((1, 2, 3), 0.5, (4, 5, 6))
    np.testing.assert_allclose(grid.centres([[0, 0, 0], [3, 4, 5]]), [[1.25, 2.25, 3.25], [2.75, 4.25, 5.75]])
    np.testing.assert_allclose(grid.upper, [3, 4.5, 6])


@pytest.mark.parametrize("wrong", [
    lambda: VoxelGrid((0, 0, 0), 0, (1, 1, 1)), lambda: VoxelGrid((0, 0, 0), np.nan, (1, 1, 1)),
    lambda: VoxelGrid((0, 0, 0), 1, (1, 0, 1)), lambda: VoxelGrid((0, 0, 0), 1, (1, 1)),
    lambda: VoxelGrid((0, 0, np.inf), 1, (1, 1, 1)), lambda: VoxelGrid.from_bounds((0, 0, 0), (1, 0, 1), 4),
    lambda: VoxelGrid.from_bounds((0, 0, 0), (1, 1, 1), 0)])
def test_a_grid_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError):
        wrong()
