# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The button that runs a method, and those that show and export what it made."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from bpy.props import StringProperty
from bpy_extras.io_utils import ExportHelper

from ... import workflow
from ...errors import ScanstageError
from ...reconstruction.methods import COMMON_COUNTS, METHODS
from ...results import folder as results
from ...results.booleans import solver
from ...results.export import FORMATS, export_result
from ...results.pictures import picture_files, show_pictures
from ...results.present import show_result, shown_beside
from ..jobs import Job, MainThread, idle, in_thread
from ..probability import start_at_threshold
from ..properties import changed_values, field_name, values_of
from ..viewport import frame_shown, show_colors, show_image
from .requirements import capture_folder, has_captures, has_result, result_folder

_INPUT_SETTINGS = {"silhouettes": "silhouettes", "lights": "shadows"}  # by what a method needs: the settings of how it is found


class SCANSTAGE_OT_reconstruct(Job, bpy.types.Operator):
    """Run the method on the captures and put the resulting mesh beside the object"""

    bl_idname = "scanstage.reconstruct"
    bl_label = "Reconstruct"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_captures(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        scene, settings = context.scene, context.scene.scanstage
        out, method = result_folder(context.scene), METHODS[settings.method]
        options = values_of(getattr(settings, field_name("method", method.name)), method.options)
        for need in workflow.INPUT_OPTIONS.keys() & set(method.needs):
            options |= changed_values(getattr(settings, _INPUT_SETTINGS[need]), workflow.INPUT_OPTIONS[need])
        bounds = np.array([settings.bounds_lower, settings.bounds_upper]) if settings.use_bounds else None
        main = MainThread()
        report = yield from in_thread(workflow.reconstruct, capture_folder(context.scene), method.name, out, main=main,
                                      voxels=settings.voxels, bounds=bounds, options=options, solids=solver(main.calling))
        found = yield from in_thread(_read, out)
        show_result(scene, found, smooth=settings.smooth)
        start_at_threshold(settings, found)
        settings.result_lines, settings.measures = "\n".join(summary(report)), ""

    def show(self, context: bpy.types.Context) -> None:
        show_colors(context)
        frame_shown(context, shown_beside(context.scene))


class SCANSTAGE_OT_show_result(bpy.types.Operator):
    """Put the result on disk into the scene again, with the current display options"""

    bl_idname = "scanstage.show_result"
    bl_label = "Show Result"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_result(cls, context) and idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.scanstage
        try:
            found = results.read_result(result_folder(context.scene))
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        show_result(context.scene, found, smooth=settings.smooth)
        start_at_threshold(settings, found)
        settings.result_lines = "\n".join(summary(found.report))
        return {'FINISHED'}


class SCANSTAGE_OT_show_pictures(bpy.types.Operator):
    """Load the pictures that the method made, to be looked at in the Image Editor"""

    bl_idname = "scanstage.show_pictures"
    bl_label = "Show Pictures"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not has_result(cls, context):
            return False
        if not picture_files(result_folder(context.scene)):
            cls.poll_message_set("The method of this result makes no pictures")
            return False
        return idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            images = show_pictures(result_folder(context.scene))
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        show_image(context, images[0])
        self.report({'INFO'}, f"{len(images)} pictures, for the Image Editor: {', '.join(image.name for image in images)}"[:400])
        return {'FINISHED'}


class SCANSTAGE_OT_export(ExportHelper, bpy.types.Operator):
    """Write the result's mesh or voxels as a file for other programs; its ending chooses the format"""

    bl_idname = "scanstage.export_mesh"
    bl_label = "Export Mesh"

    filename_ext = ""
    check_extension = None  # the name's own ending chooses the format
    filter_glob: StringProperty(default=";".join(f"*{ending}" for ending in FORMATS), options={'HIDDEN'})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_result(cls, context) and idle(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the name, with a sensible one proposed."""
        self.filepath = "result.ply"
        return ExportHelper.invoke(self, context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.scanstage
        try:
            faces = export_result(result_folder(context.scene), Path(self.filepath), {"smooth": settings.smooth})
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        self.report({'INFO'}, f"{faces} faces in {self.filepath}")
        return {'FINISHED'}


_EFFORT = ("tests", "tests_dense")  # counts of the work, not of the result: the report has them


def _read(folder: Path, progress) -> results.Result:
    progress(0.95, "Reading the result")
    return results.read_result(folder)


def summary(report: dict) -> list[str]:
    """Return what a panel shows of a reconstruction, one fact a line."""
    counts, iou = report["counts"], report["silhouette_iou"]["mean"]
    lines = [f"{counts['occupied']:,} voxels, {counts['quads']:,} faces", f"{sum(report['seconds'].values()):.1f} s"]
    lines += [f"{name.replace('_', ' ').capitalize()}: {count:,}" for name, count in counts.items()
              if name not in (*COMMON_COUNTS, *_EFFORT)]
    return lines + ([f"Silhouettes match to {100 * iou:.1f} %"] if iou else []) + [f"! {w}" for w in report["warnings"]]


CLASSES = (SCANSTAGE_OT_reconstruct, SCANSTAGE_OT_show_result, SCANSTAGE_OT_show_pictures, SCANSTAGE_OT_export)
