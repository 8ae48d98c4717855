# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The concavities that silhouettes miss: cross-sections through the truth and its hull, and depths along the concavities' axes."""

from dataclasses import dataclass

import numpy as np
from tables import Table

from addon.reconstruction import methods
from addon.reconstruction.evaluation import inside

from . import drawing
from .experiment import Experiment
from .stage import MM, VIEWS, captured

VOXELS = 192
OUTER = 0.13  # metres: farther from the object's middle than any of its parts
LOW, HIGH = -0.06, 0.22  # metres: what of the section is drawn
_STEPS = 4  # samples in a voxel, along an axis


@dataclass(frozen=True)
class Concavity:
    """A concavity of a built-in object, as scripts/make_assets.py makes it: its axis begins inside and leaves by the mouth.

    Parameters
    ----------
    object, label : str
    azimuth, elevation : float
        Of the axis, in degrees.
    height : float
        At which the axis begins, above the middle of the object's base, in metres.
    """

    object: str
    label: str
    azimuth: float
    elevation: float
    height: float = 0.1

    @property
    def start(self):
        """The (3,) point at which the axis begins."""
        return np.array([0.0, 0.0, self.height])

    @property
    def axis(self):
        """The (3,) direction of the axis."""
        a, e = np.radians((self.azimuth, self.elevation))
        return np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])


CONCAVITIES = (Concavity("dented-sphere", "shallow dent", -100, 10), Concavity("dented-sphere", "middle dent", 25, -8),
               Concavity("dented-sphere", "deep dent", 140, 28), Concavity("pot", "pit", 0, 90, height=0.001))
DRAWN = CONCAVITIES[2], CONCAVITIES[3]


def occupied(volume, points):
    """Return (...) bool: whether (..., 3) points lie in an occupied voxel."""
    index = np.floor((points - volume.grid.origin) / volume.grid.voxel_size).astype(int)
    return volume.contains(index.reshape(-1, 3)).reshape(points.shape[:-1])


def farthest(volume, start, axis, reach=2 * OUTER):
    """Return how far along an axis the outermost occupied voxel reaches, to a part of a voxel."""
    step = volume.grid.voxel_size / _STEPS
    along = np.arange(0.0, reach, step)
    return float(along[occupied(volume, start + along[:, None] * axis)].max())


def depths(concavity, truth, true_volume, hull):
    """Return the concavity's depth below the plane that closes its mouth, how far the hull rises above the truth there, and how
    much of the depth the hull shows, in mm."""
    mouth = float(((truth.vertices - concavity.start) @ concavity.axis).max())
    bottom, top = (farthest(volume, concavity.start, concavity.axis) for volume in (true_volume, hull))
    return MM * (mouth - bottom), MM * (top - bottom), MM * max(0.0, mouth - top)


def section(concavity, volume, samples=400):
    """Return (samples, samples) bool, the cut through a volume along a concavity's axis and the vertical, and its extent in mm."""
    a = np.radians(concavity.azimuth)
    across, up = np.meshgrid(np.linspace(-OUTER, OUTER, samples), np.linspace(LOW, HIGH, samples))
    points = np.stack((across * np.cos(a), across * np.sin(a), up), -1)
    return occupied(volume, points), MM * np.array([-OUTER, OUTER, LOW, HIGH])


def run(out, progress):
    rows, volumes = [], {}
    for name in dict.fromkeys(concavity.object for concavity in CONCAVITIES):
        scan, truth = captured(out, name, progress)
        hull = methods.reconstruct(scan, "visual-hull", voxels=VOXELS, progress=progress).volume
        volumes[name] = inside(truth, hull.grid), hull
        rows += [(name, concavity.label, *depths(concavity, truth, *volumes[name]))
                 for concavity in CONCAVITIES if concavity.object == name]
    figure, axes = drawing.panels(900, 460, 1, len(DRAWN))
    for panel, concavity in zip(axes, DRAWN, strict=True):
        draw(panel, concavity, *volumes[concavity.object])
    drawing.key(figure, truth=drawing.TRUTH, what_the_hull_has_too_much=drawing.HULL, missed_along_the_axis=drawing.BLUE)
    drawing.save(figure, out, EXPERIMENT.name)
    return tabulate(rows)


def tabulate(rows):
    note = (f"{VIEWS} views in one ring at 20 degrees, {VOXELS} voxels, conservative rule (which adds up to a voxel). Depth is below the "
            "plane that closes the mouth, along the concavity's axis. Where the hull rises above the truth by clearly more than "
            "the depth, it bulges out of the mouth: no camera of the ring looks along the mouth's plane.")
    return Table(("object", "concavity", "depth, mm", "hull above the truth, mm", "depth that the hull shows, mm"), tuple(rows), note)


def draw(panel, concavity, truth, hull):
    """Draw the section through the truth and the hull, and the missed depth."""
    (true_cut, extent), (hull_cut, _) = section(concavity, truth), section(concavity, hull)
    drawing.show(panel, np.where(true_cut, 2, hull_cut.astype(int)), ("white", drawing.HULL, drawing.TRUTH), extent)
    start, axis = concavity.start, concavity.axis
    ends = [start + farthest(volume, start, axis) * axis for volume in (truth, hull)]
    across = np.array([np.cos(np.radians(concavity.azimuth)), np.sin(np.radians(concavity.azimuth)), 0])
    bottom, top = (MM * np.array([end @ across, end[2]]) for end in ends)
    panel.annotate("", top, bottom, arrowprops={"arrowstyle": "<->", "color": drawing.BLUE, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0})
    panel.set(xlabel="across, mm", ylabel="height, mm", title=f"{concavity.object}, {concavity.label}")


EXPERIMENT = Experiment("concavities", "The concavities that silhouettes miss: sections through truth and hull.", run)
