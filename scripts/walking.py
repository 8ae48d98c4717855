# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the walks through a real window share: they run inside that Blender, started by `photograph_window.photograph`.

A walk is a generator that yields the seconds which the window needs before the next step. In the end the folder after ``--`` holds
``walk.json``: what was `found`, or the ``error`` that ended the walk.
"""

import json
import os
import shutil
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

OUT = Path(sys.argv[sys.argv.index("--") + 1]).resolve()
DRAWN = 0.7  # seconds in which every region has been drawn again
found: dict[str, object] = {}


def begin(walk: Callable[[], Iterator[float]]) -> None:
    """Start a walk once the window is there."""
    bpy.context.preferences.view.show_splash = False
    steps = walk()
    bpy.app.timers.register(lambda: _tick(steps), first_interval=2.0, persistent=True)


def open_tab() -> Iterator[float]:
    """Open the sidebar at Scanstage's tab."""
    area = view()["area"]
    area.spaces.active.show_region_ui = True
    yield DRAWN
    next(region for region in area.regions if region.type == 'UI').active_panel_category = "Scanstage"


def view() -> dict:
    """Return what `bpy.context.temp_override` needs to act as if the 3-D view was clicked in."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == 'VIEW_3D')
    return {"window": window, "area": area, "region": next(region for region in area.regions if region.type == 'WINDOW')}


def press(name: str) -> None:
    """Press a button of Scanstage's."""
    with bpy.context.temp_override(**view()):
        getattr(bpy.ops.scanstage, name)('INVOKE_DEFAULT')


def job() -> bpy.types.PropertyGroup:
    """Return what Blender knows of the running job."""
    return bpy.context.window_manager.scanstage_job


def look(name: str) -> Iterator[float]:
    """Have everything drawn, and photograph the window."""
    for area in view()["window"].screen.areas:
        for region in area.regions:
            region.tag_redraw()
    yield DRAWN
    picture = str(OUT / f"{name}.png")
    if shutil.which("import"):  # ImageMagick's: of a window drawn by software, Blender's own screenshot is black
        subprocess.run(["import", "-window", "root", "-resize", "1280x>", "+dither", "-colors", "160", "-depth", "8", picture], check=True)
        return
    with bpy.context.temp_override(**view()):
        bpy.ops.screen.screenshot(filepath=picture)


def tell() -> None:
    """Write what was found, as it is known by now."""
    (OUT / "walk.json").write_text(json.dumps(found, indent=1), encoding="utf-8")


def _end() -> None:
    tell()
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
