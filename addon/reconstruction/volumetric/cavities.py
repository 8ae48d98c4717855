# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cavities that are closed on all sides, filled."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from .volume import SparseVolume


def without_cavities(volume: SparseVolume) -> SparseVolume:
    """Return the volume with every empty voxel filled that no way through faces leads out of.

    Regions of empty voxels are found layer by layer, as OpenCV labels them, and joined where they lie on each other. No more than
    a slab is ever dense.
    """
    borders, pairs, count = [], [], 0
    above = None
    for labels, regions in _layers(volume):
        labels = np.where(labels > 0, labels + count, 0)
        borders.append(labels[0, 0])
        if above is not None:
            touching = (labels > 0) & (above > 0)
            pairs.append(np.unique(np.stack((above[touching], labels[touching])), axis=1))
        above, count = labels, count + regions
    # The rim of each layer is the world outside, as are all regions of the first layer and of the last.
    pairs.append(np.stack((np.zeros(len(borders), np.int64), borders)))
    outside = _joined(np.concatenate(pairs, axis=1), count + 1) == 0
    return SparseVolume.from_slabs(volume.grid, _filled(volume, outside))


def _layers(volume: SparseVolume) -> Iterator[tuple[np.ndarray, int]]:
    """Yield for each layer in x the regions of its empty voxels, in a rim of one voxel, and how many there are.

    An empty layer before the first and behind the last are among them.
    """
    rim = np.ones((volume.grid.shape[1] + 2, volume.grid.shape[2] + 2), np.uint8)
    yield rim.astype(np.int64), 1
    for slab in volume.slabs():
        for layer in slab:
            rim[1:-1, 1:-1] = ~layer
            regions, labels = cv2.connectedComponents(rim, connectivity=4)
            yield labels.astype(np.int64), regions - 1
    yield np.ones(rim.shape, np.int64), 1


def _joined(pairs: np.ndarray, count: int) -> np.ndarray:
    """Return (count,) the least number of the set that each number is in, where ``pairs`` (2, n) are in the same."""
    least = np.arange(count)
    while True:
        low = np.minimum(least[pairs[0]], least[pairs[1]])
        before = least.copy()
        np.minimum.at(least, least[pairs[0]], low)
        np.minimum.at(least, least[pairs[1]], low)
        least = least[least]
        if (least == before).all():
            return least


def _filled(volume: SparseVolume, outside: np.ndarray) -> Iterator[np.ndarray]:
    layers, first = _layers(volume), 1
    first += next(layers)[1]
    for slab in volume.slabs():
        filled = np.zeros_like(slab)
        for layer in filled:
            labels, regions = next(layers)
            inner = labels[1:-1, 1:-1]
            layer[:] = (inner == 0) | ~outside[np.where(inner > 0, inner + first - 1, 0)]
            first += regions
        yield filled
