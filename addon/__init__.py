# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Scanstage: design, simulate and evaluate 3-D scanning rigs in Blender.

This module registers the extension and nothing else. Blender is imported only when it registers, so that
`addon.reconstruction` and `addon.captures` work in any Python.
"""


def register() -> None:
    """Add panels, operators, properties and the command line to the running Blender."""
    from . import cli, ui

    ui.register()
    cli.register()


def unregister() -> None:
    """Take away everything that `register` added."""
    from . import cli, ui

    cli.unregister()
    ui.unregister()
