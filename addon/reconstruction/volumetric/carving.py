# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A sparse volume that voxels can be taken out of, and that knows what this exposes.

A voxel is one integer, its key: the bits of x, y and z side by side. Its neighbours are sums, sets of voxels sort and
compare as integers, and a voxel's place in its brick is a few shifts away. Bricks are those of `SparseVolume`; a full
one is stored only once something in it changes, so that memory follows the surface.
"""

from __future__ import annotations

import numpy as np

from ..geometry import VoxelGrid
from .volume import BRICK, EMPTY, FULL, SparseVolume

OCCUPIED, QUEUED = np.uint8(1), np.uint8(2)
_ROOM = BRICK  # voxels of empty space about the grid, so that neighbours need no bounds
_CELLS = BRICK ** 3
_NOTHING, _SOLID = 0, 1  # the shared rows of all empty and all full bricks


class Carving:
    """A volume that is being carved.

    Parameters
    ----------
    volume : SparseVolume
        What to begin with; it is not changed.

    Attributes
    ----------
    grid : VoxelGrid
    neighbours : (6,) int64 array
        What to add to a key for its neighbour in -x, +x, -y, +y, -z, +z.
    """

    def __init__(self, volume: SparseVolume) -> None:
        self.grid: VoxelGrid = volume.grid
        bricks = np.array(volume.brick_map.shape) + 2
        self._bits = [int(n - 1).bit_length() + 3 for n in bricks]  # of x, y and z in a key
        _, y, z = self._bits
        self._shift = y + z, z
        self.neighbours = np.array([step * sign for step in (1 << (y + z), 1 << z, 1) for sign in (-1, 1)], np.int64)
        rows = np.where(volume.brick_map >= 0, volume.brick_map + 2, np.where(volume.brick_map == FULL, _SOLID, _NOTHING))
        self._map = np.zeros((bricks[0], 1 << (y - 3), 1 << (z - 3)), np.int32)
        self._map[tuple(slice(1, 1 + n) for n in rows.shape)] = rows
        self._used = len(volume.bricks) + 2
        self._cells = np.zeros((self._used + 64, _CELLS), np.uint8)
        self._cells[_SOLID] = OCCUPIED
        self._cells[2:self._used] = volume.bricks.reshape(-1, _CELLS)

    def keys(self, voxels: np.ndarray) -> np.ndarray:
        """Return the (n,) int64 keys of voxels (n, 3), which may lie up to `BRICK` beyond the grid."""
        x, y, z = np.asarray(voxels, np.int64).T + _ROOM
        return x << self._shift[0] | y << self._shift[1] | z

    def voxels(self, keys: np.ndarray) -> np.ndarray:
        """Return the (n, 3) int32 indices of voxels given by their keys."""
        out = np.empty((len(keys), 3), np.int32)
        out[:, 0] = keys >> self._shift[0]
        out[:, 1] = keys >> self._shift[1] & (1 << self._bits[1]) - 1
        out[:, 2] = keys & (1 << self._bits[2]) - 1
        out -= _ROOM
        return out

    def occupied(self, keys: np.ndarray) -> np.ndarray:
        """Return (n,) bool: which voxels are there still."""
        return (self._state(keys) & OCCUPIED) != 0

    def queued(self, keys: np.ndarray) -> np.ndarray:
        """Return (n,) bool: which voxels are there still and are enqueued."""
        return (self._state(keys) & QUEUED) != 0

    def nothing_near(self, keys: np.ndarray) -> np.ndarray:
        """Return (n,) bool: which voxels lie in a brick that was empty from the beginning."""
        return self._map.ravel().take(self._places(keys)[0]) == _NOTHING

    def remove(self, keys: np.ndarray) -> None:
        """Take voxels out."""
        self._set(keys, np.uint8(0))

    def enqueue(self, keys: np.ndarray) -> np.ndarray:
        """Return those of the keys whose voxels are occupied and were not enqueued before; each must be given once."""
        fresh = keys[self._state(keys) == OCCUPIED]
        self._set(fresh, OCCUPIED | QUEUED)
        return fresh

    def exposed_by(self, removed: np.ndarray) -> np.ndarray:
        """Return the neighbours of removed voxels that are enqueued by this call, each once."""
        return np.concatenate([self.enqueue(removed + step) for step in self.neighbours])

    def forget(self) -> None:
        """Empty the queue: every voxel can be enqueued again."""
        self._cells[:self._used] &= OCCUPIED

    def exposure(self, keys: np.ndarray) -> np.ndarray:
        """Return the (n, 3) float32 means of the outward normals of the voxels' exposed faces; 0 where they cancel."""
        free = [~self.occupied(keys + step) for step in self.neighbours]
        total = np.stack([free[2 * axis + 1].astype(np.float32) - free[2 * axis] for axis in range(3)], axis=1)
        return total / np.maximum(np.sum(free, axis=0, dtype=np.float32), 1)[:, None]

    def surface_keys(self) -> np.ndarray:
        """Return the keys of all voxels with an exposed face, sorted."""
        solid = np.argwhere(self._map == _SOLID)
        inner = np.logical_and.reduce([self._map[tuple((solid + step).T)] == _SOLID
                                       for step in np.concatenate((np.eye(3, dtype=int), -np.eye(3, dtype=int)))])
        mixed = np.argwhere(self._map > _SOLID)
        found = []
        for bricks in np.array_split(np.concatenate((solid[~inner], mixed)), max(1, (len(solid) + len(mixed)) // 512)):
            place, cell = np.nonzero(self._cells[self._map[tuple(bricks.T)]] & OCCUPIED)
            voxels = bricks[place] * BRICK + np.stack(np.unravel_index(cell, (BRICK,) * 3), -1) - _ROOM
            keys = self.keys(voxels)
            hidden = np.logical_and.reduce([self.occupied(keys + step) for step in self.neighbours])
            found.append(keys[~hidden])
        return np.sort(np.concatenate(found))

    def frozen(self) -> SparseVolume:
        """Return the volume as it is now."""
        rows = self._map[tuple(slice(1, 1 - n // -BRICK) for n in self.grid.shape)]
        left = (self._cells[:self._used] & OCCUPIED).any(axis=1)
        mixed = (rows > _SOLID) & left[rows]
        brick_map = np.where(rows == _SOLID, FULL, EMPTY).astype(np.int32)
        brick_map[mixed] = np.arange(np.count_nonzero(mixed), dtype=np.int32)
        return SparseVolume(self.grid, brick_map, (self._cells[rows[mixed]] & OCCUPIED).astype(bool).reshape(-1, BRICK, BRICK, BRICK))

    def _places(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return each voxel's brick, as a flat index into the map, and its cell in the brick."""
        (_, y, z), (high, low) = self._bits, self._shift
        brick = keys >> (high + 3) << (y - 3) | keys >> (low + 3) & (1 << (y - 3)) - 1
        brick = brick << (z - 3) | keys >> 3 & (1 << (z - 3)) - 1
        return brick, (keys >> high & 7) << 6 | (keys >> low & 7) << 3 | keys & 7

    def _state(self, keys: np.ndarray) -> np.ndarray:
        brick, cell = self._places(keys)
        cell |= self._map.ravel().take(brick).astype(np.int64) << 9
        return self._cells.ravel().take(cell)

    def _set(self, keys: np.ndarray, state: np.uint8) -> None:
        brick, cell = self._places(keys)
        rows = self._map.ravel()
        shared = rows.take(brick) <= _SOLID
        if shared.any():
            self._own(np.unique(brick[shared]))
        self._cells.ravel()[rows.take(brick).astype(np.int64) << 9 | cell] = state

    def _own(self, bricks: np.ndarray) -> None:
        """Give bricks cells of their own."""
        need = self._used + len(bricks)
        if need > len(self._cells):
            self._cells = np.concatenate((self._cells, np.zeros((need, _CELLS), np.uint8)))
        rows = self._map.ravel()
        fresh = np.arange(self._used, need, dtype=np.int32)
        self._cells[fresh] = self._cells[rows[bricks]]
        rows[bricks] = fresh
        self._used = need
