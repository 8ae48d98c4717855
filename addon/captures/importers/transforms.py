# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""``transforms.json`` of NeRF (Mildenhall et al., 2020), instant-ngp and nerfstudio.

``transform_matrix`` is camera to world with the camera looking along -z and y up; the y and z axes are turned here.
The intrinsics, ``fl_x fl_y cx cy w h k1 k2 p1 p2`` or ``camera_angle_x``, stand at the top or in a frame. The top-left pixel's
centre is (0.5, 0.5) there, so half a pixel is taken off. A ``file_path`` may lack its ending, and a frame may have a
``mask_path``.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...reconstruction.geometry import Camera
from ..fields import Field, parse_json
from ..files import read_bytes
from ..picture_format import SUFFIXES
from .colmap import HALF_PIXEL
from .sources import MAX_CALIBRATION_BYTES, Import, assemble, camera_from, checked_size, find_below, own_file

FILE = "transforms.json"
AXES = np.diag((1.0, -1.0, -1.0))
"""From the file's camera axes, x right, y up, z backward, to those of OpenCV."""
LENS = ("k1", "k2", "p1", "p2", "k3")
_INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "camera_angle_x", "camera_angle_y", *LENS, "k4")
_FOREIGN = ("OPENCV_FISHEYE", "EQUIRECTANGULAR", "FISHEYE624", "ORTHOPHOTO")


def read_transforms(source: Path) -> Import:
    """Read the file and find its pictures.

    Parameters
    ----------
    source : Path
        The file, or the folder of ``transforms.json`` (or ``transforms_train.json``).

    Raises
    ------
    ScanstageError
        The file cannot be read, a field of it cannot be used, or a picture is not there.
    """
    names = [source] if source.is_file() else [own_file(source, name) for name in (FILE, "transforms_train.json")]
    path = next((name for name in names if name.is_file()), None)
    if path is None:
        raise ScanstageError(f"{source}: holds no {FILE}; give the file")
    document = parse_json(read_bytes(path, MAX_CALIBRATION_BYTES), path.name)
    top = _members(document, "an object with frames")
    model = top.get("camera_model")
    if model is not None and model.value in _FOREIGN:
        raise model.error(f"is {model.value}: only pinhole cameras with OpenCV's lens can be used; undistort the pictures first")
    if "frames" not in top or not isinstance(top["frames"].value, list) or not top["frames"].value:
        raise document.error("has no list of frames; check the file")
    views = [_view(path.parent, Field(item, path.name, f"frames[{number}]"), top) for number, item in enumerate(top["frames"].value)]
    found = assemble([(picture, camera) for picture, camera, _ in views])
    masks = {picture: mask for picture, _, mask in views if mask is not None}
    frames, pictures = [], dict(found.pictures)
    for frame in found.capture.frames:
        mask = masks.get(found.pictures[frame.image])
        if mask is not None:
            frame = replace(frame, mask=f"given/{frame.id}{mask.suffix.lower()}")
            pictures[frame.mask] = mask
        frames.append(frame)
    return Import(replace(found.capture, frames=tuple(frames)), pictures)


def _members(item: Field, what: str) -> dict[str, Field]:
    if not isinstance(item.value, dict):
        raise item.error(f"must be {what}; check the file")
    return {name: Field(value, item.source, f"{item.path}.{name}" if item.path else name) for name, value in item.value.items()}


def _view(folder: Path, item: Field, top: dict[str, Field]) -> tuple[Path, Camera, Path | None]:
    own = _members(item, "an object")
    if "file_path" not in own or "transform_matrix" not in own:
        raise item.error("must have a file_path and a transform_matrix; check the file")
    picture = _file(folder, own["file_path"])
    mask = _file(folder, own["mask_path"]) if "mask_path" in own and own["mask_path"].value is not None else None
    size = checked_size(picture, f"{item.source}: {item.path}")
    given = {name: (own.get(name) or top.get(name)) for name in _INTRINSICS}
    K, distortion = _lens({name: field for name, field in given.items() if field is not None}, size, item)
    matrix = own["transform_matrix"]
    three = isinstance(matrix.value, list) and len(matrix.value) == 3
    motion = np.vstack((matrix.numbers(3, 4), (0, 0, 0, 1))) if three else matrix.numbers(4, 4)
    place = f"{item.source}: {item.path}.transform_matrix"
    if np.abs(motion[3] - (0, 0, 0, 1)).max() > 1e-9:
        raise ScanstageError(f"{place}: its last row must be 0 0 0 1; correct it")
    R = AXES @ motion[:3, :3].T
    return picture, camera_from(K, R, -R @ motion[:3, 3], distortion, size, place), mask


def _lens(given: dict[str, Field], size: tuple[int, int], item: Field) -> tuple[np.ndarray, np.ndarray]:
    value = {name: field.number() for name, field in given.items()}
    width, height = value.get("w", size[0]), value.get("h", size[1])
    if (width, height) != size:
        raise item.error(f"its picture is {size[0]}x{size[1]} pixels and the file says {width:g}x{height:g}; give the pictures that "
                         "belong to it")
    if value.get("k4"):
        raise given["k4"].error("is not 0: that lens cannot be used; undistort the pictures first")
    focal = value.get("fl_x")
    if focal is None:
        angle = value.get("camera_angle_x")
        if angle is None or not 0 < angle < math.pi:
            raise item.error("has neither fl_x nor camera_angle_x, here or at the top; add one")
        focal = 0.5 * width / math.tan(0.5 * angle)
    across = value.get("fl_y")
    if across is None:
        across = 0.5 * height / math.tan(0.5 * value["camera_angle_y"]) if 0 < value.get("camera_angle_y", 0) < math.pi else focal
    K = np.array([[focal, 0, value.get("cx", width / 2) - HALF_PIXEL], [0, across, value.get("cy", height / 2) - HALF_PIXEL], [0, 0, 1]])
    return K, np.array([value.get(name, 0.0) for name in LENS])


def _file(folder: Path, item: Field) -> Path:
    name = item.value
    if not isinstance(name, str) or not name:
        raise item.error("must be the path of a picture; correct it")
    found = find_below(folder, name, f"{item.source}: {item.path}", ("", *SUFFIXES))
    if found is None:
        raise item.error(f"the picture {name[:100]!r} is not there; put it below the file's folder")
    return found
