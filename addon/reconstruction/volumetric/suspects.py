# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which views contradict the others: a wrong mask or a wrong pose, found and named.

One wrong silhouette cuts a hull in all views, so that all of them look bad. A hull that lets some views disagree is not cut;
projected back, it covers the silhouettes of the good views and not those of the bad.
"""

from __future__ import annotations

import numpy as np

from ...errors import ScanstageError
from ..geometry import VoxelGrid
from ..scan import Scan
from .item_buffer import reprojection_iou
from .surface import extract_surface
from .visual_hull import visual_hull

GOOD = 0.93
"""Intersection over union: where every view reaches it nobody is suspected."""
_LEAST_VIEWS = 6
_VOXELS = 96
_SHARE = 12  # of so many views one may disagree, and at least one
_LEAST_FALL = 0.04  # below the median
_DEVIATIONS = 5.0
_SIDE = 320  # pixels: coarser pictures are enough to tell


def suspicious_views(scan: Scan, grid: VoxelGrid, ious: dict[str, float]) -> dict[str, float]:
    """Return the views whose silhouettes the others contradict, and how well a hull of the others covers them.

    Parameters
    ----------
    scan : Scan
    grid : VoxelGrid
        Of the result; its box is carved again, coarsely.
    ious : dict of str to float
        Of each view with a silhouette, how well the result covers it. If all are good nothing more is done.

    Returns
    -------
    dict of str to float
        Intersection over union by the view's name, the worst first.
    """
    if len(ious) < _LEAST_VIEWS or min(ious.values()) >= GOOD:
        return {}
    views = tuple(view for view in scan.views if view.mask is not None)
    coarse = VoxelGrid.from_bounds(grid.origin, grid.upper, min(_VOXELS, max(grid.shape)))
    try:
        hull = visual_hull(Scan(views), coarse, rule="center", tolerance=max(1, min(16, len(views) // _SHARE))).volume
    except ScanstageError:  # nothing is left even so: the views contradict each other all round
        return {}
    surface = extract_surface(hull)
    covered = {view.name: reprojection_iou(surface, coarse, view, scale=min(1.0, _SIDE / max(view.camera.size))) for view in views}
    values = np.array(list(covered.values()))
    median = float(np.median(values))
    fall = max(_LEAST_FALL, _DEVIATIONS * 1.4826 * float(np.median(np.abs(values - median))))
    return dict(sorted(((name, value) for name, value in covered.items() if value < median - fall), key=lambda item: item[1]))


def suspicion(scan: Scan, grid: VoxelGrid, ious: dict[str, float], *, forgiving: bool) -> list[str]:
    """Return a warning that names the views that contradict the others, if there are any.

    ``forgiving`` is whether the method has an option by which views may disagree.
    """
    found = suspicious_views(scan, grid, ious)
    if not found:
        return []
    named = ", ".join(f"{name} ({value:.2f})" for name, value in list(found.items())[:5])
    more = f" and {len(found) - 5} more" if len(found) > 5 else ""
    tolerance = f", or let {len(found)} views disagree with --set tolerance={len(found)}" if forgiving else ""
    return [f"the silhouettes of {len(found)} of {len(ious)} views do not fit the others' (share in common): frame {named}{more}; correct "
            f"their masks or poses, leave them out{tolerance}"]
