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

_REACH = 3  # pixels of the window on either side
_LEAST_NEIGHBOURS = 12
_LEAST_SPREAD = 0.05  # of the neighbours about their line, in squared pixels: on a line there is no plane
_TOLERANCE = 1.0  # cells of the code, from the plane and of the neighbours about it: they scatter by 0.3 where it is one
_MOST_ROUNDS = 32
_CHUNK = 1 << 16  # pixels whose windows are in memory together


def settle_by_neighbours(decoded: Decoded) -> Decoded:
    """Return a Gray code's map with those uncertain codes made valid that continue a plane through the valid ones about them.

    The plane is fitted by least squares to the valid codes in a window; what is settled in one round is a neighbour in the next.
    """
    # A frame of pixels without a code, so that no window leaves the picture.
    position, reason = (np.pad(values, _REACH, constant_values=value)
                        for values, value in ((decoded.position, 0), (decoded.reason, np.uint8(Reason.UNLIT))))
    tolerance = _TOLERANCE * np.sqrt(12) * decoded.sigma
    for _ in range(_MOST_ROUNDS):
        valid = (reason == Reason.VALID).astype(np.uint8)
        neighbours = cv2.boxFilter(valid, cv2.CV_16U, (2 * _REACH + 1,) * 2, normalize=False, borderType=cv2.BORDER_CONSTANT)
        pixels = np.flatnonzero((reason == Reason.UNCERTAIN) & (neighbours >= _LEAST_NEIGHBOURS))
        settled = [part[_continues(position, valid, part, tolerance)] for part in np.split(pixels, range(_CHUNK, len(pixels), _CHUNK))]
        if not any(map(len, settled)):
            break
        reason.ravel()[np.concatenate(settled)] = Reason.VALID
    inner = slice(_REACH, -_REACH)
    return Decoded(decoded.position, np.ascontiguousarray(reason[inner, inner]), decoded.sigma)


def _continues(position: np.ndarray, valid: np.ndarray, pixels: np.ndarray, tolerance: float) -> np.ndarray:
    """Return (n,) bool: whether pixels, by their flat indices, lie on the plane through the valid positions about them."""
    down, across = (place.ravel() for place in np.mgrid[-_REACH:_REACH + 1, -_REACH:_REACH + 1])
    around = pixels[:, None] + down * position.shape[1] + across
    weight = valid.ravel()[around].astype(np.float64)
    height = weight * (position.ravel()[around] - position.ravel()[pixels][:, None])  # above the pixel's own: small numbers
    count = weight.sum(axis=1)
    x, y, z = weight @ across / count, weight @ down / count, height.sum(axis=1) / count
    xx, yy, xy = (weight @ (a * b) / count - c * d for a, b, c, d in ((across, across, x, x), (down, down, y, y), (across, down, x, y)))
    xz, yz, zz = height @ across / count - x * z, height @ down / count - y * z, (height ** 2).sum(axis=1) / count - z * z
    determinant = xx * yy - xy * xy
    enough = determinant > _LEAST_SPREAD
    safe = np.where(enough, determinant, 1)
    a, b = (yy * xz - xy * yz) / safe, (xx * yz - xy * xz) / safe
    scatter = np.sqrt(np.maximum(zz - a * xz - b * yz, 0))
    return enough & (np.abs(z - a * x - b * y) <= tolerance) & (scatter <= tolerance)
