# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stick whose shadow passes over a desk: an ordinary rod with keys, that knows which sweep a frame belongs to.

The camera does not see it, as one sees to when scanning with a real one; the lamp does. The frames of a sweep share a pattern
of the ``kind`` ``shadow``; see `addon.reconstruction.active.desk_shadow`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import bpy

# isort: split
import bmesh  # exists once bpy is imported
from mathutils import Matrix

from . import ownership
from .materials import matte
from .timeline import keyframe_steps

_SWEEPS = "scanstage_sweeps"  # a property of the stick: how many frames a sweep has, and the strips
_COLOR = (0.35, 0.2, 0.1)
_SIDES = 24


def add_stick(stage: bpy.types.Collection, *, radius: float, length: float) -> bpy.types.Object:
    """Add a rod along y."""
    mesh = bpy.data.meshes.new("Scanstage Stick")
    rod = bmesh.new()
    bmesh.ops.create_cone(rod, cap_ends=True, segments=_SIDES, radius1=radius, radius2=radius, depth=length,
                          matrix=Matrix.Rotation(1.5707963267948966, 4, "X"))
    rod.to_mesh(mesh)
    rod.free()
    mesh.materials.append(matte("Scanstage Stick", _COLOR))
    stick = ownership.add(stage, "Scanstage Stick", mesh, "stick")
    stick.visible_camera = False
    return stick


def sweep(stick: bpy.types.Object, places: Sequence[Sequence[float]], steps: int, strips: Sequence[Mapping[str, object]], *,
          start: int = 1) -> None:
    """Move a stick to one place a frame.

    Parameters
    ----------
    stick : bpy.types.Object
    places : sequence of (3,) sequences
        Where its middle is in the world.
    steps : int
        Frames of one sweep.
    strips : sequence of mapping
        ``rows`` of the picture and the ``plane`` that they show, as every frame's pattern has them.
    start : int
    """
    stick[_SWEEPS] = json.dumps({"steps": steps, "start": start, "strips": list(strips)})
    stick.location = places[0]
    for axis in range(3):
        keyframe_steps(stick, "location", [place[axis] for place in places], index=axis, start=start)


def stick_fields(stick: bpy.types.Object, frame: int) -> tuple[str, Mapping[str, object]] | None:
    """Return the id and the fields of what a stick does at a frame, or None if it does nothing there."""
    if _SWEEPS not in stick or stick.hide_render:
        return None
    known = json.loads(stick[_SWEEPS])
    number = (frame - known["start"]) // known["steps"]
    return f"shadow-{number}", {"kind": "shadow", "sweep": number, "strips": known["strips"]}
