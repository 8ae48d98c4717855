# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stripes of colour on analytic surfaces, and how well `color-stripes` tells them: tests judge it, `figures.py` prints it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from addon.reconstruction.active.color_stripes import Matches, find_stripes, match_pictures, passing_edges, stripe_width
from addon.reconstruction.active.patterns import Pattern, make_patterns
from addon.reconstruction.active.rectification import pixel_map, real_pixels, rectified_camera, rectify
from addon.reconstruction.active.scanline_matching import match_scanlines
from addon.reconstruction.active.stripe_edges import Channels
from addon.reconstruction.active.triangulation import meet_lines, rays_through
from addon.reconstruction.geometry import Camera
from addon.reconstruction.scan import ProjectedPicture
from tests.projection import Round, Sight, Wall, shown, sight
from tests.rigs import Ball, camera_at

CAMERA = camera_at((0.0, -2.0, 0.1), focal=1600.0, size=(1120, 80))
PROJECTOR = camera_at((0.5, -2.0, 0.1), focal=1000.0, size=(1024, 768))
NOISE = 2 / 255
SAMPLES = 3
Colors = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Rod:
    """An upright round rod."""

    x: float
    y: float
    radius: float

    def distances(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return where (..., 3) unit rays first meet the rod; infinite if nowhere."""
        a = (rays[..., :2] ** 2).sum(-1)
        to_axis = np.array((self.x, self.y)) - np.asarray(origin)[..., :2]
        b = (rays[..., :2] * to_axis).sum(-1)
        root = b ** 2 - a * ((to_axis ** 2).sum(-1) - self.radius ** 2)
        distance = (b - np.sqrt(np.where(root >= 0, root, np.nan))) / a
        return np.where(distance > 1e-9, distance, np.inf)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return the normals (..., 3) at points of the surface."""
        out = points - np.array((self.x, self.y, 0))
        out[..., 2] = 0
        return out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-12)


WALL = Wall((0.0, -1.0, 0.0), 0.0)
BALL = Round(Ball((0.0, 0.0, 0.0), 0.35))
ROD = Rod(0.05, -0.8, 0.035)


def colored_picture(seen: Sight, colors: np.ndarray, pattern: Pattern, *, crosstalk: np.ndarray, seed: int) -> np.ndarray:
    """Return a picture (h, w, 3) of a finely sampled sight: cross-talk in the camera, noise, 8 bits."""
    light = shown(pattern, seen.pixels)
    light = light if light.ndim == 3 else light[..., None]
    light = colors * seen.light[..., None] * (np.broadcast_to(light, (*seen.light.shape, 3)) @ crosstalk.T)
    height, width = light.shape[0] // SAMPLES, light.shape[1] // SAMPLES
    light = light.reshape(height, SAMPLES, width, SAMPLES, 3).mean(axis=(1, 3))
    light = light + np.random.default_rng(seed).normal(0, NOISE, light.shape)
    return (np.rint(np.clip(light, 0, 1) * 255) / 255).astype(np.float32)


@dataclass(frozen=True)
class Trial:
    """What was matched in simulated pictures, and the truth at every pixel of the rectified one.

    Parameters
    ----------
    found, missed
        As `color_stripes.match_pictures` returns them; ``timed`` as `passing_edges` does, where there are several pictures.
    truth : (h, w) array
        The projector's column; NaN where the projector lights nothing.
    surface : (h, w) int array
        Which surface is seen.
    rectified : Camera
    """

    found: Matches
    missed: np.ndarray
    timed: Matches | None
    truth: np.ndarray
    surface: np.ndarray
    rectified: Camera

    def true_positions(self, found: Matches) -> np.ndarray:
        """Return the projector's true column (n,) of matches, between pixels; NaN near what is not lit."""
        left = np.clip(np.floor(found.places).astype(int), 0, self.truth.shape[1] - 2)
        share = found.places - left
        return (1 - share) * self.truth[found.rows, left] + share * self.truth[found.rows, left + 1]

    def recall(self, stripes, *, surface: int | None = None, margin: int = 4) -> tuple[float, int, int]:
        """Return the share of visible edges that are matched, the number of wrong matches, and of visible edges.

        An edge is visible where a row crosses its column at least ``margin`` pixels from a border of shadow or silhouette, and the
        stripes there are four pixels wide or more.
        """
        inner = self.inner(margin) if surface is None else self.inner(margin) & (self.surface == surface)
        width, code = stripes.width, self.truth / stripes.width - stripes.position(-1) / stripes.width
        cell = np.floor(code)
        crossing = inner[:, :-1] & inner[:, 1:] & (cell[:, 1:] != cell[:, :-1])
        number = np.maximum(cell[:, 1:], cell[:, :-1])
        crossing &= np.abs(np.diff(self.truth, axis=1)) <= width / 4  # a step is measured over four pixels
        crossing &= (number >= 1) & (number <= stripes.stripes - 1)
        rows, columns = np.nonzero(crossing)
        truth = self.true_positions(self.found)
        near = np.clip(np.rint(self.found.places).astype(int), 0, self.truth.shape[1] - 1)
        right = np.abs(truth - self.found.positions) < width / 2
        hit = np.zeros((self.truth.shape[0], self.truth.shape[1] + 4), bool)
        for shift in range(-2, 3):  # a crossing lies between two pixels, and its match within two of it
            hit[self.found.rows[right], near[right] + 2 + shift] = True
        wrong = np.count_nonzero(~right & inner[self.found.rows, near])
        return float(hit[rows, columns + 2].mean()), int(wrong), len(rows)

    def inner(self, margin: int) -> np.ndarray:
        """Return the pixels (h, w) of which all to both sides, up to ``margin``, are lit and of the same surface."""
        lit = np.isfinite(self.truth)
        inner = lit.copy()
        for shift in range(1, margin + 1):
            for by in (-shift, shift):
                same = np.roll(lit, by, axis=1) & (np.roll(self.surface, by, axis=1) == self.surface)
                inner &= same
        inner[:, :margin] = inner[:, -margin:] = False
        return inner

    def depth_errors(self, found: Matches, wall: Wall) -> np.ndarray:
        """Return the distances (n,) of triangulated matches from a wall."""
        pixels = real_pixels(CAMERA, self.rectified, np.stack((found.places, found.rows), -1))
        rays = rays_through(CAMERA, pixels)
        distance = meet_lines(PROJECTOR, "column", found.positions, CAMERA.centre, rays)[0]
        return (CAMERA.centre + distance[:, None] * rays) @ np.array(wall.normal) - wall.offset


def trial(surfaces: Sequence, colors: Colors | tuple = (0.8, 0.8, 0.8), *, frames: int = 1, passes: int = 8, crosstalk: np.ndarray | None = None,
          primaries: bool = False) -> tuple[Trial, object]:
    """Simulate pictures of surfaces, and match them; return the trial and its `Stripes`."""
    crosstalk = np.eye(3) if crosstalk is None else crosstalk
    patterns = make_patterns("color-stripes", PROJECTOR.size, {"frames": frames, "primaries": primaries})
    fine = CAMERA.scaled(SAMPLES)
    seen = sight(fine, PROJECTOR, surfaces, 1.0)
    paint = colors(np.nan_to_num(seen.points)) if callable(colors) else np.broadcast_to(colors, seen.points.shape)
    pictures = [colored_picture(seen, paint, pattern, crosstalk=crosstalk, seed=seed) for seed, pattern in enumerate(patterns)]
    stripes = find_stripes([ProjectedPicture(p.id, p.fields, "projector", PROJECTOR, lambda image=image: image)
                            for p, image in zip(patterns, pictures, strict=True)])
    rectified = rectified_camera("0001", CAMERA, PROJECTOR, "column")
    places = pixel_map(CAMERA, rectified)
    images = [rectify(picture, places) for picture in pictures]
    channels = Channels.measured(np.stack(images[frames:frames + 3]), images[frames + 3], 0.05) if primaries else None
    found, missed = match_pictures(images[:frames], stripes, stripe_width(CAMERA, PROJECTOR, stripes), passes=passes, channels=channels)
    timed = passing_edges(np.stack(images[:frames]), found, stripes) if frames > 1 else None
    truth = sight(rectified, PROJECTOR, surfaces, 1.0)
    with np.errstate(invalid="ignore"):
        which = np.stack([surface.distances(rectified.centre, (np.nan_to_num(truth.points) - rectified.centre)
                                            / np.linalg.norm(np.nan_to_num(truth.points) - rectified.centre, axis=-1, keepdims=True))
                          for surface in surfaces]).argmin(axis=0)
    real = ((places >= 0) & (places <= np.array(CAMERA.size) - 1)).all(axis=-1)  # a rectified picture has corners beyond the real one
    return Trial(found, missed, timed, np.where((truth.light > 0.05) & real, truth.pixels[..., 0], np.nan), which, rectified), stripes


def mottled(points: np.ndarray) -> np.ndarray:
    """Return colours (..., 3) of a fine, strong texture."""
    wave = np.sin(points[..., 0] * 310) * np.sin(points[..., 2] * 270 + 1) + np.sin(points[..., 0] * 143 + points[..., 2] * 91)
    return 0.5 + 0.2 * np.stack((wave, np.roll(wave, 7, axis=1), np.roll(wave, 13, axis=1)), axis=-1)


def textured_plane(frames: int) -> tuple[float, float, int]:
    """Return distances of points from a plane of strong texture: RMS over all, RMS of those of the right stripe; and their number."""
    found, code = trial([WALL], mottled, frames=frames)
    matches = found.found if frames == 1 else found.timed
    errors = found.depth_errors(matches, WALL)
    right = np.abs(found.true_positions(matches) - matches.positions) < code.width / 2
    return float(np.sqrt(np.mean(errors ** 2))), float(np.sqrt(np.mean(errors[right] ** 2))), len(errors)


def plain_matching(scores: np.ndarray) -> float:
    """Return the best total of one scanline by the paper's recurrence, cell by cell, with the way back."""
    count, code = scores.shape
    rows = scores.tolist()
    best = [[0.0] * (code + 1) for _ in range(count + 1)]
    move = [[0] * (code + 1) for _ in range(count + 1)]
    for i in range(1, count + 1):
        for j in range(1, code + 1):
            choices = (best[i - 1][j], best[i][j - 1], best[i - 1][j - 1] + rows[i - 1][j - 1])
            best[i][j] = max(choices)
            move[i][j] = choices.index(best[i][j])
    i, j, matches = count, code, []
    while i and j:
        if move[i][j] == 2:
            matches.append((i - 1, j - 1))
        i, j = i - (move[i][j] != 1), j - (move[i][j] != 0)
    return sum(rows[i][j] for i, j in matches)


def matching_speed(lines: int = 720, plain_lines: int = 12) -> tuple[float, float]:
    """Return how many times faster than `plain_matching` scanlines of 140 edges and 125 stripes are matched, and the largest
    difference of the totals as a share; CPU time a line, the plain one's of its first lines."""
    random = np.random.default_rng(1)
    scores = random.uniform(-1, 1, (lines, 140, 125)).astype(np.float32)
    begun = time.process_time()
    total = match_scanlines(scores)[1]
    ours = (time.process_time() - begun) / lines
    begun = time.process_time()
    plain = np.array([plain_matching(line) for line in scores[:plain_lines]])
    theirs = (time.process_time() - begun) / plain_lines
    return theirs / ours, float(np.max(np.abs(total[:plain_lines] - plain) / plain))
