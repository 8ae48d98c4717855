# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The RESULT folder of a reconstruction.

| file | what |
|---|---|
| ``result.json`` | ``format``, ``version``, ``grid``, and the report: method, options, capture, seconds, counts, ... |
| ``volume.npz`` | ``occupancy`` bool ``[x, y, z]``, ``origin``, ``voxel_size``, ``surface_voxels`` (s, 3) int32, |
| | ``surface_colors`` (s, 3) float32 linear, ``surface_views`` (s,) uint16 |
| | and the layers (see `layers`) |
| ``points.ply`` | where the method measures points: positions, normals, sRGB colours, ``sigma``, ``view`` |
| ``mesh.ply`` | the voxels' faces as quads, with sRGB colours at the vertices; where ``result.json`` says ``"mesh": "triangles"``, |
| | the surface that the method found itself, in triangles |
| ``preview.png`` | a picture of it |
| ``pictures/*.png`` | what the method has to show besides, where it has |

A folder appears whole or not at all. It is untrusted when read.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from ..captures.files import inside
from ..errors import ScanstageError
from ..files import making, replacing
from ..reconstruction.color import linear_to_srgb
from ..reconstruction.geometry import VoxelGrid
from ..reconstruction.mesh import TriangleMesh
from ..reconstruction.outcome import VoxelLayer
from ..reconstruction.points import PointCloud
from ..reconstruction.volumetric.coloring import SurfaceColors
from ..reconstruction.volumetric.surface import Surface, extract_surface
from ..reconstruction.volumetric.volume import SparseVolume
from .layers import layer_arrays, layer_fields, read_layers
from .npz import AGAIN, VolumeFile, check_size, open_volume, write_volume
from .ply import read_ply, write_ply
from .point_file import read_points, write_points

FORMAT, VERSION = "scanstage-result", 1
REPORT, VOLUME, MESH, PREVIEW, PICTURES, POINTS = "result.json", "volume.npz", "mesh.ply", "preview.png", "pictures", "points.ply"
_TRIANGLES = "triangles"
MAX_REPORT = 1 << 24
_OURS = ("format", "version", "grid", "layers", "mesh")


@dataclass(frozen=True)
class Result:
    """A reconstruction as read from its folder.

    Parameters
    ----------
    folder : Path
    report : dict
        All of ``result.json``.
    volume : SparseVolume
    surface : Surface
        The volume's exposed faces.
    colors : SurfaceColors, optional
        One row for each of ``surface.voxels``; None for a method that finds no colours.
    layers : mapping of str to VoxelLayer
        What the method says of chosen voxels.
    mesh : TriangleMesh, optional
        The surface, where the method finds it finer than voxels can show.
    points : PointCloud, optional
        Of a method that measures points.
    """

    folder: Path
    report: dict
    volume: SparseVolume
    surface: Surface
    colors: SurfaceColors | None
    layers: Mapping[str, VoxelLayer] = field(default_factory=dict)
    mesh: TriangleMesh | None = None
    points: PointCloud | None = None


def check_replaceable(folder) -> None:
    """Refuse a place where `write_result` would not write, before hours of work are spent.

    Raises
    ------
    ScanstageError
        Something is there already that is neither a result folder nor an empty one, or nothing can be made there.
    """
    folder = Path(folder)
    home = next((parent for parent in folder.absolute().parents if parent.exists()), folder)
    if not home.is_dir() or not os.access(home, os.W_OK):
        raise ScanstageError(f"{folder}: cannot be made, for {home} is not a folder that can be written to; name another folder")
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise ScanstageError(f"{folder}: is a file; name a folder for the result")
    if any(folder.iterdir()):
        try:
            read_report(folder)
        except ScanstageError:
            raise ScanstageError(f"{folder}: is not empty and not a result, so it is not replaced; name another folder "
                                 "or remove it") from None


def write_result(folder, *, volume: SparseVolume, surface: Surface, colors: SurfaceColors | None, report: dict,
                 preview: np.ndarray, layers: Mapping[str, VoxelLayer] | None = None,
                 pictures: Mapping[str, np.ndarray] | None = None, mesh: TriangleMesh | None = None,
                 points: PointCloud | None = None) -> None:
    """Write a result folder, in place of an older result or an empty folder.

    Parameters
    ----------
    folder : path-like
    volume : SparseVolume
    surface : Surface
        Of the volume.
    colors : SurfaceColors, optional
    report : dict
        JSON values (numpy's too): method, options, capture, seconds per step, peak memory, counts, warnings.
    preview : (h, w, 3) or (h, w, 4) uint8 array
        sRGB, with alpha or without.
    layers : mapping of str to VoxelLayer, optional
    pictures : mapping of str to (h, w, 3) uint8 array, optional
        By the names of their files, without ending.
    mesh : TriangleMesh, optional
        Written in place of the voxels' faces.
    points : PointCloud, optional

    Raises
    ------
    ScanstageError
        The place is taken by something else, or the disk refuses.
    ValueError
        An argument does not fit the others; nothing is written.
    """
    check_replaceable(folder)
    folder, layers = Path(folder), layers or {}
    text = _encode({**report, "format": FORMAT, "version": VERSION, "grid": _grid_fields(volume.grid), "layers": layer_fields(layers),
                    **({} if mesh is None else {"mesh": _TRIANGLES})})
    files = {PREVIEW: _png(preview)} | {f"{PICTURES}/{name}.png": _png(picture) for name, picture in (pictures or {}).items()}
    arrays = {**volume_arrays(surface, colors), **layer_arrays(layers)}
    vertex_colors = None if colors is None else _vertex_colors(surface, colors.rgb)
    with making(folder) as made:
        write_volume(made / VOLUME, volume, arrays)
        if mesh is None:
            write_ply(made / MESH, surface.vertices, surface.quads, vertex_colors=vertex_colors)
        else:
            write_ply(made / MESH, mesh.vertices, mesh.triangles, double=True)
        if points is not None:
            write_points(made / POINTS, points)
        if pictures:
            (made / PICTURES).mkdir()
        for name, data in files.items():
            _write(made / name, data)
        _write(made / REPORT, text)


def volume_arrays(surface: Surface, colors: SurfaceColors | None) -> dict[str, np.ndarray]:
    """Return what ``volume.npz`` holds of a surface and its colours, by name.

    Raises
    ------
    ValueError
        The colours do not fit the surface.
    """
    arrays = {"surface_voxels": surface.voxels.astype(np.int32)}
    if colors is not None:
        if colors.rgb.shape != (len(surface.voxels), 3) or colors.views.shape != (len(surface.voxels),):
            raise ValueError(f"colors must have one row for each of the {len(surface.voxels)} surface voxels")
        arrays |= {"surface_colors": colors.rgb.astype(np.float32), "surface_views": colors.views.astype(np.uint16)}
    return arrays


def read_result(folder) -> Result:
    """Read a result folder.

    Raises
    ------
    ScanstageError
        A file is missing, damaged, of an unknown version, or disagrees with another.
    """
    folder = Path(folder)
    for name in (REPORT, VOLUME, MESH, POINTS):
        inside(folder, name, str(folder / name), whole="result")
    report = read_report(folder)
    grid = _grid(report, folder / REPORT)
    check_size(grid, folder / REPORT)
    with open_volume(folder / VOLUME) as file:
        origin, voxel_size = file.array("origin", "<f8", (3,)), file.array("voxel_size", "<f8", ())
        if (origin != grid.origin).any() or voxel_size != grid.voxel_size:
            raise ScanstageError(f"{folder / VOLUME}: origin and voxel_size are not those of {REPORT}; {AGAIN}")
        volume = file.volume(grid)
        surface = extract_surface(volume)
        colors = colors_from(file, surface, grid, folder / VOLUME, required=True)
        layers = read_layers(file, report.get("layers", {}), grid, folder / REPORT)
    mesh = read_ply(folder / MESH) if report.get("mesh") == _TRIANGLES else None
    points = read_points(folder / POINTS) if (folder / POINTS).exists() else None
    return Result(folder, report, volume, surface, colors, layers, mesh, points)


def report_section(folder, name: str, section: dict) -> None:
    """Add a section such as ``evaluation`` to a result's ``result.json``, or replace it.

    Raises
    ------
    ScanstageError
        The folder is no result, or the disk refuses.
    ValueError
        The name is one of the format's own, or the section is not JSON.
    """
    if name in _OURS:
        raise ValueError(f"{name} belongs to the format")
    folder = Path(folder)
    _write(folder / REPORT, _encode({**read_report(folder), name: section}))


def colors_from(file: VolumeFile, surface: Surface, grid: VoxelGrid, path: Path, *, required: bool = False) -> SurfaceColors | None:
    """Return the colours in an open volume file, if it has any.

    Parameters
    ----------
    file : VolumeFile
    surface : Surface
        Of the file's volume.
    grid : VoxelGrid
    path : Path
        The file, for error messages.
    required : bool
        Whether the voxels that may have colours must be listed.

    Raises
    ------
    ScanstageError
        An array is missing, or disagrees with the volume.
    """
    if not required and "surface_voxels" not in file:
        return None
    rows = _rows(file.array("surface_voxels", "<i4", (None, 3), most=grid.count), surface, grid, path)
    if "surface_colors" not in file:
        return None
    rgb = file.array("surface_colors", "<f4", (len(rows), 3))[rows]
    if not np.isfinite(rgb).all():
        raise ScanstageError(f"{path}: surface_colors holds a colour that is not finite; {AGAIN}")
    return SurfaceColors(rgb, file.array("surface_views", "<u2", (len(rows),))[rows])


def _rows(voxels: np.ndarray, surface: Surface, grid: VoxelGrid, path: Path) -> np.ndarray:
    """Return for each surface voxel its row in the file, whose order need not be ours."""
    if len(voxels) == len(surface.voxels) and ((voxels >= 0) & (voxels < grid.shape)).all():
        theirs, ours = (np.ravel_multi_index(tuple(table.T), grid.shape) for table in (voxels, surface.voxels))
        by_voxel, rows = np.argsort(theirs), np.zeros(len(ours), np.int64)
        rows[np.argsort(ours)] = by_voxel
        if (theirs[rows] == ours).all():
            return rows
    raise ScanstageError(f"{path}: surface_voxels are not the surface of occupancy; {AGAIN}")


def _vertex_colors(surface: Surface, rgb: np.ndarray) -> np.ndarray:
    """Return (v, 3) uint8 sRGB colours: the mean, in linear light, of the faces around each vertex.

    At the vertices because that is where Blender and most viewers look for colours; those of faces are ignored.
    """
    corner = surface.quads.ravel()
    faces = np.bincount(corner, minlength=len(surface.vertices))
    mean = np.zeros((len(surface.vertices), 3))
    for channel in range(3):
        weights = np.repeat(rgb[surface.face_voxel, channel], 4)
        mean[:, channel] = np.bincount(corner, weights, minlength=len(faces)) / np.maximum(faces, 1)
    return np.rint(linear_to_srgb(np.clip(mean, 0, 1)) * 255).astype(np.uint8)


def _png(preview: np.ndarray) -> bytes:
    if preview.ndim != 3 or preview.shape[2] not in (3, 4) or preview.dtype != np.uint8 or not preview.size:
        raise ValueError(f"preview must be (h, w, 3 or 4) uint8, not {preview.shape} {preview.dtype}")
    code = cv2.COLOR_RGB2BGR if preview.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    return cv2.imencode(".png", cv2.cvtColor(np.ascontiguousarray(preview), code))[1].tobytes()


def _write(path: Path, data: bytes) -> None:
    with replacing(path) as file:
        file.write(data)


def _encode(report: dict) -> bytes:
    def plain(value):
        if isinstance(value, np.generic | np.ndarray):
            return value.tolist()
        raise ValueError(f"a report holds JSON values only, not {type(value).__name__}")

    return (json.dumps(report, indent=1, allow_nan=False, default=plain) + "\n").encode()


def _grid_fields(grid: VoxelGrid) -> dict:
    return {"origin": grid.origin.tolist(), "voxel_size": grid.voxel_size, "shape": list(grid.shape)}


def read_report(folder: Path) -> dict:
    """Return all of a result's ``result.json``.

    Raises
    ------
    ScanstageError
        There is none, or it is not one that this version reads.
    """
    path = folder / REPORT
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_REPORT + 1)
    except OSError as error:
        raise ScanstageError(f"{path}: cannot be read ({error.strerror}); name the folder of a result") from None
    if len(data) > MAX_REPORT:
        raise ScanstageError(f"{path}: is larger than {MAX_REPORT >> 20} MiB; {AGAIN}")
    try:
        report = json.loads(data)
    except (ValueError, RecursionError) as error:  # not UTF-8, not JSON, a number of thousands of digits, a JSON bomb
        raise ScanstageError(f"{path}: is not JSON ({' '.join(str(error).split())[:100]}); {AGAIN}") from None
    if not isinstance(report, dict) or report.get("format") != FORMAT:
        raise ScanstageError(f"{path}: format is not {FORMAT!r}; name the folder of a result")
    if report.get("version") != VERSION:
        raise ScanstageError(f"{path}: version is {str(report.get('version'))[:40]}, and this Scanstage reads "
                             f"{VERSION}; use the one that wrote it")
    return report


def _grid(report: dict, path: Path) -> VoxelGrid:
    fields = report.get("grid")
    try:
        shape = fields["shape"]
        if not all(type(n) is int for n in shape):
            raise ValueError("shape must be three whole numbers")
        return VoxelGrid(fields["origin"], fields["voxel_size"], shape)
    except KeyError as error:
        raise ScanstageError(f"{path}: grid.{error.args[0]} is missing; {AGAIN}") from None
    except (TypeError, ValueError, OverflowError) as error:
        raise ScanstageError(f"{path}: grid: {' '.join(str(error).split())[:100]}; {AGAIN}") from None
