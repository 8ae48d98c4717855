# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The multi-view sets of Middlebury (Seitz et al., 2006): ``*_par.txt`` with name, K, R and t on one line a picture.

Their pixels have the centre of the top-left one at (0, 0), as here. The set's README may give the tight bounding box,
which becomes the working volume, and the recipe for silhouettes that it recommends becomes the set's default.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...options import Option
from ..fields import MAX_NUMBER
from .sources import Import, assemble, camera_from, checked_size, find_below, own_file, plain_numbers, read_text

MIDDLEBURY_OPTIONS = (
    Option("good_silhouettes", False, "Leave out the pictures that *_good_silhouette_images.txt does not list, whose "
           "silhouettes have shadows that carve into the object"),
)
RECIPE = {"silhouette": "threshold", "threshold": 0.19, "dilate": 10, "erode": 7}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def read_middlebury(source: Path, *, good_silhouettes: bool) -> Import:
    """Read a set.

    Parameters
    ----------
    source : Path
        The folder, or the ``*_par.txt`` in it.
    good_silhouettes : bool

    Raises
    ------
    ScanstageError
        There is not exactly one ``*_par.txt``, a line of it cannot be used, or a picture is not there.
    """
    parameters = _only(source, "*_par.txt")
    lines = [line.split() for line in read_text(parameters).splitlines()]
    lines = [(number, words) for number, words in enumerate(lines, start=1) if words]
    if not lines or len(lines[0][1]) != 1 or not lines[0][1][0].isdecimal():
        raise ScanstageError(f"{parameters.name}: line 1 must be the number of pictures; check the file")
    if int(lines[0][1][0]) != len(lines) - 1:
        raise ScanstageError(f"{parameters.name}: line 1 announces {lines[0][1][0]} pictures, {len(lines) - 1} follow; "
                             "check that the file is complete")
    listed = _good(parameters.parent) if good_silhouettes else None
    cameras = [_camera(parameters, number, words) for number, words in lines[1:] if listed is None or words[0] in listed]
    if not cameras:
        raise ScanstageError(f"{parameters.name}: no picture is left to import; check the files' names")
    found = assemble(cameras)
    return replace(found, capture=replace(found.capture, silhouette=RECIPE, bounds=_box(parameters.parent)))


def _only(source: Path, pattern: str) -> Path:
    if source.is_file():
        return source
    found = sorted(source.glob(pattern))
    if len(found) != 1:
        raise ScanstageError(f"{source}: holds {len(found)} files {pattern} where one is needed; give the file itself")
    return own_file(source, found[0].name)


def _camera(parameters: Path, number: int, words: list[str]) -> tuple[Path, object]:
    place = f"{parameters.name}: line {number}"
    if len(words) != 22:
        raise ScanstageError(f"{place} has {len(words)} words where 22 are needed (name, K, R, t); correct it")
    if "/" in words[0]:
        raise ScanstageError(f"{place}: {words[0][:100]!r} is no plain file name; put the picture beside the file")
    values = np.array(plain_numbers(words[1:], place))
    picture = find_below(parameters.parent, words[0], place)
    if picture is None:
        raise ScanstageError(f"{place}: the picture {words[0][:100]!r} is not in {parameters.parent}; put it there")
    size = checked_size(picture, place)
    K, R, t = values[:9].reshape(3, 3), values[9:18].reshape(3, 3), values[18:]
    return picture, camera_from(K, R, t, np.zeros(5), size, place)


def _good(folder: Path) -> set[str]:
    return set(read_text(_only(folder, "*_good_silhouette_images.txt")).split())


def _box(folder: Path) -> np.ndarray | None:
    """Return the (2, 3) box of the README: the six numbers that follow the words, however they are punctuated."""
    readme = next((path for path in sorted(folder.iterdir()) if path.name.lower() == "readme.txt"), None)
    if readme is None:
        return None
    after = re.split(r"bounding\s+box", read_text(own_file(folder, readme.name)), maxsplit=1, flags=re.IGNORECASE)
    numbers = re.findall(_NUMBER, after[1][:400]) if len(after) == 2 else []
    if len(numbers) < 6:
        return None
    corners = np.array(numbers[:6], dtype=np.float64).reshape(2, 3)
    box = np.stack((corners.min(axis=0), corners.max(axis=0)))
    return box if (box[0] < box[1]).all() and (np.abs(box) <= MAX_NUMBER).all() else None
