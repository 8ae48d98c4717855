# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result as a file for other programs, the format chosen by the file's ending.

Blender's own exporters write everything but .vox. They work on a scene of their own that is gone afterwards: the
user's scene, selection and data-blocks stay as they are. Every format keeps its own convention for axes (.obj and
.glb are y-up, the others z-up); what Blender imports again stands where it stood. .stl holds no colours, and .vox no
lengths.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..errors import ScanstageError
from ..files import NotWritten, check_room
from ..options import Option, Value, resolve
from ..progress import Progress, silent
from .blend import reason_of
from .folder import read_result
from .materials import remove_if_unused
from .objects import add_polygon_mesh, add_voxel_mesh
from .vox import write_vox

if TYPE_CHECKING:
    from ..reconstruction.geometry import VoxelGrid
    from ..reconstruction.mesh import TriangleMesh
    from ..reconstruction.volumetric.surface import Surface


EXPORT_OPTIONS = (
    Option("smooth", False, "Take off the voxels' steps; has no effect on .vox, and is a live modifier in .blend"),
)

_CLAY = (0.6, 0.58, 0.55)


def export_result(folder, path, options: Mapping[str, Value] | None = None, progress: Progress = silent) -> int:
    """Write the mesh of a result folder, as `export_mesh` does.

    Parameters
    ----------
    folder, path : path-like
    options : mapping, optional
        See `EXPORT_OPTIONS`.
    progress : callable

    Returns
    -------
    int
        The number of the surface's faces.

    Raises
    ------
    ScanstageError
        An option is unknown, the result cannot be read, or as `export_mesh`.
    """
    options = resolve(EXPORT_OPTIONS, options or {}, "mesh")
    _check_ending(Path(path))
    progress(0.0, "Reading the result")
    result = read_result(folder)
    progress(0.5, f"Writing {Path(path).name}")
    export_mesh(result.surface, result.colors and result.colors.rgb, path, grid=result.volume.grid,
                method=str(result.report.get("method", "")), mesh=result.mesh, **options)
    progress(1.0, "Done")
    return len(result.surface.quads if result.mesh is None or Path(path).suffix.lower() == ".vox" else result.mesh.triangles)


def export_mesh(surface: Surface, rgb: np.ndarray | None, path, *, grid: VoxelGrid, frame=None, method: str = "",
                smooth: bool = False, mesh: TriangleMesh | None = None) -> None:
    """Write a coloured voxel mesh, whole or not at all. The object in the file has the file's name.

    Parameters
    ----------
    surface : Surface
        In the object frame.
    rgb : (s, 3) array or None
        Linear colour of every surface voxel; None for a method that finds no colours.
    path : path-like
        Ends in .blend, .ply, .obj (with its .mtl beside it), .stl, .glb or .vox. Replaced if it exists.
    grid : VoxelGrid
        Of the volume the surface was taken from.
    frame : (4, 4) array, optional
        Object frame to the file's world. Default: the identity. A .vox is always in the grid's axes.
    method : str
        As for `add_voxel_mesh`; kept in a .blend.
    smooth : bool
        As for `add_voxel_mesh`. In .ply and .obj the colours of neighbouring voxels then run into each other.
    mesh : TriangleMesh, optional
        The surface that the method found itself: written in place of the voxels', as it is, but to .vox.

    Raises
    ------
    ScanstageError
        The ending is none of these, the surface is empty, or the file cannot be written.
    """
    path = Path(path)
    ending = _check_ending(path)
    if not len(surface.quads):
        raise ScanstageError(f"{path}: the result has no voxels to write; check its bounds and the silhouettes")
    if ending == ".vox":
        write_vox(path, surface.voxels, np.broadcast_to(_CLAY, surface.voxels.shape) if rgb is None else rgb)
        return
    if ending in _COLORS_ON_VERTICES and rgb is not None and not smooth:
        surface = split_voxels(surface)
    with _own_scene(path.stem) as scene:
        if mesh is None:
            add_voxel_mesh(path.stem, surface, rgb, collection=scene.collection, grid=grid, frame=frame, method=method,
                           smooth=smooth, replace=False)
        else:
            add_polygon_mesh(path.stem, mesh.vertices, mesh.triangles, collection=scene.collection, frame=frame, method=method,
                             replace=False)
        _write_whole(path, lambda temporary: _WRITERS[ending](scene, str(temporary)))


def _check_ending(path: Path) -> str:
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ScanstageError(f"{path}: cannot be written as {ending or 'a file without ending'}; "
                             f"the ending must be one of {' '.join(ENDINGS)}")
    return ending


def split_voxels(surface: Surface) -> Surface:
    """Return the surface with no vertex shared by two voxels, so that a vertex can have its voxel's colour."""
    count = len(surface.vertices)
    owned = surface.quads + surface.face_voxel[:, None].astype(np.int64) * count
    unique, quads = np.unique(owned, return_inverse=True)
    return replace(surface, vertices=surface.vertices[unique % count], quads=quads.reshape(-1, 4).astype(np.int32))


@contextmanager
def _own_scene(name: str) -> Iterator[bpy.types.Scene]:
    """Make a scene that disappears afterwards, with all that was put into it."""
    scene = bpy.data.scenes.new(name)
    try:
        yield scene
    finally:
        for member in list(scene.collection.objects):
            mesh, materials = member.data, list(member.data.materials)
            bpy.data.objects.remove(member)
            bpy.data.meshes.remove(mesh)
            for material in materials:
                remove_if_unused(material)
        bpy.data.scenes.remove(scene)


def _write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Let ``write`` make the file, and what belongs to it, in a hidden folder beside ``path``; then move all there."""
    if path.is_dir():  # told before the parts are moved
        raise ScanstageError(f"{path}: cannot be written, for it is a folder; give another name")
    try:
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
            temporary = Path(folder, path.name).with_suffix(path.suffix.lower())
            write(temporary)
            check_room(path.parent)
            for part in set(Path(folder).iterdir()) - {temporary}:  # first: the file names them
                os.replace(part, path.parent / part.name)
            os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # the latter is how operators report what goes wrong
        raise NotWritten(path, reason_of(error)) from None


def _write_blend(scene: bpy.types.Scene, filepath: str) -> None:
    scene.view_layers[0].update()  # Blender 5.2 crashes when it writes a view layer that has never been synchronised
    bpy.data.libraries.write(filepath, {scene}, compress=True)


def _write_ply(scene: bpy.types.Scene, filepath: str) -> None:
    with _in(scene):
        bpy.ops.wm.ply_export(filepath=filepath, export_colors='SRGB')


def _write_obj(scene: bpy.types.Scene, filepath: str) -> None:
    with _in(scene):
        bpy.ops.wm.obj_export(filepath=filepath, export_colors=True)


def _write_stl(scene: bpy.types.Scene, filepath: str) -> None:
    with _in(scene):
        bpy.ops.wm.stl_export(filepath=filepath)


def _write_glb(scene: bpy.types.Scene, filepath: str) -> None:
    if not hasattr(bpy.types, "EXPORT_SCENE_OT_gltf"):  # the only exporter that is an add-on
        raise ScanstageError(f"{Path(filepath).name}: enable Blender's add-on \"glTF 2.0 format\" to write .glb files")
    with _in(scene), redirect_stderr(io.StringIO()):  # of an error it would print the traceback, besides raising it
        # Without use_active_scene the file would hold every scene there is.
        bpy.ops.export_scene.gltf(filepath=filepath, export_format='GLB', use_active_scene=True,
                                  export_vertex_color='ACTIVE', export_apply=True, export_animations=False)


def _in(scene: bpy.types.Scene):
    return bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0])


_WRITERS = {".blend": _write_blend, ".ply": _write_ply, ".obj": _write_obj, ".stl": _write_stl, ".glb": _write_glb}
_COLORS_ON_VERTICES = (".ply", ".obj")  # colours of shared vertices would be blurred between voxels
ENDINGS = (*_WRITERS, ".vox")
