# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A staged scene is saved with the fingerprint of its plan as it then is, for whoever renders the file."""

import bpy
from bpy.app.handlers import persistent

from ..errors import ScanstageError
from ..stage import ownership
from ..stage.fingerprint import stamp


@persistent
def stamp_plan(*_: object) -> None:
    """Stamp the scene before it is saved; one whose plan cannot be captured yet has no fingerprint."""
    scene = bpy.context.scene
    if ownership.find_stage(scene) is None:
        return
    try:
        stamp(scene)
    except ScanstageError:
        scene.render.stamp_note_text = ""


def register() -> None:
    """Stamp on every save."""
    bpy.app.handlers.save_pre.append(stamp_plan)


def unregister() -> None:
    """Stamp no more."""
    bpy.app.handlers.save_pre.remove(stamp_plan)
