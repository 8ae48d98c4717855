# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxel coloring, space carving and generalized voxel coloring on scenes that are formulas, and against plain definitions."""

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.methods import METHODS, reconstruct
from addon.reconstruction.scan import Scan
from addon.reconstruction.volumetric.carving import Carving
from addon.reconstruction.volumetric.consistency import MEASURES, Judge
from addon.reconstruction.volumetric.footprints import Pictures
from addon.reconstruction.volumetric.generalized_voxel_coloring import carve_by_sight
from addon.reconstruction.volumetric.item_buffer import item_buffer
from addon.reconstruction.volumetric.sight import NOTHING, Sight
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.sweeping import AXES, Order, covered, sweep
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.reconstruction.volumetric.voxel_coloring import ordinal_visibility, separating_direction
from tests.rigs import Ball, Box, camera_at, marbled, painted_views, ring

COLOR_METHODS = ("voxel-coloring", "space-carving", "generalized-voxel-coloring")
BALL, BLOCK = Ball((0.0, 0.0, 0.0), 0.5), Box((0.3, 0.2, -0.15), (0.25, 0.3, 0.2), np.eye(3))
BOUNDS = np.array([[-0.7, -0.7, -0.7], [0.7, 0.7, 0.7]])
GRID = VoxelGrid.from_bounds(*BOUNDS, 48)
CENTRES = GRID.centres(np.stack(np.indices(GRID.shape), -1))
TRUTH = BALL.contains(CENTRES) | BLOCK.contains(CENTRES)


def soft(points):
    """Return colours that change by at most 0.07 from voxel to voxel: over half of the ball."""
    return 0.5 + 0.4 * np.sin(points @ np.array([[4, 1, -3], [-2, 5, 1], [2, -1, 5]]) + (0.3, 1.1, 2.0))


@pytest.fixture(scope="module")
def scan():
    cameras = ring(12, elevation=35, focal=420, size=(200, 180)) + ring(6, elevation=65, focal=420, size=(200, 180))
    return Scan(tuple(painted_views(cameras, [BALL, BLOCK], soft)), BOUNDS)


@pytest.fixture(scope="module")
def found(scan):
    return {name: reconstruct(scan, name, voxels=48) for name in ("visual-hull", *COLOR_METHODS)}


def judge_of(consistency="pairwise", threshold=0.15, min_views=2):
    return Judge.of(consistency=consistency, threshold=threshold, noise=0.01, min_views=min_views)


def carving_of(occupancy, grid=GRID):
    return Carving(SparseVolume.from_dense(grid, occupancy))


@pytest.mark.parametrize("name", COLOR_METHODS)
def test_the_photo_hull_holds_the_object_and_the_hull_holds_it(name, found):
    volume, hull = found[name].volume.dense(), found["visual-hull"].volume.dense()
    surface = extract_surface(SparseVolume.from_dense(GRID, TRUTH)).voxels
    lost = ~found[name].volume.contains(surface)
    assert lost.mean() <= 1e-3  # as much as pictures sampled at pixels' centres may cost
    assert (volume <= hull).all() and np.count_nonzero(volume) < np.count_nonzero(hull)


@pytest.mark.parametrize("name", COLOR_METHODS)
def test_colours_are_those_of_the_surface(name, found):
    surface, colors = found[name].surface, found[name].colors
    points = GRID.centres(surface.voxels)
    distance = np.abs(np.linalg.norm(points, axis=1) - BALL.radius)
    on_ball = (colors.views >= 3) & (distance < GRID.voxel_size) & ~BLOCK.contains(points * 0.98)
    # a voxel's colour is read within a voxel of its place, where the colours change by 0.4 * 5.5 a unit at most
    assert np.count_nonzero(on_ball) > 500
    assert np.abs(colors.rgb - soft(points))[on_ball].mean() < 0.4 * 5.5 * GRID.voxel_size / 2


@pytest.mark.parametrize("name", COLOR_METHODS)
def test_what_no_view_sees_is_kept_and_said(name, found):
    result = found[name]
    counts = result.report["counts"]
    assert counts["coloured"] + counts["unseen"] == counts["surface"]
    assert counts["unseen"] == np.count_nonzero(result.colors.views == 0)
    below = result.surface.voxels[result.colors.views == 0]
    assert (GRID.centres(below)[:, 2] < -0.2).any()  # no camera stands below
    assert counts["tested"] >= counts["coloured"] > 0 and counts["removed"] > 0


def test_the_report_names_the_order_and_the_measure(found):
    assert found["voxel-coloring"].report["order"] == "plane sweep towards -z"
    assert found["voxel-coloring"].report["consistency"]["monotone"] is False
    assert found["voxel-coloring"].report["consistency"]["measure"] == "adaptive"


def test_rays_see_what_an_item_buffer_shows(scan):
    carving = carving_of(TRUTH)
    pictures = Pictures.of(scan.views[:4], GRID)
    sight = Sight(pictures, carving)
    before = carving.frozen()
    for _ in range(3):
        check_sight(sight, pictures, carving)
        seen = sight.seen()
        carving.remove(seen[::3])
        sight.look_on()
    assert carving.frozen().count() < before.count()


def check_sight(sight, pictures, carving):
    surface = extract_surface(carving.frozen())
    keys = np.append(carving.keys(surface.voxels), NOTHING)
    for view, camera in enumerate(pictures.cameras):
        items = item_buffer(surface, GRID, camera)[0].ravel()
        own = sight.view == view
        expected = keys[items[sight.rows[own] - pictures.offset[view]]]
        # float32 matrices move a ray by 1e-4 pixels: it may pass an edge on the other side
        assert (sight.keys[own] == expected).mean() > 0.998


def test_the_photo_hull_does_not_depend_on_the_order_of_carving(scan):
    pictures, judge = Pictures.of(scan.views, GRID), judge_of()
    random = np.random.default_rng(6)
    block = (np.abs(CENTRES) < 0.58).all(-1)
    results = []
    for choose in (lambda keys: keys, lambda keys: keys[:max(1, len(keys) // 3)],
                   lambda keys: np.sort(random.permutation(keys)[:max(1, len(keys) // 2)])):
        carving = carving_of(block)
        carve_by_sight(carving, Sight(pictures, carving), judge, choose=choose)
        results.append(carving.frozen().dense())
    assert np.array_equal(results[0], results[1]) and np.array_equal(results[0], results[2])
    assert 0 < results[0].sum() < block.sum()


def plain_voxel_coloring(dense, pictures, judge, order):
    """Voxel coloring by its definition: layer by layer, voxel by voxel, a bit a pixel, set after the layer."""
    dense, steps = dense.copy(), np.concatenate((-np.eye(3, dtype=int), np.eye(3, dtype=int)))
    marked = np.zeros(len(pictures.rgba), bool)
    layers = order.layer(np.argwhere(np.ones(dense.shape, bool)))
    for layer in range(layers.min(), layers.max() + 1):
        kept, looked, again = [], set(), True
        while again:
            padded = np.pad(dense, 1)
            free = {tuple(voxel): [step for step in steps if not padded[tuple(voxel + 1 + step)]] for voxel in np.argwhere(dense)
                    if order.layer(voxel[None])[0] == layer and tuple(voxel) not in looked}
            front = [voxel for voxel in free if free[voxel]]
            refused = [voxel for voxel in front if plainly_refused(np.array(voxel), free[voxel], pictures, judge, marked)]
            looked |= set(front)
            kept += [voxel for voxel in front if voxel not in refused]
            for voxel in refused:
                dense[voxel] = False
            again = bool(refused)
        for voxel in kept:
            marked |= plainly_covered(np.array(voxel), pictures)
    return dense


def plainly_refused(voxel, free, pictures, judge, marked):
    normal = np.mean(free, axis=0)
    point = voxel + 0.5 + 0.5 * normal
    distance = np.linalg.norm(pictures.centres - np.array(GRID_SMALL.shape) / 2, axis=1)
    colors = []
    for view, row in enumerate(pictures.locate(point[None])[:, 0]):
        facing = normal @ (pictures.centres[view] - point) >= 0.1 * np.linalg.norm(normal) * distance[view]
        if facing and pictures.rgba[row, 3] and not marked[row]:
            colors.append(pictures.rgba[row, :3])
    return len(colors) >= judge.min_views and np.ptp(colors, axis=0).max() > judge.threshold


def plainly_covered(voxel, pictures):
    """Return which pixels' centres have rays that meet a voxel's cube: by slabs."""
    cover = []
    for number, camera in enumerate(pictures.cameras):
        u, v = np.meshgrid(np.arange(camera.size[0]) + 0.5, np.arange(camera.size[1]) + 0.5)
        rays = np.stack((u, v, np.ones_like(u)), -1) @ np.linalg.inv(pictures.matrices[number, :, :3].astype(float)).T
        first, second = (voxel - pictures.centres[number]) / rays, (voxel + 1 - pictures.centres[number]) / rays
        cover.append((np.minimum(first, second).max(-1) <= np.maximum(first, second).min(-1)).ravel())
    return np.concatenate(cover)


GRID_SMALL = VoxelGrid.from_bounds(*BOUNDS, 10)


def test_a_sweep_is_voxel_coloring_by_its_definition():
    views = painted_views(ring(5, elevation=40, focal=90, size=(56, 50)), [BALL], marbled)
    pictures, judge = Pictures.of(views, GRID_SMALL, border=0), judge_of(threshold=0.2)
    block = Ball(BALL.centre, 0.68).contains(GRID_SMALL.centres(np.stack(np.indices(GRID_SMALL.shape), -1)))
    carving = carving_of(block, GRID_SMALL)
    sweep(carving, pictures, judge, AXES[5])
    expected = plain_voxel_coloring(block, pictures, judge, AXES[5])
    # a pixel's centre within float32 of a cube's outline may fall on either side and change a voxel or two
    assert np.count_nonzero(carving.frozen().dense() != expected) <= 2
    assert 0 < expected.sum() < block.sum() - 10


def test_pixels_covered_by_voxels_are_those_whose_rays_meet_them():
    views = painted_views(ring(3, elevation=40, focal=300, size=(200, 180)), [BALL], soft)
    pictures = Pictures.of(views, GRID_SMALL, border=0)
    for voxel in np.array([[2, 3, 4], [8, 5, 6], [5, 5, 9]]):
        mine = np.zeros(len(pictures.rgba), bool)
        for rows in covered(pictures, voxel[None]):
            mine[rows] = True
        expected = plainly_covered(voxel, pictures)
        # perspective within the voxel is left out: less than a pixel along the outline
        assert np.count_nonzero(mine != expected) <= 0.04 * np.count_nonzero(expected)


def test_marks_are_set_after_a_layer_and_not_within_it():
    """Two voxels side by side in a layer, one before the other in the only views: both are seen."""
    grid = VoxelGrid((0, 0, 0), 1.0, (8, 8, 8))
    occupancy = np.zeros(grid.shape, bool)
    occupancy[2, 4, 3] = occupancy[4, 4, 3] = True
    cameras = [camera_at((-12, y, 6.5), (3, 4.5, 3.5), focal=120, size=(120, 80)) for y in (3, 4.5, 6)]
    views = painted_views(cameras, [Ball((3, 4.5, 3.5), 3)], lambda points: np.full(points.shape, 0.5))
    pictures = Pictures.of(views, grid)
    swept = sweep(carving_of(occupancy, grid), pictures, judge_of(), AXES[5])
    assert len(swept.keys) == 2 and (swept.views >= 2).all()
    across = sweep(carving_of(occupancy, grid), pictures, judge_of(), AXES[0])
    # when the plane moves away from the cameras the nearer voxel takes the pixels of the one behind it
    assert (across.views >= 2).sum() == 1


def test_too_few_views_leave_a_voxel_uncoloured(scan):
    all_views = len(scan.views)
    result = reconstruct(scan, "voxel-coloring", voxels=24, options={"min_views": all_views})
    hull = reconstruct(scan, "visual-hull", voxels=24, options={"rule": "center"})
    assert result.report["counts"]["removed"] == 0 and result.volume.count() == hull.volume.count()
    assert result.report["counts"]["coloured"] < result.report["counts"]["unseen"]


@pytest.mark.parametrize("name", COLOR_METHODS)
def test_from_the_box_background_is_removed_too(name, scan, found):
    boxed = reconstruct(scan, name, voxels=48, options={"start": "box"})
    surface = extract_surface(SparseVolume.from_dense(GRID, TRUTH)).voxels
    assert (~boxed.volume.contains(surface)).mean() <= 1e-3
    near = Ball((0, 0, 0), 0.5 + 0.25).contains(CENTRES) | Box(BLOCK.centre, (0.5, 0.55, 0.45), np.eye(3)).contains(CENTRES)
    assert not (boxed.volume.dense() & ~near)[:, :, 12:].any()  # below, nothing is seen of what stands in the object's shadow


def test_cameras_round_the_object_are_refused(scan):
    views = painted_views(ring(8, elevation=0, focal=420, size=(200, 180)), [BALL], soft)
    with pytest.raises(ScanstageError, match="convex hull of the 8 camera centres meets the working volume.*generalized-voxel-coloring"):
        reconstruct(Scan(tuple(views), BOUNDS), "voxel-coloring", voxels=24)


@pytest.mark.parametrize("name", COLOR_METHODS)
def test_more_views_demanded_than_there_are_leave_the_hull_without_a_colour(name, scan):
    result = reconstruct(scan, name, voxels=24, options={"min_views": len(scan.views) + 1})
    hull = reconstruct(scan, "visual-hull", voxels=24, options={"rule": "center"})
    np.testing.assert_array_equal(result.volume.dense(), hull.volume.dense())
    assert result.report["counts"]["coloured"] == 0 and np.isfinite(result.colors.rgb).all()


def test_one_view_is_refused(scan):
    with pytest.raises(ScanstageError, match="has 1 view: colours can only be compared"):
        reconstruct(Scan(scan.views[:1], BOUNDS), "space-carving", voxels=16)


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 1, 0.2), (-1, 0.5, 0.7), (0.3, -1, -1)])
def test_an_oblique_plane_separates_cameras_from_the_volume(direction):
    direction = np.array(direction) / np.linalg.norm(direction)
    box = np.array([[0.0, 0, 0], [40, 30, 20]])
    random = np.random.default_rng(3)
    spread = random.standard_normal((12, 3)) * 30
    spread -= np.outer(spread @ direction, direction)
    centres = spread + box.mean(0) + 60 * direction
    found = separating_direction(centres, box)
    corners = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    assert (corners @ found).min() > (centres @ found).max()
    assert separating_direction(np.concatenate((centres, box.mean(0) - 60 * direction[None])), box) is None


def test_a_sweep_along_an_oblique_order_keeps_the_object():
    cameras = [camera_at(4 * np.array([np.cos(a), np.sin(a), 0.4]), focal=420, size=(200, 180)) for a in np.radians(np.arange(5, 90, 10))]
    scan = Scan(tuple(painted_views(cameras, [BALL], soft)), BOUNDS)
    order = ordinal_visibility(np.array([[90.0, 40, 30], [40, 90, 30], [100, 50, 20]]), carving_of(np.ones((48, 48, 48), bool)))
    assert order not in AXES and (order.direction[:2] < 0).all()
    carving = carving_of(BALL.contains(CENTRES))
    swept = sweep(carving, Pictures.of(scan.views, GRID), judge_of("adaptive", 0.02), Order("test", np.array([-0.7, -0.7, -0.1])))
    assert swept.removed <= 1e-3 * swept.tested and (swept.views >= 2).mean() > 0.15


def test_every_measure_carves_with_every_method(scan):
    small = Scan(scan.views[::3], BOUNDS)
    for measure in MEASURES:
        for name in COLOR_METHODS:
            report = reconstruct(small, name, voxels=12, options={"consistency": measure, "consistency_threshold": 30.0}).report
            assert report["consistency"]["measure"] == measure and report["counts"]["coloured"] > 0


def test_methods_are_in_the_table():
    assert set(COLOR_METHODS) <= set(METHODS)
