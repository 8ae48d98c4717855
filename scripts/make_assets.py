# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the built-in objects in assets/objects/ with Blender's own modelling tools. The same input, the same bytes.

Run from the root of a clone, in Blender or in a Python that has its ``bpy``::

    python -m scripts.make_assets [FOLDER]

Every object is one closed surface, 0.2 m in its largest dimension, with the middle of its base at the origin.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import bpy

# isort: split
import bmesh  # exists once bpy is imported
import numpy as np
from mathutils import Matrix

from addon.results.ply import write_ply
from addon.stage.objects import BUILTIN_SIZE, evaluated_copy, resize

FOLDER = Path(__file__).resolve().parent.parent / "assets" / "objects"
TRIANGLES = 12500  # keeps a file below 250 kB
COMMENTS = ("SPDX-FileCopyrightText: 2026 Scanstage Authors", "SPDX-License-Identifier: GPL-3.0-or-later",
            "Made by scripts/make_assets.py")


def dented_sphere() -> bpy.types.Object:
    """Return a unit sphere with three round dents, each deeper than the one before."""
    helper = _object("sphere", lambda b: bmesh.ops.create_icosphere(b, subdivisions=6, radius=1.0))
    for azimuth, elevation, radius, depth in ((-100, 10, 0.55, 0.28), (25, -8, 0.50, 0.40), (140, 28, 0.42, 0.55)):
        a, e = math.radians(azimuth), math.radians(elevation)
        toward = np.array([math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)])
        tool = _object("dent", lambda b, r=radius: bmesh.ops.create_icosphere(b, subdivisions=5, radius=r))
        tool.location = toward * (1.0 + radius - depth)
        _boolean(helper, tool, "DIFFERENCE")
    _remesh(helper, 0.018)
    helper.modifiers.new("Soft", "SMOOTH").iterations = 5  # the voxels have cut the dents' rims into steps
    return _decimated(helper, TRIANGLES)


def pot() -> bpy.types.Object:
    """Return a turned pot: solid walls, and a pit two thirds as deep as its mouth is wide."""
    mouth, depth = 0.62, 2 * 0.62 * 0.67
    height, floor = 1.0, 1.0 - depth
    outside = [(0.0, 0.0), (0.50, 0.0), (0.56, 0.02), (0.58, 0.06), (0.70, 0.20), (0.80, 0.38), (0.83, 0.55),
               (0.79, 0.74), (0.73, 0.86), (0.74, 0.92), (0.79, 0.97), (0.78, 0.995), (0.74, height)]
    inside = [(mouth + 0.06, height), (mouth + 0.01, 0.97), (mouth, 0.93), (mouth - 0.01, 0.80), (mouth - 0.01, 0.50),
              (mouth - 0.02, floor + 0.14), (mouth - 0.08, floor + 0.045), (mouth - 0.20, floor + 0.008), (0.0, floor)]
    helper = _object("pot", lambda b: _polyline(b, [(x, 0.0, z) for x, z in outside + inside]))
    screw = helper.modifiers.new("Turn", "SCREW")
    screw.steps = screw.render_steps = 48
    screw.use_merge_vertices, screw.merge_threshold = True, 1e-4
    screw.use_normal_calculate = True
    helper.modifiers.new("Round", "SUBSURF").levels = 1
    return helper


def knot() -> bpy.types.Object:
    """Return a trefoil knot of a round tube, standing upright, flatter from front to back than wide."""
    curve = bpy.data.curves.new("knot", "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution = "3D", 0.30, 8
    spline = curve.splines.new("POLY")
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    points = np.stack((np.sin(angle) + 2 * np.sin(2 * angle), -np.sin(3 * angle), np.cos(angle) - 2 * np.cos(2 * angle),
                       np.ones_like(angle)), axis=1) * (0.4, 0.5, 0.4, 1.0)
    spline.points.add(len(points) - 1)
    spline.points.foreach_set("co", points.astype(np.float32).ravel())
    spline.use_cyclic_u = True
    return bpy.data.objects.new("knot", curve)


def figure() -> bpy.types.Object:
    """Return a standing figure on a small base: thin legs and arms, one arm on the hip, a staff in the other hand."""
    limbs = [([(0.00, 0, 1.02), (0.00, 0, 1.22), (0.01, 0, 1.38)], [0.115, 0.105, 0.140]),  # hips, waist, chest
             ([(-0.12, 0, 1.43), (0.14, 0, 1.43)], [0.068, 0.068]),  # shoulders
             ([(0.01, 0, 1.42), (0.01, -0.01, 1.68)], [0.055, 0.050]),  # neck
             ([(-0.07, 0, 0.98), (-0.13, -0.04, 0.55), (-0.15, 0.01, 0.08)], [0.088, 0.060, 0.042]),
             ([(0.07, 0, 0.98), (0.16, -0.06, 0.56), (0.20, 0.00, 0.08)], [0.088, 0.060, 0.042]),
             ([(-0.15, 0.02, 0.09), (-0.17, -0.16, 0.075)], [0.048, 0.036]),  # feet
             ([(0.20, 0.01, 0.09), (0.24, -0.16, 0.075)], [0.048, 0.036]),
             ([(-0.14, 0, 1.43), (-0.40, 0.05, 1.22), (-0.13, -0.07, 1.04)], [0.056, 0.040, 0.034]),  # hand on hip
             ([(0.16, 0, 1.43), (0.40, -0.02, 1.30), (0.50, -0.17, 1.56)], [0.056, 0.040, 0.036]),
             ([(0.50, -0.17, 0.03), (0.50, -0.17, 2.05)], [0.026, 0.026])]  # staff
    parts = [_limb(points, radii) for points, radii in limbs]
    head = _object("head", lambda b: bmesh.ops.create_icosphere(b, subdivisions=4, radius=0.15))
    head.matrix_basis = Matrix.LocRotScale((0.01, -0.02, 1.78), None, (0.84, 0.98, 1.12))
    base = _object("base", lambda b: bmesh.ops.create_cone(b, cap_ends=True, segments=128, radius1=0.46, radius2=0.43,
                                                           depth=0.06))
    base.matrix_basis = Matrix.Translation((0.17, -0.07, 0.03))
    helper = _joined([*parts, head, base])
    _remesh(helper, 0.010)  # of parts that overlap it keeps the outer surface: their union, with rounded seams
    helper.modifiers.new("Soft", "SMOOTH").iterations = 2
    return _decimated(helper, TRIANGLES)


OBJECTS: Mapping[str, Callable[[], bpy.types.Object]] = {
    "dented-sphere": dented_sphere, "pot": pot, "knot": knot, "figure": figure}


def make(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return an object's vertices (n, 3) in metres and triangles (m, 3), counter-clockwise seen from outside."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mesh = evaluated_copy(OBJECTS[name]())
    shape = bmesh.new()
    shape.from_mesh(mesh)
    bmesh.ops.triangulate(shape, faces=shape.faces)
    if shape.calc_volume(signed=True) < 0:
        bmesh.ops.reverse_faces(shape, faces=shape.faces)
    shape.to_mesh(mesh)
    shape.free()
    resize(mesh, BUILTIN_SIZE)
    vertices, triangles = np.zeros(len(mesh.vertices) * 3, np.float32), np.zeros(len(mesh.polygons) * 3, np.int32)
    mesh.vertices.foreach_get("co", vertices)
    mesh.polygons.foreach_get("vertices", triangles)
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3)


def main(folder: Path = FOLDER) -> None:
    """Write every object."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in OBJECTS:
        vertices, triangles = make(name)
        path = folder / f"{name}.ply"
        write_ply(path, vertices, triangles, comments=COMMENTS)
        print(f"{path.name}: {len(vertices)} vertices, {len(triangles)} triangles, {path.stat().st_size // 1000} kB")


def _object(name: str, shape: Callable[[bmesh.types.BMesh], object]) -> bpy.types.Object:
    mesh, cage = bpy.data.meshes.new(name), bmesh.new()
    shape(cage)
    cage.to_mesh(mesh)
    cage.free()
    return bpy.data.objects.new(name, mesh)


def _polyline(cage: bmesh.types.BMesh, points: list[tuple[float, float, float]]) -> None:
    corners = [cage.verts.new(point) for point in points]
    for a, b in zip(corners, corners[1:], strict=False):
        cage.edges.new((a, b))


def _limb(points: list[tuple[float, float, float]], radii: list[float]) -> bpy.types.Object:
    """Return a capsule with a knee at each inner point: a bevelled curve with a ball at every point."""
    curve = bpy.data.curves.new("limb", "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution, curve.use_fill_caps = "3D", 1.0, 6, True
    spline = curve.splines.new("POLY")
    spline.points.add(len(points) - 1)
    for point, position, radius in zip(spline.points, points, radii, strict=True):
        point.co, point.radius = (*position, 1.0), radius
    balls = [_object("ball", lambda b, r=radius: bmesh.ops.create_icosphere(b, subdivisions=4, radius=r))
             for radius in radii]
    for ball, position in zip(balls, points, strict=True):
        ball.matrix_basis = Matrix.Translation(position)
    return _joined([bpy.data.objects.new("limb", curve), *balls])


def _joined(parts: list[bpy.types.Object]) -> bpy.types.Object:
    """Return one object with the surfaces of all parts, where they stand."""
    whole = bmesh.new()
    for part in parts:
        mesh = evaluated_copy(part)
        mesh.transform(part.matrix_basis)
        whole.from_mesh(mesh)
    mesh = bpy.data.meshes.new("joined")
    whole.to_mesh(mesh)
    whole.free()
    return _object_of(mesh)


def _object_of(mesh: bpy.types.Mesh) -> bpy.types.Object:
    return bpy.data.objects.new(mesh.name, mesh)


def _boolean(helper: bpy.types.Object, tool: bpy.types.Object, operation: str) -> None:
    bpy.context.scene.collection.objects.link(tool)
    modifier = helper.modifiers.new(tool.name, "BOOLEAN")
    modifier.operation, modifier.solver, modifier.object = operation, "EXACT", tool


def _remesh(helper: bpy.types.Object, voxel_size: float) -> None:
    modifier = helper.modifiers.new("Even", "REMESH")
    modifier.mode, modifier.voxel_size = "VOXEL", voxel_size


def _decimated(helper: bpy.types.Object, triangles: int) -> bpy.types.Object:
    """Return the object with its modifiers applied and reduced to a number of triangles, where they matter least."""
    dense = _object_of(evaluated_copy(helper))
    count = sum(len(polygon.vertices) - 2 for polygon in dense.data.polygons)
    dense.modifiers.new("Few", "DECIMATE").ratio = min(1.0, triangles / count)
    return dense


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:2]))
