# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of shadow scanning: a lamp, a desk and a stick whose shadow passes over the object (method: `desk-shadow`).

The lamp stands to one side, the stick between it and the desk; its shadow runs from the front of the desk to the back and
moves across. Rows at the top and at the bottom of the picture show nothing but the desk, or the wall behind it: there the
shadow's edge tells its plane. A second sweep has a lamp on the other side, which reaches what the first leaves dark.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Unit, Value
from ..reconstruction.geometry import Camera
from . import devices, ownership, rig, scanner, stick
from .materials import matte
from .objects import Subject, add_object
from .readback import camera_of
from .timeline import switch_light

_SOFT_SAMPLES = 16
OPTIONS = (
    Option("steps", 80, "Places of the stick in one sweep: more are finer in time", minimum=8, maximum=10000),
    Option("sweeps", 1, "One lamp, or two on either side, one after the other: each leaves a side of the object dark",
           minimum=1, maximum=2),
    Option("wall", False, "Stand a wall behind the object: the lamp need then not be known"),
    Option("lamp_distance", 0.0, "From the object to the lamp; 0 is six times the object's reach", unit=Unit.LENGTH,
           minimum=0.0, maximum=1e6),
    Option("lamp_size", 0.005, f"Radius of the lamp. Above 0 shadows have a penumbra, by which their edge is placed between frames, and "
           f"a pixel takes at least {_SOFT_SAMPLES} samples", unit=Unit.LENGTH, minimum=0.0, maximum=1.0),
    replace(scanner.ELEVATION, default=math.radians(50), minimum=math.radians(25)),
    *rig.CAMERA_OPTIONS,
    rig.SAMPLES,
    rig.FIT,
)
_ROOM = 1.8  # times the distance from which the object would fill the picture
_STRIP = (0.03, 0.10)  # of the picture's height, from its top and from its bottom
_LAMP_ELEVATION = math.radians(50)
_BETWEEN = 0.5  # of the way from the lamp to the desk: where the stick is
_SHADOW = 0.12  # of the sweep: how wide the shadow is, at least
_PENUMBRAS = 4.0  # that the shadow is wide, at least
_DESK, _WALL = (0.62, 0.6, 0.56), (0.6, 0.62, 0.64)
_WIDE = 20.0  # times the object's reach: half of the desk's side


@dataclass(frozen=True)
class _View:
    """What the camera sees of the known planes: corners (2, 2, 3) of the strips' middles, top and bottom, left and right."""

    strips: tuple[tuple[int, int], tuple[int, int]]
    corners: np.ndarray


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        The distance or the lamp's cannot be used, or the object cannot be staged.
    """
    if options["lamp_size"] > 0:
        options = {**options, "samples": max(options["samples"], _SOFT_SAMPLES)}
    sweeps, steps = options["sweeps"], options["steps"]
    rig.apply_settings(scene, options, frames=sweeps * steps, transparent=True, persistent=True)
    table = devices.add_turntable(stage)
    points = add_object(scene, stage, table, subject, fit=options["fit"])
    foot, reach = np.array(table.location), rig.reach_of(points)
    table.empty_display_size = rig.radius_of(points) * 1.4
    camera, = rig.add_cameras(stage, 1, options)
    scene.camera = camera
    elevation = options["elevation"]
    fitting = rig.place_cameras(scene, [camera], [elevation], points, foot, options["distance"])
    if not options["distance"]:
        rig.place_cameras(scene, [camera], [elevation], points, foot, fitting * _ROOM)
    wall = float(foot[1] + points[:, 1].max() + 0.5 * reach) if options["wall"] else None
    _add_planes(stage, foot, reach, wall)
    view = _seen(camera_of(scene, camera), foot[2], wall)
    away = options["lamp_distance"] or 6 * reach
    if away <= 1.5 * reach:
        raise ScanstageError(f"option lamp_distance: {away:g} m puts the lamp, or the stick, into the object, which reaches {reach:g} m "
                             "from its middle; use more, or 0 for automatic")
    target = foot + rig.middle_of(points)
    lamps = [target + away * np.array([side * math.cos(_LAMP_ELEVATION), 0.0, math.sin(_LAMP_ELEVATION)]) for side in (1, -1)[:sweeps]]
    for number, lamp in enumerate(lamps):
        light = devices.add_light(stage, camera, number + 1, away, size=options["lamp_size"])
        light.parent, light.location = None, lamp
        switch_light(light.data, [float(frame // steps == number) for frame in range(sweeps * steps)])
    _add_stick(stage, view, lamps, foot[2], steps, options["lamp_size"], wall)


def _add_planes(stage: bpy.types.Collection, foot: np.ndarray, reach: float, wall: float | None) -> None:
    """Add the desk, and the wall at a y."""
    x, y, z = foot
    half = _WIDE * reach
    depth = wall if wall is not None else y + half
    planes = {"desk": ([(x - half, y - half, z), (x + half, y - half, z), (x + half, depth, z), (x - half, depth, z)], _DESK)}
    if wall is not None:
        planes["wall"] = ([(x - half, wall, z), (x + half, wall, z), (x + half, wall, z + half), (x - half, wall, z + half)], _WALL)
    for role, (corners, color) in planes.items():
        mesh = bpy.data.meshes.new(f"Scanstage {role.title()}")
        mesh.from_pydata([tuple(map(float, corner)) for corner in corners], [], [(0, 1, 2, 3)])
        mesh.materials.append(matte(mesh.name, color))
        ownership.add(stage, mesh.name, mesh, role).hide_select = True


def _seen(camera: Camera, desk: float, wall: float | None) -> _View:
    width, height = camera.size
    near, far = (round(share * height) for share in _STRIP)
    strips = ((near, far), (height - 1 - far, height - 1 - near))
    rows = [sum(strip) / 2 for strip in strips]
    rays = camera.rays(np.array([[(column, row) for column in (0, width - 1)] for row in rows], np.float64))
    distance = (desk - camera.centre[2]) / rays[..., 2]
    if wall is not None:
        distance[0] = (wall - camera.centre[1]) / rays[0, :, 1]
    if not (distance > 0).all():
        raise ScanstageError("option elevation: the camera sees over the desk's edge; raise it, or take a longer focal length")
    return _View(strips, camera.centre + distance[..., None] * rays)


def _add_stick(stage: bpy.types.Collection, view: _View, lamps: list[np.ndarray], desk: float, steps: int, lamp_size: float,
               wall: float | None) -> None:
    """Add the stick and move it so that its shadow crosses both strips, for each lamp from its own side to the other."""
    (left, right), (front, back) = view.corners[1, :, 0], (view.corners[1, 0, 1], view.corners[0, 0, 1])
    span, middle = float(right - left), (front + back) / 2
    penumbra = 2 * lamp_size * (1 - _BETWEEN) / _BETWEEN
    width = max(_SHADOW * span, _PENUMBRAS * penumbra)
    rod = stick.add_stick(stage, radius=_BETWEEN * width / 2, length=1.5 * _BETWEEN * float(back - front))
    share = np.linspace(-0.5, 0.5, steps) * (1 + width / span)
    places = []
    for lamp in lamps:
        across = (left + right) / 2 + np.sign((left + right) / 2 - lamp[0]) * share * span
        shadow = np.column_stack((across, np.full(steps, middle), np.full(steps, desk)))
        places += (lamp + _BETWEEN * (shadow - lamp)).tolist()
    ground, behind = [0.0, 0.0, 1.0, float(desk)], [0.0, -1.0, 0.0, 0.0 if wall is None else -wall]
    (top, bottom) = ({"rows": [first, last + 1]} for first, last in view.strips)
    stick.sweep(rod, places, steps, [{**bottom, "plane": ground}, {**top, "plane": ground if wall is None else behind}])
