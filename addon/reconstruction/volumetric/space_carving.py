# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Space carving: planes sweep through the volume in six directions until hardly anything changes (Kutulakos & Seitz, 2000).

A sweep judges a voxel by the cameras that its plane has passed, which is never by more than see it, so that no sweep takes
out what all cameras together would keep, if the measure is monotone. What six sweeps leave may still be inconsistent
with all cameras at once: a last check asks them all, also about what it exposes itself. After it no sweep can find more,
since none asks cameras that the check has not asked. So the sweeps may stop when a round of six takes out next to nothing.
"""

from __future__ import annotations

from dataclasses import replace

from ...progress import Progress, part_of, silent
from ..geometry import VoxelGrid
from ..outcome import Outcome
from ..scan import Scan
from . import photo_hull
from .carving import Carving
from .consistency import Judge
from .footprints import Pictures
from .generalized_voxel_coloring import carve_by_sight, colors_by_sight
from .sight import Sight
from .sweeping import AXES, sweep

OPTIONS = photo_hull.OPTIONS
LEAST_ACROSS = 0.5  # of every line of sight at least one axis is nearer than that: its cosine is at least 0.577
LEAST_CHANGE = 1e-3  # of the voxels that a round tests, for another round
_ORDERS = tuple(replace(order, least_across=LEAST_ACROSS) for order in AXES)


def space_carving(scan: Scan, grid: VoxelGrid, *, start: str = "hull", consistency: str = "adaptive",
                  consistency_threshold: float = 0.0, noise: float = 0.01, min_views: int = 2, progress: Progress = silent) -> Outcome:
    """Carve the photo hull by sweeps of planes.

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
        Its report counts ``tested`` (voxels judged, each time), ``coloured``, ``removed``, ``removed_by_check``,
        ``unseen`` and ``sweeps``.

    Raises
    ------
    ScanstageError
        Nothing is left.
    """
    carving, warnings = photo_hull.start(scan, grid, start, part_of(progress, 0, 0.15))
    judge = Judge.of(consistency=consistency, threshold=consistency_threshold, noise=noise, min_views=min_views)
    pictures = photo_hull.pictures_of(scan, grid, start, judge, part_of(progress, 0.15, 0.2))
    tested, removed, sweeps = _sweep_until_stable(carving, pictures, judge, part_of(progress, 0.2, 0.8))
    sight = Sight(pictures, carving)
    checked, refused = carve_by_sight(carving, sight, judge, part_of(progress, 0.8, 0.95))
    counts = {"tested": tested + checked, "removed": removed + refused, "removed_by_check": refused, "sweeps": sweeps}
    return photo_hull.outcome(carving, colors_by_sight(sight, judge), judge, counts=counts, warnings=warnings,
                              report={"order": "plane sweeps towards " + ", ".join(order.name for order in AXES)},
                              whole_footprints=False)


def _sweep_until_stable(carving: Carving, pictures: Pictures, judge: Judge, progress: Progress) -> tuple[int, int, int]:
    """Sweep in all six directions until a round takes out a small share of what it tests; return tests, removals and sweeps."""
    tested = removed = sweeps = 0
    while True:
        swept = [sweep(carving, pictures, judge, order, part_of(progress, 1 - 0.9 ** (sweeps + way), 1 - 0.9 ** (sweeps + way + 1)))
                 for way, order in enumerate(_ORDERS)]
        sweeps += len(swept)
        tests, removals = sum(one.tested for one in swept), sum(one.removed for one in swept)
        tested, removed = tested + tests, removed + removals
        if removals <= LEAST_CHANGE * tests:
            return tested, removed, sweeps
