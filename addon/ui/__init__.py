# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The window's face: properties, operators and one tab of panels, in the order of the work.

- `properties`: what a scene remembers; the options come out of the tables of presets, methods and silhouettes.
- `jobs`: long work as steps, with progress, Esc and a thread for what never touches Blender.
- `drawing`: lines and buttons as all panels draw them.
- `operators`: adapters: gather what is set, call a function, report.
- `adding`: Add > Scan Rig, with an entry for each preset.
- `gallery`: every rig with its picture; the user's own rigs, as presets.
- `forecast`: what a button will cost.
- `calibrating`: the operator that calibrates the devices of a capture set.
- `panels`: draw, and nothing else.
- `devices`: projectors and lasers by hand.
- `saving`: the plan's fingerprint in every saved file.
- `view_panels`: what is drawn over the 3-D views by `overlays`, in the colours of `coverage`, from what `watching` knows of the rig.
"""

from . import adding, calibrating, devices, gallery, jobs, operators, panels, properties, saving, view_panels


def register() -> None:
    """Register every class and attach the settings to scenes."""
    properties.register()
    jobs.register()
    operators.register()
    calibrating.register()
    gallery.register()
    panels.register()
    devices.register()
    adding.register()
    saving.register()
    view_panels.register()


def unregister() -> None:
    """Undo `register`, in reverse."""
    view_panels.unregister()
    saving.unregister()
    adding.unregister()
    devices.unregister()
    panels.unregister()
    gallery.unregister()
    calibrating.unregister()
    operators.unregister()
    jobs.unregister()
    properties.unregister()
