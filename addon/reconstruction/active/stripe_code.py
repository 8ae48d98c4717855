# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour stripes whose edges are told by their neighbours (Zhang, Curless & Seitz, 2002), and how well an edge fits.

Stripes have the corners of the RGB cube as colours, ``p``; edge j is the vector ``q[j] = p[j + 1] - p[j]``. Which channels flip
from stripe to stripe follows a De Bruijn sequence of five symbols, so that any three edges in a row are found only once.
"""

from __future__ import annotations

import numpy as np

WINDOW = 3
"""Edges in a row that tell where they are."""
FLIPS = (3, 5, 6, 7, 2)
"""The symbols: which channels flip, as bits. All but the last flip two or more, so that one channel's failure is no loss."""
EDGES = len(FLIPS) ** WINDOW
ALPHA, BETA = 0.1, 0.5
"""Shares of a whole step up to which a channel counts as still, and from which it counts as flipped."""


def de_bruijn(symbols: int, window: int) -> np.ndarray:
    """Return a cyclic sequence (symbols ** window,) that holds each word of ``window`` symbols once.

    The Lyndon words whose lengths divide the window's, in their order (Fredricksen & Maiorana, 1978).
    """
    word, sequence = [0], [0]
    while True:
        word = (word * window)[:window]  # the next Lyndon word, by Duval's algorithm
        while word and word[-1] == symbols - 1:
            word.pop()
        if not word:
            return np.array(sequence)
        word[-1] += 1
        if window % len(word) == 0:
            sequence += word


def stripe_colors(stripes: int = EDGES + 1) -> np.ndarray:
    """Return the colours (stripes, 3) of the code's first stripes, 0 or 1 a channel; at most ``EDGES + 1``."""
    flips = np.array(FLIPS)[de_bruijn(len(FLIPS), WINDOW)[:stripes - 1]]
    numbers = np.bitwise_xor.accumulate(np.concatenate(([1], flips)))
    return (numbers[:, None] >> np.arange(3)) & 1


def stripe_edges(stripes: int = EDGES + 1) -> np.ndarray:
    """Return the edges (stripes - 1, 3) between the stripes: -1, 0 or 1 a channel."""
    return np.diff(stripe_colors(stripes), axis=0)


def edge_scores(steps: np.ndarray, edges: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Return how well steps in a picture fit edges of the code: the paper's consistency, the least over the channels.

    Parameters
    ----------
    steps : (..., 3) array
        From one stripe to the next as a share of the whole step that the surface allows, by channel.
    edges : (m, 3) integer array
    alive : (..., 3) bool array
        Where a channel can be told. One that a saturated colour has killed would veto every edge; it is left out, and the
        window of the others decides. With fewer than two nothing fits.

    Returns
    -------
    scores : (..., m) float32 array
        From -1 to 1.
    """
    steps = np.asarray(steps, np.float32)[..., None, :]
    ramp = (np.abs(steps) - ALPHA) / (BETA - ALPHA)
    still, up, down = 1 - ramp, (steps - ALPHA) / (BETA - ALPHA), (-steps - ALPHA) / (BETA - ALPHA)
    fit = np.clip(np.concatenate((down, still, up), axis=-2), -1, 1)
    fit[~np.broadcast_to(alive[..., None, :], fit.shape)] = 1
    scores = np.minimum.reduce([fit[..., edges[:, channel] + 1, channel] for channel in range(3)])
    scores[alive.sum(axis=-1) < 2] = -1
    return scores
