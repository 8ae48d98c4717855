# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstructions as Blender objects: coloured voxel meshes and plain polygon meshes.

Arrays come in the object frame; ``frame`` says where that frame lies in the world (the turntable's matrix at angle 0)
and becomes the object's matrix, so that the vertices keep the coordinates the reconstruction gave them. Meshes are
filled through attributes, whole arrays at a time.

A result that is made again under the same name replaces the earlier one. Only what Scanstage made, and nobody else
uses, is removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import bpy
import numpy as np
from mathutils import Matrix

from .materials import OWNER, clay_material, remove_if_unused, voxel_material

if TYPE_CHECKING:
    from ..reconstruction.geometry import VoxelGrid
    from ..reconstruction.volumetric.surface import Surface

# Blender's own default. Cycles shows an attribute named "color" as black, in 4.5 and in 5.2.
COLOR = "Color"

# On a ball of 58 voxels across, twelve steps take the faces' mean error of direction from 45 to 5 degrees, while the
# surface moves inwards by a thirtieth of a voxel. Fewer leave the terraces visible, more wear off thin parts.
SMOOTH_FACTOR, SMOOTH_STEPS = 0.5, 12


def add_voxel_mesh(name: str, surface: Surface, rgb: np.ndarray | None, *, collection: bpy.types.Collection, grid: VoxelGrid,
                   frame=None, method: str = "", attributes: Mapping[str, np.ndarray] | None = None,
                   smooth: bool = False, replace: bool = True) -> bpy.types.Object:
    """Add the surface of a volume as a coloured mesh.

    The colour is the corner attribute ``Color`` (linear), active for the viewport and for rendering, and read by one
    material that all voxel meshes share. The object carries the custom properties ``voxel_size`` and ``method``.

    Parameters
    ----------
    name : str
        Made unique by Blender if something else has it.
    surface : Surface
        In the object frame.
    rgb : (s, 3) array or None
        Linear colour of every surface voxel. None, for a method that finds no colours: plain clay.
    collection : bpy.types.Collection
        Where the object is linked.
    grid : VoxelGrid
        Of the volume the surface was taken from.
    frame : (4, 4) array, optional
        Object frame to world. Default: the identity.
    method : str
        What made the result, in words for the user.
    attributes : mapping of str to (s,) array, optional
        More values of every surface voxel (bool, integer or float), stored as face attributes of these names.
    smooth : bool
        Take off the voxels' steps, by a live modifier and smooth shading; the mesh itself stays as it is.
    replace : bool
        Remove an earlier Scanstage result of this name first.

    Raises
    ------
    ValueError
        ``rgb`` or an attribute has not one row per surface voxel, or an attribute takes a name that is in use.
    """
    mesh = voxel_mesh(name, surface, rgb, attributes or {})
    if replace:
        remove_result(name)
    mesh.materials.append(clay_material() if rgb is None else voxel_material())
    added = _add_object(name, mesh, collection, frame)
    added["voxel_size"] = grid.voxel_size
    added["method"] = method
    if smooth:
        mesh.shade_smooth()
        modifier = added.modifiers.new("Smooth Voxels", 'SMOOTH')
        modifier.factor, modifier.iterations = SMOOTH_FACTOR, SMOOTH_STEPS
    return added


def voxel_mesh(name: str, surface: Surface, rgb: np.ndarray | None, attributes: Mapping[str, np.ndarray]) -> bpy.types.Mesh:
    """Return a new mesh without material: see `add_voxel_mesh`."""
    count = len(surface.voxels)
    if rgb is not None and np.shape(rgb) != (count, 3):
        raise ValueError(f"rgb must have the shape ({count}, 3), not {np.shape(rgb)}")
    mesh = mesh_from_arrays(name, surface.vertices, surface.quads)
    try:
        if rgb is not None:
            set_face_colors(mesh, np.asarray(rgb)[surface.face_voxel])
        for attribute, values in attributes.items():
            if np.shape(values) != (count,):
                raise ValueError(f"attribute {attribute} must have the shape ({count},), not {np.shape(values)}")
            set_attribute(mesh, attribute, np.asarray(values)[surface.face_voxel], 'FACE')
    except ValueError:
        bpy.data.meshes.remove(mesh)
        raise
    return mesh


def replace_mesh(shown: bpy.types.Object, mesh: bpy.types.Mesh, material: bpy.types.Material) -> None:
    """Give an object another mesh of one material; what nobody uses any more goes."""
    before, name = shown.data, shown.data.name
    mesh.materials.append(material)
    shown.data = mesh
    materials = list(before.materials)
    if before.users == 0:
        bpy.data.meshes.remove(before)
    mesh.name = name
    for earlier in materials:
        remove_if_unused(earlier)


def add_polygon_mesh(name: str, vertices: np.ndarray, faces: np.ndarray, *, collection: bpy.types.Collection,
                     frame=None, method: str = "", replace: bool = True) -> bpy.types.Object:
    """Add a mesh without colours (a truth out of a file, a polyhedral hull), in plain clay.

    Parameters
    ----------
    name : str
        Made unique by Blender if something else has it.
    vertices : (v, 3) array
        In the object frame.
    faces : (f, k) int array
        Vertex indices, counter-clockwise seen from outside; all faces with k corners.
    collection : bpy.types.Collection
    frame : (4, 4) array, optional
        Object frame to world. Default: the identity.
    method : str
        What made the result, in words for the user; empty for a truth.
    replace : bool
        Remove an earlier Scanstage result of this name first.
    """
    mesh = mesh_from_arrays(name, vertices, faces)
    if replace:
        remove_result(name)
    mesh.materials.append(clay_material())
    added = _add_object(name, mesh, collection, frame)
    added["method"] = method
    return added


def add_vertices(name: str, positions: np.ndarray, *, collection: bpy.types.Collection, frame=None) -> bpy.types.Object:
    """Add a mesh of vertices alone, (v, 3) positions in the object frame; an earlier Scanstage result of this name is replaced."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(positions))
    mesh.attributes["position"].data.foreach_set("vector", np.asarray(positions, np.float32).ravel())
    remove_result(name)
    return _add_object(name, mesh, collection, frame)


def remove_result(name: str) -> None:
    """Remove the Scanstage result ``name`` with its mesh and materials, if there is one and nothing else uses them."""
    found = bpy.data.objects.get(name)
    if found is None or OWNER not in found:
        return
    materials = {slot.material for slot in found.material_slots if slot.material}
    groups = {modifier.node_group for modifier in found.modifiers if modifier.type == 'NODES' and modifier.node_group}
    mesh = found.data
    bpy.data.objects.remove(found)
    for group in groups:
        if OWNER in group and group.users == 0:
            bpy.data.node_groups.remove(group)
    if mesh.users == 0:
        materials.update(material for material in mesh.materials if material)
        bpy.data.meshes.remove(mesh)
    for material in materials:
        remove_if_unused(material)


def mesh_from_arrays(name: str, vertices: np.ndarray, faces: np.ndarray) -> bpy.types.Mesh:
    """Return a new flat-shaded mesh of (v, 3) vertices and (f, k) faces.

    Raises
    ------
    ValueError
        A face names a vertex that does not exist.
    """
    faces = np.asarray(faces, np.int32)
    if len(faces) and not (0 <= faces.min() and faces.max() < len(vertices)):
        raise ValueError(f"faces must hold indices from 0 to {len(vertices) - 1}")
    return polygon_mesh_from_arrays(name, vertices, faces.ravel(), np.arange(0, faces.size, faces.shape[1], dtype=np.int32))


def polygon_mesh_from_arrays(name: str, vertices: np.ndarray, corners: np.ndarray, starts: np.ndarray) -> bpy.types.Mesh:
    """Return a new flat-shaded mesh, laid out as `PolygonMesh` is."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.loops.add(len(corners))
    mesh.polygons.add(len(starts))
    if len(starts):
        mesh.attributes["position"].data.foreach_set("vector", np.asarray(vertices, np.float32).ravel())
        mesh.attributes[".corner_vert"].data.foreach_set("value", corners)
        mesh.polygons.foreach_set("loop_start", starts)
    mesh.update(calc_edges=True)
    mesh.shade_flat()
    return mesh


def set_face_colors(mesh: bpy.types.Mesh, rgb: np.ndarray) -> None:
    """Store the linear colours (f, 3) of the faces, which all have equally many corners, and show them.

    On corners, although every face has one colour: the viewport and Blender's exporters know no colours of faces.
    """
    corners = len(mesh.loops) // max(len(mesh.polygons), 1)
    rgba = np.ones((len(rgb), corners, 4), np.float32)
    rgba[..., :3] = np.asarray(rgb, np.float32)[:, None]
    layer = mesh.color_attributes.new(COLOR, 'FLOAT_COLOR', 'CORNER')
    layer.data.foreach_set("color", rgba.ravel())
    mesh.color_attributes.active_color_name = COLOR
    mesh.color_attributes.default_color_name = COLOR


def set_attribute(mesh: bpy.types.Mesh, name: str, values: np.ndarray, domain: str) -> None:
    """Store one bool, integer or float per element of ``domain`` (``'FACE'`` or ``'POINT'``).

    A numeric attribute of this name that is already there is replaced.

    Raises
    ------
    ValueError
        The values do not fit the mesh, or the name is that of the mesh's geometry or colours.
    """
    kind, dtype = {"b": ('BOOLEAN', bool), "i": ('INT', np.int32), "u": ('INT', np.int32)}.get(
        values.dtype.kind, ('FLOAT', np.float32))
    present = mesh.attributes.get(name)
    if present is not None and present.data_type in ('BOOLEAN', 'INT', 'FLOAT') and not present.is_required:
        mesh.attributes.remove(present)
    elif present is not None:
        raise ValueError(f"the mesh has an attribute {name} of its own")
    layer = mesh.attributes.new(name, kind, domain)
    if len(layer.data) != len(values):
        mesh.attributes.remove(layer)
        raise ValueError(f"attribute {name}: {len(values)} values do not fit domain {domain}")
    layer.data.foreach_set("value", np.ascontiguousarray(values, dtype))


def _add_object(name: str, mesh: bpy.types.Mesh, collection: bpy.types.Collection, frame) -> bpy.types.Object:
    added = bpy.data.objects.new(name, mesh)
    mesh.name = added.name  # its own was made unique while an earlier result still had it
    added[OWNER] = "result"
    if frame is not None:
        added.matrix_world = Matrix(np.asarray(frame, np.float64).tolist())
    collection.objects.link(added)
    return added
