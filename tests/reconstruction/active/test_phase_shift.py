# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases: their noise is the formula's, no period is mistaken, and they are finer than a Gray code."""

import numpy as np
import pytest

from addon.reconstruction.active.correspondence import Decoded, Reason
from addon.reconstruction.active.decoding import decode_view
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.phase_shift import fit_phase, unwrap_by_frequencies, unwrap_by_position
from tests.projection import projected_view, sight

RANDOM = np.random.default_rng(11)
PHASE = RANDOM.uniform(0, 2 * np.pi, (200, 250))


def waves(phase, steps, *, amplitude=80.0, offset=120.0, noise=0.0):
    """Return pictures from 0 to 1 of numbers that are shares of 255."""
    return [(offset + amplitude * np.cos(phase - 2 * np.pi * step / steps) + RANDOM.normal(0, noise, phase.shape)) / 255 for step in range(steps)]


def rounded(images):
    return [np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8) for image in images]


def turned(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_phase_and_amplitude_come_back(steps):
    fitted = fit_phase(waves(PHASE, steps), steps)
    assert np.abs(turned(fitted.phase - PHASE)).max() < 2e-4  # OpenCV's arc tangent
    np.testing.assert_allclose(fitted.amplitude, 80 / 255, rtol=1e-4)


@pytest.mark.parametrize("steps", [3, 4, 8])
def test_noise_of_the_phase_is_that_of_the_formula(steps):
    """Issue figure: within 5 % of ``sigma_I / B sqrt(2 / N)``; 50,000 pixels know a deviation to 0.3 %."""
    fitted = fit_phase(waves(PHASE, steps, noise=2.0), steps)
    measured = np.sqrt(np.mean(turned(fitted.phase - PHASE) ** 2))
    assert measured == pytest.approx(2.0 / 80 * np.sqrt(2 / steps), rel=0.05)


@pytest.mark.parametrize("steps", [4, 5, 8, 16])
def test_noise_is_found_from_what_the_sinusoids_leave(steps):
    images = rounded(waves(PHASE, steps, noise=3.0))
    assert fit_phase(images, steps).noise(0.02) == pytest.approx(np.hypot(3.0, 1 / np.sqrt(12)), rel=0.05)
    assert fit_phase(images[:3], 3).noise(0.02) is None


def test_where_phase_and_gray_code_turn_over_apart_no_period_is_mistaken():
    """The code's borders and the phase's are shifted against each other by up to half a period less a pixel."""
    length, period = 512, 16.0
    column = RANDOM.uniform(0, length - 1, (300, 400))
    fitted = fit_phase(waves(2 * np.pi * column / period, 4, noise=2.0), 4)
    for shift in (-7.0, -3.0, 0.0, 3.0, 7.0):
        coarse = Decoded((column + shift).astype(np.float32), np.zeros(column.shape, np.uint8), 1.0)
        found = unwrap_by_position(fitted, period, coarse, noise=2.0 / 255, length=length)
        assert np.abs(found.position - column)[found.valid].max() < 0.5
        assert found.valid.mean() > 0.99
    assert found.sigma.mean() == pytest.approx(period / (2 * np.pi) * 2 / 80 * np.sqrt(0.5), rel=0.02)


def test_frequencies_tell_the_periods_apart_from_the_first_column_to_the_last():
    length = 1000
    column = RANDOM.uniform(-0.5, length - 0.5, (200, 300))
    periods = [1125.0, 260.0, 61.0, 16.0]
    phases = [(period, fit_phase(waves(2 * np.pi * column / period, 4, noise=2.0), 4)) for period in periods]
    found = unwrap_by_frequencies(phases, noise=2.0 / 255, length=length)
    assert np.abs(found.position - column)[found.valid].max() < 0.5 and found.valid.mean() > 0.999


def test_frequencies_too_far_apart_for_the_noise_are_not_believed():
    column = RANDOM.uniform(0, 999, (50, 60))
    phases = [(period, fit_phase(waves(2 * np.pi * column / period, 4, noise=20.0), 4)) for period in (1125.0, 16.0)]
    found = unwrap_by_frequencies(phases, noise=20.0 / 255, length=1000)
    assert not found.valid.any()


def test_saturated_and_dark_pixels_say_so():
    images = rounded(waves(PHASE, 4, amplitude=140.0))
    coarse = Decoded((PHASE * 16 / (2 * np.pi)).astype(np.float32), np.zeros(PHASE.shape, np.uint8), 1.0)
    found = unwrap_by_position(fit_phase(images, 4), 16.0, coarse, noise=1.0, length=16)
    clipped = np.max(images, axis=0) == 255
    assert clipped.any() and (found.reason[clipped] == Reason.SATURATED).all() and (found.reason[~clipped] == Reason.VALID).all()
    dark = fit_phase(rounded(waves(PHASE, 4, amplitude=1.0)), 4)
    assert (unwrap_by_position(dark, 16.0, coarse, noise=1.0, length=16).reason == Reason.UNLIT).all()


def test_four_steps_are_four_times_finer_than_the_gray_code(camera, projector, scene):
    """Issue figures: RMS of at most 0.06 projector pixels, and a quarter of the Gray code's."""
    truth = sight(camera, projector, scene)
    lit = truth.light > 0.4  # amplitudes from 51 of 255
    errors = {}
    for name in ("gray-code", "phase-shift"):
        patterns = make_patterns(name, projector.size, {"axes": "columns"})
        view = projected_view(camera, projector, patterns, scene, noise=2 / 255, levels=255, albedo=0.95)
        decoded = decode_view(view.projected, projector.size)["column"]
        errors[name] = (decoded.position - truth.pixels[..., 0])[decoded.valid & lit]
        assert len(errors[name]) > 0.99 * np.count_nonzero(lit)
    fine, coarse = (float(np.sqrt(np.mean(errors[name] ** 2))) for name in ("phase-shift", "gray-code"))
    assert fine <= 0.06 and coarse / fine >= 4
