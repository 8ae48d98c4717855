# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials, matte but for one: the built-in objects' textures, and the stage's own surfaces.

The textures are node trees in object coordinates, so that they have detail at every distance and their files stay
small. Their albedo lies between 0.08 and 0.8 in every channel: no pixel in the light is black or saturated.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .. import compat
from .ownership import mark

Color = tuple[float, float, float]

# A thick glaze: the sun's highlight is about as bright as white paper, and wide enough to cover many voxels.
_GLAZE = {"Roughness": 0.3, "Specular IOR Level": 1.0}


@dataclass(frozen=True)
class Texture:
    """How a built-in object is coloured.

    Parameters
    ----------
    palette : tuple of colour
        Linear RGB, run through by a slow noise.
    patches, grain : float
        How many per metre of the coloured patches and of the fine grain.
    bands : float
        Share of horizontal bands in the mixture, 0 to 1.
    """

    palette: tuple[Color, ...]
    patches: float
    grain: float
    bands: float = 0.0


def textured(name: str, texture: Texture, *, within: bpy.types.Object | None = None, shiny: bool = False) -> bpy.types.Material:
    """Return a new material with a procedural texture.

    Parameters
    ----------
    name : str
    texture : Texture
    within : bpy.types.Object, optional
        In whose coordinates the texture lies; otherwise in those of each object that has the material.
    shiny : bool
        Glossy like glazed ware, instead of matte: highlights that move with the eye.
    """
    material, tree = _new_material(name)
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    coordinates.object = within
    place = coordinates.outputs["Object"]
    hue = _noise(tree, place, texture.patches, detail=2.0)
    if texture.bands:
        wave = tree.nodes.new("ShaderNodeTexWave")
        wave.bands_direction = "Z"
        wave.inputs["Scale"].default_value = texture.patches / 3
        wave.inputs["Distortion"].default_value = 4.0
        tree.links.new(place, wave.inputs["Vector"])
        hue = _mixed(tree, "FLOAT", texture.bands, hue, wave.outputs[1])
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    _fill(ramp.color_ramp, texture.palette)
    tree.links.new(hue, ramp.inputs[0])
    cells = tree.nodes.new("ShaderNodeTexVoronoi")
    cells.inputs["Scale"].default_value = texture.grain
    tree.links.new(place, cells.inputs["Vector"])
    shade = _remapped(tree, cells.outputs["Distance"], 0.0, 0.8, 1.0, 0.72)
    fine = _remapped(tree, _noise(tree, place, texture.grain * 2.5, detail=3.0), 0.3, 0.7, 0.82, 1.0)
    color = _scaled(tree, _scaled(tree, ramp.outputs["Color"], shade), fine)
    if shiny:
        _finish_shiny(tree, color)
    else:
        _finish_diffuse(tree, color)
    material.diffuse_color = (*texture.palette[0], 1.0)  # what the viewport's solid mode shows
    return material


def matte(name: str, color: Color) -> bpy.types.Material:
    """Return a new plain matte material."""
    material, tree = _new_material(name)
    value = tree.nodes.new("ShaderNodeRGB").outputs[0]
    value.default_value = (*color, 1.0)
    _finish_diffuse(tree, value)
    material.diffuse_color = (*color, 1.0)
    return material


def printed(name: str, image: bpy.types.Image, ink: float, paper: float) -> bpy.types.Material:
    """Return a new matte material that shows an image in grey: albedo ``ink`` where it is black, ``paper`` where it is white."""
    material, tree = _new_material(name)
    place = tree.nodes.new("ShaderNodeTexCoord").outputs["UV"]
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.interpolation, texture.extension = image, "Linear", "EXTEND"
    tree.links.new(place, texture.inputs["Vector"])
    _finish_diffuse(tree, _remapped(tree, texture.outputs["Color"], 0.0, 1.0, ink, paper))
    return material


def screen(name: str, color: Color) -> bpy.types.Material:
    """Return a new material that has one colour from everywhere, and lights nothing."""
    material, tree = _new_material(name)
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (*color, 1.0)
    _finish(tree, emission)
    material.cycles.emission_sampling = "NONE"  # at one sample a second light would be noise
    material.diffuse_color = (*color, 1.0)
    return material


def _new_material(name: str) -> tuple[bpy.types.Material, bpy.types.NodeTree]:
    material = mark(bpy.data.materials.new(name))
    tree = compat.node_tree(material)
    tree.nodes.clear()
    return material, tree


def _finish_diffuse(tree: bpy.types.NodeTree, color: bpy.types.NodeSocket) -> None:
    shader = tree.nodes.new("ShaderNodeBsdfDiffuse")
    tree.links.new(color, shader.inputs["Color"])
    _finish(tree, shader)


def _finish_shiny(tree: bpy.types.NodeTree, color: bpy.types.NodeSocket) -> None:
    shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
    for name, value in _GLAZE.items():
        shader.inputs[name].default_value = value
    tree.links.new(color, shader.inputs["Base Color"])
    _finish(tree, shader)


def _finish(tree: bpy.types.NodeTree, shader: bpy.types.Node) -> None:
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    for column, node in enumerate(tree.nodes):
        node.location = (column * 220.0, 0.0)  # readable when the user opens the tree


def _noise(tree: bpy.types.NodeTree, place: bpy.types.NodeSocket, scale: float, *,
           detail: float) -> bpy.types.NodeSocket:
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = scale
    noise.inputs["Detail"].default_value = detail
    tree.links.new(place, noise.inputs["Vector"])
    return noise.outputs[0]


def _remapped(tree: bpy.types.NodeTree, value: bpy.types.NodeSocket, low: float, high: float, to_low: float,
              to_high: float) -> bpy.types.NodeSocket:
    node = tree.nodes.new("ShaderNodeMapRange")
    for name, number in (("From Min", low), ("From Max", high), ("To Min", to_low), ("To Max", to_high)):
        node.inputs[name].default_value = number
    tree.links.new(value, node.inputs["Value"])
    return node.outputs["Result"]


def _mixed(tree: bpy.types.NodeTree, kind: str, share: float, a: bpy.types.NodeSocket,
           b: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type = kind
    node.inputs["Factor"].default_value = share
    tree.links.new(a, node.inputs["A"])
    tree.links.new(b, node.inputs["B"])
    return node.outputs["Result"]


def _scaled(tree: bpy.types.NodeTree, color: bpy.types.NodeSocket,
            factor: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = "SCALE"
    tree.links.new(color, node.inputs[0])
    tree.links.new(factor, node.inputs["Scale"])
    return node.outputs[0]


def _fill(ramp: bpy.types.ColorRamp, palette: tuple[Color, ...]) -> None:
    # Noise keeps to the middle of its range: there the hues lie, closely enough that all of them show.
    low, high = 0.3, 0.7
    ramp.elements.remove(ramp.elements[1])
    ramp.elements[0].position, ramp.elements[0].color = low, (*palette[0], 1.0)
    for i, color in enumerate(palette[1:], start=1):
        ramp.elements.new(low + (high - low) * i / (len(palette) - 1)).color = (*color, 1.0)
