# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig as lines and faces in the world, for the viewport to draw: what each device sees, lights and turns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..errors import ScanstageError
from ..reconstruction.geometry import Camera, VoxelGrid
from ..reconstruction.planning.coverage import Shot
from . import ownership
from .extents import box_of
from .laser import LASER as LASER_NODE
from .laser import is_laser, plane_of
from .projection import pattern_of
from .projector import border_rays, is_projector
from .readback import camera_of, light_of, projector_of, rigid_motion, staged_objects, turntable_of
from .timeline import light_is_on
from .units import length_text

CAMERA, VIEW, PROJECTOR, LIGHT, LASER, SHADOW = "camera", "view", "projector", "light", "laser", "shadow"
VOLUME, TURNTABLE = "volume", "turntable"

_VIEW_SIZE = 0.07  # of the camera's distance: the pyramid that stands for a view
_ARROW = 0.3  # of a light's distance
_HEAD = 0.06  # of a light's distance: its arrow's head
_SUN_RAYS = 0.45  # of the object's size, between the rays of a sun
_CIRCLE = 72  # sides
_PATCH = 8  # voxels along a side of the patch that shows their size


@dataclass(frozen=True)
class Sketch:
    """One thing of the rig.

    Parameters
    ----------
    kind : str
        `CAMERA`, `VIEW`, ...: decides the colour.
    lines : (n, 2, 3) array
        In the world.
    faces : (m, 3, 3) array
        Triangles.
    label : str
    anchor : (3,) array, optional
        Where the label belongs.
    active : bool
        Whether it takes part in the present frame.
    """

    kind: str
    lines: np.ndarray
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))
    label: str = ""
    anchor: np.ndarray | None = None
    active: bool = True


def sketch_devices(scene: bpy.types.Scene) -> Iterator[Sketch]:
    """Yield the cameras, projectors, lasers, lights and sticks of the scene's stage as they stand at the present frame.

    Raises
    ------
    ScanstageError
        The scene has no stage.
    """
    middle, size = object_place(scene)
    for device in sorted(scene.objects, key=lambda o: o.name):
        if device.type not in ("CAMERA", "LIGHT") or device.hide_render:
            continue
        try:
            yield from _device(scene, device, middle, size)
        except ScanstageError:
            continue  # what cannot be described has no lines; capturing says why
    lights = [light_of(o).position for o in _lights(scene) if light_is_on(o.data) and o.data.type != "SUN"]
    for stick in ownership.with_role(ownership.require_stage(scene), "stick"):
        for light in lights:
            yield _shadow(stick, light, middle)


def sketch_views(scene: bpy.types.Scene, shots: Sequence[Shot]) -> Iterator[Sketch]:
    """Yield a small pyramid for every view of the plan, where it stands about the object's present pose."""
    motion = rigid_motion(turntable_of(scene))
    middle = object_place(scene)[0]
    for shot in shots:
        camera = shot.camera.moved(np.linalg.inv(motion))
        depth = _VIEW_SIZE * float(np.linalg.norm(camera.centre - middle))
        corners = camera.centre + depth * border_rays(camera)[::16]
        yield Sketch(VIEW, np.concatenate((_loop(corners), _spokes(camera.centre, corners))), active=False)


def sketch_volume(scene: bpy.types.Scene, grid: VoxelGrid) -> Iterator[Sketch]:
    """Yield the working volume, which turns with the object, and a patch of its voxels at the lower corner."""
    motion = rigid_motion(turntable_of(scene))
    lower, upper = grid.origin, grid.upper
    box = lower + (upper - lower) * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    edges = np.array([(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit])
    count, rows = np.minimum(_PATCH, np.array(grid.shape)), []
    for normal in range(3):
        for along, across in ((normal - 1, normal - 2), (normal - 2, normal - 1)):
            row = np.zeros((count[across], 2, 3))  # all but the first, which lies on an edge of the box
            row[:, :, across] = 1 + np.arange(count[across])[:, None]
            row[:, 1, along] = count[along]
            rows.append(lower + grid.voxel_size * row)
    size = length_text(scene, grid.voxel_size)
    for lines, label, active in ((box[edges], "", True), (np.concatenate(rows), f"voxel {size}", False)):
        lines = lines @ motion[:3, :3].T + motion[:3, 3]
        yield Sketch(VOLUME, lines, label=label, anchor=motion[:3, :3] @ lower + motion[:3, 3], active=active)


def sketch_turntable(scene: bpy.types.Scene, stops: np.ndarray) -> Sketch:
    """Return the turntable's axis and circle, with a mark at every stop of the plan and a hand at the present one.

    Parameters
    ----------
    scene : bpy.types.Scene
    stops : (n, 4, 4) array
        Where the object frame stands in the world at each.
    """
    table = turntable_of(scene)
    motion, height, radius = rigid_motion(table), 2 * object_place(scene)[1], table.empty_display_size
    centre, turned, axis = motion[:3, 3], motion[:3, :3], motion[:3, 2]
    angles = np.linspace(0, 2 * math.pi, _CIRCLE, endpoint=False)
    rim = np.column_stack((np.cos(angles), np.sin(angles), 0 * angles)) @ turned.T
    marks = np.array([stop[:3, 0] for stop in stops]).reshape(-1, 1, 3) * np.array([1.0, 1.08])[:, None]
    lines = [_loop(rim), marks, turned[:, 0] * np.array([[[0.0], [1.16]]]), axis * np.array([[[-0.12], [1.0]]]) * height / radius]
    return Sketch(TURNTABLE, centre + radius * np.concatenate(lines), anchor=centre + 1.2 * radius * turned[:, 0],
                  label=f"{len(stops)} stops" if len(stops) > 1 else "")


def _device(scene: bpy.types.Scene, device: bpy.types.Object, middle: np.ndarray, size: float) -> Iterator[Sketch]:
    name = device.name.removeprefix("Scanstage ")
    if device.type == "CAMERA":
        yield _frustum(CAMERA, camera_of(scene, device), middle, name, device == scene.camera)
    elif is_projector(device):
        shining = pattern_of(device.data, scene.frame_current) is not None
        yield _frustum(PROJECTOR, projector_of(scene, device), middle, name, shining)
    elif is_laser(device):
        yield _sheet(device, middle, name)
    else:
        yield _light(device, middle, size, name)


def _lights(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return [o for o in scene.objects if o.type == "LIGHT" and not o.hide_render and not is_projector(o) and not is_laser(o)]


def object_place(scene: bpy.types.Scene) -> tuple[np.ndarray, float]:
    """Return the middle (3,) of the staged object in the world, and half the diagonal of its box."""
    box = box_of(staged_objects(scene))
    if box is None:
        return np.array(turntable_of(scene).matrix_world.translation), 0.1
    lower, upper = box
    return (lower + upper) / 2, float(np.linalg.norm(upper - lower)) / 2


def reach_of(device: Camera, middle: np.ndarray) -> float:
    """Return the depth at which a device's frustum ends: that of the object's middle."""
    depth = float(device.project(middle)[1])
    return depth if depth > 0 else float(np.linalg.norm(middle - device.centre))


def _frustum(kind: str, device: Camera, middle: np.ndarray, name: str, active: bool) -> Sketch:
    """Return the pyramid of what a device sees or lights, as far as the object's middle; a projector's picture is filled there."""
    rim = device.centre + reach_of(device, middle) * border_rays(device)
    picture = np.stack((np.broadcast_to(rim.mean(axis=0), rim.shape), rim, np.roll(rim, -1, axis=0)), axis=1)
    lines = [_loop(rim), _spokes(device.centre, rim[::16])]
    return Sketch(kind, np.concatenate(lines), picture if kind == PROJECTOR else np.zeros((0, 3, 3)), name, device.centre, active)


def _sheet(laser: bpy.types.Object, middle: np.ndarray, name: str) -> Sketch:
    """Return the sheet of a laser as far as the object's middle."""
    world = np.array(laser.matrix_world)
    centre, up = world[:3, 3], world[:3, 1] / np.linalg.norm(world[:3, 1])
    normal = plane_of(laser)[0]
    ahead = np.cross(up, normal)
    ahead *= math.copysign(1.0, float(ahead @ -world[:3, 2]))
    half = laser.data.node_tree.nodes[LASER_NODE].inputs["Fan"].default_value / 2
    reach = float(np.linalg.norm(middle - centre))
    ends = np.array([centre + reach * (ahead + side * math.tan(half) * up) for side in (-1, 1)])
    return Sketch(LASER, _loop(np.vstack((centre, ends))), np.vstack((centre, ends))[None], name, centre, light_is_on(laser.data))


def _light(source: bpy.types.Object, middle: np.ndarray, size: float, name: str) -> Sketch:
    """Return arrows along which a light shines on the object."""
    light = light_of(source)
    if light.kind == "sun":
        way = np.asarray(light.direction)
        starts = [middle - 2.6 * size * way + _SUN_RAYS * size * offset for offset in (np.zeros(3), *_across(way))]
        return Sketch(LIGHT, np.concatenate([_arrow(start, way, size) for start in starts]), label=name, anchor=starts[0],
                      active=light_is_on(source.data))
    way = middle - light.position if light.kind == "point" else np.asarray(light.direction) * np.linalg.norm(middle - light.position)
    distance = float(np.linalg.norm(way))
    if not distance > 0:
        return Sketch(LIGHT, np.zeros((0, 2, 3)), label=name, anchor=light.position, active=light_is_on(source.data))
    star = light.position + 0.02 * distance * np.array([[-axis, axis] for axis in np.eye(3)])
    return Sketch(LIGHT, np.concatenate((star, _arrow(light.position, way / distance, _ARROW * distance))), label=name,
                  anchor=light.position, active=light_is_on(source.data))


def _shadow(stick: bpy.types.Object, light: np.ndarray, middle: np.ndarray) -> Sketch:
    """Return the plane that a stick's shadow sweeps through the object: from the light past both ends of the stick."""
    world = np.array(stick.matrix_world)
    half = float(np.abs(np.array(stick.bound_box)[:, 1]).max())
    ends = world[:3, 3] + np.array([[-half], [half]]) * world[:3, 1]
    far = light + (ends - light) * 1.3 * np.linalg.norm(middle - light) / np.linalg.norm(ends - light, axis=1, keepdims=True)
    return Sketch(SHADOW, _loop(np.vstack((light, far))), np.vstack((light, far))[None])


def _arrow(start: np.ndarray, way: np.ndarray, length: float) -> np.ndarray:
    """Return the lines of an arrow with a head of four strokes."""
    tip, head = start + length * way, _HEAD / _ARROW * length
    return np.concatenate((np.stack((start, tip))[None], _spokes(tip, [tip - head * way + 0.4 * head * side for side in _across(way)])))


def _across(way: np.ndarray) -> list[np.ndarray]:
    """Return four unit vectors across a direction."""
    first = np.cross(way, np.eye(3)[np.abs(way).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(way, first)
    return [first, second, -first, -second]


def _loop(points: np.ndarray) -> np.ndarray:
    return np.stack((points, np.roll(points, -1, axis=0)), axis=1)


def _spokes(hub: np.ndarray, ends: Sequence[np.ndarray]) -> np.ndarray:
    ends = np.asarray(ends)
    return np.stack((np.broadcast_to(hub, ends.shape), ends), axis=1)
