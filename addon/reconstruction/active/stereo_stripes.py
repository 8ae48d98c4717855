# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Coloured stripes seen by two cameras: the projector need not be calibrated (Zhang, Curless & Seitz, 2002, section 3).

Both pictures are rectified with each other, and the edges of each are matched with the code alone. Where both cameras see the same
edge of the code in the same row, its disparity tells the depth. What the projector's optics are plays no part; it has to
stand upright beside the cameras, so that its columns come in their order along the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...errors import ScanstageError
from ..neighbours import nearest_views
from ..scan import Scan, View
from .correspondence import Reason
from .measurement import Measurement, measurement_of
from .rectified_pair import box_between, rectified_picture, rectify

WIDEST = np.radians(45.0)
"""Between two cameras that are matched, seen from the object."""
_DEVIATION = 0.35  # pixels, of a disparity: that of two edges' places
_SLACK = 1.0  # pixels by which a disparity may lie beyond those of the working volume

Find = Callable[[Sequence[np.ndarray], View], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Given a view's rectified pictures returns row, place and position in the code of the edges that are found in them."""


def measure_pairs(scan: Scan, views: Sequence[tuple[int, View]], find: Find, pictures: Callable[[View], Sequence]) -> list[Measurement]:
    """Measure views under coloured stripes by pairs of neighbours.

    Parameters
    ----------
    scan : Scan
    views : sequence of (int, View)
        Those under stripes whose projector is not known, with their numbers in the scan.
    find : callable
        See `Find`.
    pictures : callable
        Returns a view's pictures under stripes, in the order of their shifts.

    Raises
    ------
    ScanstageError
        No two of the views are near each other.
    """
    shown = Scan(tuple(view for _, view in views), scan.bounds)
    middle = _meeting(shown) if scan.bounds is None else np.mean(scan.bounds, axis=0)
    pairs = nearest_views([view.camera for view in shown.views], middle, WIDEST)
    if not pairs:
        raise ScanstageError(f"frame {views[0][1].name}: its stripes' projector is not calibrated, and no second camera within "
                             f"{np.degrees(WIDEST):g} degrees sees the same stripes; calibrate the projector, or add a camera")
    return [_measured(scan, shown.views[own], views[own][0], shown.views[other], find, pictures) for own, other in pairs]


def _measured(scan: Scan, view: View, number: int, other: View, find: Find, pictures: Callable[[View], Sequence]) -> Measurement:
    """Return the points of one view's edges, matched with another view's."""
    to_the_right = view.camera.R[0] @ (other.camera.centre - view.camera.centre) > 0
    left, right = (view, other) if to_the_right else (other, view)
    box = box_between(left.camera, right.camera) if scan.bounds is None else np.asarray(scan.bounds)
    pair = rectify(left.camera, right.camera, box, f"frame {view.name} beside {other.name}")
    found = [find([rectified_picture(one.camera, ideal, picture.read_image()) for picture in pictures(one)], one)
             for one, ideal in ((left, pair.first), (right, pair.second))]
    rows, here, there = common_edges(*found)
    disparity = here - there
    good = (disparity > -_SLACK) & (disparity < pair.disparities + _SLACK)
    rays = pair.first.rays(np.stack((here[good], rows[good]), axis=-1))  # of unit depth
    points = pair.first.centre + pair.depths(disparity[good])[:, None] * rays
    pixels, depth = view.camera.project(points)
    whole = np.rint(pixels).astype(np.intp)
    inside = (depth > 0) & (whole >= 0).all(axis=1) & (whole < view.camera.size).all(axis=1)
    points, (columns, lines) = points[inside], whole[inside].T
    reason = np.full(view.camera.size[::-1], Reason.UNLIT, np.uint8)
    reason[lines, columns] = Reason.VALID
    deviation = pair.deviation((points - pair.first.centre) @ pair.first.forward, _DEVIATION)
    return measurement_of(view, number, points, (lines, columns), deviation, reason, None)


def common_edges(first: tuple[np.ndarray, np.ndarray, np.ndarray],
                 second: tuple[np.ndarray, np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rows (n,) of edges that both pictures show once in the same row, and their places (n,) in the first and the second.

    Parameters
    ----------
    first, second : three (m,) arrays
        Row, place and position in the code.
    """
    keys = [rows * 1e6 + np.round(positions * 64) for rows, _, positions in (first, second)]  # codes are below 16,384 columns
    once = [np.unique(key, return_index=True, return_counts=True) for key in keys]
    (own, at, count), (others, at_other, count_other) = once
    _, a, b = np.intersect1d(own[count == 1], others[count_other == 1], assume_unique=True, return_indices=True)
    a, b = at[count == 1][a], at_other[count_other == 1][b]
    return first[0][a], first[1][a], second[1][b]


def _meeting(scan: Scan) -> np.ndarray:
    first, second = scan.views[0].camera, scan.views[-1].camera
    return box_between(first, second).mean(axis=0) if first is not second else first.centre + first.forward
