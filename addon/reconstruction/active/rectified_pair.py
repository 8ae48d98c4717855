# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Rectification: two devices, cameras or projectors, as ideal ones side by side, so that epipolar lines are rows.

Both keep their centres and share one orientation, whose x axis runs from the first centre to the second, and one focal
length (Fusiello, Trucco & Verri, 2000). A point at depth Z is then at ``u1 - u2 = f b / Z + c1 - c2`` in the same row of both.
The principal points ``c1`` and ``c2`` are set apart such that what lies farthest in the working volume has no disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera
from .correspondence import Reason
from .rectification import pixel_map
from .rectification import rectify as rectify_picture
from .triangulation import rays_through

LARGEST_SIDE = 8192  # pixels of a rectified picture
_BORDER_STEPS = 32  # points on each side of a picture's border: a lens bends it
_LEAST_BASELINE = 1e-6  # of the working volume's distance
_LEAST_SINE = 0.05  # of the angle between the baseline and where the two look
_NEAREST = 0.02  # of the farthest depth: what is nearer to the devices is not looked for
_SURROUNDINGS = 0.5  # of the distance: half of the box that is looked at where nothing gives a working volume


@dataclass(frozen=True)
class RectifiedPair:
    """Two ideal devices with the same rows.

    Parameters
    ----------
    first, second : Camera
        In the object frame, without distortion.
    baseline : float
        From the first centre to the second, along x.
    disparities : int
        Disparities of the working volume lie from 0 to this.
    """

    first: Camera
    second: Camera
    baseline: float
    disparities: int

    @property
    def offset(self) -> float:
        """Disparity of what is infinitely far: at most 0."""
        return float(self.first.K[0, 2] - self.second.K[0, 2])

    def depths(self, disparity: np.ndarray) -> np.ndarray:
        """Return depths along the common axis; infinite or negative where there is none."""
        with np.errstate(divide="ignore"):
            return self.first.K[0, 0] * self.baseline / (np.asarray(disparity, np.float64) - self.offset)  # whichever way a numpy promotes

    def deviation(self, depths: np.ndarray, sigma: float) -> np.ndarray:
        """Return the expected error of depths for one of ``sigma`` pixels in the disparity (Khoshelham & Elberink, 2012, eq. 9)."""
        return depths ** 2 * sigma / (self.first.K[0, 0] * self.baseline)

    def points_seen(self, camera: Camera, disparity: np.ndarray, reason: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what the pixels of the real camera, the first one, see by the disparity nearest to each.

        Parameters
        ----------
        camera : Camera
        disparity : (h, w) array
            Of the rectified picture.
        reason : (h, w) uint8 array
            0 where there is one, otherwise a `correspondence.Reason`.

        Returns
        -------
        points : (n, 3) array
            In the object frame, on the pixels' own rays, in the order of ``np.nonzero(reason == 0)``.
        reason : (height, width) uint8 array
            Of the real picture.
        """
        width, height = camera.size
        rows, columns = np.mgrid[:height, :width]
        place, depth = self.first.project(self.first.centre + rays_through(camera, np.stack((columns, rows), axis=-1)))
        u, v = np.rint(np.nan_to_num(place, nan=-1.0)).astype(np.int64).transpose(2, 0, 1)
        inside = (depth > 0) & (u >= 0) & (v >= 0) & (u < disparity.shape[1]) & (v < disparity.shape[0])
        seen = np.full((height, width), Reason.UNLIT, np.uint8)
        seen[inside] = reason[v[inside], u[inside]]
        good = seen == Reason.VALID
        points = self.first.centre + self.depths(disparity[v[good], u[good]])[:, None] * self.first.rays(place[good])
        return points, seen


def rectify(first: Camera, second: Camera, box: np.ndarray, where: str) -> RectifiedPair:
    """Return two devices as a rectified pair that shows what both see of a box.

    Parameters
    ----------
    first, second : Camera
        In the object frame.
    box : (2, 3) array
        The working volume.
    where : str
        The view, for error messages.

    Raises
    ------
    ScanstageError
        The two stand in one place, one behind the other, or see nothing of the volume together.
    """
    along = second.centre - first.centre
    baseline = float(np.linalg.norm(along))
    forward = first.forward + second.forward
    x = along / baseline if baseline > 0 else along
    z = forward - (forward @ x) * x
    apart = baseline > _LEAST_BASELINE * float(np.linalg.norm(np.asarray(box).mean(axis=0) - first.centre))
    if not (apart and np.linalg.norm(z) > _LEAST_SINE * np.linalg.norm(forward)):
        raise ScanstageError(f"{where}: its two devices stand in one place, or one behind the other, and cannot be rectified; check "
                             "their poses")
    z /= np.linalg.norm(z)
    R = np.stack((x, np.cross(z, x), z))
    focal = float(min(first.K[0, 0], first.K[1, 1], second.K[0, 0], second.K[1, 1]))
    corners = np.stack(np.meshgrid(*np.asarray(box, np.float64).T), axis=-1).reshape(-1, 3)
    depth = (corners - first.centre) @ z
    far = float(depth.max())
    near = max(float(depth.min()), _NEAREST * far)
    extents = [_extent(device, R, focal, corners) for device in (first, second)]
    rows = max(extents[0][0, 1], extents[1][0, 1]), min(extents[0][1, 1], extents[1][1, 1])
    # The second picture is moved by the least disparity, that of the farthest points; see `offset`.
    columns = [(extent[0, 0], extent[1, 0]) for extent in extents]
    if not (far > 0 and rows[1] > rows[0] and all(high > low for low, high in columns)):
        raise ScanstageError(f"{where}: its two devices see nothing of the working volume together; check their poses, or the bounds")
    sides = [int(np.ceil(high - low)) + 1 for low, high in (rows, *columns)]
    if max(sides) > LARGEST_SIDE:
        raise ScanstageError(f"{where}: rectified, its pictures would have {max(sides)} pixels a side, more than {LARGEST_SIDE}; check "
                             "the poses, or give tighter bounds")
    least = focal * baseline / far
    # Whole pixels from the real picture's axis: where that is rectified already, nothing is interpolated.
    column, row = (float(first.K[axis, 2] - np.floor(first.K[axis, 2] + low)) for axis, low in enumerate((columns[0][0], rows[0])))
    cameras = [Camera([[focal, 0, c], [0, focal, row], [0, 0, 1]], R, -R @ device.centre, (sides[1] + 1, sides[0] + 1))
               for device, c in ((first, column), (second, column + least))]
    return RectifiedPair(*cameras, baseline, max(1, int(np.ceil(focal * baseline / near - least))))


def box_between(first: Camera, second: Camera) -> np.ndarray:
    """Return a (2, 3) box about where the axes of two devices come nearest to each other, for captures without a working volume."""
    a, b = first.forward, second.forward
    between, cosine = second.centre - first.centre, float(a @ b)
    distance = (between @ a - cosine * (between @ b)) / max(1 - cosine ** 2, 1e-9)
    if not 0 < distance < 100 * np.linalg.norm(between):
        distance = 10 * np.linalg.norm(between)  # parallel axes
    middle, half = first.centre + distance * a, _SURROUNDINGS * distance
    return np.stack((middle - half, middle + half))


def rectified_picture(device: Camera, ideal: Camera, picture: np.ndarray, *, interpolation: int = cv2.INTER_LINEAR,
                      border: float = 0.0) -> np.ndarray:
    """Return a device's picture, (h, w) or (h, w, c), as an ideal one with the same centre would show it."""
    return rectify_picture(picture, pixel_map(device, ideal), interpolation=interpolation, border=border)


def _extent(device: Camera, R: np.ndarray, focal: float, corners: np.ndarray) -> np.ndarray:
    """Return least and greatest (u, v), relative to the principal point, of what a device sees of a box given by its corners."""
    share = np.arange(_BORDER_STEPS) / _BORDER_STEPS
    edge = np.concatenate([a + share[:, None] * (b - a) for a, b in zip(_CORNERS, np.roll(_CORNERS, -1, axis=0), strict=True)])
    border = _slopes(rays_through(device, edge * device.size - 0.5) @ R.T)
    box = _slopes((corners - device.centre) @ R.T)
    return focal * np.stack((np.maximum(border.min(axis=0), box.min(axis=0)), np.minimum(border.max(axis=0), box.max(axis=0))))


_CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float64)


def _slopes(points: np.ndarray) -> np.ndarray:
    """Return ``x / z`` and ``y / z`` (n, 2); what is not in front counts as all of the picture."""
    ahead = points[:, 2] > 1e-3 * np.linalg.norm(points, axis=1)
    slopes = points[ahead, :2] / points[ahead, 2:]
    return slopes if ahead.all() else np.concatenate((slopes, [(-1e3, -1e3), (1e3, 1e3)]))
