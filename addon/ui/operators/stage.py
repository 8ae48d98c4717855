# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The buttons that build the rig and take it away."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...errors import ScanstageError
from ...stage import ownership, staging
from ...stage.carried import scannable
from ...stage.presets import PRESETS
from ..jobs import idle
from ..properties import field_name, values_of
from ..viewport import frame_stage
from .requirements import has_stage


def build_chosen(operator: bpy.types.Operator, context: bpy.types.Context) -> set[str]:
    """Build the rig that the scene's settings choose, and return what ``operator`` is to return."""
    settings = context.scene.scanstage
    subject = {'BUILTIN': settings.builtin, 'SCENE': settings.subject, 'SELECTION': chosen_objects(context),
               'FILE': Path(bpy.path.abspath(settings.file))}[settings.source]
    preset = PRESETS[settings.preset]
    options = values_of(getattr(settings, field_name("preset", preset.name)), preset.options)
    try:
        staging.build(context.scene, preset.name, subject, options)
    except ScanstageError as error:
        operator.report({'ERROR'}, str(error))
        return {'CANCELLED'}
    return {'FINISHED'}


def chosen_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected objects that can be scanned; if there are none, those that are on the turntable already."""
    if chosen := scannable(context.selected_objects):
        return chosen
    stage = ownership.find_stage(context.scene)
    return [] if stage is None else [o for table in ownership.with_role(stage, "turntable") for o in ownership.attached(table)]


class FramesStage:
    """Of an operator that builds a stage: pressed by hand, it brings the stage into view, which is small beside Blender's default cube."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Execute, and look at what was built."""
        done = self.execute(context)
        if 'FINISHED' in done:
            frame_stage(context)
        return done


class SCANSTAGE_OT_stage(FramesStage, bpy.types.Operator):
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
        if settings.source == 'SELECTION' and not chosen_objects(context):
            cls.poll_message_set("Select the objects that are to be scanned")
            return False
        if settings.source == 'FILE' and not settings.file:
            cls.poll_message_set("Choose the file of the object that is to be scanned")
            return False
        return idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return build_chosen(self, context)


class SCANSTAGE_OT_remove_stage(bpy.types.Operator):
    """Take the rig away; your own objects and render settings are as they were before it"""

    bl_idname = "scanstage.remove_stage"
    bl_label = "Remove Stage"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_stage(cls, context) and idle(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        staging.remove(context.scene)
        return {'FINISHED'}


CLASSES = (SCANSTAGE_OT_stage, SCANSTAGE_OT_remove_stage)
