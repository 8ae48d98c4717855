# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where between its samples a stripe of light is brightest: across a picture, or through time."""

from __future__ import annotations

import numpy as np

ESTIMATORS = {
    "centroid": "The mean place of the light: least noise where the window holds the whole stripe",
    "gaussian": "A Gaussian through the three brightest samples",
    "parabola": "A parabola through the three brightest samples",
    "zero-crossing": "Where the smoothed derivative changes its sign",
}
_TINY = 1e-6


def peak_offsets(windows: np.ndarray, estimator: str) -> np.ndarray:
    """Return how far each window's peak lies from its middle sample, in samples.

    Parameters
    ----------
    windows : (2 k + 1, n) array
        Samples about the brightest one, which is in the middle, one column a window.
    estimator : str
        One of `ESTIMATORS`.

    Returns
    -------
    (n,) float64 array
        NaN where there is no peak.
    """
    windows = np.asarray(windows, np.float64)
    middle = len(windows) // 2
    functions = {"centroid": _centroid, "gaussian": _gaussian, "parabola": _parabola, "zero-crossing": _zero_crossing}
    return functions[estimator](windows, middle)


def centroid_deviations(windows: np.ndarray, noise: float) -> np.ndarray:
    """Return the expected standard deviation (n,) of the centroids of windows (2 k + 1, n) under additive noise, in samples."""
    places = np.arange(len(windows)) - len(windows) // 2
    light = (windows - windows.min(axis=0)).sum(axis=0, dtype=np.float64)  # numpy 1 would divide in single precision, numpy 2 would not
    return noise * np.sqrt((places ** 2).sum()) / np.maximum(light, _TINY)


def _centroid(windows: np.ndarray, middle: int) -> np.ndarray:
    light = windows - windows.min(axis=0)
    total = light.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (np.arange(len(windows)) - middle) @ light / np.where(total > 0, total, np.nan)


def _gaussian(windows: np.ndarray, middle: int) -> np.ndarray:
    # Above the background, as a Gaussian is; a sample at it would have no logarithm.
    light = np.maximum(windows[middle - 1:middle + 2] - windows.min(axis=0), _TINY)
    return _parabola(np.log(light), 1)


def _parabola(windows: np.ndarray, middle: int) -> np.ndarray:
    before, at, after = windows[middle - 1:middle + 2]
    bend = before - 2 * at + after
    return 0.5 * (before - after) / np.where(bend < 0, bend, np.nan)


def _zero_crossing(windows: np.ndarray, middle: int) -> np.ndarray:
    """Return where the difference of the sums on either side passes from rising to falling, nearest to the middle."""
    kernel = np.concatenate((-np.ones(max(middle // 2, 1)), [0], np.ones(max(middle // 2, 1))))
    reach = len(kernel) // 2
    padded = np.concatenate((np.repeat(windows[:1], reach, axis=0), windows, np.repeat(windows[-1:], reach, axis=0)))
    slope = sum(weight * padded[shift:shift + len(windows)] for shift, weight in enumerate(kernel))
    before, after = slope[:-1], slope[1:]
    falling = (before >= 0) & (after < 0)
    place = np.arange(len(windows) - 1)[:, None] - middle
    with np.errstate(invalid="ignore", divide="ignore"):
        crossing = np.where(falling, place + before / (before - after), np.inf)
    nearest = np.take_along_axis(crossing, np.abs(crossing).argmin(axis=0)[None], axis=0)[0]
    return np.where(np.isfinite(nearest), nearest, np.nan)
