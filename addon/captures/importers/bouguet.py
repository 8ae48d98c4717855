# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""``Calib_Results.m`` of Bouguet's camera calibration toolbox for MATLAB, with the pictures it was made from.

The file is read as text and never run: what counts are assignments of plain numbers. ``fc cc alpha_c kc`` are the intrinsics
(``K = [fc1, alpha_c fc1, cc1; 0, fc2, cc2; 0, 0, 1]``, kc is k1 k2 p1 p2 k3, and the top-left pixel's centre is (0, 0), as
here); ``omc_7 Tc_7`` are the pose of picture 7, as a Rodrigues vector and a translation, from the board's frame to the
camera's. A picture that the toolbox left out has NaN there, and is left out here as well. Beside a picture ``view7.jpg`` its
silhouette may lie as outlines, ``view7.txt`` (see `contour_file`).
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import cv2
import numpy as np

from ...errors import ScanstageError
from ..fields import MAX_NUMBER
from .silhouettes import with_outlines
from .sources import Import, assemble, camera_from, checked_size, own_file, pictures_in, read_text

FILE = "Calib_Results.m"
_ASSIGNMENT = re.compile(r"^[ \t]*([A-Za-z]\w{0,60})[ \t]*=[ \t]*(?:\[([^\[\]]{0,10000})\]|([^\[\];\n]{1,100}))", re.MULTILINE)
_POSE = re.compile(r"omc_([1-9]\d{0,8})")


def read_bouguet(source: Path) -> Import:
    """Read a calibration and find its pictures.

    Parameters
    ----------
    source : Path
        The file, or the folder of ``Calib_Results.m``.

    Raises
    ------
    ScanstageError
        A value is missing or not what it must be, or a picture is not there.
    """
    path = source if source.is_file() else own_file(source, FILE)
    if not path.is_file():
        raise ScanstageError(f"{source}: holds no {FILE}; give the file")
    values = _assignments(read_text(path), path.name)
    focal, centre, distortion = (_vector(values, name, length, path.name) for name, length in (("fc", 2), ("cc", 2), ("kc", 5)))
    skew = _vector(values, "alpha_c", 1, path.name)[0] if "alpha_c" in values else 0.0
    K = np.array([[focal[0], skew * focal[0], centre[0]], [0, focal[1], centre[1]], [0, 0, 1]])
    pictures = _by_number(path)
    cameras = []
    for number in sorted(int(match[1]) for name in values if (match := _POSE.fullmatch(name))):
        if any(math.isnan(value) for value in values[f"omc_{number}"]):
            continue
        place = f"{path.name}: omc_{number}"
        rotation, translation = (_vector(values, f"{name}_{number}", 3, path.name) for name in ("omc", "Tc"))
        if number not in pictures:
            raise ScanstageError(f"{place}: no picture in {path.parent} has the number {number}; put it there")
        size = checked_size(pictures[number], place)
        if "nx" in values and "ny" in values:
            stated = tuple(_vector(values, name, 1, path.name)[0] for name in ("nx", "ny"))
            if stated != size:
                raise ScanstageError(f"{pictures[number].name}: is {size[0]}x{size[1]} pixels and nx, ny of {path.name} are "
                                     f"{stated[0]:g}, {stated[1]:g}; give the pictures that belong to it")
        cameras.append((pictures[number], camera_from(K, cv2.Rodrigues(rotation)[0], translation, distortion, size, place)))
    if not cameras:
        raise ScanstageError(f"{path.name}: holds no pose (omc_1, Tc_1, ...); save the calibration again with its extrinsics")
    return with_outlines(assemble(cameras), path.parent)


def _assignments(text: str, file: str) -> dict[str, list[float]]:
    """Return the plain numbers that are assigned to each name; what is assigned otherwise is left out."""
    found: dict[str, list[float]] = {}
    for match in _ASSIGNMENT.finditer(re.sub(r"%[^\n]*", "", text)):
        words = re.split(r"[\s;,]+", (match[2] if match[2] is not None else match[3]).strip(" \t\r\n;,"))
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            continue
        if match[1] in found:
            raise ScanstageError(f"{file}: {match[1]}: is given twice; leave one out")
        found[match[1]] = numbers
    return found


def _vector(values: dict[str, list[float]], name: str, length: int, file: str) -> np.ndarray:
    if name not in values:
        raise ScanstageError(f"{file}: {name}: is missing or holds no plain numbers; check that it is the right file")
    numbers = values[name]
    if len(numbers) != length:
        raise ScanstageError(f"{file}: {name}: has {len(numbers)} values where {length} are needed; correct it")
    if not all(abs(number) <= MAX_NUMBER for number in numbers):
        raise ScanstageError(f"{file}: {name}: a number is not finite or is too large; correct it")
    return np.array(numbers)


def _by_number(path: Path) -> dict[int, Path]:
    """Return the pictures by the last number in their names, as the toolbox counts them."""
    found: dict[int, Path] = {}
    for picture in pictures_in(path.parent):
        digits = re.findall(r"\d{1,9}", picture.stem)
        if not digits:
            continue
        if int(digits[-1]) in found:
            raise ScanstageError(f"{picture.name}: has the same number as {found[int(digits[-1])].name}; rename one")
        found[int(digits[-1])] = picture
    return found
