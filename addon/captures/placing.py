# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A new capture set made of pictures from elsewhere: it appears whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

from ..errors import ScanstageError
from ..files import making
from ..progress import Progress
from .files import write_bytes
from .schema import Capture
from .store import is_capture, write_capture


def check_place(source: Path, out: Path) -> None:
    """Refuse a place that holds something else than a capture set, or the source itself.

    Raises
    ------
    ScanstageError
        It does.
    """
    if out.exists() and not out.is_dir():
        raise ScanstageError(f"{out}: is a file; give the name of a folder to make")
    if out.is_dir() and any(out.iterdir()):
        if not is_capture(out):
            raise ScanstageError(f"{out}: holds files that are no capture set; give an empty or a new folder")
        if source.resolve().is_relative_to(out.resolve()):
            raise ScanstageError(f"{out}: holds the source and would be replaced; give another folder")


def put_in_place(capture: Capture, pictures: Mapping[str, Path], out: Path, progress: Progress, *,
                 extra: Mapping[str, bytes] | None = None) -> None:
    """Write a set beside ``out`` and then give it that name; a set that is there is replaced.

    Parameters
    ----------
    capture : Capture
    pictures : mapping of str to Path
        Where each file of the set, by its path in it, is now.
    out : Path
    progress : Progress
    extra : mapping of str to bytes, optional
        Files to be written into the set, by their paths in it.

    Raises
    ------
    ScanstageError
        The disk refuses.
    """
    with making(out) as staged:
        for step, (relative, picture) in enumerate(pictures.items()):
            progress(step / len(pictures), f"Copying {picture.name}")
            target = staged / relative
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(picture, target)
        for relative, data in (extra or {}).items():
            write_bytes(staged / relative, data)
        write_capture(staged, capture)
    progress(1.0, f"{len(pictures)} pictures in place")
