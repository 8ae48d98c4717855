# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a button may do to the user's view: little, and only so that its result can be seen."""

from __future__ import annotations

import bpy
from mathutils import Vector

from ..stage.ownership import require_stage
from ..stage.readback import turntable_of

_DISTANCE = 1.5  # of the view, in distances from the turntable to the camera


def frame_stage(context: bpy.types.Context) -> None:
    """Turn the view that was clicked in towards the whole stage."""
    view = getattr(context.space_data, "region_3d", None)
    if view is None:
        return
    scene = context.scene
    corners = [member.matrix_world.translation for member in require_stage(scene).all_objects]
    centre = turntable_of(scene).matrix_world.translation
    view.view_perspective = 'PERSP'
    view.view_location = sum(corners, Vector()) / len(corners)
    view.view_distance = _DISTANCE * max((corner - centre).length for corner in corners)


def show_colors(context: bpy.types.Context) -> None:
    """Show materials where the view that was clicked in shows solids: the colours of a result are in its material."""
    shading = getattr(context.space_data, "shading", None)
    if shading is not None and shading.type == 'SOLID':
        shading.type = 'MATERIAL'


def show_image(context: bpy.types.Context, image: bpy.types.Image) -> None:
    """Show an image in the Image Editors of the screen that was clicked in."""
    for area in context.screen.areas if context.screen else ():
        if area.type == 'IMAGE_EDITOR':
            area.spaces.active.image = image
