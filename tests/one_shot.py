# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Experiments with coloured stripes, dots and the shadow of a stick: tests judge their numbers, `scripts/figures.py` prints them."""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np

from addon.reconstruction.active.color_stripe_code import border_positions, border_steps
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.rectification import rectified_picture, rectify
from addon.reconstruction.active.speckle import STEPS
from addon.reconstruction.active.stripe_edges import edges_of
from addon.reconstruction.active.stripe_matching import best_path, border_scores, match_borders
from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.methods import METHODS
from addon.reconstruction.scan import Scan
from tests.projection import Round, Wall, projected_view, sight
from tests.rigs import Ball, camera_at

CAMERA = camera_at((0.0, -2.0, 0.0), focal=1100.0, size=(960, 720))
PROJECTOR = camera_at((0.5, -1.95, 0.0), focal=1100.0, size=(1024, 768))
BOX = np.array([[-0.9, -0.9, -0.9], [0.9, 1.4, 0.9]])
WALL, BALL = Wall((0.0, -1.0, 0.0), -0.4), Round(Ball((0.0, 0.0, 0.0), 0.35))
NOISE = {"noise": 2 / 255, "levels": 255}
WIDTH = 8
LEAST_WIDTH = 3  # pixels of a stripe: narrower ones cannot be told, as the option says
RIM = 3  # pixels beside an outline, where two surfaces meet in one pixel


@dataclass(frozen=True)
class Rod:
    """A flat upright rod across y = const."""

    y: float
    left: float
    right: float

    def distances(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return where (..., 3) unit rays meet the rod; infinite if nowhere."""
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (self.y - origin[1]) / rays[..., 1]
            x = origin[0] + distance * rays[..., 0]
        return np.where((distance > 1e-9) & (x >= self.left) & (x <= self.right), distance, np.inf)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return the normals (..., 3), towards -y."""
        return np.broadcast_to(np.array([0.0, -1.0, 0.0]), points.shape)


@dataclass(frozen=True)
class Borders:
    """Borders of stripes in a picture, of one surface.

    Parameters
    ----------
    visible, right, wrong : int
        How many there are in the light, how many of them were matched as they are, and how many otherwise.
    """

    visible: int
    right: int
    wrong: int

    @property
    def share(self) -> float:
        """Of the visible ones that are right."""
        return self.right / max(self.visible, 1)


def stripes(surfaces, *, passes: int = 4, tint=None, **how) -> list[Borders]:
    """Match one picture of coloured stripes; return what became of the borders on each surface."""
    pattern = make_patterns("color-stripes", PROJECTOR.size, {"width": WIDTH, "dark": False})[0]
    view = projected_view(CAMERA, PROJECTOR, [pattern], surfaces, **{**NOISE, **({} if tint is None else {"tint": tint}), **how})
    pair = rectify(CAMERA, PROJECTOR, BOX, "test")
    edges = edges_of(rectified_picture(CAMERA, pair.first, view.projected[0].read_image()), 0.02)
    found = match_borders(edges, border_steps(), passes=passes)
    places = border_positions(PROJECTOR.size, WIDTH, 0.0)
    truth = sight(pair.first, PROJECTOR, surfaces)
    lit = (truth.light > 0) & (rectified_picture(CAMERA, pair.first, np.ones(CAMERA.size[::-1], np.float32)) > 0.99)
    stripe = np.floor((truth.pixels[..., 0] - places[0]) / WIDTH)
    which = _nearest_surface(pair.first, surfaces, truth)
    parts = np.where(lit, which + 1, 0).astype(np.uint8)
    rim = np.ones((2 * RIM + 1,) * 2, np.uint8)
    deep = (cv2.erode(parts, rim) == cv2.dilate(parts, rim)) & lit
    slope = np.abs(np.diff(truth.pixels[..., 0], axis=1))
    both = deep[:, 1:] & deep[:, :-1] & (np.abs(stripe[:, 1:] - stripe[:, :-1]) == 1) & (slope * LEAST_WIDTH <= WIDTH)
    inside = (np.maximum(stripe[:, 1:], stripe[:, :-1]) >= 0) & (np.minimum(stripe[:, 1:], stripe[:, :-1]) < len(places) - 1)
    matched = found >= 0
    rows, columns, border = edges.rows[matched], np.rint(edges.columns[matched]).astype(int), found[matched]
    off = np.abs(truth.pixels[rows, columns, 0] - places[border]) > WIDTH / 2
    here = deep[rows, columns]
    return [Borders(int(np.count_nonzero(both & inside & (which[:, 1:] == number) & (which[:, :-1] == number))),
                    int(np.count_nonzero(here & ~off & (which[rows, columns] == number))),
                    int(np.count_nonzero(here & off & (which[rows, columns] == number)))) for number in range(len(surfaces))]


def _nearest_surface(camera, surfaces, truth) -> np.ndarray:
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1])), axis=-1).astype(float))
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return np.stack([surface.distances(camera.centre, rays) for surface in surfaces]).argmin(axis=0)


def rod_before_a_wall(passes: int) -> tuple[Borders, Borders]:
    """Return what becomes of the borders on a rod in front of a wall, and of those on the wall."""
    rod, wall = stripes([Rod(-0.3, -0.08, 0.09), Wall((0.0, -1.0, 0.0), -1.2)], passes=passes)
    return rod, wall


@dataclass(frozen=True)
class Compared:
    """RMS distance from a plane and number of points, of one picture and of seven in space and time."""

    one: float
    seven: float
    points_of_one: int
    points_of_seven: int


def space_time() -> Compared:
    """Measure a plane with a texture of random patches by one picture and by seven."""
    random = np.random.default_rng(3)
    patches = random.uniform(0.25, 0.95, (97, 97))

    def texture(points: np.ndarray) -> np.ndarray:
        x, z = (np.clip((points[..., axis] + 1) * 48, 0, 96).astype(int) for axis in (0, 2))
        return patches[x, z]

    found = []
    for shifts in (1, 7):
        patterns = make_patterns("color-stripes", PROJECTOR.size, {"width": WIDTH, "shifts": shifts, "dark": False})
        view = projected_view(CAMERA, PROJECTOR, patterns, [WALL], albedo=texture, **NOISE)
        cloud = METHODS["color-stripes"].measure(Scan((view,), BOX)).cloud
        found.append((float(np.sqrt(np.mean((cloud.positions[:, 1] - 0.4) ** 2))), len(cloud)))
    (one, few), (seven, many) = found
    return Compared(one, seven, few, many)


def realistic_scores(rows: int, count: int = 140) -> np.ndarray:
    """Return scores (rows, count, 125) of borders that are the projector's in order, with noise, some missing and some too many."""
    random = np.random.default_rng(5)
    borders = border_steps()
    steps = np.empty((rows, count, 3))
    for row in range(rows):
        kept = np.flatnonzero(random.random(len(borders)) < 0.9)
        line = np.sort(random.permutation(np.concatenate((kept, random.integers(0, len(borders), count))))[:count])
        steps[row] = borders[line] + random.normal(0, 0.15, (count, 3))
    return border_scores(borders, steps)


def plain_best_path(scores: np.ndarray) -> float:
    """Return the best path's score of one row (i, j) by the textbook's two loops."""
    count, borders = scores.shape
    table = [[0.0] * (borders + 1) for _ in range(count + 1)]
    choice = [[0] * (borders + 1) for _ in range(count + 1)]
    rows = scores.tolist()
    for i in range(1, count + 1):
        above, here, score, taken = table[i - 1], table[i], rows[i - 1], choice[i]
        for j in range(1, borders + 1):
            match, up, left = above[j - 1] + score[j - 1], above[j], here[j - 1]
            best = max(match, up, left)
            here[j] = best
            taken[j] = 0 if best == left else 1 if best == up else 2
    i, j = count, borders
    while i and j:
        step = choice[i][j]
        i, j = i - (step > 0), j - (step != 1)
    return table[count][borders]


def matching_speed(rows: int = 720, plainly: int = 6) -> tuple[float, float, float]:
    """Return the seconds of all rows at once, of two plain loops (for as many rows), and the greatest difference of their scores."""
    scores = realistic_scores(rows)
    start = time.perf_counter()
    _, totals = best_path(scores)
    ours = time.perf_counter() - start
    start = time.perf_counter()
    plain = [plain_best_path(scores[row]) for row in range(plainly)]
    theirs = (time.perf_counter() - start) * rows / plainly
    return ours, theirs, float(np.max(np.abs(totals[:plainly] - plain) / np.abs(plain)))


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
    cloud = METHODS["speckle"].measure(Scan((_speckle_view([wall]),), _sensor_box(depth))).cloud
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
    surfaces = [Rod(near, -0.1, 0.1), Wall((0.0, -1.0, 0.0), -far)]
    view = _speckle_view(surfaces)
    measured = METHODS["speckle"].measure(Scan((view,), _sensor_box(1.2)))
    depths = measured.depths[0].depths[100:140]
    edge = int(round(159.5 - 580 * 0.1 / near))  # of the plate, away from the projector
    hole = (depths[:, edge - 60:edge] == 0).sum(axis=1)
    return float(np.median(hole)), 580 * 0.075 * (1 / near - 1 / far)


def _speckle_view(surfaces):
    pattern = make_patterns("speckle", DOTS.size, {"dot": 3})
    return projected_view(SENSOR, DOTS, pattern, surfaces, samples=8, **NOISE)


def _sensor_box(depth: float) -> np.ndarray:
    return np.array([[-depth, 0.6 * depth, -depth], [depth, 1.6 * depth, depth]])
