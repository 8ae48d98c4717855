# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a method's function returns: a volume, and whatever else it alone can tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .points import PointCloud
from .volumetric.coloring import SurfaceColors
from .volumetric.surface import Surface
from .volumetric.volume import SparseVolume


@dataclass(frozen=True)
class VoxelLayer:
    """Numbers for chosen voxels, besides the volume: what was carved and by whom, how probable a voxel is.

    Parameters
    ----------
    voxels : (n, 3) int32 array
        Indices in the volume's grid, each at most once.
    values : mapping of str to (n,) array
        Integers, bools or floats, by what they are.
    """

    voxels: np.ndarray
    values: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        if self.voxels.ndim != 2 or self.voxels.shape[1] != 3:
            raise ValueError(f"voxels must have the shape (n, 3), not {self.voxels.shape}")
        for name, values in self.values.items():
            if values.shape != (len(self.voxels),):
                raise ValueError(f"{name} must have one value for each of the {len(self.voxels)} voxels, not {values.shape}")


@dataclass(frozen=True)
class Outcome:
    """What a method found.

    Parameters
    ----------
    volume : SparseVolume
    report : dict
        Plain JSON values: what the method counted, and ``warnings``, a list of sentences.
    surface : Surface, optional
        Of the volume, where the method has extracted it anyway.
    colors : SurfaceColors, optional
        One row for each of ``surface.voxels``, where the method itself finds colours; otherwise the views give them.
    layers : mapping of str to VoxelLayer
    pictures : mapping of str to (h, w, 3) uint8 array
        sRGB, to be looked at.
    points : PointCloud, optional
        Where the method measures points; the volume is then made of them.
    """

    volume: SparseVolume
    report: dict
    surface: Surface | None = None
    colors: SurfaceColors | None = None
    layers: Mapping[str, VoxelLayer] = field(default_factory=dict)
    pictures: Mapping[str, np.ndarray] = field(default_factory=dict)
    points: PointCloud | None = None

    def __post_init__(self) -> None:
        if self.colors is not None and (self.surface is None or len(self.colors.rgb) != len(self.surface.voxels)):
            raise ValueError("colors need the surface that they belong to")
