# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of passive stereo: two cameras side by side before a turntable, under one light between them (method: `stereo`)."""

from __future__ import annotations

import math
from collections.abc import Mapping

import bpy
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Unit, Value
from . import devices, rig, scanner
from .objects import Subject, add_object
from .timeline import bind_cameras, keyframe_steps

_BASELINE = 1 / 8  # of the distance
OPTIONS = (
    Option("views", 8, "How many poses of the table, evenly round the circle, both cameras capture", minimum=1, maximum=3600),
    Option("baseline", 0.0, "From camera to camera; 0 is an eighth of their distance. More is more precise in depth, and harder to match",
           unit=Unit.LENGTH, minimum=0.0, maximum=1e6),
    Option("axes", "parallel", "Where the cameras look", choices={
        "parallel": "straight ahead, with lenses shifted towards each other: the pictures are rectified as they are",
        "converging": "both at the object's middle"}),
    scanner.ELEVATION,
    *rig.CAMERA_OPTIONS,
    rig.SAMPLES,
    rig.FIT,
)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        The distance or baseline cannot be used, or the object cannot be staged.
    """
    views, elevation = options["views"], options["elevation"]
    rig.apply_settings(scene, options, frames=2 * views, transparent=True)
    turntable = devices.add_turntable(stage)
    points = add_object(scene, stage, turntable, subject, fit=options["fit"])
    cameras = rig.add_cameras(stage, 2, options)
    table = np.array(turntable.location)
    distance = rig.place_cameras(scene, cameras, [elevation] * 2, points, table, options["distance"])
    baseline = options["baseline"] or _BASELINE * distance
    if baseline >= distance:
        raise ScanstageError(f"option baseline: {baseline:g} m is not less than the cameras' distance of {distance:g} m; use less")
    target = table + rig.middle_of(points)
    _part(cameras, target, distance, elevation, baseline, options)
    radius = rig.radius_of(points)
    turntable.empty_display_size = radius * 1.4
    devices.add_platter(stage, turntable, radius * 1.15, "none")
    devices.add_light(stage, cameras[0], 1, max(distance - radius, 0.1 * distance), offset=(baseline / 2, 0.0, 0.0))
    keyframe_steps(turntable, "rotation_euler", [2 * math.pi * (frame // 2) / views for frame in range(2 * views)], index=2)
    bind_cameras(scene, cameras * views)


def _part(cameras: list[bpy.types.Object], target: np.ndarray, distance: float, elevation: float, baseline: float,
          options: Mapping[str, Value]) -> None:
    """Move two cameras that stand in one place half a baseline to the left and to the right."""
    middle = target + rig.offset_of(distance, elevation)
    for camera, side in zip(cameras, (-1, 1), strict=True):
        aside = np.array((side * baseline / 2, 0.0, 0.0))  # the cameras' common x axis is the world's
        devices.aim(camera, middle + aside, target + (aside if options["axes"] == "parallel" else 0.0))
        if options["axes"] == "parallel":
            camera.data.shift_x = -side * baseline / 2 / distance * options["focal_length"] / options["sensor_width"]
    bpy.context.view_layer.update()
