# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Two tools for vectorised work on unequal things: lists of lists without a loop, and large triangles cut small."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def expand(counts: np.ndarray, chunk: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Enumerate lists of unequal length, in chunks of bounded memory.

    Parameters
    ----------
    counts : (n,) integer array
        The length of each list.
    chunk : int
        At most this many entries at a time; a long list may be divided among chunks.

    Yields
    ------
    owner : (m,) int64 array
        Which list each entry is of, ascending.
    position : (m,) int64 array
        0, 1, 2, ... within the list.
    """
    stops = np.cumsum(counts, dtype=np.int64)
    total = int(stops[-1]) if len(stops) else 0
    for start in range(0, total, chunk):
        stop = min(start + chunk, total)
        first, last = np.searchsorted(stops, (start, stop - 1), side="right")
        ends = np.minimum(stops[first:last + 1], stop)
        owner = np.repeat(np.arange(first, last + 1), np.diff(ends, prepend=start))
        yield owner, np.arange(start, stop) - (stops[owner] - counts[owner])


def sorted_unique(values: np.ndarray) -> np.ndarray:
    """Return the distinct values (n,), ascending. On millions of integers, numpy 2's `unique` is ten times slower."""
    values = np.sort(values)
    return values[np.flatnonzero(np.diff(values, prepend=values[:1] - 1))]


def squared_edges(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the squared lengths (t, 3) of the edges 0-1, 1-2 and 2-0 of each triangle."""
    edges = (vertices[triangles[:, (i + 1) % 3]] - vertices[triangles[:, i]] for i in range(3))
    return np.stack([np.einsum("ij,ij->i", edge, edge) for edge in edges], axis=1)


def bisect(vertices: np.ndarray, triangles: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut triangles at the middle of their longest edge until no edge is longer than ``longest``.

    Longest-edge bisection (Rivara, 1984) never makes triangles much thinner than they were (Rosenberg & Stenger,
    1975), and cuts a sliver along its length only. Neighbours are cut independently of each other.

    Parameters
    ----------
    vertices : (v, 3) array
    triangles : (t, 3) integer array
    longest : float
        Positive, in the unit of the vertices.

    Returns
    -------
    vertices : (v + n, 3) float64 array
        The given ones, then the new.
    pieces : (p, 3) int64 array
    parent : (p,) int64 array
        The given triangle that each piece lies in.
    """
    pieces, parent = triangles.astype(np.int64), np.arange(len(triangles))
    done = []
    while len(pieces):
        squared = squared_edges(vertices, pieces)
        large = squared.max(axis=1) > longest ** 2
        done.append((pieces[~large], parent[~large]))
        edge = squared[large].argmax(axis=1)
        # Turn each triangle so that its longest edge is a-b.
        a, b, c = pieces[large][np.arange(len(edge)), (edge + np.arange(3)[:, None]) % 3]
        low, high = np.minimum(a, b), np.maximum(a, b)
        keys, middle = np.unique(low * len(vertices) + high, return_inverse=True)
        middle = middle.reshape(-1) + len(vertices)
        ends = np.stack(np.divmod(keys, len(vertices)))
        vertices = np.concatenate((vertices, vertices[ends].mean(axis=0)))
        pieces = np.concatenate((np.stack((a, middle, c), axis=1), np.stack((middle, b, c), axis=1)))
        parent = np.tile(parent[large], 2)
    return (vertices, np.concatenate([np.zeros((0, 3), np.int64)] + [part for part, _ in done]),
            np.concatenate([np.zeros(0, np.int64)] + [owner for _, owner in done]))
