# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""``points.ply``: the points of a result, as any viewer reads them, and back.

A file that is read is untrusted: only the layout that is written here is read, so that its size says how many points it may
hold before anything is allocated.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..reconstruction.color import linear_to_srgb, srgb_to_linear
from ..reconstruction.geometry import VoxelGrid
from ..reconstruction.points import PointCloud
from ..reconstruction.volumetric.surface import Surface
from .npz import AGAIN
from .ply import write_ply

MAX_POINTS = 1 << 28
_COLUMNS = (*((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")), *((name, "|u1") for name in ("red", "green", "blue")),
            ("sigma", "<f4"), ("view", "<u2"))
_KINDS = {"<f4": "float", "|u1": "uchar", "<u2": "ushort"}
_HEADER_BYTES = 1024


def write_points(path: Path, cloud: PointCloud) -> None:
    """Write a point cloud, with sRGB colours, whole or not at all.

    Raises
    ------
    ScanstageError
        The disk refuses.
    """
    colors = np.rint(linear_to_srgb(np.clip(cloud.colors, 0, 1)) * 255).astype(np.uint8)
    write_ply(path, cloud.positions, vertex_colors=colors, normals=cloud.normals, attributes={"sigma": cloud.sigma, "view": cloud.view})


def surface_points(surface: Surface, grid: VoxelGrid, rgb: np.ndarray | None) -> PointCloud:
    """Return the centres of a surface's voxels as points: with its normals, and known to a voxel's half diagonal.

    Parameters
    ----------
    surface : Surface
    grid : VoxelGrid
    rgb : (s, 3) array or None
        Linear colours; grey where there are none.
    """
    count = len(surface.voxels)
    colors = np.full((count, 3), 0.5) if rgb is None else rgb
    return PointCloud(grid.centres(surface.voxels), surface.normals(), colors, np.full(count, grid.voxel_size * 3 ** 0.5 / 2),
                      np.zeros(count))


def read_points(path: Path) -> PointCloud:
    """Read a point cloud that `write_points` wrote.

    Raises
    ------
    ScanstageError
        The file cannot be read, is damaged, or has another layout.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(_HEADER_BYTES)
            count, start = _checked_header(head, path)
            file.seek(0, 2)
            if file.tell() != start + count * np.dtype(list(_COLUMNS)).itemsize:
                raise ScanstageError(f"{path}: is not as long as its {count} points; {AGAIN}")
            file.seek(start)
            records = np.frombuffer(file.read(), np.dtype(list(_COLUMNS)))
    except OSError as error:
        raise ScanstageError(f"{path}: cannot be read ({error.strerror}); {AGAIN}") from None

    def columns(*names: str) -> np.ndarray:
        return np.stack([records[name] for name in names], axis=-1)

    try:
        return PointCloud(columns("x", "y", "z"), columns("nx", "ny", "nz"), srgb_to_linear(columns("red", "green", "blue") / 255),
                          records["sigma"], records["view"])
    except ValueError:
        raise ScanstageError(f"{path}: holds a number that is not finite; {AGAIN}") from None


def _checked_header(head: bytes, path: Path) -> tuple[int, int]:
    """Return the number of points and where they begin."""
    found = re.search(rb"^element vertex (\d{1,9})$", head, re.MULTILINE)
    count = int(found[1]) if found else 0
    properties = "".join(f"property {_KINDS[kind]} {name}\n" for name, kind in _COLUMNS)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{properties}end_header\n".encode()
    if not head.startswith(header) or count > MAX_POINTS:
        raise ScanstageError(f"{path}: is not a point cloud of Scanstage's; {AGAIN}")
    return count, len(header)
