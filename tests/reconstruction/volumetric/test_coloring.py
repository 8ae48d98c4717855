# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of balls whose pictures are formulas: rays against spheres, colours by place, magenta beyond them."""

import cv2
import numpy as np
import pytest

from addon.errors import Cancelled
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.scan import View
from addon.reconstruction.volumetric.coloring import NEUTRAL, color_surface
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from tests.rigs import Ball, camera_at, pixel_rays, ring

MAGENTA = (1.0, 0.0, 1.0)
RED, GREEN, BLUE, YELLOW = (0.7, 0.1, 0.05), (0.1, 0.6, 0.2), (0.0, 0.0, 0.9), (0.8, 0.6, 0.0)
BALL = Ball((0.0, 0.0, 0.0), 0.8)
GRID = VoxelGrid((-1.0, -1.0, -1.0), 2 / 48, (48, 48, 48))
H = GRID.voxel_size


def halves(points):
    return np.where(points[..., :1] > 0, RED, GREEN)


def gradient(points):
    return 0.5 + 0.4 * points


def photograph(camera, painted):
    """Return picture and mask of balls, each with a function from surface points to colours."""
    rays, nearest = pixel_rays(camera), np.full(camera.size[::-1], np.inf)
    picture = np.broadcast_to(MAGENTA, (*nearest.shape, 3)).copy()
    for ball, paint in painted:
        offset = camera.centre - np.array(ball.centre)
        a, b = (rays * rays).sum(-1), rays @ offset
        root = b * b - a * (offset @ offset - ball.radius ** 2)
        time = (-b - np.sqrt(np.maximum(root, 0))) / a
        hit = (root > 0) & (time < nearest)
        nearest[hit] = time[hit]
        picture[hit] = paint(camera.centre + rays[hit] * time[hit][:, None])
    return picture.astype(np.float32), np.isfinite(nearest)


def views_of(cameras, painted):
    views = []
    for number, camera in enumerate(cameras):
        picture, mask = photograph(camera, painted)
        views.append(View(f"{number:04d}", camera, mask, lambda picture=picture: picture))
    return views


def surface_of(balls, *, grown=0.0):
    centres = GRID.centres(np.stack(np.indices(GRID.shape), -1))
    occupancy = np.any([Ball(ball.centre, ball.radius + grown).contains(centres) for ball in balls], axis=0)
    return extract_surface(SparseVolume.from_dense(GRID, occupancy))


def above_and_below(count, **camera):
    return ring(count // 2, elevation=35, **camera) + ring(count // 2, elevation=-35, **camera)


@pytest.mark.parametrize("focal", [250, 1100])  # one pixel a voxel, and more than the pictures are read at
def test_a_ball_of_two_colours_gets_both_and_nothing_else(focal):
    surface = surface_of([BALL])
    views = views_of(above_and_below(12, focal=focal, size=(focal + 69, focal - 9)), [(BALL, halves)])
    colors = color_surface(surface, GRID, views)
    assert colors.rgb.dtype == np.float32 and colors.views.dtype == np.uint16
    assert colors.rgb.shape == surface.voxels.shape and colors.views.shape == (len(surface.voxels),)
    x = GRID.centres(surface.voxels)[:, :1]
    # A voxel's point lies within a voxel's diagonal of the ball, and pictures are read over two pixels of half a voxel:
    # four voxels from the seam all that can be read is one colour, to the rounding of float32.
    clear = np.abs(x[:, 0]) > 4 * H
    np.testing.assert_allclose(colors.rgb[clear], halves(x)[clear], atol=1e-5)
    low, high = np.minimum(RED, GREEN) - 1e-5, np.maximum(RED, GREEN) + 1e-5
    assert ((colors.rgb >= low) & (colors.rgb <= high)).all()  # at the seam a mixture, but never background


@pytest.mark.parametrize("focal", [250, 700, 1100])
def test_pictures_are_read_where_the_voxels_are(focal):
    """A colour that is a place: half a pixel of displacement anywhere would show."""
    surface = surface_of([BALL])
    # Widths and heights that no reduction divides.
    views = views_of(above_and_below(12, focal=focal, size=(focal + 69, focal - 9)), [(BALL, gradient)])
    colors = color_surface(surface, GRID, views)
    points = GRID.centres(surface.voxels)
    points *= BALL.radius / np.linalg.norm(points, axis=1, keepdims=True)
    error = np.abs(colors.rgb - gradient(points))
    # The voxels' points are up to a diagonal's half, 0.87 voxels, off the ball; seen at up to 45 degrees on the whole
    # (of 12 views the best five weigh most), that is as much sideways. The gradient is 0.4 for each unit of length.
    assert error.max() < 0.4 * 1.2 * H
    # Displacements of both signs cancel out on average over the ball, whichever way a misalignment would go.
    facing_front = points[:, 1] < -0.3
    bias = (colors.rgb - gradient(points))[facing_front].mean(axis=0)
    assert np.abs(bias).max() < 0.4 * 0.25 * H


FRONT, BACK = Ball((0.5, 0.0, 0.1), 0.14), Ball((-0.35, 0.0, 0.0), 0.5)
PAINTED = [(FRONT, lambda points: np.broadcast_to(BLUE, points.shape)),
           (BACK, lambda points: np.broadcast_to(YELLOW, points.shape))]


@pytest.mark.parametrize("focal", [450, 60])  # five pixels a voxel, and two thirds of a pixel
def test_what_is_hidden_does_not_take_the_colour_of_what_hides_it(focal):
    # The volume contains the object, as a hull does: half a voxel's diagonal more all round.
    surface = surface_of([FRONT, BACK], grown=0.87 * H)
    cameras = [camera_at((4, y, 0.4), focal=focal) for y in (-0.35, 0.0, 0.3)]
    colors = color_surface(surface, GRID, views_of(cameras, PAINTED))
    on_back = BACK.contains(GRID.centres(surface.voxels) * 0.8 + 0.2 * np.array(BACK.centre))
    assert 1000 < on_back.sum() < len(surface.voxels) - 50
    grey = (colors.rgb == np.float32(NEUTRAL)).all(axis=1)
    yellow = np.abs(colors.rgb - YELLOW).max(axis=1) < 1e-5
    assert yellow[on_back].sum() > 100
    assert (grey | yellow)[on_back].all()


def test_a_view_sees_round_what_hides_and_not_through_it():
    surface = surface_of([FRONT, BACK], grown=0.87 * H)
    camera = camera_at((4, 0.0, 0.4))
    colors = color_surface(surface, GRID, views_of([camera], PAINTED))
    centres = GRID.centres(surface.voxels)
    to_eye = camera.centre - centres
    on_back = BACK.contains(centres * 0.8 + 0.2 * np.array(BACK.centre))
    hidden = on_back & _blocked(FRONT, centres, to_eye)
    assert hidden.sum() > 30
    assert (colors.views[hidden] == 0).all()
    normals = (centres - BACK.centre) / np.linalg.norm(centres - BACK.centre, axis=1, keepdims=True)
    cosine = (normals * to_eye).sum(1) / np.linalg.norm(to_eye, axis=1)
    lit = on_back & (cosine > 0.55) & ~_blocked(Ball(FRONT.centre, FRONT.radius + 3 * H), centres, to_eye)
    assert lit.sum() > 30  # three voxels from the shadow, and not at the outline either
    assert (colors.views[lit] == 1).all()


def _blocked(ball, points, directions):
    """Return whether rays from (n, 3) points along (n, 3) directions meet a ball."""
    to_centre = np.array(ball.centre) - points
    along = (to_centre * directions).sum(1) / np.linalg.norm(directions, axis=1)
    return ((to_centre ** 2).sum(1) - along ** 2 < ball.radius ** 2) & (along > 0)


def test_background_that_a_lens_mixes_in_is_not_read():
    """Pictures blurred by a pixel each way: what is two pixels inside the mask is pure."""
    surface = surface_of([BALL])
    views = []
    for view in views_of(above_and_below(12, focal=300), [(BALL, lambda points: np.broadcast_to(GREEN, points.shape))]):
        blurred = cv2.blur(view.read_image(), (3, 3))
        assert np.abs(blurred - GREEN)[view.mask].max() > 0.2
        views.append(View(view.name, view.camera, view.mask, lambda blurred=blurred: blurred))
    colors = color_surface(surface, GRID, views)
    # Of twelve cameras all round, every point of the ball faces one well enough to lie far from its outline.
    assert (colors.views > 0).all()
    np.testing.assert_allclose(colors.rgb, np.tile(np.float32(GREEN), (len(colors.rgb), 1)), atol=1e-5)


def test_one_wrong_picture_of_twelve_changes_nothing():
    surface = surface_of([BALL])
    views = views_of(above_and_below(12), [(BALL, gradient)])
    wrong = list(views)
    white = np.ones_like(views[4].read_image())
    wrong[4] = View("wrong", views[4].camera, np.ones_like(views[4].mask), lambda: white)
    right, disturbed = color_surface(surface, GRID, views), color_surface(surface, GRID, wrong)
    points = GRID.centres(surface.voxels)
    both = (right.views > 0) & (disturbed.views > 0)
    assert both.mean() > 0.99
    error = np.abs(disturbed.rgb - gradient(points * BALL.radius / np.linalg.norm(points, axis=1, keepdims=True)))
    # The bound of the gradient above, doubled for those who lost their best view; white would be off by up to 0.8.
    assert error[both].max() < 0.4 * 2.4 * H
    assert (disturbed.views <= right.views).all()
    assert disturbed.views.sum() < right.views.sum()  # the wrong view is not counted


def test_noise_is_averaged_not_rejected():
    surface, noise = surface_of([BALL]), np.random.default_rng(3)
    views = []
    for view in views_of(above_and_below(12), [(BALL, lambda points: np.broadcast_to(GREEN, points.shape))]):
        noisy = view.read_image() + noise.normal(0, 0.05, view.read_image().shape).astype(np.float32)
        views.append(View(view.name, view.camera, view.mask, lambda noisy=noisy: noisy))
    colors = color_surface(surface, GRID, views)
    seen = colors.views >= 5
    residual = (colors.rgb - GREEN)[seen]
    # The mean of five or so samples that are themselves blends of pixels: under 0.05 / sqrt(2), and not shifted.
    assert residual.std() < 0.05 / np.sqrt(2)
    assert np.abs(residual.mean()) < 0.002
    # No view is thrown out for its noise: what faces the upper ring's middle is seen by most of its cameras.
    assert np.median(colors.views) >= 4


def test_views_counts_the_views_that_see_a_voxel():
    surface = surface_of([BALL])
    cameras = above_and_below(12)
    colors = color_surface(surface, GRID, views_of(cameras, [(BALL, gradient)]))
    points = GRID.centres(surface.voxels)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    cosines = []
    for camera in cameras:
        towards = camera.centre - points
        cosines.append((normals * towards).sum(1) / np.linalg.norm(towards, axis=1))
    # Normals of voxels are up to 25 degrees off, and steps of a voxel may hide what lies flat: clearly turned towards
    # a camera (60 degrees) is seen, clearly turned away is not.
    assert (colors.views >= (np.array(cosines) > 0.5).sum(0)).all()
    assert (colors.views <= (np.array(cosines) > -0.3).sum(0)).all()


def test_what_no_view_sees_is_grey():
    surface = surface_of([BALL])
    colors = color_surface(surface, GRID, views_of(ring(6, elevation=50), [(BALL, halves)]))
    z = GRID.centres(surface.voxels)[:, 2]
    unseen = colors.views == 0
    # Cameras at 50 degrees see no part of a ball whose normal is more than 40 degrees below the horizon.
    bottom = z < -0.8 * np.sin(np.radians(60))
    assert unseen[bottom].all() and not unseen[z > 0].any()
    np.testing.assert_array_equal(colors.rgb[bottom], np.full((bottom.sum(), 3), NEUTRAL, np.float32))
    # The rim of what is seen lends its colour two voxels deep, and to no more.
    lent = unseen & (colors.rgb != np.float32(NEUTRAL)).any(axis=1)
    assert lent.any()
    lowest_seen = z[~unseen].min()
    assert z[lent].min() > lowest_seen - 5 * H


@pytest.mark.parametrize("number", [0, 1])
def test_few_views_and_views_without_masks_will_do(number):
    surface = surface_of([BALL])
    views = [View(view.name, view.camera, None, view.read_image)
             for view in views_of(ring(2), [(BALL, halves)])[:number]]
    colors = color_surface(surface, GRID, views)
    assert (colors.views > 0).any() == (number > 0)
    assert np.isfinite(colors.rgb).all()
    if not number:
        np.testing.assert_array_equal(colors.rgb, np.full(colors.rgb.shape, NEUTRAL, np.float32))


def test_an_empty_surface_has_no_colours():
    surface = surface_of([Ball((9.0, 9.0, 9.0), 0.1)])
    colors = color_surface(surface, GRID, views_of(ring(2), [(BALL, halves)]))
    assert colors.rgb.shape == (0, 3) and colors.views.shape == (0,)


def test_progress_names_the_view_and_can_stop_the_work():
    surface, views = surface_of([BALL]), views_of(ring(3), [(BALL, halves)])
    seen = []
    color_surface(surface, GRID, views, lambda fraction, message: seen.append((fraction, message)))
    assert [fraction for fraction, _ in seen] == sorted(fraction for fraction, _ in seen) and seen[-1][0] == 1
    assert all(any(view.name in message for _, message in seen) for view in views)

    def stop(fraction, message):
        raise Cancelled

    with pytest.raises(Cancelled):
        color_surface(surface, GRID, views, stop)


def test_no_samples_is_refused():
    with pytest.raises(ValueError, match="samples"):
        color_surface(surface_of([BALL]), GRID, [], samples=0)
