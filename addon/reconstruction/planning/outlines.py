# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes of a triangle mesh, from its contour edges alone.

How many triangles cover a pixel's centre is a sum over their edges: going along a row, an edge that is crossed adds one triangle or
takes one away. An edge between two triangles that face the same way adds and takes away the same, so that only the edges of the
contour count, some sqrt(t) of t triangles. A row is filled by a running sum, as outlines of letters are. The work is in
proportion to the contour's length and to the picture, not to the triangles' area.
"""

from __future__ import annotations

import numpy as np

from ..geometry import Camera
from ..mesh import TriangleMesh, merge_equal


class Outliner:
    """Draws silhouettes of one mesh.

    Parameters
    ----------
    mesh : TriangleMesh
        Closed or not, convex or not; vertices at one place count as one.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self._vertices, rows = merge_equal(mesh.vertices)
        self._triangles = rows[mesh.triangles]
        start, stop = self._triangles.ravel(), np.roll(self._triangles, -1, axis=1).ravel()
        key, edge = np.unique(np.minimum(start, stop) * len(self._vertices) + np.maximum(start, stop), return_inverse=True)
        self._ends = np.stack(np.divmod(key, max(len(self._vertices), 1)))  # (2, e)
        self._edge, self._way = edge.ravel(), np.where(start < stop, 1.0, -1.0)

    def silhouette(self, camera: Camera) -> np.ndarray | None:
        """Return which pixels have their centre on the mesh.

        Parameters
        ----------
        camera : Camera
            In the mesh's frame, without distortion.

        Returns
        -------
        (height, width) bool array or None
            None where a part of the mesh lies behind the camera: such a view has no outline.
        """
        width, height = camera.size
        pixels, depth = camera.project(self._vertices)
        if not (depth > 0).all():
            return None
        x, y = pixels.T
        a, b, c = self._triangles.T
        turn = np.sign((x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a]))
        net = np.bincount(self._edge, self._way * np.repeat(turn, 3), minlength=self._ends.shape[1])
        contour = np.flatnonzero(net)
        (x0, x1), (y0, y1) = x[self._ends[:, contour]], y[self._ends[:, contour]]
        # The rows whose centres the edge crosses: an end on a row belongs to the edge below it, and to no other.
        first = np.clip(np.ceil(np.minimum(y0, y1)), 0, height).astype(np.int64)
        count = np.maximum(np.clip(np.ceil(np.maximum(y0, y1)), 0, height).astype(np.int64) - first, 0)
        row = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
        with np.errstate(divide="ignore", invalid="ignore"):  # an edge along a row crosses none
            slope = (x1 - x0) / (y1 - y0)
        at = np.repeat(x0 - y0 * slope, count) + row * np.repeat(slope, count)
        column = np.clip(np.ceil(at), 0, width).astype(np.int64)
        weight = np.repeat(net[contour] * np.sign(y1 - y0), count)
        steps = np.bincount(row * (width + 1) + column, weight, minlength=height * (width + 1)).reshape(height, width + 1)
        return np.abs(np.cumsum(steps[:, :-1], axis=1)) > 0.5
