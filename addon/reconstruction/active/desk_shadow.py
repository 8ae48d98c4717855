# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `desk-shadow`: a lamp, a stick whose shadow sweeps over an object on a desk, and a camera that stands still.

Bouguet & Perona, "3D photography on your desk" (1998). The shadow's edge on the desk, in strips of the picture where nothing but
the desk is seen, and the lamp span a plane; with the edge on a second known plane the lamp need not be known. A pixel's ray
meets the plane of the moment at which the shadow arrives there. Memory: two pictures and about ten numbers a pixel, however
many frames there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, silent
from ..geometry import Camera
from ..scan import ProjectedPicture, Scan, View
from .correspondence import NOISE, Reason
from .measurement import Measurement, measurement_of
from .sequences import of_kind, read_grey
from .shadow_edges import Range, arrival_times, leading_edge, pixel_ranges
from .structured_light import FILL
from .triangulation import LEAST_ANGLE, meet_planes, rays_through, undistorted_pixels

LEAST_CONTRAST = 30 / 255
"""Of full scale: between a pixel's brightest and darkest value."""
LEAST_FRAMES = 3
SOURCES = {"auto": "By the lamp where it is known, otherwise by two planes", "light": "By one plane and the lamp",
           "two-planes": "By the shadow's edges on two planes; the lamp need not be known"}
OPTIONS = (
    Option("contrast", LEAST_CONTRAST, "Least difference of a pixel's brightest and darkest value, as a share of white", minimum=0.0,
           maximum=1.0),
    Option("shadow_planes", "auto", "How the shadow's planes are found", choices=SOURCES),
    Option("noise", NOISE, "Noise of the pictures, as a share of white, for the expected error of the points", minimum=0.0, maximum=1.0),
    Option("clearance", 0.0, "Points nearer than this to the desk, or to a wall that is named, are left out; 0 is one percent of its "
           "distance from the camera, below 0 keeps all", unit=Unit.LENGTH, minimum=-1.0, maximum=1e6),
    FILL,
)
_CLEARANCE = 0.01
_LEAST_EDGES = 2  # in each strip
_TURN = np.sin(np.radians(2.0))  # least angle between the edges on two planes


@dataclass(frozen=True)
class Strip:
    """Rows of the picture where only a known plane is seen.

    Parameters
    ----------
    rows : (int, int)
        The first and the one after the last.
    plane : (4,) array
        ``(nx, ny, nz, d)`` in the object frame, ``n . X = d``.
    """

    rows: tuple[int, int]
    plane: np.ndarray


def measure_desk_shadow(scan: Scan, *, contrast: float = LEAST_CONTRAST, shadow_planes: str = "auto", noise: float = NOISE,
                        clearance: float = 0.0, fill: str = "shell", progress: Progress = silent) -> Measurement:
    """Measure points by the shadow of a stick.

    The frames of one sweep share a pattern ``{"kind": "shadow", "sweep": number, "strips": [{"rows": [first, end], "plane": [nx, ny, nz,
    d]}]}`` and are in the order of time. Several sweeps of a view are merged by the weights ``1 / sigma^2``.

    Raises
    ------
    ScanstageError
        No frame shows a shadow's sweep, a sweep has too few frames, its strips cannot be used, or no plane is found.
    """
    parts = []
    for number, view in enumerate(scan.views):
        sweeps = find_shadow_sweeps(view)
        found = []
        for step, pictures in enumerate(sweeps):
            progress((number + step / len(sweeps)) / len(scan.views), f"Following the shadow in view {view.name}")
            found.append(_measured_sweep(view, pictures, contrast, shadow_planes, noise))
        if found:
            planes = [strip.plane for strip in strips_of(sweeps[0][0], view.camera.size[1])]
            parts.append(_merged(view, number, found, planes, clearance))
    if not parts:
        raise ScanstageError("no frame of the capture shows the sweep of a shadow, and desk-shadow needs one; capture a sweep")
    progress(1.0, "Measured")
    return Measurement.joined(parts)


def find_shadow_sweeps(view: View) -> list[list[ProjectedPicture]]:
    """Return a view's sweeps, each in the order of time.

    Raises
    ------
    ScanstageError
        One has too few frames.
    """
    groups: dict[str, list[ProjectedPicture]] = {}
    for picture in of_kind(view.projected, "shadow"):
        groups.setdefault(str(picture.pattern.get("sweep", 0)), []).append(picture)
    for pictures in groups.values():
        if len(pictures) < LEAST_FRAMES:
            raise ScanstageError(f"the view of frame {view.name}: its shadow's sweep has {len(pictures)} frames (first: "
                                 f"{pictures[0].name}); capture at least {LEAST_FRAMES}")
    return list(groups.values())


def strips_of(picture: ProjectedPicture, height: int) -> list[Strip]:
    """Return the strips that a frame's pattern names.

    Raises
    ------
    ScanstageError
        There are none, or one is not what it must be.
    """
    given = picture.pattern.get("strips")
    if not isinstance(given, (list, tuple)) or not given:
        raise ScanstageError(f"frame {picture.name}: its pattern has no strips; name rows of the picture in which only the desk is seen")
    return [_strip(item, height, f"frame {picture.name}: its pattern's strip {number}") for number, item in enumerate(given)]


def _strip(item: object, height: int, place: str) -> Strip:
    rows, plane = (item.get("rows"), item.get("plane")) if isinstance(item, Mapping) else (None, None)
    if not (isinstance(rows, (list, tuple)) and len(rows) == 2 and all(type(row) is int for row in rows)
            and 0 <= rows[0] <= rows[1] - _LEAST_EDGES and rows[1] <= height):
        raise ScanstageError(f"{place} must have rows [first, end] with 0 <= first, first + {_LEAST_EDGES} <= end <= {height}")
    if not (isinstance(plane, (list, tuple)) and len(plane) == 4 and all(isinstance(value, float | int) for value in plane)
            and np.isfinite(plane).all() and np.linalg.norm(plane[:3]) > 0):
        raise ScanstageError(f"{place} must have a plane [nx, ny, nz, d]")
    return Strip((rows[0], rows[1]), np.array(plane, np.float64) / np.linalg.norm(plane[:3]))


def _images(pictures: Sequence[ProjectedPicture]) -> Iterator[np.ndarray]:
    return (read_grey(picture) for picture in pictures)


def _measured_sweep(view: View, pictures: Sequence[ProjectedPicture], contrast: float, source: str,
                    noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each pixel's distance along its ray, that distance's deviation, and a `Reason`: (h, w) arrays."""
    strips = strips_of(pictures[0], view.camera.size[1])
    ranges = pixel_ranges(_images(pictures))
    time, drop = arrival_times(_images(pictures), ranges)
    planes = _planes(view, pictures, strips, ranges, time, contrast, source)
    reason = np.where(ranges.contrast < max(contrast, 1e-6), np.uint8(Reason.UNLIT), np.uint8(Reason.UNCERTAIN))
    rows, columns = np.nonzero((reason == Reason.UNCERTAIN) & np.isfinite(time))
    rays = rays_through(view.camera, np.stack((columns, rows), axis=-1))
    when = time[rows, columns].astype(np.float64)
    lower = np.clip(np.floor(when).astype(int), 0, len(planes) - 2)
    change = planes[lower + 1] - planes[lower]
    at = planes[lower] + (when - lower)[:, None] * change
    along, sine = meet_planes(view.camera.centre, rays, at)
    points = view.camera.centre + along[:, None] * rays
    # The dual form's error, 1 / Z being linear in the plane (Bouguet & Perona, 1999): here from the plane's motion at the point.
    motion = np.abs((change[:, :3] * points).sum(axis=1) - change[:, 3])
    deviation = np.sqrt(0.5) * noise / drop[rows, columns].astype(np.float64) * motion / np.maximum(sine, 1e-12)
    known = np.isfinite(along)
    good = known & (along > 0) & (sine > np.sin(LEAST_ANGLE))
    reason[rows, columns] = np.select([good, known], [np.uint8(Reason.VALID), np.uint8(Reason.BEHIND)], np.uint8(Reason.UNCERTAIN))
    distance, deviations = np.full(reason.shape, np.nan), np.full(reason.shape, np.inf)
    distance[rows[good], columns[good]] = along[good]
    deviations[rows[good], columns[good]] = np.maximum(deviation[good], 1e-12 * along[good])
    return distance, deviations, reason


def _planes(view: View, pictures: Sequence[ProjectedPicture], strips: Sequence[Strip], ranges: Range, time: np.ndarray, contrast: float,
            source: str) -> np.ndarray:
    """Return the shadow's planes (frames, 4), with unit normals that turn steadily; nan where a frame shows too little of its edge."""
    light = None if pictures[0].light is None else pictures[0].light.position
    two = source == "two-planes" or (source == "auto" and light is None)
    grounds = _by_plane(strips)
    if two and len(grounds) < 2 or not two and light is None:
        raise ScanstageError(f"frame {pictures[0].name}: the shadow's planes need a lamp whose position is known, or strips on two planes; "
                             "calibrate the lamp by pencils, or name a second plane")
    grounds = grounds[:2] if two else grounds[:1]
    planes = np.full((len(pictures), 4), np.nan)
    for frame, image in enumerate(_images(pictures)):
        above = np.where(ranges.contrast >= contrast, image - ranges.middle, np.nan)
        edges = [edge for plane, own in grounds if (edge := _edge_on(view.camera, plane, own, above, time, frame)) is not None]
        if len(edges) == len(grounds):
            planes[frame] = _spanned_by_edges(*edges) if two else _spanned_by_light(edges[0], light)
    if np.isfinite(planes[:, 0]).sum() < LEAST_FRAMES:
        raise ScanstageError(f"frame {pictures[0].name}: the shadow's edge is found in the strips of fewer than {LEAST_FRAMES} frames of "
                             "its sweep; check the strips' rows, or lower the contrast")
    known = np.flatnonzero(np.isfinite(planes[:, 0]))
    turns = (planes[known[1:], :3] * planes[known[:-1], :3]).sum(axis=1)
    planes[known] *= np.cumprod(np.append(1, np.where(turns < 0, -1, 1)))[:, None]  # a plane and its reverse are the same
    return planes


def _by_plane(strips: Sequence[Strip]) -> list[tuple[np.ndarray, list[Strip]]]:
    groups: dict[bytes, tuple[np.ndarray, list[Strip]]] = {}
    for strip in strips:
        groups.setdefault((strip.plane + 0.0).tobytes(), (strip.plane, []))[1].append(strip)
    return list(groups.values())


def _edge_on(camera: Camera, plane: np.ndarray, strips: Sequence[Strip], above: np.ndarray, time: np.ndarray,
             frame: int) -> np.ndarray | None:
    """Return two points (2, 3) of the shadow's edge on a plane; None if a strip does not show it."""
    found = []
    for strip in strips:
        rows = slice(*strip.rows)
        edge = leading_edge(above[rows], time[rows], frame)
        if len(edge) < _LEAST_EDGES:
            return None
        found.append(edge + (0, strip.rows[0]))
    pixels = undistorted_pixels(camera, np.concatenate(found))
    middle = pixels.mean(axis=0)
    step_x, step_y, x, y = cv2.fitLine((pixels - middle).astype(np.float32), cv2.DIST_HUBER, 0, 1e-3, 1e-5).ravel().astype(np.float64)
    half = np.ptp(pixels, axis=0).max() / 2
    ends = middle + (x, y) + half * np.array([[-step_x, -step_y], [step_x, step_y]])
    rays = camera.rays(ends)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along, _ = meet_planes(camera.centre, rays, plane)
    return camera.centre + along[:, None] * rays if (np.isfinite(along) & (along > 0)).all() else None


def _spanned_by_light(edge: np.ndarray, light: np.ndarray) -> np.ndarray:
    normal = np.cross(edge[1] - edge[0], light - edge[0])
    normal /= np.linalg.norm(normal)
    return np.append(normal, normal @ edge.mean(axis=0))


def _spanned_by_edges(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the plane along both edges that lies nearest to them; nan if they are nearly parallel."""
    steps = [(edge[1] - edge[0]) / np.linalg.norm(edge[1] - edge[0]) for edge in (first, second)]
    normal = np.cross(*steps)
    sine = np.linalg.norm(normal)
    if not sine > _TURN:
        return np.full(4, np.nan)
    normal /= sine
    return np.append(normal, normal @ np.concatenate((first, second)).mean(axis=0))


def _merged(view: View, number: int, found: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], planes: Sequence[np.ndarray],
            clearance: float) -> Measurement:
    """Return the points of a view's sweeps: their distances' mean, weighted by one over the expected variance.

    Points on the known planes, or behind them, are left out.
    """
    total, weights, reason = np.zeros(found[0][0].shape), np.zeros(found[0][0].shape), None
    for distance, deviation, own in found:
        weight = 1 / deviation ** 2
        total += np.where(np.isfinite(distance), distance, 0) * weight
        weights += weight
        reason = own if reason is None else np.where((reason == Reason.VALID) | (own == Reason.VALID), np.uint8(Reason.VALID),
                                                     np.maximum(reason, own))
    rows, columns = np.nonzero(weights > 0)
    weight = weights[rows, columns]
    rays = rays_through(view.camera, np.stack((columns, rows), axis=-1))
    points = view.camera.centre + (total[rows, columns] / weight)[:, None] * rays
    clear = np.ones(len(points), bool)
    for plane in planes if clearance >= 0 else ():
        away = plane[:3] @ view.camera.centre - plane[3]
        clear &= np.sign(away) * (points @ plane[:3] - plane[3]) >= (clearance or _CLEARANCE * abs(away))
    reason[rows[~clear], columns[~clear]] = Reason.UNLIT
    return measurement_of(view, number, points[clear], (rows[clear], columns[clear]), 1 / np.sqrt(weight[clear]), reason, None)
