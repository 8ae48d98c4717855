# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull in the plane, growing view by view: silhouettes are intervals of angles, their cones are sectors."""

import numpy as np
from tables import Table

from . import drawing
from .experiment import Experiment

DISTANCE = 25.0  # cm, of the cameras from the middle
REACH = 11.0  # cm, half the side of the square that is carved
SAMPLES = 512  # along a side of it
SHOWN = (1, 2, 3, 4, 6, 8, 12, 24)
LIMIT = 360  # views, beyond which nothing visible changes
SLACK = 1e-12  # radians: rounding must not lose a point of the object's edge
_GOLDEN = np.pi * (3 - np.sqrt(5))


def horseshoe():
    """Return a horseshoe with a ball before its mouth, as (n, 3) discs: x, y and radius in cm."""
    turn = np.radians(np.linspace(45, 315, 136))
    arc = np.column_stack((5 * np.cos(turn) - 1, 5 * np.sin(turn), np.full(len(turn), 1.4)))
    return np.vstack((arc, [[8.0, 1.5, 1.3]]))


def cameras(count, distance=DISTANCE):
    """Return (count, 2) places on a circle, each far from those before it: more of them begin with the same."""
    angle = _GOLDEN * np.arange(count) - np.pi / 2
    return distance * np.column_stack((np.cos(angle), np.sin(angle)))


def directions(camera, points):
    """Return the angles (n,) at which a camera that looks at the origin sees (n, 2) points."""
    x, y = (points - camera).T
    forward = -camera / np.linalg.norm(camera)
    return np.arctan2(forward[0] * y - forward[1] * x, forward[0] * x + forward[1] * y)


def silhouette(camera, discs):
    """Return the (k, 2) intervals of angles, apart and ascending, in which a camera sees discs.

    Exact: a disc of radius r at the distance d covers asin(r / d) on either side of its middle.
    """
    middle = directions(camera, discs[:, :2])
    half = np.arcsin(discs[:, 2] / np.linalg.norm(discs[:, :2] - camera, axis=1))
    order = np.argsort(middle - half)
    start, stop = (middle - half)[order], np.maximum.accumulate((middle + half)[order])
    first = np.append(True, start[1:] > stop[:-1])
    return np.column_stack((start[first], stop[np.append(first[1:], True)]))


def inside_cone(points, camera, intervals):
    """Return (n,) bool: whether a camera sees (n, 2) points within its silhouette."""
    angle = directions(camera, points)
    nearest = np.searchsorted(intervals[:, 0] - SLACK, angle, side="right") - 1
    return (nearest >= 0) & (angle <= intervals[nearest, 1] + SLACK)


def hulls(points, discs, places):
    """Yield (n,) bool after each camera: which points all cones so far hold."""
    left = np.ones(len(points), bool)
    for place in places:
        left = left & inside_cone(points, place, silhouette(place, discs))
        yield left


def covered(points, discs):
    """Return (n,) bool: which of (n, 2) points lie in a disc."""
    return np.any([((points - disc[:2]) ** 2).sum(1) <= disc[2] ** 2 for disc in discs], axis=0)


def raster(reach=REACH, samples=SAMPLES):
    """Return the (samples^2, 2) middles of a square's cells, row by row, and the area of one."""
    step = 2 * reach / samples
    axis = (np.arange(samples) + 0.5) * step - reach
    return np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2), step ** 2


def grow(progress, samples=SAMPLES, limit=LIMIT):
    """Return the raster's points, the object as (n,) bool, the hull after the shown numbers of views and in the limit, and the table."""
    points, cell = raster(samples=samples)
    discs, kept = horseshoe(), {}
    for views, left in enumerate(hulls(points, discs, cameras(limit)), start=1):
        progress(views / limit, f"view {views} of {limit}")
        if views in (*SHOWN, limit):
            kept[views] = left
    truth = covered(points, discs)
    rows = tuple((views, float(left.sum() * cell), float((left & ~truth).sum() / truth.sum()), int((truth & ~left).sum()))
                 for views, left in kept.items())
    note = (f"The object, a horseshoe and a ball, has {truth.sum() * cell:.1f} cm². The square that is carved is {2 * REACH:g} cm wide; "
            f"one view bounds nothing in depth. {limit} views are as good as all that there are: what is left over then, in the horseshoe "
            "and before its mouth, is where every line meets the object.")
    return points, truth, kept, Table(("views", "hull, cm²", "excess", "samples of the object lost"), rows, note)


def run(out, progress):
    points, truth, kept, table = grow(progress)
    figure, axes = drawing.panels(900, 560, 2, 4, sharex=True, sharey=True)
    for panel, views in zip(axes.flat, SHOWN, strict=True):
        draw(panel, truth, kept[views], views)
        panel.set_title(f"{views} view{'s' * (views > 1)}: +{100 * table.rows[SHOWN.index(views)][2]:.0f} %")
    for panel in axes[-1]:
        panel.set_xlabel("x, cm")
    for panel in axes[:, 0]:
        panel.set_ylabel("y, cm")
    drawing.key(figure, object=drawing.TRUTH, what_the_hull_has_too_much=drawing.HULL, cone_of_the_last_view=drawing.BLUE)
    drawing.save(figure, out, EXPERIMENT.name)
    return table


def draw(panel, truth, left, views):
    """Draw the object, the hull, and the rays along which the last camera's cone is cut."""
    extent = (-REACH, REACH, -REACH, REACH)
    drawing.show(panel, np.where(truth, 2, left.astype(int)).reshape(SAMPLES, SAMPLES), ("white", drawing.HULL, drawing.TRUTH), extent)
    place = cameras(views)[-1]
    for angle in silhouette(place, horseshoe()).ravel():
        forward = np.arctan2(-place[1], -place[0]) + angle
        end = place + 2 * DISTANCE * np.array([np.cos(forward), np.sin(forward)])
        panel.plot(*np.transpose((place, end)), color=drawing.BLUE, linewidth=0.8)
    panel.set(xlim=extent[:2], ylim=extent[2:], xticks=(-10, 0, 10), yticks=(-10, 0, 10))
    panel.spines[:].set_visible(True)


EXPERIMENT = Experiment("hull-2d", "The visual hull in the plane, growing view by view.", run)
