# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measured points as a Blender object: vertices with colours, drawn as points by a live modifier.

Blender 4.5 cannot fill a point cloud from Python, and both versions draw what the node *Mesh to Points* makes of vertices.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..reconstruction.points import PointCloud
from .materials import OWNER, voxel_material
from .objects import COLOR, add_vertices, set_attribute

POINTS_GROUP = "Scanstage Points"
_RADIUS = "radius"  # an attribute: scripts set a modifier's own inputs differently in each version
_RADII_A_SPACING = 0.5


def add_points(name: str, cloud: PointCloud, *, collection: bpy.types.Collection, frame=None, method: str = "") -> bpy.types.Object:
    """Add measured points, with the point attributes ``Color`` (linear), ``direction`` (the normal), ``sigma``, ``view``, ``radius``.

    Parameters
    ----------
    name : str
        An earlier Scanstage result of this name is replaced.
    cloud : PointCloud
        In the object frame.
    collection : bpy.types.Collection
    frame : (4, 4) array, optional
        Object frame to world. Default: the identity.
    method : str
        What made the result, in words for the user.
    """
    added = add_vertices(name, cloud.positions, collection=collection, frame=frame)
    mesh = added.data
    rgba = np.column_stack((cloud.colors, np.ones(len(cloud), np.float32)))
    mesh.color_attributes.new(COLOR, 'FLOAT_COLOR', 'POINT').data.foreach_set("color", rgba.astype(np.float32).ravel())
    mesh.color_attributes.active_color_name = COLOR
    mesh.attributes.new("direction", 'FLOAT_VECTOR', 'POINT').data.foreach_set("vector", cloud.normals.ravel())
    set_attribute(mesh, "sigma", cloud.sigma, 'POINT')
    set_attribute(mesh, "view", cloud.view, 'POINT')
    mesh.materials.append(voxel_material())
    set_attribute(mesh, _RADIUS, np.full(len(cloud), _RADII_A_SPACING * _spacing(cloud), np.float32), 'POINT')
    added.modifiers.new("Points", 'NODES').node_group = _points_group()
    added["method"] = method
    return added


def _spacing(cloud: PointCloud) -> float:
    """Return about how far neighbouring points lie apart, as if they were spread over the faces of their bounding box."""
    x, y, z = np.ptp(cloud.positions, axis=0) if len(cloud) else np.ones(3)
    return float(np.sqrt((x * y + y * z + z * x) / max(len(cloud), 1)))


def _points_group() -> bpy.types.NodeTree:
    """Return the node group that all points share: mesh to points, with the material that reads their colour."""
    found = bpy.data.node_groups.get(POINTS_GROUP)
    if found is not None and OWNER in found:
        return found
    group = bpy.data.node_groups.new(POINTS_GROUP, 'GeometryNodeTree')
    group[OWNER] = "points"
    group.interface.new_socket("Geometry", in_out='INPUT', socket_type='NodeSocketGeometry')
    group.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    kinds = "NodeGroupInput", "GeometryNodeInputNamedAttribute", "GeometryNodeMeshToPoints", "GeometryNodeSetMaterial", "NodeGroupOutput"
    start, radius, points, material, end = (group.nodes.new(kind) for kind in kinds)
    for place, node in enumerate((start, radius, points, material, end)):
        node.location.x = 200 * place
    radius.data_type, radius.inputs["Name"].default_value = 'FLOAT', _RADIUS
    material.inputs["Material"].default_value = voxel_material()
    for source, target in ((start.outputs["Geometry"], points.inputs["Mesh"]), (radius.outputs["Attribute"], points.inputs["Radius"]),
                           (points.outputs["Points"], material.inputs["Geometry"]), (material.outputs["Geometry"], end.inputs["Geometry"])):
        group.links.new(source, target)
    return group
