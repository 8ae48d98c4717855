# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh in triangles of about one size: no larger than a figure on them may vary, no more than can be worked on at once."""

from __future__ import annotations

import numpy as np

from ..mesh import TriangleMesh


def simplified(mesh: TriangleMesh, cells: int) -> TriangleMesh:
    """Merge all vertices within a cell of a grid (vertex clustering: Rossignac & Borrel, 1993).

    Parameters
    ----------
    mesh : TriangleMesh
    cells : int
        Along the mesh's longest side. Nothing moves farther than across one cell.

    Returns
    -------
    TriangleMesh
        Of triangles that span cells; what lies within one, or comes to lie on another triangle, is gone.
    """
    lower, upper = mesh.bounds()
    cell = np.floor((mesh.vertices - lower) / max((upper - lower).max() / cells, 1e-300)).astype(np.int64)
    keys = (cell[:, 0] * (cells + 2) + cell[:, 1]) * (cells + 2) + cell[:, 2]
    _, cluster, members = np.unique(keys, return_inverse=True, return_counts=True)
    vertices = np.column_stack([np.bincount(cluster, mesh.vertices[:, axis]) for axis in range(3)]) / members[:, None]
    triangles = cluster[mesh.triangles]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    first = triangles.argmin(axis=1)[:, None]  # equal triangles are to begin with the same corner
    return TriangleMesh(vertices, np.unique(np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1), axis=0))


def divided(corners: np.ndarray, longest: float, most: int) -> np.ndarray:
    """Cut triangles in two across their longest side until no side is longer than ``longest`` (Rivara, 1984).

    Parameters
    ----------
    corners : (t, 3, 3) array
        Of the triangles.
    longest : float
    most : int
        No further round of cuts that would make more triangles than this.

    Returns
    -------
    (s, 3, 3) array
        The same surface, and the same way round. Neighbours need not share corners.
    """
    while True:
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        cut = np.flatnonzero(sides.max(axis=1) > longest)
        if not len(cut) or len(corners) + len(cut) > most:
            return corners
        turned = (sides[cut].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(corners[cut[:, None], turned], 1, 0)
        middle = (a + b) / 2
        corners = np.concatenate((np.delete(corners, cut, axis=0), np.stack((a, middle, c), axis=1), np.stack((middle, b, c), axis=1)))
