# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures turned so that their rows are epipolar lines of a projector."""

from __future__ import annotations

import cv2
import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera
from .patterns import AXES

_LEAST_CROSSING = np.sin(np.radians(20))  # between epipolar lines and stripes
_NOWHERE = -10.0  # pixels
_LARGEST_GROWTH = 4  # of the picture, in pixels


def rectified_camera(name: str, camera: Camera, projector: Camera, axis: str) -> Camera:
    """Return the camera, without distortion, turned so that each of its rows is an epipolar line.

    Only the camera's side is turned: along an epipolar line the projector's columns come in their order whatever their angle, and
    triangulation takes them as they are. The row runs in the direction in which the projector counts.

    Parameters
    ----------
    name : str
        The frame's, for error messages.
    camera, projector : Camera
    axis : {'column', 'row'}
        What the pattern counts.

    Raises
    ------
    ScanstageError
        Epipolar lines run along the stripes, or so steeply into the picture that it cannot be rectified.
    """
    across = projector.centre - camera.centre
    across = across / np.linalg.norm(across)
    crossing = projector.R[AXES.index(axis)] @ across
    if abs(crossing) < _LEAST_CROSSING:
        raise ScanstageError(f"frame {name}: the stripes number the projector's {axis}s, which run along the line from camera to "
                             "projector; number the other axis, or move the projector")
    across = across * np.sign(crossing)
    forward = camera.forward - (camera.forward @ across) * across
    forward = forward / max(np.linalg.norm(forward), 1e-12)
    R = np.stack((across, np.cross(forward, across), forward))
    width, height = camera.size
    ends = np.array([(x, y) for x in (0, width / 2, width) for y in (0, height / 2, height)]) - 0.5
    rays = camera.rays(ends) @ R.T
    focal = camera.K[1, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        places = focal * rays[:, :2] / rays[:, 2:]
    low, high = np.floor(places.min(axis=0)), np.ceil(places.max(axis=0))
    if (rays[:, 2] <= 0).any() or np.prod(high - low) > _LARGEST_GROWTH * width * height:
        raise ScanstageError(f"frame {name}: the projector stands too nearly in the camera's direction of sight for its picture to be "
                             "rectified; move it to the side")
    K = [[focal, 0, -low[0]], [0, focal, -low[1]], [0, 0, 1]]
    return Camera(K, R, -R @ camera.centre, tuple(int(n) + 1 for n in high - low))


def real_pixels(camera: Camera, rectified: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return where pixels (..., 2) of the rectified picture lie in the real one; far outside it for what is behind the camera."""
    found, depth = camera.project(rectified.centre + rectified.rays(pixels))
    return np.where((depth > 0)[..., None], found, _NOWHERE)


def pixel_map(camera: Camera, rectified: Camera) -> np.ndarray:
    """Return for each pixel of the rectified picture its place (h, w, 2) in the real one, as `cv2.remap` takes it."""
    rows, columns = np.mgrid[:rectified.size[1], :rectified.size[0]]
    return real_pixels(camera, rectified, np.stack((columns, rows), axis=-1)).astype(np.float32)


def rectify(image: np.ndarray, places: np.ndarray, *, interpolation: int = cv2.INTER_LINEAR, border: float = 0.0) -> np.ndarray:
    """Return the rectified picture; ``border`` beyond the real one."""
    return cv2.remap(image, places, None, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=(border,) * 4)
