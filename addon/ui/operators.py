# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons. Each gathers what the panel set, calls one function of the project, and reports."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from bpy.props import EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from .. import workflow
from ..captures.importers import IMPORTERS, import_capture
from ..captures.scan import load_scan
from ..captures.schema import FILE_NAME
from ..captures.store import read_capture
from ..errors import ScanstageError
from ..reconstruction.methods import COMMON_COUNTS, METHODS
from ..reconstruction.shadows import SHADOW_OPTIONS
from ..reconstruction.silhouettes import SILHOUETTE_OPTIONS
from ..render.capture import capture_frames
from ..results import folder as results
from ..results.booleans import solver
from ..results.export import export_result
from ..results.pictures import picture_files, show_pictures
from ..results.present import face_errors, show_comparison, show_result
from ..stage import ownership, staging
from ..stage.presets import PRESETS
from .jobs import Job, MainThread, idle, in_thread
from .masks import show_masks, show_shadows
from .probability import start_at_threshold
from .properties import changed_values, field_name, values_of
from .viewport import frame_stage, show_colors, show_image

_INPUT_SETTINGS = {"silhouettes": "silhouettes", "lights": "shadows"}  # by what a method needs: the settings of how it is found


def capture_folder(scene: bpy.types.Scene) -> Path:
    """Return where the panel says the captures are."""
    return _folder(scene.scanstage.capture_folder, "capture")


def result_folder(scene: bpy.types.Scene) -> Path:
    """Return where the panel says the result is."""
    return _folder(scene.scanstage.result_folder, "result")


def _folder(path: str, name: str) -> Path:
    if path and (bpy.data.filepath or not path.startswith("//")):
        return Path(bpy.path.abspath(path))
    return Path(bpy.data.filepath).parent / "scanstage" / name if bpy.data.filepath else Path(bpy.app.tempdir) / "scanstage" / name


class SCANSTAGE_OT_stage(bpy.types.Operator):
    """Build the rig round the object, in place of an earlier one"""

    bl_idname = "scanstage.stage"
    bl_label = "Build Stage"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        settings = context.scene.scanstage
        if context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode first")
            return False
        if settings.source == 'SCENE' and settings.subject is None:
            cls.poll_message_set("Choose the object of this scene that is to be scanned")
            return False
        if settings.source == 'FILE' and not settings.file:
            cls.poll_message_set("Choose the file of the object that is to be scanned")
            return False
        return idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.scanstage
        subject = {'BUILTIN': settings.builtin, 'SCENE': settings.subject,
                   'FILE': Path(bpy.path.abspath(settings.file))}[settings.source]
        preset = PRESETS[settings.preset]
        options = values_of(getattr(settings, field_name("preset", preset.name)), preset.options)
        try:
            staging.build(context.scene, preset.name, subject, options)
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        return {'FINISHED'}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Build, and bring the stage into view: it is small beside Blender's default cube."""
        done = self.execute(context)
        if 'FINISHED' in done:
            frame_stage(context)
        return done


class SCANSTAGE_OT_remove_stage(bpy.types.Operator):
    """Take the rig away; your own objects and render settings are as they were before it"""

    bl_idname = "scanstage.remove_stage"
    bl_label = "Remove Stage"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_stage(cls, context) and idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        staging.remove(context.scene)
        return {'FINISHED'}


class SCANSTAGE_OT_capture(Job, bpy.types.Operator):
    """Render every frame of the plan that is not on disk yet"""

    bl_idname = "scanstage.capture"
    bl_label = "Capture"
    bl_options = {'REGISTER'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_stage(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        settings = context.scene.scanstage
        folder = capture_folder(context.scene)
        try:
            yield from capture_frames(context.scene, folder)
        finally:
            settings.capture_state = capture_state(folder)


class SCANSTAGE_OT_import(Job, ImportHelper, bpy.types.Operator):
    """Turn calibrated photographs into a capture set"""

    bl_idname = "scanstage.import_captures"
    bl_label = "Import Captures"
    bl_options = {'REGISTER'}

    format: EnumProperty(name="Format", items=[(name, entry.label, entry.description) for name, entry in IMPORTERS.items()])
    filter_glob: StringProperty(default="*.xml;*.yml;*.yaml;*.json;*.txt", options={'HIDDEN'})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return idle(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file first; `execute` runs the import."""
        self.format = context.scene.scanstage.import_format
        return ImportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        settings = context.scene.scanstage
        folder = capture_folder(context.scene)
        yield from in_thread(import_capture, self.format, Path(self.filepath), folder)
        settings.capture_state = capture_state(folder)


class SCANSTAGE_OT_show_masks(Job, bpy.types.Operator):
    """Extract the silhouettes and show them as the image of each camera; look through the camera and scrub"""

    bl_idname = "scanstage.show_masks"
    bl_label = "Show Silhouettes"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_captures(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        settings = context.scene.scanstage
        folder = capture_folder(context.scene)
        yield from in_thread(load_scan, folder, values_of(settings.silhouettes, SILHOUETTE_OPTIONS))
        show_masks(context.scene, folder)


class SCANSTAGE_OT_show_shadows(Job, bpy.types.Operator):
    """Find the shadows and show them as the image of each camera: white in shadow, black lit, grey undecided"""

    bl_idname = "scanstage.show_shadows"
    bl_label = "Show Shadows"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_captures(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        folder = capture_folder(context.scene)
        yield from in_thread(load_scan, folder, silhouettes=False,
                             shadow_options=values_of(context.scene.scanstage.shadows, SHADOW_OPTIONS))
        show_shadows(context.scene, folder)


class SCANSTAGE_OT_reconstruct(Job, bpy.types.Operator):
    """Run the method on the captures and put the resulting mesh beside the object"""

    bl_idname = "scanstage.reconstruct"
    bl_label = "Reconstruct"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_captures(cls, context) and idle(cls, context)

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


class SCANSTAGE_OT_show_result(bpy.types.Operator):
    """Put the result on disk into the scene again, with the current display options"""

    bl_idname = "scanstage.show_result"
    bl_label = "Show Result"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_result(cls, context) and idle(cls, context)

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
        if not _has_result(cls, context):
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


class SCANSTAGE_OT_evaluate(Job, bpy.types.Operator):
    """Compare the result with the true object, and lay truth, result and error side by side"""

    bl_idname = "scanstage.evaluate"
    bl_label = "Evaluate"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_result(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        scene, settings = context.scene, context.scene.scanstage
        folder = result_folder(context.scene)
        measures = yield from in_thread(workflow.evaluate_result, folder)
        found, truth, errors = yield from in_thread(_compare, folder)
        show_comparison(scene, found, truth, errors)
        settings.measures = json.dumps(measures)

    def show(self, context: bpy.types.Context) -> None:
        show_colors(context)


class SCANSTAGE_OT_export(ExportHelper, bpy.types.Operator):
    """Write the result's voxel mesh as a file for other programs"""

    bl_idname = "scanstage.export_mesh"
    bl_label = "Export Mesh"

    filename_ext = ""
    check_extension = None  # the name's own ending chooses the format
    filter_glob: StringProperty(default="*.ply;*.obj;*.stl;*.glb;*.vox;*.blend", options={'HIDDEN'})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _has_result(cls, context) and idle(cls, context)

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


def _read(folder: Path, progress) -> results.Result:
    progress(0.95, "Reading the result")
    return results.read_result(folder)


def _compare(folder: Path, progress):
    """Return what `show_comparison` takes, computed away from Blender."""
    found = results.read_result(folder)
    truth = workflow.truth_of(found)
    progress(0.97, "Measuring the error of every face")
    return found, truth, face_errors(found, truth)


def capture_state(folder: Path) -> str:
    """Return in one phrase what a capture set holds."""
    try:
        capture = read_capture(folder, require_pictures=False)
    except ScanstageError:
        return "no captures"
    return f"{len(capture.frames) - len(capture.missing)} of {len(capture.frames)} frames captured"


def summary(report: dict) -> list[str]:
    """Return what a panel shows of a reconstruction, one fact a line."""
    counts, iou = report["counts"], report["silhouette_iou"]["mean"]
    lines = [f"{counts['occupied']:,} voxels, {counts['quads']:,} faces", f"{sum(report['seconds'].values()):.1f} s"]
    lines += [f"{name.replace('_', ' ').capitalize()}: {count:,}" for name, count in counts.items() if name not in COMMON_COUNTS]
    return lines + ([f"Silhouettes match to {100 * iou:.1f} %"] if iou else []) + [f"! {w}" for w in report["warnings"]]


def _has_stage(cls, context: bpy.types.Context) -> bool:
    if ownership.find_stage(context.scene) is None:
        cls.poll_message_set("Build a stage first")
        return False
    return True


def _has_captures(cls, context: bpy.types.Context) -> bool:
    if not (capture_folder(context.scene) / FILE_NAME).is_file():
        cls.poll_message_set("Capture or import pictures first")
        return False
    return True


def _has_result(cls, context: bpy.types.Context) -> bool:
    if not (result_folder(context.scene) / results.REPORT).is_file():
        cls.poll_message_set("Reconstruct first")
        return False
    return True


CLASSES = (SCANSTAGE_OT_stage, SCANSTAGE_OT_remove_stage, SCANSTAGE_OT_capture, SCANSTAGE_OT_import, SCANSTAGE_OT_show_masks,
           SCANSTAGE_OT_show_shadows, SCANSTAGE_OT_reconstruct, SCANSTAGE_OT_show_result, SCANSTAGE_OT_show_pictures,
           SCANSTAGE_OT_evaluate, SCANSTAGE_OT_export)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
