# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Space sweep: points in space by votes of edge elements, from any number of images at once (Collins, 1996).

A plane sweeps through the working volume. At each height every image's edge elements are carried onto it by a homography,
and each image gives one vote to the cells within reach of one of its elements. Cells with more votes than chance would
give to any cell at all, and more than the cells about them, are points. No image is a reference, nothing is matched
beforehand, and the work grows in proportion to the number of images.

There is no model of occlusion: what an object hides from many cameras has fewer votes to win by, and an edge along which
the cameras move votes at many heights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, part_of, silent
from ..geometry import Camera, VoxelGrid
from ..outcome import Outcome, VoxelLayer
from ..points import PointCloud
from ..scan import Scan
from .edge_features import Features, edge_features
from .volume import BRICK, SparseVolume

OPTIONS = (
    Option("contrast", 0.1, "Least step of brightness across an edge, as a share of white: fewer and surer edges with a larger one",
           minimum=0.005, maximum=1.0),
    Option("reach", 1.0, "How far an edge may lie from where a point would be seen, and still vote for it", unit=Unit.PIXELS,
           minimum=0.25, maximum=10.0),
    Option("accidents", 1.0, "How many cells may win by chance in the whole volume: decides how many votes a point needs",
           minimum=1e-6, maximum=1e6),
    Option("votes", 0, "How many votes a point needs; 0 for as many as chance demands", minimum=0, maximum=1000),
)

LAYER = "votes"
_HALF_CELL = 0.5  # of a cell's edge: how far from its centre a point of it may be
_AROUND = np.array([step for step in product((-2, -1, 0, 1, 2), repeat=3) if any(step)])


@dataclass(frozen=True)
class Swept:
    """The cells with enough votes.

    Parameters
    ----------
    cells : (n, 3) int32 array
    votes : (n,) uint16 array
    score : (n,) float32 array
        Votes weighted by how near the elements are: tells neighbours apart that have equally many.
    peak : (n,) bool array
        Whether no cell within two steps has a higher score.
    """

    cells: np.ndarray
    votes: np.ndarray
    score: np.ndarray
    peak: np.ndarray


def space_sweep(scan: Scan, grid: VoxelGrid, *, contrast: float = 0.1, reach: float = 1.0, accidents: float = 1.0, votes: int = 0,
                progress: Progress = silent) -> Outcome:
    """Find points of a scan's surfaces by sweeping a plane through the working volume.

    Parameters
    ----------
    scan : Scan
    grid : VoxelGrid
        Its layers along z are the planes, its voxels their cells.
    contrast, reach, accidents, votes
        See `OPTIONS`.
    progress : Progress

    Returns
    -------
    Outcome
        The points; the volume of the cells that hold them; and the layer ``votes`` of all cells with enough of them. Its report
        says how many were ``needed``, and the expected number of ``accidents``.

    Raises
    ------
    ScanstageError
        There are fewer than three views or than ``votes``, edges are so dense that chance could give any number of votes, or no
        cell has enough.
    """
    if len(scan.views) < 3:
        raise ScanstageError(f"the capture has {len(scan.views)} view(s): a space sweep tells points from chance by three or more; "
                             "capture more")
    if votes > len(scan.views):
        raise ScanstageError(f"option votes: {votes} are more than the {len(scan.views)} views can give")
    features = []
    for number, view in enumerate(scan.views):
        progress(0.3 * number / len(scan.views), f"Looking for edges in view {view.name}")
        features.append(edge_features(view, contrast=contrast))
    chances = [chance_of_a_vote(each, grid, reach) for each in features]
    needed = votes or votes_needed(chances, grid.count, accidents)
    expected = float(at_least(chances)[min(needed, len(chances) + 1)] * grid.count)
    if needed > len(features):
        raise ScanstageError(f"edges cover {100 * np.mean(chances):.0f} % of the pictures, so that all {len(features)} views may agree by "
                             "chance: keep fewer edges (--set contrast=...) or shorten their reach (--set reach=...)")
    swept = sweep_planes(features, grid, reach=reach, needed=needed, progress=part_of(progress, 0.3, 0.9))
    cells = swept.cells[swept.peak]
    if not len(cells):
        raise ScanstageError(f"no cell has {needed} votes: lower that (--set votes=...), keep more edges (--set contrast=...), or check "
                             "the poses")
    progress(0.9, "Placing the points")
    points = _points(scan, features, grid, swept, reach)
    layer = VoxelLayer(swept.cells, {"votes": swept.votes, "peak": swept.peak})
    counts = {"edges": sum(len(each.points) for each in features), "voted": len(swept.cells), "points": len(cells)}
    return Outcome(_volume_of(cells, grid), {"counts": counts, "needed": int(needed), "accidents": expected, "warnings": []},
                   layers={LAYER: layer}, points=points)


def chance_of_a_vote(features: Features, grid: VoxelGrid, reach: float) -> float:
    """Return the probability that an image votes for a cell that holds no point: the share of it that is near an element."""
    return features.coverage(_radius(features.camera, (grid.origin + grid.upper) / 2, grid.voxel_size, reach))


def at_least(chances: Sequence[float]) -> np.ndarray:
    """Return the probabilities (v + 2,) that at least 0, 1, ..., v + 1 of v independent events happen."""
    counts = np.ones(1)
    for chance in chances:
        counts = np.convolve(counts, (1 - chance, chance))
    return np.append(np.cumsum(counts[::-1])[::-1], 0.0)


def votes_needed(chances: Sequence[float], cells: int, accidents: float) -> int:
    """Return the least number of votes that so few cells have by chance; more than there are views if none will do."""
    return max(int(np.argmax(at_least(chances) * cells < accidents)), 1)


def sweep_planes(features: Sequence[Features], grid: VoxelGrid, *, reach: float, needed: int, progress: Progress = silent) -> Swept:
    """Return the cells that at least ``needed`` images vote for.

    Parameters
    ----------
    features : sequence of Features
    grid : VoxelGrid
    reach : float
        In pixels, beyond half of a cell's edge.
    needed : int
    progress : Progress
    """
    nx, ny, nz = grid.shape
    x, y = np.arange(nx, dtype=np.float32)[:, None], np.arange(ny, dtype=np.float32)[None]
    cells, count, score = [np.zeros((0, 3), np.int32)], [np.zeros(0, np.uint16)], [np.zeros(0, np.float32)]
    for z in range(nz):
        progress(z / nz, f"Sweeping plane {z + 1} of {nz}")
        votes, total = np.zeros((nx, ny), np.uint16), np.zeros((nx, ny), np.float32)
        for each in features:
            u, v, depth = (row[0] * x + row[1] * y + row[2] for row in _homography(each.camera, grid, z).astype(np.float32))
            depth[depth <= 0] = np.nan
            squared, _ = each.distances(u / depth, v / depth)
            nearness = 1 - squared / _radius_squared(each.camera, depth, grid.voxel_size, reach)
            voted = nearness >= 0  # not so where it is NaN: behind the camera
            votes += voted
            total += np.where(voted, nearness, 0)
        where = np.argwhere(votes >= needed)
        cells.append(np.column_stack((where, np.full(len(where), z))).astype(np.int32))
        count.append(votes[tuple(where.T)])
        score.append(total[tuple(where.T)])
    cells, count, score = (np.concatenate(parts) for parts in (cells, count, score))
    return Swept(cells, count, score, _peaks(cells, score, grid))


def _homography(camera: Camera, grid: VoxelGrid, z: int) -> np.ndarray:
    """Return the (3, 3) homography from cell indices of a plane to pixels: K [r1 r2 (z r3 + t)], in units of cells."""
    P, size = camera.P, grid.voxel_size
    corner = grid.centres((0, 0, z))
    return np.column_stack((P[:, 0] * size, P[:, 1] * size, P[:, :3] @ corner + P[:, 3]))


def _radius(camera: Camera, point: np.ndarray, voxel_size: float, reach: float) -> float:
    depth = camera.project(point)[1]
    return float(np.sqrt(_radius_squared(camera, depth, voxel_size, reach))) if depth > 0 else reach


def _radius_squared(camera: Camera, depth: np.ndarray, voxel_size: float, reach: float) -> np.ndarray:
    """Return the square of how far an element may be from a cell's centre, in pixels: Collins' neighbourhood, seen from the image."""
    return (reach + _HALF_CELL * voxel_size * np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / depth) ** 2


def _peaks(cells: np.ndarray, score: np.ndarray, grid: VoxelGrid) -> np.ndarray:
    """Return which cells have no other within two steps with a higher score; of equal ones the last."""
    shape = np.array(grid.shape) + 4
    keys = np.ravel_multi_index((cells + 2).T.astype(np.int64), shape)
    order = np.argsort(keys)
    keys, value = keys[order], score[order]
    peak = np.ones(len(keys), bool)
    for step in _AROUND @ np.array([shape[1] * shape[2], shape[2], 1]):
        place = np.minimum(np.searchsorted(keys, keys + step), max(len(keys) - 1, 0))
        there = keys[place] == keys + step if len(keys) else np.zeros(0, bool)
        peak &= ~there | (value > value[place]) | ((value == value[place]) & (step < 0))
    found = np.empty(len(keys), bool)
    found[order] = peak
    return found


def _volume_of(cells: np.ndarray, grid: VoxelGrid) -> SparseVolume:
    empty = SparseVolume(grid, np.full([-(-n // BRICK) for n in grid.shape], -1, np.int32), np.zeros((0, BRICK, BRICK, BRICK), bool))
    return empty.updated(cells, np.ones(len(cells), bool))


def _points(scan: Scan, features: Sequence[Features], grid: VoxelGrid, swept: Swept, reach: float) -> PointCloud:
    """Return a point for each peak: where the rays through the elements that voted for it meet, in the least-squares sense."""
    centres = grid.centres(swept.cells[swept.peak])
    n = len(centres)
    system, right, towards, color = np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    votes, first, size = np.zeros(n), np.full(n, len(features)), np.zeros(n)
    for number, (view, each) in enumerate(zip(scan.views, features, strict=True)):
        (u, v), depth = np.moveaxis(each.camera.project(centres)[0], -1, 0), each.camera.project(centres)[1]
        squared, row = each.distances(u.astype(np.float32), v.astype(np.float32))
        voted = np.flatnonzero((depth > 0) & (squared <= _radius_squared(each.camera, np.maximum(depth, 1e-12), grid.voxel_size, reach)))
        pixels = each.points[row[voted]]
        ray = each.camera.rays(pixels)
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        across = np.eye(3) - ray[:, :, None] * ray[:, None]
        system[voted] += across
        right[voted] += across @ each.camera.centre
        towards[voted] -= ray
        place = np.rint(view.camera.project(centres[voted])[0]).astype(int)
        column, line = np.clip(place, 0, np.array(view.camera.size) - 1).T
        color[voted] += view.read_image()[line, column]
        votes[voted] += 1
        size[voted] += depth[voted] / np.sqrt(each.camera.K[0, 0] * each.camera.K[1, 1])
        first[voted] = np.minimum(first[voted], number)
    found = np.linalg.solve(system, right[..., None])[..., 0]
    off = np.abs(found - centres).max(axis=1) > 2 * grid.voxel_size  # rays that are nearly parallel meet anywhere
    found[off] = centres[off]
    # Uniform errors within reach of each element, seen from rays at the angles of these: the least certain direction.
    sigma = 0.5 * reach * (size / votes) / np.sqrt(np.maximum(np.linalg.eigvalsh(system)[:, 0], 1e-6))
    normals = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    return PointCloud(found, normals, color / votes[:, None], sigma, first)
