# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials of results: voxel colours, clay for the truth, heat maps, and ink for labels.

Each is made once and found again by its name; a user's changes to it are kept. A heat map's node tree is live: its
Value node ``Limit`` says which error has the last colour.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np

from ..compat import node_tree
from ..reconstruction.color import srgb_to_linear

OWNER = "scanstage"  # the custom property by which Scanstage knows its own data-blocks

# Both maps are perceptually even and safe for colour-blind readers, at evenly spaced places; sRGB.
VIRIDIS = ("440154", "472d7b", "3b528b", "2c728e", "21918c", "28ae80", "5ec962", "addc30", "fde725")
BLUE_WHITE_RED = ("2166ac", "4393c3", "92c5de", "d1e5f0", "f7f7f7", "fddbc7", "f4a582", "d6604d", "b2182b")


def voxel_material() -> bpy.types.Material:
    """Return the material that shows the attribute ``Color``, shared by all voxel meshes."""
    return _named("Scanstage Voxels", _build_voxels)


def probability_material() -> bpy.types.Material:
    """Return the material that shows the attribute ``probability``, from 0 to 1, shared by all results that have it."""
    return _named("Scanstage Probability", _build_probability)


def clay_material() -> bpy.types.Material:
    """Return the plain light material of meshes that have no colours."""
    return _named("Scanstage Clay", _build_clay)


def ink_material() -> bpy.types.Material:
    """Return the grey material of labels, the same under any light."""
    return _named("Scanstage Ink", _build_ink)


def heat_map_material(name: str, limit: float, *, signed: bool, lit: bool = True) -> bpy.types.Material:
    """Return the material ``name``, which shows the attribute ``error``, set to ``limit``.

    Parameters
    ----------
    name : str
    limit : float
        The error of the last colour, in the scene's unit.
    signed : bool
        Blue, white, red from ``-limit`` to ``limit``; otherwise viridis from 0 to ``limit``.
    lit : bool
        Shaded like any surface, so that the form is seen; otherwise the plain colours, for a legend.
    """
    material = _named(name, lambda tree: _build_heat_map(tree, signed, lit))
    if material.get("signed") not in (None, signed):
        material.node_tree.nodes.clear()
        _build_heat_map(material.node_tree, signed, lit)
    material["signed"] = signed
    material.node_tree.nodes["Limit"].outputs[0].default_value = limit
    return material


def remove_if_unused(material: bpy.types.Material) -> None:
    """Remove a material that Scanstage made, if nothing uses it any more."""
    if OWNER in material and material.users == 0:
        bpy.data.materials.remove(material)


def _named(name: str, build: Callable[[bpy.types.NodeTree], None]) -> bpy.types.Material:
    material = bpy.data.materials.get(name)
    if material is not None and OWNER in material:
        return material
    material = bpy.data.materials.new(name)
    material[OWNER] = "material"
    tree = node_tree(material)
    tree.nodes.clear()
    build(tree)
    return material


def _surface(tree: bpy.types.NodeTree) -> bpy.types.Node:
    """Add a matt surface, whose grazing highlights would otherwise wash out the colours, and return its node."""
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    shader.inputs["Roughness"].default_value = 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    _finish(tree, shader)
    return shader


def _finish(tree: bpy.types.NodeTree, shader: bpy.types.Node) -> None:
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location.x = 300
    tree.links.new(shader.outputs[0], output.inputs["Surface"])


def _attribute(tree: bpy.types.NodeTree, name: str) -> bpy.types.Node:
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = name
    return node


def _build_voxels(tree: bpy.types.NodeTree) -> None:
    # The colour attribute's own node, not the general Attribute node: glTF's exporter recognises it.
    color = tree.nodes.new("ShaderNodeVertexColor")
    color.layer_name = "Color"
    color.location.x = -200
    tree.links.new(color.outputs["Color"], _surface(tree).inputs["Base Color"])


def _build_probability(tree: bpy.types.NodeTree) -> None:
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    _fill_ramp(ramp.color_ramp, VIRIDIS)
    tree.links.new(_attribute(tree, "probability").outputs["Fac"], ramp.inputs[0])
    tree.links.new(ramp.outputs["Color"], _surface(tree).inputs["Base Color"])


def _build_clay(tree: bpy.types.NodeTree) -> None:
    _surface(tree).inputs["Base Color"].default_value = (0.6, 0.58, 0.55, 1.0)


def _build_ink(tree: bpy.types.NodeTree) -> None:
    shader = tree.nodes.new("ShaderNodeEmission")
    shader.inputs["Color"].default_value = (0.22, 0.22, 0.23, 1.0)  # to be read on the studio's light floor and in the dark viewport
    _finish(tree, shader)


def _build_heat_map(tree: bpy.types.NodeTree, signed: bool, lit: bool) -> None:
    error = _attribute(tree, "error")
    limit = tree.nodes.new("ShaderNodeValue")
    limit.name = limit.label = "Limit"
    lowest = tree.nodes.new("ShaderNodeMath")
    lowest.operation, lowest.label = 'MULTIPLY', "Lowest error"
    lowest.inputs[1].default_value = -1.0 if signed else 0.0
    scale = tree.nodes.new("ShaderNodeMapRange")  # clamps: what is beyond the limit has the last colour
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    _fill_ramp(ramp.color_ramp, BLUE_WHITE_RED if signed else VIRIDIS)
    for node, x, y in ((error, -900, 200), (limit, -900, -100), (lowest, -700, -200), (scale, -500, 0),
                       (ramp, -300, 0)):
        node.location = (x, y)
    tree.links.new(limit.outputs[0], lowest.inputs[0])
    tree.links.new(error.outputs["Fac"], scale.inputs["Value"])
    tree.links.new(lowest.outputs[0], scale.inputs["From Min"])
    tree.links.new(limit.outputs[0], scale.inputs["From Max"])
    tree.links.new(scale.outputs[0], ramp.inputs[0])
    if lit:
        tree.links.new(ramp.outputs["Color"], _surface(tree).inputs["Base Color"])
    else:
        shader = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(ramp.outputs["Color"], shader.inputs["Color"])
        _finish(tree, shader)


def _fill_ramp(ramp: bpy.types.ColorRamp, colors: tuple[str, ...]) -> None:
    while len(ramp.elements) < len(colors):
        ramp.elements.new(0.5)
    for index, (element, color) in enumerate(zip(ramp.elements, colors, strict=True)):
        element.position = index / (len(colors) - 1)
        element.color = (*srgb_to_linear(np.frombuffer(bytes.fromhex(color), np.uint8) / 255), 1.0)
