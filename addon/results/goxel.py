# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Goxel's text format: one line ``x y z rrggbb`` for each voxel, z up as here, in whole numbers and sRGB."""

from __future__ import annotations

import numpy as np

from ..files import replacing
from ..reconstruction.color import linear_to_srgb

_HEAD = b"# Goxel 0.10.0\n# One line per voxel\n# X Y Z RRGGBB\n"


def write_goxel(path, voxels: np.ndarray, rgb: np.ndarray) -> None:
    """Write coloured voxels, whole or not at all.

    Parameters
    ----------
    path : path-like
        Replaced if it exists.
    voxels : (n, 3) int array
        Indices x, y, z, each voxel once.
    rgb : (n, 3) array
        Linear colours.

    Raises
    ------
    ScanstageError
        The file cannot be written.
    """
    colors = np.rint(linear_to_srgb(np.clip(rgb, 0.0, 1.0)) * 255).astype(np.int64)
    with replacing(path) as file:
        file.write(_HEAD)
        np.savetxt(file, np.column_stack((voxels, colors @ (1 << 16, 1 << 8, 1))), fmt="%d %d %d %06x")
