# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangulation: where a camera's ray meets a plane of light, or comes nearest to a projector's ray.

Rays are unit vectors, so that the parameter along a ray is a distance. Lens distortion is taken off both sides: off the
camera's pixels once, and off a projector's column by going back and forth, for a distorted column is no plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..geometry import Camera
from .patterns import AXES

_UNDISTORT = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
_MOST_ROUNDS = 30
_CLOSE = 1e-6  # projector pixels: when going back and forth has arrived
LEAST_ANGLE = np.radians(0.5)
"""Between the ray of the camera and the light, below which an intersection means nothing."""


def undistorted_pixels(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return where the pixels (..., 2) of a real picture would be without lens distortion."""
    pixels = np.asarray(pixels, np.float64)
    if not camera.distorted:
        return pixels
    inverse = np.linalg.inv(camera.K)
    real = pixels.reshape(-1, 2) @ inverse[:2, :2].T + inverse[:2, 2]
    # With OpenCV's intrinsics at unity, since those have no skew.
    ideal = cv2.undistortPointsIter(real[:, None], np.eye(3), camera.distortion, None, None, _UNDISTORT)[:, 0]
    return (ideal @ camera.K[:2, :2].T + camera.K[:2, 2]).reshape(pixels.shape)


def rays_through(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the (..., 3) unit rays from a camera's or projector's centre through real pixels (..., 2), in the world."""
    rays = camera.rays(undistorted_pixels(camera, pixels))
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def picture_rays(camera: Camera) -> np.ndarray:
    """Return the (height, width, 3) unit rays through the centres of all pixels."""
    rows, columns = np.mgrid[:camera.size[1], :camera.size[0]]
    return rays_through(camera, np.stack((columns, rows), axis=-1))


def meet_planes(origin: np.ndarray, rays: np.ndarray, planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Intersect rays with planes of light.

    Parameters
    ----------
    origin : (3,) array
    rays : (n, 3) array
        Unit vectors.
    planes : (n, 4) or (4,) array
        ``(nx, ny, nz, d)`` with ``n . X = d``; the normal need not be a unit vector.

    Returns
    -------
    distance : (n,) array
        Along the ray; not finite where it is parallel to the plane.
    sine : (n,) array
        Of the angle between ray and plane.
    """
    normal = planes[..., :3]
    across = (normal * rays).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (planes[..., 3] - normal @ origin) / across
    return distance, np.abs(across) / np.linalg.norm(normal, axis=-1)


def light_planes(projector: Camera, axis: str, positions: np.ndarray) -> np.ndarray:
    """Return the planes (n, 4) of light behind columns, or rows, at undistorted positions (n,): ``P^T (1, 0, -u)``.

    Their normals are scaled so that ``n . X - d`` is the depth of X times its distance in projector pixels from the line.
    """
    P = projector.P
    planes = P[AXES.index(axis)] - np.asarray(positions)[:, None] * P[2]
    planes[:, 3] *= -1
    return planes


def meet_lines(projector: Camera, axis: str, positions: np.ndarray, origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Intersect camera rays with what a projector's columns, or rows, light.

    Parameters
    ----------
    projector : Camera
        With distortion or without.
    axis : {'column', 'row'}
    positions : (n,) array
        In real projector pixels.
    origin : (3,) array
        The camera's centre.
    rays : (n, 3) array
        Unit vectors.

    Returns
    -------
    distance : (n,) array
        Along the ray.
    sine : (n,) array
        Of the angle between ray and plane of light.
    """
    positions = np.asarray(positions, np.float64)
    distance, sine = meet_planes(origin, rays, light_planes(projector, axis, positions))
    if not projector.distorted:
        return distance, sine
    index = AXES.index(axis)
    ideal = Camera(projector.K, projector.R, projector.t, projector.size)
    for _ in range(_MOST_ROUNDS):
        points = origin + distance[:, None] * rays
        with np.errstate(invalid="ignore", over="ignore"):
            shift = projector.project(points)[0][:, index] - ideal.project(points)[0][:, index]
            moved, sine = meet_planes(origin, rays, light_planes(projector, axis, positions - shift))
            still = np.abs(moved - distance) <= _CLOSE * np.abs(moved) / projector.K[index, index]
        distance = moved
        if (still | ~np.isfinite(moved)).all():
            break
    return distance, sine


@dataclass(frozen=True)
class Meeting:
    """Where rays of two devices come nearest to each other.

    Parameters
    ----------
    points : (n, 3) array
        Halfway between the two rays; not finite where they are parallel.
    gap : (n,) array
        The rays' distance there: 0 for rays that meet.
    along, beside : (n,) arrays
        Distances from camera and projector along their rays; negative behind.
    sine : (n,) array
        Of the angle between the rays.
    """

    points: np.ndarray
    gap: np.ndarray
    along: np.ndarray
    beside: np.ndarray
    sine: np.ndarray


def meet_rays(origin: np.ndarray, rays: np.ndarray, light: np.ndarray, beams: np.ndarray) -> Meeting:
    """Find where rays of two devices come nearest to each other: the midpoint method.

    Parameters
    ----------
    origin, light : (3,) arrays
        Centres of camera and projector.
    rays, beams : (n, 3) arrays
        Unit vectors.
    """
    between = light - origin
    cosine = (rays * beams).sum(axis=-1)
    to_camera, to_light = rays @ between, beams @ between
    # Not 1 - cosine^2, which has no digits left where the rays are nearly parallel.
    square = (np.cross(rays, beams) ** 2).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (to_camera - cosine * to_light) / square
        beside = (cosine * to_camera - to_light) / square
        first, second = origin + along[:, None] * rays, light + beside[:, None] * beams
        return Meeting((first + second) / 2, np.linalg.norm(second - first, axis=-1), along, beside, np.sqrt(square))


def pixel_width(projector: Camera, axis: str, points: np.ndarray) -> np.ndarray:
    """Return how wide a projector's column, or high its row, is at points (n, 3), across its plane of light."""
    index = AXES.index(axis)
    pixels, depth = projector.project(points)
    off_axis = pixels[:, index] - projector.K[index, 2]
    return np.abs(depth) / np.hypot(projector.K[index, index], off_axis)
