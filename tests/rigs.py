# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Analytic objects and rigs for tests: balls and boxes whose silhouettes and insides are formulas, rings of cameras, captures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from addon.captures.pictures import write_picture
from addon.captures.schema import Capture, Frame
from addon.captures.store import write_capture
from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.mesh import TriangleMesh
from addon.reconstruction.scan import View
from addon.results.ply import write_ply


@dataclass(frozen=True)
class Ball:
    """A solid ball."""

    centre: tuple[float, float, float]
    radius: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return whether (..., 3) points lie inside."""
        return ((points - np.array(self.centre)) ** 2).sum(-1) <= self.radius ** 2

    def hit_by(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return whether rays from ``origin`` along (..., 3) directions meet the ball."""
        to_centre = np.array(self.centre) - origin
        along = directions @ to_centre / np.linalg.norm(directions, axis=-1)
        return (to_centre @ to_centre - along ** 2 <= self.radius ** 2) & (along > 0)

    def along(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where rays enter and leave the ball, in lengths of their direction; inf and -inf where they do not, before 0 too."""
        a = (directions ** 2).sum(-1)
        to_centre = np.array(self.centre) - origins
        b = (to_centre * directions).sum(-1)
        inner = b ** 2 - a * ((to_centre ** 2).sum(-1) - self.radius ** 2)
        root = np.sqrt(np.maximum(inner, 0))
        return _ahead((b - root) / a, (b + root) / a, inner > 0)

    def distance_along(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return how many times ``directions`` lead from ``origin``, outside, to the surface; infinite where they miss it."""
        offset = origin - np.array(self.centre)
        a, b = (directions ** 2).sum(-1), directions @ offset
        root = b * b - a * (offset @ offset - self.radius ** 2)
        distance = (-b - np.sqrt(np.maximum(root, 0))) / a
        return np.where((root > 0) & (distance > 0), distance, np.inf)


@dataclass(frozen=True)
class Box:
    """A solid box: ``rotation`` turns its own axes into the world's."""

    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    rotation: np.ndarray

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return whether (..., 3) points lie inside."""
        return (np.abs((points - np.array(self.centre)) @ self.rotation) <= np.array(self.half)).all(-1)

    def hit_by(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return whether rays from ``origin`` meet the box: the slabs of its three axes overlap along the ray."""
        return np.isfinite(self.distance_along(origin, directions))

    def distance_along(self, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return how many times ``directions`` lead from ``origin``, outside, to the surface; infinite where they miss it."""
        start, step = (origin - np.array(self.centre)) @ self.rotation, directions @ self.rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (-np.array(self.half) - start) / step, (np.array(self.half) - start) / step
        enter, leave = np.minimum(first, second).max(-1), np.maximum(first, second).min(-1)
        return np.where((enter <= leave) & (leave > 0), enter, np.inf)

    def along(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where rays enter and leave the box, as `Ball.along`."""
        start, step = (origins - np.array(self.centre)) @ self.rotation, directions @ self.rotation
        step = np.where(np.abs(step) < 1e-12, 1e-12, step)
        first, second = (-np.array(self.half) - start) / step, (np.array(self.half) - start) / step
        enter, leave = np.minimum(first, second).max(-1), np.maximum(first, second).min(-1)
        return _ahead(enter, leave, enter < leave)


def _ahead(enter: np.ndarray, leave: np.ndarray, meets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    meets = meets & (leave > 0)
    return np.where(meets, np.maximum(enter, 0), np.inf), np.where(meets, leave, -np.inf)


def pixel_rays(camera: Camera) -> np.ndarray:
    """Return the (height, width, 3) rays through the pixels' centres."""
    rows, columns = np.mgrid[:camera.size[1], :camera.size[0]]
    return camera.rays(np.stack((columns, rows), -1))


def silhouette(camera: Camera, shapes) -> np.ndarray:
    """Return the (height, width) bool mask of the union of shapes, sampled at pixel centres."""
    rays = pixel_rays(camera)
    return np.any([shape.hit_by(camera.centre, rays) for shape in shapes], axis=0)


def camera_at(centre, target=(0.0, 0.0, 0.0), *, focal: float = 450.0, size=(320, 240)) -> Camera:
    """Return a camera at ``centre`` that looks at ``target``."""
    R, t = look_at(centre, target)
    return Camera([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]], R, t, size)


def ring(count: int, *, elevation: float = 20.0, distance: float = 4.0, **camera) -> list[Camera]:
    """Return cameras on a circle, ``elevation`` degrees above the horizon."""
    angles, up = 2 * np.pi * np.arange(count) / count, np.radians(elevation)
    return [camera_at(distance * np.array([np.cos(a) * np.cos(up), np.sin(a) * np.cos(up), np.sin(up)]), **camera) for a in angles]


def black_picture() -> np.ndarray:
    """Stand in for a picture in tests that never look at colours."""
    raise AssertionError("this test must not need a picture")


def views_of(cameras, shapes) -> list[View]:
    """Return a view for each camera, with the shapes' silhouette."""
    return [View(f"{i:04d}", camera, silhouette(camera, shapes), black_picture) for i, camera in enumerate(cameras)]


def painted_views(cameras, shapes, paint) -> list[View]:
    """Return a view for each camera of matte shapes; ``paint`` gives the linear colours (n, 3) of surface points (n, 3).

    Pictures are black beyond the shapes. A pixel shows what the ray through its centre meets; as those of captures, masks
    cover every pixel that a shape may touch.
    """
    views = []
    for number, camera in enumerate(cameras):
        rays = pixel_rays(camera)
        distance = np.min([shape.distance_along(camera.centre, rays) for shape in shapes], axis=0)
        mask = np.isfinite(distance)
        picture = np.zeros((*mask.shape, 3), np.float32)
        picture[mask] = paint(camera.centre + rays[mask] * distance[mask][:, None])
        views.append(View(f"{number:04d}", camera, cv2.dilate(mask.astype(np.uint8), np.ones((3, 3))) > 0, lambda picture=picture: picture))
    return views


def marbled(points: np.ndarray) -> np.ndarray:
    """Return linear colours (n, 3) that change over a fifth to a half of a unit, without sharp edges."""
    coarse = np.sin(points @ np.array([[9, 2, -5], [-4, 11, 3], [5, -3, 13]]) + (0.3, 1.1, 2.0))
    fine = np.sin(points @ np.array([[-18, 15, 8], [12, 20, -16], [15, 14, 21]]) + (1.7, 0.2, 0.9))
    return 0.5 + 0.2 * coarse + 0.2 * fine


def sphere_mesh(ball: Ball, rings: int = 32) -> TriangleMesh:
    """Return a closed mesh with all its vertices on a ball's surface: it lies inside the ball."""
    polar = np.pi * np.arange(1, rings)[:, None] / rings
    around = np.pi * np.arange(2 * rings) / rings
    belt = np.stack((np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.broadcast_to(np.cos(polar), (rings - 1, 2 * rings))), -1)
    vertices = np.concatenate(([[0.0, 0.0, 1.0]], belt.reshape(-1, 3), [[0.0, 0.0, -1.0]]))
    rows = 1 + np.arange(belt[..., 0].size).reshape(rings - 1, 2 * rings)
    here, beside = rows, np.roll(rows, -1, axis=1)
    top, bottom = np.zeros(2 * rings, int), np.full(2 * rings, len(vertices) - 1)
    triangles = [np.stack(corners, -1).reshape(-1, 3) for corners in (
        (top, here[0], beside[0]), (here[:-1], here[1:], beside[1:]), (here[:-1], beside[1:], beside[:-1]), (here[-1], bottom, beside[-1]))]
    return TriangleMesh(np.array(ball.centre) + ball.radius * vertices, np.concatenate(triangles))


def write_ball_capture(folder: Path, ball: Ball, cameras: Sequence[Camera], *, color=(0.6, 0.3, 0.1), **fields) -> Capture:
    """Write a whole capture set of a ball of one colour: pictures with alpha, one camera a frame, and the truth."""
    names = [f"{number:04d}" for number in range(1, len(cameras) + 1)]
    for name, camera in zip(names, cameras, strict=True):
        seen = silhouette(camera, [ball])
        write_picture(folder / "images" / f"{name}.png", seen[..., None] * np.array(color), seen * 1.0)
    truth = sphere_mesh(ball)
    write_ply(folder / "truth.ply", truth.vertices, truth.triangles, double=True)
    capture = Capture(dict(zip(names, cameras, strict=True)), tuple(Frame(name, f"images/{name}.png", name) for name in names),
                      truth_mesh="truth.ply", **fields)
    write_capture(folder, capture)
    return capture


def first_hit(shapes, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return how far along rays (..., 3) from ``origin`` (3,) or (..., 3) the first shape begins, in lengths of the direction; inf for none."""
    return np.min([shape.along(origin, directions)[0] for shape in shapes], axis=0)


def in_shadow(camera: Camera, light: np.ndarray, shapes) -> np.ndarray:
    """Return (height, width) bool: the pixels whose centres see a point of the shapes that ``light`` (3,) does not reach."""
    rays = pixel_rays(camera)
    distance = first_hit(shapes, camera.centre, rays)
    seen = np.isfinite(distance)
    points = camera.centre + np.where(seen, distance, 1.0)[..., None] * rays
    towards = light - points
    # A point of the surface is not hidden by itself: what begins within a millionth of the way is its own shape, unless that
    # goes on, which is where the surface turns away from the light.
    hidden = np.zeros(seen.shape, bool)
    for shape in shapes:
        enter, leave = shape.along(points, towards)
        hidden |= (enter < 1) & (leave > 1e-6) & (leave > enter + 1e-9)
    return seen & hidden
