# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The turntable: an object turns in equal steps before one camera, or before one at each of several elevations.

The outer loop of the plan is the pose, the inner one the cameras. Each camera has a headlight in its own centre, lit
for its own frames: one light at a time is free of noise at one sample, and nothing the camera sees lies in shadow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Value
from . import devices, rig
from .objects import Subject, add_object
from .readback import camera_of
from .timeline import bind_cameras, keyframe_steps, switch_light

OPTIONS = (
    Option("views", 24, "How many poses of the table, evenly round the circle, each camera captures",
           minimum=1, maximum=3600),
    rig.ELEVATIONS,
    *rig.CAMERA_OPTIONS,
    Option("backdrop", "none", "What is behind the object", choices={
        "none": "nothing: the pictures' alpha is the silhouette",
        "blue": "a blue screen and platter, for chroma keying",
        "black": "a black screen and platter"}),
    Option("plate", True, "With a backdrop, also capture it without the object"),
    rig.SAMPLES,
    rig.FIT,
)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        The elevations or the distance cannot be used, or the object cannot be staged.
    """
    elevations, backdrop = rig.parse_elevations(options["elevations"]), options["backdrop"]
    # Persistent data pays only where nothing but the camera changes; the object turns here.
    rig.apply_settings(scene, options, frames=options["views"] * len(elevations), transparent=backdrop == "none")
    turntable = devices.add_turntable(stage)
    points = add_object(scene, stage, turntable, subject, fit=options["fit"])
    cameras = rig.add_cameras(stage, len(elevations), options)
    distance = rig.place_cameras(scene, cameras, elevations, points, np.array(turntable.location), options["distance"])
    radius = rig.radius_of(points)
    turntable.empty_display_size = radius * 1.4
    devices.add_platter(stage, turntable, radius * 1.15, backdrop)
    if backdrop != "none":
        _add_backdrops(scene, stage, cameras, elevations, points, distance, backdrop)
    nearest = max(distance - radius, 0.1 * distance)
    lights = [devices.add_light(stage, camera, i, nearest) for i, camera in enumerate(cameras, start=1)]
    _plan(scene, turntable, cameras, lights, options["views"])


def _add_backdrops(scene: bpy.types.Scene, stage: bpy.types.Collection, cameras: Sequence[bpy.types.Object],
                   elevations: Sequence[float], points: np.ndarray, distance: float, backdrop: str) -> None:
    for elevation in elevations:
        if rig.middle_of(points)[2] + distance * math.sin(elevation) < 0:
            raise ScanstageError(f"option elevations: at {math.degrees(elevation):g} degrees the platter would hide "
                                 "the object; stay above the table, or use backdrop none")
    for i, camera in enumerate(cameras, start=1):
        devices.add_backdrop(stage, camera, camera_of(scene, camera), distance + 2 * rig.reach_of(points), backdrop, i)


def _plan(scene: bpy.types.Scene, turntable: bpy.types.Object, cameras: list[bpy.types.Object],
          lights: list[bpy.types.Object], views: int) -> None:
    rings = len(cameras)
    angles = [2 * math.pi * (frame // rings) / views for frame in range(views * rings)]
    keyframe_steps(turntable, "rotation_euler", angles, index=2)
    bind_cameras(scene, cameras * views)
    if rings > 1:
        for i, light in enumerate(lights):
            switch_light(light.data, [float(frame % rings == i) for frame in range(views * rings)])
