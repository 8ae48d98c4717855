# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lengths and volumes as a scene's own units write them.

All numbers of the project are in Blender's units, whatever the scene says these are: what is built round an object fits it in any
scene. Only people read them in metres, inches, or with a scale: here.
"""

from __future__ import annotations

import bpy

_METRIC = (("m", 1.0), ("mm", 1e-3), ("\u00b5m", 1e-6))


def metres_of(scene: bpy.types.Scene) -> float:
    """Return how many metres one of Blender's units is in a scene; 1 where it has no system of units."""
    units = scene.unit_settings
    return 1.0 if units.system == 'NONE' else units.scale_length


def length_text(scene: bpy.types.Scene, value: float, *, digits: int = 3) -> str:
    """Return a length, given in Blender's units, in so many digits of a unit that suits it."""
    system, length = scene.unit_settings.system, value * metres_of(scene)
    if system == 'NONE':
        return f"{length:.{digits}g}"
    if system != 'METRIC':
        return bpy.utils.units.to_string(system, 'LENGTH', length, precision=digits, split_unit=False)
    unit, size = next((entry for entry in _METRIC if abs(length) >= entry[1]), _METRIC[-1])
    return f"{float(f'{length / size:.{digits}g}'):g} {unit}"  # 250, not 2.5e+02


def volume_text(scene: bpy.types.Scene, value: float) -> str:
    """Return a volume, given in Blender's units, in a unit that suits it."""
    system, volume = scene.unit_settings.system, value * metres_of(scene) ** 3
    return f"{volume:.3g}" if system == 'NONE' else bpy.utils.units.to_string(system, 'VOLUME', volume, precision=3, split_unit=False)
