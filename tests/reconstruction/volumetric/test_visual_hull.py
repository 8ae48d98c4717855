# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull on analytic objects: never loses the object, has the shape geometry says, explains what is wrong."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.errors import ScanstageError
from addon.reconstruction.geometry import Camera, VoxelGrid, rotation_about
from addon.reconstruction.scan import Scan
from addon.reconstruction.volumetric.visual_hull import visual_hull, working_bounds
from tests.rigs import Ball, Box, camera_at, pixel_rays, ring, silhouette, views_of

CUBE = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 48)


def wholly_inside(grid: VoxelGrid, shapes) -> np.ndarray:
    """Return the dense volume of voxels whose eight corners lie in one of the (convex) shapes: a subset of the truth."""
    lattice = grid.origin + grid.voxel_size * np.stack(np.meshgrid(*(np.arange(n + 1) for n in grid.shape), indexing="ij"), -1)
    truth = np.zeros(grid.shape, bool)
    for shape in shapes:
        corners = shape.contains(lattice)
        for axis in range(3):
            corners = np.logical_and(np.take(corners, range(corners.shape[axis] - 1), axis),
                                     np.take(corners, range(1, corners.shape[axis]), axis))
        truth |= corners
    return truth


def random_scene(random: np.random.Generator, scale: int):
    """Return shapes in the unit cube and cameras anywhere outside it, with pictures ``scale`` times coarser than usual."""
    shapes = [Ball(tuple(random.uniform(-0.5, 0.5, 3)), random.uniform(0.1, 0.45)) for _ in range(random.integers(1, 4))]
    shapes += [Box(tuple(random.uniform(-0.4, 0.4, 3)), tuple(random.uniform(0.08, 0.4, 3)),
                   rotation_about(random.normal(size=3), random.uniform(0, 3))) for _ in range(random.integers(0, 3) if scale == 1 else 0)]
    cameras = []
    for _ in range(random.integers(2, 9)):
        direction = random.normal(size=3)
        cameras.append(camera_at(direction / np.linalg.norm(direction) * random.uniform(2.5, 5), random.uniform(-0.3, 0.3, 3),
                                 focal=random.uniform(150, 500) / scale, size=(320 // scale, 240 // scale)))
    return shapes, cameras


def covering(mask: np.ndarray) -> np.ndarray:
    """Return the mask that covers every partly covered pixel of a silhouette sampled at pixel centres."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)


def truth_voxels_removed(rule: str, seed: int, voxels: int, scale: int = 1) -> int:
    random = np.random.default_rng(seed)
    shapes, cameras = random_scene(random, scale)
    views = [replace(view, mask=covering(view.mask) if rule == "conservative" else view.mask) for view in views_of(cameras, shapes)]
    grid = VoxelGrid.from_bounds(random.uniform(-1.3, -1, 3), random.uniform(1, 1.3, 3), voxels)
    truth = wholly_inside(grid, shapes)
    hull = visual_hull(Scan(tuple(views)), grid, rule=rule).volume.dense()
    return int(np.count_nonzero(truth & ~hull))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2 ** 32 - 1), st.integers(6, 72), st.sampled_from([1, 4]))
def test_conservative_rule_never_removes_a_voxel_of_the_object(seed, voxels, scale):
    assert truth_voxels_removed("conservative", seed, voxels, scale) == 0


def test_the_same_test_fails_for_the_center_rule():
    """Guards the guard: with voxels of about a pixel, testing centres alone does cut into the object."""
    assert sum(truth_voxels_removed("center", seed, 72, scale=4) for seed in range(10)) > 0


def test_holds_the_center_rules_hull():
    views = tuple(views_of(ring(8), [Ball((0, 0, 0), 0.7)]))
    conservative, center = (visual_hull(Scan(views), CUBE, rule=rule).volume.dense() for rule in ("conservative", "center"))
    assert (conservative | ~center).all()
    assert conservative.sum() > center.sum()


@pytest.mark.parametrize("count, tangents", [(3, 6), (4, 4), (5, 10), (8, 8)])
def test_sphere_seen_orthographically_gives_the_circumscribed_polygon(count, tangents):
    """T7a: with parallel rays, P views on a ring leave the regular polygon of their distinct tangents."""
    radius, distance = 0.7, 2000.0
    cameras = ring(count, elevation=0, distance=distance, focal=distance * 200, size=(600, 600))
    grid = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 129)
    volume = visual_hull(Scan(tuple(views_of(cameras, [Ball((0, 0, 0), radius)]))), grid, rule="center").volume
    area = volume.dense()[:, :, 64].sum() * grid.voxel_size ** 2
    polygon = tangents * np.tan(np.pi / tangents) * radius ** 2
    # A pixel is 1/200 and samples the silhouette to half of that on each side: well within one layer of voxels.
    layer = 2 * tangents * np.tan(np.pi / tangents) * radius * grid.voxel_size
    assert abs(area - polygon) < layer
    assert abs(area - polygon) < 0.03 * polygon


def test_views_from_behind_add_nothing_but_do_no_harm():
    """Cameras inside the volume and cameras that look away cannot remove what they do not see."""
    shapes = [Ball((0, 0, 0), 0.5)]
    outside = views_of(ring(6), shapes)
    away = camera_at((0, 4, 0.1), (0, 9, 0.1))
    blind = views_of([away], shapes)[0]
    with_blind = visual_hull(Scan((*outside, blind)), CUBE, outside="unknown").volume.dense()
    assert np.array_equal(with_blind, visual_hull(Scan(tuple(outside)), CUBE).volume.dense())


def test_object_beyond_the_picture_is_kept_or_removed_as_told():
    camera = camera_at((0, -4, 0), focal=900)
    views = tuple(views_of([camera], [Box((0, 0, 0), (0.9, 0.2, 0.2), np.eye(3))]))
    kept = visual_hull(Scan(views), CUBE, outside="unknown").volume.dense()
    cut = visual_hull(Scan(views), CUBE, outside="empty").volume.dense()
    assert kept[0, 24, 24] and kept[-1, 24, 24] and cut[24, 24, 24]
    assert not cut[0, 24, 24] and not cut[-1, 24, 24]


def test_one_wrong_mask_is_forgiven_by_tolerance():
    views = views_of(ring(12), [Ball((0, 0, 0), 0.6)])
    views[5] = replace(views[5], mask=np.roll(views[5].mask, 70, axis=1))
    right = wholly_inside(CUBE, [Ball((0, 0, 0), 0.6)])
    strict, tolerant = (visual_hull(Scan(tuple(views)), CUBE, tolerance=n).volume.dense() for n in (0, 1))
    assert (right & ~strict).sum() > 0.1 * right.sum()
    assert not (right & ~tolerant).any()


def test_lens_distortion_is_undone():
    """A strongly distorted camera carves the same ball as a perfect one, to a voxel layer."""
    distortion = np.array([-0.25, 0.08, 0.002, -0.003, 0.0])
    shapes, views = [Ball((0.1, 0.1, 0), 0.6)], []
    for i, camera in enumerate(ring(10, focal=330.0)):
        bent = replace(camera, distortion=distortion)
        rays = cv2.undistortPointsIter(np.stack(np.meshgrid(np.arange(320.0), np.arange(240.0)), -1).reshape(-1, 1, 2), bent.K,
                                       distortion, None, None, (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12))
        directions = np.concatenate((rays[:, 0], np.ones((len(rays), 1))), axis=-1) @ camera.R
        mask = shapes[0].hit_by(camera.centre, directions).reshape(240, 320)
        views.append(replace(views_of([camera], shapes)[0], name=str(i), camera=bent, mask=covering(mask)))
    hull = visual_hull(Scan(tuple(views)), CUBE).volume.dense()
    assert not (wholly_inside(CUBE, shapes) & ~hull).any()
    perfect = visual_hull(Scan(tuple(replace(view, mask=covering(view.mask)) for view in views_of(ring(10, focal=330.0), shapes))),
                          CUBE).volume.dense()
    shell = 6 * (np.pi / 6) ** (1 / 3) * (6 * perfect.sum() / np.pi) ** (2 / 3) / 2  # a layer on a ball of that many voxels
    assert (hull ^ perfect).sum() < shell


def test_bounds_are_found_from_the_silhouettes():
    shapes = [Ball((0.2, -0.1, 0.3), 0.5)]
    found = working_bounds(Scan(tuple(views_of(ring(8, elevation=25), shapes))), rule="conservative", tolerance=0, outside="unknown")
    true = np.array([[-0.3, -0.6, -0.2], [0.7, 0.4, 0.8]])
    assert (found[0] <= true[0]).all() and (found[1] >= true[1]).all()
    assert ((found[1] - found[0]) < 1.6).all()  # the hull of a ring has caps above and below; the rest is a voxel or two
    given_ = working_bounds(Scan(tuple(views_of(ring(3), shapes)), np.array([[0, 0, 0], [1, 2, 3]])), rule="conservative",
                            tolerance=0, outside="unknown")
    assert np.array_equal(given_, [[0, 0, 0], [1, 2, 3]])


def test_bounds_that_the_views_do_not_give_are_asked_for():
    one = views_of([camera_at((0, -4, 0))], [Ball((0, 0, 0), 0.5)])
    with pytest.raises(ScanstageError, match="--bounds"):
        working_bounds(Scan(tuple(one)), rule="conservative", tolerance=0, outside="unknown")
    views = views_of(ring(4), [Ball((0, 0, 0), 0.2)])
    views[1] = replace(views[1], camera=replace(views[1].camera, t=views[1].camera.t + [1.5, 0, 0]))
    with pytest.raises(ScanstageError, match="no point in common"):
        working_bounds(Scan(tuple(views)), rule="conservative", tolerance=0, outside="unknown")


def test_the_view_that_empties_the_volume_is_named():
    views = views_of(ring(4), [Ball((0, 0, 0), 0.5)])
    views[2] = replace(views[2], mask=np.zeros_like(views[2].mask))
    with pytest.raises(ScanstageError, match="frame 0002 alone empties"):
        visual_hull(Scan(tuple(views)), VoxelGrid.from_bounds((-0.4, -0.4, -0.4), (0.4, 0.4, 0.4), 32))


@pytest.mark.parametrize("views, words", [((), "no views"), ((replace(views_of(ring(1), [Ball((0, 0, 0), 1)])[0], mask=None),),
                                                             "frame 0000 has no silhouette")])
def test_without_views_or_masks(views, words):
    with pytest.raises(ScanstageError, match=words):
        visual_hull(Scan(views), CUBE)


def warnings_for(views, grid=CUBE):
    return " | ".join(visual_hull(Scan(tuple(views)), grid).report["warnings"])


def test_warns_of_mirrored_and_non_metric_calibrations():
    shapes = [Ball((0, 0, 0), 0.5)]
    assert warnings_for(views_of(ring(6), shapes)) == ""
    mirror = np.diag([1.0, 1.0, -1.0])
    mirrored = [replace(view, camera=replace(view.camera, R=view.camera.R @ mirror)) for view in views_of(ring(6), shapes)]
    assert "mirrored in 6 of 6 views" in warnings_for(mirrored)
    sheared = [Camera(view.camera.K + np.array([[0, 40, 0], [0, 0, 0], [0, 0, 0]]), view.camera.R, view.camera.t, view.camera.size)
               for view in views_of(ring(6), shapes)]
    views = [replace(view, camera=camera, mask=silhouette(camera, shapes)) for view, camera in
             zip(views_of(ring(6), shapes), sheared, strict=True)]
    assert "not metric in 6 of 6" in warnings_for(views)


def test_warns_of_cut_objects():
    shapes = [Ball((0, 0, 0), 0.5)]
    close = [camera_at((0, -1.2, 0), focal=400), *ring(5)]
    assert "leaves the picture in 1 of 6 views (first: 0000)" in warnings_for(views_of(close, shapes))


def test_warns_when_pictures_are_too_coarse_for_the_voxels():
    shapes = [Ball((0, 0, 0), 0.5)]
    fine = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 200)  # 450 px at 4 m: 1.1 px a voxel
    assert "a voxel spans 1.1 pixels in frame 0000" in warnings_for(views_of(ring(6), shapes), fine)
    assert visual_hull(Scan(tuple(views_of(ring(6), shapes))), fine, rule="center").report["warnings"] == []


def test_report_counts_the_work():
    report = visual_hull(Scan(tuple(views_of(ring(6), [Ball((0, 0, 0), 0.5)]))), CUBE).report["counts"]
    assert report["tests_dense"] == 48 ** 3 * 6
    assert 0 < report["tests"] < report["tests_dense"]


def test_pixel_rays_pass_through_pixels():
    """Guards the oracle: the masks of these tests rest on it."""
    camera = camera_at((1, 2, 3))
    pixels, depth = camera.project(camera.centre + 2 * pixel_rays(camera))
    assert np.allclose(depth, 2) and np.allclose(pixels[17, 42], (42, 17))
