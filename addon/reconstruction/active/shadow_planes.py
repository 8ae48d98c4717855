# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The plane of shadow behind a stick at each moment, from where its edge lies on known planes.

On strips of rows that show nothing but a known plane, the desk or a wall behind it, the shadow's edge is a straight line. With the
lamp's place one such plane is enough: the shadow's plane holds the line and the lamp. With two known planes the lamp
need not be known: the plane holds both lines (Bouguet & Perona, 1998).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import Camera
from .triangulation import meet_planes, rays_through

_LEAST_PIXELS = 12  # of an edge in a strip
_REACH = 1.0  # frames before and after a moment whose pixels tell where its edge is
_ROBUST = 3.0  # deviations beyond which a pixel is left out
_ROUNDS = 4


@dataclass(frozen=True)
class Strip:
    """Rows of the picture in which only a known plane is seen.

    Parameters
    ----------
    first, last : int
        Rows, both of them counted.
    plane : (4,) array
        ``n . X = d`` in the object frame.
    """

    first: int
    last: int
    plane: np.ndarray


@dataclass(frozen=True)
class ShadowPlanes:
    """Planes of shadow over time.

    Parameters
    ----------
    times : (k,) array
        In frames, rising.
    planes : (k, 4) array
        ``n . X = d`` with unit normals that all point to the same side.
    """

    times: np.ndarray
    planes: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the planes (n, 4) at times (n,), between two known ones in proportion; NaN before the first and after the last."""
        return np.stack([np.interp(times, self.times, values, left=np.nan, right=np.nan) for values in self.planes.T], axis=-1)


def shadow_planes(camera: Camera, times: np.ndarray, strips: Sequence[Strip], light: np.ndarray | None) -> ShadowPlanes:
    """Find the plane of shadow at each frame at which its edge is seen in all strips.

    Parameters
    ----------
    camera : Camera
    times : (h, w) array
        From `shadow_times.shadow_times`.
    strips : sequence of Strip
        At least two; at least two different planes where there is no light.
    light : (3,) array, optional
        Where the lamp is, in the object frame.
    """
    edges = [edge_lines(times[strip.first:strip.last + 1]) for strip in strips]
    moments = sorted(set.intersection(*(set(edge) for edge in edges)))
    planes = []
    for moment in moments:
        points = np.concatenate([_on_plane(camera, strip, edge[moment]) for strip, edge in zip(strips, edges, strict=True)])
        planes.append(plane_through(points if light is None else np.vstack((points, light)), None if light is None else light))
    if not planes:
        return ShadowPlanes(np.zeros(0), np.zeros((0, 4)))
    planes = np.array(planes)
    for number in range(1, len(planes)):  # normals point to the same side
        if planes[number, :3] @ planes[number - 1, :3] < 0:
            planes[number] *= -1
    return ShadowPlanes(np.array(moments, np.float64), planes)


def edge_lines(times: np.ndarray) -> dict[int, np.ndarray]:
    """Return, for each frame at which the edge is in a strip of rows, its column at the first and at the last row (2,).

    Near the moment m the column at which the edge is, is ``a + b row + c (time - m)``: fitted robustly to the pixels that
    it passes about then.
    """
    rows, columns = np.nonzero(np.isfinite(times))
    when = times[rows, columns]
    order = np.argsort(when)
    rows, columns, when = rows[order], columns[order], when[order].astype(np.float64)
    found = {}
    if not len(when):
        return found
    for moment in range(int(np.ceil(when[0])), int(np.floor(when[-1])) + 1):
        part = slice(*np.searchsorted(when, (moment - _REACH, moment + _REACH)))
        if part.stop - part.start < _LEAST_PIXELS:
            continue
        line = _robust_line(np.column_stack((np.ones(part.stop - part.start), rows[part], when[part] - moment)), columns[part])
        if line is not None:
            found[moment] = line[0] + line[1] * np.array([0, len(times) - 1])
    return found


def _robust_line(factors: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Return the least-squares solution without outliers; None if too few values are left."""
    kept = np.ones(len(values), bool)
    for _ in range(_ROUNDS):
        solution = np.linalg.lstsq(factors[kept], values[kept], rcond=None)[0]
        off = np.abs(values - factors @ solution)
        kept = off <= max(_ROBUST * 1.4826 * float(np.median(off[kept])), 0.5)
        if np.count_nonzero(kept) < _LEAST_PIXELS:
            return None
    return solution


def _on_plane(camera: Camera, strip: Strip, columns: np.ndarray) -> np.ndarray:
    rays = rays_through(camera, np.stack((columns, (strip.first, strip.last)), axis=-1).astype(np.float64))
    distance, _ = meet_planes(camera.centre, rays, strip.plane)
    return camera.centre + distance[:, None] * rays


def plane_through(points: np.ndarray, light: np.ndarray | None) -> np.ndarray:
    """Return the plane (4,) nearest to points (n, 3), exactly through the light where that is given."""
    middle = points.mean(axis=0) if light is None else light
    normal = np.linalg.svd(points - middle)[2][2]
    return np.append(normal, normal @ middle)
