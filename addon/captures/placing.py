# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A new capture set made of pictures from elsewhere: it appears whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from functools import partial
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
                 extra: Mapping[str, bytes] | None = None, made: Mapping[str, Callable[[Path], None]] | None = None) -> None:
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
    made : mapping of str to callable, optional
        Those that are too large to be held until then: what writes each to the path that it is given.

    Raises
    ------
    ScanstageError
        The disk refuses.
    """
    with making(out) as staged:
        makers = {**{relative: partial(shutil.copyfile, picture) for relative, picture in pictures.items()}, **(made or {})}
        for step, (relative, make) in enumerate(makers.items()):
            progress(step / len(makers), f"Writing {relative}")
            target = staged / relative
            target.parent.mkdir(parents=True, exist_ok=True)
            make(target)
        for relative, data in (extra or {}).items():
            write_bytes(staged / relative, data)
        write_capture(staged, capture)
    progress(1.0, f"{len(makers)} pictures in place")
