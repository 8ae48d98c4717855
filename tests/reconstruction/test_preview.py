# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview shows the object: whole, in the middle, in its colours, lit from the upper left, on a soft backdrop."""

from dataclasses import replace

import numpy as np
import pytest

from addon.reconstruction.geometry import VoxelGrid, rotation_about
from addon.reconstruction.preview import render_preview, upward
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from tests.rigs import ring

SIZE = (240, 180)


def surface_of(occupancy, grid):
    return extract_surface(SparseVolume.from_dense(grid, occupancy))


@pytest.fixture(scope="module")
def ball():
    grid = VoxelGrid((2.0, -7.0, 0.5), 0.05, (40, 40, 40))
    where = np.indices(grid.shape) + 0.5 - 20
    return surface_of((where ** 2).sum(axis=0) < 18 ** 2, grid), grid


def painted(surface, color):
    return np.tile(np.array(color, np.float32), (len(surface.voxels), 1))


def saturated(picture, channel):
    """Return where a channel stands out from the two others; the backdrop is all but grey."""
    channels = picture.astype(int)
    return channels[..., channel] - np.delete(channels, channel, axis=-1).max(axis=-1) > 60


def test_a_red_ball_is_a_red_disc_in_the_middle(ball):
    picture = render_preview(*ball, painted(ball[0], (0.8, 0.02, 0.02)), size=SIZE)
    assert picture.shape == (180, 240, 3) and picture.dtype == np.uint8
    rows, columns = np.nonzero(saturated(picture, 0))
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    # The object fills 74 percent of the smaller side, and a ball is as wide as it is high: to a voxel, 3 pixels here,
    # and the darkest rim that is not counted.
    assert height == pytest.approx(0.74 * 180, abs=6)
    assert width == pytest.approx(height, abs=6)
    assert rows.mean() == pytest.approx(89.5, abs=3) and columns.mean() == pytest.approx(119.5, abs=3)
    assert len(rows) == pytest.approx(np.pi / 4 * height * width, rel=0.03)


def test_the_light_comes_from_the_upper_left(ball):
    picture = render_preview(*ball, painted(ball[0], (0.5, 0.5, 0.5)), size=SIZE).astype(int).sum(axis=-1)
    assert picture[60, 90] > picture[90, 120] > picture[125, 155]


def test_the_backdrop_is_soft_and_the_floor_in_shadow(ball):
    picture = render_preview(*ball, size=SIZE).astype(int)
    border = np.concatenate((picture[0], picture[-1], picture[:, 0], picture[:, -1]))
    assert np.ptp(border, axis=1).max() < 20  # nearly grey
    for line in (picture[0], picture[:, 0]):
        assert np.abs(np.diff(line, axis=0)).max() <= 2  # no edge, no band
    assert picture[0].mean() > picture[-1].mean()
    beside, below = picture[165, 10].mean(), picture[165, 120].mean()
    assert below < beside - 5


def test_each_side_has_the_colour_of_its_voxels():
    grid = VoxelGrid((0.0, 0.0, 0.0), 1.0, (16, 16, 16))
    surface = surface_of(np.ones(grid.shape, bool), grid)
    top = surface.voxels[:, 2] == 15
    rgb = np.where(top[:, None], (0.02, 0.02, 0.8), (0.8, 0.02, 0.02))
    picture = render_preview(surface, grid, rgb, size=SIZE)
    blue, red = saturated(picture, 2), saturated(picture, 0)
    assert blue.sum() > 500 and red.sum() > 500
    assert np.nonzero(blue)[0].mean() < np.nonzero(red)[0].mean()  # seen from above


@pytest.mark.parametrize("shape", [(1, 1, 1), (30, 1, 1), (1, 1, 30)])
def test_any_object_fits_the_picture(shape):
    grid = VoxelGrid((-3.0, 100.0, 2.0), 0.001, shape)
    surface = surface_of(np.ones(shape, bool), grid)
    red = saturated(render_preview(surface, grid, painted(surface, (0.8, 0.02, 0.02)), size=SIZE), 0)
    rows, columns = np.nonzero(red)
    # The longer side is framed to 74 percent; the rest of the picture is margin on all sides.
    assert max(np.ptp(rows) / 180, np.ptp(columns) / 240) == pytest.approx(0.74, abs=0.04)
    assert rows.min() > 10 and rows.max() < 170 and columns.min() > 10 and columns.max() < 230


def test_of_nothing_there_is_only_the_backdrop():
    grid = VoxelGrid((0, 0, 0), 1.0, (4, 4, 4))
    surface = surface_of(np.zeros(grid.shape, bool), grid)
    picture = render_preview(surface, grid, np.zeros((0, 3), np.float32), size=(61, 47)).astype(int)
    assert picture.shape == (47, 61, 3)
    assert np.abs(np.diff(picture, axis=0)).max() <= 4 and np.abs(np.diff(picture, axis=1)).max() <= 4


def test_the_cameras_tell_what_is_up():
    """A rig turned so that the object stands along -y: its cameras say so, and the picture is that of the upright one."""
    upright = ring(8)
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # the upright z is the object's -y
    lying = [camera.moved(np.linalg.inv(turn)) for camera in upright]
    assert np.array_equal(upward(upright), [0, 0, 1])
    assert np.array_equal(upward(lying), turn[:3, :3] @ [0, 0, 1])
    on_its_side = [replace(camera, R=rotation_about((0, 0, 1), 1.6) @ camera.R) for camera in upright]
    assert np.array_equal(upward(on_its_side), [0, 0, 1])
    assert np.array_equal(upward(upright[:1]), [0, 0, 1])
