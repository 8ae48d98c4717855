# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole .blend files, for scripts: a new one, opening one, saving one."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np

from ..errors import ScanstageError
from ..files import NotWritten, check_room, sibling
from ..stage.extents import corners_of


def new_file() -> None:
    """Begin with an empty scene in metres, whose view shows captured colours as they are."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.view_settings.view_transform = 'Standard'


def open_blend(path: Path) -> None:
    """Open a .blend file.

    Raises
    ------
    ScanstageError
        There is no such file, or Blender cannot read it.
    """
    path = Path(path)
    if not path.is_file():
        raise ScanstageError(f"{path}: there is no such file; make one with `scanstage stage PRESET --out {path}`")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False)
    except RuntimeError as error:
        raise ScanstageError(f"{path}: Blender cannot open it ({reason_of(error)}); stage it again") from None


def frame_scene(scene: bpy.types.Scene) -> None:
    """Let the file's 3-D views begin with all of a scene before them, in its colours: what is staged is small beside Blender's own view."""
    for layer in scene.view_layers:
        layer.update()  # what was placed since the last update still has its old matrix
    points = corners_of(scene.objects)
    if not len(points):
        return
    lower, upper = points.min(axis=0), points.max(axis=0)
    for screen in bpy.data.screens:
        for area in screen.areas:
            if area.type == 'VIEW_3D':
                view = area.spaces.active
                view.region_3d.view_location = (lower + upper) / 2
                view.region_3d.view_distance = max(float(np.linalg.norm(upper - lower)), 1e-3)
                view.shading.type = 'MATERIAL'


def save_blend(path: Path) -> None:
    """Save the open scene, whole or not at all, with paths relative to the file.

    Raises
    ------
    ScanstageError
        The name does not end in .blend, or the file cannot be written.
    """
    path = Path(path).resolve()
    if path.suffix != ".blend":
        raise ScanstageError(f"{path}: a scene is saved as .blend; change the file's ending")
    temporary = Path(f"{sibling(path)}.blend")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=True)
        check_room(path.parent)
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:
        raise NotWritten(path, reason_of(error)) from None
    finally:
        with suppress(OSError):  # it is not there, or what is wrong has been said
            temporary.unlink()


def reason_of(error: OSError | RuntimeError) -> str:
    """Return what went wrong without the file's name, which may be a temporary one, on one line."""
    lines = str(error).split("\nLocation:")[0].strip().splitlines()  # of an operator that is Python's the last tells, of others all do
    told = lines[-1:] if any("Traceback" in line for line in lines) else lines
    return getattr(error, "strerror", None) or " ".join(" ".join(told).split()).rsplit(": ", 1)[-1]
