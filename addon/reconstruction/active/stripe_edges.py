# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Edges between stripes along the rows of a picture, and their match with the code."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .scanline_matching import match_in_passes
from .stripe_code import edge_scores, stripe_edges

_LEAST_STEP = 0.3  # of the whole step in one channel, for an edge
_RANGE = 2.5  # stripes on either side in which each channel is taken to be on and off once
_SLAB = 1 << 24  # scores at a time


@dataclass(frozen=True)
class Channels:
    """What of a surface's colour and of the camera's channels can be taken out of a picture.

    Light of primary j is seen by channel c as ``albedo_c X_cj``: with ``X_cc = 1`` the albedo is what channel c sees of its own
    primary, and the rest of the 3x3 matrix X, the cross-talk, is the ratio of two pictures, whatever the surface's colour.

    Parameters
    ----------
    black : (h, w, 3) array
    albedo : (h, w, 3) array
    crosstalk : (3, 3) array
    """

    black: np.ndarray
    albedo: np.ndarray
    crosstalk: np.ndarray

    @classmethod
    def measured(cls, primaries: np.ndarray, black: np.ndarray, contrast: float) -> Channels:
        """Find them from pictures (3, h, w, 3) under red, green and blue, and under none; X by the median over lit pixels."""
        seen = primaries - black
        albedo = np.stack([seen[channel, ..., channel] for channel in range(3)], axis=-1)
        lit = albedo > contrast
        crosstalk = np.eye(3)
        for channel in range(3):
            where = lit[..., channel]
            if where.any():
                crosstalk[channel] = np.median(seen[:, where, channel] / albedo[where, channel], axis=1)
        return cls(black, albedo, crosstalk)

    def corrected(self, image: np.ndarray, contrast: float) -> np.ndarray:
        """Return the light (h, w, 3) that fell on the surface, in the projector's channels: 1 is full power."""
        share = (image - self.black) / np.maximum(self.albedo, contrast)
        return cv2.transform(share.astype(np.float32), np.linalg.inv(self.crosstalk).astype(np.float32))


@dataclass(frozen=True)
class Edges:
    """Edges in the rows of a picture, row by row from left to right.

    Parameters
    ----------
    rows : (n,) int array
    places : (n,) array
        Columns with fractions.
    steps : (n, 3) array
        As `stripe_code.edge_scores` takes them.
    alive : (n, 3) bool array
    """

    rows: np.ndarray
    places: np.ndarray
    steps: np.ndarray
    alive: np.ndarray


def find_edges(image: np.ndarray, stripe: float, *, contrast: float, channels: Channels | None = None) -> Edges:
    """Find the edges along rows.

    Parameters
    ----------
    image : (h, w, 3) float32 array
    stripe : float
        How wide a stripe is about, in pixels.
    contrast : float
        Least range of a channel, of full scale, by which it can be told.
    channels : Channels, optional
        Otherwise a step is measured against the channel's range in a few stripes to either side.
    """
    if channels is None:
        window = np.ones((1, 2 * int(np.ceil(_RANGE * stripe)) + 1), np.uint8)
        whole = cv2.dilate(image, window) - cv2.erode(image, window)
        alive = whole >= contrast
    else:
        image, alive = channels.corrected(image, contrast), channels.albedo >= contrast
        whole = np.ones_like(image)
    half = int(np.clip(round(0.3 * stripe), 1, 2))
    steps = np.zeros_like(image)
    steps[:, half:-half] = image[:, 2 * half:] - image[:, :-2 * half]
    steps = np.where(alive, steps / np.maximum(whole, contrast), 0)
    strength = (steps ** 2).sum(axis=2)
    top = strength >= cv2.dilate(strength, np.ones((1, 2 * half + 1), np.uint8))
    top &= np.abs(steps).max(axis=2) >= _LEAST_STEP
    top[:, 1:] &= ~top[:, :-1]  # of a plateau its first
    top[:, :half + 1] = top[:, -half - 1:] = False
    rows, columns = np.nonzero(top)
    found = steps[rows, columns]
    return Edges(rows, columns + _offsets(image, whole, rows, columns, found, half), found, alive[rows, columns])


def _offsets(image: np.ndarray, whole: np.ndarray, rows: np.ndarray, columns: np.ndarray, steps: np.ndarray, half: int) -> np.ndarray:
    """Return where the middle of each edge is: the centroid of its slope, in the direction of its step."""
    reach = np.arange(-half, half + 1)
    samples = image[rows[:, None], columns[:, None] + reach] / np.maximum(whole[rows, columns], 1e-6)[:, None]
    slope = np.maximum((np.diff(samples, axis=1) * steps[:, None]).sum(axis=2), 0)
    return (slope * (reach[:-1] + 0.5)).sum(axis=1) / np.maximum(slope.sum(axis=1), 1e-12)


def match_edges(edges: Edges, stripes: int, *, passes: int = 8) -> np.ndarray:
    """Return the edge of the code (n,) of each edge in the picture, or -1: see `scanline_matching`."""
    match, code = np.full(len(edges.rows), -1), stripe_edges(stripes)
    if not match.size:
        return match
    _, line, counts = np.unique(edges.rows, return_inverse=True, return_counts=True)
    slot = np.arange(len(line)) - (np.cumsum(counts) - counts)[line]
    most = counts.max()
    slab = max(1, _SLAB // (most * len(code)))
    for first in range(0, len(counts), slab):
        chosen = (line >= first) & (line < first + slab)
        at = line[chosen] - first, slot[chosen]
        scores = np.full((min(slab, len(counts) - first), most, len(code)), -1, np.float32)
        scores[at] = edge_scores(edges.steps[chosen], code, edges.alive[chosen])
        match[chosen] = match_in_passes(scores, passes)[at]
    return match
