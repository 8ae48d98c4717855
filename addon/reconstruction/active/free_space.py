# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxels from measured points: occupied where points lie, free where light was seen to pass.

A decoded pixel says more than where a point is: light came to it from the projector and went on to the camera, so both
segments are free (inverse ray tracing: Andreetto, Savarese & Perona). Each device's points, as it sees them, are a depth map;
a voxel is free if for some device it lies, with its whole footprint, before the points by more than a margin.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...progress import Progress, silent
from ..geometry import Camera, VoxelGrid
from ..points import PointCloud
from ..volumetric.coloring import SurfaceColors
from ..volumetric.surface import Surface, extract_surface
from ..volumetric.volume import BRICK, SparseVolume

MARGIN = 1.5
"""Voxels before a point that are not taken for free."""
FILLS = {"shell": "Voxels that hold points", "solid": "All voxels that no light was seen to pass, also those behind the surface"}
_HALF_DIAGONAL = np.sqrt(3) / 2
_POINTS_A_CELL = 2.0  # of a projector's depth map, on average where there are any
_CHUNK = 1 << 20  # voxels tested at a time


@dataclass(frozen=True)
class DepthMap:
    """How far a device's light goes until it meets a point.

    Parameters
    ----------
    camera : Camera
        In the object frame.
    depths : (h, w) float32 array
        Along its optical axis; 0 where nothing is known.
    """

    camera: Camera
    depths: np.ndarray


@dataclass(frozen=True)
class _FreeSpace:
    """What a device sees to be free, for voxels of one size.

    ``nearest`` (h, w) is the least depth in the footprint of a voxel that is at ``least`` from the device, or farther; 0 where
    something in the footprint is unknown. Voxels nearer than that are not judged.
    """

    camera: Camera
    nearest: np.ndarray
    least: float

    @classmethod
    def of(cls, map: DepthMap, grid: VoxelGrid) -> _FreeSpace:
        corners = np.stack(np.meshgrid(*np.stack((grid.origin, grid.upper), axis=-1)), axis=-1).reshape(-1, 3)
        known = map.depths[map.depths > 0]
        # Where the grid reaches up to the device, or behind it, the points tell what is a sensible distance.
        least = max(float(map.camera.project(corners)[1].min()), 0.5 * float(known.min()) if known.size else np.inf)
        radius = _HALF_DIAGONAL * grid.voxel_size * max(map.camera.K[0, 0], map.camera.K[1, 1]) / least
        window = np.ones((2 * int(np.ceil(min(radius, max(map.camera.size)))) + 1,) * 2, np.uint8)
        # Beyond the picture nothing is known either.
        return cls(map.camera, cv2.erode(map.depths, window, borderType=cv2.BORDER_CONSTANT, borderValue=0), least)

    def holds(self, centres: np.ndarray, margin: float) -> np.ndarray:
        """Return (n,) bool: which voxels, by their (n, 3) centres, lie before the points by more than a margin."""
        pixels, depth = self.camera.project(centres)
        width, height = self.camera.size
        judged = (depth >= self.least) & (pixels > -0.5).all(axis=1) & (pixels[:, 0] < width - 0.5) & (pixels[:, 1] < height - 0.5)
        column, row = np.rint(pixels[judged]).astype(np.intp).T
        free = np.zeros(len(centres), bool)
        free[judged] = depth[judged] + margin < self.nearest[row, column]
        return free


def depth_map_of(camera: Camera, depths: np.ndarray) -> DepthMap:
    """Return the depth map of a camera's own pixels (h, w), without the pixels that would end in holes of a pixel or two."""
    known = depths > 0
    # Single pixels without a point, on the borders of columns, must not keep what all round them see to be free; the
    # nearer neighbour stands in for them.
    far = np.where(known, depths, np.inf).astype(np.float32)
    filled = cv2.erode(far, np.ones((3, 3), np.uint8))
    enough = cv2.boxFilter(known.astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT) >= 6
    return DepthMap(camera, np.where(known, depths, np.where(enough & np.isfinite(filled), filled, 0)).astype(np.float32))


def projector_depths(projector: Camera, points: np.ndarray) -> DepthMap:
    """Return how a projector sees points (n, 3): the nearest in each cell of a picture as coarse as the points are many."""
    pixels, depth = projector.project(points)
    width, height = projector.size
    front = (depth > 0) & (pixels > -0.5).all(axis=1) & (pixels[:, 0] < width - 0.5) & (pixels[:, 1] < height - 0.5)
    pixels, depth = pixels[front], depth[front]
    area = float(np.prod(np.ptp(pixels, axis=0) + 1)) if len(pixels) else 1.0
    factor = float(np.clip(np.sqrt(len(pixels) / (_POINTS_A_CELL * area)), 1 / min(width, height), 1))
    coarse = projector.scaled(factor)
    column, row = np.floor((pixels + 0.5) * factor).astype(np.int64).T
    cell = np.minimum(row, coarse.size[1] - 1) * coarse.size[0] + np.minimum(column, coarse.size[0] - 1)
    depths = np.full(coarse.size[0] * coarse.size[1], np.inf)
    np.minimum.at(depths, cell, depth)
    return depth_map_of(coarse, np.where(np.isfinite(depths), depths, 0).reshape(coarse.size[::-1]).astype(np.float32))


def occupied(cloud: PointCloud, depths: Sequence[DepthMap], grid: VoxelGrid, *, fill: str, margin: float = MARGIN,
             progress: Progress = silent) -> tuple[SparseVolume, np.ndarray]:
    """Return the voxels that points, and free space, leave.

    Parameters
    ----------
    cloud : PointCloud
        Within the grid.
    depths : sequence of DepthMap
    grid : VoxelGrid
    fill : {'shell', 'solid'}
        Voxels that hold points; or all that are not free, a conservative volume, of which points only make the surface.
    margin : float
        Voxels before a point that are not taken for free.

    Returns
    -------
    volume : SparseVolume
    stray : (n,) bool array
        Points in voxels that another view sees through: wrong ones.
    """
    voxels = np.clip(np.floor((cloud.positions - grid.origin) / grid.voxel_size).astype(np.int64), 0, np.array(grid.shape) - 1)
    spaces = [_FreeSpace.of(map, grid) for map in depths]
    index, member = np.unique(np.ravel_multi_index(tuple(voxels.T), grid.shape), return_inverse=True)
    held = np.stack(np.unravel_index(index, grid.shape), axis=-1)
    free = _free(spaces, grid, held, margin)
    if fill == "shell":
        kept = held[~free]
        return SparseVolume.from_slabs(grid, _slabs_of(kept, grid)), free[member]
    return SparseVolume.from_slabs(grid, _unseen_slabs(spaces, grid, margin, progress)), free[member]


def _free(spaces: Sequence[_FreeSpace], grid: VoxelGrid, voxels: np.ndarray, margin: float) -> np.ndarray:
    """Return (n,) bool: the voxels (n, 3) that some device sees through."""
    free = np.zeros(len(voxels), bool)
    for space in spaces:
        left = np.flatnonzero(~free)
        for start in range(0, len(left), _CHUNK):
            part = left[start:start + _CHUNK]
            free[part] = space.holds(grid.centres(voxels[part]), margin * grid.voxel_size)
    return free


def _slabs_of(voxels: np.ndarray, grid: VoxelGrid) -> Iterator[np.ndarray]:
    """Yield occupancy in slabs of 8 layers from the indices (n, 3) of occupied voxels, which are ordered by x."""
    ends = np.searchsorted(voxels[:, 0], np.arange(0, grid.shape[0] + BRICK, BRICK))
    for slab, start in enumerate(range(0, grid.shape[0], BRICK)):
        cells = np.zeros((min(BRICK, grid.shape[0] - start), *grid.shape[1:]), bool)
        x, y, z = voxels[ends[slab]:ends[slab + 1]].T
        cells[x - start, y, z] = True
        yield cells


def _unseen_slabs(spaces: Sequence[_FreeSpace], grid: VoxelGrid, margin: float, progress: Progress) -> Iterator[np.ndarray]:
    for start in range(0, grid.shape[0], BRICK):
        progress(start / grid.shape[0], "Carving free space")
        layers = min(BRICK, grid.shape[0] - start)
        cells = np.indices((layers, *grid.shape[1:])).reshape(3, -1).T + (start, 0, 0)
        yield ~_free(spaces, grid, cells, margin).reshape(layers, *grid.shape[1:])


def colored_surface(volume: SparseVolume, cloud: PointCloud) -> tuple[Surface, SurfaceColors | None]:
    """Return a volume's surface, and the mean colour of the points in each of its voxels, where all of them hold points."""
    surface, grid = extract_surface(volume), volume.grid
    voxels = np.floor((cloud.positions - grid.origin) / grid.voxel_size).astype(np.int64)
    inside = ((voxels >= 0) & (voxels < grid.shape)).all(axis=1)
    theirs = np.ravel_multi_index(tuple(voxels[inside].T), grid.shape)
    ours = np.ravel_multi_index(tuple(surface.voxels.T), grid.shape)
    order = np.argsort(ours)
    place = np.minimum(np.searchsorted(ours, theirs, sorter=order), max(len(ours) - 1, 0))
    row = order[place] if len(ours) else place
    match = ours[row] == theirs if len(ours) else np.zeros(0, bool)
    count = np.bincount(row[match], minlength=len(ours))
    if not (count > 0).all():
        return surface, None
    rgb = np.stack([np.bincount(row[match], cloud.colors[inside][match, channel], minlength=len(ours)) for channel in range(3)], axis=-1)
    return surface, SurfaceColors((rgb / count[:, None]).astype(np.float32), np.minimum(count, 65535).astype(np.uint16))
