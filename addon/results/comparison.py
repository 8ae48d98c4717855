# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Truth, result and error side by side, labelled, as a collection to look at and to take a picture of.

The three stand on one floor (z = 0), in a row across the direction in which `studio` looks at them. The row is laid
out in picture coordinates: x to the right and y upward in the picture, in the scene's unit, the origin where the
middle object meets the floor. Labels and legend face the camera and rest on the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ..errors import ScanstageError
from ..stage.units import length_text
from .heatmap import ERROR, add_heat_map
from .materials import OWNER, heat_map_material, ink_material, remove_if_unused
from .objects import mesh_from_arrays, set_attribute
from .studio import BACK, RIGHT, UP, render_collection

# In parts of the picture height of the objects.
_GAP, _TITLE, _NOTE, _BAR = 0.12, 0.11, 0.06, 0.06
_LIFT = 0.08  # towards the camera: the letters' descents would otherwise reach into the floor
_BAR_STEPS = 64


@dataclass(frozen=True)
class _Row:
    """The collection and the measures of one comparison: the objects' half width, lowest and highest y, and height."""

    scene: bpy.types.Scene
    collection: bpy.types.Collection
    half: float
    low: float
    high: float

    @property
    def height(self) -> float:
        return self.high - self.low

    def length(self, value: float) -> str:
        return length_text(self.scene, value, digits=2)

    def put(self, name: str, data: bpy.types.ID, x: float, y: float, foot: float | None = None) -> bpy.types.Object:
        """Add something flat that faces the camera with its origin at (x, y), in the plane that meets the floor at
        the height ``foot`` of the picture (default: y)."""
        foot = y if foot is None else foot
        towards = -(foot * UP[2]) / BACK[2] + _LIFT * self.height
        placed = _link(self.collection, bpy.data.objects.new(name, data))
        placed.matrix_world = Matrix(np.block([[np.stack((RIGHT, UP, BACK), axis=1),
                                                (x * RIGHT + y * UP + towards * BACK)[:, None]],
                                               [np.zeros((1, 3)), np.ones((1, 1))]]).tolist())
        # Ink on the picture, not a thing in the room: it throws no shadow.
        placed.visible_shadow = placed.visible_diffuse = placed.visible_glossy = False
        return placed


def add_comparison(truth: bpy.types.Object, result: bpy.types.Object, distances: np.ndarray, limit: float, *,
                   scene: bpy.types.Scene, signed: bool = False, labels=("Truth", "Result", "Error"),
                   name: str = "Comparison") -> bpy.types.Collection:
    """Lay truth, result and error side by side in a collection of their own.

    Parameters
    ----------
    truth, result : bpy.types.Object
        Mesh objects that stand where they are to be compared: a turntable must be at angle 0. They are not changed,
        but for the attribute ``error`` of the result's mesh; the copies share their meshes.
    distances : (f,) or (v,) array
        Per face or per vertex of the result, in the scene's unit, as for `add_heat_map`.
    limit : float
        Errors from here on have the last colour.
    scene : bpy.types.Scene
        Where the collection is linked.
    signed : bool
        As for `add_heat_map`.
    labels : sequence of three str
    name : str
        Of the collection. An earlier comparison of this name is replaced.

    Raises
    ------
    ValueError
        As `add_heat_map`, or one of the objects has no extent.
    """
    clouds = [_world_vertices(truth), _world_vertices(result)]
    if not all(len(cloud) and np.ptp(cloud, axis=0).any() for cloud in clouds):
        raise ValueError("truth and result must have vertices, and not all in one place")
    remove_comparison(name)
    collection = bpy.data.collections.new(name)
    collection[OWNER] = "comparison"
    scene.collection.children.link(collection)
    points = np.concatenate(clouds)
    lower, upper = points.min(axis=0), points.max(axis=0)
    across = points @ RIGHT
    foot = np.append((lower[:2] + upper[:2]) / 2, lower[2])
    foot += ((across.min() + across.max()) / 2 - foot @ RIGHT) * RIGHT
    upward = (points - foot) @ UP
    row = _Row(scene, collection, float(np.ptp(across)) / 2, float(upward.min()), float(upward.max()))
    step = 2 * row.half + 2 * _GAP * row.height
    try:
        _add_copy(row, truth, labels[0], -step * RIGHT - foot)
        _add_copy(row, result, labels[1], -foot)
        add_heat_map(_add_copy(row, result, labels[2], step * RIGHT - foot), distances, limit, signed=signed)
    except ValueError:
        remove_comparison(name)
        raise
    size = float(np.ptp(clouds[0], axis=0).max())
    notes = (f"{row.length(size)} across", _describe(row, result), f"{row.length(limit)} = {100 * limit / size:.2g} % of the size")
    for column, (label, note) in enumerate(zip(labels, notes, strict=True)):
        _add_label(row, label, note, (column - 1) * step)
    _add_legend(row, step + row.half + _GAP * row.height, limit, signed)
    return collection


def render_comparison(path, *, size: tuple[int, int] = (1200, 450), name: str = "Comparison") -> None:
    """Take the comparison's picture.

    Parameters
    ----------
    path : path-like
        A PNG file; replaced if it exists.
    size : (int, int)
        Width and height in pixels.
    name : str
        As for `add_comparison`.

    Raises
    ------
    ScanstageError
        There is no such comparison, or the picture cannot be written.
    """
    collection = bpy.data.collections.get(name)
    if collection is None or OWNER not in collection:
        raise ScanstageError(f"{path}: there is no comparison {name!r} to take a picture of; evaluate a result first")
    render_collection(collection, path, size=size)


def remove_comparison(name: str = "Comparison") -> None:
    """Remove the comparison ``name`` and what nothing else uses of it, if there is one."""
    collection = bpy.data.collections.get(name)
    if collection is None or OWNER not in collection:
        return
    for member in list(collection.objects):
        if OWNER not in member:
            continue  # the user's own addition is unlinked with the collection, and stays in the file
        data = member.data
        materials = {slot.material for slot in member.material_slots if slot.material}
        bpy.data.objects.remove(member)
        if data.users == 0:
            bpy.data.batch_remove((data,))
        for material in materials:
            remove_if_unused(material)
    bpy.data.collections.remove(collection)


def _describe(row: _Row, result: bpy.types.Object) -> str:
    voxels = f"{row.length(result['voxel_size'])} voxels" if "voxel_size" in result else ""
    return ", ".join(part for part in (result.get("method", ""), voxels) if part)


def _world_vertices(target: bpy.types.Object) -> np.ndarray:
    evaluated = target.evaluated_get(bpy.context.evaluated_depsgraph_get())
    vertices = evaluated.data.vertices
    points = np.zeros(3 * len(vertices), np.float32)
    vertices.foreach_get("co", points)
    matrix = np.array(evaluated.matrix_world)
    return points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def _add_copy(row: _Row, source: bpy.types.Object, label: str, offset: np.ndarray) -> bpy.types.Object:
    place = Matrix.Translation(offset.tolist()) @ source.matrix_world
    copy = _link(row.collection, source.copy())
    copy.name = f"{row.collection.name} {label}"
    copy.animation_data_clear()
    copy.constraints.clear()
    copy.parent = None
    copy.matrix_world = place
    copy.hide_render = copy.hide_viewport = False
    return copy


def _link(collection: bpy.types.Collection, made: bpy.types.Object) -> bpy.types.Object:
    collection.objects.link(made)
    made[OWNER] = "comparison"
    return made


def _add_label(row: _Row, title: str, note: str, x: float) -> None:
    y = row.low - (_GAP + _TITLE) * row.height
    row.put(f"{row.collection.name} {title} Label", _text(title, _TITLE * row.height), x, y)
    if note:
        row.put(f"{row.collection.name} {title} Note", _text(note, _NOTE * row.height), x, y - 1.5 * _NOTE * row.height)


def _add_legend(row: _Row, x: float, limit: float, signed: bool) -> None:
    lowest = -limit if signed else 0.0
    width, height = _BAR * row.height, 0.9 * row.height
    lattice = np.stack(np.meshgrid((0, width), np.linspace(0, height, _BAR_STEPS + 1), (0,), indexing="ij"), axis=-1)
    first = np.arange(_BAR_STEPS)
    faces = np.stack((first, first + _BAR_STEPS + 1, first + _BAR_STEPS + 2, first + 1), axis=1)
    mesh = mesh_from_arrays("Legend", lattice.reshape(-1, 3), faces)
    set_attribute(mesh, ERROR, np.tile(np.linspace(lowest, limit, _BAR_STEPS + 1), 2), 'POINT')
    mesh.materials.append(heat_map_material(f"{row.collection.name} Legend", limit, signed=signed, lit=False))
    foot = row.low + 0.05 * row.height
    row.put(f"{row.collection.name} Legend", mesh, x, foot)
    for value in (lowest, (lowest + limit) / 2, limit):
        text = _text("0" if value == 0 else f"\u2212{row.length(-value)}" if value < 0 else row.length(value),
                     1.15 * _NOTE * row.height, 'LEFT', 'CENTER')
        y = foot + height * (value - lowest) / (limit - lowest)
        row.put(f"{row.collection.name} Tick", text, x + 1.5 * width, y, foot - _NOTE * row.height)


def _text(body: str, size: float, align_x: str = 'CENTER', align_y: str = 'BOTTOM_BASELINE') -> bpy.types.Curve:
    curve = bpy.data.curves.new(body, 'FONT')
    curve.body, curve.size, curve.align_x, curve.align_y = body, size, align_x, align_y
    curve.materials.append(ink_material())
    return curve
