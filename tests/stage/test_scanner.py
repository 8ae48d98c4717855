# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rigs of stereo: what is planned at each pose, that all devices see or light all of the object, and nothing is left over."""

import math

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.active.patterns import make_patterns
from addon.stage import ownership, projector, readback, staging

SMALL = {"resolution_x": 96, "resolution_y": 72}
PROJECTOR = {**SMALL, "projector_x": 64, "projector_y": 48}
RIGS = {
    "stereo-pair": {**SMALL, "views": 3},
    "laser-scanner": {**SMALL, "views": 2, "lines": 9},
    "gray-code": {**PROJECTOR, "views": 2},
    "phase-shift": {**PROJECTOR, "views": 2, "steps": 3},
    "color-stripes": {**PROJECTOR, "views": 2, "width": 4},
    "depth-sensor": {**PROJECTOR, "views": 2},
}
KINDS = ("objects", "meshes", "cameras", "lights", "materials", "node_groups", "actions", "worlds", "collections", "images")


def inventory():
    return {kind: sorted(block.name for block in getattr(bpy.data, kind) if block.name != "Render Result") for kind in KINDS}


def share_of_picture(device, vertices, motions):
    """Return the least distance of any vertex, at any pose, to a border of the device's picture, as a share of the picture."""
    pixels = np.concatenate([device.moved(motion).project(vertices)[0] for motion in motions])
    share = (pixels + 0.5) / device.size
    return min(share.min(), 1 - share.max())


def angle_between(a, b):
    return math.acos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


@pytest.mark.parametrize("name", ["gray-code", "phase-shift"])
def test_a_pose_has_a_picture_under_the_headlight_and_then_every_pattern(empty_scene, name):
    staging.build(empty_scene, name, "knot", RIGS[name])
    plan = readback.plan_of(empty_scene)
    patterns = make_patterns(name, (64, 48), {"steps": 3} if name == "phase-shift" else {})
    assert [frame.pattern for frame in plan.frames] == 2 * [None, *(pattern.id for pattern in patterns)]
    assert [frame.lights for frame in plan.frames] == 2 * [("light-1",), *[()] * len(patterns)]
    assert plan.patterns == {pattern.id: {**pattern.fields, "projector": "projector-1"} for pattern in patterns}
    half = len(plan.frames) // 2
    for frame in plan.frames:
        sign = 1 if frame.number <= half else -1  # the second pose is half a turn away
        np.testing.assert_allclose(frame.object_to_world, np.diag((sign, sign, 1, 1)), atol=1e-6)


@pytest.mark.parametrize("name", RIGS)
def test_every_device_sees_or_lights_all_of_the_object(empty_scene, name):
    staging.build(empty_scene, name, "figure", {**RIGS[name], "views": 7})
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    motions = {frame.object_to_world.tobytes(): frame.object_to_world for frame in plan.frames}
    assert len(motions) == 7
    for device in (*plan.cameras.values(), *plan.projectors.values()):
        # A margin of 6 % is kept; in a parallel pair parts nearer than the middle are seen up to 2 % beside it.
        assert 0.03 < share_of_picture(device, vertices, motions.values()) < 0.12


def test_camera_and_projector_stand_at_the_angle(empty_scene):
    staging.build(empty_scene, "gray-code", "knot", {**RIGS["gray-code"], "angle": math.radians(35), "elevation": 0.0, "throw_ratio": 2.0})
    plan = readback.plan_of(empty_scene)
    camera, light = plan.cameras["camera-1"], plan.projectors["projector-1"]
    assert angle_between(camera.forward, light.forward) == pytest.approx(math.radians(35), abs=1e-5)
    assert light.centre[0] > 0.1 and camera.centre[0] == pytest.approx(0, abs=1e-6)  # columns are to cross the baseline
    assert light.K[0, 0] == pytest.approx(2.0 * 64)


@pytest.mark.parametrize("sweep", ["angle", "translation"])
def test_the_laser_sweeps_from_side_to_side_of_the_object(empty_scene, sweep):
    staging.build(empty_scene, "laser-scanner", "knot", {**RIGS["laser-scanner"], "sweep": sweep, "lines": 12})
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    first = plan.frames[1:13]
    assert plan.frames[0].pattern is None and plan.frames[0].lights == ("light-1",)
    assert [frame.pattern for frame in plan.frames[14:]] == [frame.pattern for frame in first]  # the rig's planes, not the object's
    planes = np.array([plan.patterns[frame.pattern]["plane"] for frame in first])
    side = vertices @ planes[:, :3].T - planes[:, 3]
    assert (side[:, 0] > 0).mean() > 0.97 and (side[:, -1] < 0).mean() > 0.97  # the sweep goes to the laser's right
    assert (np.diff(side, axis=1) < 0).all()
    for frame, plane in zip(first, planes, strict=True):
        source = plan.lights[frame.lights[0]]
        assert plane[:3] @ source.position == pytest.approx(plane[3], abs=1e-6)
    normals = np.abs(planes[:, :3] - planes[0, :3]).max()
    assert normals < 1e-6 if sweep == "translation" else normals > 0.1


def test_a_parallel_pair_is_rectified_and_looks_at_the_middle(empty_scene):
    staging.build(empty_scene, "stereo-pair", "knot", {**RIGS["stereo-pair"], "baseline": 0.1, "elevation": math.radians(30)})
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    left, right = plan.cameras["camera-1"], plan.cameras["camera-2"]
    np.testing.assert_allclose(left.R, right.R, atol=1e-6)
    np.testing.assert_allclose(left.R @ (right.centre - left.centre), (0.1, 0, 0), atol=1e-6)
    for camera in (left, right):
        np.testing.assert_allclose(camera.project([0, 0, vertices[:, 2].max() / 2])[0], (47.5, 35.5), atol=1e-3)
    assert [frame.camera for frame in plan.frames] == ["camera-1", "camera-2"] * 3
    assert {frame.lights for frame in plan.frames} == {("light-1",)}  # both pictures are lit alike
    np.testing.assert_allclose(plan.lights["light-1"].position, (left.centre + right.centre) / 2, atol=1e-6)


def test_a_converging_pair_looks_at_the_middle(empty_scene):
    staging.build(empty_scene, "stereo-pair", "knot", {**RIGS["stereo-pair"], "axes": "converging"})
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    for camera in plan.cameras.values():
        np.testing.assert_allclose(camera.project([0, 0, vertices[:, 2].max() / 2])[0], (47.5, 35.5), atol=1e-3)
        assert camera.K[0, 2] == 47.5


@pytest.mark.parametrize(("name", "options"), [*RIGS.items(), ("calibration", {**PROJECTOR, "poses": 2, "turns": 2})])
def test_building_twice_and_removing_leaves_nothing(empty_scene, name, options):
    staging.build(empty_scene, name, "knot", options)
    once = inventory()
    staging.build(empty_scene, name, "knot", options)
    assert inventory() == once
    staging.remove(empty_scene)
    assert not any(inventory().values())


def test_a_projector_that_is_keyed_to_move_is_one_device_for_each_pose(empty_scene):
    stage = staging.build(empty_scene, "gray-code", "knot", {**RIGS["gray-code"], "views": 1, "axes": "columns"})
    made, = ownership.with_role(stage, "projector")
    for frame, x in ((2, 0.3), (5, 0.4)):
        made.location.x = x
        made.keyframe_insert("location", index=0, frame=frame)
    plan = readback.plan_of(empty_scene)
    assert set(plan.projectors) == {"projector-1", "projector-1-2", "projector-1-3", "projector-1-4"}
    assert plan.patterns[plan.frames[4].pattern]["projector"] == "projector-1-4"


def test_two_patterns_at_once_are_refused(empty_scene):
    stage = staging.build(empty_scene, "gray-code", "knot", RIGS["gray-code"])
    projector.add_projector(stage, 2)
    with pytest.raises(ScanstageError, match="frame 2 of scene 'Scene': 'Scanstage Projector 1' and 'Scanstage Projector 2' shine at once"):
        readback.plan_of(empty_scene)


@pytest.mark.parametrize(("name", "options", "message"), [
    ("stereo-pair", {"baseline": 50.0}, "option baseline: 50 m is not less than the cameras' distance"),
    ("laser-scanner", {"distance": 0.05}, "option distance: .* inside the object"),
    ("phase-shift", {"period": 4000.0}, "a period of 4000 pixels is longer than the projector's 64 columns"),
])
def test_a_rig_that_cannot_be_built_leaves_none(empty_scene, name, options, message):
    with pytest.raises(ScanstageError, match=message):
        staging.build(empty_scene, name, "knot", {**RIGS[name], **options})
    assert not any(inventory().values())
