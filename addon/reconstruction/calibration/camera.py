# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One device, camera or projector, calibrated from views of a flat board (Zhang, 2000), by OpenCV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera

LENSES: Mapping[str, int] = MappingProxyType({"none": 0, "radial": 2, "brown": 4, "full": 5})
"""Lens models: how many of ``k1 k2 p1 p2 k3`` are estimated, from the left."""

LEAST_POSES = 3
_FIXED = {0: cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3,
          2: cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3, 4: cv2.CALIB_FIX_K3, 5: 0}
_STOP = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9
_GOOD = 1.0  # pixels RMS; above it another start may do better
_GUESSES = (0.5, 1.0, 0.0)  # of a projector's principal point, in heights of its picture: lens shift puts it at an edge


@dataclass(frozen=True)
class Sighting:
    """The board's corners as one device sees them, or, if it is a projector, lights them.

    Parameters
    ----------
    device : str
    pose : str
        The board's pose; devices that see it at one pose are related by it.
    name : str
        Of the frame, for reports.
    ids : (n,) int array
        Which corners: see `Board.corners`.
    pixels : (n, 2) array
        Where they are in the device's picture.
    """

    device: str
    pose: str
    name: str
    ids: np.ndarray
    pixels: np.ndarray


def calibrate_camera(corners: np.ndarray, sightings: Sequence[Sighting], size: tuple[int, int],
                     lens: str = "radial") -> tuple[Camera, dict[str, np.ndarray]]:
    """Find a device's intrinsics and the board's poses before it.

    The principal point is always estimated: a projector's lies far from the middle.

    Parameters
    ----------
    corners : (n, 3) array
        The board's corners in its own frame.
    sightings : sequence of Sighting
        Of one device, one for each pose.
    size : (int, int)
        Of the device's picture.
    lens : str
        A key of `LENSES`.

    Returns
    -------
    camera : Camera
        With its own frame as the world.
    poses : dict of str to (4, 4) array
        Board to camera, by the sightings' ``pose``.

    Raises
    ------
    ScanstageError
        There are too few poses, or no camera explains them.
    """
    if len(sightings) < LEAST_POSES:
        names = ", ".join(sighting.name for sighting in sightings) or "none"
        raise ScanstageError(f"{sightings[0].device if sightings else 'a device'}: the board is found in {len(sightings)} pose(s) "
                             f"(frames: {names}); show it in at least {LEAST_POSES}, better 10 to 20, all tilted differently")
    objects = [corners[sighting.ids].astype(np.float32) for sighting in sightings]
    pixels = [sighting.pixels.astype(np.float32) for sighting in sightings]
    found = []
    for height in _GUESSES:
        if (solution := _solved(objects, pixels, size, lens, height)) is not None:
            found.append(solution)
            if solution[0] < _GOOD:
                break
    if not found:
        raise ScanstageError(f"{sightings[0].device}: no camera explains the board's {len(sightings)} poses; tilt the board by 15 to "
                             "45 degrees about different axes, and check the board's columns, rows and sizes")
    _, K, distortion, rotations, translations = min(found, key=lambda solution: solution[0])
    poses = {}
    for sighting, rotation, translation in zip(sightings, rotations, translations, strict=True):
        poses[sighting.pose] = pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation)[0], translation.ravel()
    return Camera(np.triu(K), np.eye(3), np.zeros(3), size, distortion.ravel()[:5]), poses


def _solved(objects: list[np.ndarray], pixels: list[np.ndarray], size: tuple[int, int], lens: str, height: float) -> tuple | None:
    """Return OpenCV's solution from a start with the principal point at ``height``, or None where there is none."""
    try:
        K = cv2.initCameraMatrix2D(objects, pixels, size)
        K[1, 2] = height * (size[1] - 1)
        solution = cv2.calibrateCamera(objects, pixels, size, K, np.zeros(5), criteria=_STOP,
                                       flags=cv2.CALIB_USE_INTRINSIC_GUESS | _FIXED[LENSES[lens]])
    except cv2.error:
        return None
    K = solution[1]
    sound = all(np.isfinite(part).all() for part in (K, solution[2], *solution[3], *solution[4])) and K[0, 0] > 0 and K[1, 1] > 0
    return solution if sound else None
