# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A desk, simulated: a lamp with a size, a stick that is moved through its light, and surfaces that are formulas; in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from addon.reconstruction.calibration.light import light_from_pencils
from addon.reconstruction.geometry import Camera, Light
from addon.reconstruction.scan import ProjectedPicture, View
from tests.rigs import Ball, camera_at

DESK, BACK = (0.0, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0, 0.4)
LAMP = np.array((-0.5, -0.25, 0.95))
BALL = Ball((0.0, 0.0, 0.05), 0.08)  # a dome on the desk
_STICK = 0.45  # its height above the desk
_HALF = 0.025  # half its width


@dataclass(frozen=True)
class Desk:
    """A scene on the desk, with a wall behind it.

    Parameters
    ----------
    camera : Camera
    points : (h, w, 3) array
        What each pixel shows.
    """

    camera: Camera
    points: np.ndarray

    def sweep(self, *, lamp=LAMP, radius: float = 0.0, frames: int = 60, direction: float = 0.0, strips, light=LAMP,
              noise: float = 0.0, number: int = 0) -> tuple[ProjectedPicture, ...]:
        """Return the pictures of a stick that moves across ``direction`` (radians); ``light`` is what the capture says."""
        fields = {"kind": "shadow", "sweep": number, "strips": strips}
        said = None if light is None else Light("point", np.asarray(light, float))
        across = np.array((np.cos(direction), np.sin(direction)))
        share = (lamp[2] - _STICK) / (lamp[2] - self.points[..., 2])
        on_stick = (lamp[:2] + (self.points[..., :2] - lamp[:2]) * share[..., None]) @ across
        # A pixel sees the mean of its surroundings, so that a point's shadow has a soft edge, too.
        pixel = np.linalg.norm(self.points - self.camera.centre, axis=-1) / self.camera.K[0, 0]
        blur = np.hypot(radius * (1 - share), pixel * share)
        paint = 0.6 + 0.2 * np.sin(40 * self.points[..., 0]) * np.cos(30 * self.points[..., 1])
        random = np.random.default_rng(5)

        def picture(frame: int) -> np.ndarray:
            place = np.interp(frame, (0, frames - 1), (on_stick.min() - 2 * _HALF, on_stick.max() + 2 * _HALF))
            hidden = _disc((on_stick - place + _HALF) / blur) - _disc((on_stick - place - _HALF) / blur)
            grey = paint * (1 - 0.85 * hidden) + random.normal(0, noise, paint.shape)
            return np.repeat(np.clip(grey, 0, 1)[..., None].astype(np.float32), 3, axis=-1)

        images = [picture(frame) for frame in range(frames)]
        return tuple(ProjectedPicture(f"{number}-{frame:03d}", fields, None, None, lambda image=image: image, said)
                     for frame, image in enumerate(images))

    def view(self, *sweeps: tuple[ProjectedPicture, ...]) -> View:
        pictures = sum(sweeps, ())
        return View("desk", self.camera, None, pictures[0].read_image, projected=pictures)


def desk(*, ball: bool = True, camera: Camera | None = None) -> Desk:
    """Return a desk with a dome on it, or none, and a wall behind."""
    camera = camera_at((0.0, -0.8, 0.65), (0.0, 0.08, 0.05), focal=300.0, size=(240, 180)) if camera is None else camera
    columns, rows = np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1]))
    rays = camera.rays(np.stack((columns, rows), axis=-1).astype(float))
    planes = np.array((DESK, BACK))
    with np.errstate(divide="ignore"):
        along = (planes[:, 3] - planes[:, :3] @ camera.centre) / (rays @ planes[:, :3].T)
    along = np.where(along > 0, along, np.inf).min(axis=-1)
    if ball:
        along = np.minimum(along, BALL.distance_along(camera.centre, rays))
    return Desk(camera, camera.centre + along[..., None] * rays)


def strips(scene: Desk, *, back: bool = False) -> list[dict]:
    """Return strips of the desk before and behind the dome, and of the wall where asked."""
    rows_on_desk = np.flatnonzero((np.abs(scene.points[..., 2]) < 1e-9).all(axis=1))
    rows_on_wall = np.flatnonzero((np.abs(scene.points[..., 1] - BACK[3]) < 1e-9).all(axis=1))

    def strip(rows, plane):
        return {"rows": [int(rows[0]), int(rows[-1]) + 1], "plane": list(plane)}

    behind = rows_on_desk[rows_on_desk - np.arange(len(rows_on_desk)) == rows_on_desk[0]]  # not interrupted by the dome
    found = [strip(behind[:12], DESK), strip(rows_on_desk[-12:], DESK)]
    return [*found, strip(rows_on_wall[:10], BACK), strip(rows_on_wall[-10:], BACK)] if back else found


def lamp_by_pencils(camera: Camera, noise: float, seed: int = 0) -> np.ndarray:
    """Return where 8 pencils of 0.15 m, marked with an error of ``noise`` pixels, say that the lamp is."""
    random = np.random.default_rng(seed)
    bases = np.array([(x, y, 0.0) for x in (-0.2, -0.08, 0.04, 0.16) for y in (-0.1, 0.12)])
    tips = bases + (0, 0, 0.15)
    shadows = LAMP + (tips - LAMP) * (LAMP[2] / (LAMP[2] - tips[:, 2:]))
    marks = [camera.project(points)[0] + random.normal(0, noise, (8, 2)) for points in (bases, shadows)]
    return light_from_pencils(camera, *marks, 0.15).position


def _disc(place: np.ndarray) -> np.ndarray:
    """Return the share of a disc of radius 1 that lies below a line at ``place``."""
    place = np.clip(place, -1, 1)
    return 0.5 + (np.arcsin(place) + place * np.sqrt(1 - place ** 2)) / np.pi
