# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Formulas as shader nodes: what is written with ``+``, ``*`` and ``<`` is what the nodes compute."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import bpy

from . import ownership

_COLUMN, _ROW = 190.0, 170.0  # of the node editor, so that a tree can be read


@dataclass(frozen=True)
class Scalar:
    """A number in a node tree: an output socket with arithmetic. Comparisons give 1 or 0.

    Parameters
    ----------
    tree : bpy.types.NodeTree
    socket : bpy.types.NodeSocket
        An output of one of its nodes.
    """

    tree: bpy.types.NodeTree
    socket: bpy.types.NodeSocket

    def __add__(self, other: Scalar | float) -> Scalar:
        return self._math("ADD", self, other)

    def __radd__(self, other: float) -> Scalar:
        return self._math("ADD", other, self)

    def __sub__(self, other: Scalar | float) -> Scalar:
        return self._math("SUBTRACT", self, other)

    def __rsub__(self, other: float) -> Scalar:
        return self._math("SUBTRACT", other, self)

    def __mul__(self, other: Scalar | float) -> Scalar:
        return self._math("MULTIPLY", self, other)

    def __rmul__(self, other: float) -> Scalar:
        return self._math("MULTIPLY", other, self)

    def __truediv__(self, other: Scalar | float) -> Scalar:
        return self._math("DIVIDE", self, other)

    def __rtruediv__(self, other: float) -> Scalar:
        return self._math("DIVIDE", other, self)

    def __neg__(self) -> Scalar:
        return self * -1.0

    def __abs__(self) -> Scalar:
        return self._math("ABSOLUTE", self)

    def __lt__(self, other: Scalar | float) -> Scalar:
        return self._math("LESS_THAN", self, other)

    def __gt__(self, other: Scalar | float) -> Scalar:
        return self._math("GREATER_THAN", self, other)

    def sin(self) -> Scalar:
        """Return the sine."""
        return self._math("SINE", self)

    def cos(self) -> Scalar:
        """Return the cosine."""
        return self._math("COSINE", self)

    def tan(self) -> Scalar:
        """Return the tangent."""
        return self._math("TANGENT", self)

    def exp(self) -> Scalar:
        """Return the exponential."""
        return self._math("EXPONENT", self)

    def clamped(self, least: float, most: float) -> Scalar:
        """Return the number, or the bound that it is beyond."""
        return self._math("MINIMUM", self._math("MAXIMUM", self, least), most)

    def _math(self, operation: str, *operands: Scalar | float) -> Scalar:
        node = self.tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, operand in zip(node.inputs, operands, strict=False):
            if isinstance(operand, Scalar):
                self.tree.links.new(operand.socket, socket)
            else:
                socket.default_value = operand
        return Scalar(self.tree, node.outputs[0])


Formulas = Callable[[bpy.types.NodeTree, Mapping[str, Scalar]], tuple[Scalar, ...]]


def separated(tree: bpy.types.NodeTree, vector: bpy.types.NodeSocket) -> tuple[Scalar, Scalar, Scalar]:
    """Return the three numbers of a vector."""
    node = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(vector, node.inputs[0])
    return tuple(Scalar(tree, socket) for socket in node.outputs)


def combined(tree: bpy.types.NodeTree, x: Scalar, y: Scalar) -> bpy.types.NodeSocket:
    """Return the vector (x, y, 0)."""
    node = tree.nodes.new("ShaderNodeCombineXYZ")
    tree.links.new(x.socket, node.inputs[0])
    tree.links.new(y.socket, node.inputs[1])
    return node.outputs[0]


def named_value(tree: bpy.types.NodeTree, name: str, value: float) -> Scalar:
    """Return a Value node's number, which an action can change from frame to frame: see `timeline.keyframe_value`."""
    node = tree.nodes.new("ShaderNodeValue")
    node.name = node.label = name
    node.outputs[0].default_value = value
    return Scalar(tree, node.outputs[0])


def local_direction(tree: bpy.types.NodeTree) -> tuple[Scalar, Scalar, Scalar]:
    """Return, in a light's tree, the unit direction from the light to what it lights, in the light's own axes."""
    return separated(tree, tree.nodes.new("ShaderNodeTexCoord").outputs["Normal"])


def constant_falloff(tree: bpy.types.NodeTree) -> Scalar:
    """Return, in a light's tree, the factor that makes its light as strong at every distance."""
    falloff = tree.nodes.new("ShaderNodeLightFalloff")
    falloff.inputs["Strength"].default_value = 1.0
    return Scalar(tree, falloff.outputs["Constant"])


def finish_light(tree: bpy.types.NodeTree, color: bpy.types.NodeSocket | None, strength: Scalar) -> None:
    """Let a light shine. A strength that is a constant 0 takes it out of the render: it is not sampled then."""
    emission, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputLight")
    if color is not None:
        tree.links.new(color, emission.inputs["Color"])
    tree.links.new(strength.socket, emission.inputs["Strength"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])


def arrange(tree: bpy.types.NodeTree) -> None:
    """Put the nodes in columns by how many nodes they depend on in a row, so that a user can read the tree."""
    depth: dict[bpy.types.Node, int] = dict.fromkeys(tree.nodes, 0)
    for _ in tree.nodes:
        deeper = {link.to_node: depth[link.from_node] + 1 for link in sorted(tree.links, key=lambda link: depth[link.from_node])}
        if all(depth[node] == column for node, column in deeper.items()):
            break
        depth |= deeper
    filled: dict[int, int] = {}
    for node, column in depth.items():
        row = filled[column] = filled.get(column, -1) + 1
        node.location = (column * _COLUMN, -row * _ROW)


@dataclass(frozen=True)
class Field:
    """An input of a node group, as the light's properties show it: a number with its bounds, or a whole number of pixels."""

    name: str
    description: str
    default: float
    minimum: float
    maximum: float
    kind: str = "Float"
    subtype: str = "NONE"


def shared_group(name: str, fields: Sequence[Field], results: Sequence[str], formulas: Formulas) -> bpy.types.NodeTree:
    """Return the node group of a name, made if the file has none yet: its users share the formulas, each with its own inputs.

    Parameters
    ----------
    name : str
    fields : sequence of Field
        The inputs.
    results : sequence of str
        Names of the outputs, all numbers.
    formulas : callable
        ``formulas(tree, given)`` returns a `Scalar` for each output, from those of the inputs by name.
    """
    known = next((group for group in bpy.data.node_groups if group.name == name and group.library is None), None)
    if known is not None:
        return known
    group = ownership.mark(bpy.data.node_groups.new(name, "ShaderNodeTree"))
    for field in fields:
        socket = group.interface.new_socket(field.name, in_out="INPUT", socket_type=f"NodeSocket{field.kind}",
                                            description=field.description)
        if field.subtype != "NONE":
            socket.subtype = field.subtype
        socket.default_value, socket.min_value, socket.max_value = field.default, field.minimum, field.maximum
    for result in results:
        group.interface.new_socket(result, in_out="OUTPUT", socket_type="NodeSocketFloat")
    source, sink = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    given = {field.name: Scalar(group, source.outputs[field.name]) for field in fields}
    for result, value in zip(results, formulas(group, given), strict=True):
        group.links.new(value.socket, sink.inputs[result])
    arrange(group)
    return group


def add_group(tree: bpy.types.NodeTree, name: str, label: str, group: bpy.types.NodeTree) -> bpy.types.Node:
    """Add a node that is called ``name`` and computes what ``group`` does."""
    node = tree.nodes.new("ShaderNodeGroup")
    node.name, node.label, node.node_tree, node.width = name, label, group, 200.0
    return node


def named_node(light: bpy.types.ID | None, name: str) -> bpy.types.Node | None:
    """Return a node of a light's tree by its name, or None."""
    tree = light.node_tree if isinstance(light, bpy.types.Light) else None
    return tree.nodes.get(name) if tree else None
