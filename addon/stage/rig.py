# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the presets share: the options of a camera, its settings in the scene, and where it stands to see all of an object."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Unit, Value
from ..reconstruction.geometry import Camera
from . import devices, scene_settings
from .readback import camera_of

ELEVATIONS = Option("elevations", "20", "How high above the table's plane the cameras stand, in degrees: one number, or several "
                    "separated by commas for one ring of views each")
CAMERA_OPTIONS = (
    Option("distance", 0.0, "From the cameras to the object's middle; 0 chooses one from which the object fills the "
           "picture at every pose", unit=Unit.LENGTH, minimum=0.0, maximum=1e6),
    Option("focal_length", 50.0, "Of the lens; longer flattens the perspective", unit=Unit.MILLIMETRES,
           minimum=1.0, maximum=5000.0),
    Option("sensor_width", 36.0, "The sensor's size along the picture's longer side", unit=Unit.MILLIMETRES,
           minimum=1.0, maximum=500.0),
    Option("resolution_x", 640, "Width of the pictures", unit=Unit.PIXELS, minimum=16, maximum=16384),
    Option("resolution_y", 480, "Height of the pictures", unit=Unit.PIXELS, minimum=16, maximum=16384),
)
SAMPLES = Option("samples", 1, "Per pixel, all through its centre; one is free of noise, more only help materials that scatter light",
                 minimum=1, maximum=4096)
FIT = Option("fit", 0.0, "Scale a built-in object or file so that its largest dimension is this; 0 keeps its own units",
             unit=Unit.LENGTH, minimum=0.0, maximum=1e6)

_STEEPEST = math.radians(85)  # beyond, "z upward in the picture" loses its meaning
_MOST_RINGS = 16
_MARGIN = 0.06  # of the picture, kept free on each side


def apply_settings(scene: bpy.types.Scene, options: Mapping[str, Value], *, frames: int, transparent: bool,
                   persistent: bool = False, bounces: int = 0) -> None:
    """Give the scene a dark world, the pictures' size and a timeline of ``frames`` frames.

    Parameters
    ----------
    scene : bpy.types.Scene
    options : mapping
        A checked value for each of `CAMERA_OPTIONS` and `SAMPLES`.
    frames : int
    transparent : bool
        Whether the pictures' alpha is the silhouette.
    persistent : bool
        Whether the renderer keeps the geometry from frame to frame: pays only where neighbouring frames differ by a camera
        or by a Value node, not where the object turns in each.
    bounces : int
        How many matte surfaces light may meet between the first and the camera. Above 0, pictures at few samples are noisy.
    """
    scene.world = devices.dark_world()
    scene_settings.apply(scene, {
        "cycles.samples": options["samples"],
        "cycles.max_bounces": bounces,
        "cycles.diffuse_bounces": bounces,
        "render.film_transparent": transparent,
        "render.filepath": "//capture/images/",  # with the frame's number: what `capture` calls its pictures
        "render.resolution_x": options["resolution_x"],
        "render.resolution_y": options["resolution_y"],
        "render.resolution_percentage": 100,
        "render.pixel_aspect_x": 1.0,
        "render.pixel_aspect_y": 1.0,
        "render.use_persistent_data": persistent,
        "render.frame_map_old": 100,
        "render.frame_map_new": 100,
        "frame_start": 1,
        "frame_end": frames,
        "frame_step": 1,
    })


def add_cameras(stage: bpy.types.Collection, count: int, options: Mapping[str, Value]) -> list[bpy.types.Object]:
    """Add cameras, called ``camera-1`` and so on in the captures; `place_cameras` puts them in their places."""
    return [devices.add_camera(stage, i, focal_length=options["focal_length"], sensor_width=options["sensor_width"])
            for i in range(1, count + 1)]


def place_cameras(scene: bpy.types.Scene, cameras: Sequence[bpy.types.Object], elevations: Sequence[float], points: np.ndarray,
                  table: np.ndarray, distance: float) -> float:
    """Aim cameras at the object's middle, one at each elevation, all from one distance.

    Parameters
    ----------
    points : (n, 3) array
        The object in the object frame.
    table : (3,) array
        Where the turntable stands in the world.
    distance : float
        0 for the least from which every camera sees all of the object at every pose.

    Returns
    -------
    float
        The distance to the object's middle.

    Raises
    ------
    ScanstageError
        The distance puts a camera inside the object.
    """
    middle = middle_of(points)
    distance = distance or max(fitting_distance(camera_of(scene, camera), elevation, points - middle)
                               for camera, elevation in zip(cameras, elevations, strict=True))
    reach = reach_of(points)
    if distance <= reach:
        raise ScanstageError(f"option distance: {distance:g} m puts the camera inside the object, which reaches "
                             f"{reach:g} m from its middle; use more, or 0 for automatic")
    for camera, elevation in zip(cameras, elevations, strict=True):
        devices.aim(camera, table + middle + offset_of(distance, elevation), table + middle)
    bpy.context.view_layer.update()  # parts are fitted to the cameras' world matrices
    return distance


def offset_of(distance: float, elevation: float, azimuth: float = 0.0) -> np.ndarray:
    """Return the (3,) way from the object's middle to a device: from the front, which in Blender is -y, then to the right."""
    return distance * np.array([math.sin(azimuth) * math.cos(elevation), -math.cos(azimuth) * math.cos(elevation), math.sin(elevation)])


def middle_of(points: np.ndarray) -> np.ndarray:
    """Return the (3,) point of the turntable's axis at half the object's height: what cameras look at."""
    return np.array([0.0, 0.0, (points[:, 2].min() + points[:, 2].max()) / 2])


def reach_of(points: np.ndarray) -> float:
    """Return how far the object reaches from its middle, at any pose."""
    return float(np.linalg.norm(points - middle_of(points), axis=1).max())


def radius_of(points: np.ndarray) -> float:
    """Return how far the object reaches from the turntable's axis."""
    return float(np.linalg.norm(points[:, :2], axis=1).max())


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
