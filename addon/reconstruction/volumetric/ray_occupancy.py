# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the colour at the end of a ray says of the voxels along it (Pollard & Mundy, 2007).

A ray crosses voxels 1 .. M, near to far, that are occupied with the probabilities P_i, independently of each other. The
first that is occupied gives the ray its colour I, with the density p_i(I); beyond the last it is p_b(I). With the
probability vis_i = prod_{j<i} (1 - P_j) that the ray reaches voxel i,

    p(I | i occupied) = sum_{j<i} P_j vis_j p_j(I) + vis_i p_i(I)
    p(I | i empty)    = sum_{j<i} P_j vis_j p_j(I) + (sum_{j>i} P_j vis_j p_j(I) + vis_b p_b(I)) / (1 - P_i)

and Bayes' rule gives Pollard and Mundy's update, P_i <- P_i p(I | i occupied) / p(I). It is exact for one ray.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Messages:
    """What rays say of the voxels that they cross.

    Parameters
    ----------
    occupied, empty : (n,) array
        The density of the ray's colour if the voxel is occupied, and if it is empty.
    visibility : (n,) array
        The probability that the ray reaches the voxel.
    """

    occupied: np.ndarray
    empty: np.ndarray
    visibility: np.ndarray

    def posterior(self, occupancy: np.ndarray) -> np.ndarray:
        """Return the (n,) probabilities of occupied voxels after a single ray each, of (n,) before it."""
        total = occupancy * self.occupied + (1 - occupancy) * self.empty
        return occupancy * self.occupied / total


def ray_messages(occupancy: np.ndarray, density: np.ndarray, beyond: np.ndarray, first: np.ndarray) -> Messages:
    """Return what many rays say of their voxels.

    Parameters
    ----------
    occupancy : (n,) array
        P_i, above 0 and below 1, of the voxels of one ray after the other, near to far in each.
    density : (n,) array
        p_i(I) of the ray's colour.
    beyond : (n,) array
        p_b(I), the same for all voxels of a ray; above 0.
    first : (n,) bool array
        True where a ray begins, as it does at the first row.
    """
    if not len(first):
        return Messages(*[np.zeros(0)] * 3)
    start = np.flatnonzero(first)
    ray = np.cumsum(first) - 1
    passed = np.log1p(-occupancy)
    visibility = np.exp(_before(passed, start, ray))
    ended = occupancy * visibility * density
    nearer = np.maximum(_before(ended, start, ray), 0)
    farther = np.maximum(np.add.reduceat(ended, start)[ray] - nearer - ended, 0)
    through = np.exp(np.add.reduceat(passed, start))[ray] * beyond
    return Messages(nearer + visibility * density, nearer + (farther + through) / (1 - occupancy), visibility)


def _before(values: np.ndarray, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Return the sum of all earlier values of the same ray."""
    total = np.cumsum(values) - values
    return total - total[start][ray]
