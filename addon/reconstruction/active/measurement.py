# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the views of a scan measured: points, and the space in front of them that is seen to be free.

A view's correspondence map becomes points with normals, colours and expected errors; the views of a turntable are already in
one frame, the object's, so that merging is putting together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from ...errors import ScanstageError
from ...progress import Progress, silent
from ..geometry import Camera, VoxelGrid
from ..outcome import Outcome
from ..points import PointCloud
from ..scan import Scan, View
from .correspondence import SENTENCES, Decoded, Reason, tally
from .free_space import DepthMap, colored_surface, depth_map_of, occupied, projector_depths
from .patterns import AXES
from .triangulation import LEAST_ANGLE, meet_lines, meet_rays, picture_rays, pixel_width, rays_through

MAX_GAP = 2.0
"""Projector pixels by which the rays of camera and projector may miss each other."""
_LEAST_BASELINE = 1e-6  # of the distance between the scene's devices and what they see
_NORMAL_WINDOW = 5
_MARGIN = 0.05  # of the points' extent, on each side of the working volume
_OUTLIERS = 0.005  # share of the points that may lie beyond each side of it


@dataclass(frozen=True)
class Measurement:
    """Points of all views, and what they say of the space before them.

    Parameters
    ----------
    cloud : PointCloud
    depths : tuple of DepthMap
        As cameras, and projectors, see them.
    counts : mapping of str to int
        Pixels by `Reason`, over all views.
    warnings : tuple of str
    pictures : mapping of str to (h, w, 3) uint8 array
        sRGB.
    """

    cloud: PointCloud
    depths: tuple[DepthMap, ...]
    counts: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    pictures: Mapping[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def joined(cls, parts: Sequence[Measurement]) -> Measurement:
        """Merge the measurements of several views, which share the object frame."""
        counts: dict[str, int] = {}
        for part in parts:
            counts |= {name: counts.get(name, 0) + number for name, number in part.counts.items()}
        return cls(PointCloud.joined([part.cloud for part in parts]), tuple(depth for part in parts for depth in part.depths), counts,
                   tuple(warning for part in parts for warning in part.warnings),
                   {name: picture for part in parts for name, picture in part.pictures.items()})

    def bounds(self) -> np.ndarray:
        """Return a (2, 3) box round the points, but for stray ones, with some room.

        Raises
        ------
        ScanstageError
            There are no points, or they all lie on a line.
        """
        if not len(self.cloud):
            raise ScanstageError("no pixel gave a point; check the patterns, the calibration and the light, or lower the contrast")
        low, high = np.quantile(self.cloud.positions, (_OUTLIERS, 1 - _OUTLIERS), axis=0)
        room = _MARGIN * np.linalg.norm(high - low)
        if not room > 0:
            raise ScanstageError("all points lie in one place; check the calibration, or give the working volume with --bounds")
        return np.stack((low - room, high + room))


def measured_bounds(scan: Scan, measured: Measurement, **options) -> np.ndarray:
    """Return the (2, 3) working volume: the capture's own, or one that holds the points."""
    return measured.bounds() if scan.bounds is None else np.asarray(scan.bounds, np.float64)


def points_to_voxels(scan: Scan, grid: VoxelGrid, *, measured: Measurement, fill: str = "shell", progress: Progress = silent,
                     **options) -> Outcome:
    """Make voxels of the points that lie in the working volume; points that another view sees through are dropped.

    Raises
    ------
    ScanstageError
        There are no points in the working volume.
    """
    cloud = measured.cloud.within(np.stack((grid.origin, grid.upper)))
    if not len(cloud):
        raise ScanstageError(f"none of the {len(measured.cloud)} points lies in the working volume; check the calibration, the "
                             "contrast, or the bounds")
    volume, stray = occupied(cloud, measured.depths, grid, fill=fill, progress=progress)
    cloud = cloud.chosen(~stray)
    surface, colors = colored_surface(volume, cloud)
    counts = {"points": len(cloud), "stray_points": int(np.count_nonzero(stray))}
    report = {"counts": counts, "pixels": dict(measured.counts), "warnings": list(measured.warnings),
              "expected_sigma": float(np.median(cloud.sigma)) if len(cloud) else None}
    return Outcome(volume, report, surface, colors, pictures=measured.pictures, points=cloud)


def measure_view(view: View, number: int, projector: Camera, decoded: Mapping[str, Decoded], *, max_gap: float = MAX_GAP) -> Measurement:
    """Triangulate a view's correspondence map.

    Parameters
    ----------
    view : View
    number : int
        Of the view in the scan.
    projector : Camera
        In the object frame.
    decoded : mapping of str to Decoded
        By ``column`` and ``row``. With both, rays meet rays and those that miss each other are dropped; with one, rays meet
        planes of light.
    max_gap : float
        By how many projector pixels two rays may miss each other.

    Raises
    ------
    ScanstageError
        Camera and projector are in the same place.
    """
    refuse_degenerate(view.name, view.camera, projector)
    axes = [axis for axis in AXES if axis in decoded]
    reason = np.maximum.reduce([decoded[axis].reason for axis in axes])
    rows, columns = np.nonzero(reason == Reason.VALID)
    rays = picture_rays(view.camera)[rows, columns]
    origin = view.camera.centre
    positions = [decoded[axis].position[rows, columns].astype(np.float64) for axis in axes]
    sigma = np.sqrt(np.mean([np.broadcast_to(decoded[axis].sigma, reason.shape)[rows, columns] ** 2 for axis in axes], axis=0))
    if len(axes) == 2:
        meeting = meet_rays(origin, rays, projector.centre, rays_through(projector, np.stack(positions, axis=-1)))
        points, sine = meeting.points, meeting.sine
        with np.errstate(invalid="ignore"):
            apart = meeting.gap > max_gap * pixel_width(projector, axes[0], points)
            good = (meeting.along > 0) & (meeting.beside > 0)
    else:
        distance, sine = meet_lines(projector, axes[0], positions[0], origin, rays)
        with np.errstate(invalid="ignore"):
            points = origin + distance[:, None] * rays
            apart, good = np.zeros(len(points), bool), (distance > 0) & (projector.project(points)[1] > 0)
    good &= np.isfinite(points).all(axis=1) & (sine > np.sin(LEAST_ANGLE))
    reason[rows, columns] = np.where(~good, np.uint8(Reason.BEHIND), np.where(apart, np.uint8(Reason.APART), np.uint8(Reason.VALID)))
    good &= ~apart
    points, sine, rows, columns = points[good], sine[good], rows[good], columns[good]
    deviation = sigma[good] * pixel_width(projector, axes[0], points) / sine
    return measurement_of(view, number, points, (rows, columns), deviation, reason, projector)


def refuse_degenerate(name: str, camera: Camera, projector: Camera) -> None:
    """Refuse a projector that stands where the camera does: all rays then meet there."""
    baseline = np.linalg.norm(camera.centre - projector.centre)
    if not baseline > _LEAST_BASELINE * max(np.linalg.norm(camera.t), np.linalg.norm(projector.t), 1e-300):
        raise ScanstageError(f"frame {name}: its projector stands where the camera does, so that nothing can be triangulated; "
                             "correct the calibration, or move one of the two")


def measurement_of(view: View, number: int, points: np.ndarray, pixels: tuple[np.ndarray, np.ndarray], deviation: np.ndarray,
                   reason: np.ndarray, projector: Camera | None) -> Measurement:
    """Return the measurement of a view's points, with their normals, their colours and what they say of the space before them.

    Parameters
    ----------
    view : View
    number : int
    points : (n, 3) array
    pixels : two (n,) integer arrays
        Row and column of the pixel that each point belongs to.
    deviation : (n,) array
        Expected, along the camera's ray.
    reason : (height, width) uint8 array
    projector : Camera, optional
        From which light came to the points.
    """
    local = points @ view.camera.R.T + view.camera.t
    front = local[:, 2] > 0
    seen = np.zeros((*reason.shape, 3))
    seen[pixels[0][front], pixels[1][front]] = local[front]
    cloud = PointCloud(points, (view_normals(seen) @ view.camera.R)[pixels], np.clip(view.read_image()[pixels], 0, 1), deviation,
                       np.full(len(points), number))
    maps = [depth_map_of(view.camera, seen[..., 2])]
    if projector is not None:
        maps.append(projector_depths(projector, points))
    counts = tally(reason)
    return Measurement(cloud, tuple(maps), counts, tuple(decoding_warnings(view.name, counts)),
                       {f"decoded-{view.name}": reason_picture(reason)})


def view_normals(points: np.ndarray) -> np.ndarray:
    """Return the normals (h, w, 3) of a picture of points, towards the camera.

    Of a plane, ``1 / Z`` is linear in the normalised picture: ``1 / Z = a x + b y + c`` has the normal ``(a, b, c)``. It is
    fitted by least squares in a window about each pixel. Where the window holds too little, the normal is the direction
    to the camera.

    Parameters
    ----------
    points : (h, w, 3) array
        In the camera's frame; 0 where there is none.
    """
    depth = points[..., 2]
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=known)
    x, y = points[..., 0] * inverse, points[..., 1] * inverse

    def total(values: np.ndarray) -> np.ndarray:
        return cv2.boxFilter(values, -1, (_NORMAL_WINDOW, _NORMAL_WINDOW), normalize=False, borderType=cv2.BORDER_CONSTANT)

    count = np.maximum(total(known.astype(np.float64)), 1)
    middle_x, middle_y, middle = (total(values) / count for values in (x, y, inverse))
    xx, yy, xy = (total(a * b) / count - c * d for a, b, c, d in ((x, x, middle_x, middle_x), (y, y, middle_y, middle_y),
                                                                 (x, y, middle_x, middle_y)))
    xq, yq = total(x * inverse) / count - middle_x * middle, total(y * inverse) / count - middle_y * middle
    determinant = xx * yy - xy * xy
    enough = known & (count >= 6) & (determinant > 1e-3 * np.maximum(xx, yy) ** 2)
    safe = np.where(enough, determinant, 1)
    a, b = (yy * xq - xy * yq) / safe, (xx * yq - xy * xq) / safe
    towards = np.where(known[..., None], -points, (0, 0, -1))
    normals = np.where(enough[..., None], -np.stack((a, b, middle - a * middle_x - b * middle_y), axis=-1), towards)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


_REASON_COLORS = {Reason.VALID: (70, 160, 80), Reason.UNLIT: (20, 20, 24), Reason.SATURATED: (250, 250, 250),
                  Reason.UNCERTAIN: (230, 160, 40), Reason.OUTSIDE: (170, 60, 180), Reason.APART: (210, 50, 50),
                  Reason.BEHIND: (60, 100, 220)}


def reason_picture(reason: np.ndarray) -> np.ndarray:
    """Return a (h, w, 3) uint8 picture that shows each pixel's `Reason` by a colour."""
    table = np.zeros((len(Reason), 3), np.uint8)
    for kind, color in _REASON_COLORS.items():
        table[kind] = color
    return table[reason]


def decoding_warnings(name: str, counts: Mapping[str, int]) -> list[str]:
    """Return a warning if many of a view's lit pixels gave no point, with the commonest reason."""
    lit = sum(counts.values()) - counts["unlit"]
    lost = {kind: counts[kind.name.lower()] for kind in Reason if kind not in (Reason.VALID, Reason.UNLIT)}
    worst = max(lost, key=lost.get)
    if lit and sum(lost.values()) > 0.5 * lit:
        return [f"frame {name}: {100 * sum(lost.values()) / lit:.0f} % of the lit pixels gave no point, most of them because: "
                f"{SENTENCES[worst]}"]
    return []
