# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The virtual light image: how far the object cannot stand in a light's rays, given one view of its shadow.

A light is taken for the centre of a virtual camera (Savarese, Andreetto, Rushmeier, Bernardini & Perona, 2007). R is a
volume that holds the object. The rule below says how far the light's rays are free of the object where they enter R.

The rule
--------
A point of R is *free* of the object if its pixel lies in the light's shadow and all of R in front of it is free: on its way
to the camera, and on its way to the light. The largest set of points of which this can be said is removed.

Why it is safe: suppose that the set held a part of the object. All that could hide a point of that part from the camera or
from the light belongs to the set as well. Work in the plane through the camera's centre, the light and such a part; take
the light ray nearest to the camera that meets one, and its first point u there. Nothing before u stops the light: u is lit.
What hides u from the camera would be of the object, on a light ray nearer still. So the camera sees u, lit, at a pixel that
shows shadow: a contradiction. Fewer shadow pixels, as of a shadow that was not found, make the set smaller.

The set is found from above. At first the rays of the light are free as far as their pixels show shadow; then the camera's
rays are followed through what is free, which shortens those of the light, until nothing changes. The lecture's sentence "a
voxel that lies in the shadow's image and in the virtual shadow's image is not part of the object", coded with two masks,
forgets what stands in front, and removes parts of the object. ``safe`` follows a light ray whose first point the camera
sees as long as its pixels show shadow: where two blockers leave a slit, through which the light meets a face that the camera
does not see, all that the camera does see may lie in shadow, and the face is cut (tests/.../test_shadow_carving.py).

What is sampled: R exactly at the centres of the pixels of both images (see `item_buffer`), and shadow at the camera's. A step
along a ray moves its pixel by less than one, and shadows are narrowed by a pixel beforehand. A ray may go one voxel beyond
what is free where it meets another's end, so that the samples of one surface do not stop each other.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..arrays import expand
from ..geometry import Camera, distort
from .item_buffer import pixel_rays
from .virtual_light import SeenSurface, VirtualLight

_POINTS = 1 << 20  # worked on together
_AHEAD = 8  # steps of a ray taken together
_FIRST_ASKED = 5  # of the rays that may meet a voxel


def free_depth(view: SeenSurface, light: SeenSurface, shadow: np.ndarray, entries: np.ndarray, voxel_size: float, *,
               strict: bool) -> np.ndarray:
    """Return up to which depth the light's rays are free of the object.

    Parameters
    ----------
    view, light : SeenSurface
        The same surface seen by the camera and by the light.
    shadow : (height, width) bool array
        The camera's pixels that see the surface in the light's shadow, and surely do.
    entries : (e,) int array
        The surface voxels at which rays may enter; the others' rays are not followed.
    voxel_size : float
    strict : bool
        Whether the rule is the one above; otherwise ``safe``.

    Returns
    -------
    (h, w) float32 array
        Per pixel of the virtual light image: at least the depth at which the volume begins.
    """
    rays = np.flatnonzero(light.items >= 0)
    rays = rays[np.isin(light.items.ravel().take(rays), entries, kind="table")]
    start, endless = light.depth.ravel().take(rays), np.full(len(rays), np.inf)
    out = _Paths(light.camera, rays, start, endless, view.camera, np.where(shadow, np.inf, -np.inf), voxel_size)
    free = light.depth.copy()
    free.ravel()[out.rays] = out.reached()
    if not (strict and len(out.rays)):
        return free
    asked, deepest = out.crossed()
    start = view.depth.ravel().take(asked)
    back = _Paths(view.camera, asked, start, np.maximum(deepest, start), light.camera, free + voxel_size, voxel_size)
    blocked = np.full(view.depth.shape, -np.inf, np.float32)
    blocked.ravel()[back.rays] = back.reached() + voxel_size
    # From above: at first all that lies in shadow counts as free, then ever less, until nothing contradicts anything.
    changed = asked
    while len(changed):
        shorter = out.shorten(blocked, changed)
        free.ravel()[out.rays[shorter]] = out.reached()[shorter]
        changed = out.rays[shorter]
        shorter = back.shorten(free + voxel_size, changed)
        blocked.ravel()[back.rays[shorter]] = back.reached()[shorter] + voxel_size
        changed = back.rays[shorter]
    return free


class _Paths:
    """Rays of one camera followed through the picture of another, in steps of less than a pixel and half a voxel.

    Parameters
    ----------
    camera : Camera
    rays : (n,) int array
        Flat pixels. A ray whose first step is beyond the limit has no path.
    start, stop : (n,) float array
        The depths, along the camera's axis, from which to which it is followed.
    other : Camera
    limit : (h, w) float array
        Per pixel of the other camera: how deep a ray may be there. Beyond the picture none is followed.
    voxel_size : float

    Attributes
    ----------
    rays : (m,) int array
        The pixels whose rays have paths.
    """

    def __init__(self, camera: Camera, rays: np.ndarray, start: np.ndarray, stop: np.ndarray, other: Camera, limit: np.ndarray,
                 voxel_size: float) -> None:
        # In the other camera's frame a ray's points are eye + own depth * way.
        eye, way = (other.R @ camera.centre + other.t)[:, None], other.R @ pixel_rays(camera, rays)
        turn, row, own = _turn(other, eye, way), np.arange(len(rays)), start.astype(np.float64)
        steps = [(np.zeros(0, np.intp), np.zeros(0, np.float32), np.zeros(0, np.intp), np.zeros(0, np.float32))]
        while len(row):
            stride = _strides(other, eye[2] + own * way[2], way[2], turn, voxel_size)
            depths = own[:, None] + stride[:, None] * np.arange(_AHEAD)
            x, y, z = (eye[axis] + depths * way[axis][:, None] for axis in range(3))
            pixels, inside = _pixels_of(other, x, y, z)
            on = np.logical_and.accumulate(inside & (z <= limit.ravel().take(pixels)) & (depths <= stop.take(row)[:, None]), axis=1)
            steps.append((np.broadcast_to(row[:, None], on.shape)[on], depths[on].astype(np.float32), pixels[on], z[on].astype(np.float32)))
            here = np.flatnonzero(on[:, -1])
            row, way, turn, own = row.take(here), way.take(here, axis=1), turn.take(here), (own + _AHEAD * stride).take(here)
        owner, own, pixels, depth = (np.concatenate(part) for part in zip(*steps, strict=True))
        order = np.argsort(owner, kind="stable")
        self._first = np.flatnonzero(np.diff(owner[order], prepend=-1))  # steps lie ray by ray
        self._end = np.append(self._first[1:], len(order))[:len(self._first)]
        self._own, self._pixels, self._depth = own[order], pixels[order], depth[order]
        kept = owner[order][self._first]
        self.rays, self._start = rays[kept], start[kept].astype(np.float32)
        self._by_pixel = np.argsort(self._pixels, kind="stable")
        self._sorted = self._pixels[self._by_pixel]

    def reached(self) -> np.ndarray:
        """Return the (m,) float32 depths of the paths' last steps; the start of a path that has lost its first."""
        return np.where(self._end > self._first, self._own.take(np.maximum(self._end - 1, 0)), self._start)

    def crossed(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels of the other camera that the paths cross, and how deep there at most."""
        first = np.flatnonzero(np.diff(self._sorted, prepend=-1))
        return self._sorted[first], np.maximum.reduceat(self._depth[self._by_pixel], first)

    def shorten(self, limit: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """End paths before steps that are beyond a limit now, where it has changed; return the numbers of those that are shorter.

        Parameters
        ----------
        limit : (h, w) float array
            Per pixel of the other camera; nowhere higher than before.
        pixels : (k,) int array
            The flat pixels at which it is lower.
        """
        begin, stop = np.searchsorted(self._sorted, pixels), np.searchsorted(self._sorted, pixels, side="right")
        before = self._end.copy()
        for which, position in expand(stop - begin, _POINTS):
            step = self._by_pixel.take(begin.take(which) + position)
            step = step[self._depth.take(step) > limit.ravel().take(self._pixels.take(step))]
            np.minimum.at(self._end, np.searchsorted(self._first, step, side="right") - 1, step)
        return np.flatnonzero(self._end < before)


def _strides(camera: Camera, z: np.ndarray, ahead: np.ndarray, turn: np.ndarray, voxel_size: float) -> np.ndarray:
    """Return how far rays at depths ``z`` (n,) of a camera may step, `_AHEAD` times, so that each step moves less than a pixel.

    A step of length d moves the pixel by ``turn`` d / (z z'), see `_turn`; ``ahead`` (n,) is how much z grows with d.
    """
    # Never more than half of the way to the camera's plane, so that the least depth on these steps is above 0.
    stride = np.minimum(voxel_size / 2, z / (2 * _AHEAD * np.maximum(-ahead, 1e-30)))
    least = z + _AHEAD * stride * np.minimum(ahead, 0)
    pixels = 0.5 if camera.distorted else 0.95  # a lens may stretch the picture
    return np.minimum(stride, pixels * least ** 2 / np.maximum(turn, 1e-30))


def _turn(camera: Camera, eye: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return how fast the pixels of points ``eye + depth * way`` (3, n) move.

    From one of them to another the pixel coordinate f x / z moves by f (x z' - x' z) / (z z'), and x z' - x' z is the
    difference of their depths times a number of the ray's own.
    """
    (ex, ey, ez), (wx, wy, wz) = eye, way
    return max(camera.K[0, 0] + abs(camera.K[0, 1]), camera.K[1, 1]) * np.maximum(np.abs(wx * ez - wz * ex), np.abs(wy * ez - wz * ey))


def _pixels_of(camera: Camera, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the flat pixels of points in a camera's frame, and whether they lie before it and in its picture."""
    ahead = z > 0
    inverse = 1.0 / np.where(ahead, z, 1.0)
    x, y = x * inverse, y * inverse
    if camera.distorted:
        x, y = np.moveaxis(distort(np.stack((x, y), axis=-1), camera.distortion), -1, 0)
    K, (width, height) = camera.K, camera.size
    column, row = np.rint(K[0, 0] * x + K[0, 1] * y + K[0, 2]), np.rint(K[1, 1] * y + K[1, 2])
    inside = ahead & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    return np.where(inside, row * width + column, 0).astype(np.intp), inside


def freed_points(free: np.ndarray, light: SeenSurface, spacing: float) -> np.ndarray:
    """Return points (3, n), in the object frame, along what the rays gained beyond their first hits, ``spacing`` apart in depth."""
    first = light.depth.ravel()
    gained = np.flatnonzero(free.ravel() > first)
    count = np.floor((free.ravel().take(gained) - first.take(gained)) / spacing).astype(np.int64) + 1
    rays, start = pixel_rays(light.camera, gained), first.take(gained).astype(np.float64)
    points = [light.camera.centre[:, None] + (start.take(ray) + step * spacing) * rays.take(ray, axis=1)
              for ray, step in expand(count, _POINTS)]
    return np.concatenate([np.zeros((3, 0)), *points], axis=1)


def wholly_free(free: np.ndarray, light: VirtualLight, centres: np.ndarray) -> np.ndarray:
    """Return (n,) bool: whether every ray through a voxel is free to beyond it.

    The rays are those through the pixels' centres; the voxel is grown by half the distance between them, so that each of
    its points has a ray beside it that is asked.

    Parameters
    ----------
    free : (h, w) float32 array
        From `free_depth`.
    light : VirtualLight
    centres : (n, 3) array
        The voxels'.
    """
    pixels, depth = light.camera.project(centres)
    nearest = np.clip(np.rint(pixels), 0, np.array(light.camera.size) - 1).astype(np.intp)  # no ray at the image's edge is free
    # Most voxels are decided by the least and by the greatest depth about them; the others ask their rays one by one.
    kernel = np.ones((2 * light.radius + 1,) * 2, np.uint8)
    column, row = nearest.T
    whole = cv2.erode(free, kernel, borderType=cv2.BORDER_REPLICATE)[row, column] > depth + light.half_depth
    rows = np.flatnonzero(~whole & (free[row, column] > depth - light.half_depth))
    whole[rows] = _rays_are_free(free, light, centres[rows], nearest[rows], depth[rows])
    return whole


def _rays_are_free(free: np.ndarray, light: VirtualLight, centres: np.ndarray, nearest: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return whether the rays that meet voxels, within the light's radius of their ``nearest`` pixels (n, 2), are free to behind them."""
    way = np.linalg.inv(light.camera.K @ light.camera.R)  # of a pixel (u, v, 1)
    offsets = _nearest_first(light.radius)
    rows = np.arange(len(centres))
    for around in (offsets[:_FIRST_ASKED], offsets[_FIRST_ASKED:]):  # what fails soon is asked no more
        parts = np.array_split(rows, 1 + len(rows) * len(around) // _POINTS)
        rows = np.concatenate([part[_free_around(free, light, way, around, centres[part], nearest[part], depth[part])] for part in parts])
    whole = np.zeros(len(centres), bool)
    whole[rows] = True
    return whole


def _free_around(free: np.ndarray, light: VirtualLight, way: np.ndarray, around: np.ndarray, centres: np.ndarray, nearest: np.ndarray,
                 depth: np.ndarray) -> np.ndarray:
    """Return (n,) bool: whether those of the rays at the offsets ``around`` (m, 2) that meet a voxel are free to behind it."""
    column, row = (nearest[:, None] + around).transpose(2, 0, 1)
    half = (light.half_edge + 0.5 * depth / light.camera.K[0, 0])[:, None]
    first, last = -np.inf, np.inf
    for axis in range(3):
        along = way[axis, 0] * column + way[axis, 1] * row + way[axis, 2]
        along = np.where(np.abs(along) < 1e-12, 1e-12, along)
        middle, spread = (centres[:, axis] - light.camera.centre[axis])[:, None] / along, half / np.abs(along)
        first, last = np.maximum(first, middle - spread), np.minimum(last, middle + spread)
    inside = (column >= 0) & (row >= 0) & (column < free.shape[1]) & (row < free.shape[0])
    reach = free[np.where(inside, row, 0), np.where(inside, column, 0)]
    return ((first > last) | (reach > last) | ~inside).all(axis=1)


def _nearest_first(radius: int) -> np.ndarray:
    """Return the offsets (m, 2) of a square of pixels about its middle, from there outward."""
    offsets = np.indices((2 * radius + 1,) * 2).reshape(2, -1).T - radius
    return offsets[np.argsort((offsets ** 2).sum(axis=1), kind="stable")]
