# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panels share in drawing: lines of text that fit, and the buttons of long work."""

from __future__ import annotations

import textwrap

import bpy

from .jobs import SCANSTAGE_OT_stop

_CHARACTER = 6.6  # pixels that a character takes, with what is beside the text shared among them
_LEAST = 20  # characters in a line


def draw_lines(layout: bpy.types.UILayout, context: bpy.types.Context, lines: list[str]) -> None:
    """Draw lines of text, broken where the region ends; those that start with "! " are warnings."""
    column = layout.column(align=True)
    width = context.region.width / context.preferences.system.ui_scale if context.region else 0
    for line in lines:
        icon = 'ERROR' if line.startswith("! ") else 'NONE'
        for part in textwrap.wrap(line.removeprefix("! "), max(_LEAST, int(width / _CHARACTER) - 4 * (icon != 'NONE'))):
            column.label(text=part, icon=icon)
            icon = 'BLANK1' if icon != 'NONE' else 'NONE'


def draw_button(layout: bpy.types.UILayout, context: bpy.types.Context, operator: type[bpy.types.Operator], **look) -> None:
    """Draw the button of a job, and in its place, while that job runs, how far it is and a cross that stops it."""
    job = context.window_manager.scanstage_job
    if not (job.running and job.operator == operator.bl_idname):
        layout.operator(operator.bl_idname, **look)
        return
    row = layout.row(align=True)
    row.progress(factor=job.fraction, text=job.message[:1].upper() + job.message[1:])
    row.operator(SCANSTAGE_OT_stop.bl_idname, text="", icon='X')
