# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Small surfaces, and a Blender with nothing in it."""

import numpy as np
import pytest

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume


@pytest.fixture
def grid():
    """Return a grid with unequal sides, off the origin, so that swapped axes or a lost origin show."""
    return VoxelGrid((0.3, -0.7, 0.1), 0.25, (4, 3, 5))


@pytest.fixture
def corner(grid):
    """Return an L of three voxels: 14 faces, and no symmetry to hide behind."""
    occupancy = np.zeros(grid.shape, bool)
    occupancy[1, 0, 2] = occupancy[2, 0, 2] = occupancy[2, 1, 2] = True
    return extract_surface(SparseVolume.from_dense(grid, occupancy))


@pytest.fixture
def ball():
    """Return the grid and the surface of a ball of radius 0.9 in the cube from -1 to 1, in 24 voxels a side."""
    ball_grid = VoxelGrid((-1, -1, -1), 2 / 24, (24, 24, 24))
    centres = ball_grid.centres(np.indices(ball_grid.shape).reshape(3, -1).T)
    inside = (np.linalg.norm(centres, axis=1) < 0.9).reshape(ball_grid.shape)
    return ball_grid, extract_surface(SparseVolume.from_dense(ball_grid, inside))
