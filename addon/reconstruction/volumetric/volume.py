# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A set of voxels whose memory follows its surface, not its volume.

The grid is cut into bricks of 8x8x8 voxels. A brick is empty, full, or mixed; only mixed bricks store their voxels.
At 1024^3 a reconstructed object has some 40,000 mixed bricks: 20 MB, where a dense array would be 1 GiB.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..geometry import VoxelGrid

BRICK = 8
EMPTY, FULL = -1, -2


@dataclass(frozen=True)
class SparseVolume:
    """Occupied voxels of a grid.

    Parameters
    ----------
    grid : VoxelGrid
    brick_map : (bx, by, bz) int32 array
        One entry a brick: ``EMPTY``, ``FULL``, or its row in ``bricks``. The map covers the grid, rounded up to whole
        bricks; a brick that reaches beyond the grid is never ``FULL``.
    bricks : (m, 8, 8, 8) bool array
        The voxels of the mixed bricks, False beyond the grid.
    """

    grid: VoxelGrid
    brick_map: np.ndarray
    bricks: np.ndarray

    @classmethod
    def from_dense(cls, grid: VoxelGrid, occupancy: np.ndarray) -> SparseVolume:
        """Store a dense bool array of the grid's shape.

        Raises
        ------
        ValueError
            The array has another shape.
        """
        if occupancy.shape != grid.shape:
            raise ValueError(f"occupancy has the shape {occupancy.shape}, the grid {grid.shape}")
        return cls.from_slabs(grid, (occupancy[x:x + BRICK] for x in range(0, grid.shape[0], BRICK)))

    @classmethod
    def from_voxels(cls, grid: VoxelGrid, voxels: np.ndarray) -> SparseVolume:
        """Store the voxels with the (n, 3) integer indices, each given at most once."""
        nothing = cls(grid, np.full(brick_counts(grid), EMPTY, np.int32), np.zeros((0, BRICK, BRICK, BRICK), bool))
        return nothing.updated(voxels, np.ones(len(voxels), bool))

    @classmethod
    def from_slabs(cls, grid: VoxelGrid, slabs: Iterator[np.ndarray]) -> SparseVolume:
        """Store consecutive slabs of 8 layers in x (the last may be thinner), without ever holding the whole array."""
        bx, by, bz = brick_counts(grid)
        brick_map = np.full((bx, by, bz), EMPTY, np.int32)
        bricks, total = [np.zeros((0, BRICK, BRICK, BRICK), bool)], 0
        for row, slab in zip(range(bx), slabs, strict=True):
            padded = np.zeros((BRICK, by * BRICK, bz * BRICK), bool)
            padded[:slab.shape[0], :slab.shape[1], :slab.shape[2]] = slab
            cells = padded.reshape(BRICK, by, BRICK, bz, BRICK).transpose(1, 3, 0, 2, 4)
            full, some = cells.all(axis=(2, 3, 4)), cells.any(axis=(2, 3, 4))
            mixed = some & ~full
            brick_map[row][full] = FULL
            brick_map[row][mixed] = total + np.arange(np.count_nonzero(mixed), dtype=np.int32)
            bricks.append(cells[mixed])
            total += len(bricks[-1])
        return cls(grid, brick_map, np.concatenate(bricks))

    @classmethod
    def joined(cls, grid: VoxelGrid, parts: Iterable[tuple[np.ndarray, SparseVolume]]) -> SparseVolume:
        """Put together volumes of parts of the grid, each with its lower corner in voxels: multiples of 8. What no part covers is empty."""
        brick_map, bricks, total = np.full(brick_counts(grid), EMPTY, np.int32), [np.zeros((0, BRICK, BRICK, BRICK), bool)], 0
        for corner, part in parts:
            at = np.asarray(corner) // BRICK
            rows = np.where(part.brick_map >= 0, part.brick_map + total, part.brick_map)
            brick_map[tuple(slice(a, a + n) for a, n in zip(at, rows.shape, strict=True))] = rows
            bricks.append(part.bricks)
            total += len(part.bricks)
        mixed = brick_map >= 0  # rows in the order of the map, whatever the order of the parts
        order = brick_map[mixed]
        brick_map[mixed] = np.arange(len(order), dtype=np.int32)
        return cls(grid, brick_map, np.concatenate(bricks)[order])

    def slabs(self) -> Iterator[np.ndarray]:
        """Yield the dense volume in slabs of 8 layers in x: (8 or fewer, ny, nz) bool."""
        nx, ny, nz = self.grid.shape
        _, by, bz = self.brick_map.shape
        for row in range(len(self.brick_map)):
            slab = self._dense_rows(slice(row, row + 1)).reshape(BRICK, by * BRICK, bz * BRICK)
            yield slab[:nx - row * BRICK, :ny, :nz]

    def dense(self) -> np.ndarray:
        """Return the dense (nx, ny, nz) bool array."""
        nx, ny, nz = self.grid.shape
        return self._dense_rows(slice(None))[:nx, :ny, :nz]

    def _dense_rows(self, rows: slice) -> np.ndarray:
        brick_map = self.brick_map[rows]
        bx, by, bz = brick_map.shape
        out = np.zeros((bx, BRICK, by, BRICK, bz, BRICK), bool)
        cells = out.transpose(0, 2, 4, 1, 3, 5)
        cells[brick_map == FULL] = True
        mixed = brick_map >= 0
        cells[mixed] = self.bricks[brick_map[mixed]]
        return out.reshape(bx * BRICK, by * BRICK, bz * BRICK)

    def count(self) -> int:
        """Return the number of occupied voxels."""
        return int(np.count_nonzero(self.brick_map == FULL)) * BRICK ** 3 + int(np.count_nonzero(self.bricks))

    def volume(self) -> float:
        """Return the occupied volume in the cube of the scene's unit."""
        return self.count() * self.grid.voxel_size ** 3

    def contains(self, voxels: np.ndarray) -> np.ndarray:
        """Return (n,) bool: whether the voxels with the (n, 3) integer indices are occupied; False beyond the grid."""
        voxels = np.asarray(voxels)
        inside = ((voxels >= 0) & (voxels < np.array(self.grid.shape))).all(axis=-1)
        x, y, z = np.where(inside[:, None], voxels, 0).T
        row = self.brick_map[x // BRICK, y // BRICK, z // BRICK]
        occupied = row == FULL
        mixed = row >= 0
        occupied[mixed] = self.bricks[row[mixed], x[mixed] % BRICK, y[mixed] % BRICK, z[mixed] % BRICK]
        return occupied & inside

    def without(self, voxels: np.ndarray) -> SparseVolume:
        """Return the volume less the voxels (n, 3), each given at most once."""
        return self.updated(voxels, np.zeros(len(voxels), bool))

    def updated(self, voxels: np.ndarray, occupied: np.ndarray) -> SparseVolume:
        """Return the volume with other contents of the voxels (n, 3), each given at most once: (n,) bool."""
        voxels = np.asarray(voxels)
        flat = np.ravel_multi_index((voxels // BRICK).T, self.brick_map.shape)
        touched, place = np.unique(flat, return_inverse=True)
        brick_map = self.brick_map.copy()
        rows = brick_map.ravel()[touched]
        cells = np.zeros((len(touched), BRICK, BRICK, BRICK), bool)
        cells[rows == FULL] = True
        cells[rows >= 0] = self.bricks[rows[rows >= 0]]
        cells[place.ravel(), *(voxels % BRICK).T] = occupied
        brick_map.ravel()[touched] = np.where(cells.any(axis=(1, 2, 3)), FULL, EMPTY)
        kept = brick_map >= 0
        mixed = cells.any(axis=(1, 2, 3)) & ~cells.all(axis=(1, 2, 3))
        bricks = np.concatenate((self.bricks[brick_map[kept]], cells[mixed]))
        brick_map[kept] = np.arange(np.count_nonzero(kept))
        brick_map.ravel()[touched[mixed]] = np.arange(np.count_nonzero(kept), len(bricks))
        return SparseVolume(self.grid, brick_map, bricks)

    def bounds(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the lowest and the highest occupied voxel index, or None if there is none."""
        if not self.count():
            return None
        where = np.argwhere(self.brick_map == FULL) * BRICK
        lower, upper = [where], [where + BRICK - 1]
        corner = np.argwhere(self.brick_map >= 0) * BRICK
        bricks = self.bricks[self.brick_map[self.brick_map >= 0]]
        corner, bricks = corner[bricks.any(axis=(1, 2, 3))], bricks[bricks.any(axis=(1, 2, 3))]
        for axis in range(3):
            line = bricks.any(axis=tuple(a for a in (1, 2, 3) if a != axis + 1))
            low, high = corner.copy(), corner.copy()
            low[:, axis] += line.argmax(axis=1)
            high[:, axis] += BRICK - 1 - line[:, ::-1].argmax(axis=1)
            high[:, [a for a in range(3) if a != axis]] = -1
            low[:, [a for a in range(3) if a != axis]] = np.iinfo(np.int32).max
            lower.append(low)
            upper.append(high)
        return np.concatenate(lower).min(axis=0), np.concatenate(upper).max(axis=0)


def brick_counts(grid: VoxelGrid) -> tuple[int, int, int]:
    """Return how many bricks cover the grid along x, y, z."""
    return tuple(-(-n // BRICK) for n in grid.shape)
