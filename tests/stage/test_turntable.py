# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The automatic distance: the object is inside every picture, and as large as that allows."""

import math

import numpy as np
import pytest

from addon.reconstruction.geometry import Camera, look_at
from addon.stage import readback, rig, staging


def least_border(points, lens, elevation, distance):
    """Return the least share of the picture between a turning object and each border, by brute force."""
    K = lens.K
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)[:, None]
    x, y, z = points.T
    turned = np.stack((x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle),
                       np.broadcast_to(z, (len(angle), len(z)))), axis=-1)
    R, t = look_at((0, -distance * math.cos(elevation), distance * math.sin(elevation)), (0, 0, 0))
    pixels, depth = Camera(K, R, t, lens.size).project(turned)
    assert (depth > 0).all()
    width, height = lens.size
    u, v = pixels[..., 0] + 0.5, pixels[..., 1] + 0.5
    return np.array([u.min() / width, 1 - u.max() / width, v.min() / height, 1 - v.max() / height])


@pytest.mark.parametrize("elevation", [-40, 0, 20, 85])
@pytest.mark.parametrize("size", [(640, 480), (300, 900)])
@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 0.2, 0.2), (0.1, 0.1, 2)])
def test_the_object_fills_the_picture_up_to_the_margin(elevation, size, shape):
    points = (np.random.default_rng(5).random((400, 3)) - 0.5) * shape
    lens = Camera([[700, 0, size[0] / 2 - 20], [0, 700, size[1] / 2 + 12], [0, 0, 1]], np.eye(3), np.zeros(3), size)
    elevation = math.radians(elevation)
    border = least_border(points, lens, elevation, rig.fitting_distance(lens, elevation, points))
    # The margin is 6 % of the picture where the axis is central; 72 tried angles of 720 leave 0.1 % of the radius.
    assert border.min() > 0.05
    assert border.min() < 0.075


def test_two_rings_share_the_distance_that_fits_both(empty_scene):
    staging.build(empty_scene, "turntable", "figure", {"views": 2, "elevations": "0,60", "focal_length": 85.0})
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    middle = np.array([0, 0, vertices[:, 2].max() / 2])
    distances = [np.linalg.norm(camera.centre - middle) for camera in plan.cameras.values()]
    assert distances[0] == pytest.approx(distances[1], rel=1e-5)
    for camera, elevation in zip(plan.cameras.values(), (0, 60), strict=True):
        assert least_border(vertices - middle, camera, math.radians(elevation), distances[0]).min() > 0.05


def test_a_given_distance_is_kept(empty_scene):
    staging.build(empty_scene, "turntable", "knot", {"views": 1, "distance": 0.75, "elevations": "0"})
    camera, = readback.plan_of(empty_scene).cameras.values()
    assert camera.centre[1] == pytest.approx(-0.75, abs=1e-6)


def test_elevations_are_read_as_degrees():
    assert rig.parse_elevations(" 10, 35.5,-5") == pytest.approx([math.radians(x) for x in (10, 35.5, -5)])
