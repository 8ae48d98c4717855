# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The layers of a result in its files: `VoxelLayer` as arrays of ``volume.npz``, listed in ``result.json``.

The layer ``carved`` with the values ``view`` and ``light`` is the arrays ``carved_voxels`` (n, 3) int32, ``carved_view``
(n,) and ``carved_light`` (n,); ``result.json`` says so: ``"layers": {"carved": {"view": "<u2", "light": "<u2"}}``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..reconstruction.geometry import VoxelGrid
from ..reconstruction.outcome import VoxelLayer
from .npz import AGAIN, VolumeFile

_NAME = re.compile(r"[a-z][a-z0-9_]{0,40}")
_DTYPES = {"|b1", "|u1", "<u2", "<u4", "<i4", "<f4"}
_MOST = 16  # layers, or values of one


def layer_arrays(layers: Mapping[str, VoxelLayer]) -> dict[str, np.ndarray]:
    """Return the layers as arrays by name."""
    arrays = {}
    for name, layer in layers.items():
        arrays[f"{name}_voxels"] = layer.voxels.astype("<i4")
        arrays |= {f"{name}_{value}": _stored(numbers) for value, numbers in layer.values.items()}
    return arrays


def layer_fields(layers: Mapping[str, VoxelLayer]) -> dict[str, dict[str, str]]:
    """Return what ``result.json`` says of the layers: per layer the type of each value."""
    for name in (*layers, *(value for layer in layers.values() for value in layer.values)):
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name!r} cannot be a layer's name: use lower-case letters, digits and _")
    return {name: {value: _stored(numbers).dtype.str for value, numbers in layer.values.items()} for name, layer in layers.items()}


def read_layers(file: VolumeFile, fields: object, grid: VoxelGrid, path: Path) -> dict[str, VoxelLayer]:
    """Read the layers that a report lists.

    Raises
    ------
    ScanstageError
        The list is none, or an array is missing, of another type or size, or beyond the grid.
    """
    layers = {}
    for name, values in _mapping(fields, path, "layers").items():
        voxels = file.array(f"{name}_voxels", "<i4", (None, 3), most=grid.count)
        if not ((voxels >= 0) & (voxels < grid.shape)).all():
            raise ScanstageError(f"{path}: layers.{name} has voxels beyond the grid; {AGAIN}")
        numbers = {}
        for value, dtype in _mapping(values, path, f"layers.{name}").items():
            if not isinstance(dtype, str) or dtype not in _DTYPES:
                raise ScanstageError(f"{path}: layers.{name}.{value}: {str(dtype)[:20]!r} is none of {', '.join(sorted(_DTYPES))}; {AGAIN}")
            numbers[value] = file.array(f"{name}_{value}", dtype, (len(voxels),))
        layers[name] = VoxelLayer(voxels, numbers)
    return layers


def rows_of(layer: VoxelLayer, voxels: np.ndarray, grid: VoxelGrid) -> np.ndarray:
    """Return (n,) int: the row of the layer that holds each of the voxels (n, 3), -1 where none does."""
    if not len(layer.voxels):
        return np.full(len(voxels), -1)
    listed, wanted = (np.ravel_multi_index(table.T.astype(np.int64), grid.shape) for table in (layer.voxels, voxels))
    order = np.argsort(listed)
    rows = order[np.minimum(np.searchsorted(listed, wanted, sorter=order), len(order) - 1)]
    return np.where(listed[rows] == wanted, rows, -1)


def _mapping(value: object, path: Path, place: str) -> dict:
    if not isinstance(value, dict) or len(value) > _MOST or not all(_NAME.fullmatch(name) for name in value):
        raise ScanstageError(f"{path}: {place} must be an object of at most {_MOST} names; {AGAIN}")
    return value


def _stored(numbers: np.ndarray) -> np.ndarray:
    """Return numbers in the smallest of the stored types that holds them."""
    if numbers.dtype == bool:
        return numbers.astype("|b1")
    if numbers.dtype.kind == "f":
        return numbers.astype("<f4")
    low, high = (int(numbers.min()), int(numbers.max())) if len(numbers) else (0, 0)
    return numbers.astype(next(kind for kind in ("|u1", "<u2", "<u4", "<i4")
                               if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max))
