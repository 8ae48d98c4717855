# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sparse volume is the dense array in another form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric.volume import BRICK, EMPTY, FULL, SparseVolume, brick_counts


@st.composite
def blocky(draw) -> np.ndarray:
    """Draw occupancies of any shape, of blocks that leave bricks empty, full or mixed, with a few voxels turned."""
    block = draw(st.sampled_from((1, 3, 8)))
    coarse = draw(hnp.arrays(bool, st.tuples(*[st.integers(1, 24 // block)] * 3)))
    occupancy = coarse.repeat(block, 0).repeat(block, 1).repeat(block, 2)
    shape = [draw(st.integers(max(1, n - block + 1), n)) for n in occupancy.shape]
    occupancy = occupancy[:shape[0], :shape[1], :shape[2]].copy()
    for _ in range(draw(st.integers(0, 3))):
        occupancy[tuple(draw(st.integers(0, n - 1)) for n in shape)] ^= True
    return occupancy


def sparse(occupancy: np.ndarray) -> SparseVolume:
    return SparseVolume.from_dense(VoxelGrid((-1.0, 0.5, 2.0), 0.25, occupancy.shape), occupancy)


@settings(max_examples=60, deadline=None)
@given(blocky())
def test_the_dense_array_comes_back(occupancy):
    volume = sparse(occupancy)
    np.testing.assert_array_equal(volume.dense(), occupancy)
    np.testing.assert_array_equal(np.concatenate(list(volume.slabs())), occupancy)
    assert volume.count() == occupancy.sum()
    assert volume.volume() == occupancy.sum() * 0.25 ** 3  # powers of two: exact


@settings(max_examples=60, deadline=None)
@given(blocky(), st.integers(0, 2 ** 32 - 1))
def test_contains_is_a_look_into_the_dense_array(occupancy, seed):
    voxels = np.random.default_rng(seed).integers(-9, max(occupancy.shape) + 9, (200, 3))
    padded = np.pad(occupancy, [(9, max(occupancy.shape) + 9)] * 3)
    np.testing.assert_array_equal(sparse(occupancy).contains(voxels), padded[tuple(voxels.T + 9)])


@settings(max_examples=60, deadline=None)
@given(blocky())
def test_bounds_are_the_first_and_last_occupied_voxels(occupancy):
    bounds = sparse(occupancy).bounds()
    where = np.argwhere(occupancy)
    if not len(where):
        assert bounds is None
    else:
        np.testing.assert_array_equal(bounds, [where.min(axis=0), where.max(axis=0)])


@settings(max_examples=60, deadline=None)
@given(blocky())
def test_only_mixed_bricks_are_stored_and_none_beyond_the_grid_is_full(occupancy):
    volume = sparse(occupancy)
    counts = brick_counts(volume.grid)
    padded = np.pad(occupancy, [(0, count * BRICK - n) for count, n in zip(counts, occupancy.shape, strict=True)])
    for brick in np.ndindex(*counts):
        cells = padded[tuple(slice(BRICK * b, BRICK * (b + 1)) for b in brick)]
        entry = volume.brick_map[brick]
        assert entry == EMPTY if not cells.any() else entry == FULL if cells.all() else entry >= 0
    assert sorted(volume.brick_map[volume.brick_map >= 0]) == list(range(len(volume.bricks)))


def test_another_shape_than_the_grids_is_refused():
    with pytest.raises(ValueError, match="shape"):
        SparseVolume.from_dense(VoxelGrid((0, 0, 0), 1.0, (4, 4, 4)), np.zeros((4, 4, 5), bool))


def test_slabs_must_be_as_many_as_the_grid_has():
    grid = VoxelGrid((0, 0, 0), 1.0, (20, 4, 4))
    with pytest.raises(ValueError):
        SparseVolume.from_slabs(grid, iter([np.zeros((8, 4, 4), bool)]))


def test_updated_voxels_are_what_a_dense_array_would_hold():
    rng = np.random.default_rng(8)
    grid = VoxelGrid((0, 0, 0), 1.0, (20, 16, 27))
    dense = rng.random(grid.shape) < 0.5
    dense[:8, :8, :8], dense[8:16, 8:16, 8:16] = True, False
    volume = SparseVolume.from_dense(grid, dense)
    for voxels, occupied in (
        (rng.permutation(np.argwhere(np.ones(grid.shape, bool)))[:3000], rng.random(3000) < 0.5),
        (np.argwhere(dense[:8, :8, :8]), np.zeros(512, bool)),  # a full brick becomes empty
        (np.argwhere(np.ones((8, 8, 8), bool)) + 8, np.ones(512, bool)),  # an empty one full
        (np.zeros((0, 3), int), np.zeros(0, bool)),
    ):
        expected = dense.copy()
        expected[tuple(voxels.T)] = occupied
        found = volume.updated(voxels, occupied)
        same = SparseVolume.from_dense(grid, expected)
        np.testing.assert_array_equal(found.dense(), expected)
        assert np.array_equal(np.minimum(found.brick_map, 0), np.minimum(same.brick_map, 0)) and len(found.bricks) == len(same.bricks)
