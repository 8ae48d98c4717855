# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Carving by an octree whose work list is (cell, view) pairs (after Szeliski, 1993).

A cell is split only where some view cannot decide it, and a child is shown only to the views that could not decide its
parent: a view that saw the parent wholly inside its silhouette is never asked again. The work grows with the surface,
N^2, where testing every voxel grows with N^3. The result is that of testing every voxel, bit for bit.

Cells of one size are handled together, as arrays; the children of a parent are eight bits of one byte.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...progress import Progress, silent
from ..geometry import VoxelGrid
from .silhouette_test import CHILD, MIXED, OUTSIDE, SilhouetteTest
from .volume import BRICK, EMPTY, FULL, SparseVolume, brick_counts

_ROOTS = 16  # cells along the longest side that are tested before any is split
VOXELS_ACROSS = 512  # of the largest volume that is carved at once; a finer one in parts with as much surface: bounds memory
_ALL = np.uint8(255)
_CORNER = CHILD.T.astype(np.int32)
_BIT = np.arange(8, dtype=np.uint8)[:, None]
_FAR_CHILDREN = np.packbits(CHILD.T == 1, axis=1, bitorder="little")[:, 0]
"""(3,): the children on the far side along x, y, z, as bits."""


@dataclass
class Counts:
    """What the carving cost and what it found.

    Attributes
    ----------
    tests : int
        (cell, view) pairs that were tested, single voxels included.
    alone : (views,) int array
        Root cells that a view, on its own, leaves standing: 0 means that the view empties the volume.
    """

    tests: int = 0
    alone: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    def add(self, other: Counts) -> None:
        self.tests += other.tests
        self.alone = self.alone + other.alone


def root_size(grid: VoxelGrid) -> int:
    """Return the edge, in voxels, of the largest cells: a power of two, at least one brick."""
    return max(BRICK, 1 << int(np.log2(max(1, max(grid.shape) // _ROOTS))))


def extent_of(grid: VoxelGrid) -> int:
    """Return the largest half-voxel coordinate of the cells that cover the grid."""
    step = 2 * root_size(grid)
    return max(-(-n // step) * step for n in grid.shape) * 2


def bricks_of(grid: VoxelGrid, edge: int) -> list[np.ndarray]:
    """Return (2, 3) boxes of voxels, lower and upper corner, that cover the grid: of ``edge`` voxels a side or little more."""
    edge = -(-edge // (2 * root_size(grid))) * 2 * root_size(grid)
    lower = np.stack(np.meshgrid(*(np.arange(0, n, edge) for n in grid.shape), indexing="ij"), -1).reshape(-1, 3)
    return [np.stack((corner, np.minimum(corner + edge, grid.shape))) for corner in lower]


def carve(tests: Sequence[SilhouetteTest], grid: VoxelGrid, *, tolerance: int = 0, brick: np.ndarray | None = None,
          progress: Progress = silent) -> tuple[SparseVolume, Counts]:
    """Keep the voxels that no more than ``tolerance`` views see outside their silhouettes.

    One thread does the work: numpy holds the interpreter between operations, and two threads waited for each other longer
    than they saved.

    Parameters
    ----------
    tests : sequence of SilhouetteTest
        One a view, made for this grid with `extent_of` it. Their order decides the time, not the result.
    grid : VoxelGrid
    tolerance : int
        How many views may disagree.
    brick : (2, 3) int array, optional
        One of `bricks_of` the grid: only this part of it is carved. Cells know nothing of each other, so that all bricks
        together are what carving the whole grid gives, bit for bit.
    progress : callable

    Returns
    -------
    volume : SparseVolume
        Of a brick: on the brick's own grid.
    counts : Counts
    """
    size = root_size(grid)
    for test in tests:
        test.prepare(size)
    lower, upper = ((0, 0, 0), grid.shape) if brick is None else brick.tolist()
    cells = np.stack(np.meshgrid(*(np.arange(a, b, 2 * size, dtype=np.int32) for a, b in zip(lower, upper, strict=True)),
                                 indexing="ij")).reshape(3, -1)
    corner = np.array(lower, np.int32)[:, None]
    part_grid = VoxelGrid(grid.origin + grid.voxel_size * corner[:, 0], grid.voxel_size, tuple(np.subtract(upper, lower).tolist()))
    share = min(1.0, (VOXELS_ACROSS / max(part_grid.shape)) ** 2)
    parts = np.array_split(cells, min(cells.shape[1], round(1 / share)), axis=1)
    store, counts = _BrickStore(part_grid), Counts(alone=np.zeros(len(tests), int))
    for done, part in enumerate(parts):
        progress(done / len(parts), "Carving")
        kept, found = _carve_part(tests, grid, part, size, tolerance)
        store.add([(size, cells - corner, children) for size, cells, children in kept])
        counts.add(found)
    return store.volume(), counts


def _carve_part(tests: Sequence[SilhouetteTest], grid: VoxelGrid, cells: np.ndarray, size: int,
                tolerance: int) -> tuple[list[tuple[int, np.ndarray, np.ndarray]], Counts]:
    """Carve below (3, n) cells of twice ``size``, given by their lower corners.

    Returns
    -------
    kept : list of (size, (3, m) lower corners, (m,) bytes)
        Cells of which voxels stay, and which of their eight children do. All children have half the size.
    counts : Counts
    """
    pairs = [np.arange(cells.shape[1])] * len(tests)
    # A saturating count of misses for every child, bit-sliced: plane k holds "more than k views see it outside".
    missed = np.zeros((tolerance + 1, cells.shape[1]), np.uint8)
    counts, kept = Counts(alone=np.zeros(len(tests), int)), []
    while True:
        doubts = _test_children(tests, grid, cells, size, pairs, missed, counts)
        alive = ~missed[tolerance]
        mixed = np.zeros(len(alive), np.uint8)
        for rows, doubt in doubts:
            mixed[rows] |= doubt
        solid = alive & ~mixed
        rows = np.flatnonzero(solid)
        kept.append((2 * size, cells[:, rows], solid[rows]))
        if size == 1:
            return kept, counts
        cells, pairs, missed = _split(cells, size, alive & mixed, doubts, missed)
        size //= 2


def _test_children(tests: Sequence[SilhouetteTest], grid: VoxelGrid, cells: np.ndarray, size: int, pairs: list[np.ndarray],
                   missed: np.ndarray, counts: Counts) -> list[tuple[np.ndarray, np.ndarray]]:
    """Show every view the children of the cells it could not decide; count their misses in ``missed``.

    Returns
    -------
    list of (rows, bytes)
        For every view the cells it was shown, and which of their children it cannot decide.
    """
    beyond = _beyond(cells, size, grid)
    missed[-1] |= beyond
    centres = (2 * cells + 2 * size).astype(np.float64)
    first, doubts = size == root_size(grid), []
    for view, (test, rows) in enumerate(zip(tests, pairs, strict=True)):
        if not first:
            rows = rows[missed[-1][rows] != _ALL]  # earlier views may have emptied a cell
        codes = test.classify_children(centres.take(rows, axis=1), size)
        counts.tests += codes.size
        outside = _pack(codes == OUTSIDE)
        if first:
            counts.alone[view] = np.unpackbits(~(outside | beyond)).sum()
        for plane in range(len(missed) - 1, 0, -1):
            missed[plane][rows] |= missed[plane - 1][rows] & outside
        missed[0][rows] |= outside
        doubts.append((rows, _pack(codes == MIXED) if size > 1 else np.zeros(len(rows), np.uint8)))
    return doubts


def _split(cells: np.ndarray, size: int, split: np.ndarray, doubts, missed: np.ndarray):
    """Return the chosen children as cells, the pairs of the views that doubt them, and their inherited misses."""
    parent, child = _bits(split)
    row_of = np.zeros(8 * len(split), np.intp)
    row_of[8 * parent + child] = np.arange(len(parent))
    pairs = []
    for rows, doubt in doubts:
        at = np.flatnonzero(np.unpackbits(doubt & split.take(rows), bitorder="little"))
        pairs.append(row_of.take((8 * rows).take(at >> 3) + (at & 7)))
    inherited = ((missed[:, parent] >> child.astype(np.uint8)) & 1) * _ALL
    return cells.take(parent, axis=1) + _CORNER.take(child, axis=1) * np.int32(size), pairs, inherited


def _pack(flags: np.ndarray) -> np.ndarray:
    """Return (8, n) flags as (n,) bytes, row c in bit c (numpy's packbits is slow along this axis)."""
    return np.bitwise_or.reduce(flags.view(np.uint8) << _BIT, axis=0)


def _bits(bytes_: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (row, bit) of every set bit, rows first."""
    at = np.flatnonzero(np.unpackbits(bytes_, bitorder="little"))
    return at >> 3, at & 7


def _beyond(cells: np.ndarray, size: int, grid: VoxelGrid) -> np.ndarray:
    """Return the children that lie wholly beyond the grid, as bits."""
    far = cells + size >= np.array(grid.shape)[:, None]
    return np.bitwise_or.reduce(far * _FAR_CHILDREN[:, None], axis=0)


class _BrickStore:
    """Gathers what `_carve_part` keeps, in any order, and lays it into bricks."""

    def __init__(self, grid: VoxelGrid) -> None:
        self.grid = grid
        self.brick_map = np.full(brick_counts(grid), EMPTY, np.int32)
        self._small: list[tuple[int, np.ndarray, np.ndarray]] = []

    def add(self, kept: list[tuple[int, np.ndarray, np.ndarray]]) -> None:
        for size, cells, children in kept:
            if size > BRICK:
                row, child = _bits(children)
                self._fill((cells[:, row] + _CORNER[:, child] * (size // 2)) // BRICK, size // 2 // BRICK)
            else:
                self._small.append((size, cells, children))

    def _fill(self, bricks: np.ndarray, edge: int) -> None:
        """Make cubes of ``edge`` bricks a side full, as far as they lie in the map."""
        for offset in np.ndindex(edge, edge, edge):
            at = bricks + np.array(offset)[:, None]
            at = at[:, (at < np.array(self.brick_map.shape)[:, None]).all(axis=0)]
            self.brick_map[tuple(at)] = FULL

    def volume(self) -> SparseVolume:
        shape, brick_map = self.brick_map.shape, self.brick_map
        for _, cells, _ in self._small:
            brick_map[tuple(cells // BRICK)] = 0
        ragged = [axis for axis in range(3) if self.grid.shape[axis] % BRICK]
        full = np.zeros(shape, bool)
        for axis in ragged:  # a full brick that reaches beyond the grid becomes a mixed one
            last = tuple(slice(-1, None) if a == axis else slice(None) for a in range(3))
            full[last] = brick_map[last] == FULL
        brick_map[full] = 0
        mixed = brick_map == 0
        brick_map[mixed] = np.arange(np.count_nonzero(mixed), dtype=np.int32)
        bricks = self._bricks(np.count_nonzero(mixed))
        bricks[brick_map[full]] = True
        for axis in ragged:
            last = brick_map.take(-1, axis)
            beyond = (last[last >= 0], *(slice(self.grid.shape[axis] % BRICK, None) if a == axis else slice(None) for a in range(3)))
            bricks[beyond] = False
        return SparseVolume(self.grid, brick_map, bricks)

    def _bricks(self, count: int) -> np.ndarray:
        """Return (count, 8, 8, 8) bool: the voxels of the mixed bricks, from cells of 8, 4 and 2 voxels."""
        pairs = np.zeros((count, 4, 4, 4), np.uint8)  # one byte for each cube of 2x2x2 voxels
        for size, cells, children in self._small:
            row = self.brick_map[tuple(cells // BRICK)]
            x, y, z = cells % BRICK // 2
            if size == 2:
                pairs[row, x, y, z] |= children
                continue
            at, child = _bits(children)
            edge = size // 4
            for offset in np.ndindex(edge, edge, edge):
                dx, dy, dz = _CORNER[:, child] * edge + np.array(offset)[:, None]
                pairs[row[at], x[at] + dx, y[at] + dy, z[at] + dz] = _ALL
        bits = np.unpackbits(pairs.reshape(count, 4, 4, 4, 1), axis=-1, bitorder="little").reshape(count, 4, 4, 4, 2, 2, 2)
        return bits.transpose(0, 1, 4, 2, 5, 3, 6).reshape(count, BRICK, BRICK, BRICK).astype(bool)
