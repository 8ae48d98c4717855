# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points are found where many pictures agree, and nowhere else."""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.scan import Scan, View
from addon.reconstruction.volumetric.edge_features import Features, edge_features
from addon.reconstruction.volumetric.space_sweep import LAYER, at_least, chance_of_a_vote, space_sweep, sweep_planes, votes_needed
from tests.rigs import Ball, black_picture, camera_at, painted_views, ring

GRID = VoxelGrid.from_bounds((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8), 160)
REACH = 1.0  # px: two standard deviations of the noise
RIG = [camera_at(4 * np.array([np.cos(a) * 0.7, np.sin(a) * 0.7, 0.7]), focal=900, size=(640, 480)) for a in np.linspace(0, 2 * np.pi, 8)[:7]]


def strewn(seed):
    """Return 500 points, at least three cells apart, and what seven cameras see of them: with 0.5 px of noise and 20 % clutter."""
    rng = np.random.default_rng(seed)
    points = np.zeros((0, 3))
    while len(points) < 500:
        point = rng.uniform(-0.7, 0.7, 3)
        if not len(points) or np.linalg.norm(points - point, axis=1).min() > 3 * GRID.voxel_size:
            points = np.vstack((points, point))
    features = []
    for camera in RIG:
        pixels = camera.project(points)[0] + 0.5 * rng.standard_normal((500, 2))
        clutter = rng.uniform(-0.5, np.array(camera.size) - 0.5, (100, 2))
        features.append(Features.of(camera, np.vstack((pixels, clutter))))
    return points, features


def test_points_among_clutter_are_found_and_nothing_else():
    points, features = strewn(3)
    chances = [chance_of_a_vote(each, GRID, REACH) for each in features]
    needed = votes_needed(chances, GRID.count, 1.0)
    assert 5 <= needed < 7
    swept = sweep_planes(features, GRID, reach=REACH, needed=needed)
    found = GRID.centres(swept.cells[swept.peak])
    distance = np.linalg.norm(points[:, None] - found, axis=2)
    nearest = distance.argmin(axis=1)
    off = np.abs(found[nearest] - points)
    hit = (off <= 1.5 * GRID.voxel_size).all(axis=1)
    assert hit.mean() >= 0.95
    assert (off[hit, 2] <= GRID.voxel_size).mean() >= 0.95  # the peak is within one plane's distance
    assert (distance.min(axis=0) <= 2 * GRID.voxel_size).mean() >= 0.95
    # Two peaks about one point would not be seen by either measure.
    assert len(found) <= 1.05 * 500


def test_votes_are_those_of_brute_force():
    grid = VoxelGrid((-0.3, -0.25, -0.2), 0.1, (6, 5, 4))
    rng = np.random.default_rng(4)
    cameras = [camera_at(4 * np.array([np.cos(a), np.sin(a), 0.5]), focal=60, size=(80, 60)) for a in (0.2, 1.9, 4.0)]
    features = [Features.of(camera, rng.uniform(30, 50, (25, 2)) * (1, 0.75)) for camera in cameras]
    swept = sweep_planes(features, grid, reach=1.0, needed=1)
    votes = np.zeros(grid.shape, int)
    for cell in product(*map(range, grid.shape)):
        for each in features:
            pixel, depth = each.camera.project(grid.centres(cell))
            radius = 1.0 + 0.5 * grid.voxel_size * 60 / depth
            near = each.points[each.nearest[tuple(np.rint(pixel[::-1]).astype(int))]]
            votes[cell] += ((near - pixel) ** 2).sum() <= radius ** 2
    assert len(swept.cells) == np.count_nonzero(votes) > 20
    np.testing.assert_array_equal(swept.votes, votes[tuple(swept.cells.T)])


def test_the_nearest_feature_is_the_nearest():
    rng = np.random.default_rng(6)
    points = rng.uniform(0, 59, (40, 2))
    features = Features.of(camera_at((0, -4, 0), size=(60, 60)), points)
    u, v = rng.uniform(0, 59, (2, 500)).astype(np.float32)
    squared, row = features.distances(u, v)
    exact = np.hypot(u[:, None] - points[:, 0], v[:, None] - points[:, 1]).min(axis=1)
    # The distance transform goes by pixels, and by a mask of five: within a pixel and a half of the truth.
    assert (np.sqrt(squared) - exact).min() > -1e-4 and (np.sqrt(squared) - exact).max() < 1.5
    assert (row >= 0).all()
    assert np.isinf(features.distances(np.array([-3.0], np.float32), np.array([5.0], np.float32))[0]).all()


def test_the_chance_of_votes_is_that_of_coins():
    np.testing.assert_allclose(at_least([0.5] * 4), np.array([16, 15, 11, 5, 1, 0]) / 16)
    chances = [0.1, 0.35, 0.2]
    counts = np.zeros(4)
    for state in product((0, 1), repeat=3):
        counts[sum(state)] += np.prod([c if s else 1 - c for c, s in zip(chances, state, strict=True)])
    np.testing.assert_allclose(at_least(chances)[:4], np.cumsum(counts[::-1])[::-1])
    assert votes_needed([0.5] * 4, 16, 1.5) == 4 and votes_needed([0.5] * 4, 16, 0.5) == 5  # more than there are


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.3])
def test_edges_are_found_to_a_fraction_of_a_pixel(angle):
    camera = camera_at((0, -4, 0), size=(120, 100))
    columns, rows = np.meshgrid(np.arange(120.0), np.arange(100.0))
    signed = (columns - 60.3) * np.cos(angle) + (rows - 48.7) * np.sin(angle)
    bright = np.clip(signed + 0.5, 0, 1)  # the share of a pixel beyond a straight edge, near enough
    srgb = 0.3 + 0.4 * bright
    linear = np.where(srgb > 0.04045, ((srgb + 0.055) / 1.055) ** 2.4, srgb / 12.92)
    picture = np.repeat(linear[..., None], 3, axis=2).astype(np.float32)
    found = edge_features(View("a", camera, None, lambda: picture), contrast=0.2)
    off = (found.points[:, 0] - 60.3) * np.cos(angle) + (found.points[:, 1] - 48.7) * np.sin(angle)
    assert len(found.points) > 80
    assert np.abs(off).max() < 0.25
    assert not len(edge_features(View("a", camera, None, lambda: picture), contrast=0.8).points)


def spotted(points):
    """Return dark spots on a light surface."""
    rng = np.random.default_rng(9)
    spots = rng.standard_normal((60, 3))
    spots *= 0.6 / np.linalg.norm(spots, axis=1, keepdims=True)
    near = np.min([((points - spot) ** 2).sum(axis=-1) for spot in spots], axis=0)
    return np.where(near < 0.03 ** 2, 0.1, 0.7)[:, None] * np.ones(3)


def test_a_spotted_ball_is_found_on_its_surface():
    cameras = ring(9, elevation=60, distance=4.0, focal=900, size=(640, 480))
    scan = Scan(tuple(painted_views(cameras, [Ball((0, 0, 0), 0.6)], spotted)))
    grid = VoxelGrid.from_bounds((-0.7, -0.7, -0.7), (0.7, 0.7, 0.7), 96)
    found = space_sweep(scan, grid, contrast=0.2)
    radius = np.linalg.norm(found.points.positions, axis=1)
    # Nine views all see the top only, where some 12 of the spots are; chance asks for seven of them.
    assert len(found.points) > 15 and (found.points.positions[:, 2] > 0).all()
    assert np.median(np.abs(radius - 0.6)) < 0.25 * grid.voxel_size
    assert np.mean(np.abs(radius - 0.6) < 2 * grid.voxel_size) > 0.8
    facing = np.einsum("ij,ij->i", found.points.normals, found.points.positions) / radius
    assert (facing > 0).mean() > 0.9
    assert found.report["accidents"] < 1 and found.report["counts"]["points"] == found.volume.count() == len(found.points)
    layer = found.layers[LAYER]
    assert (layer.values["votes"] >= found.report["needed"]).all()
    np.testing.assert_array_equal(np.sort(np.ravel_multi_index(layer.voxels[layer.values["peak"]].T, grid.shape)),
                                  np.flatnonzero(found.volume.dense()))


@pytest.mark.parametrize(("options", "message"), [
    ({"reach": 10.0, "contrast": 0.01}, "agree by chance: keep fewer edges"),
    ({"votes": 10}, "option votes: 10 are more than the 5 views"),
    ({"contrast": 1.0}, r"no cell has \d+ votes"),
])
def test_what_cannot_be_told_from_chance_is_refused(options, message):
    rng = np.random.default_rng(1)
    noise = cv2.resize(rng.random((20, 30, 3)).astype(np.float32), (160, 120), interpolation=cv2.INTER_NEAREST)
    views = tuple(View(str(i), camera, None, lambda: noise) for i, camera in enumerate(ring(5, size=(160, 120), focal=200)))
    with pytest.raises(ScanstageError, match=message):
        space_sweep(Scan(views), VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 24), **options)


def test_two_views_are_refused():
    views = tuple(replace(View(str(i), camera, None, black_picture)) for i, camera in enumerate(ring(2)))
    with pytest.raises(ScanstageError, match="three or more"):
        space_sweep(Scan(views), GRID)
