# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What importers share: pictures and calibration files of strangers, and the set they make of them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from ...errors import ScanstageError
from ...reconstruction.geometry import MAX_SKEW_OF_ROTATION, Camera
from ..fields import MAX_NUMBER
from ..files import inside, read_bytes
from ..picture_format import SUFFIXES
from ..pictures import picture_is_whole, picture_size
from ..schema import FRAME_ID, MAX_PIXELS, MAX_SIDE, Capture, Frame

MAX_CALIBRATION_BYTES = 1 << 24
MAX_ROUNDING = 1e-2  # of a rotation written with few digits
_MAX_NAME = 1000
FOLDER = "source's folder"  # in error messages


@dataclass(frozen=True)
class Import:
    """What an importer found.

    Parameters
    ----------
    capture : Capture
        With its pictures under ``images/``; the encoding is set by the caller.
    pictures : mapping of str to Path
        Where each of them is now.
    """

    capture: Capture
    pictures: Mapping[str, Path]


def natural_key(name: str) -> list[tuple[int, int | str]]:
    """Return a sorting key under which image_2 comes before image_10."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", name) if part]


def pictures_in(folder: Path) -> list[Path]:
    """Return the pictures of a folder, in their natural order.

    Raises
    ------
    ScanstageError
        There are none, or one is a link out of the folder.
    """
    pictures = sorted((item for item in folder.iterdir() if item.suffix.lower() in SUFFIXES), key=lambda item: natural_key(item.name))
    if not pictures:
        raise ScanstageError(f"{folder}: holds no pictures; put them there")
    return [own_file(folder, picture.name) for picture in pictures]


def find_below(folder: Path, name: str, place: str, endings: Sequence[str] = ("",)) -> Path | None:
    """Return the file that a stranger's text names in a folder, or None if there is none.

    Parameters
    ----------
    folder : Path
    name : str
        A path with forward slashes, to which one of ``endings`` may have to be added.
    place : str
        Where the name stands, for error messages.
    endings : sequence of str

    Raises
    ------
    ScanstageError
        It leads out of the folder, by itself or by a link.
    """
    relative = PurePosixPath(name)
    if relative.is_absolute() or ".." in relative.parts or any(mark in name for mark in "\\:\0"):
        raise ScanstageError(f"{place}: {name[:100]!r} leaves the {FOLDER}; put the file below it")
    for ending in endings:
        # A name of thousands of letters is a file nowhere, and asking for it an error of the system's.
        if len(name) <= _MAX_NAME and os.path.isfile(folder / f"{name}{ending}"):
            return inside(folder, f"{name}{ending}", place, whole=FOLDER)
    return None


def own_file(folder: Path, name: str) -> Path:
    """Return the path of a file in a stranger's folder.

    Raises
    ------
    ScanstageError
        It is a link out of the folder.
    """
    return inside(folder, name, name, whole=FOLDER)


def read_text(path: Path) -> str:
    """Read a calibration file.

    Raises
    ------
    ScanstageError
        It is not there, far too large or no text.
    """
    try:
        return read_bytes(path, MAX_CALIBRATION_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ScanstageError(f"{path.name}: is not a text file; check that it is the right file") from None


def plain_numbers(words: Sequence[str], place: str) -> list[float]:
    """Return words as finite numbers; ``place`` is where they stand, for error messages.

    Raises
    ------
    ScanstageError
        One is no number, not finite, or too large.
    """
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise ScanstageError(f"{place}: one of the values is no number; correct it") from None
    if not all(abs(value) <= MAX_NUMBER for value in values):
        raise ScanstageError(f"{place}: a number is not finite or is too large; correct it")
    return values


def checked_size(picture: Path, place: str) -> tuple[int, int]:
    """Return the width and height of a picture of the source; ``place`` is where the source names it.

    Raises
    ------
    ScanstageError
        It is not there, no picture, or cut off.
    """
    if not picture.is_file():
        raise ScanstageError(f"{place}: the picture {picture.name} is not in {picture.parent}; put it there")
    size = picture_size(picture)
    if not (0 < size[0] * size[1] <= MAX_PIXELS and max(size) <= MAX_SIDE):
        raise ScanstageError(f"{picture.name}: claims {size[0]}x{size[1]} pixels; use a picture of 1 to {MAX_PIXELS} pixels")
    if not picture_is_whole(picture, size):
        raise ScanstageError(f"{picture.name}: is cut off or damaged; copy it again")
    return size


def common_size(pictures: Sequence[Path], place: str) -> tuple[int, int]:
    """Return the width and height of pictures that one camera took; ``place`` is as for `checked_size`.

    Raises
    ------
    ScanstageError
        One is not there or damaged, or they differ.
    """
    sizes = [checked_size(picture, place) for picture in pictures]
    for picture, size in zip(pictures, sizes, strict=True):
        if size != sizes[0]:
            raise ScanstageError(f"{picture.name}: is {size[0]}x{size[1]} pixels and {pictures[0].name} {sizes[0][0]}x{sizes[0][1]}; give "
                                 "pictures of one camera, none turned or cropped")
    return sizes[0]


def nearest_rotation(R: np.ndarray, place: str) -> np.ndarray:
    """Return R if it is orthogonal, else, if only its digits are few, the nearest matrix that is (by SVD).

    Raises
    ------
    ScanstageError
        It is no rotation, not even a mirrored one.
    """
    skew = np.abs(R @ R.T - np.eye(3)).max()
    if skew <= MAX_SKEW_OF_ROTATION:
        return R
    if not skew <= MAX_ROUNDING:
        raise ScanstageError(f"{place}: R is not a rotation: its rows are not orthonormal; correct the calibration")
    u, _, vt = np.linalg.svd(R)
    return u @ vt


def camera_from(K, R, t, distortion, size: tuple[int, int], place: str) -> Camera:
    """Return a camera of a source's own matrices.

    Raises
    ------
    ScanstageError
        A matrix is not what it must be.
    """
    try:
        K = np.asarray(K, dtype=np.float64)
        return Camera(K / K[2, 2] if K[2, 2] else K, nearest_rotation(np.asarray(R), place), t, size, distortion)
    except ValueError as error:
        raise ScanstageError(f"{place}: {error}; correct the calibration") from None


def assemble(cameras: Sequence[tuple[Path, Camera]]) -> Import:
    """Return the set of one frame and one camera a picture, in the pictures' natural order."""
    ordered = sorted(cameras, key=lambda item: natural_key(item[0].name))
    frames, devices, pictures = [], {}, {}
    taken = {}
    for index, (picture, camera) in enumerate(ordered):
        plain = FRAME_ID.fullmatch(picture.stem)
        id = picture.stem if plain else f"{index + 1:04d}"
        relative = f"images/{picture.name if plain or _is_plain(picture.name) else id + picture.suffix.lower()}"
        if taken.setdefault(id.casefold(), relative) != relative or relative in pictures:
            raise ScanstageError(f"{picture.name}: has the same name as {Path(taken[id.casefold()]).name}; rename one")
        frames.append(Frame(id, relative, id))
        devices[id] = camera
        pictures[relative] = picture
    return Import(Capture(devices, tuple(frames), "srgb"), pictures)


def _is_plain(name: str) -> bool:
    """Return whether a picture may keep its name in a set; nobody has to read one with a line break or of another system's."""
    return name.isprintable() and not any(mark in name for mark in "\\:") and len(name) <= 200
