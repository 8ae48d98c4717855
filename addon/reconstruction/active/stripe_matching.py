# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of the projector's borders each border of a picture is: dynamic programming over all rows at once (Zhang et al., 2002).

With ``s(i, j)`` the score of border i of a row being border j of the projector, the best score of the first i with the first j is

    S(i, j) = max(S(i - 1, j - 1) + s(i, j), S(i - 1, j), S(i, j - 1)),

so that borders may be left out on both sides, and a match that scores no more than 0 is never forced. For one i, the last term is a
running maximum along j, and rows do not know of each other: i is the only loop.

Ties: leaving out comes before matching, and of equally good j the least is taken.

One path keeps the stripes' order. A thin thing in front of a wall changes it; what one pass has matched is then taken out,
and what is left is matched again.
"""

from __future__ import annotations

import numpy as np

from .stripe_edges import Edges

ALPHA, BETA = 0.15, 0.5
"""Shares of a channel's range: below the first a change is noise, above the second it is a border's."""
_BYTES = 1 << 28  # of decisions kept at a time
_NEVER = np.float32(-1e9)


def match_borders(edges: Edges, borders: np.ndarray, *, passes: int = 4, run: int = 3) -> np.ndarray:
    """Return (n,) int: the projector's border that each border of a picture is, -1 for none.

    Parameters
    ----------
    edges : Edges
    borders : (m, 3) int array
        The changes of the channels across the projector's borders.
    passes : int
        The most passes; they end before when one finds no run.
    run : int
        A match counts if this many neighbouring borders of the projector, itself among them, are matched to neighbours in
        the picture: no shorter word of the code is unique.
    """
    found = np.full(len(edges.rows), -1)
    rows, start, count = np.unique(edges.rows, return_index=True, return_counts=True)
    if not len(rows):
        return found
    at_once = max(1, int(_BYTES // (count.max() * len(borders) * 5)))
    for first in range(0, len(rows), at_once):
        part = slice(first, first + at_once)
        index = start[part, None] + np.arange(count[part].max())
        there = np.arange(index.shape[1]) < count[part, None]
        index = np.minimum(index, len(edges.rows) - 1)
        scores = border_scores(borders, edges.steps[index])
        scores[~there] = _NEVER
        matched = match_rows(scores, passes=passes, run=run)
        found[index[there]] = matched[there]
    return found


def match_rows(scores: np.ndarray, *, passes: int, run: int) -> np.ndarray:
    """Return (r, i) int: for each row and each border in it the projector's border, -1 for none; ``scores`` (r, i, j) are changed."""
    found = np.full(scores.shape[:2], -1)
    for _ in range(passes):
        path, _ = best_path(scores)
        path = np.where(in_runs(path, run), path, -1)
        row, border = np.nonzero(path >= 0)
        if not len(row):
            break
        found[row, border] = path[row, border]
        scores[row, border] = _NEVER
        scores[row, :, path[row, border]] = _NEVER
    return found


def border_scores(borders: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the (r, i, m) float32 scores, -1 to 1, of borders with ``steps`` (r, i, 3) being those of the projector (m, 3).

    The least of the channels' says counts (Zhang et al., 2002, eq. 1); a channel without light, NaN, has none.
    """
    rising = np.clip((steps - ALPHA) / (BETA - ALPHA), -1, 1).astype(np.float32)
    falling = np.clip((-steps - ALPHA) / (BETA - ALPHA), -1, 1).astype(np.float32)
    level = np.clip(1 - (np.abs(steps) - ALPHA) / (BETA - ALPHA), -1, 1).astype(np.float32)
    says = np.stack((falling, level, rising))  # for a change of -1, 0 and 1
    says = np.where(np.isnan(says), np.float32(1), says)
    scores = np.full((*steps.shape[:2], len(borders)), 1, np.float32)
    for channel in range(3):
        np.minimum(scores, np.moveaxis(says[borders[:, channel] + 1, ..., channel], 0, -1), out=scores)
    scores[np.isnan(steps).sum(axis=-1) > 1] = _NEVER  # one channel alone tells too little
    return scores


def best_path(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the matches (r, i) int of the best path through each row, -1 for none, and its score (r,)."""
    rows, count, borders = scores.shape
    total = np.zeros((rows, borders + 1), np.float32)
    place = np.arange(borders + 1, dtype=np.int16)
    matched = np.empty((count, rows, borders + 1), bool)
    leftmost = np.empty((count, rows, borders + 1), np.int16)
    for i in range(count):
        through = np.full_like(total, -np.inf)
        np.add(total[:, :-1], scores[:, i], out=through[:, 1:])
        np.greater(through, total, out=matched[i])
        best = np.maximum.accumulate(np.maximum(through, total), axis=1)
        rises = np.ones(best.shape, bool)
        np.greater(best[:, 1:], best[:, :-1], out=rises[:, 1:])
        np.maximum.accumulate(np.where(rises, place, np.int16(0)), axis=1, out=leftmost[i])
        total = best
    path = np.full((rows, count), -1)
    row, j = np.arange(rows), np.full(rows, borders)
    for i in range(count - 1, -1, -1):
        j = leftmost[i, row, j].astype(np.int64)
        taken = matched[i, row, j]
        path[taken, i] = j[taken] - 1
        j = j - taken
    return path, total[:, -1]


def in_runs(path: np.ndarray, run: int) -> np.ndarray:
    """Return (r, i) bool: which matches belong to ``run`` or more neighbouring borders, in the picture as in the projector."""
    rows, count = path.shape
    follows = np.zeros((rows, count + 1), bool)
    follows[:, 1:count] = (path[:, 1:] == path[:, :-1] + 1) & (path[:, :-1] >= 0)
    place = np.arange(count)
    begin = np.maximum.accumulate(np.where(follows[:, :count], 0, place), axis=1)
    end = np.minimum.accumulate(np.where(follows[:, 1:], count, place)[:, ::-1], axis=1)[:, ::-1]
    return (path >= 0) & (end - begin + 1 >= run)
