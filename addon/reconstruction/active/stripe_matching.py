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
_BYTES = 1 << 28  # of scores kept at a time
_NEVER = np.float32(-1e9)
_BESIDE = 2  # pixels by which a border may move from row to row
_MOST_ROUNDS = 64  # rows that support is handed on over


def match_borders(edges: Edges, borders: np.ndarray, *, passes: int = 4, run: int = 5) -> np.ndarray:
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
        the picture. Words of `color_stripe_code.WINDOW` are unique; longer ones also survive noise. In later passes it is one
        more, since less is left that could contradict.
    """
    found, guessed = (np.full(len(edges.rows), -1) for _ in range(2))
    rows, start, count = np.unique(edges.rows, return_index=True, return_counts=True)
    if not len(rows):
        return found
    at_once = max(1, int(_BYTES // (count.max() * len(borders) * 8)))
    for first in range(0, len(rows), at_once):
        part = slice(first, first + at_once)
        index = start[part, None] + np.arange(count[part].max())
        there = np.arange(index.shape[1]) < count[part, None]
        index = np.minimum(index, len(edges.rows) - 1)
        scores = border_scores(borders, edges.steps[index])
        scores[~there] = _NEVER
        matched, paths = match_rows(scores, passes=passes, run=run)
        found[index[there]], guessed[index[there]] = matched[there], paths[there]
    return agreeing(edges, found, guessed)


def match_rows(scores: np.ndarray, *, passes: int, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Return for each row and each border in it (r, i) the projector's border, -1 for none: as believed, and as the paths have it.

    ``scores`` (r, i, j) are changed.
    """
    found, guessed = (np.full(scores.shape[:2], -1) for _ in range(2))
    for number in range(passes):
        path, _ = best_path(scores)
        guessed = np.where(path >= 0, path, guessed)
        path = np.where(in_runs(path, run + (number > 0)), path, -1)
        row, border = np.nonzero(path >= 0)
        if not len(row):
            break
        found[row, border] = path[row, border]
        scores[row, border] = _NEVER
        scores[row, :, path[row, border]] = _NEVER
    return found, guessed


def agreeing(edges: Edges, found: np.ndarray, guessed: np.ndarray) -> np.ndarray:
    """Return ``found`` (n,), with those guesses that the row above or below supports: the same border within two pixels.

    Where a surface shows fewer stripes than a run takes, near an outline or on something thin, its other rows vouch for it.
    """
    columns = np.rint(edges.columns).astype(int) + _BESIDE
    known = np.full((edges.rows.max() + 3, columns.max() + 1 + _BESIDE), -1, np.int16)
    found, asked = found.copy(), np.flatnonzero((found < 0) & (guessed >= 0))
    known[edges.rows + 1, columns] = found
    for _ in range(_MOST_ROUNDS):
        row, column, border = edges.rows[asked] + 1, columns[asked], guessed[asked]
        supported = np.logical_or.reduce([known[row + down, column + beside] == border
                                          for down in (-1, 1) for beside in range(-_BESIDE, _BESIDE + 1)])
        if not supported.any():
            break
        found[asked[supported]] = border[supported]
        known[row[supported], column[supported]] = border[supported]
        asked = asked[~supported]
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
    best = np.zeros((count + 1, rows, borders + 1), np.float32)
    for i in range(count):
        np.add(best[i, :, :-1], scores[:, i], out=best[i + 1, :, 1:])
        np.maximum(best[i + 1], best[i], out=best[i + 1])
        np.maximum.accumulate(best[i + 1], axis=1, out=best[i + 1])
    path = np.full((rows, count), -1)
    row, j = np.arange(rows), np.full(rows, borders)
    for i in range(count - 1, -1, -1):
        j = (best[i + 1] >= best[i + 1, row, j][:, None]).argmax(axis=1)  # the least of equally good ones
        taken = best[i + 1, row, j] > best[i, row, j]  # at the least j it is not from its left
        path[taken, i] = j[taken] - 1
        j = j - taken
    return path, best[count, :, -1]


def in_runs(path: np.ndarray, run: int) -> np.ndarray:
    """Return (r, i) bool: which matches belong to ``run`` or more neighbouring borders, in the picture as in the projector."""
    rows, count = path.shape
    follows = np.zeros((rows, count + 1), bool)
    follows[:, 1:count] = (path[:, 1:] == path[:, :-1] + 1) & (path[:, :-1] >= 0)
    place = np.arange(count)
    begin = np.maximum.accumulate(np.where(follows[:, :count], 0, place), axis=1)
    end = np.minimum.accumulate(np.where(follows[:, 1:], count, place)[:, ::-1], axis=1)[:, ::-1]
    return (path >= 0) & (end - begin + 1 >= run)
