# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The button Calibrate: what it asks of a capture set, and says of the calibration."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import bpy

from ..calibration import calibrate
from ..captures.schema import FILE_NAME
from ..captures.store import read_capture
from ..errors import ScanstageError
from .jobs import Job, idle, in_thread
from .operators.requirements import capture_folder


class SCANSTAGE_OT_calibrate(Job, bpy.types.Operator):
    """Calibrate the devices from the frames of the board, into a new capture set beside this one"""

    bl_idname = "scanstage.calibrate"
    bl_label = "Calibrate"
    bl_options = {'REGISTER'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not shows_board(capture_folder(context.scene)):
            cls.poll_message_set("Capture or import frames that show a calibration board first")
            return False
        return idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        folder = capture_folder(context.scene)
        out = calibrated_folder(folder)
        report = yield from in_thread(calibrate, folder, out)
        lines = calibration_lines(out, report)
        context.scene.scanstage.calibration_lines = "\n".join(lines)
        for line in lines:
            self.report({'WARNING' if line.startswith("! ") else 'INFO'}, line.removeprefix("! "))


def calibrated_folder(capture: Path) -> Path:
    """Return where the calibrated set goes: beside the set that it is made of."""
    return capture.with_name(f"{capture.name}-calibrated")


def shows_board(capture: Path) -> bool:
    """Return whether a capture set has frames of the calibration board. Panels ask at every redraw: it is read when it changes."""
    try:
        return _shows_board(capture, (capture / FILE_NAME).stat().st_mtime_ns)
    except OSError:
        return False


def calibration_lines(folder: Path, report: dict) -> list[str]:
    """Return what a panel shows of a calibration, one fact a line."""
    lines = [f"{name.capitalize()}: RMS {device['rms']:.3f} px in {len(device['views'])} poses"
             for name, device in report["devices"].items()]
    return [*lines, f"In {folder}", *(f"! {warning}" for warning in report["warnings"])]


@lru_cache(maxsize=1)
def _shows_board(capture: Path, changed: int) -> bool:
    """Return it of the set that was ``changed`` then."""
    try:
        return any(frame.board_pose is not None for frame in read_capture(capture, require_pictures=False).frames)
    except ScanstageError:
        return False


register, unregister = bpy.utils.register_classes_factory((SCANSTAGE_OT_calibrate,))
