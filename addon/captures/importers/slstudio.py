# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera and a projector as SLStudio and its kin store them, with the frames of one Gray-code scan.

The calibration is an OpenCV FileStorage file of ``Kc kc`` (camera), ``Kp kp`` (projector), ``Rp Tp`` (from the camera's frame to the
projector's) and ``screenResX``, ``screenResY``. Beside it lie the frames, numbered in their order: white, black, then the Gray
code's columns from the coarsest bit on. The finest may be left out; with twice as many frames each pattern is followed by its
inverse. The object frame is the camera's.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ...errors import ScanstageError
from ...reconstruction.active.patterns import LARGEST_SIDE, code_bits
from ...reconstruction.geometry import Camera
from ..schema import Capture, Frame
from .opencv import calibration_file, open_storage, read_matrix
from .sources import Import, camera_from, checked_size, pictures_in

_CAMERA, _PROJECTOR = "camera", "projector"


def read_slstudio(source: Path) -> Import:
    """Read a calibration and name its frames' patterns.

    Parameters
    ----------
    source : Path
        The calibration file, or a folder that holds one.

    Raises
    ------
    ScanstageError
        The file cannot be read, a matrix is not what it must be, or there are too few or too many frames.
    """
    path = calibration_file(source)
    frames = pictures_in(path.parent)
    size = checked_size(frames[0], path.name)
    with open_storage(path) as storage:
        screen = tuple(_whole(storage.getNode(name), f"{path.name}: {name}") for name in ("screenResX", "screenResY"))
        names = _patterns(len(frames), screen[0], path)
        camera = _device(storage, path, "Kc", "kc", size, (np.eye(3), np.zeros(3)))
        pose = _matrix(storage, path, "Rp", (3, 3)), _matrix(storage, path, "Tp", (3, 1))[:, 0]
        projector = _device(storage, path, "Kp", "kp", screen, pose)
    pictures = {f"images/{frame.name}": frame for frame in frames}
    shots = tuple(Frame(f"{number:04d}", relative, _CAMERA, pattern=id)
                  for number, (relative, id) in enumerate(zip(pictures, names, strict=True)))
    return Import(Capture({_CAMERA: camera}, shots, projectors={_PROJECTOR: projector}, patterns=names), pictures)


def _patterns(frames: int, columns: int, path: Path) -> dict[str, dict[str, object]]:
    """Return the patterns' ids and fields, in the order of the frames."""
    bits, coded = code_bits(columns), frames - 2
    if not 1 <= coded <= 2 * bits or (coded > bits and coded % 2):
        raise ScanstageError(f"{path.parent}: holds {frames} pictures where white, black and a Gray code of {columns} columns are 3 to "
                             f"{2 + bits}, or twice the bits with inverses; leave out the others")
    inverses = (False, True) if coded > bits else (False,)
    found: dict[str, dict[str, object]] = {"white": {"kind": "white"}, "black": {"kind": "black"}}
    for number in range(coded // len(inverses)):
        for inverse in inverses:
            found[f"gray-column-{number:02d}" + ("-inverse" if inverse else "")] = {
                "kind": "gray-code", "axis": "column", "bit": bits - 1 - number, "bits": bits, "inverse": inverse}
    return found


def _device(storage: cv2.FileStorage, path: Path, intrinsics: str, distortion: str, size: tuple[int, int],
            pose: tuple[np.ndarray, np.ndarray]) -> Camera:
    return camera_from(_matrix(storage, path, intrinsics, (3, 3)), *pose, _matrix(storage, path, distortion, (5, 1))[:, 0], size,
                       f"{path.name}: {intrinsics}")


def _matrix(storage: cv2.FileStorage, path: Path, name: str, shape: tuple[int, int]) -> np.ndarray:
    place = f"{path.name}: {name}"
    node = storage.getNode(name)
    if node.empty():
        raise ScanstageError(f"{place}: is missing; check that this is a calibration of camera and projector")
    value = read_matrix(node, place)
    if value.size != shape[0] * shape[1]:
        raise ScanstageError(f"{place}: must be a {shape[0]}x{shape[1]} matrix; correct the calibration")
    return value.reshape(shape)


def _whole(node: cv2.FileNode, place: str) -> int:
    if node.empty() or not node.isInt() or not 1 <= int(node.real()) <= LARGEST_SIDE:
        raise ScanstageError(f"{place}: must be a whole number from 1 to {LARGEST_SIDE}: the projector's size")
    return int(node.real())
