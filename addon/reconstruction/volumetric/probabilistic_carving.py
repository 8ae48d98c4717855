# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Probabilistic carving: how probable it is that a voxel is occupied, given all pictures and what hides what.

Each pass asks every picture about every voxel (`ray_occupancy`), with visibilities and colours out of the pass before,
and begins again from the prior: what the pictures say is never counted twice, their order does not matter, and nothing
that was doubted early is lost. Deterministic carving decides by a threshold, voxel by voxel, and can take nothing back;
here the threshold comes last, and can be changed without computing anything again.

In a surface of one colour every point explains the pictures equally well, and the probability stays the prior. Voxels
deep inside, which no ray reaches, take no part: bricks are listed as what lies before them becomes doubtful.

Pollard & Mundy (2007) update voxel by voxel, picture by picture. Here all messages of a pass are combined at once, and a
picture is told what the others say of the voxels before it is asked: the sum-product algorithm on the same model. With
one ray to a voxel both are the same, and exact. Visibility and colour model as in Broadhurst, Drummond & Cipolla (2001).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...errors import ScanstageError
from ...options import Option
from ...progress import Progress, part_of, silent
from ..geometry import VoxelGrid
from ..outcome import Outcome, VoxelLayer
from ..scan import Scan
from .appearance import Evidence, Population, densities, predicted
from .footprints import Pictures
from .ray_occupancy import ray_messages
from .silhouette_test import RULES
from .visual_hull import visual_hull, working_bounds
from .volume import BRICK, EMPTY, FULL, SparseVolume

LAYER = "probability"
OPTIONS = (
    Option("rule", "center", "When a voxel is outside the hull of the silhouettes, in which the work begins", choices=RULES),
    Option("prior", 0.65, "Probability that a voxel of the hull is occupied, before any colours are compared; voxels that no picture "
                         "tells about keep it", minimum=0.05, maximum=0.95),
    Option("noise", 0.02, "Standard deviation of the camera's noise in a pixel, as a share of white", minimum=0.001, maximum=0.5),
    Option("independence", 0.2, "How much of each picture's evidence counts: at 1 the pictures' errors are taken to have nothing in "
                                "common, which makes too sure of everything", minimum=0.01, maximum=1.0),
    Option("passes", 16, "How often visibility and colours are estimated anew, at most", minimum=1, maximum=100),
    Option("least_probability", 0.5, "A voxel that is less probable is not in the volume; can be changed afterwards", minimum=0.0,
           maximum=1.0),
)

LEAST, MOST = 1e-3, 0.999  # probability
SEEN = 0.05  # probability that some ray reaches a voxel, below which no picture tells about it
UNDECIDED = 0.1  # the most that an undecided voxel's probability differs from the prior
_BACKGROUND = 0.05  # share of pixels inside a mask that show background
_OUTLIERS = 0.05  # share of pixels that show something else: highlights, edges, what lies between the centres of voxels
_FOOTPRINT = 0.5  # variance of a footprint's colour where it is read, of that of its pixels
_SETTLED = 3e-4  # mean change of probability in a pass
_NO_VOXELS = np.zeros((0, 3), np.int32)
_BLOCK = 1 << 17  # voxels of whole rays that are worked on together


@dataclass
class Belief:
    """What is known of the listed voxels by now.

    Parameters
    ----------
    voxels : (n, 3) int32 array
    odds : (n,) float32 array
        Logarithm of the odds that a voxel is occupied.
    visibility : (n,) float32 array
        The greatest probability that a ray reaches the voxel.
    moments : (n, 4) float32 array
        Of its colour: see `appearance`.
    messages : (v, n) float16 array
        What each picture adds to the odds.
    weights : (v, n) float16 array
        The probability, for every picture, that it shows the voxel if that is occupied.
    """

    voxels: np.ndarray
    odds: np.ndarray
    visibility: np.ndarray
    moments: np.ndarray
    messages: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, voxels: np.ndarray, prior: float, views: int) -> Belief:
        """Return the belief in the prior."""
        n = len(voxels)
        return cls(voxels, np.full(n, np.log(prior / (1 - prior)), np.float32), np.zeros(n, np.float32), np.zeros((n, 4), np.float32),
                   np.zeros((views, n), np.float16), np.zeros((views, n), np.float16))

    def extended(self, other: Belief) -> Belief:
        """Return the belief about the voxels of both."""
        by_voxel = ("voxels", "odds", "visibility", "moments")
        return Belief(*(np.concatenate((mine, getattr(other, name)), axis=0 if name in by_voxel else 1)
                        for name, mine in vars(self).items()))

    @property
    def occupancy(self) -> np.ndarray:
        """The (n,) float64 probabilities that the voxels are occupied."""
        return probability(self.odds)


def probability(odds: np.ndarray) -> np.ndarray:
    """Return the probabilities of log-odds, kept away from certainty."""
    return np.clip(1 / (1 + np.exp(-odds.astype(np.float64))), LEAST, MOST)


def probabilistic_bounds(scan: Scan, *, rule: str, **options) -> np.ndarray:
    """Return the (2, 3) working volume: the capture's own, or one found from the silhouettes."""
    return working_bounds(scan, rule=rule, tolerance=0, outside="unknown")


def probabilistic_carving(scan: Scan, grid: VoxelGrid, *, rule: str = "center", prior: float = 0.65, noise: float = 0.02,
                          independence: float = 0.2, passes: int = 16, least_probability: float = 0.5,
                          progress: Progress = silent) -> Outcome:
    """Estimate the probability that voxels of the visual hull are occupied.

    Parameters
    ----------
    scan : Scan
    grid : VoxelGrid
    rule : {'center', 'conservative'}
        Of the hull. The conservative one is a layer of half-filled voxels too large, which are neither occupied nor empty.
    prior, noise, independence, passes, least_probability
        See `OPTIONS`.
    progress : Progress

    Returns
    -------
    Outcome
        With the layer ``probability``: of all voxels that a picture tells about, the ``probability`` and the linear colour
        ``red``, ``green``, ``blue``. The volume is the hull without those of them that are not above ``least_probability``.

    Raises
    ------
    ScanstageError
        There are fewer than two views, no hull can be carved, or nothing is probable enough.
    """
    if len(scan.views) < 2:
        raise ScanstageError(f"the capture has {len(scan.views)} view(s): colours can only be compared between two or more; capture more")
    hull = visual_hull(scan, grid, rule=rule, outside="unknown", progress=part_of(progress, 0.0, 0.1))
    pictures = Pictures.of(scan.views, grid, part_of(progress, 0.1, 0.2))
    # A pixel of a reduced picture is the mean of several, which have less noise together.
    noises = noise * np.array([reduced.K[0, 0] / view.camera.K[0, 0] for reduced, view in zip(pictures.cameras, scan.views, strict=True)])
    population = Population.of(pictures.rgba[pictures.rgba[:, 3] > 0, :3], float(noises.mean()))
    shell = _Shell(hull.volume)
    belief = Belief.of(shell.grow(), prior, len(scan.views))
    for number in range(1, passes + 1):
        before = belief.occupancy
        _ask(belief, pictures, population, prior, noises=noises, independence=independence, voxel_size=grid.voxel_size,
             progress=part_of(progress, 0.2 + 0.8 * (number - 1) / passes, 0.2 + 0.8 * number / passes))
        grown = shell.grow(belief.voxels[belief.occupancy < 0.5])
        # The first pass only learns the colours.
        if number == passes or (number > 1 and not len(grown) and np.abs(belief.occupancy - before).mean() < _SETTLED):
            break
        belief = belief.extended(Belief.of(grown, prior, len(scan.views)))
    layer, undecided = _layer(belief, population, prior)
    volume = above(hull.volume, layer, least_probability)
    if not volume.count():
        raise ScanstageError(f"no voxel is more probable than {least_probability:g}: lower it (--set least_probability=...), or check the "
                             "poses and that the light keeps still with respect to the object")
    counts = {"judged": len(layer.voxels), "removed": hull.volume.count() - volume.count(), "undecided": undecided}
    return Outcome(volume, {"counts": counts, "passes": number, "warnings": hull.report["warnings"]}, layers={LAYER: layer})


def _layer(belief: Belief, population: Population, prior: float) -> tuple[VoxelLayer, int]:
    """Return the layer of the voxels that are seen, and of how many of them the pictures tell hardly anything."""
    seen = belief.visibility > SEEN
    occupancy = belief.occupancy[seen]
    red, green, blue = predicted(belief.moments[seen], population)[0].astype(np.float32).T
    values = {"probability": occupancy.astype(np.float32), "red": red, "green": green, "blue": blue}
    return VoxelLayer(belief.voxels[seen], values), int(np.count_nonzero(np.abs(occupancy - prior) < UNDECIDED))


def above(volume: SparseVolume, layer: VoxelLayer, threshold: float) -> SparseVolume:
    """Return a volume without, and with, those voxels of a layer whose probability is not, and is, above a threshold.

    What the layer does not list stays as it is: no picture tells about it.
    """
    return volume.updated(layer.voxels, layer.values["probability"] > threshold)


class _Shell:
    """The bricks of a hull whose voxels are listed: those at most one brick from where a ray may pass."""

    def __init__(self, hull: SparseVolume) -> None:
        self._hull = hull
        self._listed = np.zeros(hull.brick_map.shape, bool)

    def grow(self, doubtful: np.ndarray = _NO_VOXELS) -> np.ndarray:
        """Return the (n, 3) voxels to be listed besides, where some voxels (m, 3) are doubtful."""
        pervious = self._hull.brick_map != FULL
        pervious[tuple((doubtful // BRICK).T)] = True
        near = np.pad(pervious, 1, constant_values=True)
        for axis in range(3):
            near = near | np.roll(near, 1, axis) | np.roll(near, -1, axis)
        fresh = near[1:-1, 1:-1, 1:-1] & (self._hull.brick_map != EMPTY) & ~self._listed
        self._listed |= fresh
        bricks = np.argwhere(fresh)
        rows = self._hull.brick_map[fresh]
        cells = np.ones((len(bricks), BRICK ** 3), bool)
        cells[rows >= 0] = self._hull.bricks[rows[rows >= 0]].reshape(-1, BRICK ** 3)
        place, cell = np.nonzero(cells)
        return (bricks[place] * BRICK + np.stack(np.unravel_index(cell, (BRICK,) * 3), axis=-1)).astype(np.int32)


def _ask(belief: Belief, pictures: Pictures, population: Population, prior: float, *, noises: np.ndarray, independence: float,
         voxel_size: float, progress: Progress) -> None:
    """Ask all pictures, whose noise has the standard deviations (v,), about the voxels, and renew everything that is believed of them."""
    odds = np.full(len(belief.voxels), np.log(prior / (1 - prior)))
    moments = np.zeros_like(belief.moments)
    belief.visibility[:] = 0
    points = belief.voxels + np.float32(0.5)
    for number in range(len(pictures.cameras)):
        progress(number / len(pictures.cameras), "Estimating probabilities")
        for rows, pixels, first in _rays(pictures, number, points, voxel_size):
            sample = Evidence(pictures.rgba[pixels, :3].astype(np.float64),
                              _FOOTPRINT * pictures.spread[pixels, :3].mean(axis=1, dtype=np.float64) + noises[number] ** 2,
                              belief.weights[number, rows].astype(np.float64))
            density = densities(sample, belief.moments[rows], population)
            anything = population.density(sample.rgb, sample.variance)
            outlier = _OUTLIERS / (1 - _OUTLIERS) * anything
            by_others = probability(belief.odds[rows] - belief.messages[number, rows])
            found = ray_messages(by_others, density, _BACKGROUND * anything, first)
            message = (independence * np.log((found.occupied + outlier) / (found.empty + outlier))).astype(np.float16)
            weight = (found.visibility * density / (found.occupied + outlier)).astype(np.float16)
            belief.messages[number, rows], belief.weights[number, rows] = message, weight
            belief.visibility[rows] = np.maximum(belief.visibility[rows], found.visibility)
            odds[rows] += message
            moments[rows] += Evidence(sample.rgb, sample.variance, weight.astype(np.float64)).moments()
    belief.odds, belief.moments = odds.astype(np.float32), moments


def _rays(pictures: Pictures, number: int, points: np.ndarray, voxel_size: float) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the points that a picture tells about, in blocks of whole rays: their rows, their pixels, and where rays begin.

    A ray is as wide as a voxel at the middle of the points: a voxel is on one ray of each picture, with the one sample
    of its footprint, so that no picture counts for more because its pixels are smaller.
    """
    view = pictures.subset(np.arange(len(pictures.cameras)) == number)
    x, y, depth = view.project(points)
    pixels = view.rows_at(x, y)[0]
    rows = np.flatnonzero(pictures.rgba[pixels, 3] > 0)
    if not len(rows):
        return
    x, y, depth = x[0, rows], y[0, rows], depth[0, rows]
    K = view.cameras[0].K
    width = np.sqrt(K[0, 0] * K[1, 1]) * voxel_size / np.median(depth)
    ray = np.floor(y / width).astype(np.int64) * (1 << 31) + np.floor(x / width).astype(np.int64)
    order = np.lexsort((depth, ray))
    rows, ray = rows[order], ray[order]
    first = np.concatenate(([True], ray[1:] != ray[:-1]))
    start = np.flatnonzero(first)
    cuts = np.unique(start[np.minimum(np.searchsorted(start, np.arange(_BLOCK, len(rows), _BLOCK)), len(start) - 1)])
    for block in np.split(np.arange(len(rows)), cuts):
        if len(block):
            yield rows[block], pixels[rows[block]], first[block]
