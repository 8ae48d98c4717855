# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures show of voxels: the colours of a voxel's footprint in every view, with their spread.

A footprint is read as one pixel of a picture that is reduced until a voxel spans about `PIXELS_PER_VOXEL` of its pixels;
the spread is that of the pixels in a window about it. So a sample costs one projection and one gather. The pictures of all
views, cut to what they can show of the volume, lie in one array, and voxels are projected into all of them at once.

Pictures are premultiplied: a pixel that tells nothing, or that is taken out because something nearer has been found in it,
is zero in all four channels. Sums over views then need no masks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import cv2
import numpy as np

from ...progress import Progress, silent
from ..geometry import Camera, VoxelGrid
from ..scan import View
from ..undistortion import injective_radius
from .bounds import spread_order

PIXELS_PER_VOXEL = 2
WINDOW = 3  # pixels of the reduced picture; some 1.5 voxels
BORDER = 1  # pixels from a mask's outline in which background is mixed
HALF_DIAGONAL = 0.87  # of a voxel
PATCH = 5  # points along the side of a patch, a voxel apart
COLOR_BINS = 8  # a channel
OVERLAP = 0.1  # of a bin, into each of its neighbours
VIEWS_AT_ONCE = 3


@dataclass(frozen=True)
class Samples:
    """What v views show of n voxels.

    Parameters
    ----------
    rgba : (v, n, 4) float32 array
        The mean colour of the footprint, linear, and 1; all zero where the view does not see the voxel.
    variance : (v, n, 3) float32 array, optional
        Of the footprint's pixels within the view, a channel at a time. Zero where the view does not see the voxel.
    pixels : (v, n) float32 array, optional
        How many pixels that is.
    low, high : (v, n, 3) float32 array
        The least and the greatest of what is compared: ``rgba`` where a footprint is read as one sample.
    cells : (v, n, 8) uint64 array, optional
        The footprint's colours as a set of 8 x 8 x 8 bits: see `color_cells`.
    patches : (v, n, k) float32 array, optional
        Luminance at the points of a patch about the voxel, zero where the view does not see all of it.
    """

    rgba: np.ndarray
    low: np.ndarray
    high: np.ndarray
    variance: np.ndarray | None = None
    pixels: np.ndarray | None = None
    cells: np.ndarray | None = None
    patches: np.ndarray | None = None

    @cached_property
    def seen(self) -> np.ndarray:
        """Which views see which voxels: (v, n) bool."""
        return self.rgba[..., 3] > 0

    @cached_property
    def _total(self) -> np.ndarray:
        return self.rgba.sum(axis=0)

    @cached_property
    def views(self) -> np.ndarray:
        """How many views see each voxel: (n,) int."""
        return np.rint(self._total[:, 3]).astype(np.int32)

    @cached_property
    def colors(self) -> np.ndarray:
        """The (n, 3) means over the views that see a voxel; 0 where none does."""
        return self._total[:, :3] / np.maximum(self._total[:, 3:], 1)


@dataclass(frozen=True)
class Pictures:
    """The pictures of all views, ready to be sampled at voxels.

    Parameters
    ----------
    cameras : tuple of Camera
        Of the cut and reduced pictures, without distortion, in the object frame.
    matrices : (v, 3, 4) float32 array
        From voxel coordinates (voxel ``i`` spans ``[i, i + 1)``) to pixels; the integer part of a pixel coordinate is its
        column or row.
    offset : (v,) intp array
        Where each picture begins in ``rgba``.
    rgba : (p, 4) float32 array
        Rows of pixels, one picture after the other, each with a border of one empty pixel.
    outside : (p,) bool array
        The pixels in which a voxel's centre is seen only if no part of the voxel is inside the mask; none where that was
        not asked for.
    spread : (p, 4) float32 array, optional
        Variance within the window about each pixel in three channels, and how many pixels that window has.
    cells : (p, 8) uint64 array, optional
        The colours within the window about each pixel: see `color_cells`.
    """

    cameras: tuple[Camera, ...]
    matrices: np.ndarray
    offset: np.ndarray
    rgba: np.ndarray
    outside: np.ndarray
    spread: np.ndarray | None = None
    cells: np.ndarray | None = None

    @classmethod
    def of(cls, views: Sequence[View], grid: VoxelGrid, progress: Progress = silent, *, border: int = BORDER,
           background: bool = False, spread: bool = True, cells: bool = False) -> Pictures:
        """Read the pictures, one at a time.

        Parameters
        ----------
        views : sequence of View
            A view without a mask shows the object everywhere.
        grid : VoxelGrid
        progress : Progress
        border : int
            Pixels of the whole picture, inward from a mask's outline, that are left out.
        background : bool
            Whether to tell pixels that show background, which then are not cut off.
        spread, cells : bool
            Whether to collect variances, and sets of colours: 16 and 64 bytes a pixel.
        """
        cameras, pictures, spreads, outsides, sets = [], [], [], [], []
        for number, view in enumerate(views):
            progress(number / len(views), f"Reading the colours of view {view.name}")
            picture, outside, camera = prepared(view, grid, border=border, background=background)
            cameras.append(camera)
            pictures.append(picture.reshape(-1, 4))
            if spread:
                spreads.append(_spread(picture).reshape(-1, 4))
            outsides.append(outside.ravel())
            if cells:
                sets.append(_cells(picture).reshape(-1, COLOR_BINS))
        offset = np.cumsum([0] + [len(picture) for picture in pictures[:-1]])
        return cls(tuple(cameras), np.array([_from_voxels(camera, grid) for camera in cameras], np.float32), offset.astype(np.intp),
                   np.concatenate(pictures), np.concatenate(outsides), np.concatenate(spreads) if spread else None,
                   np.concatenate(sets) if cells else None)

    def subset(self, used: np.ndarray) -> Pictures:
        """Return the pictures of some views (v,) bool; rows are still those of all pictures."""
        cameras = tuple(camera for camera, use in zip(self.cameras, used, strict=True) if use)
        return replace(self, cameras=cameras, matrices=self.matrices[used], offset=self.offset[used])

    @cached_property
    def sizes(self) -> np.ndarray:
        """Widths and heights (v, 2)."""
        return np.array([camera.size for camera in self.cameras]).reshape(-1, 2)

    @cached_property
    def centres(self) -> np.ndarray:
        """The cameras' centres (v, 3) float32 in voxel coordinates."""
        matrices = self.matrices.astype(np.float64)
        return -np.linalg.solve(matrices[:, :, :3], matrices[:, :, 3:])[..., 0].astype(np.float32)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return columns and rows, whose integer part is the pixel, and depths of (n, 3) points: (v, n) float32 each.

        Points are in voxel coordinates. Columns and rows are NaN where the depth is not positive.
        """
        points = np.ascontiguousarray(points, np.float32)[None]
        local = np.empty((len(self.cameras), *points.shape[1:]), np.float32)
        for matrix, out in zip(self.matrices, local, strict=True) if points.size else ():
            cv2.transform(points, matrix, out[None])  # a hundredth of what BLAS takes for matrices so small
        x, y, depth = np.moveaxis(local, -1, 0)
        with np.errstate(divide="ignore"):
            inverse = np.where(depth > 0, 1 / depth, np.float32(np.nan))
        return x * inverse, y * inverse, depth

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Return in which row of ``rgba`` each view sees each of the (n, 3) points, in voxel coordinates: (v, n) intp.

        What lies beyond a picture or behind its camera is located in the picture's empty border.
        """
        return self.rows_at(*self.project(points)[:2])

    def rows_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the rows (v, n) of what `project` returns, as `locate` does."""
        limit = self.sizes[:, :, None].astype(np.float32) - 0.5
        # fmin and fmax turn NaN into a number: behind the camera is the corner of the border.
        column = np.fmax(np.fmin(x, limit[:, 0]), 0).astype(np.int32)
        row = np.fmax(np.fmin(y, limit[:, 1]), 0).astype(np.int32)
        return row * self.sizes[:, :1] + column + self.offset[:, None]

    def background(self, points: np.ndarray) -> np.ndarray:
        """Return (n,) bool: in the place of which of the (n, 3) points, in voxel coordinates, a view sees background."""
        found = np.zeros(len(points), bool)
        left = np.arange(len(points))
        # Few views rule most of the points out, those that look along other lines more of them.
        for group in range(0, len(self.cameras), VIEWS_AT_ONCE):
            used = np.zeros(len(self.cameras), bool)
            used[self.spread_order[group:group + VIEWS_AT_ONCE]] = True
            found[left] = self.outside.take(self.subset(used).locate(points[left])).any(axis=0)
            left = left[~found[left]]
        return found

    @cached_property
    def spread_order(self) -> list[int]:
        """The views in the order of `bounds.spread_order`."""
        return spread_order(self.cameras)

    def at(self, rows: np.ndarray, rgba: np.ndarray | None = None, *, spread: bool = True, cells: bool = False) -> Samples:
        """Return the samples in given rows (v, n), as `locate` returns them.

        Parameters
        ----------
        rows : (v, n) intp array
        rgba : (p, 4) float32 array, optional
            Read instead of ``self.rgba``: the same with some pixels zeroed.
        spread, cells : bool
            Whether the samples are to have variances and sets of colours.
        """
        found = gather(self.rgba if rgba is None else rgba, rows)
        samples = Samples(found, found[..., :3], found[..., :3])
        if spread:
            window = gather(self.spread, rows) * found[..., 3:]
            samples = replace(samples, variance=window[..., :3], pixels=window[..., 3])
        return replace(samples, cells=self.cells[rows] * (found[..., 3:] > 0)) if cells else samples

    def patches(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the luminance (v, n, k) at the points of square patches about (n, 3) points, across normals (n, 3) of any length.

        Points are in voxel coordinates. A patch that a view does not see all of is zero.
        """
        normals = np.where(normals.any(axis=1, keepdims=True), normals, [[0.0, 0.0, 1.0]])
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        aside = np.where(np.abs(normals[:, 2:]) < 0.8, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
        first = np.cross(normals, aside)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(normals, first)
        steps = np.arange(PATCH) - PATCH // 2
        read = [gather(self.rgba, self.locate(points + u * first + v * second)) for u in steps for v in steps]
        whole = np.logical_and.reduce([pixels[..., 3] > 0 for pixels in read])
        return np.stack([pixels[..., :3].mean(axis=2) for pixels in read], axis=2) * whole[..., None]


def gather(pixels: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return ``pixels[rows]`` for (p, 4) float32 pixels: (..., 4)."""
    # One element of 16 bytes is taken several times as fast as a row of four.
    return pixels.view(np.complex128)[:, 0].take(rows).view(np.float32).reshape(*rows.shape, 4)


def color_cells(rgb: np.ndarray) -> np.ndarray:
    """Return the cells of a histogram that colours fall into, as sets of bits: (..., 8) uint64 of (..., 3) linear colours.

    Each channel has `COLOR_BINS` bins over the square root of its value, in which photon noise is even. Bins reach into
    their neighbours, so that a colour near an edge is in both. Red chooses the word, green and blue the bit.
    """
    place = np.sqrt(np.clip(rgb, 0, 1)) * COLOR_BINS
    bins = np.arange(COLOR_BINS)
    inside = (place[..., None] > bins - OVERLAP) & (place[..., None] < bins + 1 + OVERLAP)
    inside[..., -1] |= place >= COLOR_BINS
    weights = np.uint64(1) << bins.astype(np.uint64)
    blue = (inside[..., 2, :] * weights).sum(axis=-1, dtype=np.uint64)
    bits = np.zeros_like(blue)
    for green in bins:
        bits |= np.where(inside[..., 1, green], blue << np.uint64(COLOR_BINS * green), np.uint64(0))
    return np.where(inside[..., 0, :], bits[..., None], np.uint64(0))


def prepared(view: View, grid: VoxelGrid, *, border: int = BORDER, background: bool = False) -> tuple[np.ndarray, np.ndarray, Camera]:
    """Return a view's picture (h, w, 4) without distortion, reduced, cut and with an empty border; and its camera.

    The fourth channel is 1 where the picture shows the object and nothing else, and the others are zero elsewhere. In
    between, for ``background``, is where it shows background: (h, w) bool.
    """
    image, camera = straightened(premultiplied(view, border=border), view.camera)
    corners = corners_of(grid)
    step = reduction(camera, corners, grid.voxel_size)
    image, camera = reduced(image, step), camera.scaled(1 / step)
    whole = image[..., 3] > 0.999
    image = np.where(whole[..., None], image / np.maximum(image[..., 3:], 1e-6), 0).astype(np.float32)
    outside = np.zeros_like(whole)
    if background and view.mask is not None:
        outside = _background(view, step, voxel=voxel_in_pixels(camera, corners, grid.voxel_size))
    left, top, right, bottom = _window(camera, corners, whole | outside)
    image, outside = (cv2.copyMakeBorder(array[top:bottom, left:right], 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0, 0, 0, 0))
                      for array in (image, outside.astype(np.uint8)))
    shift = np.array([[1, 0, 1 - left], [0, 1, 1 - top], [0, 0, 1]])
    return image, outside > 0, replace(camera, K=shift @ camera.K, size=image.shape[1::-1])


def premultiplied(view: View, *, border: int = 0) -> np.ndarray:
    """Return a view's picture (h, w, 4) with its mask as alpha, so that no mean takes in what lies outside the mask.

    The mask is made smaller by ``border`` pixels; beyond the picture's edge counts as object.
    """
    image = cv2.cvtColor(view.read_image().astype(np.float32, copy=False), cv2.COLOR_RGB2RGBA)
    if view.mask is None:
        return image
    mask = view.mask.astype(np.uint8)
    return cv2.copyTo(image, cv2.erode(mask, np.ones((2 * border + 1,) * 2, np.uint8)) if border else mask)


def straightened(image: np.ndarray, camera: Camera) -> tuple[np.ndarray, Camera]:
    """Return a premultiplied picture as the same camera without distortion sees it, and that camera.

    What the camera's lens model does not map to one place is left empty.
    """
    if not camera.distorted:
        return image, camera
    ideal = replace(camera, distortion=np.zeros(5))
    image = cv2.undistort(image, camera.K, camera.distortion, None, camera.K)
    width, height = camera.size
    x, y = np.meshgrid((np.arange(width) - camera.K[0, 2]) / camera.K[0, 0], (np.arange(height) - camera.K[1, 2]) / camera.K[1, 1])
    image[x * x + y * y > injective_radius(camera) ** 2] = 0
    return image, ideal


def corners_of(grid: VoxelGrid) -> np.ndarray:
    """Return the (8, 3) corners of a grid: what is nearest to a camera is one of them."""
    return grid.origin + np.array(list(product((0, 1), repeat=3))) * (grid.upper - grid.origin)


def reduction(camera: Camera, points: np.ndarray, voxel_size: float) -> int:
    """Return by how much a picture can be reduced and still have `PIXELS_PER_VOXEL`, for the nearest of the points."""
    return max(1, int(voxel_in_pixels(camera, points, voxel_size) / PIXELS_PER_VOXEL))


def voxel_in_pixels(camera: Camera, points: np.ndarray, voxel_size: float) -> float:
    """Return how many pixels a voxel spans at the nearest of the points, at most a whole picture."""
    depth = (points - camera.centre) @ camera.forward
    if not (depth > 0).any():
        return 1.0
    return float(min(np.sqrt(camera.K[0, 0] * camera.K[1, 1]) * voxel_size / depth[depth > 0].min(), *camera.size))


def _background(view: View, step: int, *, voxel: float) -> np.ndarray:
    """Return where the reduced picture shows background and no mask is within half a voxel's diagonal."""
    outside = reduced(straightened((~view.mask).astype(np.float32), view.camera)[0], step) > 0.999
    radius = int(np.ceil(HALF_DIAGONAL * voxel)) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
    return cv2.erode(outside.astype(np.uint8), disc, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0


def reduced(image: np.ndarray, step: int) -> np.ndarray:
    """Return means of step x step pixels, aligned as `Camera.scaled` has them."""
    if step == 1:
        return image
    height, width = image.shape[:2]
    image = cv2.copyMakeBorder(image, 0, -height % step, 0, -width % step, cv2.BORDER_REPLICATE)
    return cv2.resize(image, (image.shape[1] // step, image.shape[0] // step), interpolation=cv2.INTER_AREA)


def _window(camera: Camera, corners: np.ndarray, used: np.ndarray) -> tuple[int, int, int, int]:
    """Return left, top, right and bottom of the part of a picture that is used and may show the volume."""
    columns, rows = np.flatnonzero(used.any(axis=0)), np.flatnonzero(used.any(axis=1))
    if not len(columns):
        return 0, 0, 1, 1
    low, high = np.array([columns[0], rows[0]]), np.array([columns[-1], rows[-1]]) + 1
    pixels, depth = camera.project(corners)
    if (depth > 0).all():
        low = np.clip(np.floor(pixels.min(axis=0)).astype(int), low, high - 1)
        high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 1, low + 1, high)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _spread(picture: np.ndarray) -> np.ndarray:
    """Return (h, w, 4): variance in the window about each pixel, of those that show the object, and their number."""
    window = {"ksize": (WINDOW, WINDOW), "normalize": False, "borderType": cv2.BORDER_CONSTANT}
    total = cv2.boxFilter(picture, -1, **window)
    count = np.maximum(total[..., 3:], 1)
    square = cv2.boxFilter(picture[..., :3] ** 2, -1, **window) / count
    return np.concatenate((np.maximum(square - (total[..., :3] / count) ** 2, 0), total[..., 3:]), axis=-1)


def _cells(picture: np.ndarray) -> np.ndarray:
    """Return the colours within the window about each pixel of those that show the object: (h, w, 8) uint64."""
    cells = np.where(picture[..., 3:] > 0, color_cells(picture[..., :3]), np.uint64(0))
    for axis in (0, 1):  # the border is empty, so that what is rolled in from the other side is nothing
        cells = cells | np.roll(cells, 1, axis) | np.roll(cells, -1, axis)
    return cells


def _from_voxels(camera: Camera, grid: VoxelGrid) -> np.ndarray:
    """Return the (3, 4) matrix from voxel coordinates to pixels whose integer part is the column or row."""
    to_world = np.diag([grid.voxel_size] * 3 + [1.0])
    to_world[:3, 3] = grid.origin
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return half @ camera.P @ to_world
