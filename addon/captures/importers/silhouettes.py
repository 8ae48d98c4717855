# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes that lie in a folder, one for each picture under the picture's name: masks, or outlines as text."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...errors import ScanstageError
from ..contour_file import SUFFIX, read_contours
from ..picture_format import SUFFIXES
from .sources import Import, checked_size, find_below


def with_masks(found: Import, folder: Path) -> Import:
    """Return the set with the silhouettes of a folder, which take the place of what the source itself gives.

    A picture's silhouette is the file of its name, whatever its ending, or that with an ending more: ``a.png``, ``a.txt`` or
    ``a.jpg.png`` for ``a.jpg``.

    Raises
    ------
    ScanstageError
        There is no such folder, a picture of the object has none there, or one cannot be used.
    """
    if not folder.is_dir():
        raise ScanstageError(f"option masks: {folder} is no folder; give the one that holds the silhouettes")
    found = replace(found, capture=replace(found.capture, silhouette={}))  # a recipe for pictures without masks
    return _joined(found, folder, (*SUFFIXES, SUFFIX), required=True)


def with_outlines(found: Import, folder: Path) -> Import:
    """Return the set with the outlines that a folder holds for any of its pictures.

    Raises
    ------
    ScanstageError
        One cannot be used.
    """
    return _joined(found, folder, (SUFFIX,), required=False)


def _joined(found: Import, folder: Path, endings: tuple[str, ...], *, required: bool) -> Import:
    frames, pictures = [], dict(found.pictures)
    for frame in found.capture.frames:
        picture = found.pictures[frame.image]
        if frame.board_pose is None and frame.pattern is None:
            given = find_below(folder, picture.stem, picture.name, endings) or find_below(folder, picture.name, picture.name, endings)
            if given is not None:
                field = _checked(given, found.capture.cameras[frame.camera].size)
                relative = f"given/{frame.id}{given.suffix.lower()}"
                frame = replace(frame, **{"mask": None, "contours": None, field: relative})
                pictures[relative] = given
            elif required:
                raise ScanstageError(f"{picture.name}: no file of {folder} has its name; put its mask there")
        frames.append(frame)
    named = {relative for frame in frames for relative in (frame.image, frame.mask, frame.contours)}
    return Import(replace(found.capture, frames=tuple(frames)), {name: path for name, path in pictures.items() if name in named})


def _checked(given: Path, size: tuple[int, int]) -> str:
    """Return which field of a frame the file is for, if it is what it must be."""
    if given.suffix.lower() == SUFFIX:
        read_contours(given)
        return "contours"
    if (own := checked_size(given, given.name)) != size:
        raise ScanstageError(f"{given.name}: is {own[0]}x{own[1]} pixels, its picture {size[0]}x{size[1]}; give the mask that belongs to "
                             "it")
    return "mask"
