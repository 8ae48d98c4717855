# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's text models: ``cameras.txt`` and ``images.txt``, with the pictures in a folder ``images`` near them.

COLMAP's poses are world to camera, as here, with the rotation as a quaternion ``w x y z``. Its pixel coordinates have the
top-left pixel's centre at (0.5, 0.5): half a pixel is taken off the principal point. Every picture has two lines, of
which the second, the points seen in it, may be empty and is not used.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...reconstruction.geometry import Camera
from .sources import Import, assemble, camera_from, checked_size, find_below, own_file, plain_numbers, read_text

MODELS = {"SIMPLE_PINHOLE": ("f", "cx", "cy"), "PINHOLE": ("fx", "fy", "cx", "cy"), "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
          "RADIAL": ("f", "cx", "cy", "k1", "k2"), "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")}
"""COLMAP's camera models that OpenCV's lens describes, with their parameters."""
HALF_PIXEL = 0.5
_PICTURES = ("images", "../images", "../../images", ".")
_HEAD = 10  # words of a picture's first line
_LEAST_QUATERNION = 1e-6


def read_colmap(source: Path) -> Import:
    """Read a model.

    Parameters
    ----------
    source : Path
        The folder of ``cameras.txt`` and ``images.txt``, such as ``sparse/0``, or a folder above it.

    Raises
    ------
    ScanstageError
        A file is not there, a line of it cannot be used, or a picture is not there.
    """
    folder = _model(source)
    lenses = dict(_lenses(own_file(folder, "cameras.txt")))
    views = [_view(folder, place, words, lenses) for place, words in _pictures(own_file(folder, "images.txt"))]
    if not views:
        raise ScanstageError("images.txt: names no picture; export the model again")
    return assemble(views)


def quaternion_to_rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation of a quaternion ``w x y z`` of any length but 0."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def _model(source: Path) -> Path:
    if source.is_file():
        source = source.parent
    found = next((source / name for name in (".", "sparse/0", "sparse", "0") if (source / name / "images.txt").is_file()), None)
    if found is None:
        binary = " (a binary model is there: convert it with COLMAP's model_converter)" if list(source.glob("**/images.bin")) else ""
        raise ScanstageError(f"{source}: holds no images.txt of COLMAP's{binary}; give the folder of the text model")
    return found


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the numbers and lines of a file, without comments; empty ones too."""
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.lstrip().startswith("#"):
            yield number, line.strip()


def _lenses(path: Path) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray, tuple[int, int]]]]:
    for number, line in _lines(path):
        if not line:
            continue
        place, words = f"{path.name}: line {number}", line.split()
        if len(words) < 4 or words[1] not in MODELS:
            model = words[1][:40] if len(words) > 1 else ""
            raise ScanstageError(f"{place}: camera model {model!r} cannot be used; known are: {', '.join(MODELS)}: undistort the pictures "
                                 "with COLMAP first")
        names = MODELS[words[1]]
        if len(words) != 4 + len(names):
            raise ScanstageError(f"{place}: {words[1]} takes {len(names)} parameters ({', '.join(names)}), not {len(words) - 4}; correct "
                                 "it")
        width, height, *values = plain_numbers(words[2:], place)
        value = dict(zip(names, values, strict=True))
        K = np.array([[value.get("fx", value.get("f")), 0, value["cx"] - HALF_PIXEL],
                      [0, value.get("fy", value.get("f")), value["cy"] - HALF_PIXEL], [0, 0, 1]])
        if not (width == int(width) >= 1 and height == int(height) >= 1):
            raise ScanstageError(f"{place}: {width:g}x{height:g} is no size of a picture; correct it")
        yield words[0], (K, np.array([value.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")]), (int(width), int(height)))


def _pictures(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield the first line of each picture's two."""
    lines = _lines(path)
    for number, line in lines:
        if line:
            yield f"{path.name}: line {number}", line.split(maxsplit=_HEAD - 1)
            next(lines, None)  # the points, which may be an empty line


def _view(folder: Path, place: str, words: list[str], lenses: dict) -> tuple[Path, Camera]:
    if len(words) != _HEAD:
        raise ScanstageError(f"{place}: has {len(words)} words where {_HEAD} are needed (id, quaternion, translation, camera, name); "
                             "correct it")
    if words[8] not in lenses:
        raise ScanstageError(f"{place}: camera {words[8][:40]!r} is not in cameras.txt; export the model again")
    values = plain_numbers(words[1:8], place)
    if not np.linalg.norm(values[:4]) > _LEAST_QUATERNION:
        raise ScanstageError(f"{place}: the quaternion is 0; export the model again")
    picture = _picture(folder, words[9], place)
    K, distortion, size = lenses[words[8]]
    if checked_size(picture, place) != size:
        found = checked_size(picture, place)
        raise ScanstageError(f"{place}: {picture.name} is {found[0]}x{found[1]} and its camera {size[0]}x{size[1]} pixels; give the "
                             "pictures that the model was made from")
    return picture, camera_from(K, quaternion_to_rotation(np.array(values[:4])), np.array(values[4:]), distortion, size, place)


def _picture(folder: Path, name: str, place: str) -> Path:
    found = (find_below(folder / base, name, place) for base in _PICTURES if not (folder / base).is_symlink())
    picture = next((picture for picture in found if picture is not None), None)
    if picture is None:
        raise ScanstageError(f"{place}: the picture {name[:100]!r} is not in a folder images near the model; put it there")
    return picture
