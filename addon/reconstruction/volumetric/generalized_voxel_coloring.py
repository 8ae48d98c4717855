# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Generalized voxel coloring: carving by colour with exact visibility, whatever the cameras (Culbertson et al., 1999).

A voxel is judged by all pixels that see it, and again whenever it is seen by more of them. With a monotone measure the
result, the photo hull, does not depend on the order in which voxels are judged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...progress import Progress, part_of, silent
from ..geometry import VoxelGrid
from ..outcome import Outcome
from ..scan import Scan
from . import photo_hull
from .carving import Carving
from .consistency import Judge, Monotone
from .footprints import Samples
from .sight import Sight

OPTIONS = photo_hull.OPTIONS
VOXELS_AT_ONCE = 1 << 16


def generalized_voxel_coloring(scan: Scan, grid: VoxelGrid, *, start: str = "hull", consistency: str = "adaptive",
                               consistency_threshold: float = 0.0, noise: float = 0.01, min_views: int = 2,
                               progress: Progress = silent) -> Outcome:
    """Carve the photo hull with exact visibility.

    Parameters
    ----------
    scan : Scan
        Cameras may stand anywhere.
    grid : VoxelGrid
    start : {'hull', 'box'}
        What is carved.
    consistency, consistency_threshold, noise, min_views
        See `consistency.OPTIONS`.
    progress : Progress

    Returns
    -------
    Outcome
        Its report counts ``tested`` (voxels judged, each time), ``coloured``, ``removed`` and ``unseen``.

    Raises
    ------
    ScanstageError
        Nothing is left.
    """
    carving, warnings = photo_hull.start(scan, grid, start, part_of(progress, 0, 0.2))
    judge = Judge.of(consistency=consistency, threshold=consistency_threshold, noise=noise, min_views=min_views)
    pictures = photo_hull.pictures_of(scan, grid, start, judge, part_of(progress, 0.2, 0.3))
    emptied = photo_hull.carve_background(carving, pictures)
    sight = Sight(pictures, carving)
    tested, removed = carve_by_sight(carving, sight, judge, part_of(progress, 0.4, 0.95))
    return photo_hull.outcome(carving, colors_by_sight(sight, judge), judge,
                              counts={"tested": tested + emptied, "removed": removed + emptied}, warnings=warnings,
                              report={"order": "exact visibility"}, whole_footprints=False)


def carve_by_sight(carving: Carving, sight: Sight, judge: Judge, progress: Progress = silent, *,
                   choose: Callable[[np.ndarray], np.ndarray] = lambda keys: keys) -> tuple[int, int]:
    """Take out voxels until all that are seen are consistent.

    Parameters
    ----------
    carving : Carving
    sight : Sight
        Of the carving. Both are changed.
    judge : Judge
    progress : Progress
    choose : callable
        Given the sorted keys of voxels that wait to be judged, returns those to judge next, sorted.

    Returns
    -------
    tested, removed : int
        How many times a voxel was judged, and how many were taken out.
    """
    tested = removed = 0
    waiting = sight.seen()
    while len(waiting):
        progress(removed / (removed + 10 * len(waiting)), f"Carving by colour: {removed:,} voxels taken out")
        chosen = choose(waiting)
        refused = chosen[refusals(sight, chosen, judge)]
        carving.remove(refused)
        tested, removed = tested + len(chosen), removed + len(refused)
        waiting = np.union1d(np.setdiff1d(waiting, chosen, assume_unique=True), sight.look_on())
    return tested, removed


def refusals(sight: Sight, keys: np.ndarray, judge: Judge) -> np.ndarray:
    """Return (n,) bool: which voxels, given by their sorted keys, are refused by what is seen of them now."""
    return np.concatenate([judge.refuses(samples_of(sight, part, judge)) for part in _parts(keys)])


def colors_by_sight(sight: Sight, judge: Judge) -> photo_hull.Colored:
    """Return the colours of all voxels that enough views see."""
    found = []
    for keys in _parts(sight.seen()):
        samples = sight.samples(keys)
        enough = samples.views >= judge.min_views
        found.append((keys[enough], samples.colors[enough], samples.views[enough]))
    return photo_hull.Colored(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def samples_of(sight: Sight, keys: np.ndarray, judge: Judge) -> Samples:
    """Return all that a judge needs to know of voxels, given by their sorted keys."""
    needs = judge.measure.needs
    samples = sight.samples(keys, extremes=judge.measure.monotone is Monotone.IN_PIXELS, cells=needs == "cells")
    if needs != "patches":
        return samples
    exposure = sight.carving.exposure(keys)
    points = sight.carving.voxels(keys) + 0.5 * (1 + exposure)
    return replace(samples, patches=sight.pictures.patches(points, exposure) * samples.seen[..., None])


def _parts(keys: np.ndarray) -> list[np.ndarray]:
    return np.array_split(keys, max(1, -(-len(keys) // VOXELS_AT_ONCE)))
