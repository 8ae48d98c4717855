# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundle adjustment: devices, poses of the board and a turntable that together explain every corner best (Triggs et al., 2000).

OpenCV calibrates each device by itself, in single precision and blind to what the others saw. Here the board's poses are
shared, any number of cameras and projectors take part, a turning table is one axis instead of many poses, the numbers are
double, and their standard deviations come out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from ..geometry import Camera, rotation_about
from .camera import LENSES, Sighting
from .turntable import Axis

_STEPS = 50
_CONVERGED = 1e-13  # of the squared error: the share by which a last step still lowers it
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e-12, 1e8  # of normal equations with a diagonal of ones
_INTRINSICS = 9  # fx fy cx cy k1 k2 p1 p2 k3

Blocks = dict[tuple[str, ...], np.ndarray]


@dataclass(frozen=True)
class Table:
    """A turntable's commanded motions.

    Parameters
    ----------
    axis : Axis
        In the world.
    turns : mapping of str to (str, (4, 4) array)
        For each of the board's poses on the table: where on the table it stands, and the commanded ``object_to_world``.
    """

    axis: Axis
    turns: Mapping[str, tuple[str, np.ndarray]]


@dataclass(frozen=True)
class Estimate:
    """What is adjusted.

    Parameters
    ----------
    devices : mapping of str to Camera
        In the frame of the first, which stays.
    boards : mapping of str to (4, 4) array
        By pose, where the board was held by hand: its frame to the rig's.
    world : (4, 4) array, optional
        World to rig, where there is a turntable.
    placements : mapping of str to (4, 4) array
        The board on the table: its frame to the object frame.
    errors : mapping of str to float
        By pose on the table, what it turned beyond its commanded motion, in radians.
    """

    devices: Mapping[str, Camera]
    boards: Mapping[str, np.ndarray]
    world: np.ndarray | None = None
    placements: Mapping[str, np.ndarray] = field(default_factory=dict)
    errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Problem:
    """What an estimate must explain.

    Parameters
    ----------
    corners : (n, 3) array
        The board's corners in its own frame.
    sightings : tuple of Sighting
    lenses : mapping of str to str
        A key of `LENSES` for each device.
    table : Table, optional
    """

    corners: np.ndarray
    sightings: tuple[Sighting, ...]
    lenses: Mapping[str, str]
    table: Table | None = None

    def pose(self, estimate: Estimate, pose: str) -> np.ndarray:
        """Return one of the board's poses, its frame to the rig's."""
        if self.table is None or pose not in self.table.turns:
            return estimate.boards[pose]
        placement, _ = self.table.turns[pose]
        return estimate.world @ self._turn(estimate, pose) @ estimate.placements[placement]

    def residuals(self, estimate: Estimate) -> list[np.ndarray]:
        """Return the (n, 2) residuals of each sighting, seen minus predicted."""
        found = []
        for sighting in self.sightings:
            pose = self.pose(estimate, sighting.pose)
            predicted, _ = estimate.devices[sighting.device].project(self.corners[sighting.ids] @ pose[:3, :3].T + pose[:3, 3])
            found.append(sighting.pixels - predicted)
        return found

    def columns(self, estimate: Estimate) -> tuple[dict[tuple[str, ...], slice], int]:
        """Return which unknowns belong to each block, and how many there are in all."""
        counts = {("intrinsics", device): 4 + LENSES[self.lenses[device]] for device in estimate.devices}
        counts |= {("device", device): 6 for device in list(estimate.devices)[1:]}
        counts |= {("board", pose): 6 for pose in estimate.boards}
        if self.table is not None:
            counts |= {("world",): 6, **{("placement", name): 6 for name in estimate.placements}}
            counts |= {("error", pose): 1 for pose in estimate.errors}
        ends = np.cumsum(list(counts.values()))
        return {key: slice(end - counts[key], end) for key, end in zip(counts, ends.tolist(), strict=True)}, int(ends[-1])

    def normal_equations(self, estimate: Estimate, noise: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray, float]:
        """Return ``J^T J``, ``J^T r`` and the squared error, all weighted by the devices' noise in pixels."""
        columns, count = self.columns(estimate)
        hessian, gradient, cost = np.zeros((count, count)), np.zeros(count), 0.0
        for sighting in self.sightings:
            predicted, blocks = self._derivatives(sighting, estimate)
            own = [(columns[key], block / noise[sighting.device]) for key, block in blocks.items() if key in columns]
            error = (sighting.pixels - predicted).ravel() / noise[sighting.device]
            cost += float(error @ error)
            for rows, left in own:
                gradient[rows] += left.T @ error
                for across, right in own:
                    hessian[rows, across] += left.T @ right
        return hessian, gradient, cost

    def _turn(self, estimate: Estimate, pose: str) -> np.ndarray:
        """Return object to world at one pose on the table: the commanded motion, and what it was wrong by."""
        axis, (_, commanded) = self.table.axis, self.table.turns[pose]
        turn = np.eye(4)
        turn[:3, :3] = rotation_about(axis.direction, estimate.errors[pose])
        turn[:3, 3] = axis.point - turn[:3, :3] @ axis.point
        return turn @ commanded

    def _derivatives(self, sighting: Sighting, estimate: Estimate) -> tuple[np.ndarray, Blocks]:
        """Return the predicted (n, 2) pixels and their derivatives (2n, k) by each block of unknowns.

        A motion's unknowns are a rotation ``exp(w)`` from the left, so that ``R X`` moves by ``w x R X``, and a translation.
        """
        camera, pose = estimate.devices[sighting.device], self.pose(estimate, sighting.pose)
        points = self.corners[sighting.ids]
        turned = points @ pose[:3, :3].T
        moved = (turned + pose[:3, 3]) @ camera.R.T
        predicted, jacobian = cv2.projectPoints(moved + camera.t, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
        by_point = jacobian[:, 3:6].reshape(-1, 2, 3)
        by_rig = by_point @ camera.R
        used = 4 + LENSES[self.lenses[sighting.device]]
        blocks = {("intrinsics", sighting.device): jacobian[:, 6:6 + used], ("device", sighting.device): _by_motion(by_point, moved)}
        if self.table is None or sighting.pose not in self.table.turns:
            return predicted.reshape(-1, 2), {**blocks, ("board", sighting.pose): _by_motion(by_rig, turned)}
        return predicted.reshape(-1, 2), {**blocks, **self._by_table(sighting.pose, estimate, points, by_rig)}

    def _by_table(self, pose: str, estimate: Estimate, points: np.ndarray, by_rig: np.ndarray) -> Blocks:
        name, _ = self.table.turns[pose]
        world, turn, placement = estimate.world, self._turn(estimate, pose), estimate.placements[name]
        on_table = points @ placement[:3, :3].T
        in_world = (on_table + placement[:3, 3]) @ turn[:3, :3].T + turn[:3, 3]
        by_world = by_rig @ world[:3, :3]
        swept = np.cross(self.table.axis.direction, in_world - self.table.axis.point)
        return {("world",): _by_motion(by_rig, in_world @ world[:3, :3].T),
                ("error", pose): (by_world @ swept[..., None]).reshape(-1, 1),
                ("placement", name): _by_motion(by_world @ turn[:3, :3], on_table)}


def _by_motion(by_point: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Return the (2n, 6) derivatives by ``w`` and ``t`` from those (n, 2, 3) by the point: ``a . (w x X) = w . (X x a)``."""
    return np.concatenate((np.cross(turned[:, None], by_point), by_point), axis=-1).reshape(-1, 6)


def adjust(problem: Problem, estimate: Estimate, noise: Mapping[str, float]) -> Estimate:
    """Return the estimate of least squared error near a first one (Levenberg & Marquardt).

    Parameters
    ----------
    problem : Problem
    estimate : Estimate
    noise : mapping of str to float
        Of each device's corners, in pixels: those of a noisy one count less. What the corners leave open keeps its value.
    """
    columns, _ = problem.columns(estimate)
    hessian, gradient, cost = problem.normal_equations(estimate, noise)
    negligible = _CONVERGED * sum(len(sighting.ids) for sighting in problem.sightings)  # of corners that fit to rounding
    damping = _DAMPING
    for _ in range(_STEPS):
        scale = _scale(hessian)
        step = np.linalg.solve(hessian / np.outer(scale, scale) + damping * np.eye(len(scale)), gradient / scale) / scale
        if gradient @ step <= _CONVERGED * cost + negligible:
            break
        moved = _stepped(estimate, columns, step)
        trial = problem.normal_equations(moved, noise) if moved is not None else (None, None, np.inf)
        if trial[2] < cost:
            estimate, (hessian, gradient, cost), damping = moved, trial, max(damping / 10, _LEAST_DAMPING)
        elif (damping := damping * 10) > _MOST_DAMPING:
            break
    return estimate


def deviations(problem: Problem, estimate: Estimate, residuals: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Return the (9,) standard deviations of each device's intrinsics, by the residuals' own spread."""
    noise = {}
    for name in estimate.devices:
        own = [residual for sighting, residual in zip(problem.sightings, residuals, strict=True) if sighting.device == name]
        noise[name] = max(float(np.sqrt((np.concatenate(own) ** 2).mean())), 1e-9)
    hessian, _, _ = problem.normal_equations(estimate, noise)
    scale = _scale(hessian)
    covariance = np.linalg.pinv(hessian / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    columns, _ = problem.columns(estimate)
    found = {}
    for name in estimate.devices:
        variances = np.diag(covariance)[columns["intrinsics", name]]
        found[name] = np.concatenate((np.sqrt(np.maximum(variances, 0)), np.zeros(_INTRINSICS - len(variances))))
    return found


def _scale(hessian: np.ndarray) -> np.ndarray:
    """Return by what to divide unknowns as different as pixels and k3, so that each has the same weight."""
    return np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))


def _stepped(estimate: Estimate, columns: Mapping[tuple[str, ...], slice], step: np.ndarray) -> Estimate | None:
    """Return the estimate after a step, or None where that leads to no camera."""
    devices = {}
    for name, camera in estimate.devices.items():
        intrinsics = np.zeros(_INTRINSICS)
        own = step[columns["intrinsics", name]]
        intrinsics[:len(own)] = own
        fx, fy, cx, cy = intrinsics[:4]
        K = camera.K + np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 0]])
        if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
            return None
        pose = _moved(motion(camera.R, camera.t), step[columns["device", name]]) if ("device", name) in columns \
            else motion(camera.R, camera.t)
        devices[name] = replace(camera, K=K, R=pose[:3, :3], t=pose[:3, 3], distortion=camera.distortion + intrinsics[4:])
    return Estimate(
        devices, {name: _moved(pose, step[columns["board", name]]) for name, pose in estimate.boards.items()},
        None if estimate.world is None else _moved(estimate.world, step[columns["world",]]),
        {name: _moved(pose, step[columns["placement", name]]) for name, pose in estimate.placements.items()},
        {name: error + float(step[columns["error", name]][0]) for name, error in estimate.errors.items()})


def motion(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the (4, 4) motion ``X -> R X + t``."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, t
    return matrix


def _moved(pose: np.ndarray, step: np.ndarray) -> np.ndarray:
    angle = float(np.linalg.norm(step[:3]))
    u, _, vt = np.linalg.svd((rotation_about(step[:3], angle) if angle > 0 else np.eye(3)) @ pose[:3, :3])  # rounding must not add up
    return motion(u @ vt, pose[:3, 3] + step[3:])
