# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons that get pictures, and that show what is found in them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ...captures.exporters import EXPORTERS, export_capture
from ...captures.importers import COMMON_OPTIONS, IMPORTERS, import_capture
from ...captures.scan import load_scan
from ...captures.store import read_capture
from ...errors import ScanstageError
from ...reconstruction.shadows import SHADOW_OPTIONS
from ...reconstruction.silhouettes import SILHOUETTE_OPTIONS
from ...render.capture import capture_frames
from ...results.cameras import show_cameras
from ..jobs import Job, idle, in_thread
from ..masks import show_masks, show_shadows
from ..properties import values_of
from .requirements import capture_folder, has_captures, has_stage

_COMMON = {option.name: option for option in COMMON_OPTIONS}


class SCANSTAGE_OT_capture(Job, bpy.types.Operator):
    """Render every frame of the plan that is not on disk yet"""

    bl_idname = "scanstage.capture"
    bl_label = "Capture"
    bl_options = {'REGISTER'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_stage(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        yield from timed_capture(context.scene)


class SCANSTAGE_OT_test_frame(Job, bpy.types.Operator):
    """Render one frame of those that are missing, to learn how long the others take; it is kept, and not rendered again"""

    bl_idname = "scanstage.test_frame"
    bl_label = "Capture One Frame"
    bl_options = {'REGISTER'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_stage(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        yield from timed_capture(context.scene, most=1)


class SCANSTAGE_OT_import(Job, ImportHelper, bpy.types.Operator):
    """Turn calibrated photographs into a capture set"""

    bl_idname = "scanstage.import_captures"
    bl_label = "Import Captures"
    bl_options = {'REGISTER'}

    format: EnumProperty(name="Format", items=[(name, entry.label, entry.description) for name, entry in IMPORTERS.items()])
    filter_glob: StringProperty(default="*.xml;*.yml;*.yaml;*.json;*.txt;*.m", options={'HIDDEN'})
    masks: StringProperty(name="Masks", description=_COMMON["masks"].description)
    undistort: BoolProperty(name="Undistort", description=_COMMON["undistort"].description)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return idle(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file first; `execute` runs the import."""
        self.format = context.scene.scanstage.import_format
        return ImportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        scene, folder = context.scene, capture_folder(context.scene)
        options = {"masks": self.masks, "undistort": self.undistort}
        yield from in_thread(import_capture, self.format, Path(self.filepath), folder, options)
        note_capture(scene, folder)


class SCANSTAGE_OT_export_capture(bpy.types.Operator, ExportHelper):
    """Write the pictures and their cameras for other programs, into a new folder"""

    bl_idname = "scanstage.export_capture"
    bl_label = "Export Pictures"
    filename_ext = ""
    format: EnumProperty(name="Format", description="Whose conventions the cameras follow", items=[
        (entry.name, entry.label, entry.description) for entry in EXPORTERS.values()])

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_captures(cls, context) and idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            count = export_capture(self.format, capture_folder(context.scene), Path(self.filepath))
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        self.report({'INFO'}, f"{count} pictures in {self.filepath}")
        return {'FINISHED'}


class SCANSTAGE_OT_show_cameras(bpy.types.Operator):
    """Put the captures' cameras into the scene, each with its picture behind it; a result that is shown then stands among them"""

    bl_idname = "scanstage.show_cameras"
    bl_label = "Show Cameras"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_captures(cls, context) and idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            warnings = show_cameras(context.scene, capture_folder(context.scene))
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        for warning in warnings:
            self.report({'WARNING'}, warning)
        return {'FINISHED'}


class SCANSTAGE_OT_show_masks(Job, bpy.types.Operator):
    """Extract the silhouettes and show them as the image of each camera; look through the camera and scrub"""

    bl_idname = "scanstage.show_masks"
    bl_label = "Show Silhouettes"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_captures(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        scene, folder = context.scene, capture_folder(context.scene)
        yield from in_thread(load_scan, folder, values_of(scene.scanstage.silhouettes, SILHOUETTE_OPTIONS))
        show_masks(scene, folder)


class SCANSTAGE_OT_show_shadows(Job, bpy.types.Operator):
    """Find the shadows and show them as the image of each camera: white in shadow, black lit, grey undecided"""

    bl_idname = "scanstage.show_shadows"
    bl_label = "Show Shadows"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_captures(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        folder = capture_folder(context.scene)
        yield from in_thread(load_scan, folder, silhouettes=False,
                             shadow_options=values_of(context.scene.scanstage.shadows, SHADOW_OPTIONS))
        show_shadows(context.scene, folder)


def timed_capture(scene: bpy.types.Scene, most: int | None = None) -> Iterator[tuple[float, str]]:
    """Capture all frames, or the next ``most``, and note in the scene's settings what is there then and how long a frame took."""
    folder = capture_folder(scene)
    before, started = _counted(folder)[0], time.perf_counter()
    try:
        yield from capture_frames(scene, folder, most=most)
    finally:
        rendered = _counted(folder)[0] - before
        if rendered > 0:
            scene.scanstage.frame_seconds = (time.perf_counter() - started) / rendered
        note_capture(scene, folder)


def note_capture(scene: bpy.types.Scene, folder: Path) -> None:
    """Note in the scene's settings what a capture set holds."""
    settings = scene.scanstage
    settings.capture_state = capture_state(folder)
    settings.capture_frames, _, settings.capture_pixels = _counted(folder)


def capture_state(folder: Path) -> str:
    """Return in one phrase what a capture set holds."""
    captured, planned, _ = _counted(folder)
    return f"{captured} of {planned} frames captured" if planned else "no captures"


def _counted(folder: Path) -> tuple[int, int, int]:
    """Return how many frames are captured and planned, and the pixels of the former together."""
    try:
        capture = read_capture(folder, require_pictures=False)
    except ScanstageError:
        return 0, 0, 0
    missing = set(capture.missing)
    sizes = [capture.cameras[frame.camera].size for frame in capture.frames if frame.id not in missing]
    return len(sizes), len(capture.frames), sum(width * height for width, height in sizes)


CLASSES = (SCANSTAGE_OT_capture, SCANSTAGE_OT_test_frame, SCANSTAGE_OT_import, SCANSTAGE_OT_export_capture, SCANSTAGE_OT_show_cameras,
           SCANSTAGE_OT_show_masks, SCANSTAGE_OT_show_shadows)
