# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""When a shadow that sweeps over the scene reaches each pixel, and where its edge is in each picture.

After Bouguet & Perona ("3D photography on your desk", 1998): a pixel's threshold lies halfway between its brightest and its
darkest value over all pictures, so that neither paint nor shading matters. Both edges are the leading one, where the shadow arrives.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

_NEAR = 1.5  # frames by which an edge in a picture may miss the time at which its pixel is known to darken


@dataclass(frozen=True)
class Range:
    """The extremes of each pixel over a sweep.

    Parameters
    ----------
    middle, contrast : (h, w) float32 arrays
        Mean and difference of the brightest and the darkest value.
    darkest : (h, w) int32 array
        Number of the darkest frame.
    """

    middle: np.ndarray
    contrast: np.ndarray
    darkest: np.ndarray


def pixel_ranges(images: Iterable[np.ndarray]) -> Range:
    """Find each pixel's extremes; one picture is in memory at a time."""
    for frame, image in enumerate(images):
        if frame == 0:
            low, high, darkest = image.copy(), image.copy(), np.zeros(image.shape, np.int32)
        darker = image < low
        np.copyto(low, image, where=darker)
        np.copyto(darkest, frame, where=darker)
        np.maximum(high, image, out=high)
    return Range((low + high) / 2, high - low, darkest)


def arrival_times(images: Iterable[np.ndarray], ranges: Range) -> tuple[np.ndarray, np.ndarray]:
    """Find when each pixel's value falls through its middle: the last time before it is darkest.

    Two pictures are in memory at a time.

    Returns
    -------
    time : (h, w) float32 array
        Frame number with a fraction; nan where the sweep begins when the pixel is dark already.
    drop : (h, w) float32 array
        By how much the value falls from the frame before that time to the one after it.
    """
    time = np.full(ranges.middle.shape, np.nan, np.float32)
    drop = np.zeros(ranges.middle.shape, np.float32)
    before = None
    for frame, image in enumerate(images):
        above = image - ranges.middle
        if before is not None:
            rows, columns = np.nonzero((before >= 0) & (above < 0) & (frame <= ranges.darkest))
            falls = before[rows, columns] - above[rows, columns]
            time[rows, columns] = frame - 1 + before[rows, columns] / falls
            drop[rows, columns] = falls
        before = above
    return time, drop


def leading_edge(above: np.ndarray, time: np.ndarray, frame: int) -> np.ndarray:
    """Find where the shadow's leading edge crosses the rows of a strip in one picture.

    Parameters
    ----------
    above : (h, w) array
        The strip's values less their middles; nan where there is no contrast.
    time : (h, w) array
        As from `arrival_times`: it tells the leading edge from the trailing one, and which way the shadow moves.
    frame : int

    Returns
    -------
    (n, 2) array
        Column, with a fraction, and row in the strip: at most one edge a row.
    """
    left, right = above[:, :-1], above[:, 1:]
    with np.errstate(invalid="ignore"):
        crosses = ((left < 0) != (right < 0)) & np.isfinite(left) & np.isfinite(right)
        dark = np.where(left < 0, time[:, :-1], time[:, 1:])
        lit = np.where(left < 0, time[:, 1:], time[:, :-1])
        crosses &= (dark <= frame) & (frame <= lit) & (lit - dark <= 2 * _NEAR) & (frame - dark <= _NEAR)
    steepness = np.where(crosses, np.abs(right - left), 0)
    column = steepness.argmax(axis=1)
    rows = np.flatnonzero(crosses.any(axis=1))
    column = column[rows]
    first, second = left[rows, column], right[rows, column]
    return np.column_stack((column + first / (first - second), rows))
