# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stick whose shadow passes over a desk: an ordinary rod with keys, that knows which frame of which sweep it is in.

The camera does not see it, as one sees to when scanning with a real one; the lamp does. What a frame shows are pattern
fields ``kind`` ``stick-shadow``; see `addon.reconstruction.active.patterns`.
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

_SWEEPS = "scanstage_sweeps"  # a property of the stick: how many frames a sweep has, the known planes and the strips
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


def sweep(stick: bpy.types.Object, places: Sequence[Sequence[float]], steps: int, fields: Mapping[str, object], *, start: int = 1) -> None:
    """Move a stick to one place a frame.

    Parameters
    ----------
    stick : bpy.types.Object
    places : sequence of (3,) sequences
        Where its middle is in the world.
    steps : int
        Frames of one sweep.
    fields : mapping
        ``plane``, ``strips`` and perhaps ``wall``, as every frame's pattern has them.
    """
    stick[_SWEEPS] = json.dumps({"steps": steps, "start": start, "fields": dict(fields)})
    stick.location = places[0]
    for axis in range(3):
        keyframe_steps(stick, "location", [place[axis] for place in places], index=axis, start=start)


def stick_fields(stick: bpy.types.Object, frame: int) -> tuple[str, Mapping[str, object]] | None:
    """Return the id and the fields of what a stick does at a frame, or None if it does nothing there."""
    if _SWEEPS not in stick or stick.hide_render:
        return None
    known = json.loads(stick[_SWEEPS])
    number, index = divmod(frame - known["start"], known["steps"])
    return f"stick-{number}-{index:04d}", {"kind": "stick-shadow", "sweep": number, "index": index, **known["fields"]}
