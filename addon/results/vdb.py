# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenVDB, for renderers and simulations: the grid ``density``, 1 in occupied voxels, and ``color`` at the surface.

A value of the format belongs to a point of the lattice: voxel (i, j, k) is the point (i, j, k), and the transform puts it where the
voxel's centre is. The module is Blender's own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..compat import openvdb
from ..errors import ScanstageError
from ..reconstruction.volumetric.surface import Surface
from ..reconstruction.volumetric.volume import BRICK, SparseVolume


def write_vdb(path: Path, volume: SparseVolume, surface: Surface, rgb: np.ndarray | None) -> None:
    """Write a volume.

    Parameters
    ----------
    path : Path
        Written as it is named: the caller renames.
    volume : SparseVolume
    surface : Surface
        Of the volume.
    rgb : (s, 3) array or None
        Linear colours of the surface's voxels.

    Raises
    ------
    ScanstageError
        This Blender has no module for OpenVDB.
    """
    vdb = openvdb()
    if vdb is None:
        raise ScanstageError(f"{path.name}: this Blender has no Python module openvdb, which writes .vdb files; use Blender's own builds, "
                             "or another ending")
    density = vdb.FloatGrid()
    density.name, density.gridClass = "density", vdb.GridClass.FOG_VOLUME
    color = vdb.Vec3SGrid()
    color.name = "color"
    order = np.argsort(surface.voxels[:, 0], kind="stable")
    for row, slab in enumerate(volume.slabs()):
        first = row * BRICK
        if not slab.any():
            continue
        density.copyFromArray(np.ascontiguousarray(slab, np.float32), ijk=(first, 0, 0))
        if rgb is not None:
            start, stop = np.searchsorted(surface.voxels[order, 0], (first, first + len(slab)))
            rows = order[start:stop]
            shades = np.zeros((*slab.shape, 3), np.float32)
            shades[tuple((surface.voxels[rows] - (first, 0, 0)).T)] = rgb[rows]
            color.copyFromArray(shades, ijk=(first, 0, 0))
    grid = volume.grid
    matrix = np.diag((grid.voxel_size,) * 3 + (1.0,))
    matrix[3, :3] = grid.centres((0, 0, 0))  # points are rows there
    grids = [density] if rgb is None else [density, color]
    for part in grids:
        part.transform = vdb.createLinearTransform(matrix.tolist())
    vdb.write(str(path), grids=grids)
