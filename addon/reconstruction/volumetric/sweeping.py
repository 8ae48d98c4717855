# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxels judged layer by layer from the cameras away, with one occlusion bit a pixel (Seitz & Dyer, 1999).

A plane sweeps through the volume. Of each layer the exposed voxels are judged by the pixels that nothing before has
taken; those that stay take theirs only once the whole layer is done, since voxels of a layer do not hide each other. Only
cameras that the plane has passed are asked: for them the layers come in the order of their depth (Kutulakos & Seitz, 2000).

A voxel takes the pixels whose centres' rays meet its cube. Voxels that are not exposed cannot be seen and are never looked
at, so that the work follows the surface and what is carved.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...progress import Progress, silent
from ..geometry import VoxelGrid
from .carving import Carving
from .consistency import Judge
from .footprints import Pictures, Samples

LEAST_FACING = 0.1  # cosine; surfaces seen more obliquely are not judged
SAMPLES_AT_ONCE = 1 << 16  # views times voxels: their arrays stay in the cache
PIXELS_AT_ONCE = 1 << 17


@dataclass(frozen=True)
class Order:
    """In which order a plane passes the voxels.

    Parameters
    ----------
    name : str
        For reports.
    direction : (3,) array
        Unit vector, the way the plane moves: a voxel's layer is the whole part of its centre's place along it.
    least_across : float
        Cosine between a line of sight and the direction below which a camera is not asked about a voxel: what runs along
        the layer may be hidden by others of the same layer, which have not taken their pixels yet.
    """

    name: str
    direction: np.ndarray
    least_across: float = 0.0

    def layer(self, voxels: np.ndarray) -> np.ndarray:
        """Return the layers (n,) int of voxels (n, 3)."""
        # Of a plane across an axis, centres lie half way between whole numbers, where rounding is safe.
        return np.floor(voxels @ self.direction + 0.5 * self.direction.sum()).astype(np.int64)

    def passed(self, centres: np.ndarray, layer: int) -> np.ndarray:
        """Return which cameras (v, 3), in voxel coordinates, the plane has passed before it reaches a layer."""
        return centres @ self.direction <= layer


AXES = tuple(Order(f"{sign}{axis}", np.eye(3)[number] * (1 if sign == "+" else -1))
             for number, axis in enumerate("xyz") for sign in "+-")


@dataclass(frozen=True)
class Swept:
    """What a sweep found.

    Parameters
    ----------
    keys : (n,) int64 array
        The voxels that stay, of those that were looked at: keys of the carving.
    rgb : (n, 3) float32 array
        Their mean colours, 0 where fewer than the least number of views see them.
    views : (n,) uint16 array
        How many views see them; 0 where too few.
    tested, removed : int
        How many voxels were looked at and taken out.
    """

    keys: np.ndarray
    rgb: np.ndarray
    views: np.ndarray
    tested: int
    removed: int


def sweep(carving: Carving, pictures: Pictures, judge: Judge, order: Order, progress: Progress = silent) -> Swept:
    """Sweep a plane through a volume once and take out what the cameras that it has passed disagree on.

    Parameters
    ----------
    carving : Carving
        It is changed.
    pictures : Pictures
    judge : Judge
    order : Order
    progress : Progress

    Returns
    -------
    Swept
    """
    carving.forget()
    waiting: dict[int, list[np.ndarray]] = {}
    _wait(waiting, carving, order, carving.enqueue(carving.surface_keys()))
    rgba = pictures.rgba.copy()
    kept, tested, removed = [], 0, 0
    first, last = (order.layer(corner).item() for corner in _ends(carving.grid, order))
    while waiting:
        layer = min(waiting)
        progress((layer - first) / (last - first + 1), f"Sweeping towards {order.name}: {removed:,} voxels taken out")
        passed = pictures.subset(order.passed(pictures.centres, layer))
        stayed = []
        while layer in waiting:
            front = np.concatenate(waiting.pop(layer))
            outside = passed.background(carving.voxels(front) + 0.5) if pictures.outside.any() else np.zeros(len(front), bool)
            inside = front[~outside]
            refused, rgb, views = judged(inside, carving, passed, judge, order, rgba)
            stayed.append((inside[~refused], rgb[~refused], views[~refused]))
            gone = np.concatenate((front[outside], inside[refused]))
            tested, removed = tested + len(front), removed + len(gone)
            carving.remove(gone)
            _wait(waiting, carving, order, carving.exposed_by(gone), layer)
        kept += stayed
        for rows in covered(passed, carving.voxels(np.concatenate([keys for keys, _, _ in stayed]))):
            rgba.view(np.complex128)[rows, 0] = 0
    keys, rgb, views = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    return Swept(keys, rgb, views, tested, removed)


def _wait(waiting: dict[int, list[np.ndarray]], carving: Carving, order: Order, keys: np.ndarray, least: int | None = None) -> None:
    """Put voxels into the lists of their layers, but for layers that the plane has passed."""
    layers = order.layer(carving.voxels(keys))
    first = int(layers.min(initial=0)) if least is None else least
    for layer in range(first, int(layers.max(initial=first - 1)) + 1):
        own = keys[layers == layer]
        if len(own):
            waiting.setdefault(layer, []).append(own)


def _ends(grid: VoxelGrid, order: Order) -> tuple[np.ndarray, np.ndarray]:
    """Return the grid's corner voxels that the plane meets first and last."""
    end = np.array(grid.shape) - 1
    forward = order.direction > 0
    return np.where(forward, 0, end), np.where(forward, end, 0)


def judged(keys: np.ndarray, carving: Carving, pictures: Pictures, judge: Judge, order: Order,
           rgba: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of each voxel (n,) whether it is refused, its mean colour (n, 3) and how many views see it (n,)."""
    refused, colors, count = np.zeros(len(keys), bool), np.zeros((len(keys), 3), np.float32), np.zeros(len(keys), np.uint16)
    if not pictures.cameras:
        return refused, colors, count
    step = max(1, SAMPLES_AT_ONCE // len(pictures.cameras))
    for part in (slice(start, start + step) for start in range(0, len(keys), step)):
        samples = sampled(keys[part], carving, pictures, judge, order, rgba)
        enough = samples.views >= judge.min_views
        refused[part] = judge.refuses(samples)
        colors[part][enough], count[part][enough] = samples.colors[enough], samples.views[enough]
    return refused, colors, count


def sampled(keys: np.ndarray, carving: Carving, pictures: Pictures, judge: Judge, order: Order, rgba: np.ndarray) -> Samples:
    """Return what the views see of voxels at the middle of their exposed faces, if these are turned to them."""
    exposure = carving.exposure(keys)
    points = carving.voxels(keys) + np.float32(0.5) * (1 + exposure)
    towards = pictures.centres @ exposure.T - np.einsum("nc,nc->n", points, exposure)
    length = np.sqrt(np.einsum("nc,nc->n", exposure, exposure))
    distance = np.linalg.norm(pictures.centres - np.array(carving.grid.shape) / 2, axis=1)
    facing = towards >= LEAST_FACING * distance.astype(np.float32)[:, None] * length  # a thin sheet faces both ways
    if order.least_across:
        facing &= points @ order.direction - (pictures.centres @ order.direction)[:, None] >= order.least_across * distance[:, None]
    rows = np.where(facing, pictures.locate(points), pictures.offset[0])  # the first pixel of a border is empty
    return judge.sample(pictures, rows, rgba, points, exposure)


def covered(pictures: Pictures, voxels: np.ndarray) -> Iterator[np.ndarray]:
    """Yield rows of pixels whose centres' rays meet one of the voxels (n, 3), in parts, some more than once.

    A cube appears as a hexagon: what its three edges, moved along each other, sweep over. A point lies in it if for each
    edge it is not farther across the edge than half of the others' extent. Perspective within one voxel is left out.
    """
    step = max(1, PIXELS_AT_ONCE // max(1, len(pictures.cameras)))
    for start in range(0, len(voxels) if pictures.cameras else 0, step):
        x, y, depth = pictures.project(voxels[start:start + step] + 0.5)
        view, voxel = np.nonzero(depth > 0)
        x, y, depth = x[view, voxel], y[view, voxel], depth[view, voxel]
        edges = pictures.matrices[view, :, :3]
        ex = (edges[:, 0].T - x * edges[:, 2].T) / depth  # (3, m): how the image moves along each edge
        ey = (edges[:, 1].T - y * edges[:, 2].T) / depth
        reach = 0.5 * np.abs(ex).sum(axis=0), 0.5 * np.abs(ey).sum(axis=0)
        columns, rows = (int(2 * extent.max(initial=0)) + 1 for extent in reach)
        size = max(1, PIXELS_AT_ONCE // (columns * rows))
        for own in (slice(first, first + size) for first in range(0, len(x), size)):
            yield _hexagons(pictures, view[own], (x[own], y[own]), (ex[:, own], ey[:, own]), (columns, rows))


def _hexagons(pictures: Pictures, view: np.ndarray, middle: tuple[np.ndarray, np.ndarray], edges: tuple[np.ndarray, np.ndarray],
              box: tuple[int, int]) -> np.ndarray:
    """Return the rows of the pixels in hexagons, given by middles (m,) and edges (3, m); none covers more than ``box``."""
    (x, y), (ex, ey) = middle, edges
    column = np.ceil(x - 0.5 * np.abs(ex).sum(axis=0) - 0.5)[:, None] + np.tile(np.arange(box[0], dtype=np.float32), box[1])
    row = np.ceil(y - 0.5 * np.abs(ey).sum(axis=0) - 0.5)[:, None] + np.repeat(np.arange(box[1], dtype=np.float32), box[0])
    right, down = column + 0.5 - x[:, None], row + 0.5 - y[:, None]  # pixels' centres are at halves
    across = 0.5 * np.abs(ex[:, None] * ey - ey[:, None] * ex).sum(axis=0) + np.float32(1e-9)
    a, b = (ey / across)[..., None], (ex / across)[..., None]
    width, height = pictures.sizes[view].T[..., None]
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    for edge in range(3):
        inside &= np.abs(a[edge] * right - b[edge] * down) <= 1
    return (pictures.offset[view][:, None] + (row * width + column).astype(np.intp))[inside]
