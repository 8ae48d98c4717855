# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which voxel every pixel sees, kept up to date while the volume is carved.

Generalized voxel coloring renders item buffers again and again, or keeps a list of all surfaces along every ray (Culbertson,
Malzbender & Slabaugh, 1999). Here a pixel keeps its ray. When its voxel is carved, the ray walks on to the next one that is
there (Amanatides & Woo, 1987), so that visibility is exact at every moment, nothing is rendered twice, and the memory is
that of one item buffer: what layered depth images are made for, without the lists.
"""

from __future__ import annotations

import numpy as np

from .carving import Carving
from .footprints import Pictures, Samples, gather
from .volume import BRICK

NOTHING = 0  # the key of a place beyond the grid
CORE = 0.35  # voxels from its centre at which a ray must pass a voxel to tell its colour
RAYS_AT_ONCE = 1 << 15


class Sight:
    """The rays through the centres of all pixels that show the object, and what they see.

    Parameters
    ----------
    pictures : Pictures
    carving : Carving
        The volume that is seen. After voxels have been removed from it, call `look_on`.

    Attributes
    ----------
    rows : (m,) intp array
        The rays' pixels: rows of ``pictures.rgba``.
    view : (m,) int array
        Their views.
    keys : (m,) int64 array
        The voxels that they see, `NOTHING` where none.
    central : (m,) bool array
        Whether a ray passes its voxel's centre within `CORE`. A ray that cuts a corner may meet the real surface many voxels
        farther on, where that is nearly along the ray, and tells nothing about the voxel.
    """

    def __init__(self, pictures: Pictures, carving: Carving) -> None:
        self.pictures, self.carving = pictures, carving
        self.rows = np.flatnonzero(pictures.rgba[:, 3] > 0)
        self.view = np.searchsorted(pictures.offset, self.rows, side="right") - 1
        self._eyes, self._directions = pictures.centres.astype(np.float64), self._rays()
        self._voxels = np.zeros((len(self.rows), 3), np.int32)
        self.keys = np.full(len(self.rows), NOTHING, np.int64)
        self.central = np.zeros(len(self.rows), bool)
        self._enter()

    def seen(self) -> np.ndarray:
        """Return the keys of all voxels that any ray sees, sorted."""
        keys = np.unique(self.keys)
        return keys[keys != NOTHING]

    def look_on(self) -> np.ndarray:
        """Let the rays whose voxels have been removed walk on; return the keys of the voxels that they see now, sorted."""
        moving = np.flatnonzero((self.keys != NOTHING) & ~self.carving.occupied(self.keys))
        self._walk(moving)
        keys = np.unique(self.keys[moving])
        return keys[keys != NOTHING]

    def samples(self, keys: np.ndarray, *, extremes: bool = False, cells: bool = False) -> Samples:
        """Return what the pixels that see them show of voxels, given by their sorted keys.

        Parameters
        ----------
        keys : (n,) int64 array
        extremes, cells : bool
            Whether ``low`` and ``high`` are to be those of the single pixels, and whether to give sets of colours.
        """
        self.carving.forget()
        self.carving.enqueue(keys)
        rays = np.flatnonzero(self.central & self.carving.queued(self.keys))
        pair = self.view[rays] * len(keys) + np.searchsorted(keys, self.keys[rays])
        order = np.argsort(pair, kind="stable")
        pair, rows = pair[order], self.rows[rays[order]]
        starts = np.flatnonzero(np.diff(pair, prepend=-1))
        where = pair[starts]
        shape = len(self.pictures.cameras), len(keys)
        pixels = gather(self.pictures.rgba, rows)

        def spread(values: np.ndarray, dtype=np.float32) -> np.ndarray:
            out = np.zeros((shape[0] * shape[1], values.shape[1]), dtype)
            out[where] = values
            return out.reshape(*shape, -1)

        total = np.add.reduceat(pixels, starts, axis=0, dtype=np.float64) if len(starts) else np.zeros((0, 4))
        count = np.maximum(total[:, 3:], 1)
        mean = total / count
        square = np.add.reduceat(pixels[:, :3].astype(np.float64) ** 2, starts, axis=0) if len(starts) else np.zeros((0, 3))
        rgba = spread(mean)
        low = high = rgba[..., :3]
        if extremes:
            low, high = (spread(function.reduceat(pixels[:, :3], starts, axis=0)) for function in (np.minimum, np.maximum))
        sets = spread(np.bitwise_or.reduceat(self.pictures.cells[rows], starts, axis=0), np.uint64) if cells else None
        return Samples(rgba, low, high, spread(np.maximum(square / count - mean[:, :3] ** 2, 0)), spread(total[:, 3:])[..., 0], sets)

    def _rays(self) -> np.ndarray:
        """Return the directions (m, 3) of the rays, with unit depth, in voxels."""
        directions = np.empty((len(self.rows), 3))
        for number, (camera, start) in enumerate(zip(self.pictures.cameras, self.pictures.offset, strict=True)):
            own = slice(*np.searchsorted(self.view, (number, number + 1)))
            row, column = np.divmod(self.rows[own] - start, camera.size[0])
            pixel = np.column_stack((column + 0.5, row + 0.5, np.ones(len(row))))
            directions[own] = pixel @ np.linalg.inv(self.pictures.matrices[number, :, :3].astype(np.float64)).T
        return directions

    def _enter(self) -> None:
        """Put every ray into the first voxel of the grid that it meets, and let it walk to the first that is there."""
        shape = np.array(self.carving.grid.shape)
        for start in range(0, len(self.rows), RAYS_AT_ONCE):
            own = slice(start, start + RAYS_AT_ONCE)
            eye, direction = self._eyes[self.view[own]], self._directions[own]
            with np.errstate(divide="ignore", invalid="ignore"):
                first, second = -eye / direction, (shape - eye) / direction
            # Along the grid a ray is inside from ever and for ever, or never.
            enter, leave = np.nanmax(np.fmin(first, second), axis=1), np.nanmin(np.fmax(first, second), axis=1)
            enter = np.maximum(enter, 0)
            meets = np.flatnonzero(enter < leave)
            self._voxels[start + meets] = np.clip(np.floor(eye[meets] + enter[meets, None] * direction[meets]), 0, shape - 1)
            self.keys[start + meets] = self.carving.keys(self._voxels[start + meets])
        rays = np.flatnonzero(self.keys != NOTHING)
        self._judge_paths(rays)
        self._walk(rays[~self.carving.occupied(self.keys[rays])])

    def _walk(self, rays: np.ndarray) -> None:
        for start in range(0, len(rays), RAYS_AT_ONCE):
            moving = rays[start:start + RAYS_AT_ONCE]
            while len(moving):
                moving = self._step(moving)
            self._judge_paths(rays[start:start + RAYS_AT_ONCE])

    def _judge_paths(self, rays: np.ndarray) -> None:
        direction = self._directions[rays]
        across = np.cross(self._voxels[rays] + 0.5 - self._eyes[self.view[rays]], direction)
        self.central[rays] = (across ** 2).sum(axis=1) <= CORE ** 2 * (direction ** 2).sum(axis=1)

    def _step(self, rays: np.ndarray) -> np.ndarray:
        """Move rays into the next voxel, or out of an empty brick; return those that have not arrived."""
        voxels, direction, eye = self._voxels[rays], self._directions[rays], self._eyes[self.view[rays]]
        size = np.where(self.carving.nothing_near(self.keys[rays]), BRICK, 1)[:, None].astype(np.int32)
        corner = voxels // size * size
        forward = direction > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            time = (corner + size * forward - eye) / direction
        time[direction == 0] = np.inf
        axis, every = time.argmin(axis=1), np.arange(len(rays))
        reached = np.floor(eye + time[every, axis, None] * direction)
        voxels = np.clip(reached, corner, corner + size - 1).astype(np.int32)  # rounding must not lead out of the cell
        voxels[every, axis] = np.where(forward, corner + size, corner - 1)[every, axis]
        self._voxels[rays] = voxels
        self.keys[rays] = self.carving.keys(voxels)
        inside = (voxels[every, axis] >= 0) & (voxels[every, axis] < np.array(self.carving.grid.shape)[axis])
        self.keys[rays[~inside]] = NOTHING
        rays = rays[inside]
        return rays[~self.carving.occupied(self.keys[rays])]
