# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that come as one file, of any origin, as if they were results: numpy archives and MagicaVoxel's files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..reconstruction.geometry import VoxelGrid
from ..reconstruction.volumetric.cavities import without_cavities
from ..reconstruction.volumetric.coloring import SurfaceColors
from ..reconstruction.volumetric.surface import extract_surface
from ..reconstruction.volumetric.volume import SparseVolume
from .folder import Result, colors_from, read_result
from .npz import check_size, open_volume
from .vox_reader import read_vox


def read_volume(source: Path, *, voxel_size: float = 1.0) -> Result:
    """Read a result folder, or a volume in a file whose ending is one of `READERS`.

    Parameters
    ----------
    source : Path
    voxel_size : float
        Of a file that knows no length.

    Raises
    ------
    ScanstageError
        It is neither, or cannot be used.
    """
    source = Path(source)
    if not source.is_file():
        return read_result(source)
    ending = source.suffix.lower()
    if ending not in READERS:
        raise ScanstageError(f"{source}: is neither a result's folder nor a volume; give a folder, or a file that ends in "
                             f"{' or '.join(READERS)}")
    return READERS[ending](source, voxel_size)


def _read_npz(path: Path, voxel_size: float) -> Result:
    """Read ``occupancy`` bool [x, y, z], with ``origin`` and ``voxel_size`` where they are given, and a result's own colours."""
    with open_volume(path) as file:
        size = float(file.array("voxel_size", "<f8", ())) if "voxel_size" in file else voxel_size
        origin = file.array("origin", "<f8", (3,)) if "origin" in file else np.zeros(3)
        try:
            grid = VoxelGrid(origin, size, file.shape("occupancy", "|b1", 3))
        except ValueError as error:
            raise ScanstageError(f"{path}: {error}; correct it") from None
        volume = file.volume(grid)
        surface = extract_surface(volume)
        return Result(path.parent, {}, volume, surface, colors_from(file, surface, grid, path))


def _read_vox(path: Path, voxel_size: float) -> Result:
    """Read a scene; what is closed on all sides is solid, for such files seldom hold what nobody can see."""
    voxels, rgb = read_vox(path)
    lowest = voxels.min(axis=0)
    grid = VoxelGrid(lowest * voxel_size, voxel_size, voxels.max(axis=0) - lowest + 1)
    check_size(grid, path)
    volume = without_cavities(SparseVolume.from_voxels(grid, voxels - lowest))
    surface = extract_surface(volume)
    given, wanted = (np.ravel_multi_index(table.T, grid.shape) for table in (voxels - lowest, surface.voxels.astype(np.int64)))
    order = np.argsort(given)
    rows = order[np.searchsorted(given, wanted, sorter=order)]  # every voxel with a face to the outside is in the file
    return Result(path.parent, {}, volume, surface, SurfaceColors(rgb[rows], np.zeros(len(rows), np.uint16)))


READERS = {".npz": _read_npz, ".vox": _read_vox}
