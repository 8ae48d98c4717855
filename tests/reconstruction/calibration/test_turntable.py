# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The turntable's axis: exact from exact poses, within what noise allows from others, and shared by all devices of a rig."""

import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.calibration.board import Board
from addon.reconstruction.calibration.bundle import motion
from addon.reconstruction.calibration.camera import Sighting
from addon.reconstruction.calibration.rig import calibrate_rig
from addon.reconstruction.calibration.turntable import onto_axis, turntable_axis
from addon.reconstruction.geometry import look_at, rotation_about
from tests.boards import device, in_frame, spread_poses

BOARD = Board("checkerboard", 11, 8, 0.025)
WORLD = motion(*look_at((0.0, -0.66, 0.45), (0.0, 0.0, 0.0)))  # to a camera 0.8 m from the table's middle
ON_TABLE = motion(np.diag((1.0, -1.0, -1.0)) @ rotation_about((1, 0, 0), 0.3), (-0.1, 0.08, 0.03))  # propped up, off the axis
ANGLES = 2 * np.pi * np.arange(12) / 12


def turned(angles):
    return [motion(rotation_about((0, 0, 1), angle), (0, 0, 0)) for angle in angles]


def in_camera(angles):
    return [WORLD @ turn @ ON_TABLE for turn in turned(angles)]


def off_by(pose_to_camera, direction, point):
    """Return by how many degrees and metres an axis misses that of the world, which passes through the world's origin."""
    true, origin = pose_to_camera[:3, 2], pose_to_camera[:3, 3]
    return np.degrees(np.arcsin(np.linalg.norm(np.cross(direction, true)))), np.linalg.norm(np.cross(origin - point, direction))


def test_exact_poses_give_the_axis_its_sense_and_the_angles():
    axis = turntable_axis(in_camera(ANGLES), ANGLES)
    np.testing.assert_allclose(axis.direction, WORLD[:3, 2], atol=1e-12)
    np.testing.assert_allclose(off_by(WORLD, axis.direction, axis.point), 0, atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * axis.angles), np.exp(1j * ANGLES), atol=1e-12)
    assert abs(axis.point @ axis.direction) < 1e-12
    assert axis.tilt < 1e-9 and axis.offset < 1e-9


def test_the_sense_is_that_of_the_commanded_angles_or_upwards():
    backwards = turntable_axis(in_camera(-ANGLES), ANGLES)
    np.testing.assert_allclose(backwards.direction, -WORLD[:3, 2], atol=1e-12)
    unknown = turntable_axis(in_camera(-ANGLES))
    np.testing.assert_allclose(unknown.direction, WORLD[:3, 2], atol=1e-12)  # the table's z is upwards in the picture
    np.testing.assert_allclose(np.exp(1j * unknown.angles), np.exp(-1j * ANGLES), atol=1e-12)


def test_a_tenth_of_a_pixel_of_noise_moves_the_axis_by_less_than_a_fiftieth_of_a_degree():
    camera = device(1400, (1280, 960))
    for seed in range(5):
        rng, poses = np.random.default_rng(seed), []
        for pose in in_camera(ANGLES):
            pixels = camera.project(in_frame(pose, BOARD.corners))[0] + rng.normal(0, 0.1, (70, 2))
            _, rotation, translation = cv2.solvePnP(BOARD.corners, pixels, camera.K, None)
            poses.append(motion(cv2.Rodrigues(rotation)[0], translation.ravel()))
        axis = turntable_axis(poses, ANGLES)
        degrees, metres = off_by(WORLD, axis.direction, axis.point)
        assert degrees < 0.02 and metres < 0.15e-3
        assert 0 < axis.offset < 1e-3


@pytest.mark.parametrize("angles", [[0.3], [0.3, 0.3, 0.3], [0.0, 0.02, 0.05]], ids=["one pose", "one angle", "three degrees"])
def test_too_small_a_turn_is_refused(angles):
    with pytest.raises(ScanstageError, match=r"^the turntable's axis: the board turns by no more than \d"):
        turntable_axis(in_camera(np.array(angles)))


def test_a_world_is_moved_onto_the_axis_and_no_further():
    told, seen = turntable_axis(turned(ANGLES)), turntable_axis(in_camera(ANGLES), turntable_axis(turned(ANGLES)).angles)
    np.testing.assert_allclose(onto_axis(WORLD, told, seen), WORLD, atol=1e-9)
    along = motion(rotation_about((0, 0, 1), 0.7), (0, 0, 0.1))  # what the axis leaves open is kept
    np.testing.assert_allclose(onto_axis(WORLD @ along, told, seen), WORLD @ along, atol=1e-9)
    for wrong in (motion(rotation_about((1, 2, 0), 0.05), (0.02, 0.01, 0)), motion(np.diag((1.0, -1, -1)), (0, 0.1, 0)), np.eye(4)):
        moved = onto_axis(WORLD @ wrong, told, seen)
        np.testing.assert_allclose(moved[:3, :3] @ moved[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(moved[:3, :3] @ told.direction, seen.direction, atol=1e-9)
        np.testing.assert_allclose(off_by(WORLD, moved[:3, :3] @ told.direction, moved[:3, :3] @ told.point + moved[:3, 3]), 0, atol=1e-7)


def test_a_rig_finds_the_world_of_its_turntable_and_what_the_table_did_wrong():
    camera, rng = device(1400, (1280, 960), centre=(630, 470)), np.random.default_rng(8)
    slips = rng.normal(0, 0.004, 12)
    free = spread_poses(BOARD, rng, 8, nearest=0.7, furthest=1.0)
    poses = {f"by hand/{n}": pose for n, pose in enumerate(free)} | {f"table/{n}": pose for n, pose in enumerate(in_camera(ANGLES + slips))}
    seen = [Sighting("camera", name, name, np.arange(70), camera.project(in_frame(pose, BOARD.corners))[0]) for name, pose in poses.items()]
    turns = {f"table/{n}": ("table", turn) for n, turn in enumerate(turned(ANGLES))}
    guess = WORLD @ motion(rotation_about((1, 1, 0), 0.1), (0.05, 0, 0.03))
    rig = calibrate_rig(BOARD.corners, seen, {"camera": camera.size}, {"camera": "none"}, world=guess, turns=turns)
    assert rig.rms("camera") < 1e-6
    np.testing.assert_allclose(rig.devices["camera"].K, camera.K, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(off_by(WORLD, rig.world[:3, 2], rig.world[:3, 3]), 0, atol=1e-6)
    np.testing.assert_allclose([rig.turntable.errors[f"table/{n}"] for n in range(12)], slips - slips.mean(), atol=1e-6)
    for name, pose in poses.items():
        np.testing.assert_allclose(rig.poses[name], pose, atol=1e-6)


def test_a_table_makes_noisy_poses_better():
    camera, errors = device(1400, (1280, 960)), {"free": [], "table": []}
    for seed in range(4):
        rng = np.random.default_rng(seed)
        poses = {f"table/{n}": pose for n, pose in enumerate(in_camera(ANGLES))}
        seen = [Sighting("camera", name, name, np.arange(70), camera.project(in_frame(pose, BOARD.corners))[0] + rng.normal(0, 0.3, (70, 2)))
                for name, pose in poses.items()]
        turns = {f"table/{n}": ("table", turn) for n, turn in enumerate(turned(ANGLES))}
        for name, given in (("free", None), ("table", turns)):
            rig = calibrate_rig(BOARD.corners, seen, {"camera": camera.size}, {"camera": "none"}, turns=given)
            errors[name].append(np.linalg.norm(rig.devices["camera"].K - camera.K))
    assert np.mean(errors["table"]) < np.mean(errors["free"])
