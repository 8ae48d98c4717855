# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Corners carried into a projector's picture: between its pixels though the code is whole, and through its lens."""

import cv2
import numpy as np
import pytest

from addon.reconstruction.calibration.board import Board
from addon.reconstruction.calibration.camera import Sighting
from addon.reconstruction.calibration.projector import projector_corners
from addon.reconstruction.calibration.rig import calibrate_rig
from addon.reconstruction.geometry import rotation_about
from tests.boards import board_pose, decoded_map, device, in_frame, lit_pixels, spread_poses

BOARD = Board("checkerboard", 11, 8, 0.04)
CAMERA = device(620, (640, 480))


def projector(k1=0.0):
    """Return a projector of wide throw, whose picture the board fills and whose lens therefore matters."""
    return device(560, (800, 600), centre=(399.5, 420), distortion=(k1, 0, 0, 0, 0), R=rotation_about((0, 1, 0), 0.2), t=(-0.16, 0.0, 0.02))


def carried(pose, lamp, decoded=None, carry=projector_corners, camera=CAMERA):
    """Return the corners that are carried over, where they really project to, and which they are."""
    corners = in_frame(pose, BOARD.corners)
    decoded = decoded_map(BOARD, camera, lamp, pose) if decoded is None else decoded
    known, pixels = carry(camera.project(corners)[0], decoded)
    return pixels, lamp.project(corners[known])[0], known


def test_whole_codes_on_white_squares_give_corners_to_a_tenth_of_a_pixel():
    camera = device(620, (640, 480), distortion=(-0.05, 0.01, 0, 0, 0))
    pixels, expected, known = carried(board_pose(BOARD, (0.0, 0.0, 0.6), 0.4, 0.5), projector(), camera=camera)
    assert known.sum() > 60
    # Rounding is off by 0.29 px RMS along either axis; some 400 pixels of a window average it out
    assert np.sqrt(((pixels - expected) ** 2).sum(axis=1).mean()) < 0.1


def test_exact_codes_through_a_pinhole_give_exact_corners():
    pose, lamp = board_pose(BOARD, (0.0, 0.0, 0.6), 0.4, 0.5), projector()
    corners = in_frame(pose, BOARD.corners)
    known, pixels = projector_corners(CAMERA.project(corners)[0], lit_pixels(CAMERA, lamp, pose))
    np.testing.assert_allclose(pixels, lamp.project(corners[known])[0], atol=1e-3)  # findHomography stops at about 1e-4


def test_a_few_wrong_codes_change_nothing_much():
    pose, lamp, rng = board_pose(BOARD, (0.0, 0.0, 0.6), 0.3, 2.0), projector(), np.random.default_rng(0)
    decoded = decoded_map(BOARD, CAMERA, lamp, pose)
    wrong = rng.random(decoded.shape[:2]) < 0.1
    decoded[wrong] += rng.choice([-64, 32, 128], (wrong.sum(), 2))
    pixels, expected, _ = carried(pose, lamp, decoded=decoded)
    assert np.sqrt(((pixels - expected) ** 2).sum(axis=1).mean()) < 0.15


def test_corners_that_the_code_does_not_surround_are_left_out():
    pose, lamp = board_pose(BOARD, (0.0, 0.0, 0.6)), projector()
    decoded = decoded_map(BOARD, CAMERA, lamp, pose)
    pixels = CAMERA.project(in_frame(pose, BOARD.corners))[0]
    edge = pixels[:, 0].mean()
    decoded[:, int(edge):] = np.nan  # beyond, the projector does not reach
    known, _ = projector_corners(pixels, decoded)
    assert known[pixels[:, 0] < edge - 30].mean() > 0.9 and not known[pixels[:, 0] > edge + 5].any()
    assert not projector_corners(pixels, np.full_like(decoded, np.nan))[0].any()


def by_one_homography(pixels, decoded):
    """Carry corners over by a single homography of the whole picture."""
    row, column = np.nonzero(np.isfinite(decoded).all(axis=-1))
    H, _ = cv2.findHomography(np.column_stack((column, row)).astype(float), decoded[row, column], 0)
    return np.ones(len(pixels), bool), cv2.perspectiveTransform(pixels[:, None], H)[:, 0]


@pytest.mark.parametrize("k1", [0.0, -0.1])
def test_local_homographies_follow_a_lens_and_a_global_one_does_not(k1):
    lamp, rng = projector(k1), np.random.default_rng(2)
    poses = spread_poses(BOARD, rng, 7, nearest=0.5, furthest=0.7)
    maps = [decoded_map(BOARD, CAMERA, lamp, pose) for pose in poses]
    errors, left = {}, {}
    for name, carry in (("local", projector_corners), ("global", by_one_homography)):
        seen, wrong = [], []
        for number, (pose, decoded) in enumerate(zip(poses, maps, strict=True)):
            pixels, expected, known = carried(pose, lamp, decoded, carry)
            wrong.append(pixels - expected)
            corners = CAMERA.project(in_frame(pose, BOARD.corners))[0]
            seen += [Sighting("camera", str(number), str(number), np.arange(len(corners)), corners),
                     Sighting("projector", str(number), str(number), np.flatnonzero(known), pixels)]
        rig = calibrate_rig(BOARD.corners, seen, {"camera": CAMERA.size, "projector": lamp.size}, {"camera": "radial", "projector": "radial"})
        errors[name] = np.sqrt((np.concatenate(wrong) ** 2).sum(axis=1).mean())
        left[name] = rig.rms("projector")
        if name == "local":
            assert rig.rms("camera") < 0.2 and left[name] < 0.3
            assert abs(rig.devices["projector"].distortion[0] - k1) < 0.02
            assert np.linalg.norm(rig.devices["projector"].centre - lamp.centre) < 0.001
    if k1:
        assert errors["local"] < 0.5 * errors["global"] and left["local"] < 0.5 * left["global"]
