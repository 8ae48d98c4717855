# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the colour changes along the rows of a rectified picture, and by how much in each channel.

A change is told relative to the range of its channel nearby, so that a red surface, whose green is a quarter as strong, shows
the same steps as a white one. A channel without light has no say.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

_REACH = 33  # pixels along a row in which a channel takes on both its values: some stripes
_SMOOTHING = 0.8  # pixels
_LEAST_STEP = 0.3  # of a channel's range
_LEAST_GAP = 2  # pixels between borders
_SIDES = (1, 2, 3)  # pixels to either side: a step is the greatest difference over these


@dataclass(frozen=True)
class Edges:
    """Borders in a picture, row by row from left to right.

    Parameters
    ----------
    rows : (n,) int array
    columns : (n,) float array
        To a part of a pixel.
    steps : (n, 3) float array
        Change of red, green and blue from left to right, as a share of the channel's range nearby; NaN where a channel has
        too little light.
    """

    rows: np.ndarray
    columns: np.ndarray
    steps: np.ndarray


def relative_colors(image: np.ndarray, contrast: float) -> np.ndarray:
    """Return each channel (h, w, 3) as a share of its range along the row nearby, 0 to 1; NaN where that is below ``contrast``."""
    line = np.ones((1, _REACH), np.uint8)
    low, high = cv2.erode(image, line), cv2.dilate(image, line)
    span = high - low
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(span >= contrast, (image - low) / span, np.float32(np.nan))


def edges_of(image: np.ndarray, contrast: float) -> Edges:
    """Find the borders of a rectified picture.

    A border is where the gradient of the channels together is greatest; a parabola gives its place between pixels.

    Parameters
    ----------
    image : (h, w, 3) float32 array
    contrast : float
        Least range of a channel.
    """
    smooth = cv2.GaussianBlur(image, (0, 0), _SMOOTHING, sigmaY=1e-6) if image.size else image
    colors = relative_colors(smooth, contrast)
    known = np.nan_to_num(colors)
    slope = np.zeros_like(known)
    slope[:, 1:-1] = (known[:, 2:] - known[:, :-2]) / 2
    strength = np.sqrt((slope ** 2).sum(axis=2))
    peak = np.zeros(strength.shape, bool)
    middle = strength[:, 1:-1]
    peak[:, 1:-1] = (middle > strength[:, :-2]) & (middle >= strength[:, 2:])
    steps = _steps(colors)
    peak &= np.nan_to_num(np.abs(steps)).max(axis=2) >= _LEAST_STEP
    dilated = cv2.dilate(np.where(peak, strength, 0), np.ones((1, 2 * _LEAST_GAP + 1), np.uint8))
    rows, columns = np.nonzero(peak & (strength >= dilated))
    before, here, after = (strength[rows, columns + side] for side in (-1, 0, 1))
    bend = before - 2 * here + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, 1), 0)
    return Edges(rows, columns + np.clip(shift, -0.5, 0.5), steps[rows, columns])


def _steps(colors: np.ndarray) -> np.ndarray:
    """Return each channel's change (h, w, 3) across each pixel: the greatest, by size, over some distances to either side."""
    best = np.zeros_like(colors)
    for side in _SIDES:
        change = np.zeros_like(colors)
        change[:, side:-side] = colors[:, 2 * side:] - colors[:, :-2 * side]
        best = np.where(~(np.abs(change) <= np.abs(best)), change, best)  # NaN stays
    return best
