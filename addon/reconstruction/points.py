# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A cloud of measured points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class PointCloud:
    """Points on a surface, and what is known of each.

    Parameters
    ----------
    positions : (n, 3) float64 array
        In the object frame, in the scene's unit.
    normals : (n, 3) float32 array
        Unit vectors that point out of the surface, towards the camera that saw the point.
    colors : (n, 3) float32 array
        Linear RGB.
    sigma : (n,) float32 array
        Expected standard deviation of the position along the camera's ray.
    view : (n,) uint16 array
        Number of the view in the scan.

    Raises
    ------
    ValueError
        An array has another shape, or a number is not finite.
    """

    positions: np.ndarray
    normals: np.ndarray
    colors: np.ndarray
    sigma: np.ndarray
    view: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.positions)
        for name, kind, shape in (("positions", np.float64, (count, 3)), ("normals", np.float32, (count, 3)),
                                  ("colors", np.float32, (count, 3)), ("sigma", np.float32, (count,)), ("view", np.uint16, (count,))):
            array = np.asarray(getattr(self, name), kind)
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(f"{name} must be {shape} finite numbers, not {array.shape}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.positions)

    @classmethod
    def joined(cls, clouds: Sequence[PointCloud]) -> PointCloud:
        """Return all points of several clouds; of none, an empty one."""
        empty = cls(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))
        return cls(*(np.concatenate([getattr(cloud, item.name) for cloud in (empty, *clouds)]) for item in fields(cls)))

    def chosen(self, rows: np.ndarray) -> PointCloud:
        """Return the points of a bool mask or of row numbers."""
        return PointCloud(*(getattr(self, item.name)[rows] for item in fields(self)))

    def within(self, bounds: np.ndarray) -> PointCloud:
        """Return the points in a (2, 3) box."""
        return self.chosen(((self.positions >= bounds[0]) & (self.positions <= bounds[1])).all(axis=1))
