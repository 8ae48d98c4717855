# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The plane of a laser line, from its stripe on the board in two poses or more: no projector matrix is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...errors import ScanstageError
from ..active.correspondence import NOISE, Reason
from ..active.laser_stripe import LEAST_PEAK, stripe_peaks
from ..active.triangulation import rays_through
from ..geometry import Camera
from .board import Board

LEAST_SPREAD = 0.02  # of the points across their main direction, as a share of that along it
_HALF = 4  # pixels on either side of a stripe's brightest one
_DIMMEST = 0.3  # of the stripe's typical brightness: white squares are kept, black ones, whose edges pull the peak aside, are not


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


def laser_plane(cameras: Sequence[Camera], poses: Sequence[np.ndarray], stripes: Sequence[np.ndarray]) -> LaserPlane:
    """Fit the plane of a laser to its stripe on a board.

    Parameters
    ----------
    cameras : sequence of Camera
        That took each picture, in the frame in which the plane is wanted.
    poses : sequence of (4, 4) array
        The board's frame to that one, in each picture.
    stripes : sequence of (n, 2) array
        The stripe's pixels in each.

    Raises
    ------
    ScanstageError
        The stripe is seen in fewer than two poses, or a pixel's ray misses the board's plane.
    """
    seen = [picture for picture in zip(cameras, poses, stripes, strict=True) if len(picture[2])]
    if len(seen) < 2:
        raise ScanstageError(f"the laser's plane: the stripe is seen on the board in {len(seen)} pose(s); show it in at least 2 that "
                             "differ in distance or tilt")
    points = np.concatenate([on_plane(camera.moved(pose), stripe) @ pose[:3, :3].T + pose[:3, 3] for camera, pose, stripe in seen])
    middle = points.mean(axis=0)
    _, spread, vt = np.linalg.svd(points - middle, full_matrices=False)
    warnings = []
    if spread[1] < LEAST_SPREAD * spread[0]:
        warnings.append("the stripe lies on nearly one line in all poses, so the laser's plane may turn about it; move the board "
                        "towards the camera or tilt it otherwise")
    return LaserPlane(vt[2], float(vt[2] @ middle), float(spread[2] / np.sqrt(len(points))), tuple(warnings))


def stripe_on_board(board: Board, camera: Camera, pose: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the (n, 2) pixels of a laser's stripe where it crosses the board.

    Parameters
    ----------
    board : Board
    camera : Camera
    pose : (4, 4) array
        The board's frame to the frame that is the camera's ``world``.
    image : (h, w) float32 array
        From 0 to 1, under the laser.
    """
    right, bottom = board.columns - 1, board.rows - 1
    outline = board.square * np.array([(-1, -1, 0), (right, -1, 0), (right, bottom, 0), (-1, bottom, 0)])
    inside = np.zeros(image.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.rint(camera.moved(pose).project(outline)[0]).astype(np.int32), 1)
    found = [_peaks(image * inside), _peaks((image * inside).T)[:, ::-1]]
    stripe = max(found, key=len)  # an upright stripe crosses more rows, a level one more columns
    if not len(stripe):
        return stripe
    column, row = np.rint(stripe).astype(int).T
    light = image[row, column]
    return stripe[light >= _DIMMEST * np.percentile(light, 90)]


def _peaks(image: np.ndarray) -> np.ndarray:
    rows, columns, _, reason = stripe_peaks(image, _HALF, estimator="gaussian", contrast=LEAST_PEAK, noise=NOISE)
    return np.column_stack((columns, rows))[reason == Reason.VALID].astype(np.float64)


def on_plane(camera: Camera, pixels) -> np.ndarray:
    """Return the (n, 3) points of the plane ``z = 0`` that (n, 2) pixels of a picture, lens and all, show.

    Raises
    ------
    ScanstageError
        A pixel's ray runs along the plane or away from it.
    """
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    rays = rays_through(camera, pixels)
    with np.errstate(divide="ignore"):
        along = -camera.centre[2] / rays[:, 2]
    if not ((along > 0) & np.isfinite(along)).all():
        column, row = pixels[np.argmin((along > 0) & np.isfinite(along))]
        raise ScanstageError(f"pixel ({column:.0f}, {row:.0f}) does not show the board's plane; check the mark and the board's pose")
    return camera.centre + along[:, None] * rays
