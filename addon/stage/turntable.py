# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The turntable: an object turns in equal steps before one camera, or before one at each of several elevations.

The outer loop of the plan is the pose, the inner one the cameras. Each camera has a headlight in its own centre, lit
for its own frames: one light at a time is free of noise at one sample, and nothing the camera sees lies in shadow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import bpy
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Unit, Value
from ..reconstruction.geometry import Camera
from . import devices, ownership, scene_settings
from .objects import Subject, add_object
from .readback import camera_of
from .timeline import bind_cameras, keyframe_steps, switch_light

OPTIONS = (
    Option("views", 24, "How many poses of the table, evenly round the circle, each camera captures",
           minimum=1, maximum=3600),
    Option("elevations", "20", "How high above the table's plane the cameras stand, in degrees: one number, or several "
           "separated by commas for one ring of views each"),
    Option("distance", 0.0, "From the cameras to the object's middle; 0 chooses one from which the object fills the "
           "picture at every pose", unit=Unit.LENGTH, minimum=0.0, maximum=1e6),
    Option("focal_length", 50.0, "Of the lens; longer flattens the perspective", unit=Unit.MILLIMETRES,
           minimum=1.0, maximum=5000.0),
    Option("sensor_width", 36.0, "The sensor's size along the picture's longer side", unit=Unit.MILLIMETRES,
           minimum=1.0, maximum=500.0),
    Option("resolution_x", 640, "Width of the pictures", unit=Unit.PIXELS, minimum=16, maximum=16384),
    Option("resolution_y", 480, "Height of the pictures", unit=Unit.PIXELS, minimum=16, maximum=16384),
    Option("backdrop", "none", "What is behind the object", choices={
        "none": "nothing: the pictures' alpha is the silhouette",
        "blue": "a blue screen and platter, for chroma keying",
        "black": "a black screen and platter"}),
    Option("plate", True, "With a backdrop, also capture it without the object"),
    Option("samples", 1, "Per pixel, all through its centre; one is free of noise, more only help materials that scatter light",
           minimum=1, maximum=4096),
    Option("fit", 0.0, "Scale a built-in object or file so that its largest dimension is this; 0 keeps its own units",
           unit=Unit.LENGTH, minimum=0.0, maximum=1e6),
)

_STEEPEST = math.radians(85)  # beyond, "z upward in the picture" loses its meaning
_MOST_RINGS = 16
_MARGIN = 0.06  # of the picture, kept free on each side


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        The elevations or the distance cannot be used, or the object cannot be staged.
    """
    elevations = parse_elevations(options["elevations"])
    scene.world = devices.dark_world()
    apply_settings(scene, options, frames=options["views"] * len(elevations))
    turntable = devices.add_turntable(stage)
    points = add_object(scene, stage, turntable, subject, fit=options["fit"])
    cameras = [devices.add_camera(stage, i, focal_length=options["focal_length"], sensor_width=options["sensor_width"])
               for i in range(1, len(elevations) + 1)]
    distance = _place(scene, cameras, elevations, points, np.array(turntable.location), options)
    radius = float(np.linalg.norm(points[:, :2], axis=1).max())
    turntable.empty_display_size = radius * 1.4
    devices.add_platter(stage, turntable, radius * 1.15, options["backdrop"])
    if options["backdrop"] != "none":
        reach = float(np.linalg.norm(points - middle_of(points), axis=1).max())
        for i, camera in enumerate(cameras, start=1):
            devices.add_backdrop(stage, camera, camera_of(scene, camera), distance + 2 * reach, options["backdrop"], i)
    nearest = max(distance - radius, 0.1 * distance)
    lights = [devices.add_headlight(stage, camera, i, nearest) for i, camera in enumerate(cameras, start=1)]
    _plan(scene, turntable, cameras, lights, options["views"])


def parse_elevations(text: str) -> list[float]:
    """Return the elevations, in radians, that a user typed in degrees.

    Raises
    ------
    ScanstageError
        They are not numbers, too many, too steep, or two are equal.
    """
    try:
        elevations = [math.radians(float(part)) for part in text.split(",")]
    except ValueError:
        raise ScanstageError(f"option elevations: {text!r} is not a number of degrees, or several separated by "
                             "commas") from None
    if len(set(elevations)) != len(elevations) or len(elevations) > _MOST_RINGS:
        raise ScanstageError(f"option elevations: {text!r} must be at most {_MOST_RINGS} different angles")
    if not all(abs(elevation) <= _STEEPEST + 1e-9 for elevation in elevations):
        raise ScanstageError(f"option elevations: {text!r} must lie between -85 and 85 degrees")
    return elevations


def fitting_distance(lens: Camera, elevation: float, points: np.ndarray) -> float:
    """Return from how far a camera sees all of a turning object.

    Parameters
    ----------
    lens : Camera
        For its K and size only.
    elevation : float
        Of the camera above the plane of the table, in radians.
    points : (n, 3) array
        The object in the object frame, less the point that the camera looks at.

    Returns
    -------
    float
        The distance to that point at which every point stays, at every pose, a margin inside the picture.
    """
    # Every point turns on a circle; of equally high ones only the outermost counts, so a few hundred heights do.
    turns = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    height, radius = points[:, 2], np.linalg.norm(points[:, :2], axis=1)
    order = np.argsort(radius)
    step = max(np.ptp(height) / 200, 1e-12)
    outermost = dict(zip(np.round(height[order] / step).astype(int).tolist(), order.tolist(), strict=True))
    height, radius = (values[list(outermost.values())][:, None] for values in (height, radius))
    right, toward = radius * np.sin(turns), radius * np.cos(turns)
    depth = toward * np.cos(elevation) + height * np.sin(elevation)  # how much nearer than the point looked at
    up = height * np.cos(elevation) - toward * np.sin(elevation)
    (width, tall), K = lens.size, lens.K
    slopes = ((right, (width - 0.5 - K[0, 2]) / K[0, 0]), (-right, (K[0, 2] + 0.5) / K[0, 0]),
              (-up, (tall - 0.5 - K[1, 2]) / K[1, 1]), (up, (K[1, 2] + 0.5) / K[1, 1]))
    return float(max((depth + offset / (slope * (1 - 2 * _MARGIN))).max() for offset, slope in slopes))


def apply_settings(scene: bpy.types.Scene, options: Mapping[str, Value], *, frames: int,
                   only_cameras_change: bool = False) -> None:
    """Write a preset's picture options and its plan's length into the scene.

    Parameters
    ----------
    scene : bpy.types.Scene
    options : mapping
        With ``samples`` and the resolution; without a ``backdrop`` there is none.
    frames : int
    only_cameras_change : bool
        Whether nothing else moves or is switched in the plan: the geometry is then sent to the renderer once only.
    """
    scene_settings.apply(scene, {
        "cycles.samples": options["samples"],
        "render.film_transparent": options.get("backdrop", "none") == "none",
        "render.filepath": "//capture/images/",  # with the frame's number: what `capture` calls its pictures
        "render.resolution_x": options["resolution_x"],
        "render.resolution_y": options["resolution_y"],
        "render.resolution_percentage": 100,
        "render.pixel_aspect_x": 1.0,
        "render.pixel_aspect_y": 1.0,
        "render.use_persistent_data": only_cameras_change,
        "render.frame_map_old": 100,
        "render.frame_map_new": 100,
        "frame_start": 1,
        "frame_end": frames,
        "frame_step": 1,
    })


def middle_of(points: np.ndarray) -> np.ndarray:
    """Return the point of the axis at half the object's height, at which the cameras look; in the object frame."""
    return np.array([0.0, 0.0, (points[:, 2].min() + points[:, 2].max()) / 2])


def _place(scene: bpy.types.Scene, cameras: list[bpy.types.Object], elevations: list[float], points: np.ndarray,
           table: np.ndarray, options: Mapping[str, Value]) -> float:
    """Aim the cameras at the object's middle, all from one distance, which is returned."""
    middle = middle_of(points)
    distance = options["distance"] or max(fitting_distance(camera_of(scene, camera), elevation, points - middle)
                                          for camera, elevation in zip(cameras, elevations, strict=True))
    reach = float(np.linalg.norm(points - middle, axis=1).max())
    if distance <= reach:
        raise ScanstageError(f"option distance: {distance:g} m puts the camera inside the object, which reaches "
                             f"{reach:g} m from its middle; use more, or 0 for automatic")
    for camera, elevation in zip(cameras, elevations, strict=True):
        # From the front, which in Blender is -y.
        offset = distance * np.array([0.0, -math.cos(elevation), math.sin(elevation)])
        if options["backdrop"] != "none" and (middle + offset)[2] < 0:
            raise ScanstageError(f"option elevations: at {math.degrees(elevation):g} degrees the platter would hide "
                                 "the object; stay above the table, or use backdrop none")
        devices.aim(camera, table + middle + offset, table + middle)
    bpy.context.view_layer.update()  # parts are fitted to the cameras' world matrices
    return distance


def _plan(scene: bpy.types.Scene, turntable: bpy.types.Object, cameras: list[bpy.types.Object],
          lights: list[bpy.types.Object], views: int) -> None:
    rings = len(cameras)
    angles = [2 * math.pi * (frame // rings) / views for frame in range(views * rings)]
    keyframe_steps(turntable, "rotation_euler", angles, index=2)
    bind_cameras(scene, cameras * views)
    if rings > 1:
        for i, light in enumerate(lights):
            switch_light(light.data, [frame % rings == i for frame in range(views * rings)])
            ownership.mark(light.data.node_tree.animation_data.action)
