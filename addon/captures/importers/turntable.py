# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder of pictures that one camera took of an object on a turntable, with one calibration.

The calibration is an OpenCV FileStorage file: ``K`` and perhaps ``distortion``, under any of the names that `opencv` reads, and
where the table stands, in either of two ways:

- ``R`` and ``t``, world to camera, for a world whose z axis is the table's;
- ``axis_point`` and ``axis_direction``, three numbers each, in the world of R and t or, without these, in the camera's own frame.

Between two pictures, in their natural order, the object turns by one step about the axis: by the right hand, which is
counter-clockwise where the direction points at the viewer.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...reconstruction.geometry import Camera, rotation_about
from .opencv import calibration_file, compose_camera, named_matrices, open_storage, read_matrix
from .sources import Import, assemble, common_size, pictures_in

TURNTABLE_OPTIONS = (
    Option("step", 0.0, "Turn of the object from one picture to the next, negative for clockwise; 0 shares one full turn among the "
           "pictures", unit=Unit.ANGLE, minimum=-math.pi, maximum=math.pi),
)
CAMERA = "camera"
_UP = np.array([0.0, 0.0, 1.0])


def read_turntable(source: Path, *, step: float) -> Import:
    """Take each picture of a folder as one turn of the table.

    Parameters
    ----------
    source : Path
        The calibration file, or a folder that holds one.
    step : float
        Radians from picture to picture; 0 shares one full turn among them.

    Raises
    ------
    ScanstageError
        The calibration cannot be read or does not say where the table is, there are no pictures, or they differ in size.
    """
    path = calibration_file(source)
    pictures = pictures_in(path.parent)
    with open_storage(path) as storage:
        camera = single_camera(storage, path, common_size(pictures, path.name))
        point, direction = _axis(storage, path)
    found = assemble([(picture, camera) for picture in pictures])
    step = step or 2 * math.pi / len(pictures)
    frames = tuple(replace(frame, camera=CAMERA, object_to_world=_turn(point, direction, number * step))
                   for number, frame in enumerate(found.capture.frames))
    return replace(found, capture=replace(found.capture, cameras={CAMERA: camera}, frames=frames))


def single_camera(storage: cv2.FileStorage, path: Path, size: tuple[int, int]) -> Camera:
    """Return the one camera of a calibration file, at the origin where the file gives no pose.

    Raises
    ------
    ScanstageError
        K is missing, only one of R and t is there, or a matrix is not what it must be.
    """
    matrices = named_matrices(storage.root(), path.name)
    if "K" not in matrices:
        raise ScanstageError(f"{path.name}: K: is missing; add the camera's 3x3 matrix")
    if ("R" in matrices) != ("t" in matrices):
        here, lacking = ("R", "t") if "R" in matrices else ("t", "R")
        raise ScanstageError(f"{path.name}: {lacking}: is missing where {here} is given; add it")
    return compose_camera({"R": np.eye(3), "t": np.zeros(3), **matrices}, size, path.name)


def _axis(storage: cv2.FileStorage, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return a point (3,) of the table's axis and its direction (3,)."""
    point, direction = (_vector(storage, path, name) for name in ("axis_point", "axis_direction"))
    if point is None and direction is None:
        if "R" not in named_matrices(storage.root(), path.name):
            raise ScanstageError(f"{path.name}: says neither R and t nor axis_point and axis_direction; add where the table stands")
        return np.zeros(3), _UP
    for name, value in (("axis_point", point), ("axis_direction", direction)):
        if value is None:
            raise ScanstageError(f"{path.name}: {name}: is missing; an axis is a point and a direction")
    if not np.linalg.norm(direction) > 1e-9:
        raise ScanstageError(f"{path.name}: axis_direction: has no length; correct it")
    return point, direction


def _vector(storage: cv2.FileStorage, path: Path, name: str) -> np.ndarray | None:
    node = storage.getNode(name)
    if node.empty():
        return None
    value = read_matrix(node, f"{path.name}: {name}")
    if value.size != 3:
        raise ScanstageError(f"{path.name}: {name}: must be three numbers; correct it")
    return value.ravel()


def _turn(point: np.ndarray, direction: np.ndarray, angle: float) -> np.ndarray:
    """Return the (4, 4) motion of the table: `Frame.object_to_world`."""
    motion = np.eye(4)
    motion[:3, :3] = rotation_about(direction, angle)
    motion[:3, 3] = point - motion[:3, :3] @ point
    return motion
