# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Projectors and lasers by hand: Add > Light, a panel with their optics, and frusta that follow what is typed there."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty
from bpy_extras.io_utils import ImportHelper

from ..errors import ScanstageError
from ..reconstruction.active.patterns import PATTERN_SETS, make_patterns
from ..stage import laser, nodes, ownership, projection, projector

_LASER_WIDTH = 0.002
_OPTICS = projector.LENS, laser.LASER


class _Add(bpy.types.Operator):
    """What the operators of Add > Light share."""

    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.mode == 'OBJECT'

    def _finish(self, context: bpy.types.Context, made: bpy.types.Object) -> set[str]:
        ownership.release(made)
        made.location = context.scene.cursor.location
        for other in context.selected_objects:
            other.select_set(False)
        made.select_set(True)
        context.view_layer.objects.active = made
        return {'FINISHED'}


class SCANSTAGE_OT_add_projector(_Add):
    """Add a projector that shows patterns or pictures where its focal length, lens shift and distortion say, in Cycles"""

    bl_idname = "scanstage.add_projector"
    bl_label = "Projector"

    def execute(self, context: bpy.types.Context) -> set[str]:
        number = 1 + sum(projector.is_projector(other) for other in context.scene.objects)
        return self._finish(context, projector.add_projector(context.collection, number))


class SCANSTAGE_OT_add_laser(_Add):
    """Add a laser that throws a line: a sheet of light with a Gaussian profile, in Cycles"""

    bl_idname = "scanstage.add_laser"
    bl_label = "Laser Line"

    def execute(self, context: bpy.types.Context) -> set[str]:
        number = 1 + sum(laser.is_laser(other) for other in context.scene.objects)
        return self._finish(context, laser.add_laser(context.collection, number, width=_LASER_WIDTH))


class _Project(bpy.types.Operator):
    """What the operators on a projector share."""

    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.object is None or not projector.is_projector(context.object):
            cls.poll_message_set("Select a projector first")
            return False
        return True


class SCANSTAGE_OT_project_patterns(_Project):
    """Let the projector show a set of patterns made for its resolution, one a frame from the timeline's first frame on"""

    bl_idname = "scanstage.project_patterns"
    bl_label = "Show Patterns"

    pattern_set: EnumProperty(name="Patterns", items=[(name, entry.label, entry.description) for name, entry in PATTERN_SETS.items()])
    fit_timeline: BoolProperty(name="Fit Timeline", description="End the timeline with the last pattern", default=True)

    def execute(self, context: bpy.types.Context) -> set[str]:
        light, scene = context.object.data, context.scene
        try:
            patterns = make_patterns(self.pattern_set, projector.optics_of(light).size)
            projection.show_patterns(light, patterns, range(len(patterns)), start=scene.frame_start)
        except ScanstageError as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        if self.fit_timeline:
            scene.frame_end = scene.frame_start + len(patterns) - 1
        scene.frame_set(scene.frame_start)
        self.report({'INFO'}, f"{len(patterns)} patterns, one a frame from {scene.frame_start} on")
        return {'FINISHED'}


class SCANSTAGE_OT_project_image(_Project, ImportHelper):
    """Let the projector show an image, a movie, or a sequence of which any picture is chosen"""

    bl_idname = "scanstage.project_image"
    bl_label = "Show Image"

    filter_glob: bpy.props.StringProperty(default="*.png;*.jpg;*.jpeg;*.tif;*.tiff;*.exr;*.bmp;*.mp4;*.mov;*.mkv;*.avi", options={'HIDDEN'})
    sequence: BoolProperty(name="Image Sequence", description="Show the numbered pictures beside this one, one a frame")

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            image = bpy.data.images.load(self.filepath)
        except RuntimeError as error:
            self.report({'ERROR'}, f"{self.filepath}: cannot be read ({str(error).strip()}); choose an image or a movie")
            return {'CANCELLED'}
        first, frames = _numbered(Path(bpy.path.abspath(self.filepath))) if self.sequence else (1, 1)
        if self.sequence:
            image.source = 'SEQUENCE'
        projector.set_image(context.object.data, image, frames=frames, first=first, start=context.scene.frame_start)
        return {'FINISHED'}


def _numbered(path: Path) -> tuple[int, int]:
    """Return the number that a picture's name ends with, and how many numbers follow each other from there on."""
    digits = re.search(r"\d*$", path.stem).group()
    if not digits:
        return 1, 1
    name, first = path.stem.removesuffix(digits), int(digits)
    following = itertools.takewhile(lambda number: path.with_name(f"{name}{number:0{len(digits)}d}{path.suffix}").is_file(),
                                    itertools.count(first))
    return first, max(sum(1 for _ in following), 1)


class _Optics:
    """The panel of a projector or laser: the inputs of the node that is its optics, and the light's own power and colour."""

    bl_label = "Optics"
    bl_region_type = 'UI'

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and any(nodes.named_node(context.object.data, name) for name in _OPTICS)

    def draw(self, context: bpy.types.Context) -> None:
        layout, light = self.layout, context.object.data
        layout.use_property_split = True
        column = layout.column()
        for socket in next(node for name in _OPTICS if (node := nodes.named_node(light, name))).inputs:
            column.prop(socket, "default_value", text=socket.name)
        layout.prop(light, "energy", text="Power")
        layout.prop(light, "color")
        if not projector.is_projector(context.object):
            return
        image = nodes.named_node(light, projector.IMAGE)
        if image is not None and projector.PATTERNS not in light:
            layout.template_ID(image, "image", open="image.open")
            layout.template_image(image, "image", image.image_user, compact=True)
        row = layout.row(align=True)
        row.operator_menu_enum(SCANSTAGE_OT_project_patterns.bl_idname, "pattern_set", text="Patterns", icon='ALIGN_JUSTIFY')
        row.operator(SCANSTAGE_OT_project_image.bl_idname, text="Image", icon='IMAGE_DATA')


class SCANSTAGE_PT_optics(_Optics, bpy.types.Panel):
    """The projector or laser that is selected"""

    bl_space_type = 'VIEW_3D'
    bl_category = "Item"  # the work's own tab has its panels in the order of the work


class SCANSTAGE_PT_optics_properties(_Optics, bpy.types.Panel):
    """The projector or laser whose light this is"""

    bl_space_type = 'PROPERTIES'
    bl_region_type = 'WINDOW'
    bl_context = "data"


@bpy.app.handlers.persistent
def _follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Redraw the frusta of projectors and the fans of lasers whose optics have changed."""
    if bpy.app.is_job_running('RENDER'):
        return
    changed = {update.id.original for update in depsgraph.updates if isinstance(update.id, bpy.types.Light)}
    if changed:
        for candidate in scene.objects:
            if candidate.data in changed and projector.is_projector(candidate):
                projector.update_frustum(candidate)
            elif candidate.data in changed and laser.is_laser(candidate):
                laser.update_fan(candidate)


def _draw_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    menu.layout.separator()
    menu.layout.operator(SCANSTAGE_OT_add_projector.bl_idname, icon='LIGHT_SPOT')
    menu.layout.operator(SCANSTAGE_OT_add_laser.bl_idname, icon='LIGHT_SPOT')


CLASSES = (SCANSTAGE_OT_add_projector, SCANSTAGE_OT_add_laser, SCANSTAGE_OT_project_patterns, SCANSTAGE_OT_project_image,
           SCANSTAGE_PT_optics, SCANSTAGE_PT_optics_properties)
_register_classes, _unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes, the menu's entries and the frusta's handler."""
    _register_classes()
    bpy.types.VIEW3D_MT_light_add.append(_draw_menu)
    bpy.app.handlers.depsgraph_update_post.append(_follow)


def unregister() -> None:
    """Undo `register`."""
    bpy.app.handlers.depsgraph_update_post.remove(_follow)
    bpy.types.VIEW3D_MT_light_add.remove(_draw_menu)
    _unregister_classes()
