# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import ScanstageError

_ROOM = 1 << 16  # bytes: more than a program keeps back until it closes a file


class NotWritten(ScanstageError):
    """A file or folder that the disk refuses.

    Parameters
    ----------
    path : Path
    reason : str
    """

    def __init__(self, path: Path, reason: str | None) -> None:
        super().__init__(f"{path}: cannot be written ({reason}); check the disk space and the rights of {path.parent}")
        self.reason = reason


def sibling(path: Path) -> Path:
    """Return an unused hidden name in the same folder, from which a rename to ``path`` is atomic."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}")


@contextmanager
def replacing(path) -> Iterator[BinaryIO]:
    """Open a binary file for writing that takes the place of ``path`` when the block ends without an exception.

    Raises
    ------
    ScanstageError
        The file cannot be written.
    """
    path = Path(path)
    temporary = sibling(path)
    try:
        with open(temporary, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())  # a rename may reach the disk before the data does
        os.replace(temporary, path)
    except OSError as error:
        raise NotWritten(path, error.strerror) from None
    finally:
        with suppress(OSError):  # it is not there, or what is wrong has been said
            temporary.unlink()


@contextmanager
def making(folder: Path) -> Iterator[Path]:
    """Make a folder under a temporary name that takes the place of ``folder`` when the block ends without an exception.

    Raises
    ------
    ScanstageError
        The folder, or a file in it, cannot be written.
    """
    made = sibling(folder.resolve())
    try:
        made.mkdir(parents=True)
        yield made
        replace_folder(made, folder.resolve())
    except NotWritten as error:  # of a file in it, by a name that is gone
        raise NotWritten(folder, error.reason) from None
    except OSError as error:
        raise NotWritten(folder, error.strerror) from None
    finally:
        shutil.rmtree(made, ignore_errors=True)


def check_room(folder: Path) -> None:
    """Refuse a folder whose disk is full: what was written there by a program that does not look at errors may be cut off.

    Raises
    ------
    OSError
        The disk takes nothing more.
    """
    with tempfile.TemporaryFile(dir=folder) as file:
        file.write(bytes(_ROOM))
        file.flush()
        os.fsync(file.fileno())


def replace_folder(made: Path, folder: Path) -> None:
    """Give a finished folder its name; what has that name goes, once the new one has it.

    Raises
    ------
    OSError
        The disk refuses; what was there is there still.
    """
    if not folder.exists():
        os.rename(made, folder)
        return
    if _exchanged(made, folder):  # there is no moment at which nothing has the name
        shutil.rmtree(made, ignore_errors=True)
        return
    old = sibling(folder)
    os.rename(folder, old)
    try:
        os.rename(made, folder)
    except OSError:
        os.rename(old, folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _exchanged(one: Path, other: Path) -> bool:
    """Let two folders swap their names in one step, and return whether the system and its disk can."""
    if sys.platform != "linux":
        return False
    exchange = getattr(ctypes.CDLL(None), "renameat2", None)  # since glibc 2.28
    here, swap = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
    return exchange is not None and exchange(here, os.fsencode(one), here, os.fsencode(other), swap) == 0
