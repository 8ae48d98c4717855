# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What rigs of active stereo share: a camera before a turntable, a source of patterns beside it, and the order of their frames.

At every pose of the table the first frame has the headlight and no pattern: silhouette and colour. Then the patterns follow.
Within a pose nothing moves but the numbers of Value nodes, so that the renderer keeps the geometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..options import Option, Unit, Value
from ..reconstruction.active.patterns import PATTERN_SETS, make_patterns
from . import devices, projection, projector, rig
from .objects import Subject, add_object
from .timeline import keyframe_steps, switch_light

_STEEPEST = math.radians(85)
_MIXED_SAMPLES = 64
VIEWS = Option("views", 6, "How many poses of the table, evenly round the circle; all patterns are shown at each", minimum=1, maximum=3600)
ELEVATION = Option("elevation", math.radians(15), "How high above the table's plane the devices stand", unit=Unit.ANGLE,
                   minimum=-_STEEPEST, maximum=_STEEPEST)
ANGLE = Option("angle", math.radians(20), "Between the directions from the object to camera and light source, about the table's axis: more "
               "is more precise in depth, and more of the object is in one's sight and out of the other's",
               unit=Unit.ANGLE, minimum=math.radians(1), maximum=math.radians(120))
AMBIENT = Option("ambient", 0.0, "Other light on the object while patterns are shown, as a share of the headlight: above 0 takes at least "
                 f"{_MIXED_SAMPLES} samples a pixel", minimum=0.0, maximum=10.0)
BOUNCES = Option("bounces", 0, "How often light may go from surface to surface: above 0 concave parts light themselves, which needs "
                 "many samples", minimum=0, maximum=16)
COMMON = (ELEVATION, ANGLE, *rig.CAMERA_OPTIONS, rig.SAMPLES, BOUNCES, rig.FIT)
PROJECTOR_OPTIONS = (
    Option("throw_ratio", 1.4, "Of the projector: distance over width of its picture", minimum=0.1, maximum=20.0),
    Option("projector_x", 1024, "Resolution of the projector across", unit=Unit.PIXELS, minimum=8, maximum=8192),
    Option("projector_y", 768, "Resolution of the projector down", unit=Unit.PIXELS, minimum=8, maximum=8192),
    Option("projector_k1", 0.0, "Radial distortion of the projector's lens: below 0 is a barrel's", minimum=-0.5, maximum=0.5),
)


@dataclass(frozen=True)
class Bench:
    """A turntable with its object before a camera that carries a headlight.

    Parameters
    ----------
    turntable, camera, headlight : bpy.types.Object
    points : (n, 3) array
        The object's vertices in the object frame.
    distance : float
        From the camera to the object's middle.
    """

    turntable: bpy.types.Object
    camera: bpy.types.Object
    headlight: bpy.types.Object
    points: np.ndarray
    distance: float

    @property
    def target(self) -> np.ndarray:
        """The (3,) point of the world at which devices look: the object's middle."""
        return np.array(self.turntable.location) + rig.middle_of(self.points)


def build_bench(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value], *,
                frames: int) -> Bench:
    """Add the table, the object, the camera and its headlight, and the scene's settings for ``frames`` frames.

    Raises
    ------
    ScanstageError
        The distance cannot be used, or the object cannot be staged.
    """
    rig.apply_settings(scene, options, frames=frames, transparent=True, persistent=True, bounces=options["bounces"])
    turntable = devices.add_turntable(stage)
    points = add_object(scene, stage, turntable, subject, fit=options["fit"])
    camera, = rig.add_cameras(stage, 1, options)
    scene.camera = camera
    distance = rig.place_cameras(scene, [camera], [options["elevation"]], points, np.array(turntable.location), options["distance"])
    radius = rig.radius_of(points)
    turntable.empty_display_size = radius * 1.4
    devices.add_platter(stage, turntable, radius * 1.15, "none")
    headlight = devices.add_light(stage, camera, 1, max(distance - radius, 0.1 * distance))
    return Bench(turntable, camera, headlight, points, distance)


def plan_bench(bench: Bench, views: int, patterns: int, *, ambient: float = 0.0) -> list[int | None]:
    """Plan, at each pose of the table, one frame under the headlight and then ``patterns`` frames under a share of it.

    Returns
    -------
    list of int or None
        For each frame the number of its pattern.
    """
    pose, number = np.divmod(np.arange(views * (1 + patterns)), 1 + patterns)
    keyframe_steps(bench.turntable, "rotation_euler", (2 * math.pi * pose / views).tolist(), index=2)
    switch_light(bench.headlight.data, np.where(number == 0, 1.0, ambient).tolist())
    return [i - 1 if i else None for i in number.tolist()]


def add_fitting_projector(stage: bpy.types.Collection, points: np.ndarray, target: np.ndarray,
                          options: Mapping[str, Value]) -> bpy.types.Object:
    """Add a projector to the camera's right, as far away as it needs to light all of the object at every pose.

    Parameters
    ----------
    stage : bpy.types.Collection
    points : (n, 3) array
        The object in the object frame.
    target : (3,) array
        The object's middle in the world.
    options : mapping
        With those of `PROJECTOR_OPTIONS`, ``elevation`` and ``angle``.
    """
    made = projector.add_projector(stage, 1, throw_ratio=options["throw_ratio"], size=(options["projector_x"], options["projector_y"]))
    projector.lens_of(made.data).inputs["K1"].default_value = options["projector_k1"]
    lens = projector.optics_of(made.data)
    distance = rig.fitting_distance(lens, options["elevation"], points - rig.middle_of(points))
    devices.point(made, target + rig.offset_of(distance, options["elevation"], options["angle"]), target)
    projector.update_frustum(made, distance)
    return made


def projector_rig_options(pattern_set: str, **defaults: Value) -> tuple[Option, ...]:
    """Return the options of a rig whose projector shows a set of `PATTERN_SETS`, some of them with defaults of their own."""
    options = (VIEWS, *PATTERN_SETS[pattern_set].options, *PROJECTOR_OPTIONS, *COMMON)
    return tuple(replace(option, default=defaults.get(option.name, option.default)) for option in options)


def build_projector_rig(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value],
                        pattern_set: str) -> None:
    """Build a rig whose projector shows all patterns of a set at each pose.

    ``options`` are those of `projector_rig_options`, and perhaps `AMBIENT`.

    Raises
    ------
    ScanstageError
        The projector cannot show the set, the distance cannot be used, or the object cannot be staged.
    """
    code = {option.name: options[option.name] for option in PATTERN_SETS[pattern_set].options}
    patterns = make_patterns(pattern_set, (options["projector_x"], options["projector_y"]), code)
    ambient = options.get("ambient", 0.0)
    if ambient > 0:  # of two lights the renderer draws one at random for each sample
        options = {**options, "samples": max(options["samples"], _MIXED_SAMPLES)}
    bench = build_bench(scene, stage, subject, options, frames=options["views"] * (1 + len(patterns)))
    made = add_fitting_projector(stage, bench.points, bench.target, options)
    projection.show_patterns(made.data, patterns, plan_bench(bench, options["views"], len(patterns), ambient=ambient))
