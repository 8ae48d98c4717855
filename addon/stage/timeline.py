# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The capture plan on the timeline: values that jump from frame to frame, and the camera of each frame."""

from collections.abc import Sequence

import bpy

from .. import compat
from .ownership import is_marked, mark

SWITCH = "Scanstage On"


def keyframe_steps(owner: bpy.types.ID, data_path: str, values: Sequence[float], *, index: int = 0,
                   start: int = 1) -> None:
    """Give a property one value a frame, without any value between two frames; keys that it has go.

    Parameters
    ----------
    owner : bpy.types.ID
        The data-block that the path starts from: an object, or a light's node tree.
    data_path : str
    values : sequence of float
        For the frames ``start``, ``start + 1``, ... Equal neighbours share one key.
    index : int
        Which element, of a property that is a vector.
    start : int
        The frame of the first value.
    """
    keys = [(start + i, value) for i, value in enumerate(values) if i == 0 or value != values[i - 1]]
    owner.animation_data_create()
    action = owner.animation_data.action or mark(bpy.data.actions.new(f"{owner.name} Plan"))
    owner.animation_data.action = action
    curve = action.fcurve_ensure_for_datablock(owner, data_path, index=index)
    curve.keyframe_points.clear()
    curve.keyframe_points.add(len(keys))
    curve.keyframe_points.foreach_set("co", [number for key in keys for number in key])
    for point in curve.keyframe_points:
        point.interpolation = "CONSTANT"
    curve.update()


def keyframe_scene(scene: bpy.types.Scene, data_path: str, values: Sequence[float], *, start: int = 1) -> None:
    """Give a setting of the scene one value a frame. An action that the scene has already steps aside until the stage goes."""
    if scene.animation_data and scene.animation_data.action and not is_marked(scene.animation_data.action):
        scene.animation_data.action = None
    keyframe_steps(scene, data_path, values, start=start)


def switch_light(light: bpy.types.Light, strengths: Sequence[float], *, start: int = 1) -> None:
    """Set a light's strength by a Value node on its emission, one a frame: 0 is off, 1 is its full power.

    Far cheaper than hiding the light, which would send the geometry to the renderer again, and right under persistent
    data as long as the tree is there before the first render.
    """
    tree = compat.node_tree(light)
    emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    value = tree.nodes.new("ShaderNodeValue")
    value.name = value.label = SWITCH
    value.location = (emission.location.x - 200, emission.location.y - 100)
    tree.links.new(value.outputs[0], emission.inputs["Strength"])
    value.outputs[0].default_value = strengths[0]
    keyframe_steps(tree, f'nodes["{SWITCH}"].outputs[0].default_value', strengths, start=start)


def keyframe_value(tree: bpy.types.NodeTree, name: str, values: Sequence[float], *, start: int = 1) -> None:
    """Give a Value node, known by its name, one number a frame."""
    tree.nodes[name].outputs[0].default_value = values[0]
    keyframe_steps(tree, f'nodes["{name}"].outputs[0].default_value', values, start=start)


def light_is_on(light: bpy.types.Light) -> bool:
    """Return whether a light shines at the present frame."""
    node = light.node_tree.nodes.get(SWITCH) if light.node_tree else None
    return light.energy > 0 and (node is None or node.outputs[0].default_value > 0)


def bind_cameras(scene: bpy.types.Scene, cameras: Sequence[bpy.types.Object], *, start: int = 1) -> None:
    """Let the frames ``start``, ``start + 1``, ... be seen by these cameras.

    A single camera is the scene's and needs no markers; several are bound by markers, which Blender follows on its own
    in every render, on a farm as here.
    """
    scene.camera = cameras[0]
    if len(set(cameras)) == 1:
        return
    for i, camera in enumerate(cameras):
        if i == 0 or camera != cameras[i - 1]:
            scene.timeline_markers.new(camera.name, frame=start + i).camera = camera
