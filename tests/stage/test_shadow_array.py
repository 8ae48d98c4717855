# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The shadow array: where its lights stand, which shines when, and what comes back when the stage goes."""

import bpy  # before OpenCV, which the readback brings: both have libraries of their own
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.stage import readback, staging
from addon.stage.shadow_array import SHAPES, light_offsets


def plan(scene, **options):
    staging.build(scene, "shadow-array", "dented-sphere", {"views": 3, "resolution_x": 64, "resolution_y": 48, **options})
    return readback.plan_of(scene)


def test_every_pose_is_captured_under_all_lights_and_under_each(empty_scene):
    found = plan(empty_scene, lights=4)
    assert set(found.lights) == {"light-1", "light-2", "light-3", "light-4"} and len(found.frames) == 3 * 5
    for pose in range(3):
        group = found.frames[5 * pose:5 * pose + 5]
        assert [frame.lights for frame in group] == [tuple(found.lights), *((id,) for id in found.lights)]
        turned = np.array([frame.object_to_world for frame in group])
        assert (turned == turned[0]).all()
        assert np.arctan2(turned[0, 1, 0], turned[0, 0, 0]) % (2 * np.pi) == pytest.approx(2 * np.pi * pose / 3, abs=1e-6)


def test_a_single_light_gets_a_headlight_without_which_its_shadow_could_be_paint(empty_scene):
    found = plan(empty_scene, lights=1)
    assert [frame.lights for frame in found.frames] == [("light-1", "light-2"), ("light-1",)] * 3
    np.testing.assert_allclose(found.lights["light-2"].position, found.cameras["camera-1"].centre, atol=1e-6)


def test_each_of_several_cameras_has_an_array_of_its_own(empty_scene):
    found = plan(empty_scene, views=2, lights=2, elevations="10,50")
    first, second = ("light-1", "light-2"), ("light-3", "light-4")
    expected = [("camera-1", first), ("camera-1", first[:1]), ("camera-1", first[1:]),
                ("camera-2", second), ("camera-2", second[:1]), ("camera-2", second[1:])]
    assert [(frame.camera, frame.lights) for frame in found.frames] == 2 * expected


@pytest.mark.parametrize("array", SHAPES)
def test_lights_stand_thirty_degrees_off_the_axis_unless_told_otherwise(empty_scene, array):
    found = plan(empty_scene, lights=5, array=array)
    camera = found.cameras["camera-1"]
    local = np.array([camera.R @ light.position + camera.t for light in found.lights.values()])
    np.testing.assert_allclose(local[:, 2], 0, atol=1e-6)  # in the camera's own plane
    _, points = empty_scene, readback.truth_mesh(empty_scene)[0]
    middle = camera.R @ [0, 0, (points[:, 2].min() + points[:, 2].max()) / 2] + camera.t
    assert np.degrees(np.arctan(np.hypot(local[:, 0], local[:, 1]).max() / middle[2])) == pytest.approx(30, abs=0.1)
    assert len(np.unique(local.round(5), axis=0)) == 5


def test_the_array_takes_its_own_radius_distance_and_size(empty_scene):
    found = plan(empty_scene, lights=3, array_radius=0.2, array_distance=0.5, distance=0.8, light_size=0.01)
    camera = found.cameras["camera-1"]
    for light in found.lights.values():
        x, y, z = camera.R @ light.position + camera.t
        assert (np.hypot(x, y), z, light.radius) == pytest.approx((0.2, 0.3, 0.01), abs=1e-6)
    empty_scene.frame_set(2)
    assert empty_scene.cycles.samples >= 16  # a penumbra at one sample is noise


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 32])
@pytest.mark.parametrize("shape", SHAPES)
def test_arrays_reach_their_radius_and_no_two_lights_coincide(shape, count):
    places = light_offsets(shape, count, 2.0)
    reach = np.linalg.norm(places, axis=1)
    assert len(np.unique(places.round(9), axis=0)) == count and reach.max() <= 2 + 1e-9
    assert reach.max() == pytest.approx(2.0) or (shape, count) == ("grid", 1)
    assert shape != "arc" or (places[:, 1] > -1e-9).all()


def test_lights_inside_the_object_are_refused_and_nothing_is_left(empty_scene):
    with pytest.raises(ScanstageError, match="option array_distance: 0.01 m puts a light inside the object"):
        plan(empty_scene, array_distance=0.01, array_radius=0.01)
    assert not bpy.data.objects and empty_scene.cycles.samples == 4096


def test_the_users_own_animation_of_the_scene_comes_back(empty_scene):
    empty_scene.cycles.samples = 77
    empty_scene.keyframe_insert("gravity", frame=5)
    own = empty_scene.animation_data.action
    plan(empty_scene, lights=4)
    empty_scene.frame_set(1)
    assert empty_scene.cycles.samples == 4 and empty_scene.animation_data.action != own
    staging.remove(empty_scene)
    assert empty_scene.animation_data.action == own and empty_scene.cycles.samples == 77
    assert empty_scene.animation_data.action_slot is not None
    assert list(bpy.data.actions) == [own]
