# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which surface voxel each pixel of a camera sees: the item buffer (Culbertson, Malzbender & Slabaugh, 1999).

It is exact at the centres of pixels. A face lies in a plane across one of the grid's axes, so that the ray through a
pixel's centre meets it if and only if the ray's point in that plane falls into the face's cell: one division, two
multiplications and two comparisons of integers. A face is asked only of the pixels in the box round its projected
corners, so that the work is in proportion to the larger of the faces turned to the camera and the pixels they cover,
whatever the voxels measure in pixels. There are no cracks between faces, and a lens's distortion bends the rays, not
the faces.

What is left is the sampling: a voxel smaller than a pixel may fall between pixel centres, and an outline is known to
half a pixel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ..geometry import Camera, VoxelGrid, distort
from ..scan import View
from .surface import Surface

CANDIDATES = 1 << 18  # pairs of a face and a pixel worked on together: some 20 MB
FACES = 1 << 16
MAX_UNDISTORTION_ERROR = 0.01  # pixels
MARGIN = 2 * MAX_UNDISTORTION_ERROR
NOTHING = np.uint64(0xFFFFFFFFFFFFFFFF)


def item_buffer(surface: Surface, grid: VoxelGrid, camera: Camera, near: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Render the number of the surface voxel that each pixel sees.

    Parameters
    ----------
    surface : Surface
    grid : VoxelGrid
        The grid that the surface was extracted on.
    camera : Camera
        In the object frame. Faces that reach behind the camera's plane are left out.
    near : (height, width) bool array, optional
        Only faces whose first corner falls on one of these pixels are rendered.

    Returns
    -------
    items : (height, width) int32 array
        Rows of ``surface.voxels``, -1 where a pixel's centre sees none.
    depth : (height, width) float32 array
        Along the optical axis in the scene's unit, infinite where there is no item.
    """
    faces, depth = face_buffer(surface, grid, camera, near)
    items = surface.face_voxel.take(faces, mode="clip") if len(surface.face_voxel) else faces
    return np.where(faces < 0, np.int32(-1), items), depth


def face_buffer(surface: Surface, grid: VoxelGrid, camera: Camera, near: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Render the number of the face, a row of ``surface.quads``, that each pixel sees; as `item_buffer` else.

    Of faces at the same depth the one with the lowest number is seen.
    """
    width, height = camera.size
    # Positive floats are ordered as their bits are: depth above, face below make one number to take the least of.
    nearest = np.full(height * width, NOTHING)
    for pixel, depth, face in _hits(surface, grid, camera, near):
        key = depth.astype(np.float32).view(np.uint32).astype(np.uint64) << np.uint64(32) | face.astype(np.uint64)
        np.minimum.at(nearest, pixel, key)
    seen = nearest != NOTHING
    faces = np.where(seen, nearest & np.uint64(0xFFFFFFFF), np.uint64(0)).astype(np.int32)
    depth = (nearest >> np.uint64(32)).astype(np.uint32).view(np.float32)
    return (np.where(seen, faces, np.int32(-1)).reshape(height, width),
            np.where(seen, depth, np.float32(np.inf)).reshape(height, width))


def silhouette_of(surface: Surface, grid: VoxelGrid, camera: Camera) -> np.ndarray:
    """Return (height, width) bool: the pixels whose centres see the volume.

    For a volume in front of the camera this is the exact silhouette of its voxels, sampled at the pixels' centres: an
    outline is right to half a pixel.
    """
    width, height = camera.size
    cover = np.zeros(height * width, bool)
    for pixel, _, _ in _hits(surface, grid, camera):
        cover[pixel] = True
    return cover.reshape(height, width)


def reprojection_iou(surface: Surface, grid: VoxelGrid, view: View, *, scale: float = 1.0) -> float:
    """Return how well a volume agrees with a silhouette: intersection over union of the two in the picture.

    Parameters
    ----------
    surface : Surface
    grid : VoxelGrid
    view : View
        With a mask.
    scale : float
        At most 1. The comparison is made in a picture of this times the size: quicker, and coarser. Both outlines are
        right to half a pixel of that picture, so that equal shapes with an outline of p pixels and an area of a may
        still differ by some p / a.

    Returns
    -------
    float
        From 0 to 1; 1 if both are empty.

    Raises
    ------
    ValueError
        The view has no mask, or the scale is not between 0 and 1.
    """
    if view.mask is None:
        raise ValueError(f"view {view.name} has no mask")
    if not 0 < scale <= 1:
        raise ValueError(f"scale must be above 0 and at most 1, not {scale}")
    camera = view.camera.scaled(scale) if scale < 1 else view.camera
    mask = view.mask
    if scale < 1:
        # Camera.scaled keeps the outer edges of pixels; so must the mask, whatever whole size they are rounded up to.
        move = np.array([[scale, 0, (scale - 1) / 2], [0, scale, (scale - 1) / 2]])
        mask = cv2.warpAffine(mask.astype(np.uint8), move, camera.size, flags=cv2.INTER_NEAREST) > 0
    cover = silhouette_of(surface, grid, camera)
    union = np.count_nonzero(cover | mask)
    return float(np.count_nonzero(cover & mask) / union) if union else 1.0


@dataclass(frozen=True)
class _Rays:
    """The rays of a camera's pixel centres, in voxels from the grid's lower corner, with unit depth.

    ``x`` and ``y`` are the normalised image coordinates: of the columns (w,) and rows (h,), or for a camera with
    distortion of all pixels (h * w,) each. A pixel that the lens model never reaches has NaN.
    """

    R: np.ndarray
    x: np.ndarray
    y: np.ndarray
    skew: float
    width: int
    distorted: bool

    @classmethod
    def of(cls, camera: Camera) -> _Rays:
        width, height = camera.size
        K = camera.K
        y = (np.arange(height) - K[1, 2]) / K[1, 1]
        x = (np.arange(width) - K[0, 2]) / K[0, 0]
        skew = K[0, 1] / K[0, 0]
        if camera.distorted:
            # A rig's views differ in their poses, hardly ever in their lenses.
            x, y = _undistorted(tuple(camera.K.ravel()), tuple(camera.distortion), camera.size)
            skew = 0.0
        return cls(camera.R, x, y, skew, width, camera.distorted)

    def at(self, u: np.ndarray, v: np.ndarray, axis: int) -> np.ndarray:
        """Return the (n,) components of the rays along a world axis."""
        X, Y, Z = self.R[:, axis]
        if self.distorted:
            pixel = v * self.width + u
            return self.x.take(pixel) * X + self.y.take(pixel) * Y + Z
        return (self.x * X).take(u) + (self.y * (Y - self.skew * X) + Z).take(v)


def pixel_rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Return the (3, n) directions, with unit depth, of the rays through the centres of flat pixels (n,), the lens allowed for.

    A pixel that the lens model never reaches has NaN.
    """
    if camera.distorted:
        x, y = (values.take(pixels) for values in _undistorted(tuple(camera.K.ravel()), tuple(camera.distortion), camera.size))
        return camera.R.T @ np.stack((x, y, np.ones(len(pixels))))
    row, column = np.divmod(pixels, camera.size[0])
    return np.linalg.inv(camera.K @ camera.R) @ np.stack((column, row, np.ones(len(pixels))))


@lru_cache(maxsize=2)
def _undistorted(K: tuple, distortion: tuple, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the flat ideal image coordinates of all pixels; NaN where the lens model has no inverse."""
    K, distortion = np.array(K).reshape(3, 3), np.array(distortion)
    pixels = np.indices(size[::-1], np.float64)[::-1].reshape(2, -1).T.copy()
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-6)
    distorted = (pixels - K[:2, 2]) @ np.linalg.inv(K[:2, :2]).T
    ideal = cv2.undistortPointsIter(distorted[:, None], np.eye(3), distortion, None, None, criteria)[:, 0]
    off = (distort(ideal, distortion) - distorted) @ K[:2, :2].T
    ideal[~(np.abs(off).max(axis=1) < MAX_UNDISTORTION_ERROR)] = np.nan
    return ideal[:, 0].copy(), ideal[:, 1].copy()


def _hits(surface: Surface, grid: VoxelGrid, camera: Camera,
          near: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield where rays through pixel centres meet faces turned to the camera: flat pixel, depth, face; (n,) each."""
    if not len(surface.quads):
        return
    eye = (camera.centre - grid.origin) / grid.voxel_size
    rays = _Rays.of(camera)
    pixels = _projected(surface.vertices, camera)
    wanted = None if near is None else _on(near, pixels)
    for side in surface.sides:
        plane = side.cells[side.axis]
        turned = plane < eye[side.axis] if side.upper else plane > eye[side.axis]
        rows = np.flatnonzero(turned if wanted is None else turned & wanted.take(side.quads[0]))
        for start in range(0, len(rows), FACES):
            row = rows[start:start + FACES]
            face, cells = side.faces.take(row), side.cells.take(row, axis=1)
            for box, u, v in box_pixels(_boxes(pixels, side.quads.take(row, axis=1), camera)):
                hit, depth = _met(rays, eye, cells, side.axis, box, u, v)
                yield (v.take(hit) * camera.size[0] + u.take(hit), depth * grid.voxel_size, face.take(box.take(hit)))


def _met(rays: _Rays, eye: np.ndarray, cells: np.ndarray, axis: int,
         face: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which pairs of a face and a pixel meet, and how far from the camera; all in voxels.

    Of the faces' ``cells`` (3, n), the row ``axis`` is the plane that they lie in.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # a ray along the plane meets it nowhere: infinite or NaN
        depth = (cells[axis] - eye[axis]).take(face) / rays.at(u, v, axis)
        inside = [np.floor(depth * rays.at(u, v, side) + eye[side]) == cells[side].take(face)
                  for side in ((axis + 1) % 3, (axis + 2) % 3)]
    hit = np.flatnonzero(inside[0] & inside[1])
    return hit, depth.take(hit)


def _projected(vertices: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the (2, v) pixels of vertices; NaN behind the camera, so that a face with such a corner gets no box."""
    # A product of many 3-vectors is what BLAS is slowest at: OpenCV's takes a fiftieth of the time.
    x, y, depth = cv2.transform(vertices[:, None], np.column_stack((camera.R, camera.t)))[:, 0].T
    depth = np.where(depth > 0, depth, np.nan)
    x, y = x / depth, y / depth
    if camera.distorted:
        x, y = distort(np.stack((x, y), axis=-1), camera.distortion).T
    K = camera.K
    return np.stack((K[0, 0] * x + K[0, 1] * y + K[0, 2], K[1, 1] * y + K[1, 2]))


def _on(mask: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return (v,) bool: whether pixels (2, v) fall, rounded, on a mask."""
    height, width = mask.shape
    with np.errstate(invalid="ignore"):  # what NaN becomes is no matter: its faces have no boxes
        column, row = np.floor(pixels + 0.5).astype(np.int32).view(np.uint32)  # what is negative becomes large
    on = (column < width) & (row < height)
    inside = np.flatnonzero(on)
    on[inside] = mask.ravel().take(row.take(inside).astype(np.intp) * width + column.take(inside))
    return on


def _boxes(pixels: np.ndarray, quads: np.ndarray, camera: Camera) -> np.ndarray:
    """Return (4, n) int64: first column and row, number of columns and rows of the pixels that quads (4, n) may cover."""
    first, count, focal = [], [], min(camera.K[0, 0], camera.K[1, 1])
    for coordinate, size in zip(pixels, camera.size, strict=True):
        a, b, c, d = coordinate.take(quads)
        low, high = np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d))
        # An edge of length L bends by L^2 / 8 times its curvature, for a lens of the order of 1 / focal length.
        margin = MARGIN + (high - low) ** 2 / (2 * focal) if camera.distorted else 1e-6
        low, high = np.maximum(np.ceil(low - margin), 0), np.minimum(np.floor(high + margin), size - 1)
        covered = high >= low  # not so where a corner is NaN
        first.append(np.where(covered, low, 0))
        count.append(np.where(covered, high - low + 1, 0))
    return np.array(first + count).astype(np.int64)


def box_pixels(box: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the pixels of boxes (4, n) in bounded parts: number of the box, column u, row v; (m,) int64 each."""
    filled = np.flatnonzero(box[2] * box[3])
    u0, v0, columns, rows = box[:, filled]
    # Lines first, then pixels in them: two runs of np.repeat instead of a division for every pixel.
    line_box = np.repeat(np.arange(len(filled)), rows)
    line_v = v0.take(line_box) + _count_up(rows)
    ends = np.cumsum(columns.take(line_box))
    start = 0
    while start < len(ends):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + CANDIDATES, side="right")))
        line = line_box[start:stop]
        count = columns.take(line)
        u = np.repeat(u0.take(line), count) + _count_up(count)
        yield filled.take(np.repeat(line, count)), u, np.repeat(line_v[start:stop], count)
        start = stop


def _count_up(counts: np.ndarray) -> np.ndarray:
    """Return 0 .. n - 1 for each of the counts n, one after another."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - counts, counts)
