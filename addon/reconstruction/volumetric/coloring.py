# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The colour of a volume's surface, from the pictures that really see it.

A view sees a surface voxel if nothing of the volume lies nearer in the item buffer's depth, about the voxel's pixel
and not only in it, since the picture is read between pixels. Each voxel keeps its best samples, judged by how large
its surface appears in the view; their colour is a mean of those that agree with the median. A picture that disagrees
with the others all over (a lamp that failed, a frame that was mixed up) is left out as a whole, for a voxel with two
samples could not tell which of them is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...progress import Progress, silent
from ..geometry import Camera, VoxelGrid
from ..scan import View
from .footprints import premultiplied, reduced, reduction
from .item_buffer import item_buffer
from .surface import Surface

NEUTRAL = 0.214  # linear; 0.5 in sRGB
SMOOTHING = 2  # of the normals by which views are weighted
LEAST_FACING = 0.1  # cosine; surfaces seen more obliquely are not read
STEEPEST = 4.0  # tangent up to which a slope's own depth is allowed for in the depth test
REACH = 2.0  # pixels from a voxel's point to the farthest pixel whose depth it is compared with
BORDER_WEIGHT = 1e-10  # of a sample that may be mixed with background
LEAST_SHARE = 1e-5  # of the best sample's weight, below which a sample is not used
TOLERANCE = 0.02  # linear colour by which samples may always differ
LEAST_SAMPLES = 20  # by which a view is judged
FILL_STEPS = 2
ROW = 4096
VOXELS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class SurfaceColors:
    """Colours of surface voxels.

    Parameters
    ----------
    rgb : (s, 3) float32 array
        Linear, one row for each row of ``Surface.voxels``.
    views : (s,) uint16 array
        How many views saw the voxel, those that were left out not counted. Where it is 0 the colour is that of the
        adjoining surface, or grey where that was not seen either.
    """

    rgb: np.ndarray
    views: np.ndarray


def color_surface(surface: Surface, grid: VoxelGrid, views: Sequence[View], progress: Progress = silent, *,
                  samples: int = 5, border: int = 2, bias: float = 1.5) -> SurfaceColors:
    """Colour the surface of a volume from the views that see it.

    Parameters
    ----------
    surface : Surface
    grid : VoxelGrid
        The grid that the surface was extracted on.
    views : sequence of View
        Their pictures are read one at a time.
    progress : Progress
    samples : int
        How many samples a voxel keeps, those in which it appears largest.
    border : int
        Pixels from a mask's outline within which a sample is used only if there is no other, because background is
        mixed in. A sample outside the mask is never used.
    bias : float
        Voxels by which a point may lie behind the nearest surface and still be seen.

    Returns
    -------
    SurfaceColors

    Raises
    ------
    ValueError
        ``samples`` is less than 1.
    """
    if samples < 1:
        raise ValueError(f"samples must be at least 1, not {samples}")
    patches = _Patches.of(surface, grid)
    best = _Best.empty(samples, len(surface.voxels))
    seen = []
    for number, view in enumerate(views):
        progress(number / len(views), f"Colouring from view {view.name}")
        rows, weight, rgb = _sample(patches, surface, grid, view, border=border, bias=bias * grid.voxel_size)
        best.add(rows, weight, rgb, number)
        seen.append(_as_bits(rows, len(surface.voxels)))
    rejected = best.reject(len(views))
    count = np.zeros(len(surface.voxels), np.uint16)
    for number, bits in enumerate(seen):
        if number not in rejected:
            count += np.unpackbits(bits, count=len(count))
    rgb = best.colors()
    del best  # what fills the gaps takes as much again
    progress(1.0, "Surface coloured")
    return SurfaceColors(filled(surface, rgb, count > 0).astype(np.float32), count)


def _as_bits(rows: np.ndarray, size: int) -> np.ndarray:
    flags = np.zeros(size, bool)
    flags[rows] = True
    return np.packbits(flags)


@dataclass(frozen=True)
class _Patches:
    """What is to be coloured: per surface voxel the mean point of its exposed faces and a smoothed normal, (s, 3).

    ``sheet`` (s,) is True where the normal is zero: a sheet of one voxel, which is seen from both sides.
    """

    points: np.ndarray
    normals: np.ndarray
    sheet: np.ndarray

    @classmethod
    def of(cls, surface: Surface, grid: VoxelGrid) -> _Patches:
        faces = np.bincount(surface.face_voxel, minlength=len(surface.voxels))[:, None]
        points = grid.centres(surface.voxels) + 0.5 * grid.voxel_size * surface.exposure() / faces
        normals = surface.normals(smoothing=SMOOTHING)
        return cls(points, normals, ~normals.any(axis=1))

    def facing(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows that are turned to a camera, and the cosines of the angles to their normals."""
        towards = camera.centre - self.points
        cosine = np.einsum("ij,ij->i", self.normals, towards) / np.sqrt(np.einsum("ij,ij->i", towards, towards))
        cosine[self.sheet] = 0.5
        rows = np.flatnonzero(cosine > LEAST_FACING)
        return rows, cosine[rows]


def _sample(patches: _Patches, surface: Surface, grid: VoxelGrid, view: View, *,
            border: int, bias: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rows that a view sees, with their weights and (n, 3) colours."""
    rows, cosine = patches.facing(view.camera)
    step = reduction(view.camera, patches.points[rows], grid.voxel_size)
    camera = view.camera.scaled(1 / step)
    (u, v), depth = (array.T for array in camera.project(patches.points[rows]))
    width, height = camera.size
    inside = np.flatnonzero((depth > 0) & (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5))
    rows, cosine, u, v, depth = (array.take(inside) for array in (rows, cosine, u, v, depth))

    pixel = np.rint(v).astype(np.intp) * width + np.rint(u).astype(np.intp)
    size = depth / np.sqrt(camera.K[0, 0] * camera.K[1, 1])  # of a pixel, at the voxel
    slope = np.minimum(np.sqrt(1 - np.minimum(cosine, 1) ** 2) / cosine, STEEPEST)
    nearest = cv2.erode(item_buffer(surface, grid, camera)[1], np.ones((3, 3), np.uint8))
    inner, outer = _allowed(view, border, step)
    seen = (depth - nearest.ravel().take(pixel) <= bias + REACH * slope * size) & outer.ravel().take(pixel)

    weight = (cosine / (size / step))[seen] ** 2  # in pixels of the whole picture, so that views compare
    weight[~inner.ravel().take(pixel[seen])] *= BORDER_WEIGHT
    return rows[seen], weight * grid.voxel_size ** 2, _bilinear(reduced(premultiplied(view), step), u[seen], v[seen])


def _allowed(view: View, border: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return where a reduced picture shows the object and nothing else, and where it shows it at all: bool each."""
    width, height = view.camera.size
    mask = np.ones((height, width), np.float32) if view.mask is None else view.mask.astype(np.float32)
    inner = cv2.erode(mask, np.ones((2 * border + 1,) * 2, np.uint8))  # beyond the picture counts as object
    # A sample between pixels reads the neighbours too: they must be as far from the outline.
    inner = cv2.erode((reduced(inner, step) > 0.999).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return inner, reduced(mask, step) >= 0.5


def _bilinear(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Read the colours (n, 3) of a premultiplied image between its pixels; beyond the outermost ones theirs hold."""
    if not len(u):
        return np.zeros((0, 3), np.float32)
    # OpenCV's maps may not be longer than 32767 along either side.
    count = -(-len(u) // ROW) * ROW
    maps = [np.resize(coordinate.astype(np.float32), count).reshape(-1, ROW) for coordinate in (u, v)]
    read = cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).reshape(-1, 4)[:len(u)]
    return read[:, :3] / np.maximum(read[:, 3:], 1e-6)


@dataclass(frozen=True)
class _Best:
    """Each voxel's samples of largest weight: ``weight`` (k, s), 0 for none; ``rgb`` (k, s, 3); ``view`` (k, s)."""

    weight: np.ndarray
    rgb: np.ndarray
    view: np.ndarray

    @classmethod
    def empty(cls, samples: int, size: int) -> _Best:
        return cls(np.zeros((samples, size), np.float32), np.zeros((samples, size, 3), np.float32),
                   np.zeros((samples, size), np.int32))

    def add(self, rows: np.ndarray, weight: np.ndarray, rgb: np.ndarray, view: int) -> None:
        """Put one view's samples in the place of lesser ones."""
        present = self.weight[:, rows]
        slot = present.argmin(axis=0)
        better = np.flatnonzero(weight > present[slot, np.arange(len(rows))])
        place = slot[better], rows[better]
        self.weight[place], self.rgb[place], self.view[place] = weight[better], rgb[better], view

    def reject(self, views: int) -> set[int]:
        """Remove the samples of views that disagree with the others all over; return the numbers of those views."""
        residuals, seen_by = [], []
        for part in self._parts():
            used = part._used()
            used[:, used.sum(axis=0) < 3] = False
            residuals.append(np.abs(part.rgb - part._median(used)).max(axis=2)[used])
            seen_by.append(part.view[used])
        residual, view = np.concatenate(residuals), np.concatenate(seen_by)
        order = np.argsort(view, kind="stable")
        typical = np.full(views, np.nan)
        for number, own in enumerate(np.split(residual[order], np.searchsorted(view[order], np.arange(1, views)))):
            if len(own) >= LEAST_SAMPLES:
                typical[number] = np.median(own)
        judged = np.flatnonzero(~np.isnan(typical))
        if len(judged) < 3:
            return set()
        bad = judged[typical[judged] > 3 * np.median(typical[judged]) + TOLERANCE]
        if 3 * len(bad) > len(judged):
            return set()  # no majority is left that could be right
        self.weight[np.isin(self.view, bad)] = 0
        return set(bad.tolist())

    def colors(self) -> np.ndarray:
        """Return the (s, 3) weighted means of the samples near the median; 0 where there is no sample."""
        return np.concatenate([part._means() for part in self._parts()])

    def _parts(self) -> Iterator[_Best]:
        """Yield the samples of some voxels after the other: what is worked out of them takes many times their memory."""
        for start in range(0, max(1, self.weight.shape[1]), VOXELS_AT_ONCE):
            part = slice(start, start + VOXELS_AT_ONCE)
            yield _Best(self.weight[:, part], self.rgb[:, part], self.view[:, part])

    def _means(self) -> np.ndarray:
        used = self._used()
        residual = np.abs(self.rgb - self._median(used)).max(axis=2)
        spread = _median_of(residual[..., None], used)[:, 0]
        weight = np.where(used & (residual <= 2.5 * spread + TOLERANCE), self.weight, 0)
        total = weight.sum(axis=0)
        rgb = np.einsum("ks,ksc->sc", weight, self.rgb)
        return np.divide(rgb, total[:, None], out=np.zeros_like(rgb), where=total[:, None] > 0)

    def _used(self) -> np.ndarray:
        return (self.weight > 0) & (self.weight >= LEAST_SHARE * self.weight.max(axis=0))

    def _median(self, used: np.ndarray) -> np.ndarray:
        return _median_of(self.rgb, used)


def _median_of(values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return (s, c) medians over the first axis of ``values`` (k, s, c) where ``used`` (k, s); 0 where none is."""
    count = used.sum(axis=0)
    ordered = np.sort(np.where(used[..., None], values, np.inf), axis=0)
    middle = [np.take_along_axis(ordered, place[None, :, None], axis=0)[0]
              for place in (np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(values) - 1))]
    return np.where(count[:, None] > 0, 0.5 * (middle[0] + middle[1]), 0)


def filled(surface: Surface, rgb: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Give unseen voxels the mean colour of the seen surface they adjoin, a few steps deep; grey to the others.

    Steps go along the surface, from one voxel to those it shares a vertex with, so that no colour jumps across a gap.
    Farther in nothing is known, and grey says so.
    """
    known = np.column_stack((rgb, np.ones(len(rgb)))) * seen[:, None]
    for _ in range(FILL_STEPS):
        missing = known[:, 3] == 0
        if not missing.any():
            break
        spread = surface.spread(known)
        near = missing & (spread[:, 3] > 0)
        known[near] = spread[near] / spread[near, 3:]
    return np.where(known[:, 3:] > 0, known[:, :3], NEUTRAL)
