# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture set on disk: the folder with its `capture.json` and the pictures that it names."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

from ..errors import ScanstageError
from .fields import MAX_BYTES, parse_json
from .files import inside, read_bytes, write_bytes
from .pictures import picture_is_whole, read_picture, write_picture
from .schema import FILE_NAME, Capture, capture_from_field, capture_to_dict

__all__ = ["files_of", "is_capture", "picture_is_whole", "read_capture", "read_picture", "write_capture",
           "write_picture"]


def is_capture(folder: Path) -> bool:
    """Return whether the folder holds a `capture.json`, good or bad."""
    return os.path.isfile(Path(folder) / FILE_NAME)  # unlike Path.is_file also False for a name that no disk takes


def read_capture(folder: Path, *, require_pictures: bool = True) -> Capture:
    """Read a capture set.

    Parameters
    ----------
    folder : Path
    require_pictures : bool
        Whether every picture must be there, but for the frames that the set itself lists as missing. Whoever renders
        the rest of a set asks without.

    Raises
    ------
    ScanstageError
        There is no set, `capture.json` cannot be used, a path leaves the folder or a picture is not there.
    """
    folder = Path(folder)
    if not is_capture(folder):
        raise ScanstageError(f"{FILE_NAME}: is not in {folder}; give the folder of a capture set")
    capture = capture_from_field(parse_json(read_bytes(inside(folder, FILE_NAME, FILE_NAME), MAX_BYTES), FILE_NAME))
    for place, relative, remedy in files_of(capture):
        path = inside(folder, relative, place)
        if require_pictures and not path.is_file():
            raise ScanstageError(f"{place}: {relative} is missing; {remedy}")
    return capture


def files_of(capture: Capture) -> Iterator[tuple[str, str, str]]:
    """Yield the place in `capture.json`, the path and what to do when it is missing, of each file that should exist."""
    missing = set(capture.missing)
    for index, frame in enumerate(capture.frames):
        if frame.id not in missing:
            yield f"{FILE_NAME}: frames[{index}].image", frame.image, "run capture again to render it"
        if frame.mask is not None:
            yield f"{FILE_NAME}: frames[{index}].mask", frame.mask, "put it back, or set the mask to null"
        if frame.contours is not None:
            yield f"{FILE_NAME}: frames[{index}].contours", frame.contours, "put it back, or set the contours to null"
    for camera, relative in capture.plates.items():
        yield f"{FILE_NAME}: plate.{camera}", relative, "put it back, or set the plate to null"
    if capture.truth_mesh is not None:
        yield f"{FILE_NAME}: truth.mesh", capture.truth_mesh, "put it back, or set the truth to null"


def write_capture(folder: Path, capture: Capture) -> None:
    """Write `capture.json`, whole or not at all; the folder is made if there is none.

    Raises
    ------
    ValueError
        The set would not be read back: what the schema refuses must not reach the disk.
    ScanstageError
        The disk refuses.
    """
    data = json.dumps(capture_to_dict(capture), indent=1, allow_nan=False, ensure_ascii=False).encode()
    try:
        capture_from_field(parse_json(data, FILE_NAME))
    except ScanstageError as error:
        raise ValueError(f"this capture set is not valid: {error}") from None
    write_bytes(Path(folder) / FILE_NAME, data)
