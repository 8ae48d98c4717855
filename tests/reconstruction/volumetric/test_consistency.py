# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photo-consistency measures: by their definitions, by what they promise, and by how well they tell a surface from thin air."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric.carving import Carving
from addon.reconstruction.volumetric.consistency import MEASURES, Judge, Monotone
from addon.reconstruction.volumetric.footprints import Pictures, Samples, color_cells
from addon.reconstruction.volumetric.generalized_voxel_coloring import samples_of
from addon.reconstruction.volumetric.sight import Sight
from addon.reconstruction.volumetric.volume import SparseVolume
from tests.rigs import Ball, marbled, painted_views, ring

NOISE = 0.02
BALL = Ball((0.0, 0.0, 0.0), 0.6)
GRID = VoxelGrid((-0.8, -0.8, -0.8), 1.6 / 64, (64, 64, 64))
OFF = 3  # voxels


def random_samples(views=6, voxels=40, pixels=9, seed=5, spread=0.2):
    """Return samples and the pixels (v, n, k, 3) that they summarise; some views do not see some voxels."""
    random = np.random.default_rng(seed)
    colors = np.clip(0.5 + spread * random.standard_normal((views, voxels, pixels, 3)), 0, 1)
    seen = random.random((views, voxels)) < 0.7
    seen[:2] = True
    rgba = np.concatenate((colors.mean(2), np.ones((views, voxels, 1))), -1) * seen[..., None]
    cells = np.bitwise_or.reduce(color_cells(colors), axis=2) * seen[..., None]
    samples = Samples(rgba.astype(np.float32), colors.min(2), colors.max(2), colors.var(2) * seen[..., None], pixels * seen, cells,
                      colors.mean(3) * seen[..., None])
    return samples, colors, seen


def by_voxel(samples, colors, seen):
    return [colors[seen[:, voxel], voxel] for voxel in range(colors.shape[1])]


def test_deviation_and_adaptive_are_those_of_all_pixels():
    samples, colors, seen = random_samples()
    pooled = [np.sqrt(own.reshape(-1, 3).var(0).mean()) for own in by_voxel(samples, colors, seen)]
    within = [np.sqrt(own.var(1).mean(-1)).mean() for own in by_voxel(samples, colors, seen)]
    np.testing.assert_allclose(MEASURES["deviation"].scores(samples, NOISE), pooled, atol=1e-5)
    np.testing.assert_allclose(MEASURES["adaptive"].scores(samples, NOISE), np.array(pooled) - 2 * np.array(within), atol=1e-5)


def test_pairwise_is_the_greatest_distance_of_two_pixels():
    samples, colors, seen = random_samples()
    expected = [np.abs(own.reshape(-1, 1, 3) - own.reshape(1, -1, 3)).max() for own in by_voxel(samples, colors, seen)]
    np.testing.assert_allclose(MEASURES["pairwise"].scores(samples, NOISE), expected, atol=1e-6)


def test_correlation_is_the_mean_over_pairs_of_views():
    samples, colors, seen = random_samples(pixels=25)
    expected = []
    for own in by_voxel(samples, colors, seen):
        matrix = np.corrcoef(own.mean(2))
        expected.append(1 - matrix[np.triu_indices(len(own), 1)].mean())
    np.testing.assert_allclose(MEASURES["ncc"].scores(samples, NOISE), expected, atol=1e-5)
    flat = replace(samples, patches=np.full_like(samples.patches, 0.3))
    assert not MEASURES["ncc"].scores(flat, NOISE).any()


def test_histogram_is_the_share_of_pairs_without_a_common_cell():
    samples, colors, seen = random_samples(pixels=2)
    expected = []
    for own in by_voxel(samples, colors, seen):
        sets = [{(word, bit) for pixel in color_cells(view) for word in range(8) for bit in range(64) if int(pixel[word]) >> bit & 1}
                for view in own]
        pairs = [(a, b) for i, a in enumerate(sets) for b in sets[:i]]
        expected.append(np.mean([not a & b for a, b in pairs]))
    np.testing.assert_allclose(MEASURES["histogram"].scores(samples, NOISE), expected)
    assert 0 < np.mean(expected) < 1


def test_cells_are_bins_of_the_square_root_that_overlap():
    # 0.25 is the square of 4 / 8, the edge of two bins; (5.5 / 8)^2 the middle of the sixth
    edge, middle = 0.25, (5.5 / 8) ** 2
    cells = color_cells(np.array([edge, middle, middle]))
    assert np.flatnonzero(cells).tolist() == [3, 4]
    assert int(cells[3]) == int(cells[4]) == 1 << (8 * 5 + 5)
    assert np.flatnonzero(color_cells(np.array([9.0, 0.0, 0.0]))).tolist() == [7]  # brighter than white is white


@pytest.mark.parametrize("name", ["chi-square", "likelihood"])
def test_scores_of_noise_alone_are_standard_normal(name):
    random = np.random.default_rng(8)
    pixels = 0.5 + NOISE * random.standard_normal((7, 4000, 20, 3))
    rgba = np.concatenate((pixels.mean(2), np.ones((7, 4000, 1))), -1).astype(np.float32)
    # the sensor's noise in the mean of 20 pixels is that much less
    samples = Samples(rgba, rgba[..., :3], rgba[..., :3], pixels.var(2), np.full((7, 4000), 20.0))
    scores = MEASURES[name].scores(samples, NOISE / np.sqrt(20) if name == "chi-square" else 1e-4)
    # Wilson's and Hilferty's roots are right to a hundredth; the ratio's own approximation errs by about p / n, some 0.1
    assert abs(scores.mean()) < 0.15 and abs(scores.std() - 1) < 0.05


@pytest.mark.parametrize("name", [name for name, measure in MEASURES.items() if measure.monotone is not Monotone.NOT])
def test_more_views_never_mend_what_a_monotone_measure_refuses(name):
    samples, _, _ = random_samples(views=8, pixels=3, spread=0.15)
    full = MEASURES[name].scores(samples, NOISE)
    fewer = np.where(np.arange(8)[:, None] < 4, 1, 0)

    def part(array):
        return array * fewer.reshape(8, 1, *[1] * (array.ndim - 2)).astype(array.dtype)

    few = MEASURES[name].scores(replace(samples, rgba=part(samples.rgba), cells=part(samples.cells)), NOISE)
    threshold = MEASURES[name].threshold
    assert ((few > threshold) <= (full > threshold)).all() and (few > threshold).any()


def test_too_few_views_are_no_reason_to_refuse():
    samples, _, seen = random_samples()
    judge = Judge.of(consistency="deviation", threshold=1e-6, noise=NOISE, min_views=5)
    assert np.array_equal(judge.refuses(samples), seen.sum(0) >= 5)


@cache
def scene(texture):
    views = painted_views(ring(16, elevation=30, focal=430, size=(260, 230)) + ring(8, elevation=60, focal=430, size=(260, 230)),
                          [BALL], marbled if texture == "marbled" else checkered)
    return Pictures.of(views, GRID, cells=True)


def checkered(points):
    """Black and white in squares of a sixth of a unit."""
    return np.repeat(np.where(np.floor(points * 6).sum(-1) % 2 == 0, 0.05, 0.85)[:, None], 3, axis=1)


@cache
def sight_of(texture, outward):
    """Return what views of a textured ball see of a ball that is some voxels larger."""
    centres = GRID.centres(np.stack(np.indices(GRID.shape), -1))
    occupancy = Ball(BALL.centre, BALL.radius + outward * GRID.voxel_size).contains(centres)
    return Sight(scene(texture), Carving(SparseVolume.from_dense(GRID, occupancy)))


def scores_at(name, texture, outward):
    """Return centres and scores of the larger ball's voxels that at least five views see."""
    sight = sight_of(texture, outward)
    keys = sight.seen()
    samples = samples_of(sight, keys, Judge.of(consistency=name, threshold=0.0, noise=NOISE, min_views=2))
    enough = samples.views >= 5
    return GRID.centres(sight.carving.voxels(keys))[enough], MEASURES[name].scores(samples, NOISE)[enough]


def area_under_curve(good, bad):
    """Return the chance that a bad one scores above a good one, ties counted half (Mann & Whitney, 1947)."""
    good = np.sort(good)
    return (np.searchsorted(good, bad) + np.searchsorted(good, bad, side="right")).mean() / (2 * len(good))


@pytest.mark.parametrize("name", MEASURES)
def test_texture_tells_a_surface_from_three_voxels_off_it(name):
    assert area_under_curve(scores_at(name, "marbled", 0)[1], scores_at(name, "marbled", OFF)[1]) >= 0.95


@pytest.mark.parametrize("name", ["adaptive", "histogram"])
def test_edges_of_black_and_white_are_no_inconsistency(name):
    def across(scored):
        points, scores = scored
        place = points / np.linalg.norm(points, axis=1, keepdims=True) * BALL.radius * 6
        return scores[(np.abs(place - np.rint(place)) / 6 < 1.5 * GRID.voxel_size).any(1)]

    assert area_under_curve(across(scores_at(name, "checkered", 0)), across(scores_at(name, "checkered", OFF))) >= 0.8
