# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull that a rig will carve, from silhouettes that are drawn instead of photographed: quick enough to follow the mouse."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ...errors import ScanstageError
from ..geometry import Camera, VoxelGrid
from ..mesh import TriangleMesh
from ..volumetric.bounds import spread_order
from ..volumetric.octree import carve, extent_of
from ..volumetric.silhouette_test import SilhouetteTest
from ..volumetric.volume import SparseVolume
from .outlines import Outliner

_MARGIN = 0.15  # of the object's longest side, beyond its box: how far a hull is looked for
_PIXELS = 2.0  # that a voxel spans in the pictures that are drawn


def preview_grid(mesh: TriangleMesh, voxels: int) -> VoxelGrid:
    """Return a grid of ``voxels`` along the longest side of the mesh's box and a margin about it, in which the hull may be larger."""
    lower, upper = mesh.bounds()
    margin = _MARGIN * (upper - lower).max()
    return VoxelGrid.from_bounds(lower - margin, upper + margin, voxels)


def preview_hull(outliner: Outliner, cameras: Sequence[Camera], grid: VoxelGrid) -> SparseVolume:
    """Carve the visual hull of a mesh as the cameras would see it, by the rule ``center``.

    Parameters
    ----------
    outliner : Outliner
        Of the mesh.
    cameras : sequence of Camera
        In the mesh's frame, without distortion. One that stands within the mesh, or has a part of it behind, carves nothing.
    grid : VoxelGrid

    Raises
    ------
    ScanstageError
        No camera has all of the mesh before it.
    """
    return carve(_tests(outliner, cameras, grid), grid)[0]


def growing_hulls(outliner: Outliner, cameras: Sequence[Camera], grid: VoxelGrid) -> Iterator[tuple[int, SparseVolume]]:
    """Yield the hulls of the first 1, 2, 4, 8, ... cameras, and of all: how many there are, and the volume.

    Each view stands as far from those before it as can be (`spread_order`), so that every hull is a fair one for its number.

    Raises
    ------
    ScanstageError
        As `preview_hull`.
    """
    tests = _tests(outliner, cameras, grid)
    counts = [1 << power for power in range((len(tests) - 1).bit_length())] + [len(tests)]
    for count in counts:
        yield count, carve(tests[:count], grid)[0]


def _tests(outliner: Outliner, cameras: Sequence[Camera], grid: VoxelGrid) -> list[SilhouetteTest]:
    if not cameras:
        raise ScanstageError("the rig has no views: a visual hull needs at least one")
    middle, tests = (grid.origin + grid.upper) / 2, []
    for number in spread_order(cameras):
        camera = cameras[number]
        depth = float(camera.project(middle)[1])
        spans = min(camera.K[0, 0], camera.K[1, 1]) * grid.voxel_size / max(depth, 1e-300)
        drawn = camera.scaled(min(1.0, _PIXELS / spans))
        mask = outliner.silhouette(drawn) if depth > 0 else None
        if mask is not None:
            tests.append(SilhouetteTest(drawn, mask, grid, extent_of(grid), rule="center", unknown_outside=True))
    if not tests:
        raise ScanstageError("no camera has the whole object before it: move the cameras away from the object")
    return tests
