# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A volume that is carved against a dense array that is carved in the same way."""

import numpy as np
import pytest

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric.carving import Carving
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume

STEPS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


def carved(shape, seed, fill):
    random = np.random.default_rng(seed)
    dense = random.random(shape) < fill
    return Carving(SparseVolume.from_dense(VoxelGrid((0, 0, 0), 1, shape), dense)), dense, random


@pytest.mark.parametrize("shape,fill", [((17, 9, 30), 1.1), ((8, 8, 8), 1.1), ((13, 25, 5), 0.4)])
def test_carving_is_that_of_a_dense_array(shape, fill):
    carving, dense, random = carved(shape, 1, fill)
    for _ in range(4):
        voxels = np.argwhere(random.random(shape) < 0.2)
        carving.remove(carving.keys(voxels))
        dense[tuple(voxels.T)] = False
        volume = carving.frozen()
        assert np.array_equal(volume.dense(), dense)
        everything = np.argwhere(np.ones(shape, bool))
        assert np.array_equal(carving.occupied(carving.keys(everything)), dense.ravel())
        surface = extract_surface(volume).voxels
        keys = carving.surface_keys()
        assert np.array_equal(keys, np.sort(carving.keys(surface)))
        assert np.array_equal(carving.keys(carving.voxels(keys)), keys)


def test_exposure_is_the_mean_normal_of_exposed_faces():
    carving, dense, _ = carved((9, 10, 11), 2, 0.6)
    voxels = np.argwhere(dense)
    padded = np.pad(dense, 1)
    expected = []
    for voxel in voxels:
        free = [step for step in STEPS if not padded[tuple(voxel + 1 + step)]]
        expected.append(np.mean(free, axis=0) if free else np.zeros(3))
    np.testing.assert_allclose(carving.exposure(carving.keys(voxels)), expected, atol=1e-6)


def test_what_a_removal_exposes_is_named_once_until_it_is_forgotten():
    carving, dense, _ = carved((12, 12, 12), 3, 1.1)
    removed = carving.keys(np.argwhere(dense)[[0, 1, 2, 700, 701, 900]])
    carving.remove(removed)
    exposed = carving.exposed_by(removed)
    around = np.unique((removed[:, None] + carving.neighbours).ravel())
    assert np.array_equal(np.sort(exposed), around[carving.occupied(around)])
    assert not len(carving.exposed_by(removed))
    assert carving.frozen().count() == dense.sum() - len(removed)
    carving.forget()
    assert len(carving.exposed_by(removed)) == len(exposed)


def test_full_bricks_are_stored_only_where_they_change():
    carving = Carving(SparseVolume.from_dense(VoxelGrid((0, 0, 0), 1, (64, 64, 64)), np.ones((64, 64, 64), bool)))
    carving.remove(carving.keys(np.array([[20, 20, 20], [21, 20, 20]])))
    assert len(carving.frozen().bricks) == 1
