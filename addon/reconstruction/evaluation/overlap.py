# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which voxels the surface of a mesh passes through: the exact overlap of triangles and boxes.

Candidates come from the triangles' planes, so that their number follows the area and not the bounding boxes; each is
then decided by the separating axis theorem (Akenine-Moeller, "Fast 3D triangle-box overlap testing", 2001).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..arrays import expand, sorted_unique
from ..geometry import VoxelGrid
from ..mesh import TriangleMesh
from ..volumetric.volume import BRICK, SparseVolume
from .pieces import bisect

TOLERANCE = 1e-6
"""In voxels: a surface that enters a voxel by less does not touch it, so that one lying in a voxel's face does not."""

CHUNK = 1 << 16
LONGEST = 16.0  # voxels; larger triangles are cut, so that slivers do not fill their bounding boxes with candidates
SLACK = 1e-3  # voxels around the candidates; rounding in a plane's slope is far below, the exact test decides anyway


def touched(mesh: TriangleMesh, grid: VoxelGrid) -> SparseVolume:
    """Return the voxels whose interior the surface of the mesh passes through.

    Parameters
    ----------
    mesh : TriangleMesh
        Open or closed; a triangle without area counts as the segment or point that it is.
    grid : VoxelGrid
    """
    return SparseVolume.from_slabs(grid, slabs_of(grid, touched_indices(mesh, grid)))


def slabs_of(grid: VoxelGrid, indices: np.ndarray) -> Iterator[np.ndarray]:
    """Yield slabs of 8 layers in x, (8 or fewer, ny, nz) bool, that hold the voxels of ascending flat indices."""
    nx, ny, nz = grid.shape
    starts = np.searchsorted(indices, np.arange(0, nx + BRICK, BRICK) * ny * nz)
    for row, x in enumerate(range(0, nx, BRICK)):
        slab = np.zeros((min(BRICK, nx - x), ny, nz), bool)
        slab.reshape(-1)[indices[starts[row]:starts[row + 1]] - x * ny * nz] = True
        yield slab


def touched_indices(mesh: TriangleMesh, grid: VoxelGrid) -> np.ndarray:
    """Return `touched` as ascending flat indices, (n,) int64, of voxels in ``[x, y, z]`` order."""
    vertices = (mesh.vertices - grid.origin) / grid.voxel_size
    corners = _cut(vertices, mesh.triangles, np.array(grid.shape))
    found, pending = [np.zeros(0, np.int64)], 0
    for triangles, voxels in _candidates(corners, np.array(grid.shape)):
        hit = voxels[_overlap(triangles, voxels)]
        found.append(sorted_unique(np.ravel_multi_index(tuple(hit.T), grid.shape)))
        pending += len(found[-1])
        if pending > max(16 * CHUNK, 2 * len(found[0])):  # several triangles touch the same voxel: keep it once
            found, pending = [sorted_unique(np.concatenate(found))], 0
    return sorted_unique(np.concatenate(found))


def _cut(vertices: np.ndarray, triangles: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return the corners (n, 3, 3) of pieces that cover what of the triangles lies near the grid."""
    longest = np.inf
    while True:
        corners = vertices[triangles]
        near = (corners.max(axis=1) > -SLACK).all(axis=1) & (corners.min(axis=1) < shape + SLACK).all(axis=1)
        if longest <= LONGEST or not near.any():
            return corners[near]
        # By and by, so that what a huge triangle covers beyond the grid is dropped before it is cut small.
        longest = max(min(longest, np.ptp(corners[near], axis=1).max()) / 4, LONGEST)
        vertices, triangles, _ = bisect(vertices, triangles[near], longest)


def _candidates(corners: np.ndarray, shape: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield pairs of a triangle (m, 3, 3) and a voxel (m, 3) near its plane, in chunks."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    dominant = np.abs(normal).argmax(axis=1)
    for axis in range(3):
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]
        back = np.argsort(order)
        chosen = dominant == axis
        part = corners[chosen][:, :, order]
        low, high = part.min(axis=1), part.max(axis=1)
        first = np.clip(np.floor(low - SLACK), 0, shape[order]).astype(np.int64)
        stop = np.clip(np.floor(high + SLACK) + 1, 0, shape[order]).astype(np.int64)
        width = np.maximum(stop - first, 0)
        slope, steepness = _slopes(normal[chosen][:, order], part)
        for owner, position in expand(width[:, 0] * width[:, 1], CHUNK):
            column = first[owner, :2] + np.stack(np.divmod(position, width[owner, 1]), axis=1)
            middle = part[owner, 0, 2] + (slope[owner] * (column + 0.5 - part[owner, 0, :2])).sum(axis=1)
            spread = steepness[owner]
            lowest = np.maximum(np.floor(middle - spread), first[owner, 2]).astype(np.int64)
            beyond = np.minimum(np.floor(middle + spread) + 1, stop[owner, 2]).astype(np.int64)
            for pair, height in expand(np.maximum(beyond - lowest, 0), CHUNK):
                voxels = np.concatenate((column[pair], (lowest[pair] + height)[:, None]), axis=1)
                yield part[owner[pair]][:, :, back], voxels[:, back]


def _slopes(normal: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (n, 2) gradients of w over (u, v) and by how much (n,) w varies from a column's middle to its corners.

    A triangle with (almost) no area has no gradient worth the name; its columns are searched from end to end.
    """
    edge = ((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2).max(axis=1)
    flat = np.abs(normal[:, 2]) > 1e-8 * edge
    slope = np.where(flat[:, None], -normal[:, :2] / np.where(flat, normal[:, 2], 1.0)[:, None], 0.0)
    whole = corners[:, :, 2].max(axis=1) - corners[:, :, 2].min(axis=1)
    return slope, np.where(flat, np.abs(slope).sum(axis=1) / 2, whole) + SLACK


def _overlap(corners: np.ndarray, voxels: np.ndarray) -> np.ndarray:
    """Return (m,) bool: whether triangles (m, 3, 3) meet the unit boxes at (m, 3), shrunk by the tolerance.

    No separating axis among the box's 3 normals, the triangle's normal and the 9 cross products of their edges.
    """
    half = 0.5 - TOLERANCE
    points = corners - (voxels + 0.5)[:, None]
    meets = ((points.min(axis=1) <= half) & (points.max(axis=1) >= -half)).all(axis=1)
    edges = np.roll(points, -1, axis=1) - points
    normal = np.cross(edges[:, 0], edges[:, 1])
    # All three corners: where there is (almost) no area the normal is rounding, and an axis like any other.
    along, reach = np.einsum("ni,nci->cn", normal, points), half * np.abs(normal).sum(axis=1)
    meets &= (along.min(axis=0) <= reach) & (along.max(axis=0) >= -reach)
    for i in range(3):
        # The edge's own two corners project to the same number: one of them and the third corner are enough.
        edge, on, off = edges[:, i], points[:, i], points[:, (i + 2) % 3]
        for u, v in ((1, 2), (2, 0), (0, 1)):
            p, q = (edge[:, u] * point[:, v] - edge[:, v] * point[:, u] for point in (on, off))
            reach = half * (np.abs(edge[:, u]) + np.abs(edge[:, v]))
            meets &= (np.minimum(p, q) <= reach) & (np.maximum(p, q) >= -reach)
    return meets
