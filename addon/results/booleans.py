# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Solids cut by Blender's boolean solvers, which come as arrays and go as arrays: nothing stays in the open file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import chain

import bpy
import numpy as np
from mathutils import Vector
from mathutils.geometry import delaunay_2d_cdt

from ..reconstruction.mesh import PolygonMesh, TriangleMesh
from ..reconstruction.volumetric.polyhedral_hull import Solids
from ..reconstruction.volumetric.silhouette_cones import BackgroundCone
from ..stage.evaluated import mesh_triangles
from .objects import polygon_mesh_from_arrays

_INSIDE_CONSTRAINTS = 1  # a kind of output of Blender's triangulation
_SAME_POINT = 1e-5  # px


def solver(run: Callable[[Callable], Callable] = lambda function: function) -> Solids:
    """Return Blender's solver; ``run`` may wrap its functions, to have them called in Blender's main thread."""
    return Solids(run(carve), run(triangle_mesh))


def carve(body: PolygonMesh, cone: BackgroundCone) -> PolygonMesh:
    """Return what of a solid lies outside a cone. To be called in Blender's main thread."""
    points, triangles = triangulate(cone.window, cone.contours)
    if not len(triangles):
        return body
    solid = cone.solid(points, triangles)
    left = difference(replace(body, vertices=cone.to_view(body.vertices)), replace(solid, vertices=cone.to_view(solid.vertices)))
    return replace(left, vertices=cone.from_view(left.vertices))


def triangulate(window: tuple[np.ndarray, ...], contours: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate what lies inside an odd number of window loops and an even number of contours.

    Parameters
    ----------
    window, contours : tuple of (n, 2) array
        They may cross each other.

    Returns
    -------
    points : (p, 2) float64 array
    triangles : (t, 3) int64 array
        Counter-clockwise as x turns to y.
    """
    loops = [loop if _area(loop) > 0 else loop[::-1] for loop in window + contours]
    starts = np.cumsum([0] + [len(loop) for loop in loops])
    faces = [list(range(start, stop)) for start, stop in zip(starts[:-1], starts[1:], strict=True)]
    points, _, triangles, _, _, owners = delaunay_2d_cdt([Vector(point) for point in np.concatenate(loops).tolist()], [], faces,
                                                         _INSIDE_CONSTRAINTS, _SAME_POINT)
    triangle = np.repeat(np.arange(len(owners)), np.fromiter(map(len, owners), np.int64, len(owners)))
    owner = np.fromiter(chain.from_iterable(owners), np.int64, len(triangle))
    windows, insides = (np.bincount(triangle[which], minlength=len(owners)) for which in (owner < len(window), owner >= len(window)))
    kept = (windows % 2 == 1) & (insides % 2 == 0)
    return np.array(points, np.float64).reshape(-1, 2), np.array(triangles, np.int64).reshape(-1, 3)[kept]


def difference(body: PolygonMesh, cutter: PolygonMesh) -> PolygonMesh:
    """Return what of a solid lies outside another, by Blender's manifold solver.

    (Its exact solver takes hundreds of times as long, and may run out of memory, which ends Blender.)
    """
    scene = bpy.data.scenes.new("Scanstage Boolean")
    made = [scene]
    try:
        target, tool = (_object(scene, mesh, made) for mesh in (body, cutter))
        modifier = target.modifiers.new("Difference", 'BOOLEAN')
        modifier.operation, modifier.solver, modifier.object = 'DIFFERENCE', 'MANIFOLD', tool
        view_layer = scene.view_layers[0]
        view_layer.update()
        return _polygons(target.evaluated_get(view_layer.depsgraph).data)
    finally:
        bpy.data.batch_remove(made)


def triangle_mesh(body: PolygonMesh) -> TriangleMesh:
    """Return a solid's surface in triangles, with one on either side of each edge."""
    mesh = _two_sided_mesh(body)
    try:
        return TriangleMesh(*mesh_triangles(mesh, np.eye(4)))
    finally:
        bpy.data.meshes.remove(mesh)


def _object(scene: bpy.types.Scene, solid: PolygonMesh, made: list[bpy.types.ID]) -> bpy.types.Object:
    mesh = _two_sided_mesh(solid)
    added = bpy.data.objects.new(mesh.name, mesh)
    made += [added, mesh]
    scene.collection.objects.link(added)
    return added


def _polygons(mesh: bpy.types.Mesh) -> PolygonMesh:
    vertices, corners = np.zeros(3 * len(mesh.vertices), np.float32), np.zeros(len(mesh.loops), np.int32)
    starts = np.zeros(len(mesh.polygons), np.int32)
    mesh.vertices.foreach_get("co", vertices)
    mesh.loops.foreach_get("vertex_index", corners)
    mesh.polygons.foreach_get("loop_start", starts)
    return PolygonMesh(vertices.reshape(-1, 3).astype(np.float64), corners, starts)


def _two_sided_mesh(solid: PolygonMesh) -> bpy.types.Mesh:
    """Return a solid as a new mesh whose triangles leave one on either side of each edge, as the solver demands.

    Parts may meet in an edge, and Blender may divide neighbouring polygons along one and the same diagonal. The polygons
    there are divided for good: their triangles are joined in pairs, each pair with a point of its own in the middle of the edge.
    """
    while True:
        mesh = polygon_mesh_from_arrays("Scanstage Solid", solid.vertices, solid.corners, solid.starts)
        triangles = mesh_triangles(mesh, np.eye(4))[1].astype(np.int64)
        halves = _shared_twice(triangles, len(solid.vertices))
        if not len(halves):
            return mesh
        polygon = np.zeros(len(triangles), np.int32)
        mesh.loop_triangles.foreach_get("polygon_index", polygon)
        bpy.data.meshes.remove(mesh)
        divided = np.zeros(len(solid.starts), bool)
        divided[polygon[halves // 3]] = True
        solid = _divided(solid, divided, triangles, divided[polygon], halves)


def _shared_twice(triangles: np.ndarray, count: int) -> np.ndarray:
    """Return (n, 2) sides of triangles, numbered 3 t + k, that share an edge with another such pair; no triangle twice."""
    stop = np.roll(triangles, -1, axis=1)
    there, back = (triangles * count + stop).ravel(), (stop * count + triangles).ravel()
    there_order, back_order = np.argsort(there, kind="stable"), np.argsort(back, kind="stable")
    again = np.flatnonzero(np.diff(there[there_order], prepend=-1) == 0)
    halves = np.stack((there_order[again], back_order[again]), axis=1)
    _, first = np.unique(halves // 3, return_index=True)
    return halves[np.isin(np.arange(halves.size), first).reshape(halves.shape).all(axis=1)]


def _divided(solid: PolygonMesh, polygons: np.ndarray, triangles: np.ndarray, theirs: np.ndarray, halves: np.ndarray) -> PolygonMesh:
    """Return the solid with some polygons replaced by their triangles, those of ``halves`` cut in the middle of these sides."""
    triangle, side = np.divmod(halves, 3)
    a, b, c = (triangles[triangle, (side + turn) % 3] for turn in range(3))
    middle = np.broadcast_to(len(solid.vertices) + np.arange(len(halves))[:, None], a.shape)
    points = (solid.vertices[a[:, 0]] + solid.vertices[b[:, 0]]) / 2
    whole = theirs.copy()
    whole[triangle] = False
    pieces = np.concatenate((triangles[whole], np.stack((a, middle, c, middle, b, c), axis=-1).reshape(-1, 3)))
    kept = solid.without(polygons)
    return PolygonMesh(np.concatenate((solid.vertices, points)), np.concatenate((kept.corners, pieces.ravel().astype(np.int32))),
                       np.concatenate((kept.starts, len(kept.corners) + 3 * np.arange(len(pieces), dtype=np.int32))))


def _area(loop: np.ndarray) -> float:
    x, y = loop.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
