# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The board's corners in a projector's own pixels, by local homographies (Moreno & Taubin, 2012).

A projector sees nothing, but a decoded code says which of its pixels lights each pixel of the camera: only in whole numbers,
and nowhere exactly at a corner. Over a patch of a plane the two pictures are related by a homography, whatever the lenses do
to the rest of the picture, so one fitted to the few hundred pixels round a corner carries the corner over.
"""

from __future__ import annotations

import cv2
import numpy as np

from .board import spacing

LEAST_PIXELS = 50
_LEAST_INLIERS = 0.6  # of a window's pixels: with fewer it is the code that is wrong, or a second surface that is seen
_TOLERANCE = 1.5  # projector pixels; rounding to whole pixels alone is off by up to 0.71
_LEAST_INSIDE = 0.25  # of a window's half side, or of a square: how far a corner lies within the pixels that carry it
_MOST_SQUARES = 3.0
_MOST_PIXELS = 10_000  # of a window; of more, every n-th is taken


def projector_corners(pixels: np.ndarray, decoded: np.ndarray, squares: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Carry corners from the camera's picture into the projector's.

    Parameters
    ----------
    pixels : (n, 2) array
        The corners in the camera's picture.
    decoded : (height, width, 2) array
        Column and row of the projector at each pixel of the camera; NaN where they are not known.
    squares : float
        Side of the window round each corner, in squares of the board. It grows to at most three where it holds fewer than 50
        decoded pixels.

    Returns
    -------
    known : (n,) bool array
        Which corners could be carried over.
    corners : (k, 2) array
        Those, in the projector's pixels.
    """
    found = [_carried(pixel, decoded, side, squares) for pixel, side in zip(pixels, spacing(pixels), strict=True)]
    known = np.array([corner is not None for corner in found], dtype=bool)
    return known, np.array([corner for corner in found if corner is not None]).reshape(-1, 2)


def _carried(pixel: np.ndarray, decoded: np.ndarray, side: float, squares: float) -> np.ndarray | None:
    """Return one corner in the projector's pixels, or None where the code round it does not say."""
    while True:
        half = squares * side / 2
        seen, lit = _window(pixel, decoded, half)
        if len(seen) >= LEAST_PIXELS or squares >= _MOST_SQUARES:
            break
        squares *= 1.25
    if len(seen) < LEAST_PIXELS or not _surrounded(pixel, seen, _LEAST_INSIDE * min(half, side)):
        return None
    _, inliers = cv2.findHomography(seen - pixel, lit, cv2.RANSAC, _TOLERANCE)
    if inliers is None or inliers.mean() < _LEAST_INLIERS:
        return None
    H, _ = cv2.findHomography((seen - pixel)[inliers.ravel() > 0], lit[inliers.ravel() > 0], 0)  # RANSAC's own stops too early
    return None if H is None or H[2, 2] == 0 else H[:2, 2] / H[2, 2]


def _surrounded(pixel: np.ndarray, seen: np.ndarray, least: float) -> bool:
    """Return whether a corner lies within the pixels (m, 2), ``least`` from their hull: beyond it would be extrapolated."""
    return cv2.pointPolygonTest(cv2.convexHull(seen.astype(np.float32)), pixel.tolist(), True) >= least


def _window(pixel: np.ndarray, decoded: np.ndarray, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the decoded pixels (m, 2) round a corner, and the projector's (m, 2) that light them."""
    size = np.array(decoded.shape[1::-1])
    left, top = np.clip(np.floor(pixel - half), 0, size).astype(int)
    right, bottom = np.clip(np.ceil(pixel + half) + 1, 0, size).astype(int)
    part = decoded[top:bottom, left:right]
    row, column = np.nonzero(np.isfinite(part).all(axis=-1))
    every = slice(None, None, -(-len(row) // _MOST_PIXELS) or None)
    row, column = row[every], column[every]
    return np.column_stack((column + left, row + top)).astype(np.float64), part[row, column].astype(np.float64)
