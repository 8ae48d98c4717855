# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the methods share that carve by colour: where they begin, and how what they found becomes an outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import ScanstageError
from ...options import Option
from ...progress import Progress, silent
from ..geometry import VoxelGrid
from ..outcome import Outcome
from ..scan import Scan
from .carving import Carving
from .coloring import SurfaceColors, filled
from .consistency import OPTIONS as CONSISTENCY
from .consistency import Judge
from .footprints import Pictures
from .surface import extract_surface
from .visual_hull import visual_hull, working_bounds
from .volume import BRICK, FULL, SparseVolume, brick_counts

# By the centre rule: the conservative hull's outermost voxels have their centres outside a silhouette and would never be seen.
HULL = {"rule": "center", "tolerance": 0, "outside": "unknown"}

OPTIONS = (
    Option("start", "hull", "What is carved", choices={
        "hull": "the visual hull of the silhouettes",
        "box": "the whole working volume; a voxel in whose place a view sees background is removed"}),
    *CONSISTENCY,
)


def photo_bounds(scan: Scan, **options) -> np.ndarray:
    """Return the (2, 3) working volume: the capture's own, or one found from the silhouettes."""
    return working_bounds(scan, **HULL)


def start(scan: Scan, grid: VoxelGrid, kind: str, progress: Progress = silent) -> tuple[Carving, list[str]]:
    """Return the volume to be carved, 'hull' or 'box', and what a user should know about the captures.

    Raises
    ------
    ScanstageError
        There are fewer than two views, or no hull can be carved.
    """
    if len(scan.views) < 2:
        raise ScanstageError(f"the capture has {len(scan.views)} view{'' if len(scan.views) == 1 else 's'}: colours can only be "
                             "compared between two or more; capture more views")
    if kind == "hull":
        hull = visual_hull(scan, grid, **HULL, progress=progress)
        return Carving(hull.volume), hull.report["warnings"]
    return Carving(whole_box(grid)), []


def whole_box(grid: VoxelGrid) -> SparseVolume:
    """Return the volume of all voxels of a grid."""
    if all(n % BRICK == 0 for n in grid.shape):
        return SparseVolume(grid, np.full(brick_counts(grid), FULL, np.int32), np.zeros((0, BRICK, BRICK, BRICK), bool))
    return SparseVolume.from_slabs(grid, (np.ones((min(BRICK, grid.shape[0] - x), *grid.shape[1:]), bool)
                                          for x in range(0, grid.shape[0], BRICK)))


def pictures_of(scan: Scan, grid: VoxelGrid, kind: str, judge: Judge, progress: Progress = silent) -> Pictures:
    """Return the pictures as a method that begins with ``kind`` and its judge need them."""
    needs = judge.measure.needs
    return Pictures.of(scan.views, grid, progress, background=kind == "box", spread=needs == "spread", cells=needs == "cells")


def carve_background(carving: Carving, pictures: Pictures) -> int:
    """Take out the voxels in whose place a view sees background, from the outside in; return how many."""
    removed, front = 0, carving.surface_keys()
    carving.forget()
    carving.enqueue(front)
    while pictures.outside.any() and len(front):
        gone = front[pictures.background(carving.voxels(front) + 0.5)]
        carving.remove(gone)
        removed, front = removed + len(gone), carving.exposed_by(gone)
    return removed


@dataclass(frozen=True)
class Colored:
    """Colours of voxels: keys (n,), linear rgb (n, 3) and the number of views that they are from (n,), 0 for none."""

    keys: np.ndarray
    rgb: np.ndarray
    views: np.ndarray

    def of(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the (m, 3) colours of voxels by their keys, and the (m,) uint16 number of views, 0 for voxels that are not listed."""
        if not len(self.keys):
            return np.zeros((len(keys), 3), np.float32), np.zeros(len(keys), np.uint16)
        order = np.argsort(self.keys)
        row = order[np.minimum(np.searchsorted(self.keys, keys, sorter=order), len(order) - 1)]
        return self.rgb[row], np.where(self.keys[row] == keys, self.views[row], 0).astype(np.uint16)


def outcome(carving: Carving, colored: Colored, judge: Judge, *, counts: dict[str, int], warnings: Sequence[str], report: dict,
            whole_footprints: bool) -> Outcome:
    """Return what a method found: the volume as it is carved, its surface and the colours.

    Surface voxels without a colour count as unseen: they are kept since nothing speaks against them.

    Raises
    ------
    ScanstageError
        Nothing is left.
    """
    volume = carving.frozen()
    surface = extract_surface(volume)
    if not len(surface.voxels):
        raise ScanstageError(f"no voxel is photo-consistent: raise --set consistency_threshold=... (now {judge.threshold:g}), or check the "
                             "poses and that the light keeps still with respect to the object")
    rgb, views = colored.of(carving.keys(surface.voxels))
    rgb = filled(surface, rgb, views > 0).astype(np.float32)
    seen = int(np.count_nonzero(views))
    found = {**counts, "coloured": seen, "unseen": len(views) - seen}
    return Outcome(volume, {"counts": found, "consistency": judge.report(whole_footprints=whole_footprints), **report,
                            "warnings": list(warnings)}, surface, SurfaceColors(rgb, views))
