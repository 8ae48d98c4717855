# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of a result in Blender: virtual light images, decoded maps, and whatever else a method has to show."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..errors import ScanstageError
from .folder import PICTURES


def picture_files(folder: Path) -> list[Path]:
    """Return the pictures in a result folder, by name."""
    return sorted((folder / PICTURES).glob("*.png"))


def show_pictures(folder: Path) -> list[bpy.types.Image]:
    """Load the pictures of a result as images named like their files; those that are loaded already are read again.

    Raises
    ------
    ScanstageError
        There are none, or one cannot be read.
    """
    files = picture_files(folder)
    if not files:
        raise ScanstageError(f"{folder / PICTURES}: there are no pictures; reconstruct with a method that makes some")
    return [_load(path) for path in files]


def _load(path: Path) -> bpy.types.Image:
    known = {image.session_uid for image in bpy.data.images}
    image = bpy.data.images.load(str(path), check_existing=True)
    image.reload()
    if not all(image.size):
        if image.session_uid not in known:
            bpy.data.images.remove(image)
        raise ScanstageError(f"{path}: cannot be read; reconstruct again")
    if image.session_uid not in known:
        image.name = path.stem
    return image
