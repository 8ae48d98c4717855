# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How much memory a reconstruction will take, told before the work, and the refusal of what does not fit.

Every method's memory follows a few numbers: the pixels of the pictures, those of them inside the silhouettes, and the voxels
of the surface that it begins with. The last are not known before the work, but a hull of a few voxels tells them: a surface
grows with the square of the voxels a side. What a unit of each takes was measured (tests/reconstruction/test_forecast.py
measures it again, in processes of their own).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..errors import ScanstageError
from ..memory import amount, available_memory
from ..options import Value
from .active.correspondence import CONTRAST
from .geometry import VoxelGrid
from .scan import Scan, View
from .volumetric.footprints import PIXELS_PER_VOXEL, corners_of, voxel_in_pixels
from .volumetric.octree import VOXELS_ACROSS
from .volumetric.photo_hull import whole_box
from .volumetric.surface import extract_surface
from .volumetric.visual_hull import carve_silhouettes, silhouettes_of
from .volumetric.volume import BRICK, SparseVolume

_ACROSS = 48  # voxels of the hull that tells the surface
_PIXELS = 2.0  # of the masks that it is carved from, to a voxel
_BASE = 8 << 20  # what every reconstruction takes: a picture at a time, tables, caches


@dataclass(frozen=True)
class Workload:
    """What a reconstruction has to do.

    Parameters
    ----------
    shape : tuple of int
        Of the grid.
    views : int
    pixels, inside : int
        Of all pictures together, and those of them that show the object.
    faces : float
        Of the voxels at the surface that the method begins with. (Their number grows with the square of the voxels a side; that of
        the voxels themselves does so only in fine grids.)
    occupied : float
        Voxels that it begins with.
    span : float
        Pixels that a voxel spans. Methods that compare colours read pictures no finer than they need.
    """

    shape: tuple[int, int, int]
    views: int
    pixels: int
    inside: int
    faces: float
    occupied: float
    span: float = 1.0

    @classmethod
    def most(cls, shape: tuple[int, int, int], views: int, pixels: int) -> Workload:
        """Return the work for an object that fills the working volume and every picture: no other takes more."""
        x, y, z = shape
        return cls(shape, views, pixels, pixels, 2.0 * (x * y + y * z + z * x), float(x * y * z))

    @property
    def sampled(self) -> float:
        """How many of the pixels ``inside`` are left in pictures that are reduced to what the voxels can use."""
        return self.inside / max(1, int(self.span / PIXELS_PER_VOXEL)) ** 2

    @property
    def part(self) -> float:
        """The share of the surface that the octree carves at once."""
        return min(1.0, (VOXELS_ACROSS / max(self.shape)) ** 2)

    @property
    def brick_map(self) -> int:
        """Bytes of a map of all bricks."""
        return 4 * int(np.prod([n // BRICK + 1 for n in self.shape], dtype=object))


MemoryOf = Callable[[Workload], float]
"""Returns the bytes that a method takes at its peak."""


def carving_memory(work: Workload) -> float:
    """Return what carving the visual hull takes: codes of every pixel, pairs of a cell and a view, and the bricks that are kept."""
    return 6 * work.pixels + work.faces * (55 + 2.2 * work.views * work.part) + 2 * work.brick_map


def hull_memory(work: Workload) -> float:
    """Return what the methods take that carve silhouettes: in the end the surface with its samples of colour is the largest."""
    return max(carving_memory(work), work.faces * (195 + 70 * work.part) + 2 * work.brick_map)


def sweep_memory(work: Workload) -> float:
    """Return what the methods take that sweep a plane through the volume: all pictures, and a layer at a time."""
    return max(carving_memory(work), 40 * work.sampled + 180 * work.faces + 2 * work.brick_map)


def sight_memory(work: Workload) -> float:
    """Return what the methods take that follow the ray of every pixel that shows the object."""
    return max(carving_memory(work), 240 * work.sampled + 65 * work.faces + 2 * work.brick_map)


def probability_memory(work: Workload) -> float:
    """Return what probabilistic carving takes: for every voxel near the surface a message of every view."""
    listed = min(12 * work.faces, work.occupied)
    return max(carving_memory(work), listed * (200 + 8 * work.views) + 40 * work.sampled)


def measuring_memory(work: Workload) -> float:
    """Return what the methods take that measure points: the points and depth maps of all views, then voxels of them."""
    return 8 * work.pixels + (52 + 270 / max(work.views, 1)) * work.inside + 240 * work.faces


@dataclass(frozen=True)
class Forecast:
    """The memory that a method takes, by the number of voxels.

    Parameters
    ----------
    memory : callable
        See `MemoryOf`.
    grid_of : callable
        The grid for a number of voxels along the longest side.
    sample : Workload
        The work in a coarse grid, `_ACROSS` voxels a side.
    """

    memory: MemoryOf
    grid_of: Callable[[int], VoxelGrid]
    sample: Workload

    @classmethod
    def of(cls, memory: MemoryOf, scan: Scan, grid_of: Callable[[int], VoxelGrid], options: Mapping[str, Value], *,
           measures: bool = False) -> Forecast:
        """Look at a scan, and at its silhouettes if it has them.

        Parameters
        ----------
        options : mapping
            The method's.
        measures : bool
            Whether the method measures points first, and makes voxels of these.
        """
        pixels = sum(view.camera.size[0] * view.camera.size[1] for view in scan.views)
        most = Workload.most(grid_of(_ACROSS).shape, len(scan.views), pixels)
        masks = [view.mask for view in scan.views if view.mask is not None]
        if measures or len(masks) < len(scan.views):
            inside = sum(map(np.count_nonzero, masks)) if masks else _lit_share(scan) * pixels
            return cls(memory, grid_of, replace(most, inside=int(inside)))
        grid = grid_of(_ACROSS)
        most = replace(most, inside=sum(map(np.count_nonzero, masks)))
        hull = whole_box(grid) if options.get("start") == "box" else _coarse_hull(scan, grid, int(options.get("tolerance", 0)))
        span = np.median([voxel_in_pixels(view.camera, corners_of(grid), grid.voxel_size) for view in scan.views])
        return cls(memory, grid_of, replace(most, faces=float(len(extract_surface(hull).quads)), occupied=hull.count(), span=float(span)))

    def bytes(self, voxels: int) -> int:
        """Return the memory that the work takes at its peak, besides what is taken before it."""
        sample, finer = self.sample, voxels / _ACROSS
        return int(_BASE + self.memory(replace(sample, shape=self.grid_of(voxels).shape, faces=sample.faces * finer ** 2,
                                               occupied=sample.occupied * finer ** 3, span=sample.span / finer)))

    def refuse_too_large(self, voxels: int) -> None:
        """Refuse a number of voxels that needs more memory than there is.

        Raises
        ------
        ScanstageError
            With the largest number that fits.
        """
        there = available_memory()
        if self.bytes(voxels) <= there:
            return
        fitting = bisect_right(range(1, voxels), there, key=self.bytes)  # before the first count that does not fit: the largest that does
        remedy = f"at most {fitting} fit" if fitting else "the pictures alone are too many or too large"
        raise ScanstageError(f"--voxels: {voxels} voxels a side may need {amount(self.bytes(voxels))} of memory and "
                             f"{amount(there)} are free; {remedy}")


def _coarse_hull(scan: Scan, grid: VoxelGrid, tolerance: int) -> SparseVolume:
    """Return the visual hull in a coarse grid."""
    views = [_reduced(view, grid) for view in scan.views]
    choice = {"rule": "center", "outside": "unknown"}
    return carve_silhouettes(silhouettes_of(views, **choice), grid, tolerance=tolerance, **choice)[0]


def _reduced(view: View, grid: VoxelGrid) -> View:
    """Return a view whose mask is as fine as a coarse grid can use."""
    span = voxel_in_pixels(view.camera, (grid.origin + grid.upper)[None] / 2, grid.voxel_size)
    if span <= _PIXELS:
        return view
    camera = view.camera.scaled(_PIXELS / span)
    # As `Camera.scaled` has it, the reduced picture may reach a part of a pixel beyond the whole one; nothing depends on it here.
    return replace(view, camera=camera, mask=cv2.resize(view.mask.astype(np.uint8), camera.size, interpolation=cv2.INTER_NEAREST) > 0,
                   contours=None)


def _lit_share(scan: Scan) -> float:
    """Return the share of a picture's pixels that a projector lights, by the first view that was taken under white and black; else 1."""
    for view in scan.views:
        white, black = (next((picture for picture in view.projected if picture.pattern.get("kind") == kind), None)
                        for kind in ("white", "black"))
        if white is not None and black is not None:
            gain = (white.read_image() - black.read_image()).mean(axis=2)
            return float(np.mean(gain >= CONTRAST))
    return 1.0
