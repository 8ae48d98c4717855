# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration boards before analytic cameras and projectors: poses, corners, pictures and decoded maps, all by formula."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from addon.captures.pictures import write_picture
from addon.captures.schema import Capture, Frame
from addon.captures.store import write_capture
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.calibration.board import Board
from addon.reconstruction.calibration.camera import Sighting
from addon.reconstruction.geometry import Camera, rotation_about

_PIXELS_PER_SQUARE, _MARGIN = 56, 0.5
_BLACK, _WHITE, _AROUND = 0.04, 0.8, 0.25  # linear


def device(focal: float, size: tuple[int, int], *, centre=None, distortion=(0, 0, 0, 0, 0), R=None, t=(0, 0, 0)) -> Camera:
    """Return a camera or projector at the origin, looking along z, unless it is told otherwise."""
    u, v = ((size[0] - 1) / 2, (size[1] - 1) / 2) if centre is None else centre
    return Camera([[focal, 0, u], [0, focal, v], [0, 0, 1]], np.eye(3) if R is None else R, t, size, distortion)


def board_pose(board: Board, centre, tilt: float = 0.0, about: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Return the (4, 4) pose of a board whose middle lies at ``centre``.

    It faces ``-z``, turned in its plane by ``turn`` and then tilted by ``tilt`` about the axis of the plane at angle ``about``.
    """
    pose = np.eye(4)
    pose[:3, :3] = rotation_about((np.cos(about), np.sin(about), 0), tilt) @ rotation_about((0, 0, 1), turn)
    pose[:3, 3] = np.array(centre) - pose[:3, :3] @ board.corners.mean(axis=0)
    return pose


def spread_poses(board: Board, rng, count: int, *, nearest: float, furthest: float, tilt=(0.17, 0.61), shift: float = 0.06) -> list[np.ndarray]:
    """Return poses tilted about axes all round, near the optical axis of a camera at the origin."""
    return [board_pose(board, (*rng.uniform(-shift, shift, 2), rng.uniform(nearest, furthest)), rng.uniform(*tilt),
                       2 * np.pi * number / count + rng.uniform(-0.2, 0.2), rng.uniform(-0.3, 0.3)) for number in range(count)]


def in_frame(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (n, 3) points of the board in the frame that the pose leads to."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def sighting(name: str, seen_by: Camera, board: Board, pose: np.ndarray, number, noise=0.0) -> Sighting:
    """Return the corners where they project to, moved by ``noise``, (n, 2) or a number."""
    pixels = seen_by.project(in_frame(pose, board.corners))[0]
    return Sighting(name, str(number), f"{number:04d}", np.arange(len(pixels)), pixels + noise)


def sight_lines(camera: Camera) -> np.ndarray:
    """Return the (height, width, 2) normalised coordinates ``X / Z, Y / Z`` that each pixel's centre sees through the lens."""
    grid = pixel_grid(camera.size)
    if not camera.distorted:
        return (grid - camera.K[:2, 2]) / np.diag(camera.K)[:2]
    stop = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-10
    return cv2.undistortPointsIter(grid.reshape(-1, 1, 2), camera.K, camera.distortion, np.eye(3), np.eye(3), stop).reshape(grid.shape)


def board_points(camera: Camera, pose: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Return where on the board's plane (..., 2) sight lines end, as (..., 2) x, y in its frame: the inverse of a homography."""
    seen = camera.moved(pose)
    inverse = np.linalg.inv(np.column_stack((seen.R[:, :2], seen.t)))
    x, y, w = (lines[..., 0] * row[0] + lines[..., 1] * row[1] + row[2] for row in inverse)
    return np.stack((x / w, y / w), axis=-1)


def pixel_grid(size: tuple[int, int]) -> np.ndarray:
    """Return the (height, width, 2) positions of the pixels' centres."""
    return np.stack(np.meshgrid(*(np.arange(side, dtype=np.float64) for side in size)), axis=-1)


def board_albedo(board: Board, camera: Camera, pose: np.ndarray, samples: int = 2) -> np.ndarray:
    """Return the (height, width) picture of the evenly lit board, each pixel the mean of ``samples`` squared."""
    texture = board.draw(_PIXELS_PER_SQUARE, _MARGIN) / np.float32(255) * (_WHITE - _BLACK) + _BLACK
    width, height = camera.size
    # Between pixels' centres a lens is as good as linear; resize puts its samples where they are evenly spread over each pixel
    lines = cv2.resize(sight_lines(camera), (width * samples, height * samples), interpolation=cv2.INTER_LINEAR)
    place = (board_points(camera, pose, lines) / board.square + 1 + _MARGIN) * _PIXELS_PER_SQUARE - 0.5
    seen = cv2.remap(texture.astype(np.float32), place.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                     borderValue=_AROUND)
    return seen.reshape(height, samples, width, samples).mean(axis=(1, 3))


def lit_pixels(camera: Camera, projector: Camera, pose: np.ndarray) -> np.ndarray:
    """Return the (height, width, 2) projector pixels, not rounded, that light what each camera pixel sees of the board's plane."""
    points = board_points(camera, pose, sight_lines(camera))
    space = np.concatenate((points, np.zeros((*points.shape[:2], 1))), axis=-1)
    return projector.moved(pose).project(space)[0]


def decoded_map(board: Board, camera: Camera, projector: Camera, pose: np.ndarray) -> np.ndarray:
    """Return what an ideal Gray code gives: whole projector pixels on the white squares, NaN elsewhere."""
    lit = np.floor(lit_pixels(camera, projector, pose) + 0.5)
    square = np.floor(board_points(camera, pose, sight_lines(camera)) / board.square + 1)
    white = (square >= 0).all(-1) & (square < (board.columns, board.rows)).all(-1) & (square.sum(-1) % 2 == 1)
    inside = (lit >= 0).all(-1) & (lit < projector.size).all(-1)
    return np.where((white & inside)[..., None], lit, np.nan)


def write_board_capture(folder: Path, board: Board, camera: Camera, projector: Camera | None, by_hand: Sequence[np.ndarray],
                        on_table: np.ndarray | None = None, turns: Sequence[float] = (), said: Camera | None = None) -> Capture:
    """Write a capture set of a board by formula: poses by hand (board to world), each under a Gray code, then turns of the table.

    Parameters
    ----------
    on_table : (4, 4) array, optional
        The board's frame to the object frame.
    turns : sequence of float
        Angles of the table about the world's z.
    said : Camera, optional
        What the set says of the camera, if that is not the truth.
    """
    frames, patterns = [], make_patterns("gray-code", projector.size) if projector else ()
    to_camera = np.eye(4)
    to_camera[:3, :3], to_camera[:3, 3] = camera.R, camera.t
    plain = replace(camera, R=np.eye(3), t=np.zeros(3))

    def add(picture, motion, pattern, pose):
        name = f"{len(frames) + 1:04d}"
        write_picture(folder / "images" / f"{name}.png", np.repeat(picture[..., None], 3, -1), bits=8)
        frames.append(Frame(name, f"images/{name}.png", "cam", motion, pattern=pattern, board_pose=pose))

    for number, pose in enumerate(by_hand):
        albedo = board_albedo(board, plain, to_camera @ pose)
        add(albedo, np.eye(4), None, f"by hand {number}")
        if projector:
            column, row = np.moveaxis(np.floor(lit_pixels(plain, projector.moved(np.linalg.inv(to_camera)), to_camera @ pose) + 0.5).astype(int), -1, 0)
            lit = (column >= 0) & (row >= 0) & (column < projector.size[0]) & (row < projector.size[1])
            for pattern in patterns:
                add(albedo * np.where(lit, pattern.image[row * lit, column * lit] / 255, 0), np.eye(4), pattern.id, f"by hand {number}")
    for angle in turns:
        motion = np.eye(4)
        motion[:3, :3] = rotation_about((0, 0, 1), angle)
        add(board_albedo(board, plain, to_camera @ motion @ on_table), motion, None, "table")
    capture = Capture({"cam": said or camera}, tuple(frames), projectors={"lamp": projector} if projector else {},
                      patterns={pattern.id: pattern.fields for pattern in patterns}, board=board)
    write_capture(folder, capture)
    return capture
