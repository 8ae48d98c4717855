# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Boards: what is drawn is what is meant, and what is found lies where the geometry says."""

import numpy as np
import pytest

from addon.reconstruction.calibration.board import Board, spacing
from tests.boards import board_albedo, board_pose, device, in_frame

BOARDS = {"charuco": Board("charuco", 10, 7, 0.03, 0.022), "checkerboard": Board("checkerboard", 10, 7, 0.03)}
CAMERA = device(720, (640, 480), distortion=(-0.1, 0.02, 0, 0, 0))
POSES = [dict(centre=(0.01, -0.02, 0.6)), dict(centre=(-0.03, 0.01, 0.7), tilt=0.5, about=0.4, turn=0.3),
         dict(centre=(0.02, 0.02, 0.65), tilt=0.6, about=2.0, turn=2.9)]


def rgb_of(grey):
    return np.repeat(grey[..., None], 3, axis=-1)


@pytest.mark.parametrize("pose", POSES, ids=["frontal", "tilted", "upside down"])
@pytest.mark.parametrize("kind", BOARDS)
def test_corners_are_found_where_they_project_to(kind, pose):
    board = BOARDS[kind]
    pose = board_pose(board, **pose)
    ids, pixels = board.find(rgb_of(board_albedo(board, CAMERA, pose)))
    assert len(ids) >= (54 if kind == "checkerboard" else 50) and len(set(ids.tolist())) == len(ids)  # a marker may escape
    expected = CAMERA.project(in_frame(pose, board.corners[ids]))[0]
    error = np.linalg.norm(pixels - expected, axis=1)
    # The saddle is sought in 8 bits and 4 samples a pixel: a tenth of a pixel is what literature promises of it
    assert np.sqrt((error ** 2).mean()) < 0.1 and error.max() < 0.3


def test_exposure_does_not_matter():
    board = BOARDS["charuco"]
    picture = rgb_of(board_albedo(board, CAMERA, board_pose(board, **POSES[1])))
    np.testing.assert_allclose(board.find(picture * 0.02)[1], board.find(picture)[1], atol=0.02)  # the same but for rounding to 8 bits


def test_a_large_picture_is_searched_small_and_measured_whole():
    board, large = BOARDS["checkerboard"], device(1600, (1400, 1000))
    pose = board_pose(board, (0.0, 0.0, 0.7), 0.3, 1.0)
    _, pixels = board.find(rgb_of(board_albedo(board, large, pose)))
    assert np.linalg.norm(pixels - large.project(in_frame(pose, board.corners))[0], axis=1).max() < 0.3


def test_a_charuco_board_may_be_seen_in_part_and_a_checkerboard_not():
    for kind, board in BOARDS.items():
        found = board.find(rgb_of(board_albedo(board, CAMERA, board_pose(board, (0.25, 0.0, 0.6)))))
        assert (found is None) == (kind == "checkerboard")
        if found is not None:
            expected = CAMERA.project(in_frame(board_pose(board, (0.25, 0.0, 0.6)), board.corners[found[0]]))[0]
            assert 6 <= len(found[0]) < 54
            assert np.linalg.norm(found[1] - expected, axis=1).max() < 0.5


@pytest.mark.parametrize("picture", [np.zeros((60, 80, 3)), np.full((60, 80, 3), 0.5), np.random.default_rng(0).random((60, 80, 3))],
                         ids=["black", "grey", "noise"])
@pytest.mark.parametrize("kind", BOARDS)
def test_nothing_is_found_where_there_is_no_board(kind, picture):
    assert BOARDS[kind].find(picture) is None


def test_the_drawing_has_a_black_square_in_its_top_left_and_corner_0_between_four_pixels():
    for board in BOARDS.values():
        drawn = board.draw(28, margin=0.5)
        assert drawn.shape == (8 * 28, 11 * 28)
        assert (drawn[:14] == 255).all() and (drawn[:, -14:] == 255).all()
        corner = 14 + 28
        block = drawn[corner - 2:corner + 2, corner - 2:corner + 2]
        np.testing.assert_array_equal(block[:2, :2], 0)
        np.testing.assert_array_equal(block[2:, 2:], 0)
        np.testing.assert_array_equal(block[:2, 2:], 255)


def test_a_drawing_too_small_for_its_markers_is_refused():
    with pytest.raises(ValueError, match="^pixels_per_square must be more than 8 to show the markers"):
        BOARDS["charuco"].draw(8)  # 7 cells in 5.9 pixels


@pytest.mark.parametrize("shape", [(1, 1), (8, 6), (3, 40), (500, 4)])
def test_pictures_of_any_size_are_searched(shape):
    assert all(board.find(np.random.default_rng(0).random((*shape, 3))) is None for board in BOARDS.values())


def test_corners_go_row_by_row_from_the_first_inner_one():
    corners = Board("checkerboard", 4, 4, 2.0).corners
    np.testing.assert_array_equal(corners, [[2 * column, 2 * row, 0] for row in range(3) for column in range(3)])


@pytest.mark.parametrize(("columns", "rows", "symmetric"), [(10, 7, False), (8, 6, True), (9, 7, True)])
def test_half_a_turn_keeps_a_checkerboard_with_an_even_sum(columns, rows, symmetric):
    board = Board("checkerboard", columns, rows, 1.0)
    drawn = board.draw(2, margin=0)
    assert board.symmetric == symmetric == np.array_equal(drawn, drawn[::-1, ::-1])
    assert not Board("charuco", columns, rows, 1.0, 0.5).symmetric


@pytest.mark.parametrize(("arguments", "message"), [
    (("circles", 10, 7, 1.0), "^kind must be one of"), (("checkerboard", 3, 7, 1.0), "^columns must be from 4 to 50"),
    (("checkerboard", 10, 51, 1.0), "^rows must be from 4 to 50"), (("checkerboard", 10, 7, 0.0), "^square must be a positive"),
    (("charuco", 10, 7, 1.0, 1.0), "^marker must be a length less"), (("charuco", 10, 7, 1.0, 0.5, "9X9_1"), "^dictionary must be one of"),
    (("charuco", 20, 11, 1.0, 0.5, "5X5_100"), "^dictionary 5X5_100 has 100 markers, and the board needs 110"),
])
def test_a_board_that_cannot_be_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Board(*arguments)


def test_spacing_is_the_distance_to_the_nearest_corner():
    points = np.random.default_rng(1).random((20, 2))
    expected = [min(np.hypot(*(a - b)) for j, b in enumerate(points) if j != i) for i, a in enumerate(points)]
    np.testing.assert_allclose(spacing(points), expected)
