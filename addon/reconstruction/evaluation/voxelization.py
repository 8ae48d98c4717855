# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which voxels have their centre inside a mesh, and which lie wholly inside.

Lines through the voxel centres along one axis are followed through the mesh: at every surface they cross, they go one
layer deeper in or out. Which triangles a line crosses is decided by the half-open scanline rule: a triangle covers a
centre between its edges' crossings with the scanline, the lower included. Both neighbours of an edge compute the same
crossing, in the same order of operations, so that a closed mesh is entered as often as it is left, whatever rounding
does: exactly, not within a tolerance.

Memory follows the surface and one slab of 8 layers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import expand
from ..geometry import VoxelGrid
from ..mesh import TriangleMesh
from ..volumetric.volume import BRICK, SparseVolume
from .overlap import slabs_of, touched_indices

CHUNK = 1 << 18


def inside(mesh: TriangleMesh, grid: VoxelGrid) -> SparseVolume:
    """Return the voxels whose centre is inside the mesh.

    A watertight mesh is judged by its winding number along z: where shells overlap it is their union, and a shell
    inside out within another is a cavity. A mesh with holes is judged along all three axes, and the majority decides;
    an axis whose line leaves the mesh less often than it enters it does not vote, and a tie is outside. Where
    triangles disagree on which side is out, crossings are counted odd and even instead.

    Parameters
    ----------
    mesh : TriangleMesh
    grid : VoxelGrid
    """
    return SparseVolume.from_slabs(grid, inside_slabs(mesh, grid))


def wholly_inside(mesh: TriangleMesh, grid: VoxelGrid) -> SparseVolume:
    """Return the voxels inside the mesh that its surface does not touch: no point of them is outside.

    Within `overlap.TOLERANCE`: a voxel whose face lies in the surface is wholly inside.
    """
    surface = touched_indices(mesh, grid)
    slabs = zip(inside_slabs(mesh, grid), slabs_of(grid, surface), strict=True)
    return SparseVolume.from_slabs(grid, (centre & ~shell for centre, shell in slabs))


def inside_slabs(mesh: TriangleMesh, grid: VoxelGrid) -> Iterator[np.ndarray]:
    """Yield `inside` in slabs of 8 layers in x: (8 or fewer, ny, nz) bool."""
    imbalance = mesh.edge_imbalance()
    if imbalance == 0:
        yield from (winding != 0 for winding, _ in _Crossings.of(mesh, grid, 2).slabs(grid))
        return
    votes = [_Crossings.of(mesh, grid, axis).slabs(grid, parity=imbalance > 1) for axis in range(3)]
    for ballots in zip(*votes, strict=True):
        total = np.zeros(ballots[0][0].shape, np.int8)
        for winding, closed in ballots:
            total += np.where(winding != 0, np.int8(1), np.int8(-1)) * closed
        yield total > 0


@dataclass(frozen=True)
class _Crossings:
    """Where the lines through voxel centres along one axis cross a mesh.

    Parameters
    ----------
    axis : int
        Of the lines.
    voxels : (n, 3) int32 array
        The first voxel beyond each crossing, ordered by x. The count of voxels along ``axis`` if there is none.
    sign : (n,) int8 array
        1 on the way in, -1 on the way out.
    """

    axis: int
    voxels: np.ndarray
    sign: np.ndarray

    @classmethod
    def of(cls, mesh: TriangleMesh, grid: VoxelGrid, axis: int) -> _Crossings:
        """Find all crossings within the grid's cross-section."""
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]  # a right-handed frame (u, v, w) with w along the lines
        # In voxels, with the centres at the integers.
        vertices = ((mesh.vertices - grid.origin) / grid.voxel_size - 0.5)[:, order]
        size = np.array(grid.shape)[order]
        found = [np.zeros((0, 4), np.int32)]
        corners = vertices[mesh.triangles]
        row = np.clip(np.ceil(corners[:, :, 1]), 0, size[1]).astype(np.int64)
        first = row.min(axis=1)  # rows v with v_min <= v < v_max: at a corner's own height it counts as below
        for owner, position in expand(row.max(axis=1) - first, CHUNK):
            v = first[owner] + position
            low, high, sign = _scanline(corners[owner], v)
            start = np.clip(np.ceil(low), 0, size[0]).astype(np.int64)
            stop = np.clip(np.ceil(high), 0, size[0]).astype(np.int64)
            for span, offset in expand(np.maximum(stop - start, 0), CHUNK):
                u, line = start[span] + offset, v[span]
                depth = np.clip(np.ceil(_depth(corners[owner[span]], u, line)), 0, size[2])
                found.append(np.stack((u, line, depth.astype(np.int64), sign[span]), axis=1).astype(np.int32))
        table = np.concatenate(found)
        voxels = table[:, np.argsort(order)]
        by_x = np.argsort(voxels[:, 0], kind="stable")
        return cls(axis, voxels[by_x], table[by_x, 3].astype(np.int8))

    def slabs(self, grid: VoxelGrid, *, parity: bool = False) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield for slabs of 8 layers in x the winding numbers (or 0 and 1), and whether each voxel's line is closed.

        Yields
        ------
        winding : (8 or fewer, ny, nz) int16 array
        closed : bool array
            Broadcasts against ``winding``.
        """
        nx, ny, nz = grid.shape
        carried = np.zeros((ny, nz), np.int16)
        balance = np.zeros((ny, nz), np.int16)
        if self.axis == 0:
            np.add.at(balance, (self.voxels[:, 1], self.voxels[:, 2]), 1 if parity else self.sign)
        starts = np.searchsorted(self.voxels[:, 0], np.minimum(np.arange(0, nx + BRICK, BRICK), nx))
        for row, x in enumerate(range(0, nx, BRICK)):
            part = slice(starts[row], starts[row + 1])
            shape = [min(BRICK, nx - x), ny, nz]
            if self.axis:
                shape[self.axis] += 1  # takes the crossings beyond the last voxel, which the balance needs
            change = np.zeros(shape, np.int16)
            i, j, k = self.voxels[part].T
            np.add.at(change, (i - x, j, k), 1 if parity else self.sign[part])
            if self.axis == 0:
                change[0] += carried
            winding = np.cumsum(change, axis=self.axis, dtype=np.int16, out=change)
            last = winding.take(-1, axis=self.axis)
            if self.axis == 0:
                carried = last
                closed = (balance % 2 == 0 if parity else balance == 0)[None]
            else:
                closed = np.expand_dims(last % 2 == 0 if parity else last == 0, self.axis)
            winding = winding[:, :ny, :nz]
            yield winding % 2 if parity else winding, closed


def _scanline(corners: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where triangles (m, 3, 3) begin and end along the scanlines at v (m,), and which way they face.

    A triangle faces the lines' start (sign 1) where it is clockwise seen from their end.
    """
    ends = np.full((2, len(v)), np.nan)  # at the edge that runs up, at the one that runs down
    for edge in range(3):
        start, stop = corners[:, edge], corners[:, (edge + 1) % 3]
        up, down = (start[:, 1] <= v) & (v < stop[:, 1]), (stop[:, 1] <= v) & (v < start[:, 1])
        # From the lower end to the higher one, whichever way the edge runs, so that both neighbours get the same u.
        lower, upper = np.where(up[:, None], start, stop), np.where(up[:, None], stop, start)
        rise = np.where(up | down, upper[:, 1] - lower[:, 1], 1.0)
        u = lower[:, 0] + (v - lower[:, 1]) / rise * (upper[:, 0] - lower[:, 0])
        ends[0][up], ends[1][down] = u[up], u[down]
    return ends.min(axis=0), ends.max(axis=0), np.where(ends[0] < ends[1], 1, -1)


def _depth(corners: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return w (m,) where lines at (u, v) cross the planes of triangles (m, 3, 3), within the triangles' own range."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    slope = (normal[:, 0] * (u - a[:, 0]) + normal[:, 1] * (v - a[:, 1])) / np.where(normal[:, 2] == 0, 1, normal[:, 2])
    return np.clip(a[:, 2] - slope, corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1))
