# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Edge elements of a picture, and which of them is nearest to any place in it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..color import linear_to_srgb
from ..geometry import Camera
from ..scan import View
from .footprints import premultiplied, straightened

_BORDER = 3  # pixels from a mask's outline, which is an edge of no surface point
_LOW = 0.4  # of the edge threshold: how weak an edge may become where it goes on


@dataclass(frozen=True)
class Features:
    """Points in a picture.

    Parameters
    ----------
    camera : Camera
        Without distortion, in the object frame.
    points : (n, 2) float32 array
        In pixels.
    nearest : (height, width) int32 array
        Row of the point that is nearest to each pixel; -1 where there is none at all.
    domain : (height, width) bool array
        Where they were looked for.
    """

    camera: Camera
    points: np.ndarray
    nearest: np.ndarray
    domain: np.ndarray

    @classmethod
    def of(cls, camera: Camera, points: np.ndarray, domain: np.ndarray | None = None) -> Features:
        """Return the points (n, 2) as features, of the whole picture by default; those beyond it are left out."""
        width, height = camera.size
        points = np.asarray(points, np.float32).reshape(-1, 2)
        column, row = np.rint(points).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        points, column, row = points[inside], column[inside], row[inside]
        domain = np.ones((height, width), bool) if domain is None else domain
        if not len(points):
            return cls(camera, points, np.full((height, width), -1, np.int32), domain)
        free = np.ones((height, width), np.uint8)
        free[row, column] = 0
        labels = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]
        number = np.zeros(labels.max() + 1, np.int32)
        number[labels[row, column]] = np.arange(len(points))
        return cls(camera, points, number[labels], domain)

    def coverage(self, radius: float) -> float:
        """Return the share of the domain's pixels that have a point within a radius."""
        v, u = np.nonzero(self.domain)
        return float(np.mean(self.distances(u.astype(np.float32), v.astype(np.float32))[0] <= radius ** 2)) if len(u) else 0.0

    def distances(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the squared distances of places to their nearest points, and the rows of these; infinite and -1 beyond the picture."""
        width, height = self.camera.size
        with np.errstate(invalid="ignore"):
            inside = (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
        row = np.full(u.shape, -1, np.int32)
        row[inside] = self.nearest[np.rint(v[inside]).astype(np.intp), np.rint(u[inside]).astype(np.intp)]
        squared = np.full(u.shape, np.inf, np.float32)
        found = row >= 0
        x, y = self.points[row[found]].T
        squared[found] = (u[found] - x) ** 2 + (v[found] - y) ** 2
        return squared, row


def edge_features(view: View, *, contrast: float) -> Features:
    """Return a picture's edge elements (Canny, 1986) to a fraction of a pixel, away from the mask's outline.

    Parameters
    ----------
    view : View
    contrast : float
        Least step of brightness across an edge, of an sRGB picture's range.
    """
    image, camera = straightened(premultiplied(view), view.camera)
    used = cv2.erode((image[..., 3] > 0.999).astype(np.uint8), np.ones((2 * _BORDER + 1,) * 2, np.uint8), borderValue=0)
    gray = cv2.GaussianBlur(linear_to_srgb(np.clip(image[..., :3], 0, 1)).mean(axis=2).astype(np.float32), (0, 0), 1.0)
    dx, dy = (cv2.Sobel(gray, cv2.CV_32F, *order, scale=1 / 8) for order in ((1, 0), (0, 1)))
    scale = 2 ** 14  # gradients of at most 1 as 16-bit integers, which is what Canny takes
    steep = contrast / np.sqrt(2 * np.pi) * scale * 0.7  # of a blurred step of that height; 0.7 since Canny's is 1 pixel wide, too
    edges = cv2.Canny((dx * scale).astype(np.int16), (dy * scale).astype(np.int16), _LOW * steep, steep, L2gradient=True)
    rows, columns = np.nonzero((edges > 0) & (used > 0))
    offset = _peak_offset(np.hypot(dx, dy), dx, dy, rows, columns)
    return Features.of(camera, np.stack((columns, rows), axis=-1) + offset, domain=used > 0)


def _peak_offset(slope: np.ndarray, dx: np.ndarray, dy: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return (n, 2): from pixels to where the slope is steepest across the edge, by a parabola through three places."""
    across = np.stack((dx[rows, columns], dy[rows, columns]), axis=-1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    places = np.stack((columns, rows), axis=-1).astype(np.float32)
    before, here, after = (_read(slope, places + step * across) for step in (-1, 0, 1))
    curvature = before - 2 * here + after
    offset = np.divide(0.5 * (before - after), curvature, out=np.zeros_like(here), where=curvature < -1e-9)
    return np.clip(offset, -0.5, 0.5)[:, None] * across


def _read(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the values (n,) of an image between its pixels, at (n, 2)."""
    u, v = np.clip(places, 0, np.array(image.shape[::-1]) - 1.001).T
    column, row = u.astype(int), v.astype(int)
    s, t = u - column, v - row
    top = image[row, column] * (1 - s) + image[row, column + 1] * s
    return top * (1 - t) + (image[row + 1, column] * (1 - s) + image[row + 1, column + 1] * s) * t
