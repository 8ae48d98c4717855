# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Render settings for the time of a capture, put back whatever happens."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import bpy

from ..stage import scene_settings
from ..stage.readback import frame_kept


@contextmanager
def capture_settings(scene: bpy.types.Scene, note: str = "") -> Iterator[None]:
    """Apply the capture settings; restore every one of them, the output path, frame and camera when the block ends.

    What the stage has decided (samples, resolution, transparency) stays as the scene has it. ``note`` goes into each file.
    """
    settings = {**scene_settings.capture_settings(scene), "render.stamp_note_text": note}
    before = scene_settings.snapshot(scene, (*settings, "render.filepath"))
    with frame_kept(scene):
        try:
            scene_settings.apply(scene, settings)
            forget_geometry(scene)
            yield
        finally:
            scene_settings.apply(scene, before)


def forget_geometry(scene: bpy.types.Scene) -> None:
    """Let the renderer forget what it kept from earlier renders: 4.5 would show lights that were built since as they were not."""
    persistent = scene.render.use_persistent_data
    scene.render.use_persistent_data = False
    scene.render.use_persistent_data = persistent


@contextmanager
def hidden(objects: Iterable[bpy.types.Object]) -> Iterator[None]:
    """Keep objects out of renders while the block lasts."""
    shown = [o for o in objects if not o.hide_render]
    try:
        for member in shown:
            member.hide_render = True
        yield
    finally:
        for member in shown:
            member.hide_render = False
