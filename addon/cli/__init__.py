# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: the same functions as the panels, without a window.

`main` is what all three doors lead to: ``scripts/scanstage.py`` from a clone, ``blender --background --python`` with the
same script, and ``blender --command scanstage`` with the extension installed.
"""

from .main import main

__all__ = ["main", "register", "unregister"]

_handles = []


def register() -> None:
    """Make ``blender --command scanstage`` known."""
    import bpy

    _handles.append(bpy.utils.register_cli_command("scanstage", main))


def unregister() -> None:
    """Forget the command again."""
    import bpy

    while _handles:
        bpy.utils.unregister_cli_command(_handles.pop())
