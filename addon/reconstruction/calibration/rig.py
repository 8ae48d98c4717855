# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""All devices of a rig in one frame: each calibrated by itself, related by the poses that they share, then adjusted together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera
from .bundle import Estimate, Problem, Table, adjust, deviations, motion
from .camera import Sighting, calibrate_camera
from .turntable import Axis, onto_axis, turntable_axis

_FINEST = 1e-3  # pixels: no device is weighted as if its corners were known better


@dataclass(frozen=True)
class Turntable:
    """What is known of the turntable after a calibration.

    Parameters
    ----------
    axis : Axis
        In the rig's frame, from the poses before they were adjusted to share an axis: its ``tilt`` and ``offset`` say how
        far they were from doing so.
    errors : mapping of str to float
        By pose, what the table turned beyond its commanded motion, in radians.
    """

    axis: Axis
    errors: Mapping[str, float]


@dataclass(frozen=True)
class Rig:
    """Calibrated devices, in the frame of the first.

    Parameters
    ----------
    devices : mapping of str to Camera
    poses : mapping of str to (4, 4) array
        The board's frame to the rig's.
    sightings : tuple of Sighting
        What the rig was calibrated from.
    residuals : tuple of (n, 2) array
        Of each sighting: seen minus predicted, in pixels.
    deviations : mapping of str to (9,) array
        Standard deviations of each device's ``fx fy cx cy k1 k2 p1 p2 k3``; 0 where one was not estimated.
    world : (4, 4) array
        World to rig.
    turntable : Turntable, optional
    """

    devices: Mapping[str, Camera]
    poses: Mapping[str, np.ndarray]
    sightings: tuple[Sighting, ...]
    residuals: tuple[np.ndarray, ...]
    deviations: Mapping[str, np.ndarray]
    world: np.ndarray
    turntable: Turntable | None = None

    def rms(self, device: str) -> float:
        """Return the root mean square distance, in pixels, of a device's corners from where they should be."""
        return _rms(self.sightings, self.residuals)[device]


def rms(residuals: Sequence[np.ndarray]) -> float:
    """Return the root mean square length of (n, 2) residuals, point by point as OpenCV has it."""
    return float(np.sqrt((np.concatenate(residuals) ** 2).sum(axis=1).mean()))


def _rms(sightings: Sequence[Sighting], residuals: Sequence[np.ndarray]) -> dict[str, float]:
    own: dict[str, list[np.ndarray]] = {}
    for sighting, residual in zip(sightings, residuals, strict=True):
        own.setdefault(sighting.device, []).append(residual)
    return {device: rms(found) for device, found in own.items()}


def calibrate_rig(corners: np.ndarray, sightings: Sequence[Sighting], sizes: Mapping[str, tuple[int, int]], lenses: Mapping[str, str], *,
                  world: np.ndarray | None = None, turns: Mapping[str, tuple[str, np.ndarray]] | None = None) -> Rig:
    """Calibrate devices that saw the board, by themselves and then together.

    Parameters
    ----------
    corners : (n, 3) array
        The board's corners in its own frame.
    sightings : sequence of Sighting
        At most one of a device and pose.
    sizes : mapping of str to (int, int)
        Of each device; the first one's frame is the rig's.
    lenses : mapping of str to str
        A key of `LENSES` for each device.
    world : (4, 4) array, optional
        World to rig, as far as it is known; the identity if not.
    turns : mapping of str to (str, (4, 4) array), optional
        For poses on a turntable, where on it the board stands and the commanded ``object_to_world``. The world is then moved so
        that the board turned as they say: all but the angle about the axis and the height along it, which they leave open.

    Raises
    ------
    ScanstageError
        A device cannot be calibrated, shares no pose with the others, or the table's axis cannot be found.
    """
    alone = {device: calibrate_camera(corners, [sighting for sighting in sightings if sighting.device == device], size, lenses[device])
             for device, size in sizes.items()}
    problem, world = Problem(corners, tuple(sightings), lenses), np.eye(4) if world is None else world
    estimate = Estimate(*_related(alone))
    estimate = adjust(problem, estimate, _noise(problem, estimate))
    seen, turns = None, {pose: turn for pose, turn in (turns or {}).items() if pose in estimate.boards}
    if turns:
        table, seen, estimate = _on_table(turns, estimate, world)
        problem = replace(problem, table=table)
        estimate = adjust(problem, estimate, _noise(problem, estimate))
        world = estimate.world
    residuals = problem.residuals(estimate)
    poses = {sighting.pose: problem.pose(estimate, sighting.pose) for sighting in sightings}
    return Rig(estimate.devices, poses, problem.sightings, tuple(residuals), deviations(problem, estimate, residuals), world,
               Turntable(seen, _centred(estimate.errors, turns)) if seen is not None else None)


def _noise(problem: Problem, estimate: Estimate) -> dict[str, float]:
    return {device: max(_FINEST, error) for device, error in _rms(problem.sightings, problem.residuals(estimate)).items()}


def _related(alone: Mapping[str, tuple[Camera, dict[str, np.ndarray]]]) -> tuple[dict[str, Camera], dict[str, np.ndarray]]:
    """Return the devices and poses in the first device's frame, each device related by the poses it shares with earlier ones."""
    first, *waiting = alone
    devices, poses = {first: alone[first][0]}, dict(alone[first][1])
    while waiting:
        device = max(waiting, key=lambda name: len(alone[name][1].keys() & poses.keys()))
        camera, own = alone[device]
        shared = sorted(own.keys() & poses.keys())
        if not shared:
            raise ScanstageError(f"{device}: sees the board in no pose that {', '.join(devices)} sees; show it to both at once")
        moves = np.array([own[pose] @ np.linalg.inv(poses[pose]) for pose in shared])
        u, _, vt = np.linalg.svd(moves[:, :3, :3].sum(axis=0))  # the rotation nearest to all of them
        R, t = u @ vt, np.median(moves[:, :3, 3], axis=0)
        devices[device] = replace(camera, R=R, t=t)
        to_rig = np.linalg.inv(motion(R, t))
        poses |= {pose: to_rig @ matrix for pose, matrix in own.items() if pose not in poses}
        waiting.remove(device)
    return {name: devices[name] for name in alone}, poses


def _on_table(turns: Mapping[str, tuple[str, np.ndarray]], estimate: Estimate, world: np.ndarray) -> tuple[Table, Axis, Estimate]:
    """Return the table, its axis as the rig saw it, and the estimate with the poses on it expressed by it."""
    placements: dict[str, list[str]] = {}
    for pose, (placement, _) in turns.items():
        placements.setdefault(placement, []).append(pose)
    most = max(placements.values(), key=len, default=[])
    told = turntable_axis([turns[pose][1] for pose in most])
    seen = turntable_axis([estimate.boards[pose] for pose in most], told.angles)
    world = onto_axis(world, told, seen)
    on_table = {placement: np.linalg.inv(world @ turns[own[0]][1]) @ estimate.boards[own[0]] for placement, own in placements.items()}
    boards = {pose: matrix for pose, matrix in estimate.boards.items() if pose not in turns}
    return Table(told, turns), seen, Estimate(estimate.devices, boards, world, on_table, dict.fromkeys(turns, 0.0))


def _centred(errors: Mapping[str, float], turns: Mapping[str, tuple[str, np.ndarray]]) -> dict[str, float]:
    """Return the errors without their mean at each placement, which is no error but where on the table the board stands."""
    groups: dict[str, list[float]] = {}
    for pose, error in errors.items():
        groups.setdefault(turns[pose][0], []).append(error)
    return {pose: error - float(np.mean(groups[turns[pose][0]])) for pose, error in errors.items()}
