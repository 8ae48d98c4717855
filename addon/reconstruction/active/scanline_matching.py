# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Matching the edges of all scanlines with those of a code by dynamic programming (Zhang, Curless & Seitz, 2002, section 3).

``best[i, j]``, the best total of the first i edges in the picture and the first j of the code, is the greatest of
``best[i-1, j-1] + score``, ``best[i-1, j]`` and ``best[i, j-1]``. The last of these is a running maximum, so that one edge is a
step in numpy for all scanlines and all of the code at once.

Ties: the way back leaves out the picture's edge before the code's edge, and either before it matches the two. A match is
thus taken only where nothing else reaches the total; its score is positive, and a negative one is never forced.
"""

from __future__ import annotations

import numpy as np

from .stripe_code import WINDOW

_MOST_BYTES = 1 << 27  # of totals that the way back needs at a time
_MOST_PASSES = 8
_LONGEST_STEP = 2  # edges of the picture from one match of a run to the next
_SUPPORT = np.float32(0.5)  # of a neighbour's score


def match_scanlines(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the best monotone matching of each scanline.

    Parameters
    ----------
    scores : (lines, n, m) float32 array
        Of n edges in the picture with m of the code; what cannot match is below 0.

    Returns
    -------
    match : (lines, n) int array
        The code's edge, or -1.
    total : (lines,) float32 array
        Sum of the matches' scores.
    """
    lines, count, code = scores.shape
    match, total = np.full((lines, count), -1), np.zeros(lines, np.float32)
    slab = max(1, _MOST_BYTES // (4 * (count + 1) * (code + 1)))
    for first in range(0, lines, slab):
        part = slice(first, first + slab)
        match[part], total[part] = _match_slab(scores[part])
    return match, total


def _match_slab(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lines, count, code = scores.shape
    if not count or not code:
        return np.full((lines, count), -1), np.zeros(lines, np.float32)
    best = np.zeros((count + 1, lines, code + 1), np.float32)
    for i in range(count):
        here = best[i + 1, :, 1:]
        np.add(best[i, :, :-1], scores[:, i], out=here)
        np.maximum(here, best[i, :, 1:], out=here)
        np.maximum.accumulate(here, axis=1, out=here)
    match = np.full((lines, count), -1)
    line, i, j = np.arange(lines), np.full(lines, count), np.full(lines, code)
    while line.size:
        here = best[i, line, j]
        skip_edge = here == best[i - 1, line, j]
        skip_code = ~skip_edge & (here == best[i, line, j - 1])
        taken = ~(skip_edge | skip_code)
        match[line[taken], i[taken] - 1] = j[taken] - 1
        i, j = i - ~skip_code, j - ~skip_edge
        on = (i > 0) & (j > 0)
        line, i, j = line[on], i[on], j[on]
    return match, best[count, :, code]


def match_in_passes(scores: np.ndarray, passes: int = _MOST_PASSES) -> np.ndarray:
    """Match scanlines again and again, each time what is left: a thin thing in front, whose edges are out of order, is found late.

    Only runs of `WINDOW` matches or more with successive edges of the code are kept, and used up: they verify themselves.

    Parameters
    ----------
    scores : (lines, n, m) array
    passes : int
        At most; it ends before once nothing is found.

    Returns
    -------
    match : (lines, n) int array
        The code's edge, or -1.
    """
    scores = np.array(scores, np.float32)
    match = np.full(scores.shape[:2], -1)
    active = np.arange(len(scores))
    for _ in range(passes):
        found = runs_only(match_scanlines(supported(scores[active]))[0])
        lines, edges = np.nonzero(found >= 0)
        if not lines.size:
            break
        codes, where = found[lines, edges], active[lines]
        match[where, edges] = codes
        scores[where, edges], scores[where, :, codes] = -1, -1
        active = active[np.unique(lines)]
    return match


def supported(scores: np.ndarray) -> np.ndarray:
    """Return scores (lines, n, m) of which the positive ones gain by those before and after them in a run, a window at most.

    Not in the paper: at the ends of a scanline a few edges often fit edges of the code here and there as well as a run, and the
    total alone cannot choose.
    """
    fit = np.maximum(scores, 0)
    before, after = np.zeros_like(fit), np.zeros_like(fit)
    # From the far end of a window to the near one: what lies beyond counts only as far as what lies between fits.
    for _ in range(WINDOW - 1):
        before[:, 1:, 1:], before[:, 0], before[:, :, 0] = fit[:, :-1, :-1] * (1 + before[:, :-1, :-1]), 0, 0
        after[:, :-1, :-1], after[:, -1], after[:, :, -1] = fit[:, 1:, 1:] * (1 + after[:, 1:, 1:]), 0, 0
    return np.where(scores > 0, scores + _SUPPORT * (before + after), scores)


def runs_only(match: np.ndarray) -> np.ndarray:
    """Return matches (lines, n) without those in runs of fewer than `WINDOW` successive edges of the code.

    One edge without a match, such as a texture's, does not end a run; several do: they are another surface's.
    """
    lines, places = np.nonzero(match >= 0)
    codes, kept = match[lines, places], np.full(match.shape, -1)
    if not codes.size:
        return kept
    begins = np.concatenate(([True], (np.diff(lines) != 0) | (np.diff(codes) != 1) | (np.diff(places) > _LONGEST_STEP)))
    run = np.cumsum(begins) - 1
    long = np.bincount(run)[run] >= WINDOW
    kept[lines[long], places[long]] = codes[long]
    return kept
