# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures of results whose errors are known."""

import json

import numpy as np
import pytest

from addon.errors import Cancelled, ScanstageError
from addon.reconstruction.evaluation import evaluate, inside, surface_measures, touched, volume_measures
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.mesh import TriangleMesh
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume

GRID = VoxelGrid((0, 0, 0), 0.1, (20, 20, 20))
NOTHING = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), int))


def block(lower: tuple[int, int, int], upper: tuple[int, int, int], grid: VoxelGrid = GRID) -> SparseVolume:
    dense = np.zeros(grid.shape, bool)
    dense[tuple(slice(a, b) for a, b in zip(lower, upper, strict=True))] = True
    return SparseVolume.from_dense(grid, dense)


def test_blocks_overlap_as_arithmetic_says(shapes):
    truth = shapes.box((0.2, 0.2, 0.2), (1.2, 1.2, 1.2))  # voxels 2 to 11
    measures = volume_measures(block((2, 2, 4), (12, 12, 15)), truth)
    assert measures == {"result": pytest.approx(1.1), "truth": pytest.approx(1.0), "excess": pytest.approx(0.3),
                        "loss": pytest.approx(0.2), "iou": pytest.approx(0.8 / 1.3), "truth_voxels_removed": 200}


def test_the_truth_itself_loses_nothing(shapes):
    truth = shapes.sphere(0.8, (1, 1, 1))
    measures = volume_measures(inside(truth, GRID), truth)
    assert (measures["excess"], measures["loss"], measures["iou"], measures["truth_voxels_removed"]) == (0, 0, 1, 0)
    # The lattice-point error at a radius of 8 voxels stays within a few per cent.
    assert measures["truth"] == pytest.approx(4 / 3 * np.pi * 0.8 ** 3, rel=0.03)


def test_the_shell_of_touched_voxels_is_the_floor_of_excess(shapes):
    truth = shapes.sphere(0.8, (1, 1, 1))
    grid = VoxelGrid((0, 0, 0), 0.025, (80, 80, 80))
    both = SparseVolume.from_dense(grid, inside(truth, grid).dense() | touched(truth, grid).dense())
    measures = volume_measures(both, truth)
    assert measures["loss"] == 0 and measures["truth_voxels_removed"] == 0
    # A surface of random direction keeps every voxel whose centre is up to half its width along the normal away:
    # 0.5 to 0.87 voxels, 0.75 on average over the sphere. The sphere's 3 h / r makes that 0.070; curvature adds 2 %.
    assert measures["excess"] == pytest.approx(0.75 * 3 * 0.025 / 0.8, rel=0.05)


def test_one_voxel_missing_inside_is_counted_and_one_at_the_surface_is_not(shapes):
    truth = shapes.sphere(0.8, (1, 1, 1))
    full = inside(truth, GRID).dense()
    for index, removed in (((10, 10, 10), 1), (tuple(np.argwhere(full)[0]), 0)):
        dense = full.copy()
        dense[index] = False
        measures = volume_measures(SparseVolume.from_dense(GRID, dense), truth)
        assert measures["truth_voxels_removed"] == removed
        assert measures["loss"] == pytest.approx(1 / full.sum())


@pytest.mark.parametrize("offset", [(-11, 0, 0), (0, 3, 0), (0, 0, -5), (13, -4, 2)])
def test_truth_beyond_the_grid_is_lost(shapes, offset):
    """The same block and truth in a grid that ends within the truth measure as in one that holds both."""
    truth = shapes.box((0.2, 0.2, 0.2), (1.8, 1.8, 1.8))
    low, high = np.maximum(np.array(offset), 0), np.minimum(np.array(offset) + 20, 20)
    wide = block(tuple(low), tuple(high))
    moved = VoxelGrid(0.1 * np.array(offset), 0.1, (20, 20, 20))
    narrow = block(tuple(low - offset), tuple(high - offset), moved)
    assert volume_measures(narrow, truth) == pytest.approx(volume_measures(wide, truth))
    assert volume_measures(narrow, truth)["truth"] == pytest.approx(1.6 ** 3)


def test_a_truth_in_another_unit_is_refused(shapes):
    with pytest.raises(ScanstageError, match="truth: .* unit"):
        volume_measures(block((0, 0, 0), (9, 9, 9)), shapes.box((0, 0, 0), (1000, 1000, 1000)))
    with pytest.raises(ScanstageError, match="truth: the mesh has no faces"):
        volume_measures(block((0, 0, 0), (9, 9, 9)), NOTHING)


def test_a_truth_between_the_centres_has_no_ratios(shapes):
    measures = volume_measures(block((0, 0, 0), (2, 2, 2)), shapes.box((0.51, 0.51, 0.51), (0.53, 0.53, 0.53)))
    assert measures["truth"] == 0 and measures["excess"] is None and measures["loss"] is None and measures["iou"] == 0


def test_equal_meshes_are_at_no_distance(shapes):
    for mesh in (shapes.torus(), shapes.box(), shapes.sphere()):
        measures = surface_measures(mesh, mesh, samples=3000)
        for name in ("accuracy_90", "chamfer", "hausdorff", "rms"):
            assert measures[name] < 1e-7  # the root of rounding: 1e-16 of squares
        assert measures["f_score"] == measures["completeness"] == 1


def test_concentric_spheres_are_their_difference_apart(shapes):
    measures = surface_measures(shapes.sphere(1.1, rings=96), shapes.sphere(1.0, rings=96), samples=5000)
    # 96 rings: each mesh keeps within 1.1 (1 - cos(pi / 192)^2) = 3e-4 of its sphere.
    for name, distance in (("accuracy_90", 0.1), ("hausdorff", 0.1), ("rms", 0.1), ("chamfer", 0.2)):
        assert measures[name] == pytest.approx(distance, abs=6e-4)
    assert measures["completeness"] == measures["f_score"] == 0  # 1 % of the diagonal is 0.035
    assert surface_measures(shapes.sphere(1.1), shapes.sphere(1.0), samples=500, tolerance=0.11)["f_score"] == 1


def test_a_shifted_sphere(shapes):
    """Shifted by s along z, the distance is |s cos(theta)| to first order, and cos(theta) is uniform on a sphere."""
    s = 0.01
    measures = surface_measures(shapes.sphere(1.0, (0, 0, s), rings=96), shapes.sphere(1.0, rings=96), samples=20_000)
    for name, distance in (("rms", s / np.sqrt(3)), ("chamfer", s), ("accuracy_90", 0.9 * s), ("hausdorff", s)):
        assert measures[name] == pytest.approx(distance, rel=0.04)  # facets: 3e-4; second order: s^2 / 2


def test_half_an_object_is_half_complete_and_accurate(shapes):
    truth = shapes.sphere(rings=64)
    upper = (truth.corners()[:, :, 2] >= -1e-9).all(axis=1)
    half = TriangleMesh(truth.vertices, truth.triangles[upper])
    measures = surface_measures(half, truth, samples=20_000)
    # The tolerance of 1 % of the diagonal, 0.035, adds that height of sphere to the half: 0.017 of all.
    assert measures["completeness"] == pytest.approx(0.5 + 0.017, abs=0.005)
    assert measures["accuracy_90"] < 1e-7
    assert measures["f_score"] == pytest.approx(2 * 0.517 / 1.517, abs=0.005)
    assert measures["hausdorff"] == pytest.approx(np.sqrt(2), rel=0.01)  # from the lower pole to the rim


def test_measures_move_with_both_meshes(shapes):
    a, b = shapes.sphere(1.05), shapes.torus()
    here = surface_measures(a, b, samples=2000, tolerance=0.05)
    moved = [shapes.moved(mesh, (7, -3, 50), (1, 2, 3), 1.0) for mesh in (a, b)]
    # Rounding may move a point or two of the 2000 across the tolerance.
    assert surface_measures(*moved, samples=2000, tolerance=0.05) == pytest.approx(here, rel=1e-6, abs=1e-3)
    assert surface_measures(a, b, samples=2000, tolerance=0.05) == here  # the same seed, the same numbers
    assert surface_measures(a, b, samples=2000, tolerance=0.05, seed=5) != here


def test_no_result_is_complete_nowhere(shapes):
    measures = surface_measures(NOTHING, shapes.box())
    assert measures["completeness"] == measures["f_score"] == 0 and measures["chamfer"] is None
    with pytest.raises(ScanstageError, match="truth: the mesh has no faces"):
        surface_measures(shapes.box(), NOTHING)


def test_evaluate_gathers_both_as_json(shapes):
    truth = shapes.sphere(0.8, (1, 1, 1))
    volume = inside(truth, GRID)
    seen = []
    report = evaluate(volume, extract_surface(volume), truth, samples=2000, progress=lambda part, _: seen.append(part))
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert set(report["volume"]) == {"result", "truth", "excess", "loss", "iou", "truth_voxels_removed"}
    assert set(report["surface"]) == {"accuracy_90", "completeness", "chamfer", "hausdorff", "f_score", "rms"}
    assert seen == sorted(seen) and seen[-1] == 1
    # A voxel chosen by its centre ends at most half a diagonal from the sphere.
    assert report["surface"]["hausdorff"] <= 0.1 * np.sqrt(3) / 2 + 1e-3
    assert set(evaluate(None, truth, truth, samples=100)) == {"surface"}


def test_evaluation_stops_when_told(shapes):
    def stop(_part, _message):
        raise Cancelled

    with pytest.raises(Cancelled):
        evaluate(block((0, 0, 0), (2, 2, 2)), shapes.box(), shapes.box(), progress=stop)
