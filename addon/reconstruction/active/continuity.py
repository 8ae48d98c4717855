# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels whose code is not certain, believed where it continues that of their neighbours.

Indirect light turns the coarse bits, under whose wide stripes it is not even, and a coarse bit that is wrong moves the code
by many columns. So a code that lies where the certain ones about it lead is right, however faint its bits were.
"""

from __future__ import annotations

import cv2
import numpy as np

from .correspondence import Decoded, Reason

_WINDOW = 7
_LEAST_NEIGHBOURS = 12
_TOLERANCE = 1.0  # cells of the code, from the plane and of the neighbours about it: they scatter by 0.3 where it is one
_MOST_ROUNDS = 32


def settle_by_neighbours(decoded: Decoded) -> Decoded:
    """Return a Gray code's map with those uncertain codes made valid that continue a plane through the valid ones about them.

    The plane is fitted by least squares to the valid codes in a window; what is settled in one round is a neighbour in the next.
    """
    position, reason = decoded.position, decoded.reason.copy()
    rows, columns = np.indices(position.shape, np.float32)
    tolerance = _TOLERANCE * np.sqrt(12) * decoded.sigma
    for _ in range(_MOST_ROUNDS):
        doubtful = reason == Reason.UNCERTAIN
        if not doubtful.any():
            break
        predicted, scatter = _continued(position, reason == Reason.VALID, rows, columns)
        settled = doubtful & (np.abs(position - predicted) <= tolerance) & (scatter <= tolerance)
        if not settled.any():
            break
        reason[settled] = Reason.VALID
    return Decoded(position, reason, decoded.sigma)


def _continued(position: np.ndarray, valid: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what the plane through the valid positions in each window has in its middle, and how they scatter about it.

    NaN where there are too few, or all on a line.
    """
    weight = valid.astype(np.float32)

    def total(values: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(values * weight, cv2.CV_64F, (_WINDOW, _WINDOW), normalize=False, borderType=cv2.BORDER_CONSTANT)

    count = np.maximum(total(np.ones_like(weight)), 1)
    x, y, z = (total(values) / count for values in (columns, rows, position))
    xx, yy, xy = total(columns * columns) / count - x * x, total(rows * rows) / count - y * y, total(columns * rows) / count - x * y
    xz, yz = total(columns * position) / count - x * z, total(rows * position) / count - y * z
    zz = total(position * position) / count - z * z
    determinant = xx * yy - xy * xy
    enough = (count >= _LEAST_NEIGHBOURS) & (determinant > 0.05)
    safe = np.where(enough, determinant, 1)
    a, b = (yy * xz - xy * yz) / safe, (xx * yz - xy * xz) / safe
    scatter = np.sqrt(np.maximum(zz - a * xz - b * yz, 0))
    return np.where(enough, z + a * (columns - x) + b * (rows - y), np.nan), scatter
