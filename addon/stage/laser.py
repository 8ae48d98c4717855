# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The laser line: a plane of light with a Gaussian profile, swept by angle or by translation.

A laser is a point light whose node tree leaves a sheet of it. The sheet is as thick at every distance; its width is four
standard deviations of its profile, as for a real laser (ISO 11146). It turns about the light's own y axis by the input
``Angle`` of its node, as by a mirror, which moves no object and so lets the renderer keep its geometry; or the object is
moved or turned by keys of its own. Either way a plan has the plane of every frame: pattern fields ``kind`` ``laser``,
``plane`` ``[nx, ny, nz, d]`` with ``n . X = d`` in the world, and ``width`` in metres. The laser is also the frame's light,
a point light where the sheet comes from: rays that saw light go there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from .. import compat
from . import devices, nodes, ownership
from .nodes import Field, Scalar
from .timeline import SWITCH, keyframe_steps, keyframe_value

LASER = "Scanstage Laser"
COLOR = (1.0, 0.05, 0.02)
_FIELDS = (
    Field("Angle", "By how much the sheet is turned to the light's right, about its y axis", 0.0, -math.pi / 2, math.pi / 2,
          subtype="ANGLE"),
    Field("Width", "Of the sheet: four standard deviations of its Gaussian profile", 0.001, 1e-6, 100.0, subtype="DISTANCE"),
    Field("Fan", "Angle that the sheet's fan of rays spans", math.radians(60), 1e-3, math.radians(179), subtype="ANGLE"),
)


def add_laser(stage: bpy.types.Collection, number: int, *, width: float, fan: float = math.radians(60)) -> bpy.types.Object:
    """Add a laser line, ``laser-<number>`` in captures.

    Parameters
    ----------
    stage : bpy.types.Collection
    number : int
    width : float
        Of the sheet, in metres: four standard deviations.
    fan : float
        Angle of the fan of rays, in radians.
    """
    light = bpy.data.lights.new(f"Scanstage Laser {number}", "POINT")
    light.shadow_soft_size, light.energy, light.color = 0.0, 4 * math.pi ** 2, COLOR  # at its peak a white surface is as bright as white
    made = ownership.add(stage, light.name, light, "laser", device=f"laser-{number}")
    tree = compat.node_tree(light)
    tree.nodes.clear()
    optics = nodes.add_group(tree, LASER, "Laser Line", nodes.shared_group(LASER, _FIELDS, ("Light",), _formulas))
    optics.inputs["Width"].default_value, optics.inputs["Fan"].default_value = width, fan
    strength = nodes.named_value(tree, SWITCH, 1.0) * (Scalar(tree, optics.outputs["Light"]) * nodes.constant_falloff(tree))
    nodes.finish_light(tree, None, strength)
    nodes.arrange(tree)
    fan = devices.add_outline(stage, made, "Fan")
    turn = fan.driver_add("rotation_euler", 1).driver  # the viewport's fan turns with the sheet, whoever turns that
    turn.type, turn.expression = "SCRIPTED", "-angle"
    angle = turn.variables.new()
    angle.name = "angle"
    angle.targets[0].id_type, angle.targets[0].id, angle.targets[0].data_path = "LIGHT", light, _angle_path(light)
    update_fan(made)
    return made


def update_fan(owner: bpy.types.Object, distance: float | None = None) -> None:
    """Draw a laser's sheet as a triangle that reaches ``distance`` far, unless it is drawn so already."""
    half = owner.data.node_tree.nodes[LASER].inputs["Fan"].default_value / 2
    devices.draw_outline(owner, [half], distance, lambda reach: (
        [(0.0, 0.0, 0.0), *((0.0, side * reach * math.sin(half), -reach * math.cos(half)) for side in (-1, 1))], [(0, 1), (1, 2), (2, 0)]))


def is_laser(candidate: bpy.types.Object) -> bool:
    """Return whether an object is a laser line."""
    return nodes.named_node(candidate.data, LASER) is not None


def sweep(light: bpy.types.Light, angles: Sequence[float], on: Sequence[bool], *, start: int = 1) -> None:
    """Turn a laser's sheet to one angle a frame, in radians, and switch it."""
    tree = light.node_tree
    tree.nodes[LASER].inputs["Angle"].default_value = angles[0]
    keyframe_steps(tree, _angle_path(light).removeprefix("node_tree."), angles, start=start)
    keyframe_value(tree, SWITCH, [float(state) for state in on], start=start)


def plane_of(laser: bpy.types.Object) -> tuple[np.ndarray, float]:
    """Return a laser's plane at the present frame: unit normal (3,) and offset with ``n . X = d``, in the world."""
    angle = laser.data.node_tree.nodes[LASER].inputs["Angle"].default_value
    world = np.array(laser.matrix_world)
    normal = world[:3, :3] @ (math.cos(angle), 0.0, math.sin(angle))
    normal /= np.linalg.norm(normal)
    return normal, float(normal @ world[:3, 3])


def laser_fields(laser: bpy.types.Object) -> Mapping[str, object]:
    """Return what a capture set says of a laser's sheet at the present frame: see above."""
    normal, offset = plane_of(laser)
    return {"kind": "laser", "plane": [*normal.tolist(), offset], "width": laser.data.node_tree.nodes[LASER].inputs["Width"].default_value}


def _angle_path(light: bpy.types.Light) -> str:
    index = light.node_tree.nodes[LASER].inputs.find("Angle")
    return f'node_tree.nodes["{LASER}"].inputs[{index}].default_value'


def _formulas(group: bpy.types.NodeTree, given: Mapping[str, Scalar]) -> tuple[Scalar]:
    """Return how much light goes into a ray: 1 in the middle of the sheet."""
    right, up, backward = nodes.local_direction(group)
    turn_cos, turn_sin = given["Angle"].cos(), given["Angle"].sin()
    length = Scalar(group, group.nodes.new("ShaderNodeLightPath").outputs["Ray Length"])
    beside = (right * turn_cos + backward * turn_sin) * length / given["Width"]
    forward = right * turn_sin - backward * turn_cos
    half_fan = (given["Fan"] * 0.5).tan()
    within = (forward > 0.0) * ((up * up) < (forward * forward) * half_fan * half_fan)
    return ((beside * beside * -8.0).exp() * within,)
