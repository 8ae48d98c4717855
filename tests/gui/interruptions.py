# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Interrupts the long work in a real window, in every way that a user can; see `scripts/walking.py`."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
from walking import OUT, begin, found, job, open_tab, press, tell, view  # noqa: E402 - the folder is only known now

VIEWS = 10


def walk() -> Iterator[float]:
    """Stop by Esc and by the cross, load a file and a new one, undo, save, move the rig, and quit: each during a job."""
    found["views"] = VIEWS
    yield from open_tab()
    yield from _stage("first")
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "first.blend"))
    yield from _esc_during_capture()
    yield from _esc_during_reconstruction()
    yield from _loading("load")
    yield from _loading("new")
    yield from _undo()
    yield from _moving()
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "quit.blend"))
    yield from _stage("quit")
    yield from _started("capture", frames=2)
    tell()
    bpy.ops.wm.quit_blender()
    yield 600


def _stage(folder: str) -> Iterator[float]:
    settings = bpy.context.scene.scanstage
    rig = settings.preset_turntable
    rig.views, rig.resolution_x, rig.resolution_y = VIEWS, 160, 120
    settings.builtin, settings.capture_folder, settings.result_folder = "knot", str(OUT / folder / "capture"), str(OUT / folder / "result")
    press("stage")
    yield 0.3


def _started(name: str, *, frames: int = 0) -> Iterator[float]:
    press(name)
    while job().running and len(_pictures()) < frames:
        yield 0.05
    found[f"{name} runs"] = job().running
    yield 0.05


def _finished() -> Iterator[float]:
    while job().running:
        yield 0.1


def _pictures() -> list[Path]:
    return sorted((Path(bpy.context.scene.scanstage.capture_folder) / "images").glob("[0-9]*.png"))


def _esc() -> None:
    window = view()["window"]
    for value in ('PRESS', 'RELEASE'):
        window.event_simulate('ESC', value, x=window.width // 3, y=window.height // 2)


def _esc_during_capture() -> Iterator[float]:
    scene = bpy.context.scene
    scene.frame_set(5)
    path = scene.render.filepath
    yield from _started("capture", frames=3)
    try:
        bpy.ops.scanstage.reconstruct()
    except RuntimeError as error:
        found["second start"] = str(error)
    _esc()
    yield from _finished()
    found["esc in capture"] = {"captured": len(_pictures()), "state": scene.scanstage.capture_state,
                               "scene as before": scene.frame_current == 5 and scene.render.filepath == path}
    yield from _started("capture", frames=len(_pictures()) + 1)
    press("stop")
    yield from _finished()
    found["cross in capture"] = len(_pictures())
    press("capture")
    yield from _finished()
    found["capture goes on"] = len(_pictures())


def _esc_during_reconstruction() -> Iterator[float]:
    settings = bpy.context.scene.scanstage
    settings.voxels = 512
    yield from _started("reconstruct")
    yield 0.5
    _esc()
    yield from _finished()
    home = Path(settings.result_folder).parent
    found["esc in reconstruction"] = sorted(path.name for path in home.iterdir())
    settings.voxels = 32
    press("reconstruct")
    yield from _finished()
    found["reconstruction after it"] = "Result" in bpy.data.objects


def _loading(way: str) -> Iterator[float]:
    """Load a file, or begin a new one, during a capture and then during a reconstruction; save during the capture."""
    yield from _stage(way)
    yield from _started("capture", frames=2)
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT / "saved-at-work.blend"), copy=True)
    yield from _load(way)
    found[f"{way} in capture"] = {"running": job().running, "stage": "Scanstage" in bpy.data.collections}
    bpy.ops.wm.open_mainfile(filepath=str(OUT / "saved-at-work.blend"))
    yield 1.0
    found[f"{way}: saved at work"] = {"running": job().running, "can go on": bpy.ops.scanstage.capture.poll()}
    press("capture")
    yield from _finished()
    found[f"{way}: went on"] = len(_pictures())
    bpy.context.scene.scanstage.voxels = 512
    yield from _started("reconstruct")
    yield 0.3
    yield from _load(way)
    found[f"{way} in reconstruction"] = {"running": job().running, "left": sorted(path.name for path in (OUT / way).iterdir())}


def _load(way: str) -> Iterator[float]:
    if way == "load":
        bpy.ops.wm.open_mainfile(filepath=str(OUT / "first.blend"))
    else:
        bpy.ops.wm.read_homefile()
    yield 1.0


def _undo() -> Iterator[float]:
    yield from open_tab()
    yield from _stage("undo")
    bpy.ops.ed.undo_push(message="staged")
    bpy.context.scene.scanstage.builtin = "pot"
    bpy.ops.ed.undo_push(message="changed")
    yield from _started("capture", frames=2)
    with bpy.context.temp_override(**view()):
        bpy.ops.ed.undo()
    yield from _finished()
    found["undo in capture"] = {"captured": len(_pictures()), "running": job().running}


def _moving() -> Iterator[float]:
    yield from _stage("moving")
    yield from _started("capture", frames=2)
    bpy.context.scene.camera.location.x += 0.01
    yield from _finished()
    found["rig moved in capture"] = len(_pictures())


begin(walk)
