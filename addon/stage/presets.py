# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rigs that can be built: one table, read by the command line, the Stage panel, the tests and the manual.

A new preset is one module, with its options and its ``build``, and one line here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import bpy

from ..options import Option, Value
from . import (
    calibration,
    color_stripes,
    depth_sensor,
    desk_shadow,
    gray_code,
    laser_scanner,
    phase_shift,
    shadow_array,
    stereo_pair,
    turntable,
    voxel_coloring,
)
from .objects import Subject

Build = Callable[[bpy.types.Scene, bpy.types.Collection, Subject, Mapping[str, Value]], None]


@dataclass(frozen=True)
class Preset:
    """A rig.

    Parameters
    ----------
    name : str
        As the user types it.
    label, description : str
        As a panel shows it: a title, and a sentence without a full stop.
    options : tuple of Option
    build : callable
        ``build(scene, stage, subject, options)`` fills the stage's collection and plans the timeline; every option has
        a checked value.
    """

    name: str
    label: str
    description: str
    options: tuple[Option, ...]
    build: Build


PRESETS: Mapping[str, Preset] = MappingProxyType({preset.name: preset for preset in (
    Preset("turntable", "Turntable", "A turning table before one camera, or one at each elevation, with a headlight",
           turntable.OPTIONS, turntable.build),
    Preset("shadow-array", "Shadow Array", "A turning table before one camera, or several, with an array of lights round each",
           shadow_array.OPTIONS, shadow_array.build),
    Preset("stereo-pair", "Stereo Pair", "A turning table before two cameras side by side", stereo_pair.OPTIONS, stereo_pair.build),
    Preset("laser-scanner", "Laser Scanner", "A turning table before a camera, with a laser line that sweeps over the object",
           laser_scanner.OPTIONS, laser_scanner.build),
    Preset("gray-code", "Gray Code", "A turning table before a camera and a projector of black and white stripes",
           gray_code.OPTIONS, gray_code.build),
    Preset("phase-shift", "Phase Shift", "A turning table before a camera and a projector of sinusoids",
           phase_shift.OPTIONS, phase_shift.build),
    Preset("depth-sensor", "Depth Sensor", "A turning table before a camera and a projector of pseudo-random dots, close together",
           depth_sensor.OPTIONS, depth_sensor.build),
    Preset("color-stripes", "Color Stripes", "A turning table before a camera and a projector of coloured stripes, one picture a pose",
           color_stripes.OPTIONS, color_stripes.build),
    Preset("desk-shadow", "Desk Shadow", "A lamp, a desk and a stick whose shadow passes over the object",
           desk_shadow.OPTIONS, desk_shadow.build),
    Preset("calibration", "Calibration", "A board in many poses before a camera and a projector, then on the turning table; no object",
           calibration.OPTIONS, calibration.build),
    Preset("voxel-coloring", "Voxel Coloring", "Cameras above an object that stands still in even light, as voxel coloring needs them",
           voxel_coloring.OPTIONS, voxel_coloring.build),
)})
