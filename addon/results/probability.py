# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result whose voxels have probabilities, cut at any threshold: nothing is computed again but the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..reconstruction.volumetric.coloring import NEUTRAL
from ..reconstruction.volumetric.probabilistic_carving import LAYER, above
from ..reconstruction.volumetric.surface import Surface, extract_surface
from .folder import Result
from .layers import rows_of


@dataclass(frozen=True)
class Cut:
    """The surface of the voxels above a threshold.

    Parameters
    ----------
    surface : Surface
    rgb : (s, 3) float32 array
        Linear, one row for each row of ``surface.voxels``; grey where no picture shows the voxel.
    probability : (s,) float32 array
        The prior where no picture shows the voxel.
    """

    surface: Surface
    rgb: np.ndarray
    probability: np.ndarray


def has_probabilities(result: Result) -> bool:
    """Return whether the result's voxels have probabilities."""
    return LAYER in result.layers and {"probability", "red", "green", "blue"} <= result.layers[LAYER].values.keys()


def threshold_of(result: Result) -> float:
    """Return the threshold that the result was made with."""
    return float(result.report["options"]["least_probability"])


def cut(result: Result, threshold: float) -> Cut:
    """Return the surface of a result with probabilities at some threshold."""
    layer = result.layers[LAYER]
    surface = extract_surface(above(result.volume, layer, threshold))
    row = rows_of(layer, surface.voxels, result.volume.grid)
    known = row >= 0
    values = np.empty((len(row), 4), np.float32)
    values[:] = (result.report["options"]["prior"], NEUTRAL, NEUTRAL, NEUTRAL)
    values[known] = np.stack([layer.values[name][row[known]] for name in ("probability", "red", "green", "blue")], axis=1)
    return Cut(surface, values[:, 1:], values[:, 0])
