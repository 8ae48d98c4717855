# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh from any file that Blender imports, as plain triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..reconstruction.mesh import TriangleMesh
from .ply import read_ply


def read_mesh(path: Path) -> TriangleMesh:
    """Read the triangles of a mesh file, in the file's own units and frame.

    A .ply needs no Blender; everything else goes through its importers, and nothing of it stays in the open file.

    Raises
    ------
    ScanstageError
        There is no such file, its ending is unknown, or it holds no mesh.
    """
    path = Path(path)
    if not path.is_file():
        raise ScanstageError(f"{path}: there is no such file")
    if path.suffix.lower() == ".ply":
        return read_ply(path)
    return _imported(path)


def _imported(path: Path) -> TriangleMesh:
    import bpy

    from ..stage.objects import IMPORTERS

    if path.suffix.lower() not in IMPORTERS:
        raise ScanstageError(f"{path}: unknown ending; the truth can be one of {' '.join(IMPORTERS)}")
    before = {id.session_uid for id in bpy.data.user_map()}
    try:
        IMPORTERS[path.suffix.lower()](str(path))
        parts = [_triangles(each) for each in bpy.data.objects if each.session_uid not in before and each.type == 'MESH']
    except RuntimeError as error:  # how an importer reports a bad file
        raise ScanstageError(f"{path}: Blender cannot read this file ({str(error).strip().splitlines()[0]})") from None
    finally:
        bpy.data.batch_remove([id for id in bpy.data.user_map() if id.session_uid not in before])
    if not any(len(triangles) for _, triangles in parts):
        raise ScanstageError(f"{path}: holds no mesh; export the object's surface")
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    return TriangleMesh(np.concatenate([vertices for vertices, _ in parts]),
                        np.concatenate([triangles + start for (_, triangles), start in zip(parts, starts, strict=True)]))


def _triangles(member) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices of a mesh object in the world, and its triangles."""
    mesh = member.data
    vertices, triangles = np.zeros(3 * len(mesh.vertices)), np.zeros(3 * len(mesh.loop_triangles), np.int32)
    mesh.vertices.foreach_get("co", vertices)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    world = np.array(member.matrix_world)
    return vertices.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3], triangles.reshape(-1, 3)
