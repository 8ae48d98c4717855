# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of a laser scanner: a sheet of light sweeps over the object beside a camera (method: `laser-stripe`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ..options import Option, Unit, Value
from . import devices, laser, rig, scanner
from .objects import Subject
from .timeline import keyframe_steps

_STEPS_PER_WIDTH = 6.0  # a point is lit in so many frames: enough to place the beam's middle in time
_FAN = 1.3  # times the angle that the object spans
OPTIONS = (
    scanner.VIEWS,
    Option("lines", 120, "How many places of the laser's line at each pose, evenly over the object", minimum=2, maximum=10000),
    Option("sweep", "angle", "How the line moves", choices={
        "angle": "a mirror turns it: the laser stands still",
        "translation": "the laser moves to its right on a rail"}),
    Option("width", 0.0, f"Of the laser's sheet, four standard deviations of its profile; 0 is {_STEPS_PER_WIDTH:g} steps of the sweep, so "
           "that every point sees the profile pass in time", unit=Unit.LENGTH, minimum=0.0, maximum=10.0),
    *scanner.COMMON,
)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        The distance cannot be used, or the object cannot be staged.
    """
    lines = options["lines"]
    bench = scanner.build_bench(scene, stage, subject, options, frames=options["views"] * (1 + lines))
    reach = rig.reach_of(bench.points)
    width = options["width"] or _STEPS_PER_WIDTH * 2 * reach / lines
    span = 2 * math.asin(reach / bench.distance)
    made = laser.add_laser(stage, 1, width=width, fan=min(_FAN * span, math.radians(170)))
    devices.point(made, bench.target + rig.offset_of(bench.distance, options["elevation"], options["angle"]), bench.target)
    laser.update_fan(made, bench.distance)
    shown = scanner.plan_bench(bench, options["views"], lines)
    share = (np.arange(lines) + 0.5) / lines - 0.5
    laser.sweep(made.data, _held([0.0] * lines if options["sweep"] == "translation" else (share * span).tolist(), shown),
                [number is not None for number in shown])
    if options["sweep"] == "translation":
        rail = np.array(made.matrix_basis)[:3, 0] * 2 * reach
        start = np.array(made.location)
        for axis in range(3):
            keyframe_steps(made, "location", _held((start[axis] + share * rail[axis]).tolist(), shown), index=axis)


def _held(values: Sequence[float], shown: Sequence[int | None]) -> list[float]:
    """Return a value for each frame; under the headlight the laser already waits where its sweep begins."""
    return [values[number or 0] for number in shown]
