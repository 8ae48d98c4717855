# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxel coloring: one pass through the volume, near to far, that keeps and colours what the views agree on.

Near and far must mean the same to all cameras: there must be one order in which no voxel hides another before it (the
ordinal visibility constraint, Seitz & Dyer, 1999). There is one if the cameras' convex hull does not meet the scene, for
then a plane lies between the two, and the distance from it is such an order.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ...errors import ScanstageError
from ...progress import Progress, part_of, silent
from ..geometry import VoxelGrid
from ..outcome import Outcome
from ..scan import Scan
from . import photo_hull
from .carving import Carving
from .consistency import Judge
from .sweeping import AXES, Order, sweep

OPTIONS = photo_hull.OPTIONS
_MOST_STEPS = 2000
_LEAST_GAP = 1e-3  # voxels between the cameras and the scene


def voxel_coloring(scan: Scan, grid: VoxelGrid, *, start: str = "hull", consistency: str = "adaptive",
                   consistency_threshold: float = 0.0, noise: float = 0.01, min_views: int = 2, progress: Progress = silent) -> Outcome:
    """Colour the voxels that views agree on, and take out the others (Seitz & Dyer, 1999).

    Parameters
    ----------
    scan : Scan
    grid : VoxelGrid
    start : {'hull', 'box'}
        What is carved.
    consistency, consistency_threshold, noise, min_views
        See `consistency.OPTIONS`.
    progress : Progress

    Returns
    -------
    Outcome
        Its report names the ``order`` and counts voxels ``tested``, ``coloured``, ``removed`` and ``unseen``.

    Raises
    ------
    ScanstageError
        The cameras' convex hull meets the volume, or nothing is left.
    """
    carving, warnings = photo_hull.start(scan, grid, start, part_of(progress, 0, 0.2))
    order = ordinal_visibility(np.array([(view.camera.centre - grid.origin) / grid.voxel_size for view in scan.views]), carving)
    judge = Judge.of(consistency=consistency, threshold=consistency_threshold, noise=noise, min_views=min_views)
    pictures = photo_hull.pictures_of(scan, grid, start, judge, part_of(progress, 0.2, 0.4))
    swept = sweep(carving, pictures, judge, order, part_of(progress, 0.4, 1.0))
    return photo_hull.outcome(carving, photo_hull.Colored(swept.keys, swept.rgb, swept.views), judge,
                              counts={"tested": swept.tested, "removed": swept.removed}, warnings=warnings,
                              report={"order": f"plane sweep towards {order.name}"}, whole_footprints=True)


def ordinal_visibility(centres: np.ndarray, carving: Carving) -> Order:
    """Return an order of depth that holds for all cameras.

    Parameters
    ----------
    centres : (v, 3) array
        Of the cameras, in voxel coordinates.
    carving : Carving
        The scene is the box round its voxels.

    Raises
    ------
    ScanstageError
        There is none: the cameras' convex hull meets the box.
    """
    lower, upper = carving.frozen().bounds()
    box = np.stack((lower, upper + 1)).astype(float)
    gaps = [_gap(centres, box, order.direction) for order in AXES]
    if max(gaps) > _LEAST_GAP:
        return AXES[int(np.argmax(gaps))]  # across an axis layers are whole sheets of voxels
    direction = separating_direction(centres, box)
    if direction is None:
        raise ScanstageError(
            f"the convex hull of the {len(centres)} camera centres meets the working volume, so that no order of depth holds for all of "
            "them: use generalized-voxel-coloring or space-carving, or capture from one side only, such as from above "
            "(preset voxel-coloring)")
    return Order("({:.3f}, {:.3f}, {:.3f}), by the distance from a plane before the cameras' convex hull".format(*direction), direction)


def separating_direction(centres: np.ndarray, box: np.ndarray) -> np.ndarray | None:
    """Return the (3,) unit vector from points (v, 3) to a box (2, 3) across a plane between their convex hulls, if there is one.

    The shortest vector between the hulls is approached from corner to corner of their difference (Gilbert, 1966); any
    vector on the way that already separates them will do.
    """
    corners = box[np.array(list(product((0, 1), repeat=3))), np.arange(3)]
    differences = (corners[:, None] - centres).reshape(-1, 3)
    nearest = differences.mean(axis=0)
    for _ in range(_MOST_STEPS):
        length = np.linalg.norm(nearest)
        if length < _LEAST_GAP:
            return None
        along = differences @ nearest
        if along.min() > _LEAST_GAP * length:
            return nearest / length
        step = differences[along.argmin()] - nearest
        nearest = nearest + np.clip(-(nearest @ step) / (step @ step), 0, 1) * step
    return None


def _gap(centres: np.ndarray, box: np.ndarray, direction: np.ndarray) -> float:
    """Return how far, along a direction, the box begins after the last of the cameras."""
    return float(np.where(direction > 0, box[0], box[1]) @ direction - (centres @ direction).max())
