# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What buttons ask before they can be pressed: where the captures and the result are, and whether they are there."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...captures.schema import FILE_NAME
from ...results import folder as results
from ...stage import ownership


def capture_folder(scene: bpy.types.Scene) -> Path:
    """Return where the panel says the captures are."""
    return _folder(scene.scanstage.capture_folder, "capture")


def result_folder(scene: bpy.types.Scene) -> Path:
    """Return where the panel says the result is."""
    return _folder(scene.scanstage.result_folder, "result")


def _folder(path: str, name: str) -> Path:
    if path and (bpy.data.filepath or not path.startswith("//")):
        return Path(bpy.path.abspath(path))
    return Path(bpy.data.filepath).parent / "scanstage" / name if bpy.data.filepath else Path(bpy.app.tempdir) / "scanstage" / name


def has_stage(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Return whether a rig stands in the scene; otherwise say so as the reason why the button is greyed out."""
    if ownership.find_stage(context.scene) is None:
        cls.poll_message_set("Build a stage first")
        return False
    return True


def has_captures(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Return whether there is a capture set; otherwise say so as the reason why the button is greyed out."""
    if not (capture_folder(context.scene) / FILE_NAME).is_file():
        cls.poll_message_set("Capture or import pictures first")
        return False
    return True


def has_result(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """Return whether there is a result; otherwise say so as the reason why the button is greyed out."""
    if not (result_folder(context.scene) / results.REPORT).is_file():
        cls.poll_message_set("Reconstruct first")
        return False
    return True


def is_older(scene: bpy.types.Scene) -> bool:
    """Return whether pictures were captured after the result was made from them."""
    pictures, result = capture_folder(scene) / "images", result_folder(scene) / results.VOLUME
    try:
        return result.stat().st_mtime < pictures.stat().st_mtime
    except OSError:
        return False  # one of the two is not there
