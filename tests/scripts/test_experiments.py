# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The experiments against truths of their own: the lecture's counts, areas that are formulas, invariants of the tables."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from experiments import (
    EXPERIMENTS,
    accuracy,
    colored,
    concavities,
    consistency_measures,
    cost,
    hull_2d,
    lambertian,
    octree_count,
    robustness,
    stage,
    threshold,
    uniqueness,
    voxel_sizes,
)
from tables import Table, head, line
from turntable_captures import thinned

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.scan import Scan
from addon.reconstruction.volumetric.consistency import MEASURES
from addon.reconstruction.volumetric.volume import SparseVolume
from tests.rigs import Ball, marbled, painted_views, ring, sphere_mesh, views_of

ROOT = Path(__file__).resolve().parents[2]
BALL = Ball((0.0, 0.0, 0.0), 0.1)


def silent(fraction, message):
    """Report to nobody."""


@pytest.fixture(scope="module")
def scan():
    """Return a ball of 20 cm in 12 views."""
    cameras = ring(12, distance=0.6, focal=400.0, size=(200, 200))
    return Scan(tuple(replace(view, read_image=lambda: np.ones((200, 200, 3), np.float32)) for view in views_of(cameras, [BALL])))


@pytest.fixture(scope="module")
def truth():
    return sphere_mesh(BALL)


# --- octree-count ----------------------------------------------------------------------------------------------------------


def test_the_lecture_counts_617_with_the_root():
    tests = octree_count.count(octree_count.horse(), skip_last_level=True)
    assert tests == [1, 4, 16, 13 * 4, 34 * 16]
    assert sum(tests) == 617 and sum(tests[1:]) == 616


def test_a_strict_quadtree_counts_fewer_on_the_same_figure():
    tests = octree_count.count(octree_count.horse())
    assert tests[:5] == [1, 4, 16, 52, 136] and sum(tests) == 209 + tests[5]
    assert tests[5] < 4 * 102  # below this many it is cheaper than the lecture's jump
    assert sum(tests) < 617


@pytest.mark.parametrize(("radius", "tests"), [(6, 125), (9, 169), (11, 209), (13, 221)])
def test_discs_count_as_an_independent_program_found(radius, tests):
    assert sum(octree_count.count(octree_count.disc(radius))) == tests


def recursive_count(figure):
    """Return the tests of a quadtree, from its definition."""
    if figure.all() or not figure.any() or figure.size == 1:
        return 1
    half = len(figure) // 2
    return 1 + sum(recursive_count(figure[rows, columns]) for rows in (slice(half), slice(half, None))
                   for columns in (slice(half), slice(half, None)))


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
def test_the_count_is_that_of_the_definition(share):
    figure = np.random.default_rng(5).random((32, 32)) < share
    assert sum(octree_count.count(figure)) == recursive_count(figure)


def test_cells_that_are_not_divided_tile_the_figure_and_are_of_one_kind():
    figure, leaves = octree_count.horse(), np.zeros((32, 32), int)
    for edge, corners in octree_count.tested_cells(figure):
        for row, column in corners:
            cell = figure[row:row + edge, column:column + edge]
            leaves[row:row + edge, column:column + edge] += cell.all() or not cell.any()
    # A cell that is undivided is tested once, and nothing below it.
    assert (leaves == 1).all()


# --- hull-2d ---------------------------------------------------------------------------------------------------------------


def test_the_hull_in_the_plane_shrinks_and_never_loses_the_object():
    points, truth, kept, table = hull_2d.grow(silent, samples=128, limit=40)
    hulls = list(kept.values())
    assert len(hulls) == 9 and truth.any()
    assert all((left | ~truth).all() for left in hulls)
    assert all((before | ~after).all() for before, after in zip(hulls, hulls[1:], strict=False))
    areas = table.column("hull, cm²")
    assert areas == sorted(areas, reverse=True) and set(table.column("samples of the object lost")) == {0}
    assert table.column("excess")[-1] == pytest.approx(areas[-1] / (truth.sum() * (2 * hull_2d.REACH / 128) ** 2) - 1)


@pytest.mark.parametrize(("views", "sides"), [(3, 6), (4, 4), (5, 10), (8, 8)])
def test_the_hull_of_a_disc_is_the_polygon_of_its_tangents(views, sides):
    """Distant views are parallel projections: P odd ones have 2 P tangents, P even ones share theirs and have P."""
    radius, reach = 3.0, 7.0
    points, cell = hull_2d.raster(reach, 400)
    angle = 2 * np.pi * np.arange(views) / views + 0.1
    places = 1e6 * np.column_stack((np.cos(angle), np.sin(angle)))
    *_, left = hull_2d.hulls(points, np.array([[0.0, 0.0, radius]]), places)
    polygon = sides * radius ** 2 * np.tan(np.pi / sides)
    perimeter = 2 * sides * radius * np.tan(np.pi / sides)
    # Cells whose middle is inside: their area is that of the polygon but for those which its sides cross.
    assert left.sum() * cell == pytest.approx(polygon, abs=0.1 * perimeter * np.sqrt(cell))


def test_one_silhouette_has_a_gap_between_two_discs_and_none_where_they_overlap():
    camera = np.array([0.0, -10.0])
    apart = hull_2d.silhouette(camera, np.array([[-3.0, 0.0, 1.0], [3.0, 0.0, 1.0]]))
    assert apart.shape == (2, 2) and (np.diff(apart.ravel()) > 0).all()
    np.testing.assert_allclose(apart[0], -apart[1][::-1])
    hidden = hull_2d.silhouette(camera, np.array([[0.0, 0.0, 2.0], [0.0, 2.0, 0.5]]))
    np.testing.assert_allclose(hidden, [[-np.arcsin(0.2), np.arcsin(0.2)]])


def test_more_cameras_begin_with_the_same():
    np.testing.assert_array_equal(hull_2d.cameras(30)[:12], hull_2d.cameras(12))


# --- in space --------------------------------------------------------------------------------------------------------------


def test_the_octree_is_the_dense_hull_at_fewer_tests(scan):
    table = cost.compare(scan, (16, 32, 64), 32, silent)
    assert table.column("tests, dense") == [12 * n ** 3 for n in (16, 32, 64)]
    # Both round the same positions, by different arithmetic: a voxel on a pixel's very edge may fall on either side.
    assert all(differing <= 2 for differing in table.column("voxels that differ")[:2])
    assert table.column("voxels that differ")[2] is None
    share = table.column("share")
    assert share[2] < share[1] < share[0] <= 1


def test_the_slope_is_the_exponent():
    sizes = np.array([32, 64, 128])
    assert cost.slope(sizes, 7 * sizes ** 2.5) == pytest.approx(2.5)


def test_a_cube_has_the_middle_and_the_longest_side():
    cube = cost.cube(np.array([[0.0, 0, 0], [1, 4, 2]]))
    np.testing.assert_allclose(cube, [[-1.5, 0, -1], [2.5, 4, 3]])


def test_voxels_are_as_large_as_asked_for(scan, truth):
    table, found = voxel_sizes.measure(scan, truth, (10, 5), silent)
    assert [result.volume.grid.voxel_size for result in found.values()] == pytest.approx([0.010, 0.005])
    np.testing.assert_allclose(found[10].volume.grid.origin, found[5].volume.grid.origin)
    assert table.column("truth voxels removed") == [0, 0] and table.column("loss") == [0, 0]
    coarse, fine = table.column("excess")
    assert fine < coarse
    assert all(megabytes > 0 for megabytes in table.column("peak memory, MB"))


def test_bounds_grow_to_whole_millimetres():
    bounds, steps = voxel_sizes.whole_millimetres(np.array([[-0.0101, 0.0, 0.0032], [0.0101, 0.004, 0.0059]]), 2)
    np.testing.assert_allclose(bounds, [[-0.012, 0, 0.002], [0.012, 0.004, 0.006]])
    assert steps == 12


def test_peak_memory_is_what_was_held_at_most():
    assert voxel_sizes.peak(lambda: np.ones(30_000_000, np.uint8)) == pytest.approx(30, rel=0.02)


def test_more_views_of_a_ring_are_never_worse(scan, truth):
    rows = accuracy.follow("ball", scan, truth, (3, 6, 12), 32, silent)
    table = accuracy.tabulate(rows, 32)
    assert table.column("views") == [3, 6, 12] and set(table.column("truth voxels removed")) == {0}
    assert table.column("excess") == sorted(table.column("excess"), reverse=True)
    assert set(table.column("loss")) == {0}


def test_thinned_views_are_spread_evenly(scan):
    assert [view.name for view in thinned(scan, 4).views] == ["0000", "0003", "0006", "0009"]
    with pytest.raises(ValueError, match="5 views"):
        thinned(scan, 5)


def test_the_depth_of_a_concavity_is_measured_from_its_mouth():
    """A ball with a pit: the truth is hollow up its axis from 20 mm, the hull from 80 mm, and the mouth is at 100 mm."""
    grid = VoxelGrid((-0.12, -0.12, -0.12), 0.002, (120, 120, 120))
    x, y, z = np.moveaxis(grid.centres(np.moveaxis(np.indices(grid.shape), 0, -1)), -1, 0)
    ball, pit = x ** 2 + y ** 2 + z ** 2 <= 0.01, x ** 2 + y ** 2 <= 0.03 ** 2
    true, hull = (SparseVolume.from_dense(grid, ball & ~(pit & (z > top))) for top in (0.02, 0.08))
    concavity = concavities.Concavity("ball", "pit", 0, 90, height=0.0)
    depth, above, shown = concavities.depths(concavity, sphere_mesh(BALL), true, hull)
    assert depth == pytest.approx(80, abs=2) and above == pytest.approx(60, abs=2) and shown == pytest.approx(20, abs=2)
    cut, extent = concavities.section(concavity, true)
    left, right, low, high = extent
    # The disc of the section, less the segment that is not drawn, less the pit: 60 mm wide, from 20 mm to the circle.
    segment = 100 ** 2 * np.arccos(0.6) - 60 * np.sqrt(100 ** 2 - 60 ** 2)
    hollow = 100 ** 2 * np.arcsin(0.3) + 30 * np.sqrt(100 ** 2 - 30 ** 2) - 60 * 20
    assert low == -60 and cut.mean() * (right - left) * (high - low) == pytest.approx(np.pi * 100 ** 2 - segment - hollow, rel=0.02)


# --- carving by colour -----------------------------------------------------------------------------------------------------


def test_two_scenes_give_the_same_two_pictures():
    floor, platform = uniqueness.scenes().values()
    assert (floor != platform).any() and (floor & ~platform).any() and (platform & ~floor).any()
    pictures = [uniqueness.pictures_of(blocks) for blocks in (floor, platform)]
    for (one, mask), (other, other_mask) in zip(*pictures, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(mask, other_mask)
        # Not for want of anything to see: both colours, and background on all sides.
        assert {tuple(color) for color in one[mask]} == {tuple(color) for color in uniqueness.COLORS.astype(np.float32)}
        assert mask.any() and not (mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
    # A scene that is neither gives others.
    assert any((one[0] != other[0]).any() for one, other in zip(pictures[0], uniqueness.pictures_of(floor & platform), strict=True))


def test_the_photo_hull_holds_both_scenes_and_shows_their_colours():
    """Kutulakos & Seitz (2000): it is the union of all shapes that the pictures allow."""
    table = uniqueness.tabulate(found := uniqueness.reconstructed(silent))
    assert table.column("share of the floor that it holds")[2:] == table.column("share of the platform that it holds")[2:] == [1, 1]
    assert all(result.report["counts"]["removed"] > 0 and result.report["counts"]["coloured"] > 0 for result in found.values())
    assert table.column("their pixels of another colour")[2:] == [0, 0]


def painted(paint):
    """Return a ball of one unit in 12 views from above, painted, and its truth. A painter that takes two gets the view's number, too."""
    ball, cameras = Ball((0.0, 0.0, 0.0), 1.0), ring(12, elevation=35.0, focal=200.0, size=(160, 120))
    views = [painted_views([camera], [ball], lambda points, number=number: paint(points, number))[0] for number, camera in enumerate(cameras)]
    return Scan(tuple(replace(view, name=f"{number:04d}") for number, view in enumerate(views))), sphere_mesh(ball)


@pytest.fixture(scope="module")
def matte():
    return painted(lambda points, number: marbled(points / 2))


def test_what_is_lost_and_too_much_is_that_of_the_truth(matte):
    scan, truth = matte
    made = colored.outcome(scan, truth, "visual-hull", {"rule": "conservative"}, silent, voxels=32)
    # A conservative hull holds the ball; from above it has the cone below, too.
    assert made.lost == 0 and made.excess > 0
    volume = made.found.volume
    ball = 4 / 3 * np.pi / volume.grid.voxel_size ** 3
    assert 1 + made.excess == pytest.approx(volume.count() / ball, rel=0.02)


def test_a_plain_surface_stays_fat_and_one_that_shines_is_lost(matte):
    plain = painted(lambda points, number: np.full((len(points), 3), 0.5))
    shiny = painted(lambda points, number: marbled(points / 2) * (0.3 + 0.7 * (number % 2)))
    kinds = {"matte": matte, "shiny": shiny, "textureless": plain}
    made = {kind: lambertian.compare(*each, silent, voxels=32) for kind, each in kinds.items()}
    for method in lambertian.METHODS:
        matte_one, shiny_one, plain_one = (made[kind][method] for kind in kinds)
        assert plain_one.lost == 0 and plain_one.excess >= matte_one.excess
        assert shiny_one.lost > matte_one.lost + 0.1
        assert all(each[method].excess <= each["visual-hull"].excess for each in made.values())
    table = lambertian.tabulate(made)
    assert len(table.rows) == 9 and table.column("coloured voxels")[0] is None


def test_a_low_threshold_loses_and_a_high_one_keeps_the_hull(matte):
    made = threshold.sweep(*matte, silent, (0.02, 0.1, 10.0), 32)
    table = threshold.tabulate(made)
    low, _, high = table.column("surface lost")
    assert low > high and table.column("excess") == sorted(table.column("excess"))
    hull = lambertian.compare(*matte, silent, voxels=32)["visual-hull"]
    assert (high, table.column("excess")[-1]) == (hull.lost, hull.excess)  # no score is above 10


def test_every_measure_is_compared_on_the_same_scan(matte):
    table = consistency_measures.tabulate(consistency_measures.compare(*matte, silent, voxels=32))
    assert table.column("measure") == list(MEASURES)
    areas = dict(zip(table.column("measure"), table.column("area under the curve"), strict=True))
    # Those that compare colours as they are do far better than a coin. Colours of one cell of the histogram's, or patches that change
    # as slowly as these, tell nothing.
    assert all(0.8 < areas[name] <= 1 for name in ("adaptive", "deviation", "chi-square", "pairwise", "likelihood"))
    assert areas["histogram"] >= 0.5
    assert [text for text in table.column("monotone") if not text.startswith("not")] == [
        MEASURES["pairwise"].monotone.value, MEASURES["histogram"].monotone.value]
    assert all(seconds > 0 for seconds in table.column("seconds"))


# --- tables and the script -------------------------------------------------------------------------------------------------


def test_a_table_is_markdown():
    table = Table(("name", "count", "share"), (("a", 1234567, 0.123456), ("b", 2, None)), "A note.")
    assert table.markdown().splitlines() == [
        "| name | count | share |", "| --- | --- | --- |", "| a | 1,234,567 | 0.1235 |", "| b | 2 |  |", "", "A note."]
    assert head("x") == ("| x |", "| --- |") and line("x", -1) == "| x | -1 |"
    with pytest.raises(ValueError, match="3 cells"):
        Table(("name", "count", "share"), (("a", 1),))


def test_every_experiment_is_told_in_one_sentence():
    assert {"hull-2d", "octree-count", "cost", "voxel-sizes", "accuracy", "concavities", "shadow-carving", "uniqueness", "lambertian", "threshold",
            "consistency-measures"} <= set(EXPERIMENTS)
    for name, experiment in EXPERIMENTS.items():
        assert experiment.name == name and experiment.description.endswith(".")
    assert set(stage.MEASURES) >= {"excess", "loss", "truth_voxels_removed"}


def test_the_script_prints_the_table_and_leaves_the_picture(tmp_path):
    command = [sys.executable, ROOT / "scripts" / "experiments.py", "octree-count", "--out", tmp_path]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert answer.returncode == 0, answer.stderr
    assert "| 617 |" in answer.stdout and "## octree-count" in answer.stdout
    picture = tmp_path / "octree-count.png"
    height, width, _ = cv2.imread(str(picture)).shape
    assert width == 900 and height < 900 and picture.stat().st_size < 150_000
    assert [path.name for path in tmp_path.iterdir()] == ["octree-count.png"]


def test_an_unknown_experiment_is_a_wrong_call(tmp_path):
    command = [sys.executable, ROOT / "scripts" / "experiments.py", "nonsense", "--out", tmp_path]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert answer.returncode == 2 and "nonsense" in answer.stderr and "hull-2d" in answer.stderr
    # Blender itself may say something there about a machine without file systems.
    assert not any(line.startswith(("|", "#")) for line in answer.stdout.splitlines()) and not list(tmp_path.iterdir())


# --- robustness ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", robustness.FAULTS)
def test_a_fault_is_what_it_says_and_the_same_every_time(scan, fault):
    first, second = (robustness.faulty(scan, fault).views for _ in range(2))
    assert all((a.mask == b.mask).all() and (a.camera.K == b.camera.K).all() for a, b in zip(first, second, strict=True))
    spoilt = [number for number, (a, b) in enumerate(zip(first, scan.views, strict=True)) if (a.mask != b.mask).any()]
    moved = np.array([a.camera.K[:2, 2] - b.camera.K[:2, 2] for a, b in zip(first, scan.views, strict=True)])
    assert (moved != 0).all() == fault.startswith("calibration") and np.abs(moved).max() < 4 * 2
    if fault.startswith("salt"):
        share = np.mean([(a.mask != b.mask).mean() for a, b in zip(first, scan.views, strict=True)])
        assert share == pytest.approx(0.005, rel=0.1)  # of a hundredth of the pixels half have the other value already
        assert np.mean([(a.read_image() != 1).any(axis=2).mean() for a in first]) == pytest.approx(0.005, rel=0.1)  # the pictures are white
    else:
        assert spoilt == ([robustness.WRONG] if fault.startswith("1 wrong mask") else [])


def test_the_wrong_view_is_named_and_forgiving_it_gives_the_object_back(scan, truth):
    bounds = np.array([[-0.12] * 3, [0.12] * 3])
    none, wrong, forgiven = (dict(zip(("method", "fault", "tolerance", "loss", "excess", "within", "says"), robustness.judged(
        scan, truth, "visual-hull", fault, tolerance, bounds, silent), strict=True)) for fault, tolerance in (
            ("none", 0), (list(robustness.FAULTS)[1], 0), (list(robustness.FAULTS)[1], 1)))
    assert none["says"] == "" and none["loss"] == 0
    assert wrong["says"] == forgiven["says"] == f"names {scan.views[robustness.WRONG].name}"
    assert wrong["loss"] > 0.05 and forgiven["loss"] == 0 and forgiven["excess"] < none["excess"] + 0.1
