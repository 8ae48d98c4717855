# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of shadow carving: a turntable before a camera with an array of lights round it (Savarese et al., 2007).

At every pose each camera takes one picture under all its lights, for silhouette and colour, and then one under each
light alone, whose shadows tell of the concavities that no silhouette shows. Within a pose only Value nodes change, so
that the renderer keeps the geometry.

All lights together, each at its share of the power, expose the picture as one light alone does. At one sample a pixel
the renderer draws one of the lights at random, so those frames take as many samples as lights: a power of two, which the
sampler divides evenly among them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Unit, Value
from . import devices, rig
from .objects import Subject, add_object
from .timeline import bind_cameras, keyframe_scene, keyframe_steps, switch_light

_SPREAD = math.radians(30)  # methods that carve by shadows gain most between 20 and 45 degrees
_SOFT_SAMPLES = 16
SHAPES = {
    "ring": "evenly on a circle round the camera",
    "arc": "on a half circle, from the camera's left over it to its right",
    "grid": "on a square grid round the camera",
}
OPTIONS = (
    Option("views", 24, "How many poses of the table, evenly round the circle, each camera captures",
           minimum=1, maximum=3600),
    Option("lights", 4, "How many lights stand round each camera; a pose takes one picture for each, and one under all; a "
           "single one gets a headlight beside it for the picture under all",
           minimum=1, maximum=32),
    Option("array", "ring", "How the lights are arranged", choices=SHAPES),
    Option("array_radius", 0.0, "From the camera to the outermost lights; 0 puts them 30 degrees off its axis, as seen from the "
           "object: nearer, shadows hide behind what casts them, farther out they are few",
           unit=Unit.LENGTH, minimum=0.0, maximum=1e6),
    Option("array_distance", 0.0, "From the plane of the lights to the object's middle, along the camera's axis; 0 is the camera's "
           "own distance", unit=Unit.LENGTH, minimum=0.0, maximum=1e6),
    Option("light_size", 0.0, f"Radius of the lamps: above 0 shadows have a penumbra, which takes at least {_SOFT_SAMPLES} samples a pixel",
           unit=Unit.LENGTH, minimum=0.0, maximum=1e3),
    rig.ELEVATIONS,
    *rig.CAMERA_OPTIONS,
    rig.SAMPLES,
    rig.FIT,
)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        The elevations, the distance or the array cannot be used, or the object cannot be staged.
    """
    elevations = rig.parse_elevations(options["elevations"])
    if options["light_size"] > 0:
        options = {**options, "samples": max(options["samples"], _SOFT_SAMPLES)}
    frames = options["views"] * len(elevations) * (options["lights"] + 1)
    rig.apply_settings(scene, options, frames=frames, transparent=True, persistent=True)
    turntable = devices.add_turntable(stage)
    points = add_object(scene, stage, turntable, subject, fit=options["fit"])
    cameras = rig.add_cameras(stage, len(elevations), options)
    distance = rig.place_cameras(scene, cameras, elevations, points, np.array(turntable.location), options["distance"])
    radius = rig.radius_of(points)
    turntable.empty_display_size = radius * 1.4
    devices.add_platter(stage, turntable, radius * 1.15, "none")
    offsets = _offsets(options, distance, rig.reach_of(points))
    if len(offsets) == 1:  # a headlight, so that the picture under all lights shows what lies in the only shadow
        offsets = np.concatenate((offsets, np.zeros((1, 3))))
    lights = [devices.add_light(stage, camera, 1 + i * len(offsets) + j, _nearest(offset, distance, rig.reach_of(points)), offset=offset,
                                size=options["light_size"])
              for i, camera in enumerate(cameras) for j, offset in enumerate(offsets)]
    _plan(scene, turntable, cameras, lights, options)


def light_offsets(shape: str, count: int, radius: float) -> np.ndarray:
    """Return the (count, 2) places, right and up of the camera, of an array whose outermost lights are at ``radius``."""
    if shape == "grid":
        side = math.ceil(math.sqrt(count))
        rows = -(-count // side)
        column, row = np.arange(count) % side, np.arange(count) // side
        places = np.column_stack((column - (side - 1) / 2, row - (rows - 1) / 2))
        return places * (radius / max(np.linalg.norm(places, axis=1).max(), 0.5))
    turn = np.pi * (np.arange(count) + 0.5) / count if shape == "arc" else 2 * np.pi * (np.arange(count) + 0.5) / count
    return radius * np.column_stack((np.cos(turn), np.sin(turn)))


def _offsets(options: Mapping[str, Value], distance: float, reach: float) -> np.ndarray:
    """Return the (count, 3) places of the lights in a camera's own axes: right, up, backward."""
    along = options["array_distance"] or distance
    radius = options["array_radius"] or along * math.tan(_SPREAD)
    places = light_offsets(options["array"], options["lights"], radius)
    offsets = np.column_stack((places, np.full(len(places), along - distance)))
    if np.hypot(np.linalg.norm(places, axis=1), along).min() <= reach + options["light_size"]:
        raise ScanstageError(f"option array_distance: {along:g} m puts a light inside the object, which reaches {reach:g} m from its "
                             "middle; use more, or 0 for the camera's own distance")
    return offsets


def _nearest(offset: np.ndarray, distance: float, reach: float) -> float:
    """Return how near a light comes to the object."""
    away = float(np.linalg.norm(offset - (0, 0, -distance)))
    return max(away - reach, 0.1 * away)


def _plan(scene: bpy.types.Scene, turntable: bpy.types.Object, cameras: Sequence[bpy.types.Object],
          lights: Sequence[bpy.types.Object], options: Mapping[str, Value]) -> None:
    views, each = options["views"], len(lights) // len(cameras)
    shape = views, len(cameras), options["lights"] + 1  # pictures: under all lights, then under each of the array
    pose, camera, lit = np.unravel_index(np.arange(np.prod(shape)), shape)
    keyframe_steps(turntable, "rotation_euler", (2 * math.pi * pose / views).tolist(), index=2)
    bind_cameras(scene, [cameras[i] for i in camera])
    for i, light in enumerate(lights):
        owner, number = divmod(i, each)
        strength = np.where(lit == 0, 1 / each, (lit == number + 1) * 1.0) * (camera == owner)
        switch_light(light.data, strength.tolist())
    even = max(1 << (each - 1).bit_length(), options["samples"])
    keyframe_scene(scene, "cycles.samples", np.where(lit == 0, even, options["samples"]).tolist())
