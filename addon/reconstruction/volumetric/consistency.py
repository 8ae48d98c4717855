# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photo-consistency: could what the views show of a voxel be one piece of a matte surface?

Each measure turns the samples of voxels into scores; a voxel is consistent if its score is not above a threshold. All
assume that a surface looks the same from everywhere (Lambert) and differ in what else they assume. Carving is safe in any
order only with a measure that is monotone: what is inconsistent stays so when more is seen of it (Kutulakos & Seitz, 2000).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from ...options import Option
from .footprints import Pictures, Samples

TEXTURE = 0.01  # standard deviation of a patch's luminance below which correlation means nothing
WITHIN = 2.0  # how much of the spread within a view the adaptive measure forgives


class Monotone(Enum):
    """What may be added to an inconsistent set of samples without making it consistent."""

    NOT = "not monotone"
    IN_VIEWS = "monotone in the views"
    IN_PIXELS = "monotone in views and pixels"


@dataclass(frozen=True)
class Measure:
    """One photo-consistency measure.

    Parameters
    ----------
    name, label, description : str
        The description says what is measured and what that assumes.
    monotone : Monotone
    threshold : float
        The default: the highest score of a consistent voxel.
    scores : callable
        ``scores(samples, noise) -> (n,) float array``. ``noise`` is the standard deviation of the sensor's noise in linear
        colour. Scores of voxels that fewer than two views see mean nothing.
    needs : {'', 'spread', 'cells', 'patches'}
        What the samples must hold besides means.
    """

    name: str
    label: str
    description: str
    monotone: Monotone
    threshold: float
    scores: Callable[[Samples, float], np.ndarray]
    needs: str = ""


def deviation(samples: Samples, noise: float) -> np.ndarray:
    """Return the standard deviation of all pixels, the root of the mean of the channels' variances; views weigh the same."""
    between, within = _between(samples), _within(samples)
    return np.sqrt((between + within).mean(axis=1))


def chi_square(samples: Samples, noise: float) -> np.ndarray:
    """Return how unlikely sensor noise alone explains the views' means, in standard deviations (Seitz & Dyer, 1999).

    ``(m - 1) s^2 / noise^2`` summed over the channels is a chi-square of 3 (m - 1) degrees of freedom.
    """
    views = samples.views
    between = _between(samples)
    return _normal(between.sum(axis=1) * views / noise ** 2, 3 * (views - 1))


def pairwise(samples: Samples, noise: float) -> np.ndarray:
    """Return the greatest difference in any channel between two samples: the maximum pairwise distance in the L-infinity norm."""
    seen = samples.seen[..., None]
    low = np.where(seen, samples.low, np.inf).min(axis=0)
    return (np.where(seen, samples.high, -np.inf).max(axis=0) - low).max(axis=1)


def adaptive(samples: Samples, noise: float) -> np.ndarray:
    """Return the standard deviation of all pixels less `WITHIN` times the mean of those within a view (Slabaugh et al., 2004)."""
    within = np.sqrt(samples.variance.mean(axis=2)).sum(axis=0) / np.maximum(samples.views, 1)
    return deviation(samples, noise) - WITHIN * within


def histogram(samples: Samples, noise: float) -> np.ndarray:
    """Return the share of the pairs of views that have no cell of colours in common (Stevens, Culbertson & Malzbender, 2002)."""
    cells, seen = samples.cells, samples.seen
    disjoint = np.zeros(seen.shape[1])
    for first in range(len(cells)):
        shared = (cells[first + 1:] & cells[first]).any(axis=2)
        disjoint += np.count_nonzero(~shared & seen[first + 1:] & seen[first], axis=0)
    views = samples.views
    return disjoint / np.maximum(views * (views - 1) / 2, 1)


def correlation(samples: Samples, noise: float) -> np.ndarray:
    """Return 1 less the mean normalised cross-correlation of all pairs of views' patches; 0 where fewer than two have texture."""
    patches = samples.patches - samples.patches.mean(axis=2, keepdims=True)
    length = np.linalg.norm(patches, axis=2, keepdims=True)
    textured = (length[..., 0] > TEXTURE * np.sqrt(patches.shape[2])) & samples.seen
    unit = np.divide(patches, length, out=np.zeros_like(patches), where=textured[..., None])
    count = textured.sum(axis=0)
    # the sum over all pairs of products is half of what the square of the sum has beside the squares
    pairs = ((unit.sum(axis=0) ** 2).sum(axis=1) - count) / 2
    return np.where(count > 1, 1 - pairs / np.maximum(count * (count - 1) / 2, 1), 0)


def likelihood_ratio(samples: Samples, noise: float) -> np.ndarray:
    """Return how unlikely the views' pixels come from one normal distribution, in standard deviations (Broadhurst & Cipolla, 2000).

    ``-2 ln L = n ln(s0^2 / sw^2)`` a channel, with the variance s0^2 of all n pixels and sw^2 of those within the views, is
    a chi-square of m - 1 degrees of freedom. The sensor's noise is the least that a variance can be.
    """
    between, within = _between(samples), np.maximum(_within(samples), noise ** 2)
    count = samples.pixels.sum(axis=0)[:, None]
    return _normal((count * np.log1p(between / within)).sum(axis=1), 3 * (samples.views - 1))


def _between(samples: Samples) -> np.ndarray:
    """Return the (n, 3) variances of the views' means."""
    rgb = samples.rgba[..., :3]  # zero where a view does not see the voxel
    square = np.einsum("vnc,vnc->nc", rgb, rgb) / np.maximum(samples.views, 1)[:, None]
    return np.maximum(square - samples.colors ** 2, 0)


def _within(samples: Samples) -> np.ndarray:
    """Return the (n, 3) means of the variances within the views."""
    return samples.variance.sum(axis=0) / np.maximum(samples.views, 1)[:, None]


def _normal(chi_square: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Return standard normal deviates of chi-square values (Wilson & Hilferty, 1931)."""
    spread = 2 / (9 * np.maximum(degrees, 1))
    return (np.cbrt(chi_square / np.maximum(degrees, 1)) - (1 - spread)) / np.sqrt(spread)


MEASURES = {measure.name: measure for measure in (
    Measure("adaptive", "Adaptive", "Deviation less that within the views: forgives edges of texture inside a voxel, assumes that "
            "every view resolves them alike", Monotone.NOT, 0.04, adaptive, "spread"),
    Measure("deviation", "Standard deviation", "Deviation of all pixels: assumes that a voxel has one colour",
            Monotone.NOT, 0.08, deviation, "spread"),
    Measure("chi-square", "Chi-square", "Deviation of the views' means against the sensor's noise, in standard deviations: assumes "
            "that nothing but noise makes them differ", Monotone.NOT, 3.1, chi_square),
    Measure("pairwise", "Maximum pairwise distance", "Greatest difference between two samples: assumes that a voxel has one colour and "
            "that there are no outliers", Monotone.IN_PIXELS, 0.25, pairwise),
    Measure("histogram", "Histogram", "Share of the pairs of views without a common colour: assumes only that every two views show some "
            "colour of the voxel alike", Monotone.IN_VIEWS, 0.0, histogram, "cells"),
    Measure("ncc", "Normalised cross-correlation", "One less the mean correlation of patches: assumes texture and a smooth surface, and "
            "forgives gain and offset; where there is no texture nothing is removed", Monotone.NOT, 0.4, correlation, "patches"),
    Measure("likelihood", "Likelihood ratio", "One distribution of colours against one for each view, in standard deviations: assumes "
            "normal distributions and independent pixels", Monotone.NOT, 8.0, likelihood_ratio, "spread"),
)}

OPTIONS = (
    Option("consistency", "adaptive", "How colours are compared",
           choices={name: measure.description for name, measure in MEASURES.items()}),
    Option("consistency_threshold", 0.0, "Highest score of a consistent voxel; 0 for the measure's own", minimum=0),
    Option("noise", 0.01, "Standard deviation of the sensor's noise in linear colour, for the measures that ask for it", minimum=1e-4,
           maximum=1),
    Option("min_views", 2, "Views that must see a voxel before it is judged; with fewer it stays, uncoloured", minimum=2, maximum=64),
)


@dataclass(frozen=True)
class Judge:
    """A measure with its threshold.

    Parameters
    ----------
    measure : Measure
    threshold : float
    noise : float
    min_views : int
        With fewer views a voxel is not judged.
    """

    measure: Measure
    threshold: float
    noise: float
    min_views: int

    @classmethod
    def of(cls, *, consistency: str, threshold: float, noise: float, min_views: int) -> Judge:
        """Return the judge that the options describe."""
        measure = MEASURES[consistency]
        return cls(measure, threshold or measure.threshold, noise, min_views)

    def sample(self, pictures: Pictures, rows: np.ndarray, rgba: np.ndarray, points: np.ndarray, normals: np.ndarray) -> Samples:
        """Return the samples in ``rows`` (v, n) of pictures ``rgba`` with all that the measure needs.

        ``points`` (n, 3), in voxel coordinates, and ``normals`` (n, 3) of any length say where patches lie.
        """
        samples = pictures.at(rows, rgba, spread=self.measure.needs == "spread", cells=self.measure.needs == "cells")
        if self.measure.needs == "patches":
            return replace(samples, patches=pictures.patches(points, normals) * samples.seen[..., None])
        return samples

    def refuses(self, samples: Samples) -> np.ndarray:
        """Return (n,) bool: the voxels that enough views see and that they disagree on."""
        return (samples.views >= self.min_views) & (self.measure.scores(samples, self.noise) > self.threshold)

    def report(self, *, whole_footprints: bool) -> dict:
        """Return what a report says about the measure.

        Parameters
        ----------
        whole_footprints : bool
            Whether a view sees all of a voxel's footprint or nothing, so that monotone in the views is monotone.
        """
        monotone = self.measure.monotone
        safe = monotone is Monotone.IN_PIXELS or (whole_footprints and monotone is Monotone.IN_VIEWS)
        return {"measure": self.measure.name, "assumption": self.measure.description, "threshold": self.threshold,
                "monotone": safe, "monotony": monotone.value}
