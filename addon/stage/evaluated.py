# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The geometry that a render sees: with render levels of modifiers, instances made real, hidden parts left out.

The viewport's evaluation differs from the render's (subdivision levels, modifiers shown in one of them, visibility),
and Blender hands the render's to render engines only. So this module is one: an engine that reads instead of drawing.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from . import scene_settings

_BORROWED = ("render.engine", "render.use_compositing", "render.use_sequencer", "render.use_multiview",
             "render.use_border", "render.use_freestyle")


class MeshReader(bpy.types.RenderEngine):
    """Collects the triangles of some objects instead of rendering. Registered only while it reads."""

    bl_idname = "SCANSTAGE_MESH_READER"
    bl_label = "Scanstage Mesh Reader"
    bl_use_postprocess = False

    wanted: frozenset[int] = frozenset()
    parts: list[tuple[np.ndarray, np.ndarray]] = []

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Read the render's dependency graph; Blender calls this once for each view layer."""
        if type(self).parts:
            return  # an object that several view layers show is still one object
        type(self).parts = [mesh_triangles(instance.object.data, np.array(instance.matrix_world))
                            for instance in depsgraph.object_instances if self._is_wanted(instance)]

    def _is_wanted(self, instance: bpy.types.DepsgraphObjectInstance) -> bool:
        # Curves, texts and the like come as an instance of a mesh whose parent is the object itself.
        owner = instance.parent if instance.is_instance else instance.object
        return instance.object.type == "MESH" and instance.show_self and owner.original.session_uid in self.wanted


def render_mesh(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of objects as the present frame's render sees them.

    Parameters
    ----------
    scene : bpy.types.Scene
    objects : iterable of bpy.types.Object
        Instances that one of them makes belong to it; children do not.

    Returns
    -------
    vertices : (n, 3) float64 array
        In the world.
    triangles : (m, 3) int32 array
        Counter-clockwise seen from outside.
    """
    camera, before = scene.camera, scene_settings.snapshot(scene, _BORROWED)
    stand_in = None if camera else bpy.data.objects.new("Scanstage Reader", bpy.data.cameras.new("Scanstage Reader"))
    MeshReader.wanted, MeshReader.parts = frozenset(o.session_uid for o in objects), []
    bpy.utils.register_class(MeshReader)
    try:
        scene.camera = camera or stand_in  # without a camera Blender does not call the engine
        scene_settings.apply(scene, {**dict.fromkeys(_BORROWED, False), "render.engine": MeshReader.bl_idname})
        bpy.ops.render.render(scene=scene.name)
        parts = MeshReader.parts
    finally:
        scene_settings.apply(scene, before)
        bpy.utils.unregister_class(MeshReader)
        MeshReader.wanted, MeshReader.parts = frozenset(), []
        scene.camera = camera
        if stand_in is not None:
            bpy.data.cameras.remove(stand_in.data)
    return joined(parts)


def mesh_triangles(mesh: bpy.types.Mesh, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (n, 3) of a mesh in the world, and its triangles (m, 3), counter-clockwise seen from outside."""
    mesh.calc_loop_triangles()
    local = np.zeros(len(mesh.vertices) * 3, np.float32)
    corners = np.zeros(len(mesh.loop_triangles) * 3, np.int32)
    mesh.vertices.foreach_get("co", local)
    mesh.loop_triangles.foreach_get("vertices", corners)
    vertices = local.reshape(-1, 3).astype(np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
    triangles = corners.reshape(-1, 3)
    mirrored = np.linalg.det(to_world[:3, :3]) < 0
    return vertices, triangles[:, ::-1] if mirrored else triangles


def joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices and triangles of several meshes as those of one."""
    first = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    vertices = [np.zeros((0, 3))] + [vertices for vertices, _ in parts]
    triangles = [np.zeros((0, 3), np.int32)] + [corners + np.int32(start)
                                                for start, (_, corners) in zip(first, parts, strict=False)]
    return np.concatenate(vertices), np.concatenate(triangles)
