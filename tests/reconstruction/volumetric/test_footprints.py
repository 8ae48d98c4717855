# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Footprints: where voxels are seen, what is read there, and that nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.scan import View
from addon.reconstruction.volumetric.footprints import Pictures, straightened
from tests.rigs import Ball, camera_at, marbled, painted_views, pixel_rays, ring

BALL = Ball((0.1, -0.05, 0.05), 0.7)
GRID = VoxelGrid((-0.9, -0.9, -0.8), 0.1, (18, 18, 17))
CENTRES = np.stack(np.indices(GRID.shape), -1).reshape(-1, 3) + 0.5


def coordinates(pictures, row, view):
    """Return column and row in a view's own picture."""
    width = pictures.cameras[view].size[0]
    return np.stack(((row - pictures.offset[view]) % width, (row - pictures.offset[view]) // width), -1)


def test_voxels_are_located_in_the_pixels_that_hold_their_projections():
    views = painted_views(ring(3), [BALL], marbled)
    pictures = Pictures.of(views, GRID)
    rows = pictures.locate(CENTRES)
    for view, camera in enumerate(pictures.cameras):
        expected = np.rint(camera.project(GRID.centres(CENTRES - 0.5))[0])
        inside = (expected >= 0).all(1) & (expected < camera.size).all(1)
        off = np.abs(coordinates(pictures, rows[view], view) - expected)[inside]
        # float32 may round a point on the edge between two pixels to either
        assert off.max() <= 1 and np.count_nonzero(off) <= 1e-3 * off.size
        assert not pictures.rgba[rows[view][~inside]].any()


def test_samples_are_the_colours_of_the_picture_and_empty_beyond_the_mask():
    views = painted_views(ring(4, focal=100, size=(100, 80)), [BALL], marbled)  # not reduced
    found = Pictures.of(views, GRID, border=0)
    samples = found.at(found.locate(CENTRES))
    for number, view in enumerate(views):
        pixel = np.rint(view.camera.project(GRID.centres(CENTRES - 0.5))[0]).astype(int)
        pixel = np.clip(pixel, 0, np.array(view.camera.size) - 1)
        seen, picture = view.mask[pixel[:, 1], pixel[:, 0]], view.read_image()[pixel[:, 1], pixel[:, 0]]
        agree = samples.seen[number] == seen
        assert agree.mean() > 0.999
        both = agree & seen
        close = np.abs(samples.rgba[number, both, :3] - picture[both]).max(1) < 1e-6
        assert close.mean() > 0.999
        assert not samples.rgba[number, ~samples.seen[number]].any()
    assert np.array_equal(samples.views, samples.seen.sum(0))


def test_variance_is_that_of_the_window():
    noise = np.random.default_rng(4).random((60, 80, 3)).astype(np.float32)
    camera = camera_at((0, -4, 0), focal=60, size=(80, 60))
    pictures = Pictures.of([View("a", camera, None, lambda: noise)], GRID)
    samples = pictures.at(pictures.locate(CENTRES[:1]))
    u, v = np.rint(camera.project(GRID.centres(CENTRES[0] - 0.5))[0]).astype(int)
    np.testing.assert_allclose(samples.variance[0, 0], noise[v - 1:v + 2, u - 1:u + 2].var(axis=(0, 1)), rtol=1e-4)
    assert samples.pixels[0, 0] == 9


def test_large_pixels_are_means_and_share_nothing_with_the_background():
    views = painted_views(ring(1, focal=1600, size=(1000, 800)), [BALL], lambda points: np.full(points.shape, 0.25))
    pictures = Pictures.of(views, GRID)
    assert pictures.cameras[0].size[0] < 100  # 40 pixels a voxel become 2
    seen = pictures.rgba[:, 3] > 0
    np.testing.assert_allclose(pictures.rgba[seen], np.tile([0.25, 0.25, 0.25, 1], (seen.sum(), 1)), atol=1e-6)


def test_nothing_is_seen_behind_a_camera():
    camera = camera_at((0, 0, 0), (1, 0, 0))
    picture = np.ones((240, 320, 3), np.float32)
    pictures = Pictures.of([View("a", camera, None, lambda: picture)], GRID)
    samples = pictures.at(pictures.locate(CENTRES))
    assert not samples.seen[0, GRID.centres(CENTRES - 0.5)[:, 0] < 0].any() and samples.seen.any()


@pytest.mark.parametrize("k1", [-0.2, 0.15])
def test_a_lens_is_straightened(k1):
    camera = replace(camera_at((0, -4, 0), focal=300), distortion=(k1, 0.02, 0.001, -0.002, 0))
    # a picture that says where it was taken: the pixel's own ideal ray
    ideal = pixel_rays(replace(camera, distortion=np.zeros(5)))
    points = camera.centre + ideal
    u, v = np.moveaxis(camera.project(points)[0], -1, 0)
    columns, rows = np.meshgrid(np.arange(320.0), np.arange(240.0))
    picture = np.stack((columns, rows, 0 * rows, 1 + 0 * rows), -1).astype(np.float32)
    image, pinhole = straightened(picture, camera)
    inside = (u > 1) & (v > 1) & (u < 318) & (v < 238) & (image[..., 3] > 0.999)
    assert inside.mean() > 0.8 and not pinhole.distorted
    # remap interpolates in steps of 1/32 pixel
    np.testing.assert_allclose(image[inside][:, :2], np.stack((u, v), -1)[inside], atol=0.04)
