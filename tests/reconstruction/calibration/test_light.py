# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The light from pencils' shadows: exact from exact marks, and within the bounds of a simulation from others."""

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.calibration.laser import on_plane
from addon.reconstruction.calibration.light import intersect_lines, light_from_pencils
from addon.reconstruction.geometry import Camera, look_at

R, T = look_at((0.1, -0.5, 0.6), (0.05, 0.05, 0.0))
CAMERA = Camera([[1100, 0, 640], [0, 1100, 480], [0, 0, 1]], R, T, (1280, 960), (-0.1, 0.03, 0.001, 0, 0))
LAMP, HEIGHT = np.array([-0.5, 0.6, 0.9]), 0.1
BASES = np.array([[x, y, 0.0] for x in (-0.05, 0.05, 0.15) for y in (0.0, 0.1)])


def shadow_of(bases, lamp, height):
    """Return the (n, 3) shadows of the tips on the plane z = 0, by similar triangles."""
    tips = bases + (0, 0, height)
    return lamp + (tips - lamp) * lamp[2] / (lamp[2] - height)


def marks(lamp=LAMP, bases=BASES, height=HEIGHT, camera=CAMERA):
    return camera.project(bases)[0], camera.project(shadow_of(bases, lamp, height))[0]


def test_exact_marks_give_the_light():
    found = light_from_pencils(CAMERA, *marks(), HEIGHT)
    np.testing.assert_allclose(found.position, LAMP, atol=1e-6)
    assert found.rms < 1e-3 and not found.warnings


def test_a_board_that_looks_the_other_way_has_its_light_at_negative_z():
    flipped = CAMERA.moved(np.diag([1.0, -1, -1, 1]))  # z into the desk
    found = light_from_pencils(flipped, *marks(), HEIGHT)
    np.testing.assert_allclose(found.position, LAMP * (1, -1, -1), atol=1e-6)


def test_six_pencils_with_noise_give_the_light_to_two_per_cent():
    """A simulation of 0.2 mm on the board's points has 95 % of its errors below 1.5 % of the lamp's distance, 1.16 m."""
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        shadows = shadow_of(BASES, LAMP, HEIGHT)
        noisy = [CAMERA.project(points + np.append(rng.normal(0, 0.2e-3, (6, 2)), np.zeros((6, 1)), axis=1))[0] for points in (BASES, shadows)]
        errors.append(np.linalg.norm(light_from_pencils(CAMERA, *noisy, HEIGHT).position - LAMP))
    assert np.quantile(errors, 0.95) < 0.02 * np.linalg.norm(LAMP)
    assert np.median(errors) > 1e-4  # the noise did reach it


def test_lines_that_hardly_meet_are_said_so():
    found = light_from_pencils(CAMERA, *marks(LAMP * 20, BASES[:2] * 0.3), HEIGHT)
    assert len(found.warnings) == 1 and found.warnings[0].startswith("the lines from shadows to pencils are nearly parallel")


def test_lines_meet_at_the_point_nearest_to_all():
    rng = np.random.default_rng(2)
    points, directions = rng.random((5, 3)), rng.normal(size=(5, 3))

    def squares(place):
        return (np.cross(place - points, directions / np.linalg.norm(directions, axis=1, keepdims=True)) ** 2).sum()

    found, condition = intersect_lines(points, directions)
    assert all(squares(found) < squares(found + step) for step in 1e-3 * np.concatenate((np.eye(3), -np.eye(3))))
    assert 1 < condition < 100


def test_marks_that_give_no_light_are_refused():
    bases, shadows = marks()
    with pytest.raises(ScanstageError, match="^the light: 1 pencils and 1 shadows are marked; mark as many of each, at least 2"):
        light_from_pencils(CAMERA, bases[:1], shadows[:1], HEIGHT)
    with pytest.raises(ScanstageError, match="^the light: the lines .* meet in no point above them"):
        light_from_pencils(CAMERA, *marks(np.array([0.05, 0.05, -0.4])), HEIGHT)  # they meet below the desk
    level = Camera(CAMERA.K, *look_at((0, -1, 0.2), (0, 0, 0.2)), CAMERA.size)
    with pytest.raises(ScanstageError, match=r"^pixel \(640, 100\) does not show the board's plane"):
        on_plane(level, [[640, 900], [640, 100]])
