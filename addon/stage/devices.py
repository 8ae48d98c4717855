# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of a rig as ordinary Blender objects: cameras, headlights, platters and backdrops."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import bpy

# isort: split
import bmesh  # exists once bpy is imported
import numpy as np
from mathutils import Matrix

from .. import compat
from ..reconstruction.geometry import Camera, look_at
from . import ownership
from .materials import Color, matte, screen

BACKDROP_COLORS: dict[str, Color] = {"blue": (0.02, 0.10, 0.80), "black": (0.0, 0.0, 0.0)}
_PLATTER_COLOR = (0.18, 0.19, 0.21)
_OUTLINE = "outline"
_OUTLINE_LENGTH = 0.25
_DRAWN = "scanstage_drawn"  # a property of an outline's mesh: what it shows
AMBIENT = 0.6  # of the light on a white surface that faces the sun
_NO_OCCLUSION = 1e-6  # metres: how far the ambient light looks for what hides it
_SUN_ROTATION = (math.radians(40), 0.0, math.radians(-30))  # high, from the front right
_OVERLAP = 1.1  # a backdrop reaches this much beyond the picture's edges


def add_turntable(stage: bpy.types.Collection) -> bpy.types.Object:
    """Add the empty that turns, at the world's origin."""
    turntable = ownership.add(stage, "Scanstage Turntable", None, "turntable")
    turntable.empty_display_type = "PLAIN_AXES"
    return turntable


def add_camera(stage: bpy.types.Collection, number: int, *, focal_length: float,
               sensor_width: float) -> bpy.types.Object:
    """Add a perspective camera; both lengths in millimetres."""
    data = bpy.data.cameras.new(f"Scanstage Camera {number}")
    data.lens, data.sensor_width, data.sensor_fit = focal_length, sensor_width, "AUTO"
    return ownership.add(stage, data.name, data, "camera", device=f"camera-{number}")


def point(device: bpy.types.Object, centre: np.ndarray, target: np.ndarray) -> None:
    """Put a projector or laser at ``centre`` and let it shine at ``target`` with z upward in its picture; both in the world."""
    stand(device, *look_at(centre, target))


def stand(device: bpy.types.Object, R: np.ndarray, t: np.ndarray) -> None:
    """Stand a device without a parent where world-to-device ``R`` (3, 3) and ``t`` (3,) say, in OpenCV's axes."""
    device.matrix_basis = Matrix.LocRotScale(-R.T @ t, Matrix((R.T @ np.diag((1, -1, -1))).tolist()), None)


def aim(camera: bpy.types.Object, centre: np.ndarray, target: np.ndarray) -> None:
    """Put a camera at ``centre`` and let it look at ``target`` with z upward in the picture; both in the world."""
    point(camera, centre, target)
    distance = float(np.linalg.norm(np.asarray(target) - centre))
    camera.data.clip_start, camera.data.clip_end = distance * 1e-3, distance * 100
    camera.data.display_size = distance * 0.15


def add_light(stage: bpy.types.Collection, camera: bpy.types.Object, number: int, distance: float, *,
              offset: Sequence[float] = (0.0, 0.0, 0.0), size: float = 0.0) -> bpy.types.Object:
    """Add a point light that a camera carries. In its centre it is a headlight: nothing the camera sees lies in shadow.

    Parameters
    ----------
    distance : float
        In metres; a white surface that faces the light from there is seen as white (radiance 1).
    offset : (3,) sequence
        From the camera's centre, in the camera's own axes: right, up, backward.
    size : float
        Radius of the luminous sphere; 0 casts hard shadows and is, at one sample, free of noise.
    """
    data = bpy.data.lights.new(f"Scanstage Light {number}", "POINT")
    data.shadow_soft_size = size
    data.energy = 4 * math.pi ** 2 * distance ** 2  # radiance of a matte surface: albedo * energy / (2 pi distance)^2
    light = ownership.add(stage, data.name, data, "light", device=f"light-{number}")
    light.parent, light.location = camera, offset
    return light


def add_even_light(stage: bpy.types.Collection, world: bpy.types.World) -> bpy.types.Object:
    """Light the object evenly from all round, a little more from one side, and with no shadow: the same from everywhere.

    A matte surface of albedo a and normal n has the radiance a (`AMBIENT` + (1 - `AMBIENT`) max(0, n . l)) in every
    view, l being the direction to the sun. Both parts are free of noise at one sample: the sun is a point of light, and
    the ambient light is the closed form that Cycles adds with its fast global illumination, here without occlusion. A
    bright world would be noise, and of several lamps one sample takes one at random.

    Parameters
    ----------
    stage : bpy.types.Collection
    world : bpy.types.World
        It is given the ambient part; the scene must have `scene_settings.AMBIENT_LIGHT`.
    """
    world.light_settings.distance, world.light_settings.ao_factor = _NO_OCCLUSION, AMBIENT
    data = bpy.data.lights.new("Scanstage Sun", "SUN")
    data.angle, data.use_shadow = 0.0, False
    data.energy = math.pi * (1 - AMBIENT)
    sun = ownership.add(stage, data.name, data, "light", device="sun")
    sun.rotation_euler = _SUN_ROTATION
    return sun


def add_platter(stage: bpy.types.Collection, turntable: bpy.types.Object, radius: float,
                backdrop: str) -> bpy.types.Object:
    """Add the disc under the object: part of the backdrop where there is one, otherwise only to be looked at."""
    mesh = bpy.data.meshes.new("Scanstage Platter")
    disc = bmesh.new()
    bmesh.ops.create_cone(disc, cap_ends=True, segments=96, radius1=radius, radius2=radius, depth=radius * 0.06)
    bmesh.ops.translate(disc, verts=disc.verts, vec=(0.0, 0.0, -radius * 0.032))  # its top just below the object
    disc.to_mesh(mesh)
    disc.free()
    platter = ownership.add(stage, "Scanstage Platter", mesh, "platter")
    platter.parent = turntable
    if backdrop == "none":
        platter.hide_render = True  # an alpha silhouette is the object's alone
        mesh.materials.append(matte("Scanstage Platter", _PLATTER_COLOR))
    else:
        mesh.materials.append(_backdrop_material(platter, backdrop))
    return platter


def add_backdrop(stage: bpy.types.Collection, camera: bpy.types.Object, lens: Camera, distance: float,
                 backdrop: str, number: int) -> bpy.types.Object:
    """Add a screen of one colour that fills a camera's picture.

    Parameters
    ----------
    camera : bpy.types.Object
    lens : Camera
        The same camera as `addon.stage.readback.camera_of` reads it.
    distance : float
        From the camera, in metres.
    backdrop : str
        A name of `BACKDROP_COLORS`.
    """
    width, height = lens.size
    corners = np.array([(u, v, 1.0) for u, v in ((-.5, -.5), (-.5, height - .5), (width - .5, height - .5),
                                                  (width - .5, -.5))]) @ np.linalg.inv(lens.K).T
    middle = corners.mean(axis=0)
    corners = (middle + (corners - middle) * _OVERLAP) * distance * (1, -1, -1)
    mesh = bpy.data.meshes.new(f"Scanstage Backdrop {number}")
    mesh.from_pydata(corners.tolist(), [], [(0, 1, 2, 3)])
    wall = ownership.add(stage, mesh.name, mesh, "backdrop")
    wall.parent = camera
    mesh.materials.append(_backdrop_material(wall, backdrop))
    return wall


def dark_world() -> bpy.types.World:
    """Return a new world that sheds no light and is black."""
    world = ownership.mark(bpy.data.worlds.new("Scanstage World"))
    world.color = (0.0, 0.0, 0.0)  # what the viewport shows
    for node in compat.node_tree(world).nodes:
        if node.bl_idname == "ShaderNodeBackground":  # a new world is dark grey, which at one sample is noise
            node.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
            node.inputs["Strength"].default_value = 0.0
    return world


def _backdrop_material(owner: bpy.types.Object, backdrop: str) -> bpy.types.Material:
    # Seen by the camera and by nothing else: it neither lights the object nor shades it.
    owner.visible_diffuse = owner.visible_glossy = owner.visible_transmission = owner.visible_shadow = False
    owner.hide_select = owner.data.name.startswith("Scanstage Backdrop")
    return screen(f"Scanstage {backdrop.title()} Backdrop", BACKDROP_COLORS[backdrop])


def add_outline(stage: bpy.types.Collection, owner: bpy.types.Object, kind: str) -> bpy.types.Object:
    """Add the object that draws what a projector or laser lights, for the viewport only: see `draw_outline`."""
    drawn = ownership.add(stage, f"{owner.name} {kind}", bpy.data.meshes.new(f"{owner.name} {kind}"), _OUTLINE)
    drawn.parent, drawn.hide_render, drawn.hide_select = owner, True, True
    return drawn


def draw_outline(owner: bpy.types.Object, optics: Sequence[float], distance: float | None,
                 lines: Callable[[float], tuple[Sequence, Sequence]]) -> None:
    """Redraw a device's outline, if it has one and if it is drawn otherwise.

    Parameters
    ----------
    owner : bpy.types.Object
    optics : sequence of float
        All that the lines depend on, besides the distance.
    distance : float or None
        How far the outline reaches; None is as far as it did.
    lines : callable
        ``lines(distance)`` returns vertices, in the owner's axes, and edges.
    """
    drawn = next((child for child in owner.children if ownership.role_of(child) == _OUTLINE), None)
    if drawn is None:
        return
    known = drawn.data.get(_DRAWN)
    distance = distance or (known[0] if known else _OUTLINE_LENGTH)
    wanted = [float(value) for value in (distance, *optics)]
    if known is None or list(known) != wanted:
        drawn.data.clear_geometry()
        drawn.data.from_pydata(*lines(distance), [])
        drawn.data.update()
        drawn.data[_DRAWN] = wanted
