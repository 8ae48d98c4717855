# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A depth sensor's dots: the code, the matching, and depths before exact walls."""

import dataclasses

import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.active.correspondence import Reason
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.speckle import STEPS, match_dots
from addon.reconstruction.active.speckle_code import speckle_image
from addon.reconstruction.methods import METHODS
from addon.reconstruction.scan import Scan
from tests import depth_sensors
from tests.projection import Round, projected_view
from tests.rigs import Ball, camera_at

FIELDS = {"kind": "speckle", "dot": 3, "density": 0.3, "seed": 1}


def test_the_dots_are_as_dense_as_asked_for_and_their_seed_is_their_name():
    image = speckle_image((1023, 768), FIELDS)
    assert image.shape == (768, 1023) and image.dtype == np.uint8
    assert abs((image[::3, ::3] > 0).mean() - 0.3) < 4 * np.sqrt(0.3 * 0.7 / (341 * 256))
    assert (image[:3, :3] == image[0, 0]).all()
    assert (image != speckle_image((1023, 768), {**FIELDS, "seed": 2})).any()


def test_no_window_looks_like_another_one_in_its_row():
    """methods.md 5.2: a second peak of the correlation is below 0.3 for the mean window, so that shifts are unique."""
    dots = speckle_image((192, 120), {**FIELDS, "dot": 2}).astype(np.float32)
    window = dots[40:58, 20:38]
    scores = cv2.matchTemplate(dots[40:58, 20:], window, cv2.TM_CCOEFF_NORMED)[0]
    assert scores[0] == pytest.approx(1, abs=1e-5)
    assert scores[3:].mean() < 0.3 and scores[3:].max() < 0.6


@pytest.mark.parametrize("shift", [3, 11.5, 20.25])
def test_a_shifted_picture_is_found_to_an_eighth_of_a_pixel(shift):
    fine = speckle_image((8 * 232, 8 * 60), {**FIELDS, "dot": 16}).astype(np.float32) / 255

    def seen(columns):  # a pixel takes in an area
        moved = np.roll(fine, round(8 * columns), axis=1)
        return cv2.resize(moved, (232, 60), interpolation=cv2.INTER_AREA)

    found = match_dots(0.1 + 0.5 * seen(shift)[:, 32:], seen(0), window=9, score=0.6, uniqueness=0.85, contrast=0.004)
    inside = (slice(8, -8), slice(8, -8))
    assert (found.reason[inside] == Reason.VALID).mean() > 0.98
    error = found.disparity[inside][found.reason[inside] == Reason.VALID] - shift
    assert np.abs(np.median(error)) <= 1 / STEPS and np.quantile(np.abs(error), 0.95) <= 2 / STEPS


@pytest.mark.parametrize("depth", [1.0, 3.0])
def test_depths_come_in_the_sensors_steps_and_fill_a_matte_wall(depth):
    found = depth_sensors.depth_sensor(depth)
    quantum = depth_sensors.QUANTUM * depth ** 2
    assert found.step == pytest.approx(quantum, rel=0.05)
    assert found.sigma <= 1.5 * quantum / 2  # scripts/figures.py has the target's 1.2 for more depths
    assert found.filled >= 0.97


def test_the_projectors_shadow_is_as_wide_as_the_formula_says():
    measured, formula = depth_sensors.sensor_shadow()
    assert abs(measured - formula) <= 2


def test_a_ball_comes_back_from_an_oblique_camera():
    camera = camera_at((0.0, -1.0, 0.2), focal=420.0, size=(320, 240))
    projector = camera_at((0.12, -1.0, 0.22), focal=560.0, size=(480, 360))
    view = projected_view(camera, projector, make_patterns("speckle", projector.size, {"dot": 3}), [Round(Ball((0.0, 0.0, 0.0), 0.2))],
                          samples=3, **depth_sensors.NOISE)
    cloud = METHODS["speckle"].measure(Scan((view,), np.array([[-0.3] * 3, [0.3] * 3]))).cloud
    error = np.linalg.norm(cloud.positions, axis=1) - 0.2
    assert len(cloud) > 10_000
    assert np.median(np.abs(error)) < 0.002  # an eighth of a pixel is 2.2 mm there


def test_a_pattern_that_drowns_is_reported():
    view = depth_sensors.wall_view(1.0, albedo=0.1, ambient=0.5)
    assert any("drown" in warning for warning in METHODS["speckle"].measure(Scan((view,), depth_sensors.box_about(1.0))).warnings)
    view = depth_sensors.wall_view(1.0)
    assert not METHODS["speckle"].measure(Scan((view,), depth_sensors.box_about(1.0))).warnings


def test_bad_input_is_one_sentence():
    view = depth_sensors.wall_view(1.0)
    with pytest.raises(ScanstageError, match="no frame of the capture was taken under dots"):
        METHODS["speckle"].measure(Scan((dataclasses.replace(view, projected=()),)))
    shot = dataclasses.replace(view.projected[0], pattern={**FIELDS, "density": "much"})
    with pytest.raises(ScanstageError, match=f"frame {shot.name}: its pattern's density"):
        METHODS["speckle"].measure(Scan((dataclasses.replace(view, projected=(shot,)),), depth_sensors.box_about(1.0)))
