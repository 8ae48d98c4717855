# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of a collection on a light floor under soft light, rendered by Cycles.

Everything happens in a scene of its own, with camera, light, world and floor that are gone afterwards: nothing of the
user's scene is touched. The camera is orthographic, so that objects in a row are seen from the same direction and at
the same scale.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import cv2
import numpy as np
from mathutils import Matrix

from ..compat import node_tree
from ..errors import ScanstageError
from ..files import replacing
from .objects import mesh_from_arrays

# From the front, a little from the right and from above.
_AZIMUTH, _ELEVATION = math.radians(25), math.radians(22)
RIGHT = np.array((math.cos(_AZIMUTH), math.sin(_AZIMUTH), 0.0))
BACK = np.array((math.sin(_AZIMUTH) * math.cos(_ELEVATION), -math.cos(_AZIMUTH) * math.cos(_ELEVATION),
                 math.sin(_ELEVATION)))  # from the picture to the camera
UP = np.cross(BACK, RIGHT)

_MARGIN = 0.05  # of the picture, on each side
_SAMPLES = 10  # the denoiser does the rest
_EDGE = 3  # pixels rendered on each side and cut off: there the denoiser leaves noise

# Sun and sky add up to a floor just below white, so that the background neither greys nor clips.
_SKY, _SUN, _FLOOR, _FLOOR_SIZE = 0.6, 1.6, 0.85, 1e3
# The sun stands behind the camera's left shoulder, and is wide: the soft edge of its shadows says where things stand.
_SUN_SIDE, _SUN_TILT, _SUN_ANGLE = math.radians(35), math.radians(30), math.radians(25)
_SETTINGS = {
    "render.engine": 'CYCLES', "cycles.device": 'CPU', "cycles.samples": _SAMPLES, "cycles.use_denoising": True,
    "cycles.use_adaptive_sampling": False, "cycles.max_bounces": 2, "cycles.diffuse_bounces": 1, "cycles.seed": 0,
    "render.resolution_percentage": 100, "render.dither_intensity": 0.0, "render.image_settings.file_format": 'PNG',
    "render.image_settings.color_mode": 'RGB', "render.image_settings.color_depth": '8',
    "view_settings.view_transform": 'Standard', "view_settings.look": 'None',
}


def render_collection(collection: bpy.types.Collection, path, *, size: tuple[int, int]) -> None:
    """Take a picture of all that a collection shows; it stands on z = 0. The file appears whole or not at all.

    Parameters
    ----------
    collection : bpy.types.Collection
    path : path-like
        A PNG file; replaced if it exists.
    size : (int, int)
        Width and height in pixels.

    Raises
    ------
    ScanstageError
        The picture cannot be rendered or written.
    """
    with replacing(path) as file:
        file.write(_render(collection, size))


def _render(collection: bpy.types.Collection, size: tuple[int, int]) -> bytes:
    """Return the picture as a PNG file's bytes."""
    with tempfile.TemporaryDirectory() as folder, _own_scene(collection, size) as scene:
        scene.render.filepath = os.path.join(folder, "picture.png")
        try:
            bpy.ops.render.render(write_still=True, scene=scene.name)
        except RuntimeError as error:  # how operators report what goes wrong
            raise ScanstageError(f"the picture cannot be rendered: {str(error).removeprefix('Error: ').strip()}") from None
        picture = cv2.imdecode(np.fromfile(scene.render.filepath, np.uint8), cv2.IMREAD_COLOR)
    return cv2.imencode(".png", picture[_EDGE:-_EDGE, _EDGE:-_EDGE])[1].tobytes()


@contextmanager
def _own_scene(collection: bpy.types.Collection, size: tuple[int, int]) -> Iterator[bpy.types.Scene]:
    scene = bpy.data.scenes.new("Studio")
    made = [scene]
    try:
        scene.collection.children.link(collection)
        for path, value in _SETTINGS.items():
            owner, name = path.rsplit(".", 1)
            setattr(scene.path_resolve(owner), name, value)
        scene.render.resolution_x, scene.render.resolution_y = size[0] + 2 * _EDGE, size[1] + 2 * _EDGE
        _furnish(scene, made)
        _aim(scene, collection)
        yield scene
    finally:
        bpy.data.batch_remove(made)


def _furnish(scene: bpy.types.Scene, made: list[bpy.types.ID]) -> None:
    """Add sky, sun, floor and camera, and note every data-block in ``made``."""
    scene.world = bpy.data.worlds.new("Studio Sky")
    made.append(scene.world)
    background = next(n for n in node_tree(scene.world).nodes if n.type == 'BACKGROUND')
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    background.inputs["Strength"].default_value = _SKY
    sun = bpy.data.lights.new("Studio Sun", 'SUN')
    sun.energy, sun.angle = _SUN, _SUN_ANGLE
    _place(scene, made, sun, Matrix.Rotation(_AZIMUTH, 4, 'Z') @ Matrix.Rotation(-_SUN_SIDE, 4, 'Y')
           @ Matrix.Rotation(_SUN_TILT, 4, 'X'))
    far = _FLOOR_SIZE
    floor = mesh_from_arrays("Studio Floor", np.array([(-far, -far, 0), (far, -far, 0), (far, far, 0), (-far, far, 0)]),
                             np.array([(0, 1, 2, 3)]))
    material = bpy.data.materials.new("Studio Floor")
    made.append(material)
    tree = node_tree(material)
    tree.nodes.clear()
    diffuse, output = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Color"].default_value = (_FLOOR, _FLOOR, _FLOOR, 1.0)
    tree.links.new(diffuse.outputs[0], output.inputs["Surface"])
    floor.materials.append(material)
    _place(scene, made, floor, Matrix())
    camera = bpy.data.cameras.new("Studio Camera")
    camera.type, camera.sensor_fit = 'ORTHO', 'HORIZONTAL'
    scene.camera = _place(scene, made, camera, Matrix())


def _place(scene: bpy.types.Scene, made: list[bpy.types.ID], data: bpy.types.ID, matrix: Matrix) -> bpy.types.Object:
    placed = bpy.data.objects.new(data.name, data)
    placed.matrix_world = matrix
    scene.collection.objects.link(placed)
    made += [placed, data]
    return placed


def _aim(scene: bpy.types.Scene, collection: bpy.types.Collection) -> None:
    """Fill the picture with the collection's objects."""
    layer = scene.view_layers[0]
    layer.update()
    points = np.concatenate([_outline(member.evaluated_get(layer.depsgraph)) for member in collection.all_objects])
    picture = points @ np.stack((RIGHT, UP, BACK), axis=1)
    lower, upper = picture.min(axis=0), picture.max(axis=0)
    (width, height, depth), middle = upper - lower, (lower + upper) / 2
    aspect = scene.render.resolution_x / scene.render.resolution_y
    camera = scene.camera.data
    camera.ortho_scale = max(width, height * aspect) * (1 + 2 * _MARGIN)
    # Far enough that the floor in front of the objects is not behind the camera.
    distance = depth / 2 + 2 * camera.ortho_scale
    camera.clip_start, camera.clip_end = distance / 1000, 1000 * distance
    place = middle[0] * RIGHT + middle[1] * UP + (middle[2] + distance) * BACK
    scene.camera.matrix_world = Matrix([[*row, at] for row, at in zip(
        np.stack((RIGHT, UP, BACK), axis=1).tolist(), place.tolist(), strict=True)] + [[0, 0, 0, 1]])


def _outline(evaluated: bpy.types.Object) -> np.ndarray:
    """Return (n, 3) points in the world that no part of the object lies outside of."""
    if evaluated.type == 'MESH' and len(evaluated.data.vertices):
        points = np.zeros((len(evaluated.data.vertices), 3), np.float32)
        evaluated.data.vertices.foreach_get("co", points.ravel())
    else:
        points = np.array(evaluated.bound_box)
    matrix = np.array(evaluated.matrix_world)
    return points @ matrix[:3, :3].T + matrix[:3, 3]
