# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth buffers and coverage against rays, and the expected error of depth against the formulas of two devices."""

import numpy as np
import pytest

from addon.reconstruction.geometry import Camera, Light
from addon.reconstruction.mesh import TriangleMesh
from addon.reconstruction.planning.coverage import Sheet, Shot, Surveyor
from addon.reconstruction.planning.depth_buffer import Sight, depth_buffer
from tests.rigs import Ball, camera_at, first_hit, pixel_rays, ring, sphere_mesh

BALLS = Ball((0.0, 0.0, 0.0), 1.0), Ball((1.3, -0.9, 0.4), 0.4)


@pytest.fixture(scope="module")
def balls():
    one, two = (sphere_mesh(ball, 40) for ball in BALLS)
    return TriangleMesh(np.concatenate((one.vertices, two.vertices)), np.concatenate((one.triangles, two.triangles + len(one.vertices))))


def plate(*, half=1.0) -> TriangleMesh:
    """A square in the plane z = 0 that faces up."""
    return TriangleMesh(half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), [[0, 1, 2], [0, 2, 3]])


def surveyed(mesh, shots, **words):
    return Surveyor(mesh, mesh.corners()).coverage(shots, **words)


def reached(mesh, place):
    """Return which triangles' middles the place sees by the balls' formulas: balls hide each other, and their own far sides."""
    a, b, c = np.moveaxis(mesh.corners(), 1, 0)
    points, normals = (a + b + c) / 3, np.cross(b - a, c - a)
    out = ((place - points) * normals).sum(1) > 0
    own = np.array([np.linalg.norm(points - ball.centre, axis=1) / ball.radius for ball in BALLS]).argmin(0)
    for number, ball in enumerate(BALLS):
        enters = ball.along(np.broadcast_to(place, points.shape), points - place)[0]
        out &= (own == number) | (enters > 1)
    return out


def test_depths_are_those_of_the_rays(balls):
    camera = camera_at((2.0, -5.0, 1.5), focal=260.0, size=(160, 120))
    depth, true = depth_buffer(balls, camera), first_hit(BALLS, camera.centre, pixel_rays(camera))
    both = np.isfinite(depth) & np.isfinite(true)
    assert np.count_nonzero(np.isfinite(depth) ^ np.isfinite(true)) < 0.02 * both.sum()  # the mesh lies within the balls
    error = depth[both] - true[both]
    assert error.min() > -1e-5 and np.median(error) < 0.005 and (error < 0.1).mean() > 0.99


@pytest.mark.parametrize("place", [(2.0, -4.0, 1.0), (4.0, 1.0, 0.2), (0.3, 0.2, 6.0), (3000.0, -2000.0, 900.0)])
def test_what_a_place_sees_is_what_rays_reach(balls, place):
    place = np.array(place)
    a, b, c = np.moveaxis(balls.corners(), 1, 0)
    points, normals = (a + b + c) / 3, np.cross(b - a, c - a)
    seen, true = Sight(balls, place).sees(points, normals), reached(balls, place)
    assert 0.2 < true.mean() < 0.6
    assert (seen != true).mean() < 0.01  # beside the edge of a shadow, which is known to half a pixel of 1 / 256 of the picture
    for point in points[seen != true]:
        near = np.linalg.norm(points - point, axis=1) < 0.12
        assert true[near].any() and not true[near].all()


def test_counts_of_views_and_lights_are_sums_over_the_places(balls):
    cameras = ring(5, elevation=20, distance=6, focal=120)
    lights = [Light("point", np.array([3.0, 3.0, 3.0])), Light("sun", direction=np.array([0.0, 0.6, -0.8]))]
    found = surveyed(balls, [Shot(camera, (lights[0], lights[i % 2])) for i, camera in enumerate(cameras)])
    true = sum(reached(balls, camera.centre).astype(int) for camera in cameras)
    assert (found.views != true).mean() < 0.03 and found.views.max() == true.max()
    lit = sum(reached(balls, place).astype(int) for place in (lights[0].position, -1e4 * lights[1].direction))
    assert (found.lights != lit).mean() < 0.02
    summary = found.summary()
    assert summary["seen_by_less_than_2"] == pytest.approx(balls.areas()[found.views < 2].sum() / balls.area())
    assert summary["beyond_projectors"] == 1.0


def test_what_lies_beyond_a_picture_is_not_seen():
    camera = camera_at((0.0, -0.001, 5.0), focal=100.0, size=(20, 20))  # sees half a unit to each side
    mesh = TriangleMesh(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [1.0, 0, 0], [1.1, 0, 0], [1.0, 0.1, 0]]), [[0, 1, 2], [3, 4, 5]])
    assert surveyed(mesh, [Shot(camera)]).views.tolist() == [1, 0]


def parallel(x: float, height: float, focal: float) -> Camera:
    """A camera at ``height`` above the plate that looks straight down."""
    R = np.diag((1.0, -1.0, -1.0))
    return Camera([[focal, 0, 159.5], [0, focal, 119.5], [0, 0, 1]], R, -R @ (x, 0.0, height), (320, 240))


def test_the_error_of_two_cameras_is_that_of_the_disparity():
    height, base, focal, pixel_error = 4.0, 0.2, 300.0, 0.3
    mesh = plate(half=0.01)
    for devices in ([Shot(parallel(side * base / 2, height, focal)) for side in (-1, 1)],
                    [Shot(parallel(-base / 2, height, focal), projectors=(parallel(base / 2, height, focal),))]):
        error = surveyed(mesh, devices, pixel_error=pixel_error).depth_error
        assert error == pytest.approx(np.sqrt(2) * pixel_error * height ** 2 / (focal * base), rel=0.01)


def test_the_error_of_a_laser_is_the_footprint_over_the_sine():
    height, focal, pixel_error, angle = 5.0, 400.0, 0.1, np.radians(25)
    sheet = Sheet(height * np.array([np.sin(angle), 0.0, np.cos(angle)]), np.array([0.0, 1.0, 0.0]))
    error = surveyed(plate(half=0.005), [Shot(parallel(0.0, height, focal), sheets=(sheet,))], pixel_error=pixel_error).depth_error
    # Along the sheet, at the angle to the normal: only this share of the error is along the normal.
    assert error == pytest.approx(np.cos(angle) * pixel_error * height / focal / np.sin(angle), rel=0.01)


def test_one_camera_knows_no_depth_and_neither_do_two_in_one_place():
    mesh = plate(half=0.1)
    for shots in ([Shot(parallel(0.0, 4.0, 300.0))], [Shot(parallel(0.0, 4.0, 300.0))] * 2, []):
        found = surveyed(mesh, shots)
        assert np.isinf(found.depth_error).all() and found.summary()["median_depth_error"] is None


def test_a_passive_rig_matches_neighbours_and_no_others():
    """More views of the same kind do not measure better, and views that are too far apart do not measure at all."""
    def ring(*angles):
        return [Shot(camera_at((4 * np.sin(angle), 0.0, 4 * np.cos(angle)), (0, 0, 0), focal=300.0)) for angle in np.radians(angles)]

    mesh = plate(half=0.01)
    pairs = np.array([surveyed(mesh, ring(start, start + 20)).depth_error for start in (-50, -30, -10, 10, 30)])
    assert np.isfinite(pairs).all()
    many = surveyed(mesh, ring(-50, -30, -10, 10, 30, 50))
    assert not many.active and many.depth_error == pytest.approx(pairs.min(axis=0))
    assert np.isinf(surveyed(mesh, ring(-20, 20)).depth_error).all()


def test_an_active_rig_measures_within_a_shot():
    """The same point seen from two sides is not measured where each side lacks its light."""
    shots = [Shot(parallel(-1.0, 4.0, 300.0)), Shot(parallel(1.0, 4.0, 300.0), projectors=(parallel(50.0, 4.0, 300.0),))]
    assert np.isinf(surveyed(plate(half=0.1), shots).depth_error).all()


def test_the_density_of_projector_pixels_counts_them():
    projector = camera_at((0.5, -3.0, 4.0), (0.2, 0.1, 0.0), focal=500.0, size=(400, 300))
    mesh = plate(half=0.05)
    found = surveyed(mesh, [Shot(parallel(0.0, 4.0, 300.0), projectors=(projector,))]).projector_pixels
    corners = projector.project(mesh.vertices)[0]
    x, y = corners.T
    area = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    assert found == pytest.approx(area / mesh.area(), rel=0.03)


def test_places_are_remembered_only_while_they_are_used(balls):
    surveyor = Surveyor(balls, balls.corners())
    one, two = ([Shot(camera) for camera in ring(count, distance=6, focal=120)] for count in (2, 3))
    first = surveyor.coverage(one)
    assert (surveyor.coverage(two).views == surveyed(balls, two).views).all()
    assert (surveyor.coverage(one).views == first.views).all()
    assert len(surveyor._sights) == 2
