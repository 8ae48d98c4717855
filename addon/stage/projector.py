# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The projector: a light that obeys K [R | t] and OpenCV's distortion, like the camera it is, run backwards.

A projector is a point light whose node tree asks for each ray which of the projector's pixels it comes from, and gives
it that pixel's light: Cycles renders it with one sample a pixel and without noise. What it is lies in the inputs of one
node, `LENS` of the light's tree, and nowhere else: whoever edits, keys or drives them has changed the projector. Power
and colour are the light's own. `readback.projector_of` reads it as a `Camera`.

The image is an Image Texture node: any image, image sequence or movie of Blender's (`set_image`), or a set of patterns
(`projection.show_patterns`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import bpy

# isort: split
import cv2  # bpy first: both bring libraries of their own
import numpy as np

from .. import compat
from ..errors import ScanstageError
from ..reconstruction.geometry import Camera
from ..reconstruction.undistortion import MAX_GROWTH
from . import devices, nodes, ownership
from .nodes import Field, Scalar

LENS = "Scanstage Lens"
IMAGE = "Scanstage Image"
PATTERN = "Scanstage Pattern"
PATTERNS = "scanstage_patterns"  # a property of the light, in which `projection` keeps what its patterns are
OFF = -1.0  # what the Value node `PATTERN` says while the projector is dark
FULL_POWER = 4 * math.pi ** 2  # watts at which a white surface that faces a white pixel has radiance 1, at every distance
_FIELDS = (
    Field("Throw Ratio", "Distance over the width of the picture: the focal length over the imager's width", 1.0, 0.05, 100.0),
    Field("Pixel Aspect", "Focal length in pixels down over that across: 1 for square pixels", 1.0, 0.01, 100.0),
    Field("Shift X", "Lens shift to the right, in widths of the picture, as a camera's", 0.0, -10.0, 10.0),
    Field("Shift Y", "Lens shift upward, in widths of the picture, as a camera's", 0.0, -10.0, 10.0),
    Field("Width", "Resolution across", 1024, 1, 65536, kind="Int"),
    Field("Height", "Resolution down", 768, 1, 65536, kind="Int"),
    *(Field(name, f"Lens distortion: OpenCV's {name.lower()}", 0.0, -100.0, 100.0) for name in ("K1", "K2", "P1", "P2", "K3")),
)
_EDGE_STEPS = 16  # of a frustum's drawing: its edges are bent where the lens distorts


def add_projector(stage: bpy.types.Collection, number: int, *, throw_ratio: float = 1.0,
                  size: tuple[int, int] = (1024, 768)) -> bpy.types.Object:
    """Add a projector with its frustum; it shows nothing but white yet.

    Parameters
    ----------
    stage : bpy.types.Collection
    number : int
        Its id in captures is ``projector-<number>``.
    throw_ratio : float
        Distance over picture width; 1 is a horizontal angle of 2 atan(1/2).
    size : (int, int)
        Width and height in pixels.
    """
    light = bpy.data.lights.new(f"Scanstage Projector {number}", "POINT")
    made = ownership.add(stage, light.name, light, "projector", device=f"projector-{number}")
    make_projector(light, throw_ratio=throw_ratio, size=size)
    devices.add_outline(stage, made, "Frustum")
    update_frustum(made)
    return made


def make_projector(light: bpy.types.Light, *, throw_ratio: float = 1.0, size: tuple[int, int] = (1024, 768)) -> None:
    """Turn a point light into a projector that shows white. To be done before the first render: 4.5 keeps lights as they were."""
    light.shadow_soft_size, light.energy = 0.0, FULL_POWER
    tree = compat.node_tree(light)
    lens = _kept_alone(tree, nodes.add_group(
        tree, LENS, "Projector", nodes.shared_group(LENS, _FIELDS, ("Column", "Row", "Inside"), _formulas)))
    for name, value in (("Throw Ratio", throw_ratio), ("Width", size[0]), ("Height", size[1])):
        lens.inputs[name].default_value = value
    set_image(light, None)


def lens_of(light: bpy.types.ID | None) -> bpy.types.Node | None:
    """Return the node whose inputs are the projector's optics, or None of what is no projector."""
    return nodes.named_node(light, LENS)


def is_projector(candidate: bpy.types.Object) -> bool:
    """Return whether an object is a projector."""
    return lens_of(candidate.data) is not None


def set_optics(light: bpy.types.Light, camera: Camera) -> None:
    """Give a projector the K, distortion and size of a camera, for instance a real projector's calibration.

    Raises
    ------
    ScanstageError
        K has skew, which no projector has.
    """
    (width, height), K = camera.size, camera.K
    if abs(K[0, 1]) > 1e-9 * K[0, 0]:
        raise ScanstageError(f"projector {light.name!r}: K[0][1] is {K[0, 1]:g}; a projector has no skew, set it to 0")
    values = {"Throw Ratio": K[0, 0] / width, "Pixel Aspect": K[1, 1] / K[0, 0], "Shift X": 0.5 - (K[0, 2] + 0.5) / width,
              "Shift Y": (K[1, 2] + 0.5 - height / 2) / width, "Width": width, "Height": height,
              **dict(zip(("K1", "K2", "P1", "P2", "K3"), camera.distortion.tolist(), strict=True))}
    for name, value in values.items():
        lens_of(light).inputs[name].default_value = value


def optics_of(light: bpy.types.Light) -> Camera:
    """Return a projector's K, distortion and size, in the projector's own frame."""
    value = {socket.name: socket.default_value for socket in lens_of(light).inputs}
    width, height = value["Width"], value["Height"]
    fx = value["Throw Ratio"] * width
    K = [[fx, 0, (0.5 - value["Shift X"]) * width - 0.5],
         [0, fx * value["Pixel Aspect"], height / 2 + value["Shift Y"] * width - 0.5],
         [0, 0, 1]]
    return Camera(K, np.eye(3), np.zeros(3), (width, height), [value[name] for name in ("K1", "K2", "P1", "P2", "K3")])


def set_image(light: bpy.types.Light, image: bpy.types.Image | None, *, frames: int = 1, first: int = 1, start: int = 1) -> None:
    """Project a still, a sequence or a movie, stretched over the whole picture; None is white.

    Parameters
    ----------
    light : bpy.types.Light
    image : bpy.types.Image or None
    frames, first : int
        Of a sequence: how many pictures, and the number of the first.
    start : int
        Frame of the timeline at which a sequence or movie begins.
    """
    clear(light)
    tree = light.node_tree
    column, row, _ = (Scalar(tree, socket) for socket in lens_of(light).outputs)
    texture = None if image is None else image_node(tree, image, nodes.combined(tree, column, 1.0 - row))
    if texture is not None:
        user = texture.image_user
        user.frame_start, user.frame_offset = start, first - 1 if image.source == "SEQUENCE" else 0
        user.frame_duration = image.frame_duration if image.source == "MOVIE" else frames
    finish(tree, texture, nodes.named_value(tree, PATTERN, 0.0))


def image_node(tree: bpy.types.NodeTree, image: bpy.types.Image, place: bpy.types.NodeSocket) -> bpy.types.Node:
    """Add the node that looks an image's pixels up, without a blend between neighbours: a projector has none either."""
    node = tree.nodes.new("ShaderNodeTexImage")
    node.name = node.label = IMAGE
    node.image, node.interpolation, node.extension = image, "Closest", "EXTEND"
    node.image_user.use_auto_refresh = True
    tree.links.new(place, node.inputs["Vector"])
    return node


def finish(tree: bpy.types.NodeTree, texture: bpy.types.Node | None, pattern: Scalar) -> None:
    """Let a projector shine inside its picture, and only while ``pattern`` is not negative."""
    inside = Scalar(tree, tree.nodes[LENS].outputs["Inside"])
    strength = (pattern > -0.5) * (inside * nodes.constant_falloff(tree))
    nodes.finish_light(tree, texture and texture.outputs["Color"], strength)
    nodes.arrange(tree)


def clear(light: bpy.types.Light) -> None:
    """Take everything but the lens out of a projector's tree."""
    _kept_alone(light.node_tree, lens_of(light))
    if PATTERNS in light:
        del light[PATTERNS]


def update_frustum(owner: bpy.types.Object, distance: float | None = None) -> None:
    """Draw a projector's picture as a frustum, with edges bent by its distortion, unless it is drawn so already.

    Parameters
    ----------
    owner : bpy.types.Object
        The projector.
    distance : float, optional
        How far the frustum reaches; by default as far as it did, or 0.25 m.
    """
    optics = optics_of(owner.data)
    values = (*optics.size, *optics.K.ravel(), *optics.distortion)
    devices.draw_outline(owner, values, distance, lambda reach: _frustum(optics, reach))


def border_rays(optics: Camera) -> np.ndarray:
    """Return the rays (64, 3), of unit depth, through the border of the picture, clockwise from its top left; every 16th is a corner."""
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float64) * optics.size - 0.5
    share = np.arange(_EDGE_STEPS)[:, None] / _EDGE_STEPS
    border = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    return rays_through(optics, border)


def rays_through(optics: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the rays (n, 3), of unit depth in the world, through pixels (n, 2) of the picture as the lens shows it."""
    straight = cv2.undistortPoints(pixels[:, None], optics.K, optics.distortion, P=optics.K)[:, 0]
    lens = replace(optics, R=np.eye(3), t=np.zeros(3))
    lit = np.abs(lens.project(lens.rays(straight))[0] - pixels).max(axis=1) < 1  # not so where the lens folds its picture back
    return optics.rays(np.where(lit[:, None], straight, pixels))


def _frustum(optics: Camera, distance: float) -> tuple[list[list[float]], list[tuple[int, int]]]:
    """Return the vertices and edges of a frustum in the axes of Blender's lights: the picture's border, and its corners' rays."""
    rim = border_rays(optics) * (distance, -distance, -distance)
    count = len(rim)
    edges = [*((i, (i + 1) % count) for i in range(count)), *((count, i) for i in range(0, count, _EDGE_STEPS))]
    return np.vstack((rim, np.zeros(3))).tolist(), edges


def _kept_alone(tree: bpy.types.NodeTree, lens: bpy.types.Node) -> bpy.types.Node:
    for node in [node for node in tree.nodes if node != lens]:
        tree.nodes.remove(node)
    return lens


def _formulas(group: bpy.types.NodeTree, given: Mapping[str, Scalar]) -> tuple[Scalar, Scalar, Scalar]:
    """Return the column and row of a ray as shares of the picture, from its top left, and whether it is in the picture.

    The same model as `geometry.distort`, in the same direction: from rays to pixels, so that nothing is inverted.
    """
    right, up, backward = nodes.local_direction(group)
    x, y = -(right / backward), up / backward  # OpenCV's axes: y down, z forward
    k1, k2, p1, p2, k3 = (given[name] for name in ("K1", "K2", "P1", "P2", "K3"))
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xy = 2.0 * (x * y)
    bent_x = x * radial + p1 * xy + p2 * (r2 + 2.0 * (x * x))
    bent_y = y * radial + p1 * (r2 + 2.0 * (y * y)) + p2 * xy
    throw, aspect = given["Throw Ratio"], given["Width"] / given["Height"]
    column = throw * bent_x + (0.5 - given["Shift X"])
    row = aspect * (throw * given["Pixel Aspect"] * bent_y + given["Shift Y"]) + 0.5
    # Beyond some radius the polynomial turns back and would show the picture a second time; and further out, perhaps, a third.
    slope = 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * (7.0 * k3)))
    across, down = 0.5 + abs(given["Shift X"]), (0.5 / aspect + abs(given["Shift Y"])) / given["Pixel Aspect"]
    corner = (across * across + down * down) / (throw * throw)  # squared radius of the farthest one, where the lens is straight
    inside = (backward < 0.0) * (slope > 0.0) * (r2 < corner * MAX_GROWTH ** 2)
    for share in (column, row):
        inside = inside * (share > 0.0) * (share < 1.0)
    return column, row, inside
