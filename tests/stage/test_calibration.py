# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The calibration rig: a board whose corners are found where its pose says, in poses that calibrate, before both devices."""

import itertools
import math

import bpy
import numpy as np
import pytest

from addon.captures.pictures import read_picture
from addon.captures.store import read_capture
from addon.errors import ScanstageError
from addon.render.capture import capture_frames
from addon.stage import board, ownership, readback, staging
from addon.stage.calibration import board_places
from tests.rigs import camera_at

SMALL = {"resolution_x": 320, "resolution_y": 240, "projector_x": 32, "projector_y": 24}


def corners_in_world(scene, plan, frame):
    scene.frame_set(frame.number)
    made, = ownership.with_role(ownership.require_stage(scene), "board")
    pose = np.array(made.matrix_world)
    return plan.board.corners @ pose[:3, :3].T + pose[:3, 3]


@pytest.mark.parametrize(("kind", "least"), [("charuco", 0.6), ("checkerboard", 1.0)])
def test_corners_are_found_where_they_are(empty_scene, tmp_path, kind, least):
    staging.build(empty_scene, "calibration", "knot", {**SMALL, "board": kind, "columns": 7, "square": 0.025, "rows": 5 if kind == "charuco" else 6,
                                                       "poses": 2, "turns": 2, "projector": False})
    plan = readback.plan_of(empty_scene)
    list(capture_frames(empty_scene, tmp_path))
    found = read_capture(tmp_path)
    assert found.board == plan.board and found.truth_mesh is None and not (tmp_path / "truth.ply").exists()
    for planned, frame in zip(plan.frames, found.frames, strict=True):
        ids, pixels = plan.board.find(read_picture(tmp_path / frame.image, "linear")[0])
        expected, depth = plan.cameras["camera-1"].project(corners_in_world(empty_scene, plan, planned))
        assert len(ids) >= least * len(plan.board.corners) and (depth > 0).all()
        error = np.linalg.norm(pixels - expected[ids], axis=1)
        assert np.sqrt((error ** 2).mean()) < 0.2  # the figure asked of a rendered calibration


def test_every_pose_has_its_name_and_all_patterns_and_the_table_turns_after_them(empty_scene):
    staging.build(empty_scene, "calibration", "knot", {**SMALL, "poses": 3, "turns": 4})
    plan = readback.plan_of(empty_scene)
    patterns = 2 * (5 + 5) + 2
    assert [frame.board_pose for frame in plan.frames] == [*["pose"] * (1 + patterns), *["pose-2"] * (1 + patterns),
                                                           *["pose-3"] * (1 + patterns), *["pose-4"] * 4]
    by_hand, turned = plan.frames[:-4], plan.frames[-4:]
    assert [frame.pattern is None for frame in by_hand] == 3 * [True, *[False] * patterns]
    assert all(frame.lights == (("light-1",) if frame.pattern is None else ()) for frame in plan.frames)
    assert len(plan.patterns) == patterns and all(frame.pattern is None for frame in turned)
    assert all(np.array_equal(frame.object_to_world, np.eye(4)) for frame in by_hand)
    angles = [math.atan2(*frame.object_to_world[[1, 0], 0]) for frame in turned]
    np.testing.assert_allclose(np.unwrap(angles), np.arange(4) * math.pi / 2, atol=1e-6)
    corners = [corners_in_world(empty_scene, plan, frame) for frame in turned]
    for placed in corners:
        np.testing.assert_allclose(placed[:, 2], 0, atol=1e-6)  # it lies on the table, its middle on the axis
        np.testing.assert_allclose(placed.mean(axis=0), 0, atol=1e-6)


def test_a_second_camera_sees_the_board_at_the_same_poses(empty_scene):
    staging.build(empty_scene, "calibration", "knot", {**SMALL, "poses": 2, "turns": 1, "cameras": 2})
    plan = readback.plan_of(empty_scene)
    second = [frame for frame in plan.frames if frame.camera == "camera-2"]
    assert [(frame.board_pose, frame.pattern, frame.lights) for frame in second] == [("pose", None, ("light-2",)), ("pose-2", None, ("light-2",))]
    assert [frame.camera for frame in plan.frames].count("camera-1") == 2 * (1 + 22) + 1
    for frame in second:
        pixels, depth = plan.cameras["camera-2"].project(corners_in_world(empty_scene, plan, frame))
        assert (depth > 0).all() and (pixels > 0).all() and (pixels < (319, 239)).all()
    left, middle, right = plan.cameras["camera-2"].centre, plan.cameras["camera-1"].centre, plan.projectors["projector-1"].centre
    assert left[0] < -0.05 and middle[0] == pytest.approx(0, abs=1e-6) and right[0] > 0.05


def test_the_board_is_seen_and_lit_whole_in_every_pose(empty_scene):
    staging.build(empty_scene, "calibration", "knot", {**SMALL, "poses": 12, "turns": 5})
    plan = readback.plan_of(empty_scene)
    for frame in {(frame.board_pose, frame.object_to_world.tobytes()): frame for frame in plan.frames}.values():
        for device in (plan.cameras["camera-1"], plan.projectors["projector-1"]):
            pixels, depth = device.project(corners_in_world(empty_scene, plan, frame))
            assert (depth > 0).all() and (pixels > 0).all() and (pixels < np.array(device.size) - 1).all()


@pytest.mark.parametrize("count", [3, 10, 20])
def test_poses_are_tilted_all_differently_and_fill_the_pictures(count):
    devices = [camera_at((0.0, -0.5, 0.5)), camera_at((0.2, -0.5, 0.5))]
    poses = board_places(board.Board("checkerboard", 9, 6, 0.02), devices, 0.7, count)
    normals = np.array([devices[0].R @ pose[:3, 2] for pose in poses])
    tilts = np.degrees(np.arccos(normals[:, 2]))
    assert tilts.min() > 5 and tilts.max() < 60  # 15 to 40 degrees from the line between the two devices
    apart = [np.degrees(np.arccos(np.clip(a @ b, -1, 1))) for a, b in itertools.combinations(normals, 2)]
    assert max(apart) > 40 and min(apart) > 2
    middles = np.array([devices[0].project(pose[:3, 3])[0] for pose in poses]) / devices[0].size
    assert np.ptp(middles, axis=0).min() > (0.1 if count > 3 else 0.03)
    for pose in poses:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) > 0


def test_a_board_that_was_scaled_says_so(empty_scene):
    staging.build(empty_scene, "calibration", "knot", {**SMALL, "poses": 1, "turns": 0, "projector": False})
    made, = ownership.with_role(ownership.require_stage(empty_scene), "board")
    made.scale = (2.0,) * 3
    bpy.context.view_layer.update()
    found = readback.plan_of(empty_scene).board
    assert (found.square, found.marker) == pytest.approx((0.04, 0.03), rel=1e-6)


def test_another_board_is_another_plan(empty_scene, tmp_path):
    options = {**SMALL, "poses": 1, "turns": 0, "projector": False, "distance": 1.0}
    staging.build(empty_scene, "calibration", "knot", options)
    list(capture_frames(empty_scene, tmp_path))
    staging.build(empty_scene, "calibration", "knot", {**options, "square": 0.021})
    with pytest.raises(ScanstageError, match="another calibration board"):
        list(capture_frames(empty_scene, tmp_path))


def test_too_many_squares_for_markers(empty_scene):
    with pytest.raises(ScanstageError, match="option columns: a board of 50x50 squares needs 1250 markers"):
        staging.build(empty_scene, "calibration", "knot", {**SMALL, "columns": 50, "rows": 50})
