# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The item buffer against a ray caster that walks from voxel to voxel, and against silhouettes that are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.reconstruction.geometry import Camera, VoxelGrid, distort
from addon.reconstruction.scan import View
from addon.reconstruction.volumetric import item_buffer as module
from addon.reconstruction.volumetric.item_buffer import face_buffer, item_buffer, reprojection_iou, silhouette_of
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from tests.rigs import black_picture, camera_at, pixel_rays

GRID = VoxelGrid((-1.0, -1.2, -0.8), 0.1, (20, 24, 16))
STRONG_BARREL = (-0.25, 0.08, 0.004, -0.003, -0.01)


def surface_of(occupancy, grid=GRID):
    return extract_surface(SparseVolume.from_dense(grid, occupancy))


def first_voxels(occupancy: np.ndarray, grid: VoxelGrid, eye: np.ndarray, rays: np.ndarray):
    """Walk rays (n, 3) from outside through the grid (Amanatides & Woo, 1987): first occupied voxel or -1, and depth.

    Depth is in units of the rays' lengths. All rays take a step at once; each leaves its voxel through the nearest of
    the three planes ahead.
    """
    origin = (eye - grid.origin) / grid.voxel_size
    step = rays / grid.voxel_size
    shape = np.array(grid.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        planes = np.stack(((0 - origin) / step, (shape - origin) / step))
    enter = np.maximum(planes.min(axis=0).max(axis=1), 0)
    alive = enter < planes.max(axis=0).min(axis=1)
    voxel = np.clip(np.floor(origin + enter[:, None] * step), 0, shape - 1).astype(int)
    time = enter.copy()
    found, depth = np.full((len(rays), 3), -1), np.full(len(rays), np.inf)
    while alive.any():
        inside = np.where(alive[:, None], voxel, 0)
        hit = alive & occupancy[tuple(inside.T)]
        found[hit], depth[hit] = voxel[hit], time[hit]
        alive &= ~hit
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = np.where(step != 0, (voxel + (step > 0) - origin) / step, np.inf)
        axis = ahead.argmin(axis=1)
        row = np.arange(len(rays))
        time = ahead[row, axis]
        voxel[row, axis] += np.where(step[row, axis] > 0, 1, -1)
        alive &= ((voxel >= 0) & (voxel < shape)).all(axis=1)
    return found, depth


def check_against_rays(occupancy, camera, rays, share):
    surface = surface_of(occupancy)
    items, depth = item_buffer(surface, GRID, camera)
    assert items.shape == depth.shape == camera.size[::-1]
    assert items.dtype == np.int32 and depth.dtype == np.float32
    found, expected = first_voxels(occupancy, GRID, camera.centre, rays.reshape(-1, 3))
    mine = np.where(items.ravel()[:, None] >= 0, surface.voxels[items.ravel()], -1)
    agree = (mine == found).all(axis=1)
    assert agree.mean() >= share
    both = agree & (found[:, 0] >= 0)
    assert both.any()
    # float32 keeps seven digits.
    np.testing.assert_allclose(depth.ravel()[both], expected[both], rtol=2e-7)
    np.testing.assert_array_equal(np.isinf(depth), items < 0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2 ** 32 - 1), st.sampled_from((0.02, 0.2, 0.7)), st.floats(0, 6.28), st.floats(-1.2, 1.2),
       st.floats(30, 600))
def test_every_pixel_sees_what_its_ray_meets_first(seed, filling, azimuth, elevation, focal):
    """From voxels of a third of a pixel to voxels of fifteen, all pixels but those whose rays graze an edge."""
    occupancy = np.random.default_rng(seed).random(GRID.shape) < filling
    direction = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    camera = camera_at(4 * direction, (0.013, -0.007, 0.003), focal=focal, size=(96, 72))
    # Both compute in float64, so that only a ray within 1e-12 of an edge can go two ways: one pixel is allowed.
    check_against_rays(occupancy, camera, pixel_rays(camera), 1 - 1 / (96 * 72))


def test_rays_along_the_planes_of_the_grid_are_no_trouble():
    """The middle row and column of an odd picture run exactly along the axes; the eye lies within a cell's side."""
    occupancy = np.random.default_rng(4).random(GRID.shape) < 0.1
    camera = camera_at((4, 0.03141, 0.0427), (0, 0.03141, 0.0427), focal=91.7, size=(97, 73))
    assert (pixel_rays(camera)[36, 48, 1:] == 0).all()
    check_against_rays(occupancy, camera, pixel_rays(camera), 1)


def test_a_lens_bends_the_rays():
    occupancy = np.random.default_rng(5).random(GRID.shape) < 0.15
    camera = replace(camera_at((3, -2.4, 1.7), focal=130, size=(160, 120)), distortion=STRONG_BARREL)
    # The rays are found by bisection-free Newton steps of our own, from the forward model alone.
    target = pixel_rays(replace(camera, K=camera.K, R=np.eye(3), t=np.zeros(3)))[..., :2].reshape(-1, 2)
    ideal = target.copy()
    for _ in range(30):
        base = distort(ideal, camera.distortion)
        jacobian = np.stack([(distort(ideal + 1e-6 * axis, camera.distortion) - base) / 1e-6 for axis in np.eye(2)], -1)
        ideal -= np.linalg.solve(jacobian, (base - target)[..., None])[..., 0]
    rays = np.column_stack((ideal, np.ones(len(ideal)))) @ camera.R
    assert np.abs(ideal - target).max() * 130 > 10  # the lens matters: more than ten pixels in the corners
    surface = surface_of(occupancy)
    items, _ = item_buffer(surface, GRID, camera)
    found, _ = first_voxels(occupancy, GRID, camera.centre, rays)
    agree = (np.where(items.ravel()[:, None] >= 0, surface.voxels[items.ravel()], -1) == found).all(axis=1)
    # OpenCV's inverse is accepted up to 0.01 px; edges of voxels of some 4 px cross about every second pixel, and a
    # ray that is 0.01 px off changes sides at a few in a thousand of those.
    assert agree.mean() > 0.995


def test_a_mirrored_camera_sees_the_mirror_image():
    occupancy = np.random.default_rng(6).random(GRID.shape) < 0.1
    camera = camera_at((3.1, 1.3, 0.9), focal=100, size=(96, 72))
    mirror = Camera(camera.K, np.diag([-1.0, 1, 1]) @ camera.R, np.diag([-1.0, 1, 1]) @ camera.t, camera.size)
    surface = surface_of(occupancy)
    items, depth = item_buffer(surface, GRID, camera)
    mirrored, mirrored_depth = item_buffer(surface, GRID, mirror)
    np.testing.assert_array_equal(mirrored, items[:, ::-1])  # the principal point is the middle of the picture
    np.testing.assert_array_equal(mirrored_depth, depth[:, ::-1])


def test_the_face_that_is_seen_is_turned_to_the_camera():
    occupancy = np.random.default_rng(7).random(GRID.shape) < 0.3
    surface = surface_of(occupancy)
    camera = camera_at((2.1, -2.9, 1.4), focal=150, size=(96, 72))
    faces, _ = face_buffer(surface, GRID, camera)
    items, _ = item_buffer(surface, GRID, camera)
    seen = faces[faces >= 0]
    np.testing.assert_array_equal(items[faces >= 0], surface.face_voxel[seen])
    np.testing.assert_array_equal(items < 0, faces < 0)
    middle = surface.vertices[surface.quads[seen]].mean(axis=1)
    assert (((camera.centre - middle) * surface.face_normals()[seen]).sum(axis=1) > 0).all()


def test_nothing_is_seen_behind_the_camera_or_of_nothing():
    surface = surface_of(np.ones(GRID.shape, bool))
    away = camera_at((4, 0, 0), (8, 0, 0), size=(32, 24))
    empty = surface_of(np.zeros(GRID.shape, bool))
    for case, camera in ((surface, away), (empty, camera_at((4, 0, 0), size=(32, 24)))):
        items, depth = item_buffer(case, GRID, camera)
        assert (items == -1).all() and np.isinf(depth).all()
        assert not silhouette_of(case, GRID, camera).any()


def test_the_result_does_not_depend_on_the_size_of_parts(monkeypatch):
    surface = surface_of(np.random.default_rng(8).random(GRID.shape) < 0.3)
    camera = camera_at((2.1, -2.9, 1.4), focal=300, size=(96, 72))
    whole = item_buffer(surface, GRID, camera)
    monkeypatch.setattr(module, "CANDIDATES", 50)
    monkeypatch.setattr(module, "FACES", 300)
    for one, other in zip(whole, item_buffer(surface, GRID, camera), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_silhouette_of_a_box_is_the_hull_of_its_corners():
    occupancy = np.zeros(GRID.shape, bool)
    occupancy[3:17, 5:11, 2:14] = True
    camera = camera_at((2.6, 2.2, 1.1), focal=170, size=(160, 120))
    corners = GRID.origin + 0.1 * np.array([(x, y, z) for x in (3, 17) for y in (5, 11) for z in (2, 14)])
    hull = cv2.convexHull(camera.project(corners)[0].astype(np.float32))[:, 0]
    rows, columns = np.mgrid[:120, :160]
    edges = np.roll(hull, -1, axis=0) - hull
    side = np.stack([ex * (rows - y) - ey * (columns - x) for (x, y), (ex, ey) in zip(hull, edges, strict=True)])
    inside = (side >= 0).all(axis=0) | (side <= 0).all(axis=0)
    on_edge = (np.abs(side) / np.hypot(*edges.T)[:, None, None]).min(axis=0) < 1e-4  # the hull is float32
    found = silhouette_of(surface_of(occupancy), GRID, camera)
    np.testing.assert_array_equal(found | on_edge, inside | on_edge)
    np.testing.assert_array_equal(found, item_buffer(surface_of(occupancy), GRID, camera)[0] >= 0)


def test_reprojection_iou_is_the_overlap_of_the_two_silhouettes():
    occupancy = np.zeros(GRID.shape, bool)
    occupancy[4:16, 4:20, 4:12] = True
    surface, camera = surface_of(occupancy), camera_at((3, 1.5, 1), focal=250, size=(160, 120))
    mask = silhouette_of(surface, GRID, camera)
    assert reprojection_iou(surface, GRID, View("a", camera, mask, black_picture)) == 1
    half = mask.copy()
    half[:, :80] = False
    overlap = reprojection_iou(surface, GRID, View("a", camera, half, black_picture))
    assert overlap == pytest.approx(half.sum() / mask.sum())
    nothing, empty = View("a", camera, np.zeros_like(mask), black_picture), surface_of(np.zeros(GRID.shape, bool))
    assert reprojection_iou(surface, GRID, nothing) == 0
    assert reprojection_iou(empty, GRID, nothing) == 1


@pytest.mark.parametrize("scale", [0.5, 0.3])
def test_reprojection_iou_at_a_smaller_scale_differs_by_the_outline(scale):
    occupancy = np.zeros(GRID.shape, bool)
    occupancy[4:16, 4:20, 4:12] = True
    surface, camera = surface_of(occupancy), camera_at((3, 1.5, 1), focal=500, size=(319, 241))
    mask = silhouette_of(surface, GRID, camera)
    small = silhouette_of(surface, GRID, camera.scaled(scale))
    outline = np.count_nonzero(small & ~cv2.erode(small.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool))
    iou = reprojection_iou(surface, GRID, View("a", camera, mask, black_picture), scale=scale)
    # Nearest sampling moves the mask's outline by up to half a pixel of the full picture, so less than one small pixel
    # along the outline can change sides; a shift of a whole small pixel would change twice that.
    assert 1 - iou < 0.5 * outline / small.sum()


def test_reprojection_iou_needs_a_mask_and_a_scale():
    surface, camera = surface_of(np.ones(GRID.shape, bool)), camera_at((3, 1.5, 1), size=(32, 24))
    with pytest.raises(ValueError, match="no mask"):
        reprojection_iou(surface, GRID, View("a", camera, None, black_picture))
    with pytest.raises(ValueError, match="scale"):
        reprojection_iou(surface, GRID, View("a", camera, np.ones((24, 32), bool), black_picture), scale=2.0)
