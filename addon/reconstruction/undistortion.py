# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes and pictures of a real lens as an ideal pinhole would see them.

Volumetric methods project boxes and want their pictures straight. An ideal pixel's place in the real picture is given
by the forward model, which is exact; the model is inverted only for the size of the canvas, and for outlines.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from .geometry import Camera, distort

MAX_GROWTH = 2.0
_ROWS_AT_ONCE = 128
_DIRECTIONS, _RADII = 180, 1024
_SAME_PIXEL = 1e-2  # px; a lens is inverted where going back through it returns this near
_ITERATIONS = cv2.TermCriteria_COUNT + cv2.TermCriteria_EPS, 50, 1e-10


def undistorted_view(mask: np.ndarray, camera: Camera, *, conservative: bool,
                     outside: str = "unknown") -> tuple[np.ndarray, np.ndarray, Camera]:
    """Resample a silhouette into the picture of the same camera without distortion.

    The canvas covers the whole real picture, but at most `MAX_GROWTH` times its width and height about its middle: what
    an extreme lens sees beyond that is cropped. What lies beyond the canvas is what lies beyond the real picture; what
    lies on it and is not ``known`` must be treated as not seen by this camera, never as background.

    Parameters
    ----------
    mask : (height, width) bool array
        Of the camera's size.
    camera : Camera
    conservative : bool
        An ideal pixel is foreground if any real pixel that its square touches is, and known only if all of its square
        is. Otherwise the real pixel under the ideal pixel's centre decides.
    outside : {'unknown', 'empty'}
        What lies beyond the real picture. If unknown and conservative, its outermost pixels are left out as well: an
        object beyond the picture may reach into them and yet cover none of their centres (see
        `silhouettes.cover_partial_pixels`).

    Returns
    -------
    mask, known : (h, w) bool array
        ``mask`` is False where nothing is known.
    camera : Camera
        Without distortion, of size (w, h); R and t are the given camera's.

    Raises
    ------
    ValueError
        The mask has another size than the camera, or ``outside`` is neither.
    """
    width, height = camera.size
    if mask.shape != (height, width):
        raise ValueError(f"the mask is {mask.shape[1]}x{mask.shape[0]}, the camera {width}x{height}")
    if outside not in ("unknown", "empty"):
        raise ValueError(f"outside must be 'unknown' or 'empty', not {outside!r}")
    rim = 1 if conservative and outside == "unknown" else 0
    if min(camera.size) <= 2 * rim:
        nothing = np.zeros(mask.shape, bool)
        return nothing, nothing, _window(camera, 0, 0, width, height)
    if not camera.distorted:
        mask = mask[rim:height - rim, rim:width - rim]
        return mask, np.ones(mask.shape, bool), _window(camera, rim, rim, mask.shape[1], mask.shape[0])
    lens = _Lens(mask, camera, injective_radius(camera), rim, outside == "empty")
    ideal = _canvas(lens)
    sample = _touching if conservative else _nearest
    rows = [sample(lens, ideal, top, min(top + _ROWS_AT_ONCE, ideal.size[1]))
            for top in range(0, ideal.size[1], _ROWS_AT_ONCE)]
    return np.concatenate([row[0] for row in rows]), np.concatenate([row[1] for row in rows]), ideal


def _window(camera: Camera, left: int, top: int, width: int, height: int) -> Camera:
    """Return the camera without distortion whose pixel (0, 0) is the ideal pixel (left, top) of ``camera``."""
    shift = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]])
    return replace(camera, K=shift @ camera.K, size=(width, height), distortion=np.zeros(5))


@dataclass(frozen=True)
class _Lens:
    """One real picture: ``radius`` is that of `injective_radius`, ``rim`` the width of its untrusted border."""

    mask: np.ndarray
    camera: Camera
    radius: float
    rim: int
    empty_outside: bool

    @cached_property
    def table(self) -> np.ndarray:
        """The mask's summed-area table (h + 1, w + 1): four of its entries count a rectangle's foreground."""
        return cv2.integral(self.mask.astype(np.uint8))

    def real(self, ideal_K: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the real positions (..., 2) of ideal ones (..., 2), and whether the lens maps each to one place."""
        inverse = np.linalg.inv(ideal_K)
        rays = pixels @ inverse[:2, :2].T + inverse[:2, 2]
        valid = (rays ** 2).sum(axis=-1) <= self.radius ** 2
        rays = np.where(valid[..., None], rays, 0)  # far out the polynomial means nothing
        return distort(rays, self.camera.distortion) @ self.camera.K[:2, :2].T + self.camera.K[:2, 2], valid


def injective_radius(camera: Camera) -> float:
    """Return up to which radius, in normalised coordinates, the distortion of this camera's lens can be inverted.

    Beyond some radius the polynomial turns back and maps a second ray to the same pixel. The model is the gradient of
    a potential, so its Jacobian is symmetric; where that is positive definite on a convex set the map is injective
    there. The set is a disc about the axis, and the radius the least at which an eigenvalue is no longer positive.
    It is at most that of a canvas of `MAX_GROWTH`.
    """
    k1, k2, p1, p2, k3 = camera.distortion
    corners = np.array([[x, y, 1] for x in _limits(camera.size[0]) for y in _limits(camera.size[1])])
    furthest = np.linalg.norm((corners @ np.linalg.inv(camera.K).T)[:, :2], axis=1).max()
    r = np.linspace(0, furthest, _RADII)[:, None]
    angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    x, y = r * np.cos(angle), r * np.sin(angle)
    radial = 1 + r ** 2 * (k1 + r ** 2 * (k2 + r ** 2 * k3))
    slope = 2 * (k1 + r ** 2 * (2 * k2 + r ** 2 * 3 * k3))
    a = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    b = slope * x * y + 2 * p1 * x + 2 * p2 * y
    d = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    least = (a + d) / 2 - np.hypot((a - d) / 2, b)
    turned = (least <= 0).any(axis=1)
    return float(r[max(turned.argmax() - 2, 0), 0] if turned.any() else furthest)


def _limits(side: int) -> tuple[float, float]:
    middle = (side - 1) / 2
    return middle - MAX_GROWTH * side / 2, middle + MAX_GROWTH * side / 2


def _canvas(lens: _Lens) -> Camera:
    """Return the ideal camera whose picture covers what the real one shows."""
    x, y = (np.linspace(*_limits(side), 513) for side in lens.camera.size)
    real, inside = lens.real(lens.camera.K, np.stack(np.meshgrid(x, y), axis=-1))
    inside &= ((real >= -0.5) & (real <= np.array(lens.camera.size) - 0.5)).all(axis=-1)
    columns, rows = np.flatnonzero(inside.any(axis=0)), np.flatnonzero(inside.any(axis=1))
    if not len(columns):  # the axis meets no part of the picture where the lens can be inverted
        return _window(lens.camera, 0, 0, *lens.camera.size)
    across, down = 2 * (x[1] - x[0]), 2 * (y[1] - y[0])  # the picture's corners may lie between the samples
    left, top = int(x[columns[0]] - across), int(y[rows[0]] - down)
    right, bottom = int(x[columns[-1]] + across), int(y[rows[-1]] + down)
    return _window(lens.camera, left, top, right - left + 1, bottom - top + 1)


def _nearest(lens: _Lens, ideal: Camera, top: int, bottom: int) -> tuple[np.ndarray, np.ndarray]:
    pixels = np.stack(np.meshgrid(np.arange(ideal.size[0]), np.arange(top, bottom)), axis=-1)
    real, valid = lens.real(ideal.K, pixels)
    column, row = np.moveaxis(np.floor(real + 0.5).astype(np.int64), -1, 0)
    inside = valid & (column >= 0) & (row >= 0) & (column < lens.camera.size[0]) & (row < lens.camera.size[1])
    mask = lens.mask[np.where(inside, row, 0), np.where(inside, column, 0)] & inside
    return mask, valid if lens.empty_outside else inside


def _touching(lens: _Lens, ideal: Camera, top: int, bottom: int) -> tuple[np.ndarray, np.ndarray]:
    corners = np.stack(np.meshgrid(np.arange(ideal.size[0] + 1), np.arange(top, bottom + 1)), axis=-1) - 0.5
    real, valid = lens.real(ideal.K, corners)
    near, far = slice(None, -1), slice(1, None)
    quads = (near, near), (near, far), (far, near), (far, far)
    known = np.logical_and.reduce([valid[quad] for quad in quads])
    margin = curvature_margin(lens.camera, lens.radius)
    first = np.floor(np.minimum.reduce([real[quad] for quad in quads]) - margin + 0.5).astype(np.int64)
    last = np.floor(np.maximum.reduce([real[quad] for quad in quads]) + margin + 0.5).astype(np.int64)
    size = np.array(lens.camera.size)
    if not lens.empty_outside:
        known &= ((first >= lens.rim) & (last < size - lens.rim)).all(axis=-1)
    (x0, y0), (x1, y1) = np.moveaxis(np.clip(first, 0, size), -1, 0), np.moveaxis(np.clip(last + 1, 0, size), -1, 0)
    table = lens.table
    return (table[y1, x1] - table[y0, x1] - table[y1, x0] + table[y0, x0] > 0) & known, known


def curvature_margin(camera: Camera, radius: float) -> float:
    """Return by how much, in pixels, the image of an ideal pixel's square may bulge out of its corners' bounding box.

    On a unit square a function lies within ``(max|f_uu| + max|f_vv|) / 8`` of the bilinear interpolation of its
    corners. A term of the distortion that is homogeneous of degree n, and so at most ``c r^n``, has second derivatives
    of at most ``n (n - 1) c r^(n - 2)`` (Banach, 1938).
    """
    k1, k2, p1, p2, k3 = np.abs(camera.distortion)
    second = 6 * k1 * radius + 20 * k2 * radius ** 3 + 42 * k3 * radius ** 5 + 6 * (p1 + p2)
    linear = camera.K[:2, :2]
    return float(second * np.linalg.norm(linear, 2) * np.linalg.norm(np.linalg.inv(linear), 2) ** 2 / 4) + 1e-6


def undistort_pixels(pixels: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return the ideal positions (n, 2) of real pixels (n, 2), and whether the lens leads back from each to where it began."""
    linear, offset = camera.K[:2, :2], camera.K[:2, 2]
    real = (pixels - offset) @ np.linalg.inv(linear).T
    rays = cv2.undistortPointsIter(real[:, None], np.eye(3), camera.distortion, None, None, _ITERATIONS)[:, 0]
    with np.errstate(over="ignore", invalid="ignore"):
        missed = np.linalg.norm((distort(rays, camera.distortion) - real) @ linear.T, axis=1)
        inverted = (missed < _SAME_PIXEL) & (np.linalg.norm(rays, axis=1) <= injective_radius(camera))
    return np.where(inverted[:, None], rays, 0) @ linear.T + offset, inverted


def undistorted_camera(camera: Camera) -> Camera:
    """Return the camera without distortion whose picture shows as much as it can of the real one, and nothing beyond it.

    What is cropped at the border is as unknown as what lies beyond the real picture: no method takes it for background.

    Raises
    ------
    ValueError
        The distortion cannot be inverted at the picture's border, or leaves nothing of the picture.
    """
    width, height = camera.size
    x, y = np.arange(width, dtype=float), np.arange(height, dtype=float)
    sides = [np.column_stack(np.broadcast_arrays(*side)) for side in ((0.0, y), (width - 1.0, y), (x, 0.0), (x, height - 1.0))]
    found = [undistort_pixels(side, camera) for side in sides]
    if not all(inverted.all() for _, inverted in found):
        raise ValueError("the lens distortion cannot be inverted at the picture's border")
    (left, _), (right, _), (top, _), (bottom, _) = found
    first = np.ceil((left[:, 0].max(), top[:, 1].max())).astype(int)
    last = np.floor((right[:, 0].min(), bottom[:, 1].min())).astype(int)
    if (last < first).any():
        raise ValueError("the lens distortion leaves no rectangle of the picture")
    return _window(camera, *first, *(last - first + 1))


def resample(picture: np.ndarray, camera: Camera, ideal: Camera) -> np.ndarray:
    """Return a picture of ``camera`` as ``ideal``, the camera of `undistorted_camera`, sees it.

    Parameters
    ----------
    picture : (h, w) or (h, w, c) array
        Float is interpolated; of bool the pixel decides that is nearest.
    """
    inverse = np.linalg.inv(ideal.K)
    is_mask = picture.dtype == bool
    levels = picture.astype(np.uint8) if is_mask else picture
    parts = []
    for top in range(0, ideal.size[1], _ROWS_AT_ONCE):
        rows = np.arange(top, min(top + _ROWS_AT_ONCE, ideal.size[1]))
        pixels = np.stack(np.meshgrid(np.arange(ideal.size[0]), rows), axis=-1)
        rays = pixels @ inverse[:2, :2].T + inverse[:2, 2]
        real = distort(rays, camera.distortion) @ camera.K[:2, :2].T + camera.K[:2, 2]
        parts.append(cv2.remap(levels, real.astype(np.float32), None, cv2.INTER_NEAREST if is_mask else cv2.INTER_LINEAR,
                               borderMode=cv2.BORDER_REPLICATE))
    return np.concatenate(parts).astype(picture.dtype)
