# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Analytic objects and rigs for tests: balls and boxes whose silhouettes and insides are formulas, and rings of cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.scan import View


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
        start, step = (origin - np.array(self.centre)) @ self.rotation, directions @ self.rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (-np.array(self.half) - start) / step, (np.array(self.half) - start) / step
        enter, leave = np.minimum(first, second).max(-1), np.maximum(first, second).min(-1)
        return (enter <= leave) & (leave > 0)


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
