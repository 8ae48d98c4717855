# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The button that compares a result with the truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import bpy
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper

from ... import workflow
from ...errors import ScanstageError
from ...results import folder as results
from ...results.page import write_page
from ...results.present import face_errors, show_comparison
from ..jobs import Job, idle, in_thread
from ..viewport import frame_shown, show_colors
from .requirements import has_result, result_folder


class SCANSTAGE_OT_evaluate(Job, bpy.types.Operator):
    """Compare the result with the true object, and lay truth, result and error side by side"""

    bl_idname = "scanstage.evaluate"
    bl_label = "Evaluate"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_result(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        scene, settings = context.scene, context.scene.scanstage
        folder = result_folder(context.scene)
        measures = yield from in_thread(workflow.evaluate_result, folder)
        found, truth, errors = yield from in_thread(_compare, folder)
        self._row = show_comparison(scene, found, truth, errors)
        settings.measures = json.dumps(measures)

    def show(self, context: bpy.types.Context) -> None:
        show_colors(context)
        frame_shown(context, self._row.objects, from_front=True)


def _compare(folder: Path, progress):
    """Return what `show_comparison` takes, computed away from Blender."""
    found = results.read_result(folder)
    truth = workflow.truth_of(found)
    progress(0.97, "Measuring the error of every face")
    return found, truth, face_errors(found, truth)


class SCANSTAGE_OT_report_page(bpy.types.Operator, ExportHelper):
    """Write all that the result says, with its pictures, as one page for any browser; it needs no network"""

    bl_idname = "scanstage.report_page"
    bl_label = "Write Report Page"
    filename_ext = ".html"
    filter_glob: StringProperty(default="*.html", options={'HIDDEN'})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_result(cls, context) and idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            write_page(result_folder(context.scene), Path(self.filepath))
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        self.report({'INFO'}, f"Report in {self.filepath}")
        return {'FINISHED'}


CLASSES = (SCANSTAGE_OT_evaluate, SCANSTAGE_OT_report_page)
