# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What importers share: pictures and calibration files of strangers, and the set they make of them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...reconstruction.geometry import MAX_SKEW_OF_ROTATION, Camera
from ..files import read_bytes
from ..pictures import picture_is_whole, picture_size
from ..schema import FRAME_ID, Capture, Frame

MAX_CALIBRATION_BYTES = 1 << 24
MAX_ROUNDING = 1e-2  # of a rotation written with few digits


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
    if not picture_is_whole(picture, size):
        raise ScanstageError(f"{picture.name}: is cut off or damaged; copy it again")
    return size


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
        relative = f"images/{picture.name}"
        id = picture.stem if FRAME_ID.fullmatch(picture.stem) else f"{index + 1:04d}"
        if taken.setdefault(id.casefold(), relative) != relative or relative in pictures:
            raise ScanstageError(f"{picture.name}: has the same name as {Path(taken[id.casefold()]).name}; rename one")
        frames.append(Frame(id, relative, id))
        devices[id] = camera
        pictures[relative] = picture
    return Import(Capture(devices, tuple(frames), "srgb"), pictures)
