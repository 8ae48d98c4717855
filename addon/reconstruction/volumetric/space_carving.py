# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Space carving: planes sweep through the volume in six directions until nothing changes (Kutulakos & Seitz, 2000).

A sweep judges a voxel by the cameras that its plane has passed, which is never by more than see it, so that no sweep takes
out what all cameras together would keep, if the measure is monotone. What six sweeps leave may still be inconsistent
with all cameras at once: a last check asks them all, and if it takes anything out the sweeps begin again.
"""

from __future__ import annotations

from ...progress import Progress, part_of, silent
from ..geometry import VoxelGrid
from ..outcome import Outcome
from ..scan import Scan
from . import photo_hull
from .carving import Carving
from .consistency import Judge
from .footprints import Pictures
from .generalized_voxel_coloring import colors_by_sight, refusals
from .sight import Sight
from .sweeping import AXES, sweep

OPTIONS = photo_hull.OPTIONS


def space_carving(scan: Scan, grid: VoxelGrid, *, start: str = "hull", consistency: str = "adaptive", threshold: float = 0.0,
                  noise: float = 0.01, min_views: int = 2, progress: Progress = silent) -> Outcome:
    """Carve the photo hull by sweeps of planes.

    Parameters
    ----------
    scan : Scan
        Cameras may stand anywhere.
    grid : VoxelGrid
    start : {'hull', 'box'}
        What is carved.
    consistency, threshold, noise, min_views
        See `consistency.OPTIONS`.
    progress : Progress

    Returns
    -------
    Outcome
        Its report counts ``tested`` (voxels judged, each time), ``coloured``, ``removed``, ``unseen``, ``sweeps`` and
        ``checks``.

    Raises
    ------
    ScanstageError
        Nothing is left.
    """
    carving, warnings = photo_hull.start(scan, grid, start, part_of(progress, 0, 0.15))
    judge = Judge.of(consistency=consistency, threshold=threshold, noise=noise, min_views=min_views)
    pictures = photo_hull.pictures_of(scan, grid, start, part_of(progress, 0.15, 0.2))
    counts = dict.fromkeys(("tested", "removed", "sweeps", "checks"), 0)
    done, checked = 0.2, True
    while checked:
        done += (1 - done) / 3  # nobody knows how many rounds there will be
        _sweep_until_stable(carving, pictures, judge, counts, part_of(progress, done - 0.1, done))
        sight = Sight(pictures, carving)
        seen = sight.seen()
        refused = seen[refusals(sight, seen, judge)]
        carving.remove(refused)
        checked = len(refused)
        _add(counts, tested=len(seen), removed=checked, checks=1)
    return photo_hull.outcome(carving, colors_by_sight(sight, judge), judge, counts=counts, warnings=warnings,
                              report={"order": "plane sweeps towards " + ", ".join(order.name for order in AXES)},
                              whole_footprints=False)


def _sweep_until_stable(carving: Carving, pictures: Pictures, judge: Judge, counts: dict[str, int], progress: Progress) -> None:
    """Sweep in turn in all six directions, until none of six sweeps on end has taken anything out."""
    idle = 0
    while idle < len(AXES):
        order = AXES[counts["sweeps"] % len(AXES)]
        swept = sweep(carving, pictures, judge, order, progress)
        _add(counts, tested=swept.tested, removed=swept.removed, sweeps=1)
        idle = 0 if swept.removed else idle + 1


def _add(counts: dict[str, int], **more: int) -> None:
    for name, number in more.items():
        counts[name] += number
