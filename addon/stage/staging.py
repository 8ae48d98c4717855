# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds a preset's stage in a scene, in place of the one that is there, and removes it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy

from ..errors import ScanstageError
from ..options import Value, resolve
from . import ownership, scene_settings
from .objects import find_subject
from .presets import PRESETS
from .readback import staged_objects


def build(scene: bpy.types.Scene, preset_name: str, subject: str | Path | bpy.types.Object | Sequence[bpy.types.Object],
          options: Mapping[str, Value]) -> bpy.types.Collection:
    """Build a stage round an object. A stage that the scene has already is replaced.

    Parameters
    ----------
    scene : bpy.types.Scene
        The context's scene, in Object Mode.
    preset_name : str
        A name of `addon.stage.presets.PRESETS`.
    subject : str, Path, bpy.types.Object or sequence of bpy.types.Object
        The name of a built-in object or of an object in the scene, a file, or an object itself, or several.
    options : mapping
        The preset's options; text is parsed as a user's.

    Returns
    -------
    bpy.types.Collection
        The stage.

    Raises
    ------
    ScanstageError
        The preset, an option or the object cannot be used; what could be told beforehand leaves the scene as it is,
        anything later leaves it without a stage.
    """
    if scene != bpy.context.scene:
        raise ValueError("the stage can only be built in the context's scene")
    if bpy.context.mode != "OBJECT":
        raise ScanstageError("the stage cannot be built while an object is edited: switch to Object Mode")
    if preset_name not in PRESETS:
        raise ScanstageError(f"there is no preset {preset_name!r}; the presets are: {', '.join(PRESETS)}")
    preset = PRESETS[preset_name]
    values = resolve(preset.options, options, f"preset {preset_name}")
    found = find_subject(scene, subject)
    ownership.remove_stage(scene)
    stage = ownership.create_stage(scene, preset_name, values)
    try:
        scene_settings.apply(scene, {**scene_settings.capture_settings(scene), **scene_settings.STAGE_DEFAULTS})
        preset.build(scene, stage, found, values)
        ownership.hide_from_render(scene, stage, staged_objects(scene))
    except BaseException:
        ownership.remove_stage(scene)
        raise
    scene.frame_set(scene.frame_start)
    if not found.existing:
        ownership.hide_in_the_way(stage, staged_objects(scene))
    return stage


def remove(scene: bpy.types.Scene) -> None:
    """Remove the scene's stage, if it has one: the user's objects and settings are as they were before it."""
    ownership.remove_stage(scene)
    scene.frame_set(scene.frame_current)
