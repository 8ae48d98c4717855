# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which views show an object alike enough to be matched with each other."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .geometry import Camera

NARROWEST, WIDEST = math.radians(1.0), math.radians(30.0)
"""Angles between two views, seen from the object: nearer there is no depth, farther too little looks alike."""


def nearest_views(cameras: Sequence[Camera], middle: np.ndarray, widest: float = WIDEST) -> list[tuple[int, int]]:
    """Return each view's number with that of the view nearest to it, seen from a point, where one is near enough but not in its place."""
    to_cameras = np.array([camera.centre for camera in cameras]).reshape(-1, 3) - middle
    to_cameras /= np.linalg.norm(to_cameras, axis=1, keepdims=True)
    angles = np.arccos(np.clip(to_cameras @ to_cameras.T, -1, 1))
    angles[angles < NARROWEST] = np.inf
    nearest = angles.argmin(axis=1) if len(angles) else ()
    return [(number, int(other)) for number, other in enumerate(nearest) if angles[number, other] <= widest]
