# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `desk-shadow`: a lamp, a stick and a desk (Bouguet & Perona, 1998 and 1999).

The stick's shadow passes over the scene. Each pixel notes when (`shadow_times`); at that time the shadow lies in a plane that its
edge on the desk and the lamp tell (`shadow_planes`); where the pixel's ray meets that plane is the surface. Sweeps with other
lamps or other directions of the stick are merged, each weighted by what error is expected of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, part_of, silent
from ..scan import ProjectedPicture, Scan, View
from .correspondence import NOISE, Reason
from .measurement import Measurement, measurement_of
from .sequences import number_of, of_kind, read_grey
from .shadow_planes import ShadowPlanes, Strip, shadow_planes
from .shadow_times import shadow_times
from .structured_light import FILL
from .triangulation import LEAST_ANGLE, meet_planes, rays_through

KIND = "stick-shadow"
OPTIONS = (
    Option("contrast", 0.05, "Least difference between a pixel in the light and in the shadow, as a share of white", minimum=0.0,
           maximum=1.0),
    Option("planes", "auto", "What tells the planes of shadow", choices={
        "auto": "the lamp and the desk; without a lamp, the desk and the wall behind it",
        "light": "the lamp and the known planes", "two": "two known planes; the lamp is not used"}),
    Option("noise", NOISE, "Noise of the pictures, as a share of white, for the expected error of the points", minimum=0.0, maximum=1.0),
    Option("clearance", 0.0, "Points nearer than this to the desk or the wall are left out; 0 is one percent of the camera's distance, "
           "below 0 keeps all", unit=Unit.LENGTH, minimum=-1.0, maximum=1e6),
    FILL,
)
_CLEARANCE = 0.01
_LEAST_FRAMES = 8
_LEAST_PLANES = 3


@dataclass(frozen=True)
class StickSweep:
    """One passing of the shadow.

    Parameters
    ----------
    pictures : tuple of ProjectedPicture
        In the order of time.
    strips : tuple of Strip
    light : (3,) array, optional
    """

    pictures: tuple[ProjectedPicture, ...]
    strips: tuple[Strip, ...]
    light: np.ndarray | None


def measure_desk_shadow(scan: Scan, *, contrast: float = 0.05, planes: str = "auto", noise: float = NOISE, clearance: float = 0.0,
                        fill: str = "shell", progress: Progress = silent) -> Measurement:
    """Measure the points of every view over which the shadow of a stick passed.

    Two pictures' worth of numbers are kept for each sweep, and each picture is read twice.

    Raises
    ------
    ScanstageError
        No frame shows a stick's shadow, its fields are wrong, or nothing could be measured.
    """
    views = [(number, view, stick_sweeps(view)) for number, view in enumerate(scan.views) if of_kind(view.projected, KIND)]
    if not views:
        raise ScanstageError("no frame of the capture shows the shadow of a stick, and desk-shadow needs them; capture with the rig "
                             "desk-shadow")
    parts = []
    for step, (number, view, sweeps) in enumerate(views):
        share = part_of(progress, step / len(views), (step + 1) / len(views))
        parts.append(_measured(view, number, sweeps, contrast=contrast, mode=planes, noise=noise, clearance=clearance, progress=share))
    progress(1.0, "Measured")
    return Measurement.joined(parts)


def stick_sweeps(view: View) -> list[StickSweep]:
    """Return the sweeps of a view.

    Raises
    ------
    ScanstageError
        A field is wrong, or a sweep has too few frames.
    """
    groups: dict[int, list[ProjectedPicture]] = {}
    for picture in of_kind(view.projected, KIND):
        groups.setdefault(int(number_of(picture, "sweep", 0, 1e6)), []).append(picture)
    sweeps = []
    for pictures in groups.values():
        pictures.sort(key=lambda picture: number_of(picture, "index", 0, 1e9))
        first = pictures[0]
        if len(pictures) < _LEAST_FRAMES:
            raise ScanstageError(f"frame {first.name}: its sweep has {len(pictures)} frames, fewer than {_LEAST_FRAMES}; move the stick in "
                                 "smaller steps")
        light = None if first.light is None or first.light.kind == "sun" else first.light.position
        sweeps.append(StickSweep(tuple(pictures), _strips(first, view.camera.size), light))
    return sweeps


def _strips(picture: ProjectedPicture, size: tuple[int, int]) -> tuple[Strip, ...]:
    """Return the strips that a pattern names: ``strips``, a list of [first row, last row, name of a field with a plane]."""
    named = picture.pattern.get("strips")
    place = f"frame {picture.name}: its pattern's strips"
    if not isinstance(named, Sequence) or isinstance(named, str) or len(named) < 2:
        raise ScanstageError(f"{place} must be a list of two or more [first row, last row, plane]")
    found = []
    for item in named:
        if not (isinstance(item, Sequence) and len(item) == 3 and all(type(row) is int for row in item[:2])
                and 0 <= item[0] < item[1] < size[1] and isinstance(item[2], str)):
            raise ScanstageError(f"{place} must be [first row, last row, plane] with rows from 0 to {size[1] - 1}, not {str(item)[:60]}")
        plane = picture.pattern.get(item[2])
        if not isinstance(plane, Sequence) or len(plane) != 4:
            raise ScanstageError(f"{place}: there is no plane {item[2][:40]!r} beside them; give it as [nx, ny, nz, d]")
        found.append(Strip(item[0], item[1], np.asarray(plane, np.float64)))
    return tuple(found)


def _measured(view: View, number: int, sweeps: Sequence[StickSweep], *, contrast: float, mode: str, noise: float, clearance: float,
              progress: Progress) -> Measurement:
    """Measure one view: every sweep by itself, and then their mean for each pixel."""
    shape = view.camera.size[::-1]
    weights, weighted = np.zeros(shape), np.zeros(shape)
    reason = np.full(shape, Reason.UNLIT, np.uint8)
    for step, sweep in enumerate(sweeps):
        progress(step / len(sweeps), f"Following the shadow in frames {sweep.pictures[0].name} to {sweep.pictures[-1].name}")
        distance, deviation, why = sweep_distances(view, sweep, contrast=contrast, mode=mode, noise=noise)
        good = why == Reason.VALID
        weight = 1 / np.maximum(deviation[good], 1e-12) ** 2
        weights[good] += weight
        weighted[good] += weight * distance[good]
        reason = np.where(good | (reason == Reason.VALID), np.uint8(Reason.VALID), np.where(reason == Reason.UNLIT, why, reason))
    rows, columns = np.nonzero(weights)
    rays = rays_through(view.camera, np.stack((columns, rows), axis=-1).astype(np.float64))
    points = view.camera.centre + (weighted / np.where(weights, weights, 1))[rows, columns][:, None] * rays
    deviation = 1 / np.sqrt(weights[rows, columns])
    kept = _clear(points, sweeps[0].strips, clearance, view.camera.centre)
    reason[rows[~kept], columns[~kept]] = Reason.UNLIT
    pixels = rows[kept], columns[kept]
    return replace(measurement_of(view, number, points[kept], pixels, deviation[kept], reason, None), warnings=())


def sweep_distances(view: View, sweep: StickSweep, *, contrast: float, mode: str,
                    noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return, for each pixel, how far along its ray one sweep finds the surface, the expected error, and the `Reason`; (h, w) each.

    In time, an error of the picture's value is one of ``noise`` over the slope; along the ray it is that times the distance
    that the shadow's plane moves in a frame (the error model of Bouguet & Perona, 1999).

    Raises
    ------
    ScanstageError
        The sweep's planes cannot be found.
    """
    frames = f"frames {sweep.pictures[0].name} to {sweep.pictures[-1].name}"
    found = shadow_times(partial(_greys, sweep.pictures), contrast)
    planes = _planes(view, sweep, found.times, mode, frames)
    reason = found.reason.copy()
    rows, columns = np.nonzero(reason == Reason.VALID)
    times = found.times[rows, columns].astype(np.float64)
    rays = rays_through(view.camera, np.stack((columns, rows), axis=-1).astype(np.float64))
    along, sine = meet_planes(view.camera.centre, rays, planes.at(times))
    before, after = (meet_planes(view.camera.centre, rays, planes.at(np.clip(times + half, planes.times[0], planes.times[-1])))[0]
                     for half in (-0.5, 0.5))
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.abs(after - before) * noise / np.maximum(found.slopes[rows, columns], 1e-6)
        good = np.isfinite(along) & (along > 0) & (sine > np.sin(LEAST_ANGLE)) & np.isfinite(error)
    outside = np.isnan(along)
    reason[rows, columns] = np.where(good, np.uint8(Reason.VALID), np.where(outside, np.uint8(Reason.OUTSIDE), np.uint8(Reason.BEHIND)))
    distance, deviation = np.zeros(reason.shape), np.zeros(reason.shape)
    distance[rows[good], columns[good]], deviation[rows[good], columns[good]] = along[good], error[good]
    return distance, deviation, reason


def _greys(pictures: Sequence[ProjectedPicture]) -> Iterable[np.ndarray]:
    for picture in pictures:
        yield read_grey(picture)


def _planes(view: View, sweep: StickSweep, times: np.ndarray, mode: str, frames: str) -> ShadowPlanes:
    different = len({tuple(np.round(strip.plane, 12)) for strip in sweep.strips}) > 1
    if mode == "light" and sweep.light is None:
        raise ScanstageError(f"{frames}: no lamp is on whose place is known; calibrate it with pencils, or use "
                             "--set planes=two with two planes")
    with_light = mode == "light" or (mode == "auto" and sweep.light is not None)
    if not with_light and not different:
        raise ScanstageError(f"{frames}: without a lamp, strips on two different planes are needed; stand a wall behind the object, or "
                             "calibrate the lamp with pencils")
    planes = shadow_planes(view.camera, times, sweep.strips, sweep.light if with_light else None)
    if len(planes.times) < _LEAST_PLANES:
        raise ScanstageError(f"{frames}: the shadow's edge is seen in all strips of rows in {len(planes.times)} frames only; let it cross "
                             "them, choose rows that show nothing but the plane, or lower --set contrast=...")
    return planes


def _clear(points: np.ndarray, strips: Sequence[Strip], clearance: float, centre: np.ndarray) -> np.ndarray:
    """Return (n,) bool: which points lie on the camera's side of all known planes, and away from them."""
    kept = np.ones(len(points), bool)
    for strip in strips:
        side = np.sign(strip.plane[:3] @ centre - strip.plane[3])
        far = abs(float(strip.plane[:3] @ centre - strip.plane[3]))
        if clearance >= 0:
            kept &= side * (points @ strip.plane[:3] - strip.plane[3]) >= (clearance or _CLEARANCE * far)
    return kept
