# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The working volume, found from the silhouettes themselves.

Each side of a silhouette's bounding rectangle is a plane through the camera's centre, and the object lies on one side
of it. The box round the region that all planes leave is the first guess; a coarse hull inside it gives the final one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera, VoxelGrid
from .octree import carve, extent_of
from .silhouette_test import SilhouetteTest

_FAR = 10.0  # a box of so many camera distances stands for "no bound"
_MOST_VIEWS = 12  # more planes tighten the first guess little, and triples of planes grow with the cube
_COARSE = 48  # voxels along the longest side of the coarse hull
_MARGIN = 1  # px; silhouettes may be a pixel too small on each side


@dataclass(frozen=True)
class Silhouette:
    """One view's silhouette.

    Parameters
    ----------
    camera : Camera
        In the object frame, without distortion.
    mask : (height, width) bool array
        Where the object is seen.
    known : (height, width) bool array
        Where the picture tells anything.
    """

    camera: Camera
    mask: np.ndarray
    known: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """Where the object may be."""
        return self.mask | ~self.known


def bounds_from_silhouettes(silhouettes: Sequence[Silhouette], *, tolerance: int = 0,
                            unknown_outside: bool = True) -> np.ndarray:
    """Return a (2, 3) box that holds everything that projects into all silhouettes.

    Parameters
    ----------
    silhouettes : sequence of Silhouette
        In the order of `spread_order`.
    tolerance : int
        How many views may disagree: given to the coarse hull.
    unknown_outside : bool
        Whether the object may reach beyond a picture whose border it touches.

    Raises
    ------
    ScanstageError
        The views do not bound the volume, or have nothing in common.
    """
    planes = np.concatenate([_planes(silhouette, unknown_outside) for silhouette in silhouettes[:_MOST_VIEWS]])
    cameras = [silhouette.camera for silhouette in silhouettes]
    centres, middle = np.array([camera.centre for camera in cameras]), meeting_point(cameras)
    reach = _FAR * np.linalg.norm(centres - middle, axis=1).max()
    walls = np.column_stack((np.concatenate((np.eye(3), -np.eye(3))), np.r_[reach - middle, reach + middle]))
    corners = _vertices(np.concatenate((planes, walls)))
    if not len(corners):
        raise ScanstageError("the silhouettes have no point in common: a calibration or a mask is wrong, or the views "
                             "belong to different scenes; give the working volume with --bounds to look into it")
    box = np.stack((corners.min(0), corners.max(0)))
    if (np.abs(box - middle) > 0.99 * reach).any():
        raise ScanstageError("the views do not bound the object (it touches the picture's border, or all views look the "
                             "same way): give the working volume with --bounds X0 Y0 Z0 X1 Y1 Z1")
    return _tightened(silhouettes, box, tolerance, unknown_outside)


def spread_order(cameras: Sequence[Camera]) -> list[int]:
    """Return an order of the views in which each looks along a line as different as can be from all before it.

    Views that look at right angles carve most, so this order empties cells early. Opposite views count as the same.
    """
    axes = np.array([camera.forward for camera in cameras])
    likeness = np.abs(axes @ axes.T)
    order, nearest = [0], likeness[0].copy()
    for _ in range(1, len(axes)):
        nearest[order[-1]] = np.inf
        order.append(int(nearest.argmin()))
        nearest = np.maximum(nearest, likeness[order[-1]])
    return order


def meeting_point(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the (3,) point nearest to all optical axes, in the least-squares sense."""
    across = np.array([np.eye(3) - np.outer(camera.forward, camera.forward) for camera in cameras])
    right = np.array([a @ camera.centre for a, camera in zip(across, cameras, strict=True)])
    return np.linalg.lstsq(across.sum(0), right.sum(0), rcond=None)[0]


def _planes(silhouette: Silhouette, unknown_outside: bool) -> np.ndarray:
    """Return (n, 4) planes, ``plane @ (X, 1) >= 0`` where the object may be: none where it may go on beyond the picture."""
    mask, P = silhouette.mask, silhouette.camera.P
    unknown = np.pad(~silhouette.known, 1, constant_values=unknown_outside)
    planes = [P[2]]
    for row, lines, before, after in ((P[0], mask.any(axis=0), unknown[1:-1, :-2], unknown[1:-1, 2:]),
                                      (P[1], mask.any(axis=1), unknown[:-2, 1:-1], unknown[2:, 1:-1])):
        used = np.flatnonzero(lines)
        if len(used) and not (mask & before).any():
            planes.append(row - (used[0] - 0.5 - _MARGIN) * P[2])
        if len(used) and not (mask & after).any():
            planes.append((used[-1] + 0.5 + _MARGIN) * P[2] - row)
    planes = np.array(planes)
    return planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)


def _vertices(planes: np.ndarray) -> np.ndarray:
    """Return the (n, 3) corners of the convex region that (m, 4) planes leave."""
    triples = np.array(list(combinations(range(len(planes)), 3)))
    normals, offsets = planes[triples, :3], planes[triples, 3]
    proper = np.abs(np.linalg.det(normals)) > 1e-9
    points = np.linalg.solve(normals[proper], -offsets[proper][..., None])[..., 0]
    scale = np.abs(points).max(axis=1, keepdims=True) + 1
    kept = [chunk[(chunk @ planes[:, :3].T + planes[:, 3] >= -1e-9 * size).all(axis=1)]
            for chunk, size in zip(np.array_split(points, 16), np.array_split(scale, 16), strict=True)]
    return np.concatenate(kept)


def _tightened(silhouettes: Sequence[Silhouette], box: np.ndarray, tolerance: int, unknown_outside: bool) -> np.ndarray:
    """Return the box round the coarse conservative hull, a coarse voxel wider on every side."""
    grid = VoxelGrid.from_bounds(*box, _COARSE)
    tests = [SilhouetteTest(silhouette.camera, silhouette.inside, grid, extent_of(grid), rule="conservative",
                            unknown_outside=unknown_outside) for silhouette in silhouettes]
    used = carve(tests, grid, tolerance=tolerance)[0].bounds()
    if used is None:
        return box
    return np.stack([grid.origin + grid.voxel_size * (index + step) for index, step in zip(used, (-1, 2), strict=True)])
