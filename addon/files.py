# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import ScanstageError


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
        raise ScanstageError(f"{path}: cannot be written ({error.strerror}); check the disk space and the rights of "
                             f"{path.parent}") from None
    finally:
        with suppress(OSError):  # it is not there, or what is wrong has been said
            temporary.unlink()
