# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What shadows carved, as an object: the voxels that shadow carving removed, coloured by the light whose shadow did it."""

from __future__ import annotations

import bpy
import numpy as np

from ..reconstruction.color import srgb_to_linear
from ..reconstruction.volumetric.surface import extract_surface
from ..reconstruction.volumetric.volume import BRICK, EMPTY, SparseVolume, brick_counts
from .folder import Result
from .layers import rows_of
from .objects import add_voxel_mesh

LAYER = "carved"
CARVED_NAME = "Carved by Shadows"
# Okabe and Ito (2008), safe for colour-blind readers; grey in the place of their black, which shading would not show. sRGB.
LIGHT_COLORS = ("e69f00", "56b4e9", "009e73", "f0e442", "0072b2", "d55e00", "cc79a7", "999999")
_VALUES = ("view", "light", "round")


def add_carved(result: Result, *, collection: bpy.types.Collection, frame: np.ndarray) -> bpy.types.Object | None:
    """Add the surface of the voxels that shadows carved, where a result tells of any.

    The face attributes ``view`` and ``light`` are numbers in the report's ``carved_by``, ``round`` is when. Lights have the
    colours of `LIGHT_COLORS` in turn; the object's custom property ``lights`` lists their names in that order.

    Parameters
    ----------
    result : Result
    collection : bpy.types.Collection
        Where the object is linked.
    frame : (4, 4) array
        Object frame to world.

    Returns
    -------
    bpy.types.Object or None
        None where nothing was carved.
    """
    layer = result.layers.get(LAYER)
    if layer is None or not len(layer.voxels) or not layer.values.keys() >= set(_VALUES):
        return None
    grid = result.volume.grid
    nothing = SparseVolume(grid, np.full(brick_counts(grid), EMPTY, np.int32), np.zeros((0, BRICK, BRICK, BRICK), bool))
    surface = extract_surface(nothing.updated(layer.voxels, np.ones(len(layer.voxels), bool)))
    rows = rows_of(layer, surface.voxels, grid)
    values = {name: layer.values[name][rows].astype(np.int32) for name in _VALUES}
    added = add_voxel_mesh(CARVED_NAME, surface, _palette()[values["light"] % len(LIGHT_COLORS)], collection=collection, grid=grid,
                           frame=frame, method=str(result.report.get("method", "")), attributes=values, replace=False)
    added["lights"] = ", ".join(_light_names(result.report))
    return added


def _light_names(report: dict) -> list[str]:
    """Return the names of the lights by their numbers; none where a report, which anybody may have written, has no such list."""
    carved_by = report.get("carved_by")
    names = carved_by.get("lights") if isinstance(carved_by, dict) else None
    return [str(name) for name in names] if isinstance(names, list) else []


def _palette() -> np.ndarray:
    """Return `LIGHT_COLORS` as (8, 3) linear values."""
    return srgb_to_linear(np.frombuffer(bytes.fromhex("".join(LIGHT_COLORS)), np.uint8).reshape(-1, 3) / 255)
