# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One tab in the 3-D view's sidebar, five panels in the order of the work. They draw and do nothing else."""

from __future__ import annotations

import json
import textwrap

import bpy

from ..options import Option
from ..reconstruction.methods import METHODS
from ..reconstruction.shadows import SHADOW_OPTIONS
from ..reconstruction.silhouettes import SILHOUETTE_OPTIONS
from ..results.present import shown_probabilities
from ..stage import ownership
from ..stage.presets import PRESETS
from . import calibrating, forecast, gallery, operators
from .operators.requirements import is_older
from .properties import field_name

_DEFAULT_FOLDER = "Beside this file"
_LINE = 42  # characters that fit a sidebar of the usual width


class _Panel:
    """What all panels of the tab share."""

    bl_space_type = 'VIEW_3D'
    bl_region_type = 'UI'
    bl_category = "Scanstage"


class SCANSTAGE_PT_stage(_Panel, bpy.types.Panel):
    """Which rig stands round which object"""

    bl_label = "Stage"

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        gallery.SCANSTAGE_PT_own_rigs.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = _split(self.layout), context.scene.scanstage
        _draw_job(layout, context)
        layout.template_icon(gallery.picture_of(settings.preset), scale=5.0)
        row = layout.row(align=True)
        row.prop(settings, "preset")
        row.popover(gallery.SCANSTAGE_PT_gallery.__name__, text="", icon='IMGDISPLAY')
        layout.prop(settings, "source")
        layout.prop(settings, {'BUILTIN': "builtin", 'SCENE': "subject", 'FILE': "file"}[settings.source])
        preset = PRESETS[settings.preset]
        _draw_options(layout, getattr(settings, field_name("preset", preset.name)), preset.options)
        row = layout.row(align=True)
        row.operator(operators.stage.SCANSTAGE_OT_stage.bl_idname, icon='SCENE_DATA')
        row.operator(operators.stage.SCANSTAGE_OT_remove_stage.bl_idname, text="", icon='TRASH')
        scene = context.scene
        stands = ownership.find_stage(scene) is not None
        _draw_state(layout, f"{scene.frame_end - scene.frame_start + 1} frames planned, on the timeline" if stands
                    else "nothing staged")


class SCANSTAGE_PT_capture(_Panel, bpy.types.Panel):
    """The pictures: rendered here, or photographs"""

    bl_label = "Capture"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = _split(self.layout), context.scene.scanstage
        layout.prop(settings, "capture_folder", placeholder=_DEFAULT_FOLDER)
        if ownership.find_stage(context.scene) is not None:
            _draw_lines(layout, [forecast.capture_cost(context.scene)])
        row = layout.row(align=True)
        row.operator(operators.capture.SCANSTAGE_OT_capture.bl_idname, icon='RENDER_ANIMATION')
        row.operator(operators.capture.SCANSTAGE_OT_test_frame.bl_idname, text="", icon='RENDER_STILL')
        _draw_state(layout, settings.capture_state or "no captures")
        header, body = layout.panel("scanstage_import", default_closed=True)
        header.label(text="Other Programs")
        if body:
            _split(body).prop(settings, "import_format")
            body.operator(operators.capture.SCANSTAGE_OT_import.bl_idname, icon='IMPORT')
            body.operator(operators.capture.SCANSTAGE_OT_export_capture.bl_idname, icon='EXPORT')
            body.operator(operators.capture.SCANSTAGE_OT_show_cameras.bl_idname, icon='OUTLINER_DATA_CAMERA')
        header, body = layout.panel("scanstage_silhouettes", default_closed=True)
        header.label(text="Silhouettes")
        if body:
            _draw_options(_split(body), settings.silhouettes, SILHOUETTE_OPTIONS)
            body.operator(operators.capture.SCANSTAGE_OT_show_masks.bl_idname, icon='IMAGE_ALPHA')
        header, body = layout.panel("scanstage_shadows", default_closed=True)
        header.label(text="Shadows")
        if body:
            _draw_options(_split(body), settings.shadows, SHADOW_OPTIONS)
            body.operator(operators.capture.SCANSTAGE_OT_show_shadows.bl_idname, icon='LIGHT')
        header, body = layout.panel("scanstage_calibration", default_closed=True)
        header.label(text="Calibration")
        if body:
            body.operator(calibrating.SCANSTAGE_OT_calibrate.bl_idname, icon='CON_CAMERASOLVER')
            _draw_lines(body, settings.calibration_lines.splitlines())


class SCANSTAGE_PT_reconstruct(_Panel, bpy.types.Panel):
    """What a real rig would compute from the pictures"""

    bl_label = "Reconstruct"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = _split(self.layout), context.scene.scanstage
        layout.prop(settings, "method")
        layout.prop(settings, "voxels")
        method = METHODS[settings.method]
        _draw_options(layout, getattr(settings, field_name("method", method.name)), method.options)
        layout.prop(settings, "use_bounds")
        if settings.use_bounds:
            layout.prop(settings, "bounds_lower")
            layout.prop(settings, "bounds_upper")
        layout.prop(settings, "result_folder", placeholder=_DEFAULT_FOLDER)
        _draw_lines(layout, forecast.reconstruction_cost(settings))
        layout.operator(operators.reconstruct.SCANSTAGE_OT_reconstruct.bl_idname, icon='MESH_ICOSPHERE')


class SCANSTAGE_PT_result(_Panel, bpy.types.Panel):
    """The voxel mesh"""

    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = _split(self.layout), context.scene.scanstage
        _draw_lines(layout, settings.result_lines.splitlines() or ["No result"])
        if is_older(context.scene):
            _draw_lines(layout, ["! There are newer pictures than this result: reconstruct again"])
        layout.prop(settings, "smooth")
        if shown_probabilities(context.scene):
            layout.prop(settings, "least_probability")
            layout.prop(settings, "probability_colors")
        layout.operator(operators.reconstruct.SCANSTAGE_OT_show_result.bl_idname, icon='HIDE_OFF')
        layout.operator(operators.reconstruct.SCANSTAGE_OT_show_pictures.bl_idname, icon='IMAGE_DATA')
        layout.operator(operators.reconstruct.SCANSTAGE_OT_export.bl_idname, icon='EXPORT')


class SCANSTAGE_PT_evaluate(_Panel, bpy.types.Panel):
    """How far the result is from the truth"""

    bl_label = "Evaluate"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.scanstage
        layout.operator(operators.evaluate.SCANSTAGE_OT_evaluate.bl_idname, icon='DRIVER_DISTANCE')
        layout.operator(operators.evaluate.SCANSTAGE_OT_report_page.bl_idname, icon='DOCUMENTS')
        if not settings.measures:
            _draw_state(layout, "not compared yet")
            return
        for group, measures in json.loads(settings.measures).items():
            box = layout.box()
            box.label(text=group.title())
            for name, value in measures.items():
                row = box.row()
                row.label(text=name.replace("_", " ").capitalize())
                row.label(text="-" if value is None else f"{value:,}" if isinstance(value, int) else f"{value:.4g}")


def _split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    layout.use_property_split, layout.use_property_decorate = True, False
    return layout


def _draw_options(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup, options: tuple[Option, ...]) -> None:
    column = layout.column()
    for option in options:
        column.prop(group, option.name)


def _draw_job(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    job = context.window_manager.scanstage_job
    if job.running:
        layout.progress(factor=job.fraction, text=f"{job.title}: {job.message}")
        layout.label(text="Press Esc to stop", icon='EVENT_ESC')


def _draw_state(layout: bpy.types.UILayout, text: str) -> None:
    layout.label(text=text[:1].upper() + text[1:], icon='INFO')


def _draw_lines(layout: bpy.types.UILayout, lines: list[str]) -> None:
    column = layout.column(align=True)
    for line in lines:
        icon = 'ERROR' if line.startswith("! ") else 'NONE'
        for part in textwrap.wrap(line.removeprefix("! "), _LINE):
            column.label(text=part, icon=icon)
            icon = 'BLANK1' if icon != 'NONE' else 'NONE'


CLASSES = (SCANSTAGE_PT_stage, SCANSTAGE_PT_capture, SCANSTAGE_PT_reconstruct, SCANSTAGE_PT_result, SCANSTAGE_PT_evaluate)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
