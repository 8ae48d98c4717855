# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The colour of a voxel as a random variable: what is expected of one picture after the others have been seen.

A voxel's colour is normally distributed about an unknown mean. Before any picture, the mean is that of all the pictures'
colours, with their variance; each sample that probably shows the voxel narrows it (the conjugate normal model). The
density of a sample is always the one that the *other* pictures predict: a voxel that only one picture shows explains
that picture no better than any other voxel would, and in a picture of a single colour no voxel explains anything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_LEAST_VARIANCE = 1e-6  # that of pictures of one colour
_ANY = 0.01  # share of colours that are as probable as any other between black and white


@dataclass(frozen=True)
class Population:
    """All colours of the pictures, as one normal distribution.

    Parameters
    ----------
    mean : (3,) array
        Linear.
    variance : float
        Of a channel.
    """

    mean: np.ndarray
    variance: float

    @classmethod
    def of(cls, rgb: np.ndarray, noise: float) -> Population:
        """Return the distribution of (n, 3) colours, less the noise that they carry, of some standard deviation."""
        mean = rgb.mean(axis=0, dtype=np.float64)
        return cls(mean, max(float(((rgb - mean) ** 2).mean()) - noise ** 2, _LEAST_VARIANCE))

    def density(self, rgb: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """Return the (n,) densities of samples (n, 3) of some variance (n,) that show anything."""
        return (1 - _ANY) * _normal(rgb - self.mean, self.variance + variance) + _ANY


@dataclass(frozen=True)
class Evidence:
    """Samples of voxels in one picture.

    Parameters
    ----------
    rgb : (n, 3) array
    variance : (n,) array
        Of a channel: the sensor's, and the texture's within the footprint.
    weight : (n,) array
        The probability that the sample shows the voxel, where it is occupied.
    """

    rgb: np.ndarray
    variance: np.ndarray
    weight: np.ndarray

    def moments(self) -> np.ndarray:
        """Return what the samples add to the voxels' moments: (n, 4), of colour over variance and of one over variance."""
        return (self.weight / self.variance)[:, None] * np.column_stack((self.rgb, np.ones(len(self.rgb))))


def predicted(moments: np.ndarray, population: Population) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean (n, 3) and the variance (n,) of voxels' colours whose samples have these moments (n, 4)."""
    variance = 1 / (1 / population.variance + np.maximum(moments[:, 3], 0))
    return (population.mean / population.variance + moments[:, :3]) * variance[:, None], variance


def densities(evidence: Evidence, moments: np.ndarray, population: Population) -> np.ndarray:
    """Return the (n,) densities of samples that show their voxel.

    Parameters
    ----------
    evidence : Evidence
    moments : (n, 4) array
        Of all samples of the voxels, these among them.
    population : Population
    """
    mean, variance = predicted(moments - evidence.moments(), population)
    return _normal(evidence.rgb - mean, variance + evidence.variance)


def _normal(difference: np.ndarray, variance: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * np.einsum("ij,ij->i", difference, difference) / variance) / (2 * np.pi * variance) ** 1.5
