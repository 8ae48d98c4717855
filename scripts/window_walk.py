# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Walks from the stage to the comparison in a real window, looks at each step, and photographs it.

`scripts/photograph_window.py` has Blender run this, with the folder for the pictures after ``--``. In the end that folder
holds ``walk.json``: what was found in the scene after each step, or the ``error`` that ended the walk.
"""

import json
import os
import shutil
import subprocess
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

import bpy

OUT = Path(sys.argv[sys.argv.index("--") + 1]).resolve()
DRAWN = 0.7  # seconds in which every region has been drawn again
found: dict[str, object] = {}


def walk() -> Iterator[float]:
    """Take the steps; yield the seconds that the window needs before the next one."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == 'VIEW_3D')
    area.spaces.active.show_region_ui = True
    yield DRAWN
    next(region for region in area.regions if region.type == 'UI').active_panel_category = "Scanstage"
    view = {"window": window, "area": area, "region": next(region for region in area.regions if region.type == 'WINDOW')}
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "walk.blend"))
    settings = bpy.context.scene.scanstage
    yield from _look(view, "0-nothing")
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
    bpy.data.objects["Cube"].hide_set(True)  # ten times as large as what is scanned
    for number, name in enumerate(("stage", "test_frame", "capture", "reconstruct", "evaluate"), 1):
        with bpy.context.temp_override(**view):
            getattr(bpy.ops.scanstage, name)('INVOKE_DEFAULT')
            job = bpy.context.window_manager.scanstage_job
            if job.running:
                found[f"{name} refuses a second start"] = not bpy.ops.scanstage.capture.poll()
        while job.running:
            yield 0.1
        yield from _look(view, f"{number}-{name.replace('_', '-')}")
        found[name] = {"objects": sorted(bpy.context.scene.objects.keys()), "captures": settings.capture_state,
                       "result": settings.result_lines, "measured": bool(settings.measures)}
    with bpy.context.temp_override(**view):
        bpy.ops.scanstage.remove_stage()
    yield from _look(view, "6-removed")
    found["removed"] = {"objects": sorted(bpy.context.scene.objects.keys())}
    with bpy.context.temp_override(**view):
        bpy.ops.wm.call_panel(name="SCANSTAGE_PT_gallery")
    yield from _look(view, "7-gallery")


def _look(view: dict, name: str) -> Iterator[float]:
    """Have everything drawn, and photograph the window."""
    for area in view["window"].screen.areas:
        for region in area.regions:
            region.tag_redraw()
    yield DRAWN
    picture = str(OUT / f"{name}.png")
    if shutil.which("import"):  # ImageMagick's: of a window drawn by software, Blender's own screenshot is black
        subprocess.run(["import", "-window", "root", "-resize", "1280x>", picture], check=True)
        return
    with bpy.context.temp_override(**view):
        bpy.ops.screen.screenshot(filepath=picture)


def _end() -> None:
    (OUT / "walk.json").write_text(json.dumps(found, indent=1), encoding="utf-8")
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _tick(steps: Iterator[float]) -> float | None:
    try:
        return next(steps)
    except StopIteration:
        _end()
    except Exception as error:  # noqa: BLE001 - whoever started the walk reads it
        traceback.print_exc()
        found["error"] = str(error)
        _end()


bpy.context.preferences.view.show_splash = False
_steps = walk()
bpy.app.timers.register(lambda: _tick(_steps), first_interval=2.0, persistent=True)
