# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""All devices of a rig in one frame, by bundle adjustment over every corner of every pose (Triggs et al., 2000).

OpenCV calibrates each device by itself, in single precision and blind to what the others saw. Here the board's poses are
shared, any number of cameras and projectors take part, the numbers are double, and their standard deviations come out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera, rotation_about
from .camera import LENSES, Sighting, calibrate_camera

_STEPS = 100
_CONVERGED = 1e-13  # of the squared error: the share by which a last step still lowers it
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e-12, 1e8  # of normal equations with a diagonal of ones
_FINEST = 1e-3  # pixels: no device is weighted as if its corners were known better
_INTRINSICS = 9  # fx fy cx cy k1 k2 p1 p2 k3


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
    """

    devices: Mapping[str, Camera]
    poses: Mapping[str, np.ndarray]
    sightings: tuple[Sighting, ...]
    residuals: tuple[np.ndarray, ...]
    deviations: Mapping[str, np.ndarray]

    def rms(self, device: str) -> float:
        """Return the root mean square distance, in pixels, of a device's corners from where they should be."""
        return rms([residual for sighting, residual in zip(self.sightings, self.residuals, strict=True) if sighting.device == device])


def rms(residuals: Sequence[np.ndarray]) -> float:
    """Return the root mean square length of (n, 2) residuals, point by point as OpenCV has it."""
    return float(np.sqrt((np.concatenate(residuals) ** 2).sum(axis=1).mean()))


def calibrate_rig(corners: np.ndarray, sightings: Sequence[Sighting], sizes: Mapping[str, tuple[int, int]],
                  lenses: Mapping[str, str]) -> Rig:
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

    Raises
    ------
    ScanstageError
        A device cannot be calibrated, or shares no pose with the others.
    """
    alone = {device: calibrate_camera(corners, [sighting for sighting in sightings if sighting.device == device], size, lenses[device])
             for device, size in sizes.items()}
    devices, poses = _related(alone)
    problem = _Problem(corners, tuple(sightings), lenses)
    errors = problem.residuals(devices, poses)
    noise = {device: max(_FINEST, rms([error for sighting, error in zip(sightings, errors, strict=True) if sighting.device == device]))
             for device in devices}
    return _adjusted(problem, devices, poses, noise)


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
        to_rig = np.linalg.inv(_motion(R, t))
        poses |= {pose: to_rig @ matrix for pose, matrix in own.items() if pose not in poses}
        waiting.remove(device)
    return {name: devices[name] for name in alone}, poses


def _motion(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = R, t
    return motion


@dataclass(frozen=True)
class _Problem:
    """What is fitted. Unknowns, in order: each device's free intrinsics; each device's pose but the first's; the board's poses."""

    corners: np.ndarray
    sightings: tuple[Sighting, ...]
    lenses: Mapping[str, str]

    def residuals(self, devices: Mapping[str, Camera], poses: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        found = []
        for sighting in self.sightings:
            pose = poses[sighting.pose]
            predicted, _ = devices[sighting.device].project(self.corners[sighting.ids] @ pose[:3, :3].T + pose[:3, 3])
            found.append(sighting.pixels - predicted)
        return found

    def columns(self, devices: Mapping[str, Camera], poses: Mapping[str, np.ndarray]) -> tuple[dict[object, slice], int]:
        """Return which unknowns belong to each device's intrinsics, its pose and each board pose, and how many there are."""
        counts = {("intrinsics", device): 4 + LENSES[self.lenses[device]] for device in devices}
        counts |= {("device", device): 6 for device in list(devices)[1:]}
        counts |= {("board", pose): 6 for pose in poses}
        ends = np.cumsum(list(counts.values()))
        return {key: slice(end - counts[key], end) for key, end in zip(counts, ends.tolist(), strict=True)}, int(ends[-1])

    def normal_equations(self, devices: Mapping[str, Camera], poses: Mapping[str, np.ndarray],
                         noise: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, float]:
        """Return ``J^T J``, ``J^T r`` and the squared error, all weighted by the devices' noise."""
        columns, count = self.columns(devices, poses)
        hessian, gradient, cost = np.zeros((count, count)), np.zeros(count), 0.0
        for sighting in self.sightings:
            predicted, blocks = self._derivatives(sighting, devices[sighting.device], poses[sighting.pose])
            blocks = {columns[key]: block / noise[sighting.device] for key, block in blocks.items() if key in columns}
            error = (sighting.pixels - predicted).ravel() / noise[sighting.device]
            cost += float(error @ error)
            for rows, left in blocks.items():
                gradient[rows] += left.T @ error
                for across, right in blocks.items():
                    hessian[rows, across] += left.T @ right
        return hessian, gradient, cost

    def _derivatives(self, sighting: Sighting, camera: Camera, pose: np.ndarray) -> tuple[np.ndarray, dict[object, np.ndarray]]:
        """Return the predicted (n, 2) pixels and their derivatives (2n, k) by each block of unknowns.

        A pose's unknowns are a rotation ``exp(w)`` from the left, so that ``R X`` moves by ``w x R X``, and a translation.
        """
        turned = self.corners[sighting.ids] @ pose[:3, :3].T
        in_rig = turned + pose[:3, 3]
        moved = in_rig @ camera.R.T
        local = moved + camera.t
        predicted, jacobian = cv2.projectPoints(local, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
        by_point = jacobian[:, 3:6].reshape(-1, 2, 3)
        by_rig = by_point @ camera.R
        used = 4 + LENSES[self.lenses[sighting.device]]
        return predicted.reshape(-1, 2), {("intrinsics", sighting.device): jacobian[:, 6:6 + used],
                                          ("device", sighting.device): _by_motion(by_point, moved),
                                          ("board", sighting.pose): _by_motion(by_rig, turned)}


def _by_motion(by_point: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Return the (2n, 6) derivatives by ``w`` and ``t`` from those (n, 2, 3) by the point: ``a . (w x X) = w . (X x a)``."""
    by_rotation = np.cross(turned[:, None], by_point)
    return np.concatenate((by_rotation, by_point), axis=-1).reshape(-1, 6)


def _adjusted(problem: _Problem, devices: dict[str, Camera], poses: dict[str, np.ndarray], noise: Mapping[str, float]) -> Rig:
    """Return the rig of least squared error near a first estimate (Levenberg & Marquardt)."""
    columns, _ = problem.columns(devices, poses)
    hessian, gradient, cost = problem.normal_equations(devices, poses, noise)
    negligible = _CONVERGED * sum(len(sighting.ids) for sighting in problem.sightings)  # of corners that fit to rounding
    damping = _DAMPING
    for _ in range(_STEPS):
        scale = _scale(hessian)
        step = np.linalg.solve(hessian / np.outer(scale, scale) + damping * np.eye(len(scale)), gradient / scale) / scale
        enough = _CONVERGED * cost + negligible
        if gradient @ step <= enough:
            break
        moved = _stepped(devices, poses, columns, step)
        trial = problem.normal_equations(*moved, noise) if moved is not None else (None, None, np.inf)
        if trial[2] < cost:
            (devices, poses), (hessian, gradient, cost), damping = moved, trial, max(damping / 10, _LEAST_DAMPING)
        elif (damping := damping * 10) > _MOST_DAMPING:
            break
    residuals = problem.residuals(devices, poses)
    return Rig(devices, poses, problem.sightings, tuple(residuals), _deviations(problem, devices, poses, residuals))


def _scale(hessian: np.ndarray) -> np.ndarray:
    """Return by what to divide unknowns as different as pixels and k3, so that each has the same weight."""
    return np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))


def _stepped(devices: Mapping[str, Camera], poses: Mapping[str, np.ndarray], columns: Mapping[object, slice],
             step: np.ndarray) -> tuple[dict[str, Camera], dict[str, np.ndarray]] | None:
    """Return devices and poses after a step, or None where it leads to no camera."""
    moved = {}
    for name, camera in devices.items():
        intrinsics = np.zeros(_INTRINSICS)
        own = step[columns["intrinsics", name]]
        intrinsics[:len(own)] = own
        fx, fy, cx, cy = intrinsics[:4]
        K = camera.K + np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 0]])
        if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
            return None
        R, t = camera.R, camera.t
        if ("device", name) in columns:
            R, t = _turned(R, t, step[columns["device", name]])
        moved[name] = replace(camera, K=K, R=R, t=t, distortion=camera.distortion + intrinsics[4:])
    return moved, {name: _motion(*_turned(pose[:3, :3], pose[:3, 3], step[columns["board", name]])) for name, pose in poses.items()}


def _turned(R: np.ndarray, t: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    angle = float(np.linalg.norm(step[:3]))
    u, _, vt = np.linalg.svd((rotation_about(step[:3], angle) if angle > 0 else np.eye(3)) @ R)  # rounding must not add up
    return u @ vt, t + step[3:]


def _deviations(problem: _Problem, devices: Mapping[str, Camera], poses: Mapping[str, np.ndarray],
                residuals: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Return the intrinsics' standard deviations, by the residuals' own spread."""
    noise = {}
    for name in devices:
        own = [residual for sighting, residual in zip(problem.sightings, residuals, strict=True) if sighting.device == name]
        noise[name] = max(rms(own) / np.sqrt(2), 1e-9)
    hessian = problem.normal_equations(devices, poses, noise)[0]
    scale = _scale(hessian)
    covariance = np.linalg.pinv(hessian / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    columns, _ = problem.columns(devices, poses)
    found = {}
    for name in devices:
        variances = np.diag(covariance)[columns["intrinsics", name]]
        found[name] = np.concatenate((np.sqrt(np.maximum(variances, 0)), np.zeros(_INTRINSICS - len(variances))))
    return found
