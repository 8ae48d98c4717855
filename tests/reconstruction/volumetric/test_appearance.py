# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What other pictures predict of a sample is the integral over the voxel's unknown colour."""

import numpy as np
import pytest

from addon.reconstruction.volumetric.appearance import Evidence, Population, densities, predicted

POPULATION = Population(np.array([0.4, 0.5, 0.3]), 0.04)
RNG = np.random.default_rng(2)


def normal(x, mean, variance):
    return np.exp(-0.5 * (x - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance)


def test_a_density_is_the_integral_over_the_colours_that_the_other_samples_leave():
    samples, variance = RNG.uniform(0.3, 0.6, (4, 3)), np.array([0.002, 0.004, 0.001, 0.003])
    parts = [Evidence(samples[i:i + 1], variance[i:i + 1], np.ones(1)) for i in range(4)]
    moments = sum(part.moments() for part in parts)
    colors = np.linspace(-1, 2, 30001)  # of one channel; the likelihoods are narrower than 0.03 and wider than 1e-4
    expected = 1.0
    for channel in range(3):
        belief = normal(colors, POPULATION.mean[channel], POPULATION.variance)
        for i in (0, 1, 3):
            belief = belief * normal(samples[i, channel], colors, variance[i])
        expected *= (belief * normal(samples[2, channel], colors, variance[2])).sum() / belief.sum()
    assert densities(parts[2], moments, POPULATION)[0] == pytest.approx(expected, rel=1e-6)


def test_a_sample_does_not_explain_itself():
    sample = Evidence(np.array([[0.9, 0.1, 0.8]]), np.array([0.0004]), np.ones(1))
    alone = densities(sample, sample.moments(), POPULATION)
    nothing = densities(Evidence(sample.rgb, sample.variance, np.zeros(1)), np.zeros((1, 4)), POPULATION)
    np.testing.assert_allclose(alone, nothing, rtol=1e-9)


def test_many_samples_tell_the_colour():
    truth = np.array([0.7, 0.2, 0.5])
    rgb = truth + 0.05 * RNG.standard_normal((400, 3))
    moments = Evidence(rgb, np.full(400, 0.05 ** 2), np.ones(400)).moments().sum(axis=0, keepdims=True)
    mean, variance = predicted(moments, POPULATION)
    np.testing.assert_allclose(mean[0], truth, atol=4 * 0.05 / 20)  # four standard errors
    assert variance[0] == pytest.approx(0.05 ** 2 / 400, rel=0.01)


def test_a_population_leaves_the_noise_out():
    rgb = 0.5 + 0.2 * RNG.standard_normal((20000, 3))
    assert Population.of(rgb, 0.1).variance == pytest.approx(0.2 ** 2 - 0.1 ** 2, rel=0.03)
    assert 0 < Population.of(np.full((10, 3), 0.5), 0.1).variance < 1e-5
