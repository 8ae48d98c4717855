# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines of masks as closed polygons, in pixels: the centre of the top-left pixel is (0, 0).

A loop is an (n, 2) array of x, y; its last point joins its first. Loops together bound the region that is inside an odd
number of them: outlines, holes, and islands in holes.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from .arrays import expand

_PAIRS_AT_ONCE = 1 << 20
_SUBPIXEL_BITS = 8  # of OpenCV's fixed-point drawing


def trace_outlines(mask: np.ndarray) -> list[np.ndarray]:
    """Return the loops round the True pixels: marching squares (Lorensen & Cline, 1987, in the plane) at level one half.

    A loop goes midway between the centres of True and False pixels, so that an outline sampled at pixel centres is met
    without bias, and within half a pixel. Loops never touch: True pixels that meet at a corner only are separate.
    Beyond the picture all is False: a region that leaves the picture ends half a pixel beyond the outermost centres,
    where the picture ends.

    Parameters
    ----------
    mask : (h, w) bool array

    Returns
    -------
    list of (n, 2) float64 array
        Each turns the same way about what it encloses: True within, or a hole the other way round.
    """
    field = np.pad(mask, 1)
    pitch = 2 * field.shape[1]  # points are numbered on a lattice of half pixels
    corners = np.stack((field[:-1, :-1], field[:-1, 1:], field[1:, 1:], field[1:, :-1]))  # of each cell, going round
    y, x = np.nonzero(corners.any(axis=0) & ~corners.all(axis=0))
    corners = corners[:, y, x]
    middle = (2 * y + 1) * pitch + 2 * x + 1
    sides = np.stack((middle - pitch, middle + 1, middle + pitch, middle - 1))  # the point on side i, after corner i
    start, stop = [], []
    for side in range(4):
        first, second, third, fourth = np.roll(corners, -side, axis=0)
        enters = np.flatnonzero(~first & second)  # here a run of True corners begins; it ends at a later side
        leaves = (side + 1 + third[enters] + (third & fourth)[enters]) % 4
        start.append(sides[side, enters])
        stop.append(sides[leaves, enters])
    start, stop = np.concatenate(start), np.concatenate(stop)
    order = np.argsort(start)
    start, following = start[order], np.searchsorted(start[order], stop[order])
    points = np.stack((start % pitch, start // pitch), axis=1) / 2 - 1
    return [points[loop] for loop in _cycles(following)]


def _cycles(following: np.ndarray) -> list[np.ndarray]:
    """Return the cycles of a permutation, each as its members in order. By pointer doubling, not point by point."""
    count = len(following)
    rounds = range(int(count).bit_length())
    first, jump = np.arange(count), following.copy()
    for _ in rounds:
        first, jump = np.minimum(first, first[jump]), jump[jump]
    root = first == np.arange(count)
    remaining, jump = np.where(root, 0, 1), np.where(root, np.arange(count), following)
    for _ in rounds:
        remaining, jump = remaining + remaining[jump], jump[jump]
    remaining[root] = count  # a cycle begins with its root
    order = np.lexsort((-remaining, first))
    return np.split(order, np.flatnonzero(np.diff(first[order])) + 1) if count else []


def simplify(loops: Sequence[np.ndarray], tolerance: float) -> list[np.ndarray]:
    """Return the loops with fewer points (Douglas & Peucker, 1973); none crosses itself or another one.

    Parameters
    ----------
    loops : sequence of (n, 2) array
        That do not cross.
    tolerance : float
        Pixels. No given point is farther than this from what stands for its loop. A loop that would vanish, or cross
        another, is kept as it was.
    """
    if not tolerance:
        return list(loops)
    coarse = [cv2.approxPolyDP(loop.astype(np.float32)[:, None], tolerance, True)[:, 0].astype(np.float64) for loop in loops]
    keep = np.array([len(loop) < 3 for loop in coarse], bool)
    while True:
        chosen = [loop if whole else short for loop, short, whole in zip(loops, coarse, keep, strict=True)]
        wrong = crossing(chosen) & ~keep
        if not wrong.any():
            return chosen
        keep |= wrong


def crossing(loops: Sequence[np.ndarray]) -> np.ndarray:
    """Return (n,) bool: which loops cross or touch themselves or another one.

    Sides are compared where their ranges along x overlap: in time that grows with their number and with how many lie
    above one another.
    """
    found = np.zeros(len(loops), bool)
    if not len(loops):
        return found
    a, b = np.concatenate(loops), np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    owner = np.repeat(np.arange(len(loops)), [len(loop) for loop in loops])
    order = np.argsort(np.minimum(a[:, 0], b[:, 0]))
    a, b, owner = a[order], b[order], owner[order]
    low, high = np.minimum(a, b), np.maximum(a, b)
    overlapping = np.searchsorted(low[:, 0], high[:, 0], side="right") - np.arange(len(a)) - 1
    for i, offset in expand(overlapping, _PAIRS_AT_ONCE):
        j = i + 1 + offset
        near = (low[i, 1] <= high[j, 1]) & (low[j, 1] <= high[i, 1])
        i, j = i[near], j[near]
        apart = ~((a[i] == b[j]).all(axis=1) | (b[i] == a[j]).all(axis=1))  # a loop's neighbouring sides share a point
        i, j = i[apart], j[apart]
        meet = (_turn(a[i], b[i], a[j]) * _turn(a[i], b[i], b[j]) <= 0) & (_turn(a[j], b[j], a[i]) * _turn(a[j], b[j], b[i]) <= 0)
        found[owner[i[meet]]] = found[owner[j[meet]]] = True
    return found


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return (n,) the sign of the turn at b on the way from a to c."""
    u, v = b - a, c - a
    return np.sign(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def fill(loops: Sequence[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """Return the (height, width) bool mask of the pixels that the region within loops touches, for a picture of that size."""
    mask = np.zeros(size[::-1], np.uint8)
    scaled = [np.rint(loop * (1 << _SUBPIXEL_BITS)).astype(np.int32) for loop in loops]
    return cv2.fillPoly(mask, scaled, 1, cv2.LINE_8, _SUBPIXEL_BITS).astype(bool)


def centres_within(loops: Sequence[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """Return the (height, width) bool mask of the pixels with their centres inside an odd number of loops, for a picture of that size."""
    width, height = size
    a, b = np.concatenate(loops), np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    a, b = np.where(a[:, 1:] <= b[:, 1:], a, b), np.where(a[:, 1:] <= b[:, 1:], b, a)  # downward
    first, last = (np.clip(np.ceil(y), 0, height).astype(np.int64) for y in (a[:, 1], b[:, 1]))
    borders = np.zeros((height, width + 1), np.int32)
    for side, offset in expand(last - first, _PAIRS_AT_ONCE):
        row = first[side] + offset
        share = (row - a[side, 1]) / (b[side, 1] - a[side, 1])
        column = np.ceil(a[side, 0] + share * (b[side, 0] - a[side, 0]))
        np.add.at(borders, (row, np.clip(column, 0, width).astype(np.int64)), 1)
    return (np.cumsum(borders[:, :width], axis=1) & 1).astype(bool)
