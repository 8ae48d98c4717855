# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Add > Scan Rig, and Scan with Rig in the objects' context menu: each preset with one click, round the objects that are selected."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty

from ..stage.carried import scannable
from ..stage.presets import PRESETS
from .jobs import idle
from .operators.stage import FramesStage, build_chosen


class SCANSTAGE_OT_add_rig(FramesStage, bpy.types.Operator):
    """Build a rig round the selected objects, or round the object that the Stage panel names"""

    bl_idname = "scanstage.add_rig"
    bl_label = "Add Scan Rig"
    bl_options = {'REGISTER', 'UNDO'}

    preset: EnumProperty(name="Rig", items=[(name, preset.label, preset.description) for name, preset in PRESETS.items()])
    use_selection: BoolProperty(name="Selected Objects", description="Build it round the selected objects, if there are any", default=True)

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Say of each entry of the menu what its rig is."""
        return PRESETS[properties.preset].description

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != 'OBJECT':
            cls.poll_message_set("Switch to Object Mode first")
            return False
        return idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        settings = context.scene.scanstage
        before = settings.preset, settings.source, settings.subject
        settings.preset = self.preset
        chosen = scannable(context.selected_objects) if self.use_selection else []
        if len(chosen) == 1:
            settings.source, settings.subject = 'SCENE', chosen[0]
        elif chosen:
            settings.source = 'SELECTION'
        done = build_chosen(self, context)
        if 'FINISHED' not in done:
            settings.preset, settings.source, settings.subject = before
        return done


class SCANSTAGE_MT_add_rig(bpy.types.Menu):
    """The rigs of Scanstage"""

    bl_idname = "SCANSTAGE_MT_add_rig"
    bl_label = "Scan Rig"

    def draw(self, context: bpy.types.Context) -> None:
        for name, preset in PRESETS.items():
            self.layout.operator(SCANSTAGE_OT_add_rig.bl_idname, text=preset.label).preset = name


def _draw_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.menu(SCANSTAGE_MT_add_rig.bl_idname, icon='OUTLINER_OB_CAMERA')


def _draw_context_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Offer the rigs where an object was clicked with the right button, if it can be scanned."""
    if scannable(context.selected_objects):
        menu.layout.separator()
        menu.layout.menu(SCANSTAGE_MT_add_rig.bl_idname, text="Scan with Rig", icon='OUTLINER_OB_CAMERA')


_register_classes, _unregister_classes = bpy.utils.register_classes_factory((SCANSTAGE_OT_add_rig, SCANSTAGE_MT_add_rig))


def register() -> None:
    """Register the operator, and its menu in Add and at the objects."""
    _register_classes()
    bpy.types.VIEW3D_MT_add.append(_draw_menu)
    bpy.types.VIEW3D_MT_object_context_menu.append(_draw_context_menu)


def unregister() -> None:
    """Undo `register`."""
    bpy.types.VIEW3D_MT_object_context_menu.remove(_draw_context_menu)
    bpy.types.VIEW3D_MT_add.remove(_draw_menu)
    _unregister_classes()
