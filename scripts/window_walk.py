# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Walks from the stage to the comparison in a real window, looks at each step, and photographs it; see `walking`."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from walking import DRAWN, OUT, begin, found, job, look, open_tab, press, view  # noqa: E402 - the folder is only known now


def walk() -> Iterator[float]:
    """Take the steps; yield the seconds that the window needs before the next one."""
    yield from open_tab()
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "walk.blend"))
    settings = bpy.context.scene.scanstage
    yield from look("0-nothing")
    for name in ("laser-scanner", "voxel-coloring", "calibration", "turntable"):
        settings.preset = name
        yield DRAWN / 2
    for method in settings.bl_rna.properties["method"].enum_items.keys():
        settings.method = method
        yield DRAWN / 2
    settings.method, settings.builtin = "visual-hull", "knot"
    rig = settings.preset_turntable
    rig.views, rig.resolution_x, rig.resolution_y = 6, 160, 120
    settings.voxels = 48
    bpy.ops.object.select_all(action='DESELECT')
    for number, name in enumerate(("stage", "test_frame", "capture", "reconstruct", "evaluate"), 1):
        press(name)
        if job().running:
            found[f"{name} refuses a second start"] = not bpy.ops.scanstage.capture.poll()
        while job().running:
            yield 0.1
        yield from look(f"{number}-{name.replace('_', '-')}")
        found[name] = {"objects": sorted(bpy.context.scene.objects.keys()), "captures": settings.capture_state,
                       "result": settings.result_lines, "measured": bool(settings.measures)}
    with bpy.context.temp_override(**view()):
        bpy.ops.scanstage.remove_stage()
    yield from look("6-removed")
    found["removed"] = {"objects": sorted(bpy.context.scene.objects.keys())}
    with bpy.context.temp_override(**view()):
        bpy.ops.wm.call_panel(name="SCANSTAGE_PT_gallery")
    yield from look("7-gallery")


begin(walk)
