# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One tab in the 3-D view's sidebar, five panels in the order of the work. They draw and do nothing else."""

from __future__ import annotations

import json
from collections.abc import Iterable

import bpy

from ..options import Option
from ..reconstruction.evaluation import EXPLAINED, Kind
from ..reconstruction.methods import METHODS
from ..reconstruction.shadows import SHADOW_OPTIONS
from ..reconstruction.silhouettes import SILHOUETTE_OPTIONS
from ..results.present import shown_probabilities
from ..stage import ownership, rig, scanner
from ..stage.presets import PRESETS
from ..stage.units import length_text, volume_text
from . import calibrating, forecast, gallery, operators
from .drawing import draw_button, draw_lines
from .operators.requirements import is_older
from .properties import field_name

_DEFAULT_FOLDER = "Beside this file"
# What many rigs share and few users change: in closed panels, so that the rig's own options stand out.
_PARTS = {"Camera": {option.name for option in (*rig.CAMERA_OPTIONS, rig.SAMPLES)},
          "Projector": {option.name for option in scanner.PROJECTOR_OPTIONS}}


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
        layout.template_icon(gallery.picture_of(settings.preset), scale=4.0)
        row = layout.row(align=True)
        row.prop(settings, "preset")
        row.popover(gallery.SCANSTAGE_PT_gallery.__name__, text="", icon='IMGDISPLAY')
        layout.prop(settings, "source")
        if settings.source == 'SELECTION':
            count = len(operators.stage.chosen_objects(context))
            _draw_state(layout, f"{count} object{'s' * (count != 1)} chosen")
        else:
            layout.prop(settings, {'BUILTIN': "builtin", 'SCENE': "subject", 'FILE': "file"}[settings.source])
        _draw_rig(layout, settings)
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
            draw_lines(layout, context, [forecast.capture_cost(context.scene)])
        row = layout.row(align=True)
        draw_button(row, context, operators.capture.SCANSTAGE_OT_capture, icon='RENDER_ANIMATION')
        draw_button(row, context, operators.capture.SCANSTAGE_OT_test_frame, text="", icon='RENDER_STILL')
        _draw_state(layout, settings.capture_state or "no captures")
        header, body = layout.panel("scanstage_import", default_closed=True)
        header.label(text="Other Programs")
        if body:
            _split(body).prop(settings, "import_format")
            draw_button(body, context, operators.capture.SCANSTAGE_OT_import, icon='IMPORT')
            body.operator(operators.capture.SCANSTAGE_OT_export_capture.bl_idname, icon='EXPORT')
            body.operator(operators.capture.SCANSTAGE_OT_show_cameras.bl_idname, icon='OUTLINER_DATA_CAMERA')
        header, body = layout.panel("scanstage_silhouettes", default_closed=True)
        header.label(text="Silhouettes")
        if body:
            _draw_options(_split(body), settings.silhouettes, SILHOUETTE_OPTIONS)
            draw_button(body, context, operators.capture.SCANSTAGE_OT_show_masks, icon='IMAGE_ALPHA')
        header, body = layout.panel("scanstage_shadows", default_closed=True)
        header.label(text="Shadows")
        if body:
            _draw_options(_split(body), settings.shadows, SHADOW_OPTIONS)
            draw_button(body, context, operators.capture.SCANSTAGE_OT_show_shadows, icon='LIGHT')
        header, body = layout.panel("scanstage_calibration", default_closed=True)
        header.label(text="Calibration")
        if body:
            draw_button(body, context, calibrating.SCANSTAGE_OT_calibrate, icon='CON_CAMERASOLVER')
            draw_lines(body, context, settings.calibration_lines.splitlines())


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
        draw_lines(layout, context, forecast.reconstruction_cost(settings))
        draw_button(layout, context, operators.reconstruct.SCANSTAGE_OT_reconstruct, icon='MESH_ICOSPHERE')


class SCANSTAGE_PT_result(_Panel, bpy.types.Panel):
    """The voxel mesh"""

    bl_label = "Result"

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = _split(self.layout), context.scene.scanstage
        draw_lines(layout, context, settings.result_lines.splitlines() or ["No result"])
        if is_older(context.scene):
            draw_lines(layout, context, ["! There are newer pictures than this result: reconstruct again"])
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
        draw_button(layout, context, operators.evaluate.SCANSTAGE_OT_evaluate, icon='DRIVER_DISTANCE')
        layout.operator(operators.evaluate.SCANSTAGE_OT_report_page.bl_idname, icon='DOCUMENTS')
        if not settings.measures:
            _draw_state(layout, "not compared yet")
            return
        for group, measures in json.loads(settings.measures).items():
            box = layout.box()
            box.label(text=group.title())
            column = box.column(align=True)
            for name, value in measures.items():
                _draw_measure(column, context.scene, name, value)


def _split(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    layout.use_property_split, layout.use_property_decorate = True, False
    return layout


def _draw_options(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup, options: Iterable[Option]) -> None:
    column = layout.column()
    for option in options:
        column.prop(group, option.name)


def _draw_rig(layout: bpy.types.UILayout, settings: bpy.types.PropertyGroup) -> None:
    """Draw the options of the rig: first its own, then in panels what it shares with others."""
    options, group = PRESETS[settings.preset].options, getattr(settings, field_name("preset", settings.preset))
    if settings.source not in ('BUILTIN', 'FILE'):
        options = [option for option in options if option.name != rig.FIT.name]  # what is in the scene keeps its size
    shared = set().union(*_PARTS.values())
    _draw_options(layout, group, [option for option in options if option.name not in shared])
    for title, names in _PARTS.items():
        if not any(option.name in names for option in options):
            continue
        header, body = layout.panel(f"scanstage_{title.lower()}", default_closed=True)
        header.label(text=title)
        if body:
            _draw_options(body, group, [option for option in options if option.name in names])


def _draw_measure(layout: bpy.types.UILayout, scene: bpy.types.Scene, name: str, value: float | None) -> None:
    entry = EXPLAINED.get(name)
    row = layout.row()
    row.label(text=entry.label if entry else name.replace("_", " ").capitalize())
    end = row.row()
    end.alignment = 'RIGHT'
    end.label(text=measure_text(scene, name, value))


def measure_text(scene: bpy.types.Scene, name: str, value: float | None) -> str:
    """Return a measure of a comparison as a panel shows it: with its unit."""
    kind = EXPLAINED[name].kind if name in EXPLAINED else None
    if value is None:
        return "-"
    if kind in (Kind.LENGTH, Kind.VOLUME):
        return (length_text if kind is Kind.LENGTH else volume_text)(scene, value)
    return f"{100 * value:.1f} %" if kind is Kind.SHARE else f"{value:,}" if isinstance(value, int) else f"{value:.4g}"


def _draw_state(layout: bpy.types.UILayout, text: str) -> None:
    layout.label(text=text[:1].upper() + text[1:], icon='INFO')


CLASSES = (SCANSTAGE_PT_stage, SCANSTAGE_PT_capture, SCANSTAGE_PT_reconstruct, SCANSTAGE_PT_result, SCANSTAGE_PT_evaluate)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
