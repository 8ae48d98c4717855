# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Many cameras above an object that stands still in even light: the rig of voxel coloring (Seitz and Dyer, 1997).

All camera centres lie above the object, so no point of it is in their convex hull: the ordinal visibility constraint
holds. The light is fixed to the object and shadowless, so a matte surface looks the same from every camera, which is
what photo-consistency assumes; the other materials show what becomes of it where that is not so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import bpy
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Unit, Value
from . import devices, rig, scene_settings
from .materials import matte, textured
from .objects import Subject, add_object, texture_for
from .readback import camera_of
from .timeline import bind_cameras

OPTIONS = (
    Option("arrangement", "above", "Where the cameras stand, all of them above the object and equally far", choices={
        "above": "in one ring, looking down",
        "arc": "in the front half of that ring: the back stays unseen",
        "dome": "evenly over a dome, from that ring's elevation almost to the zenith"}),
    Option("views", 21, "How many cameras, each of which captures once", minimum=2, maximum=512),
    Option("elevation", math.radians(30), "How high the ring, or the dome's rim, stands above the plane of the object's middle",
           unit=Unit.ANGLE, minimum=math.radians(10), maximum=math.radians(85)),
    Option("material", "own", "What the object is made of", choices={
        "own": "its own materials; those of the built-in objects are matte with a texture",
        "matte": "a matte texture, for objects whose own material is shiny or plain",
        "shiny": "the same texture, glazed: highlights differ from view to view",
        "textureless": "one matte colour: neighbouring points look the same"}),
    *rig.CAMERA_OPTIONS,
    rig.SAMPLES,
    rig.FIT,
)

_STEEPEST = math.radians(85)  # beyond, "z upward in the picture" loses its meaning
_CLEARANCE = 1.05  # how many times higher than the object's top the cameras stand at least, both from its middle
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
_PLAIN = (0.5, 0.46, 0.4)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        The distance puts a camera no higher than the object, or the object cannot be staged.
    """
    rig.apply_settings(scene, options, frames=options["views"], transparent=True, persistent=True)
    scene_settings.apply(scene, scene_settings.AMBIENT_LIGHT)
    table = devices.add_turntable(stage)
    points = add_object(scene, stage, table, subject, fit=options["fit"])
    radius = rig.radius_of(points)
    table.empty_display_size = radius * 1.4
    devices.add_platter(stage, table, radius * 1.15, "none")
    devices.add_even_light(stage, scene.world)
    _give_material(scene, table, subject, float(np.ptp(points, axis=0).max()), options["material"])
    cameras = rig.add_cameras(stage, options["views"], options)
    _place(scene, cameras, points, np.array(table.location), options)
    bind_cameras(scene, cameras)


def directions(arrangement: str, views: int, elevation: float) -> np.ndarray:
    """Return the unit vectors from the object's middle to the cameras.

    Parameters
    ----------
    arrangement : str
        A choice of the option.
    views : int
    elevation : float
        Of the lowest camera above the plane of the middle, in radians.

    Returns
    -------
    (views, 3) array
        The ring and the dome begin, and the arc has its middle, at the front, which in Blender is -y.
    """
    step = np.arange(views)
    heights = np.full(views, math.sin(elevation))
    if arrangement == "above":
        azimuths = 2 * math.pi * step / views
    elif arrangement == "arc":
        azimuths = math.pi * (step / (views - 1) - 0.5)
    else:
        # Equal steps in height are equal areas of the sphere (Archimedes), the golden angle spreads them round it.
        heights = np.linspace(math.sin(elevation), math.sin(_STEEPEST), views)
        azimuths = _GOLDEN_ANGLE * step
    across = np.sqrt(1 - heights ** 2)
    return np.stack((across * np.sin(azimuths), -across * np.cos(azimuths), heights), axis=1)


def _give_material(scene: bpy.types.Scene, table: bpy.types.Object, subject: Subject, size: float, kind: str) -> None:
    """Let the renders show another material; the objects keep theirs, which may be the user's."""
    if kind == "own":
        return
    name = f"Scanstage {kind.title()}"
    if kind == "textureless":
        material = matte(name, _PLAIN)
    else:
        material = textured(name, texture_for(subject, size), within=table, shiny=kind == "shiny")
    for layer in scene.view_layers:
        layer.material_override = material


def _place(scene: bpy.types.Scene, cameras: list[bpy.types.Object], points: np.ndarray, table: np.ndarray,
           options: Mapping[str, Value]) -> None:
    """Aim the cameras at the object's middle, all from one distance."""
    middle = rig.middle_of(points)
    away = directions(options["arrangement"], len(cameras), options["elevation"])
    lens, lowest = camera_of(scene, cameras[0]), away[:, 2].min()
    top = points[:, 2].max() - middle[2]
    distance = options["distance"] or max(
        top * _CLEARANCE / lowest, *(rig.fitting_distance(lens, math.asin(sine), points - middle)
                                     for sine in np.unique(away[:, 2])))
    if distance * lowest <= top:
        raise ScanstageError(f"option distance: at {distance:g} m and {math.degrees(options['elevation']):g} degrees a camera is "
                             f"no higher than the object's top, and voxel coloring needs all above it; use at least "
                             f"{top * _CLEARANCE / lowest:.3g} m, a higher elevation, or 0 for automatic")
    for camera, direction in zip(cameras, away, strict=True):
        devices.aim(camera, table + middle + distance * direction, table + middle)
