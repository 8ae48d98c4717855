# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Is a cube of voxels outside a silhouette, inside it, or partly both? The question that the octree asks of a view.

Exact sums
----------
Positions are whole numbers of *half voxels*, counted from the grid's lower corner: a voxel's centre is odd, a cell's
centre is any whole number. The rows of the projection matrix are rounded to multiples of a power of two so small (52
bits below the row's largest possible sum) that a sum of products is exact in float64 **in any order**. So a child may
take its parent's sum and add an offset, a brick may be carved on its own, and the result is that of a plain loop over
all voxels, bit for bit. The rounding moves a projection by less than 1e-7 pixel
at 4096 voxels and 4000 pixels a side.

Two rules
---------
``center``        a voxel is outside if the pixel under its centre is background.
``conservative``  a voxel is outside if its *footprint* - a box that bounds the projection of the whole cube - touches
                  background pixels only. No part of the true object is ever lost, whatever the voxel size.

Where a view cannot tell (beyond the picture, behind the camera, pixels marked unknown) a voxel is inside.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..geometry import Camera, VoxelGrid

OUTSIDE, MIXED, INSIDE = 0, 1, 2
RULES = {
    "conservative": "a voxel goes only if its whole footprint is background, so the true object is never cut",
    "center": "a voxel goes if the pixel under its centre is background: unbiased in volume, but may cut by half a voxel",
}
CHILD = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
"""(8, 3): the corner of a cell at which its child ``c`` lies."""

_CHUNK = 4096  # parents at a time: the arrays of their children stay in the processor's cache
_SLACK = 0.02  # px; far more than float64 loses in the bounds below
_REACH = 3  # px; a bound larger than this is looked up in an image of half the size
_LARGEST_REGION = 8  # pictures; where the volume projects to more (a near camera), its cells are clipped to the picture


def grid_projection(camera: Camera, grid: VoxelGrid, extent: int, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return the (3, 4) matrix that projects half-voxel positions exactly (see the module's docstring).

    Parameters
    ----------
    camera : Camera
        Without distortion.
    grid : VoxelGrid
    extent : int
        The largest half-voxel coordinate that will be projected.
    shift : (float, float)
        Added to the pixel coordinates.
    """
    half = grid.voxel_size / 2
    P = camera.P
    matrix = np.column_stack((P[:, :3] * half, P[:, :3] @ grid.origin + P[:, 3]))
    matrix[0] += shift[0] * matrix[2]
    matrix[1] += shift[1] * matrix[2]
    largest = np.abs(matrix) @ np.array([extent, extent, extent, 1.0])
    quantum = np.exp2(np.ceil(np.log2(largest)) - 52)[:, None]
    return np.round(matrix / quantum) * quantum


class SilhouetteTest:
    """One view's silhouette, ready to classify the cells of one grid.

    Parameters
    ----------
    camera : Camera
        In the object frame, without distortion.
    inside : (height, width) bool array
        True where the object may be: foreground, or unknown.
    grid : VoxelGrid
    extent : int
        Half-voxel coordinates run from 0 to this, cells that reach beyond the grid included.
    rule : {'conservative', 'center'}
    unknown_outside : bool
        Whether what lies beyond the picture is unknown (and so kept) or empty.
    """

    def __init__(self, camera: Camera, inside: np.ndarray, grid: VoxelGrid, extent: int, *, rule: str,
                 unknown_outside: bool) -> None:
        if camera.distorted:
            raise ValueError("the camera must be without distortion")
        self.conservative = rule == "conservative"
        matrix = grid_projection(camera, grid, extent)
        corners = np.column_stack((CHILD * float(extent), np.ones(8))) @ matrix.T
        self._ahead = 1e-9 * np.abs(corners[:, 2]).max()
        self._nearest = corners[:, 2].min()
        lower, upper = np.array([-1, -1]), np.array(inside.shape[::-1]) + 1
        self.clipped = True
        if self._nearest > self._ahead:
            box = corners[:, :2] / corners[:, 2:]
            self._spread = np.array([_spread(matrix, axis, np.array([box[:, axis].min(), box[:, axis].max()])).max() for axis in (0, 1)])
            margin = self._bound(1) + 1
            first, last = np.floor(box.min(0) - margin), np.ceil(box.max(0) + margin + 1)
            if np.prod(last - first) <= _LARGEST_REGION * inside.size:
                lower, upper, self.clipped = first.astype(int), last.astype(int), False
        self.corner = lower  # pixel that the region begins at
        self.region = _paste(inside, lower, upper, unknown_outside)
        self.matrix = grid_projection(camera, grid, extent, tuple(0.5 - lower))
        if not self.clipped:
            # The spread is convex in the pixel coordinate, so its chord over the region bounds it from above, and costs
            # two operations where the sum of absolute values costs eleven.
            ends = np.array([_spread(self.matrix, axis, np.array([0.0, side])) for axis, side in enumerate(self.region.shape[::-1])])
            self._chord = np.column_stack((ends[:, 0], (ends[:, 1] - ends[:, 0]) / self.region.shape[::-1]))
        self._codes: dict[int, tuple[np.ndarray, int]] = {}  # by cell size: the image, and how often it was halved
        self._integral = cv2.integral(self.region) if self.conservative or self.clipped else None

    def _bound(self, size: int) -> np.ndarray:
        """Return (2,) pixels: how far the voxels of a cell of ``size``, footprints included, project from its centre."""
        reach = size if self.conservative else size - 1
        return reach * self._spread / self._nearest + _SLACK

    def classify_children(self, parents: np.ndarray, size: int) -> np.ndarray:
        """Classify the eight children, of ``size`` voxels a side, of every parent.

        Parameters
        ----------
        parents : (3, n) float64 array
            Centres of cells of twice the size, in half voxels.
        size : int

        Returns
        -------
        (8, n) uint8 array
            ``OUTSIDE``, ``MIXED`` or ``INSIDE``, in the order of `CHILD`; never ``MIXED`` for single voxels.
        """
        offsets = ((2 * CHILD - 1) @ self.matrix[:, :3].T * size).T[:, :, None]
        bases = [row[:3] @ parents + row[3] for row in self.matrix]
        codes = np.empty((8, parents.shape[1]), np.uint8)
        for start in range(0, parents.shape[1], _CHUNK):
            part = slice(start, start + _CHUNK)
            u, v, w = (base[part] + offset for base, offset in zip(bases, offsets, strict=True))
            codes[:, part] = self._classify_clipped(u, v, w, size) if self.clipped else self._classify(u, v, w, size)
        return codes

    def _classify(self, u: np.ndarray, v: np.ndarray, w: np.ndarray, size: int) -> np.ndarray:
        """Classify cells by the code of the pixel under their centre. Overwrites u and v."""
        inverse = 1.0 / w
        u *= inverse
        v *= inverse
        image, shift = self._codes[size]
        if size > 1 or not self.conservative:
            return _look_up(image, shift, u, v)
        codes = _look_up(image, shift, u.copy(), v.copy())
        undecided = np.flatnonzero(codes == MIXED)
        u, v, w = (array.ravel()[undecided] for array in (u, v, w))
        codes.ravel()[undecided] = np.where(self._footprint_is_empty(u, v, w), OUTSIDE, INSIDE)
        return codes

    def _footprint_is_empty(self, u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Return whether all pixels that the footprints of voxels touch are background."""
        inverse = 1.0 / (w - np.abs(self.matrix[2, :3]).sum())
        stride = self.region.shape[1] + 1
        left, right, top, bottom = (np.floor(value + sign * (start + slope * value) * inverse)
                                    for value, (start, slope) in zip((u, v), self._chord, strict=True) for sign in (-1.0, 1.0))
        right += 1
        bottom += 1
        top *= stride
        bottom *= stride
        table = self._integral.ravel()
        corners = [table.take((row + column).astype(np.intp)) for row in (top, bottom) for column in (left, right)]
        return corners[3] - corners[2] == corners[1] - corners[0]

    def prepare(self, largest: int) -> None:
        """Make the images of codes for cells of ``largest`` voxels and all smaller ones.

        Must be called before `classify_children`, which then only reads.
        """
        if self.clipped or largest in self._codes:
            return
        levels = [self.region * 3]  # bit 1: some pixel is inside; bit 0: every pixel is
        size = 1
        if not self.conservative:
            self._codes[1], size = (self.region * INSIDE, 0), 2
        while size <= largest:
            reach = np.ceil(self._bound(size)).astype(int)
            shift = 0
            while -(-reach.max() >> shift) > _REACH and min(levels[shift].shape) > 1:
                shift += 1
                if shift == len(levels):
                    levels.append(_halved(levels[-1]))
            kernel = np.ones(2 * -(-reach[::-1] >> shift) + 1, np.uint8)
            self._codes[size] = cv2.dilate(levels[shift] >> 1, kernel) + cv2.erode(levels[shift] & 1, kernel), shift
            size *= 2

    def _classify_clipped(self, u: np.ndarray, v: np.ndarray, w: np.ndarray, size: int) -> np.ndarray:
        """Classify cells that may lie beyond the picture or behind the camera: cell by cell, by their own bounds."""
        reach = size if self.conservative else size - 1
        back = reach * np.abs(self.matrix[2, :3]).sum()
        codes = np.full(w.shape, INSIDE if size == 1 else MIXED, np.uint8)
        if size > 1:
            codes[w + back <= 0] = INSIDE
        ahead = w - back > self._ahead
        w = w[ahead]
        limits = []
        for axis, value in enumerate((u[ahead] / w, v[ahead] / w)):
            spread = _spread(self.matrix, axis, value) * reach / (w - back)
            limits += [np.clip(np.floor(value + bound), 0, self.region.shape[1 - axis] - 1).astype(np.intp) for bound in (-spread, spread)]
        left, right, top, bottom = limits[0], limits[1] + 1, limits[2], limits[3] + 1
        table = self._integral
        total = (table[bottom, right] - table[bottom, left]) - (table[top, right] - table[top, left])
        full = total == (right - left) * (bottom - top)
        codes[ahead] = np.where(total == 0, OUTSIDE, np.where(full | (size == 1), INSIDE, MIXED))
        return codes


def _spread(matrix: np.ndarray, axis: int, value: np.ndarray) -> np.ndarray:
    """Return the pixels, per half voxel and unit of depth, that a move along all axes can shift a pixel coordinate."""
    x, y, z = (np.abs(a - value * c) for a, c in zip(matrix[axis, :3], matrix[2, :3], strict=True))
    return x + y + z


def _paste(inside: np.ndarray, lower: np.ndarray, upper: np.ndarray, unknown_outside: bool) -> np.ndarray:
    """Return the uint8 picture of the pixels ``lower`` to ``upper``, of which the mask may cover any part."""
    region = np.full((upper - lower)[::-1], unknown_outside, np.uint8)
    height, width = inside.shape
    x0, y0 = np.maximum(lower, 0)
    x1, y1 = np.minimum(upper, (width, height))
    if x0 < x1 and y0 < y1:
        region[y0 - lower[1]:y1 - lower[1], x0 - lower[0]:x1 - lower[0]] = inside[y0:y1, x0:x1]
    return region


def _halved(level: np.ndarray) -> np.ndarray:
    """Return the image of half the size: bit 1 if some pixel of a 2x2 block is inside, bit 0 if every one is."""
    height, width = level.shape
    padded = np.pad(level, ((0, height % 2), (0, width % 2)), mode="edge")
    a, b, c, d = padded[::2, ::2], padded[1::2, ::2], padded[::2, 1::2], padded[1::2, 1::2]
    return ((a | b | c | d) & 2) | (a & b & c & d & 1)


def _look_up(image: np.ndarray, shift: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the pixels at floor(u), floor(v), in an image halved ``shift`` times. Overwrites u and v."""
    if shift:
        u *= 0.5 ** shift
        v *= 0.5 ** shift
    np.floor(u, out=u)
    np.floor(v, out=v)
    v *= image.shape[1]
    v += u
    return image.ravel().take(v.astype(np.intp))
