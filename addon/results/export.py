# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result as a file for other programs, the format chosen by the file's ending.

Blender's own exporters write meshes. They work on a scene of their own that is gone afterwards: the user's scene,
selection and data-blocks stay as they are. Every format keeps its own convention for axes (.obj and .glb are y-up, the
others z-up); what Blender imports again stands where it stood. .stl holds no colours, and .vox and .txt no lengths.

`FORMATS` is the one table of endings, which the command line, the panels and the manual read.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ..errors import ScanstageError
from ..files import NotWritten, check_room
from ..options import Option, Unit, Value, resolve
from ..progress import Progress, silent
from ..reconstruction.volumetric.coloring import SurfaceColors
from ..reconstruction.volumetric.volume import SparseVolume
from .blend import reason_of
from .folder import Result, volume_arrays
from .goxel import write_goxel
from .materials import remove_if_unused
from .npz import write_volume
from .objects import add_polygon_mesh, add_voxel_mesh
from .point_file import surface_points, write_points
from .vdb import write_vdb
from .volume_files import read_volume
from .vox import write_vox

if TYPE_CHECKING:
    from ..reconstruction.geometry import VoxelGrid
    from ..reconstruction.mesh import TriangleMesh
    from ..reconstruction.volumetric.surface import Surface


EXPORT_OPTIONS = (
    Option("smooth", False, "Take off the voxels' steps; has no effect on files of voxels, and is a live modifier in .blend"),
    Option("points", False, "Write points instead of faces, to .ply only: those that were measured or, failing these, the centres of the "
           "surface's voxels"),
    Option("voxel_size", 1.0, "Edge of a voxel that is read from .vox, which knows no length", unit=Unit.LENGTH, minimum=1e-9, maximum=1e9),
)

_CLAY = (0.6, 0.58, 0.55)


def export_result(source, path, options: Mapping[str, Value] | None = None, progress: Progress = silent) -> int:
    """Write the mesh, the voxels or the points of a result, as the file's ending says.

    Parameters
    ----------
    source : path-like
        A result folder, or a volume: see `volume_files.read_volume`.
    path : path-like
    options : mapping, optional
        See `EXPORT_OPTIONS`.
    progress : callable

    Returns
    -------
    int
        The number of the surface's faces, or of the points.

    Raises
    ------
    ScanstageError
        An option is unknown or does not go with the ending, the source cannot be read, or as `export_mesh`.
    """
    values, path = resolve(EXPORT_OPTIONS, options or {}, "mesh"), Path(path)
    ending = _check_ending(path)
    if values["points"] and ending != ".ply":
        raise ScanstageError(f"{path}: points are written as .ply only; change the file's ending, or leave points out")
    progress(0.0, "Reading the result")
    result = read_volume(source, voxel_size=values["voxel_size"])
    progress(0.5, f"Writing {path.name}")
    if values["points"]:
        count = _write_cloud(path, result)
    else:
        export_mesh(result.surface, result.colors and result.colors.rgb, path, grid=result.volume.grid, volume=result.volume,
                    method=str(result.report.get("method", "")), mesh=result.mesh, smooth=values["smooth"])
        own = result.mesh is not None and FORMATS[ending].of_scene is not None
        count = len(result.mesh.triangles if own else result.surface.quads)
    progress(1.0, "Done")
    return count


def export_mesh(surface: Surface, rgb: np.ndarray | None, path, *, grid: VoxelGrid, frame=None, method: str = "",
                smooth: bool = False, mesh: TriangleMesh | None = None, volume: SparseVolume | None = None) -> None:
    """Write a coloured voxel mesh, whole or not at all. The object in the file has the file's name.

    Parameters
    ----------
    surface : Surface
        In the object frame.
    rgb : (s, 3) array or None
        Linear colour of every surface voxel; None for a method that finds no colours.
    path : path-like
        Its ending is one of `FORMATS` (an .obj has its .mtl beside it). Replaced if it exists.
    grid : VoxelGrid
        Of the volume the surface was taken from.
    frame : (4, 4) array, optional
        Object frame to the file's world. Default: the identity. Voxels are always in the grid's axes.
    method : str
        As for `add_voxel_mesh`; kept in a .blend.
    smooth : bool
        As for `add_voxel_mesh`. In .ply and .obj the colours of neighbouring voxels then run into each other.
    mesh : TriangleMesh, optional
        The surface that the method found itself: written in place of the voxels', as it is, but to files of voxels.
    volume : SparseVolume, optional
        For formats that hold what is inside; without it that is hollow.

    Raises
    ------
    ScanstageError
        The ending is none of these, the surface is empty, or the file cannot be written.
    """
    path = Path(path)
    ending = _check_ending(path)
    if not len(surface.quads):
        raise ScanstageError(f"{path}: the result has no voxels to write; check its bounds and the silhouettes")
    if FORMATS[ending].of_scene is None:
        FORMATS[ending].of_voxels(path, _Voxels(surface, rgb, volume or SparseVolume.from_voxels(grid, surface.voxels)))
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
        _write_whole(path, lambda temporary: FORMATS[ending].of_scene(scene, str(temporary)))


@dataclass(frozen=True)
class _Voxels:
    """What a file of voxels is written from."""

    surface: Surface
    rgb: np.ndarray | None
    volume: SparseVolume

    @property
    def shades(self) -> np.ndarray:
        """The (s, 3) linear colours of the surface's voxels, clay where the method finds none."""
        return np.broadcast_to(_CLAY, self.surface.voxels.shape) if self.rgb is None else self.rgb


def _write_cloud(path: Path, result: Result) -> int:
    cloud = surface_points(result.surface, result.volume.grid, result.colors and result.colors.rgb) if result.points is None \
        else result.points
    write_points(path, cloud)
    return len(cloud)


def _check_ending(path: Path) -> str:
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise ScanstageError(f"{path}: cannot be written as {ending or 'a file without ending'}; "
                             f"the ending must be one of {' '.join(FORMATS)}")
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


def _write_npz(path: Path, voxels: _Voxels) -> None:
    colors = None if voxels.rgb is None else SurfaceColors(voxels.rgb, np.zeros(len(voxels.rgb), np.uint16))
    write_volume(path, voxels.volume, volume_arrays(voxels.surface, colors))


def _write_vdb(path: Path, voxels: _Voxels) -> None:
    _write_whole(path, lambda temporary: write_vdb(temporary, voxels.volume, voxels.surface, voxels.rgb))


@dataclass(frozen=True)
class Format:
    """One ending. Exactly one of the two functions is there.

    Parameters
    ----------
    description : str
        What the file holds, without a full stop.
    of_scene : callable, optional
        ``of_scene(scene, filepath)`` writes the meshes of a scene.
    of_voxels : callable, optional
        ``of_voxels(path, voxels)`` writes voxels, whole or not at all.
    """

    description: str
    of_scene: Callable[[bpy.types.Scene, str], None] | None = None
    of_voxels: Callable[[Path, _Voxels], None] | None = None


FORMATS = {
    ".blend": Format("Blender's own, with the mesh as an object", _write_blend),
    ".ply": Format("A mesh with colours, or points", _write_ply),
    ".obj": Format("A mesh with colours, y up", _write_obj),
    ".stl": Format("A mesh without colours", _write_stl),
    ".glb": Format("A mesh with colours, y up, for the web and game engines", _write_glb),
    ".vox": Format("The voxels of the surface for MagicaVoxel, of any size, in 255 colours", of_voxels=lambda path, voxels: write_vox(
        path, voxels.surface.voxels, voxels.shades)),
    ".npz": Format("The volume as numpy arrays, as in a result's folder", of_voxels=_write_npz),
    ".txt": Format("The voxels of the surface for Goxel, a line each", of_voxels=lambda path, voxels: write_goxel(
        path, voxels.surface.voxels, voxels.shades)),
    ".vdb": Format("The volume for OpenVDB, as density and color", of_voxels=_write_vdb),
}
_COLORS_ON_VERTICES = (".ply", ".obj")  # colours of shared vertices would be blurred between voxels
