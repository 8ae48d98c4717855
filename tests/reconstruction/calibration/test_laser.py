# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The laser's plane, from stripes on boards in several poses."""

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.calibration.board import Board
from addon.reconstruction.calibration.laser import laser_plane, on_plane, stripe_on_board
from tests.boards import board_albedo, board_points, board_pose, device, sight_lines

BOARD = Board("checkerboard", 11, 8, 0.025)
CAMERA = device(1200, (1280, 960), distortion=(-0.15, 0.04, 0, 0.001, 0), R=[[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], t=(0.1, 0.0, 0.05))
NORMAL, DISTANCE = np.array([0.9, 0.1, -np.sqrt(1 - 0.82)]), -0.35
POSES = [board_pose(BOARD, (0.0, 0.0, 0.75), 0.4, 0.5), board_pose(BOARD, (0.0, 0.05, 0.9), 0.3, 2.0)]


def stripe(pose, noise=0.0, rng=None):
    """Return the pixels of the line in which the laser's plane cuts the board's."""
    line, offset = (pose[:3, :3].T @ NORMAL)[:2], DISTANCE - NORMAL @ pose[:3, 3]
    foot, along = line * offset / (line @ line), np.array([-line[1], line[0]]) / np.linalg.norm(line)
    plane = foot + np.linspace(-0.1, 0.1, 40)[:, None] * along
    pixels = CAMERA.project(np.column_stack((plane, np.zeros(40))) @ pose[:3, :3].T + pose[:3, 3])[0]
    return pixels + (0 if rng is None else rng.normal(0, noise, pixels.shape))


def test_two_poses_give_the_plane():
    found = laser_plane([CAMERA] * 2, POSES, [stripe(pose) for pose in POSES])
    sign = np.sign(found.normal @ NORMAL)
    np.testing.assert_allclose(sign * found.normal, NORMAL, atol=1e-8)
    assert sign * found.distance == pytest.approx(DISTANCE, abs=1e-8)
    assert found.rms < 1e-8 and not found.warnings


def test_the_rms_is_that_of_the_points():
    rng = np.random.default_rng(0)
    found = laser_plane([CAMERA] * 2, POSES, [stripe(pose, 0.5, rng) for pose in POSES])
    assert 0.05e-3 < found.rms < 1e-3  # half a pixel is 0.3 mm on these boards, and the stripe runs askew
    assert np.degrees(np.arccos(abs(found.normal @ NORMAL))) < 0.5


def test_a_stripe_is_found_on_the_white_squares_of_the_board_alone():
    board, camera, pose = BOARD, device(900, (640, 480)), board_pose(BOARD, (0.0, 0.0, 0.45), 0.3, 1.0)
    points = board_points(camera, pose, sight_lines(camera))
    across = (points[..., 0] - 0.11 - 0.1 * points[..., 1]) / 0.001  # a line askew on the board, two millimetres wide
    image = (board_albedo(board, camera, pose) * np.exp(-across ** 2)).astype(np.float32)
    image[:, 20] = 0.9  # something bright beside the board
    for turned in (False, True):
        if turned:
            quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # the picture turned by a right angle: (u, v) to (479 - v, u)
            camera, image = device(900, (480, 640), R=quarter), np.ascontiguousarray(np.rot90(image, -1))
        found = stripe_on_board(board, camera, pose, image)
        x, y, _ = on_plane(camera.moved(pose), found).T
        assert len(found) > 60
        assert np.median(np.abs(x - 0.11 - 0.1 * y)) < 0.1e-3  # half a millimetre is a pixel here
        assert (found[:, 0] > 30).all() if not turned else (found[:, 1] > 30).all()


def test_stripes_on_one_line_are_said_so():
    found = laser_plane([CAMERA] * 2, [POSES[0], POSES[0]], [stripe(POSES[0])] * 2)
    assert len(found.warnings) == 1 and found.warnings[0].startswith("the stripe lies on nearly one line")


def test_one_pose_is_refused():
    with pytest.raises(ScanstageError, match=r"^the laser's plane: the stripe is seen on the board in 1 pose\(s\)"):
        laser_plane([CAMERA] * 2, POSES, [stripe(POSES[0]), np.zeros((0, 2))])
