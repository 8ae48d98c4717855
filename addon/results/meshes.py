# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh from any file that Blender imports, as plain triangles."""

from __future__ import annotations

from pathlib import Path

from ..errors import ScanstageError
from ..reconstruction.mesh import TriangleMesh
from .ply import read_ply


def read_mesh(path: Path) -> TriangleMesh:
    """Read the triangles of a mesh file, in the file's own units and frame.

    A .ply needs no Blender; everything else goes through its importers, and nothing of it stays in the open file.

    Raises
    ------
    ScanstageError
        There is no such file, its ending is unknown, it cannot be read, or it holds no mesh.
    """
    path = Path(path)
    if not path.is_file():
        raise ScanstageError(f"{path}: there is no such file")
    mesh = read_ply(path) if path.suffix.lower() == ".ply" else _imported(path)
    if not len(mesh.triangles):
        raise ScanstageError(f"{path}: holds no mesh; export the object's surface")
    return mesh


def _imported(path: Path) -> TriangleMesh:
    import bpy

    from ..stage.evaluated import render_mesh
    from ..stage.objects import IMPORTERS

    ending = path.suffix.lower()
    if ending not in IMPORTERS:
        raise ScanstageError(f"{path}: unknown ending; a mesh can be read from {' '.join(IMPORTERS)}")
    scene = bpy.data.scenes.new("Scanstage Import")
    before = {datablock.session_uid for datablock in bpy.data.user_map()}
    try:
        IMPORTERS[ending](str(path))
        made = [each for each in bpy.data.objects if each.session_uid not in before]
        for each in made:  # wherever the importer put it: to be evaluated, with its parents, and seen
            scene.collection.objects.link(each)
        return TriangleMesh(*render_mesh(scene, made))
    except (RuntimeError, AttributeError, OSError, ValueError) as error:  # from importers, libraries, and for NaN
        reason = " ".join(str(error).removeprefix("Error: ").split())
        raise ScanstageError(f"{path}: cannot be read ({reason}); export it again") from None
    finally:
        bpy.data.batch_remove([scene, *(each for each in bpy.data.user_map() if each.session_uid not in before)])
