# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Projected patterns on analytic objects by exact ray casting: what a camera sees of them, without a renderer.

A camera's pixel is a single ray, or the mean of several, and the projector's light at a point is what its pattern has where
the point projects to: a formula of the column and row, so that nothing is rounded to the projector's pixels unless asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from addon.captures.pictures import write_picture
from addon.captures.schema import Capture, Frame
from addon.captures.store import write_capture
from addon.reconstruction.active.patterns import Pattern
from addon.reconstruction.active.triangulation import rays_through
from addon.reconstruction.geometry import Camera, rotation_about
from addon.reconstruction.scan import ProjectedPicture, View
from addon.results.ply import write_ply
from tests.rigs import Ball, sphere_mesh

Albedo = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Wall:
    """The plane ``normal . X = offset``, seen from the side that its unit normal points to."""

    normal: tuple[float, float, float]
    offset: float

    def distances(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return where (..., 3) unit rays first meet the wall; infinite if nowhere."""
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (self.offset - origin @ np.array(self.normal)) / (rays @ np.array(self.normal))
        return np.where(distance > 1e-9, distance, np.inf)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return the normals (..., 3) at points of the wall."""
        return np.broadcast_to(np.array(self.normal), points.shape)


@dataclass(frozen=True)
class Edge:
    """A convex edge: what lies behind both of two walls."""

    walls: tuple[Wall, Wall]

    def distances(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return where (..., 3) unit rays from before both walls first meet the edge's body."""
        return np.maximum(*(wall.distances(origin, rays) for wall in self.walls))

    def errors(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distances (...) of points from the surface, as far as they lie near it."""
        return np.maximum(*(points @ np.array(wall.normal) - wall.offset for wall in self.walls))


@dataclass(frozen=True)
class Round:
    """The surface of a ball."""

    ball: Ball

    def distances(self, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Return where (..., 3) unit rays first meet the ball; infinite if nowhere."""
        to_centre = np.array(self.ball.centre) - origin
        along = rays @ to_centre
        root = self.ball.radius ** 2 - (to_centre ** 2).sum(-1) + along ** 2
        distance = along - np.sqrt(np.where(root >= 0, root, np.nan))
        return np.where(distance > 1e-9, distance, np.inf)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return the normals (..., 3) at points of the surface."""
        return (points - np.array(self.ball.centre)) / self.ball.radius


@dataclass(frozen=True)
class Sight:
    """What a camera sees, and how a projector lights it.

    Parameters
    ----------
    points : (h, w, 3) array
        NaN where nothing is hit.
    light : (h, w) array
        What a pixel shows under full light: albedo times the cosine of the angle of incidence, 0 in shadow.
    pixels : (h, w, 2) array
        Column and row of the projector.
    """

    points: np.ndarray
    light: np.ndarray
    pixels: np.ndarray


def picture_rays(camera: Camera) -> np.ndarray:
    """Return the (height, width, 3) unit rays through the centres of all pixels of a real picture."""
    rows, columns = np.mgrid[:camera.size[1], :camera.size[0]]
    return rays_through(camera, np.stack((columns, rows), axis=-1))


def sight(camera: Camera, projector: Camera, surfaces: Sequence, albedo: Albedo | float = 0.8) -> Sight:
    """Return what a camera sees of surfaces that a projector lights."""
    rays = picture_rays(camera)
    distances = np.stack([surface.distances(camera.centre, rays) for surface in surfaces])
    nearest = distances.argmin(axis=0)
    with np.errstate(invalid="ignore"):
        points = camera.centre + distances.min(axis=0)[..., None] * rays
    hit = np.isfinite(points).all(axis=-1)
    points = np.where(hit[..., None], points, 0.0)
    normals = np.choose(nearest[..., None], [surface.normals(points) for surface in surfaces])
    normals = np.where((normals * rays).sum(-1, keepdims=True) > 0, -normals, normals)
    beams = points - projector.centre
    length = np.linalg.norm(beams, axis=-1)
    beams = beams / length[..., None]
    first = np.min([surface.distances(projector.centre, beams) for surface in surfaces], axis=0)
    pixels, depth = projector.project(points)
    width, height = projector.size
    inside = (pixels > -0.5).all(-1) & (pixels[..., 0] < width - 0.5) & (pixels[..., 1] < height - 0.5) & (depth > 0)
    cosine = np.maximum(-(normals * beams).sum(-1), 0)
    lit = hit & inside & (first > length * (1 - 1e-6))
    return Sight(np.where(hit[..., None], points, np.nan), np.where(lit, cosine * (albedo(points) if callable(albedo) else albedo), 0.0), pixels)


def shown(pattern: Pattern, pixels: np.ndarray) -> np.ndarray:
    """Return what a projector shows (...) at real places (..., 2): the light of the pixel that each lies in, or a smooth formula."""
    fields, (column, row) = pattern.fields, np.moveaxis(pixels, -1, 0)
    along = row if fields.get("axis") == "row" else column
    if fields["kind"] == "phase-shift":
        return 0.5 + 0.5 * np.cos(2 * np.pi * (along / fields["period"] - fields["step"] / fields["steps"]))
    if fields["kind"] == "stripe":
        return np.exp(-8 * ((along - fields["position"]) / fields["width"]) ** 2)
    if fields["kind"] == "point":
        return np.exp(-8 * ((column - fields["column"]) ** 2 + (row - fields["row"]) ** 2) / fields["width"] ** 2)
    height, width = pattern.image.shape[:2]
    place = np.clip(np.rint(row), 0, height - 1).astype(int), np.clip(np.rint(column), 0, width - 1).astype(int)
    return pattern.image[place] / (255 if pattern.image.dtype == np.uint8 else 1)


def picture(seen: Sight, pattern: Pattern, *, samples: int = 1, ambient: float = 0.0, noise: float = 0.0, levels: int = 0,
            random: np.random.Generator | None = None) -> np.ndarray:
    """Return the (h, w) float32 picture of a sight under a pattern.

    Parameters
    ----------
    seen : Sight
        Of a camera with ``samples`` times as many pixels along each side.
    noise : float
        Standard deviation.
    levels : int
        Greatest value of the camera's integers, to which the picture is rounded; 0 for none.
    """
    light = ambient + seen.light * shown(pattern, seen.pixels)
    height, width = light.shape
    light = light.reshape(height // samples, samples, width // samples, samples).mean(axis=(1, 3))
    if noise:
        light = light + random.normal(0, noise, light.shape)
    light = np.clip(light, 0, 1)
    return (np.rint(light * levels) / levels if levels else light).astype(np.float32)


def projected_view(camera: Camera, projector: Camera, patterns: Sequence[Pattern], surfaces: Sequence, *, albedo: Albedo | float = 0.8,
                   name: str = "0001", seed: int = 0, **how) -> View:
    """Return a view whose pictures under patterns are cast when they are read; the same seed gives the same noise."""
    samples = how.get("samples", 1)
    seen = sight(camera.scaled(samples) if samples > 1 else camera, projector, surfaces, albedo)

    def reader(number: int, pattern: Pattern):
        def read() -> np.ndarray:
            random = np.random.default_rng((seed, number))
            return np.repeat(picture(seen, pattern, random=random, **how)[..., None], 3, axis=2)
        return read

    pictures = tuple(ProjectedPicture(pattern.id, pattern.fields, "projector", projector, reader(number, pattern))
                     for number, pattern in enumerate(patterns))
    own = next((shot for shot in pictures if shot.pattern["kind"] == "white"), pictures[0])
    return View(name, camera, None, own.read_image, projected=pictures)


def laser_view(camera: Camera, *, frames: int = 60, width: float = 0.02, albedo: Albedo | None = None, reach: float = 0.35,
               surface: Wall | Edge = Wall((0.0, -1.0, 0.0), 0.0)) -> View:
    """Return a view under a laser that turns about an upright axis at (0.8, -2, 0), and meets y = 0 at x from -reach to reach.

    The sheet of light is ``width`` thick, four standard deviations of its profile. Nothing is in shadow.
    """
    light = np.array([0.8, -2.0, 0.0])
    targets = np.linspace(-reach, reach, frames)
    normals = np.cross(np.stack((targets, np.zeros(frames), np.zeros(frames)), -1) - light, (0.0, 0.0, 1.0))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rays = picture_rays(camera)
    points = camera.centre + surface.distances(camera.centre, rays)[..., None] * rays
    colors = np.full(points.shape[:-1], 0.8) if albedo is None else albedo(points)

    def reader(number: int):
        def read() -> np.ndarray:
            beside = (points - light) @ normals[number]
            grey = (colors * np.exp(-8 * (beside / width) ** 2)).astype(np.float32)
            return np.repeat(grey[..., None], 3, axis=2)
        return read

    shots = tuple(ProjectedPicture(f"{n:04d}", {"kind": "laser", "plane": [*normals[n], float(normals[n] @ light)], "width": width}, None, None,
                                   reader(n)) for n in range(frames))
    return View("laser", camera, None, reader(frames // 2), projected=shots)


def write_projected_capture(folder: Path, camera: Camera, projector: Camera, patterns: Sequence[Pattern], ball: Ball,
                            poses: int = 1) -> Capture:
    """Write a whole capture set of a ball on a turntable under patterns, which stands still in the object frame, and the truth."""
    frames = []
    for pose in range(poses):
        motion = np.eye(4)
        motion[:3, :3] = rotation_about((0, 0, 1), 2 * np.pi * pose / poses)
        view = projected_view(camera.moved(motion), projector.moved(motion), patterns, [Round(ball)], ambient=0.02)
        for shot in view.projected:
            name = f"{pose:02d}-{shot.name}"
            write_picture(folder / "images" / f"{name}.png", shot.read_image(), bits=8)
            frames.append(Frame(name, f"images/{name}.png", "camera", motion, pattern=shot.name))
    truth = sphere_mesh(ball)
    write_ply(folder / "truth.ply", truth.vertices, truth.triangles, double=True)
    capture = Capture({"camera": camera}, tuple(frames), projectors={"projector": projector}, truth_mesh="truth.ply",
                      patterns={pattern.id: pattern.fields for pattern in patterns})
    write_capture(folder, capture)
    return capture
