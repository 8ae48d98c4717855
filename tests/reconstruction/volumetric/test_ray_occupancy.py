# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The posterior along a ray is Bayes' rule over all ways in which its voxels may be occupied."""

from itertools import product

import numpy as np
import pytest

from addon.reconstruction.volumetric.ray_occupancy import ray_messages


def enumerated(occupancy, density, beyond):
    """Return the posterior of each voxel of one ray from all 2^M states of its voxels."""
    total, occupied = 0.0, np.zeros(len(occupancy))
    for state in product((0, 1), repeat=len(occupancy)):
        state = np.array(state, bool)
        probability = np.prod(np.where(state, occupancy, 1 - occupancy))
        joint = probability * (density[state.argmax()] if state.any() else beyond)
        total += joint
        occupied[state] += joint
    return occupied / total


def test_two_voxels_by_hand():
    occupancy, first = np.array([0.3, 0.6]), np.array([True, False])
    found = ray_messages(occupancy, np.array([2.0, 5.0]), np.array([0.7, 0.7]), first)
    # p(I) = 0.3 * 2 + 0.7 * 0.6 * 5 + 0.7 * 0.4 * 0.7 = 2.896; given the second voxel it is 0.3 * 2 + 0.7 * 5 = 4.1
    np.testing.assert_allclose(found.posterior(occupancy), [0.3 * 2 / 2.896, 0.6 * 4.1 / 2.896], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.empty, [0.6 * 5 + 0.4 * 0.7, 0.3 * 2 + 0.7 * 0.7], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.visibility, [1.0, 0.7], rtol=0, atol=1e-12)


def test_many_rays_are_each_what_enumeration_gives():
    rng = np.random.default_rng(1)
    lengths = rng.integers(1, 9, 40)
    first = np.concatenate([np.arange(n) == 0 for n in lengths])
    occupancy, density = rng.uniform(0.001, 0.999, len(first)), rng.gamma(0.3, 5, len(first)) + 1e-6
    beyond = np.repeat(rng.uniform(0.01, 2, len(lengths)), lengths)
    found = ray_messages(occupancy, density, beyond, first).posterior(occupancy)
    ends = np.cumsum(lengths)
    expected = np.concatenate([enumerated(occupancy[a:b], density[a:b], beyond[a]) for a, b in zip(ends - lengths, ends, strict=True)])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_a_ray_that_all_voxels_explain_equally_well_tells_nothing():
    occupancy, first = np.full(6, 0.4), np.arange(6) == 0
    found = ray_messages(occupancy, np.full(6, 3.0), np.full(6, 3.0), first)
    np.testing.assert_allclose(found.posterior(occupancy), occupancy, rtol=0, atol=1e-12)


@pytest.mark.parametrize("occupancy", [0.001, 0.999])
def test_long_rays_of_extreme_probabilities_stay_between_zero_and_one(occupancy):
    n = 4000
    prior = np.full(n, occupancy)
    density = np.where(np.arange(n) % 7 == 3, 1e3, 1e-9)
    found = ray_messages(prior, density, np.full(n, 1e-3), np.arange(n) % 500 == 0)
    posterior = found.posterior(prior)
    assert np.isfinite(posterior).all() and (posterior >= 0).all() and (posterior <= 1).all()


def test_no_voxels():
    found = ray_messages(*[np.zeros(0)] * 3, np.zeros(0, bool))
    assert len(found.occupied) == len(found.empty) == len(found.visibility) == 0
