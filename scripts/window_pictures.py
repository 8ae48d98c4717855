# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes the README's pictures of the window; see `walking`."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from walking import begin, job, look, open_tab, press, view  # noqa: E402 - the folder is only known now

SHADERS = 20.0  # seconds in which they are made, without a graphics card


def walk() -> Iterator[float]:
    """A projector's stage, a shadow array at work, and what came of it."""
    yield from open_tab()
    settings = bpy.context.scene.scanstage
    settings.preset, settings.builtin = "gray-code", "monkey"
    settings.preset_gray_code.views = 8
    press("stage")
    bpy.context.scene.frame_set(7)
    yield 2.0
    yield from look("window_stage")

    settings.preset, settings.builtin, settings.method, settings.voxels = "shadow-array", "pot", "shadow-carving", 128
    rig = settings.preset_shadow_array
    rig.views, rig.elevations, rig.resolution_x, rig.resolution_y = 8, "25,60", 320, 240
    press("stage")
    shading = view()["area"].spaces.active.shading
    shading.type, shading.use_scene_lights, shading.use_scene_world = 'MATERIAL', True, True
    bpy.context.scene.frame_set(2)
    yield SHADERS
    press("capture")
    while job().running and job().fraction < 0.3:
        yield 0.1
    yield from look("window_scan")
    while job().running:
        yield 0.1

    shading.use_scene_lights = shading.use_scene_world = False
    bpy.context.window_manager.scanstage_view.overlays = False
    for name in ("reconstruct", "evaluate"):
        press(name)
        while job().running:
            yield 0.1
    yield SHADERS
    sidebar = next(region for region in view()["area"].regions if region.type == 'UI')
    with bpy.context.temp_override(**{**view(), "region": sidebar}):
        for _ in range(40):
            bpy.ops.view2d.scroll_down(deltay=100)
    yield from look("window_result")


begin(walk)
