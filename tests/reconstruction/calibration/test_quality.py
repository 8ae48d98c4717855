# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings of poses that leave something open, and the picture of the residuals."""

import numpy as np
import pytest

from addon.reconstruction.calibration.board import Board
from addon.reconstruction.calibration.quality import pose_warnings, residual_picture
from addon.reconstruction.calibration.rig import calibrate_rig
from tests.boards import board_pose, device, sighting, spread_poses

BOARD = Board("checkerboard", 11, 8, 0.025)
CAMERA = device(900, (1280, 960))


def rig_of(poses, noise=0.1):
    rng = np.random.default_rng(9)
    seen = [sighting("camera", CAMERA, BOARD, pose, n, rng.normal(0, noise, (70, 2))) for n, pose in enumerate(poses)]
    return calibrate_rig(BOARD.corners, seen, {"camera": CAMERA.size}, {"camera": "none"})


def good_poses(count=12, shift=0.15, **depth):
    return spread_poses(BOARD, np.random.default_rng(1), count, shift=shift, **(depth or {"nearest": 0.5, "furthest": 0.7}))


PLACES = np.random.default_rng(2).uniform((-0.15, -0.1, 0.5), (0.15, 0.1, 0.7), (12, 3))
CASES = {
    "good": (good_poses(), []),
    "few": (good_poses(6), ["only 6 poses of the board; take 10 to 20"]),
    "frontal": ([board_pose(BOARD, place, turn=n) for n, place in enumerate(PLACES)],
                ["the board faces it in every pose (tilted by at most "]),
    "shifted": ([board_pose(BOARD, place, 0.5, 0.3) for place in PLACES], ["the board is only shifted, or turned in its own plane"]),
    "turned in its plane": ([board_pose(BOARD, place, 0.5, 0.3, turn=n) for n, place in enumerate(PLACES)],
                            ["the board is only shifted, or turned in its own plane"]),
    "small": (good_poses(nearest=2.5, furthest=3.0), ["the board covers only "]),
    "in the middle": (good_poses(shift=0.0, nearest=0.62, furthest=0.66), ["all poses together cover only "]),
}


@pytest.mark.parametrize("case", CASES)
def test_each_weakness_is_said(case):
    poses, expected = CASES[case]
    found = pose_warnings(rig_of(poses), BOARD.corners, "camera")
    for sentence in expected:
        assert any(warning.startswith(f"camera: {sentence}") for warning in found), found
    if not expected:
        assert not found
    assert all("\n" not in warning for warning in found)


def test_corners_far_from_where_they_should_be_are_said():
    assert any("pixels (RMS) from where they should be" in warning for warning in pose_warnings(rig_of(good_poses(), 4.0), BOARD.corners, "camera"))


def test_arrows_lead_from_the_corners_the_way_the_calibration_would_move_them():
    rig = rig_of(good_poses(), 0.5)
    sheet = residual_picture(rig, "camera")
    assert sheet.dtype == np.uint8 and sheet.shape[1:] == (1280, 3) and 960 < sheet.shape[0] < 1000
    pixels = np.concatenate([one.pixels for one in rig.sightings])
    inside = pixels[((pixels > 3) & (pixels < np.array(CAMERA.size) - 4)).all(axis=1)].round().astype(int)
    assert (sheet[inside[:, 1], inside[:, 0]].min(axis=1) < 200).all()  # every corner has its dot on the white sheet
    longest = max(range(len(pixels)), key=lambda n: np.linalg.norm(np.concatenate(rig.residuals)[n]))
    residual = np.concatenate(rig.residuals)[longest]
    way = pixels[longest] - residual / np.linalg.norm(residual) * 12
    column, row = way.round().astype(int)
    assert (sheet[row - 1:row + 2, column - 1:column + 2].min(axis=-1) < 230).any()


def test_perfect_residuals_can_be_drawn():
    assert residual_picture(rig_of(good_poses(), 0.0), "camera").shape[1] == 1280
