# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a capture set: written whole or not at all, read only from inside the set."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import ScanstageError
from ..files import replacing


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file under a temporary name in its folder, then give it its own, so that no half of it is ever seen.

    Raises
    ------
    ScanstageError
        The disk refuses.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScanstageError(f"{path}: cannot be written, for its folder cannot be made ({error.strerror}); check the path") from None
    with replacing(path) as file:
        file.write(data)


def read_bytes(path: Path, most: int, name: str | None = None) -> bytes:
    """Read a file of at most ``most`` bytes.

    Parameters
    ----------
    name : str, optional
        What error messages call the file; its last component if not given.

    Raises
    ------
    ScanstageError
        There is no such file, it is not a regular one, it is too large, or the disk refuses.
    """
    name = name or path.name
    try:
        if not path.is_file():  # a pipe would block for ever
            raise ScanstageError(f"{name}: is not there or not a file; check the path")
        with open(path, "rb") as file:
            # Not the limit itself: Python takes the memory for all that it is asked to read.
            data = file.read(min(most, os.fstat(file.fileno()).st_size) + 1)
    except OSError as error:
        raise ScanstageError(f"{name}: cannot be read ({error.strerror}); check the path and its rights") from None
    if len(data) > most:
        raise ScanstageError(f"{name}: is larger than {most >> 20} MiB; check that it is the right file")
    return data


def inside(folder: Path, relative: str, place: str, *, whole: str = "capture set") -> Path:
    """Return the path of a file of the set, after following links.

    Parameters
    ----------
    folder : Path
    relative : str
        Checked by `schema.relative_path`.
    place : str
        File and field that give the path, for the error message: ``capture.json: frames[3].image``.
    whole : str
        What the error message calls the folder.

    Raises
    ------
    ScanstageError
        A link leads out of the folder.
    """
    path = folder / relative
    try:
        real = path.resolve()
    except (OSError, RuntimeError):  # a link that leads to itself
        raise ScanstageError(f"{place}: {relative} is a link that leads nowhere; copy the file itself there") from None
    if not real.is_relative_to(folder.resolve()):
        raise ScanstageError(f"{place}: {relative} is a link out of the {whole}; copy the file itself into it")
    return path
