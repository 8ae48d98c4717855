# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The octree against a plain loop over all voxels: bit for bit, for both rules, any camera, any grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.errors import Cancelled
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric import octree
from addon.reconstruction.volumetric.octree import carve, extent_of
from addon.reconstruction.volumetric.silhouette_test import SilhouetteTest, grid_projection
from addon.reconstruction.volumetric.volume import SparseVolume
from tests.rigs import Ball, camera_at, ring, silhouette


def brute_force(tests, masks, grid, *, rule, tolerance, unknown_outside):
    """Return the dense volume by testing every voxel in every view, from the rule's definition.

    Only the rounded projection matrix is shared with the code under test; pictures, footprints and sums are not.
    """
    centres = np.stack(np.meshgrid(*(2.0 * np.arange(n) + 1 for n in grid.shape), indexing="ij"))
    misses = np.zeros(grid.shape, int)
    for test, mask in zip(tests, masks, strict=True):
        padded = np.pad(mask, 1, constant_values=unknown_outside)
        sums = np.pad(padded.astype(int).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        a, b, c = test.matrix
        u, v, w = (m[0] * centres[0] + m[1] * centres[1] + m[2] * centres[2] + m[3] for m in (a, b, c))
        reach = float(rule == "conservative")
        depth = w - reach * np.abs(c[:3]).sum()
        seen = depth > test._ahead
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / w
            u, v = (u / w, v / w) if test.clipped else (u * inverse, v * inverse)
            if test.clipped:
                spread = [((np.abs(m[0] - x * c[0]) + np.abs(m[1] - x * c[1])) + np.abs(m[2] - x * c[2])) * reach / depth
                          for m, x in ((a, u), (b, v))]
            else:
                spread = [reach * ((start + slope * x) * (1.0 / depth)) for (start, slope), x in zip(test._chord, (u, v), strict=True)]
        limits = []
        for x, e, size, corner in ((u, spread[0], mask.shape[1], test.corner[0]), (v, spread[1], mask.shape[0], test.corner[1])):
            low, high = (np.where(seen, np.floor(bound), 0) + corner + 1 for bound in (x - e, x + e))
            limits += [np.clip(low, 0, size + 1).astype(int), np.clip(high, 0, size + 1).astype(int) + 1]
        x0, x1, y0, y1 = limits
        inside = sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0] > 0
        misses += seen & ~inside
    return misses <= tolerance


def prepared(cameras, masks, grid, rule="conservative", unknown_outside=True):
    return [SilhouetteTest(camera, mask, grid, extent_of(grid), rule=rule, unknown_outside=unknown_outside)
            for camera, mask in zip(cameras, masks, strict=True)]


def assert_equal_to_brute_force(cameras, masks, grid, *, rule, tolerance=0, unknown_outside=True):
    tests = prepared(cameras, masks, grid, rule, unknown_outside)
    volume, counts = carve(tests, grid, tolerance=tolerance)
    expected = brute_force(tests, masks, grid, rule=rule, tolerance=tolerance, unknown_outside=unknown_outside)
    assert np.array_equal(volume.dense(), expected)
    assert volume.count() == expected.sum()
    return volume, counts


@pytest.mark.parametrize("rule", ["conservative", "center"])
@pytest.mark.parametrize("tolerance", [0, 1, 3])
def test_equal_to_brute_force_on_a_ring(rule, tolerance):
    cameras = ring(9)
    shapes = [Ball((0.1, 0, 0), 0.6), Ball((-0.3, 0.3, 0.4), 0.3)]
    grid = VoxelGrid.from_bounds((-1, -1, -0.9), (1, 0.93, 1), 61)
    volume, counts = assert_equal_to_brute_force(cameras, [silhouette(c, shapes) for c in cameras], grid, rule=rule,
                                                 tolerance=tolerance)
    assert 0 < volume.count() < grid.count
    assert (counts.alone > 0).all()


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_equal_to_brute_force_for_any_rig(data):
    """Cameras anywhere, also inside the volume and with parts of it behind them; masks of noise; ragged grids."""
    random = np.random.default_rng(data.draw(st.integers(0, 2 ** 32 - 1)))
    cameras = [camera_at(random.normal(size=3) * data.draw(st.sampled_from([0.3, 1.0, 3.0])), random.normal(size=3) * 0.2,
                         focal=random.uniform(20, 120), size=(int(random.integers(8, 70)), int(random.integers(8, 60))))
               for _ in range(data.draw(st.integers(1, 4)))]
    masks = [random.random(camera.size[::-1]) < random.choice([0.05, 0.5, 0.97]) for camera in cameras]
    lower = random.uniform(-1, 0, 3)
    grid = VoxelGrid.from_bounds(lower, lower + random.uniform(0.3, 1.5, 3), int(random.integers(1, 40)))
    assert_equal_to_brute_force(cameras, masks, grid, rule=data.draw(st.sampled_from(["conservative", "center"])),
                                tolerance=data.draw(st.integers(0, 2)), unknown_outside=data.draw(st.booleans()))


def test_work_is_a_small_share_of_all_voxels():
    cameras = ring(12)
    grid = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 128)
    tests = prepared(cameras, [silhouette(c, [Ball((0, 0, 0), 0.8)]) for c in cameras], grid, "center")
    _, counts = carve(tests, grid)
    assert counts.tests < 0.25 * grid.count * len(cameras)  # T7c's bound


def test_carving_in_parts_changes_nothing(monkeypatch):
    cameras = ring(5)
    grid = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 300)
    tests = prepared(cameras, [silhouette(c, [Ball((0.2, 0, 0), 0.7)]) for c in cameras], grid)
    whole = carve(tests, grid)[0]
    monkeypatch.setattr(octree, "VOXELS_ACROSS", 50)
    parts = carve(tests, grid)[0]
    assert np.array_equal(whole.brick_map, parts.brick_map) and np.array_equal(whole.bricks, parts.bricks)


def test_views_that_empty_the_volume_alone_are_counted():
    cameras = ring(4)
    masks = [silhouette(c, [Ball((0, 0, 0), 0.5)]) for c in cameras]
    masks[2] = np.zeros_like(masks[2])
    grid = VoxelGrid.from_bounds((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), 32)
    volume, counts = carve(prepared(cameras, masks, grid), grid)
    assert volume.count() == 0
    assert (counts.alone == 0).tolist() == [False, False, True, False]


def test_stops_when_told():
    grid = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 512)
    cameras = ring(2)

    def stop(fraction, message):
        raise Cancelled

    with pytest.raises(Cancelled):
        carve(prepared(cameras, [silhouette(c, [Ball((0, 0, 0), 0.5)]) for c in cameras], grid), grid, progress=stop)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2 ** 32 - 1))
def test_sums_of_the_projection_are_exact_in_any_order(seed):
    random = np.random.default_rng(seed)
    grid = VoxelGrid(random.normal(size=3), random.uniform(1e-3, 1), (8, 8, 8))
    camera = camera_at(random.normal(size=3) * 5, focal=random.uniform(50, 5000))
    extent = 2 ** int(random.integers(4, 15))
    matrix = grid_projection(camera, grid, extent, tuple(random.integers(-500, 500, 2)))
    at = random.integers(0, extent + 1, (100, 3)).astype(float)
    terms = np.concatenate((matrix[:, None, :3] * at, np.broadcast_to(matrix[:, None, 3:], (3, 100, 1))), axis=-1)
    orders = [random.permutation(4) for _ in range(4)]
    sums = [((terms[..., o[0]] + terms[..., o[1]]) + terms[..., o[2]]) + terms[..., o[3]] for o in orders]
    assert all(np.array_equal(sums[0], other) for other in sums[1:])


def test_rounding_the_projection_moves_it_by_less_than_1e_7_pixel():
    grid = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 4096)
    for camera in ring(7, focal=2000.0, size=(4000, 3000)):
        matrix = grid_projection(camera, grid, extent_of(grid))
        voxels = np.random.default_rng(0).integers(0, 4096, (1000, 3))
        projected = np.column_stack((2 * voxels + 1, np.ones(1000))) @ matrix.T
        assert np.abs(projected[:, :2] / projected[:, 2:] - camera.project(grid.centres(voxels))[0]).max() < 1e-7


def test_footprint_holds_the_projected_cube_and_little_more():
    """The bound that the conservative rule uses, against the eight corners themselves."""
    grid = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 32)
    test = prepared(ring(5)[1:2], [np.ones((240, 320), bool)], grid)[0]
    voxels = np.random.default_rng(1).integers(0, 32, (500, 3))
    at = np.column_stack((2.0 * voxels + 1, np.ones(500)))
    u, v, w = test.matrix @ at.T
    centre = np.stack((u / w, v / w), axis=-1)
    half = (test._chord[:, 0] + test._chord[:, 1] * centre) / (w - np.abs(test.matrix[2, :3]).sum())[:, None]
    corners = 2 * voxels[:, None] + np.array([[x, y, z] for x in (0, 2) for y in (0, 2) for z in (0, 2)])
    projected = np.concatenate((corners, np.ones((500, 8, 1))), axis=-1) @ test.matrix.T
    needed = np.abs(projected[..., :2] / projected[..., 2:] - centre[:, None]).max(axis=1)
    assert (half >= needed - 1e-9).all()
    # The bound takes the nearest depth of the cube for all corners and, instead of its spread, the chord:
    # at most a tenth wider, a twentieth of a voxel.
    assert (half < 1.15 * needed).all()


@pytest.mark.parametrize("rule", ["conservative", "center"])
@pytest.mark.parametrize(("bounds", "voxels"), [(((-1, -1, -0.9), (1, 0.93, 1)), 61), (((-0.3, -0.7, -0.6), (0.7, 0.7, 0.9)), 150)])
def test_bricks_in_any_order_are_the_whole_bit_for_bit(rule, bounds, voxels):
    cameras, grid = ring(7), VoxelGrid.from_bounds(*bounds, voxels)
    shapes = [Ball((0.1, 0, 0), 0.6), Ball((-0.3, 0.3, 0.4), 0.3)]
    tests = prepared(cameras, [silhouette(c, shapes) for c in cameras], grid, rule)
    whole, counts = carve(tests, grid, tolerance=1)
    bricks = octree.bricks_of(grid, 16)
    assert len(bricks) > 8 and sum(np.prod(upper - lower) for lower, upper in bricks) == grid.count
    parts = [(brick[0], *carve(tests, grid, tolerance=1, brick=brick)) for brick in reversed(bricks)]
    for _, part, _ in parts:
        assert max(part.grid.shape) <= 32
    joined = SparseVolume.joined(grid, ((corner, part) for corner, part, _ in parts))
    np.testing.assert_array_equal(joined.brick_map, whole.brick_map)
    np.testing.assert_array_equal(joined.bricks, whole.bricks)
    assert sum(found.tests for _, _, found in parts) == counts.tests
    np.testing.assert_array_equal(sum(found.alone for _, _, found in parts), counts.alone)
