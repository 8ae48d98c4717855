# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The plane of a laser line, from its stripe on the board in two poses or more: no projector matrix is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera

LEAST_SPREAD = 0.02  # of the points across their main direction, as a share of that along it
_STOP = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-12


@dataclass(frozen=True)
class LaserPlane:
    """A plane of light, ``normal . X = distance``.

    Parameters
    ----------
    normal : (3,) array
        Unit vector.
    distance : float
    rms : float
        Of the points' distances from the plane, in the scene's unit.
    warnings : tuple of str
    """

    normal: np.ndarray
    distance: float
    rms: float
    warnings: tuple[str, ...]


def laser_plane(camera: Camera, poses: Sequence[np.ndarray], stripes: Sequence[np.ndarray]) -> LaserPlane:
    """Fit the plane of a laser to its stripe on a board.

    Parameters
    ----------
    camera : Camera
    poses : sequence of (4, 4) array
        The board's frame to the frame in which the plane is wanted, which is the camera's ``world``.
    stripes : sequence of (n, 2) array
        For each pose the stripe's pixels.

    Raises
    ------
    ScanstageError
        The stripe is seen in fewer than two poses, or a pixel's ray misses the board's plane.
    """
    seen = [(pose, stripe) for pose, stripe in zip(poses, stripes, strict=True) if len(stripe)]
    if len(seen) < 2:
        raise ScanstageError(f"the laser's plane: the stripe is seen on the board in {len(seen)} pose(s); show it in at least 2 that "
                             "differ in distance or tilt")
    points = np.concatenate([on_plane(camera.moved(pose), stripe) @ pose[:3, :3].T + pose[:3, 3] for pose, stripe in seen])
    middle = points.mean(axis=0)
    _, spread, vt = np.linalg.svd(points - middle, full_matrices=False)
    warnings = []
    if spread[1] < LEAST_SPREAD * spread[0]:
        warnings.append("the stripe lies on nearly one line in all poses, so the laser's plane may turn about it; move the board "
                        "towards the camera or tilt it otherwise")
    return LaserPlane(vt[2], float(vt[2] @ middle), float(spread[2] / np.sqrt(len(points))), tuple(warnings))


def on_plane(camera: Camera, pixels) -> np.ndarray:
    """Return the (n, 3) points of the plane ``z = 0`` that (n, 2) pixels of a picture, lens and all, show.

    Raises
    ------
    ScanstageError
        A pixel's ray runs along the plane or away from it.
    """
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    ideal = cv2.undistortPointsIter(pixels[:, None], camera.K, camera.distortion, np.eye(3), camera.K, _STOP).reshape(-1, 2)
    rays = camera.rays(ideal)
    with np.errstate(divide="ignore"):
        along = -camera.centre[2] / rays[:, 2]
    if not ((along > 0) & np.isfinite(along)).all():
        column, row = pixels[np.argmin((along > 0) & np.isfinite(along))]
        raise ScanstageError(f"pixel ({column:.0f}, {row:.0f}) does not show the board's plane; check the mark and the board's pose")
    return camera.centre + along[:, None] * rays
