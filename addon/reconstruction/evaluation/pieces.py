# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Large triangles cut small."""

from __future__ import annotations

import numpy as np


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
