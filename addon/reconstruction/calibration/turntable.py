# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The axis of a turntable, from the poses of a board that stands on it.

Between any two poses the board has turned about the axis: the rotation keeps the axis' direction, the motion its points.
Every pair of poses says so, which makes both a linear least-squares problem with no pose that counts more than another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import ScanstageError
from ..geometry import rotation_about

LEAST_TURN = np.radians(5.0)  # between the two poses that are furthest apart; below, their noise is all there is


@dataclass(frozen=True)
class Axis:
    """An axis of rotation, in the frame of the poses it was found from.

    Parameters
    ----------
    direction : (3,) array
        Unit vector; positive angles turn about it by the right hand.
    point : (3,) array
        Of the axis, nearest to the frame's origin.
    angles : (n,) array
        Of each pose, from the first, in -pi .. pi.
    tilt : float
        Root mean square angle by which the rotations move the direction, in radians: how far they are from sharing an axis.
    offset : float
        Root mean square distance by which the motions move the point.
    """

    direction: np.ndarray
    point: np.ndarray
    angles: np.ndarray
    tilt: float
    offset: float


def turntable_axis(poses, commanded=None) -> Axis:
    """Find the axis about which a board has turned.

    Parameters
    ----------
    poses : (n, 4, 4) array
        The board's frame to a frame that stands still.
    commanded : (n,) array, optional
        Angles that the table was told, in radians. They only settle which of its two directions the axis has; without them it
        is the one with the smaller angle to ``-y``, which is up in a camera's frame.

    Raises
    ------
    ScanstageError
        There are no two poses at angles far enough apart.
    """
    poses = np.asarray(poses, dtype=np.float64)
    first, second = np.triu_indices(len(poses), 1)
    moves = poses[second] @ np.linalg.inv(poses[first])
    rotations, shifts = moves[:, :3, :3], moves[:, :3, 3]
    turns = np.arccos(np.clip((np.trace(rotations, axis1=1, axis2=2) - 1) / 2, -1, 1))
    if not len(turns) or turns.max() < LEAST_TURN:
        raise ScanstageError(f"the turntable's axis: the board turns by no more than {np.degrees(turns.max(initial=0)):.1f} degrees in "
                             f"its {len(poses)} pose(s); turn it through at least {np.degrees(LEAST_TURN):.0f}, better all the way round")
    change = rotations - np.eye(3)
    _, _, vt = np.linalg.svd(change.reshape(-1, 3), full_matrices=False)
    direction = vt[-1]
    angles = _angles(poses[:, :3, :3] @ poses[0, :3, :3].T, direction)
    expected = direction @ (0, -1, 0) if commanded is None else _agreement(angles, np.asarray(commanded) - commanded[0])
    if expected < 0:
        direction, angles = -direction, -angles
    # (I - R) c = t for every pair, and c . a = 0; rows of the equations' own size, so that none drowns the other
    weight = np.sqrt(len(moves))
    equations = np.concatenate((-change.reshape(-1, 3), weight * direction[None]))
    point = np.linalg.lstsq(equations, np.append(shifts.ravel(), 0.0), rcond=None)[0]
    moved = point + ((change @ point) + shifts)
    return Axis(direction, point, angles, float(np.sqrt((np.linalg.norm(change @ direction, axis=1) ** 2).mean())),
                float(np.sqrt(((moved - point) ** 2).sum(axis=1).mean())))


def onto_axis(world_to_camera: np.ndarray, in_world: Axis, in_camera: Axis) -> np.ndarray:
    """Return the pose nearest to a given one that puts the world's axis where the camera sees it turn.

    An axis leaves two things open, which keep their values: the angle about it and the height along it.

    Parameters
    ----------
    world_to_camera : (4, 4) array
    in_world, in_camera : Axis
        The same axis with the same sense of rotation, from the commanded motions and from what the camera saw.

    Returns
    -------
    (4, 4) array
        World to camera.
    """
    before = world_to_camera[:3, :3] @ in_world.direction
    across, cosine = np.cross(before, in_camera.direction), float(before @ in_camera.direction)
    if np.linalg.norm(across) < 1e-12:  # as it is, or upside down: then any axis across will do
        across = np.linalg.svd(before[None])[2][-1]
    R = rotation_about(across, float(np.arccos(np.clip(cosine, -1, 1)))) @ world_to_camera[:3, :3]
    u, _, vt = np.linalg.svd(R)
    pose = np.eye(4)
    pose[:3, :3] = u @ vt
    point = world_to_camera[:3, :3] @ in_world.point + world_to_camera[:3, 3]
    foot = in_camera.point + in_camera.direction * ((point - in_camera.point) @ in_camera.direction)
    pose[:3, 3] = foot - pose[:3, :3] @ in_world.point
    return pose


def _angles(rotations: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the angles by which (n, 3, 3) rotations turn about a direction."""
    skew = np.stack((rotations[:, 2, 1] - rotations[:, 1, 2], rotations[:, 0, 2] - rotations[:, 2, 0],
                     rotations[:, 1, 0] - rotations[:, 0, 1]), axis=-1)
    return np.arctan2(skew @ direction / 2, (np.trace(rotations, axis1=1, axis2=2) - 1) / 2)


def _agreement(angles: np.ndarray, commanded: np.ndarray) -> float:
    """Return how much better the angles fit the commanded ones than their opposites do."""
    return float(np.cos(angles - commanded).sum() - np.cos(angles + commanded).sum())
