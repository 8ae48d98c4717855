# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The gallery of rigs: each with its picture and a sentence, built by one click; and the user's own rigs, kept as Blender's presets.

A rig of the user's is a file in ``presets/scanstage/rigs`` of Blender's user folder, as other presets are: given to somebody
else, and put into theirs, it is in their menu.
"""

from __future__ import annotations

import textwrap

import bpy
import bpy.utils.previews
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..stage.objects import assets_folder
from ..stage.presets import PRESETS
from .adding import SCANSTAGE_OT_add_rig
from .properties import field_name

_COLUMNS, _LINE = 4, 24  # rigs side by side, and characters that fit under a picture
_pictures: bpy.utils.previews.ImagePreviewCollection | None = None


def picture_of(preset: str) -> int:
    """Return the icon that shows a rig, or 0, which is none, where there is no picture of it."""
    return _pictures[preset].icon_id if _pictures is not None and preset in _pictures else 0


class SCANSTAGE_PT_gallery(bpy.types.Panel):
    """Every rig that can be built"""

    bl_label = "Rigs"
    bl_space_type = 'VIEW_3D'
    bl_region_type = 'HEADER'
    bl_options = {'INSTANCED'}
    bl_ui_units_x = 34

    def draw(self, context: bpy.types.Context) -> None:
        grid = self.layout.grid_flow(row_major=True, columns=_COLUMNS, even_columns=True, even_rows=False)
        for name, preset in PRESETS.items():
            cell = grid.box().column(align=True)
            cell.template_icon(picture_of(name), scale=6.0)
            button = cell.operator(SCANSTAGE_OT_add_rig.bl_idname, text=preset.label)
            button.preset, button.use_selection = name, False  # of what the panel names
            lines = textwrap.wrap(preset.description, _LINE)
            for line in lines:
                cell.label(text=line)


class SCANSTAGE_OT_save_rig(AddPresetBase, bpy.types.Operator):
    """Keep the rig's options under a name, or forget those that are kept"""

    bl_idname = "scanstage.save_rig"
    bl_label = "Save Rig"
    preset_menu = "SCANSTAGE_PT_own_rigs"
    preset_subdir = "scanstage/rigs"
    preset_defines = ["settings = bpy.context.scene.scanstage"]

    @property
    def preset_values(self) -> list[str]:
        """What is kept: the rig that is chosen, and its own options."""
        name = bpy.context.scene.scanstage.preset
        return ["settings.preset", *(f"settings.{field_name('preset', name)}.{option.name}" for option in PRESETS[name].options)]


class SCANSTAGE_PT_own_rigs(PresetPanel, bpy.types.Panel):
    """Your own rigs"""

    bl_label = "Your Rigs"
    preset_subdir = SCANSTAGE_OT_save_rig.preset_subdir
    preset_operator = "script.execute_preset"
    preset_add_operator = SCANSTAGE_OT_save_rig.bl_idname


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (SCANSTAGE_PT_gallery, SCANSTAGE_OT_save_rig, SCANSTAGE_PT_own_rigs))


def register() -> None:
    """Load the pictures and register the classes."""
    global _pictures
    _pictures = bpy.utils.previews.new()
    for name in PRESETS:
        path = assets_folder() / "rigs" / f"{name}.png"
        if path.is_file():
            _pictures.load(name, str(path), 'IMAGE')
    _register_classes()


def unregister() -> None:
    """Undo `register`."""
    global _pictures
    _unregister_classes()
    bpy.utils.previews.remove(_pictures)
    _pictures = None
