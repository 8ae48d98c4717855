# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Experiments with a depth sensor's dots: tests judge their numbers, and `scripts/figures.py` prints them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.speckle import STEPS
from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.methods import METHODS
from addon.reconstruction.scan import Scan
from tests.projection import Wall, projected_view, sight

NOISE = {"noise": 2 / 255, "levels": 255}


@dataclass(frozen=True)
class Plate:
    """A flat upright plate across y = const."""

    y: float
    left: float
    right: float

    def distances(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return where (..., 3) unit rays meet the plate; infinite if nowhere."""
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (self.y - origin[1]) / rays[..., 1]
            x = origin[0] + distance * rays[..., 0]
        return np.where((distance > 1e-9) & (x >= self.left) & (x <= self.right), distance, np.inf)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return the normals (..., 3), towards -y."""
        return np.broadcast_to(np.array([0.0, -1.0, 0.0]), points.shape)


SENSOR = Camera([[580, 0, 159.5], [0, 580, 119.5], [0, 0, 1]], *look_at((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), (320, 240))  # Kinect's middle
DOTS = Camera([[870, 0, 575.5], [0, 870, 431.5], [0, 0, 1]], *look_at((0.075, 0.0, 0.0), (0.075, 1.0, 0.0)), (1152, 864))
SENSOR_WINDOW = 9
TILT = np.radians(15.0)
QUANTUM = 1 / (STEPS * 580 * 0.075)  # times the square of the depth (Khoshelham & Elberink, 2012)


@dataclass(frozen=True)
class DepthSensor:
    """A depth sensor before a wall at one depth; metres.

    Parameters
    ----------
    step : float
        Median distance of neighbouring depths that it can tell.
    sigma : float
        Standard deviation of the depths.
    filled : float
        Share of the pixels that see the wall in the dots' light, less a margin of a window, that have a depth.
    """

    step: float
    sigma: float
    filled: float


def depth_sensor(depth: float) -> DepthSensor:
    """Measure a wall, a little tilted so that its depths lie anywhere between the sensor's steps."""
    normal = np.array([np.sin(TILT), -np.cos(TILT), 0.0])
    wall = Wall(tuple(normal), -depth * float(np.cos(TILT)))
    cloud = METHODS["speckle"].measure(Scan((_speckle_view([wall]),), box_about(depth))).cloud
    points = cloud.positions.astype(np.float64)
    off = (points @ normal - wall.offset) / normal[1]  # along the axis
    levels, count = np.unique(np.round(points[:, 1], 6), return_counts=True)
    levels = levels[count > 0.002 * len(points)]
    steps = np.diff(levels) / ((levels[1:] + levels[:-1]) / 2) ** 2
    seen = (sight(SENSOR, DOTS, [wall]).light > 0).astype(np.uint8)
    seen = cv2.erode(seen, np.ones((SENSOR_WINDOW, SENSOR_WINDOW), np.uint8), borderValue=0)
    return DepthSensor(float(np.median(steps)) * depth ** 2, float(np.std(off)), len(points) / int(np.count_nonzero(seen)))


def sensor_shadow(near: float = 1.0, far: float = 1.5) -> tuple[float, float]:
    """Return how wide the hole beside a near plate is in pixels, measured, and by the formula ``f b (1 / near - 1 / far)``."""
    surfaces = [Plate(near, -0.1, 0.1), Wall((0.0, -1.0, 0.0), -far)]
    view = _speckle_view(surfaces)
    measured = METHODS["speckle"].measure(Scan((view,), box_about(1.2)))
    depths = measured.depths[0].depths[100:140]
    edge = int(round(159.5 - 580 * 0.1 / near))  # of the plate, away from the projector
    hole = (depths[:, edge - 60:edge] == 0).sum(axis=1)
    return float(np.median(hole)), 580 * 0.075 * (1 / near - 1 / far)


def wall_view(depth: float, **how):
    """Return a view of a wall across the axis under dots."""
    return _speckle_view([Wall((0.0, -1.0, 0.0), -depth)], **how)


def _speckle_view(surfaces, **how):
    return projected_view(SENSOR, DOTS, make_patterns("speckle", DOTS.size, {"dot": 3}), surfaces, samples=8, **{**NOISE, **how})


def box_about(depth: float) -> np.ndarray:
    """Return the (2, 3) working volume of a sensor that looks for things at about a depth."""
    return np.array([[-depth, 0.6 * depth, -depth], [depth, 1.6 * depth, depth]])
