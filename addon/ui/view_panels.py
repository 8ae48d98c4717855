# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel below Stage that says what is drawn over the 3-D views, and the settings behind it, which no file keeps."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty

from ..errors import ScanstageError
from ..reconstruction.planning.coverage import PIXEL_ERROR
from ..results.growing import show_growing_hulls
from ..stage import ownership
from ..stage.units import length_text
from . import overlays, watching
from .coverage import SHOWN
from .drawing import draw_lines
from .jobs import idle
from .viewport import show_colors


def _changed(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    overlays.draw_anew()
    watching.soon()
    watching.redraw()


def _switch(name: str, description: str, default: bool = True):
    return BoolProperty(name=name, description=description, default=default, update=_changed, options={'SKIP_SAVE'})


class SCANSTAGE_PG_view(bpy.types.PropertyGroup):
    """What is drawn over the 3-D views."""

    overlays: _switch("Overlays", "Draw the rig over the 3-D views")
    cameras: _switch("Cameras", "What each camera sees, as far as the object")
    views: _switch("Views", "Where the cameras stand about the object at every pose of the plan, as small pyramids")
    projectors: _switch("Projectors", "What each projector or laser lights, as far as the object, and there what the projector shows")
    lights: _switch("Lights", "Which way the lights shine, and the plane of a stick's shadow")
    volume: _switch("Working Volume", "The box that is reconstructed, with a patch of its voxels at the lower corner")
    turntable: _switch("Turntable", "The turntable's axis, its stops, and where it stands now")
    names: _switch("Names", "Name the devices, and say how large a voxel is")
    coverage: EnumProperty(name="Coverage", description="What the colours of the object's surface say", items=SHOWN, update=_changed,
                           options={'SKIP_SAVE'})
    pixel_error: FloatProperty(name="Pixel Error", description="How well a position in a picture is found, as a standard deviation in "
                               "pixels: about 0.1 for a stripe, 0.2 for textured pictures that are matched", default=PIXEL_ERROR, min=0.001,
                               soft_max=2.0, max=100.0, precision=2, update=_changed, options={'SKIP_SAVE'})
    live_hull: _switch("Live Hull", "Show the visual hull that the rig would carve, and let it follow while you move the cameras or change "
                       "the number of views", False)
    hull_opacity: FloatProperty(name="Opacity", description="Of the live hull", default=0.6, min=0.05, max=1.0, subtype='FACTOR',
                                update=_changed, options={'SKIP_SAVE'})


class SCANSTAGE_OT_show_growing_hull(bpy.types.Operator):
    """Put the hulls of the first 1, 2, 4, 8 ... views beside the object, one after another along the timeline: play it"""

    bl_idname = "scanstage.show_growing_hull"
    bl_label = "Show Hull View by View"
    bl_options = {'REGISTER', 'UNDO'}

    voxels: IntProperty(name="Voxels", description="Along the longest side of the hulls", default=64, min=8, soft_max=256, max=512)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if ownership.find_stage(context.scene) is None:
            cls.poll_message_set("Build a stage first")
            return False
        return idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            shown = show_growing_hulls(context.scene, voxels=self.voxels)
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        show_colors(context)
        self.report({'INFO'}, f"{len(shown)} hulls from frame {context.scene.frame_start} on: play the timeline")
        return {'FINISHED'}


class SCANSTAGE_PT_view(bpy.types.Panel):
    """The rig, and what it will see, drawn over the 3-D views; nothing of it is saved"""

    bl_label = "Overlays"
    bl_space_type = 'VIEW_3D'
    bl_region_type = 'UI'
    bl_category = "Scanstage"
    bl_parent_id = "SCANSTAGE_PT_stage"
    bl_options = {'DEFAULT_CLOSED'}

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.window_manager.scanstage_view, "overlays", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.window_manager.scanstage_view
        grid = layout.grid_flow(row_major=True, columns=2, align=True)
        grid.active = settings.overlays
        for name in ("cameras", "views", "projectors", "lights", "volume", "turntable", "names"):
            grid.prop(settings, name)
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(settings, "coverage")
        if settings.coverage == 'ERROR':
            layout.prop(settings, "pixel_error")
        if settings.coverage != 'NONE' and watching.watched.missed:
            _draw_missed(layout, context.scene, watching.watched.missed)
        row = layout.row(heading="Live Hull")
        row.prop(settings, "live_hull", text="")
        sub = row.row()
        sub.active = settings.live_hull
        sub.prop(settings, "hull_opacity", text="")
        if watching.watched.problem and watching.wanted() and ownership.find_stage(context.scene) is not None:
            draw_lines(layout, context, [f"! {watching.watched.problem}"])
        layout.operator(SCANSTAGE_OT_show_growing_hull.bl_idname, icon='OUTLINER_OB_VOLUME')


def missed_lines(scene: bpy.types.Scene, missed: dict[str, float | None]) -> list[tuple[str, str]]:
    """Return what the rig misses as names and values for a panel."""
    shares = [("Seen by no view", "seen_by_less_than_1"), ("By fewer than 2", "seen_by_less_than_2"),
              ("By fewer than 3", "seen_by_less_than_3"), ("Unlit", "unlit"), ("Without depth", "without_depth")]
    if missed["beyond_projectors"] < 1:
        shares.insert(4, ("Beyond projectors", "beyond_projectors"))
    median = missed["median_depth_error"]
    return [(name, f"{100 * missed[key]:.1f} %") for name, key in shares] + [
        ("Median depth error", "-" if median is None else length_text(scene, median))]


def _draw_missed(layout: bpy.types.UILayout, scene: bpy.types.Scene, missed: dict[str, float | None]) -> None:
    box = layout.box()
    box.label(text="What the rig misses")
    column = box.column(align=True)
    for name, value in missed_lines(scene, missed):
        row = column.row()
        row.label(text=name)
        value_row = row.row()
        value_row.alignment = 'RIGHT'
        value_row.label(text=value)


CLASSES = (SCANSTAGE_PG_view, SCANSTAGE_OT_show_growing_hull, SCANSTAGE_PT_view)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the panel and attach its settings to the window manager."""
    _register_classes()
    bpy.types.WindowManager.scanstage_view = PointerProperty(type=SCANSTAGE_PG_view)
    watching.register()
    overlays.register()


def unregister() -> None:
    """Undo `register`, in reverse."""
    overlays.unregister()
    watching.unregister()
    del bpy.types.WindowManager.scanstage_view
    _unregister_classes()
