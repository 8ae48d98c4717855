# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The button Calibrate makes the set that the function makes, and works only where there is a board."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

import addon
from addon.calibration import calibrate
from addon.captures.store import read_capture, write_capture
from addon.reconstruction.calibration.board import Board
from addon.reconstruction.calibration.bundle import motion
from addon.reconstruction.geometry import Camera, look_at
from tests.boards import spread_poses, write_board_capture

BOARD = Board("checkerboard", 8, 5, 0.03)
R, T = look_at((0.0, -0.35, 0.4), (0.0, 0.0, 0.0))
CAMERA = Camera([[430, 0, 201], [0, 430, 147], [0, 0, 1]], R, T, (400, 300))


@pytest.fixture
def scene(empty_scene):
    addon.register()
    yield empty_scene
    addon.unregister()


def test_it_calibrates_into_a_folder_beside_and_says_how_well(scene, tmp_path):
    poses = spread_poses(BOARD, np.random.default_rng(4), 5, nearest=0.45, furthest=0.55, shift=0.04)
    write_board_capture(tmp_path / "set", BOARD, CAMERA, None, [np.linalg.inv(motion(R, T)) @ pose for pose in poses])
    scene.scanstage.capture_folder = str(tmp_path / "set")
    assert bpy.ops.scanstage.calibrate() == {'FINISHED'}
    report = calibrate(tmp_path / "set", tmp_path / "by hand")
    mine, made = (read_capture(tmp_path / name).cameras["cam"] for name in ("by hand", "set-calibrated"))
    np.testing.assert_array_equal(mine.K, made.K)
    np.testing.assert_array_equal(mine.distortion, made.distortion)
    line = scene.scanstage.calibration_lines.splitlines()[0]
    assert line == f"Camera cam: RMS {report['devices']['camera cam']['rms']:.3f} px in 5 poses"
    assert read_capture(tmp_path / "set").cameras["cam"].K[0, 0] == CAMERA.K[0, 0]


def test_without_a_board_it_is_greyed_out(scene, tmp_path):
    scene.scanstage.capture_folder = str(tmp_path / "set")
    assert not bpy.ops.scanstage.calibrate.poll()
    write_board_capture(tmp_path / "set", BOARD, CAMERA, None, [np.linalg.inv(motion(R, T)) @ motion(np.eye(3), (0, 0, 0.5))])
    assert bpy.ops.scanstage.calibrate.poll()
    capture = read_capture(tmp_path / "set")
    write_capture(tmp_path / "set", replace(capture, board=None, frames=tuple(replace(frame, board_pose=None) for frame in capture.frames)))
    with pytest.raises(RuntimeError, match="show a calibration board first"):
        bpy.ops.scanstage.calibrate()
