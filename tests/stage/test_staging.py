# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A stage comes and goes without a trace; what is the user's stays the user's."""

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.stage import ownership, readback, scene_settings, staging

KINDS = ("objects", "meshes", "cameras", "lights", "materials", "node_groups", "actions", "worlds", "collections",
         "images")


def inventory():
    """Return the names of all data-blocks that a scene can hold; Blender itself keeps the Render Result."""
    return {kind: sorted(block.name for block in getattr(bpy.data, kind) if block.name != "Render Result")
            for kind in KINDS}


def all_settings(scene):
    return scene_settings.snapshot(scene, (*scene_settings.capture_settings(scene), *scene_settings.STAGE_SETTINGS))


def state_of(subject):
    return {"parent": subject.parent, "collections": [c.name for c in subject.users_collection], "data": subject.data,
            "modifiers": [m.name for m in subject.modifiers], "constraints": [c.name for c in subject.constraints],
            "hidden": subject.hide_render, "properties": sorted(subject.keys()),
            "matrices": [[*map(tuple, m)] for m in (subject.matrix_basis, subject.matrix_world, subject.matrix_local,
                                                    subject.matrix_parent_inverse)]}


@pytest.fixture
def furnished_scene(empty_scene):
    """Return a scene of a user: a parented, scaled cube with a modifier and an animation, a floor, a lamp, a marker."""
    scene = empty_scene
    scene.world = bpy.data.worlds.new("Sky")
    parent = bpy.data.objects.new("Parent", None)
    parent.location, parent.rotation_euler = (1.0, 2.0, 0.5), (0.1, 0.2, 0.3)
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    cube.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [],
                          [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    cube.parent, cube.scale = parent, (0.2, 0.3, 0.4)
    cube.modifiers.new("Bevel", "BEVEL").width = 0.01
    cube.keyframe_insert("location", frame=1)
    floor = bpy.data.objects.new("Floor", cube.data)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "SUN"))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    for member in (parent, cube, floor, lamp, camera):
        scene.collection.objects.link(member)
    scene.camera = camera
    scene.timeline_markers.new("shot", frame=3).camera = camera
    scene.render.resolution_x, scene.frame_end, scene.cycles.samples = 1234, 77, 55
    bpy.context.view_layer.update()
    return scene


def test_staging_twice_leaves_no_orphans(empty_scene):
    options = {"views": 4, "elevations": "10,30", "backdrop": "blue"}
    staging.build(empty_scene, "turntable", "monkey", options)
    once = inventory()
    staging.build(empty_scene, "turntable", "monkey", options)
    assert inventory() == once
    staging.remove(empty_scene)
    assert not any(inventory().values())
    assert not empty_scene.timeline_markers


@pytest.mark.parametrize("subject", ["knot", "Cube"])
def test_removing_puts_the_scene_back(furnished_scene, subject):
    scene = furnished_scene
    before = inventory(), all_settings(scene), scene.camera, scene.world
    objects = {o.name: state_of(o) for o in scene.objects}
    for backdrop in ("none", "black"):  # the second replaces the first, and must not take its state for the user's
        staging.build(scene, "turntable", subject, {"views": 3, "elevations": "0,20", "backdrop": backdrop})
        assert all_settings(scene) != before[1]
    staging.remove(scene)
    assert (inventory(), all_settings(scene), scene.camera, scene.world) == before
    assert {o.name: state_of(o) for o in scene.objects} == objects
    marker, = scene.timeline_markers
    assert (marker.name, marker.frame, marker.camera) == ("shot", 3, scene.camera)


def test_a_users_object_stays_where_it_is(furnished_scene):
    cube = furnished_scene.objects["Cube"]
    before = state_of(cube)
    staging.build(furnished_scene, "turntable", "Cube", {"views": 4})
    after = state_of(cube)
    assert after.pop("constraints") == ["Scanstage Turntable"] and before.pop("constraints") == []
    moved = np.abs(np.array(after["matrices"]) - np.array(before["matrices"])).max()
    assert moved < 1e-6  # its world matrix went once through the constraint, in single precision
    after.pop("matrices"), before.pop("matrices")
    assert after == before


def test_the_table_stands_under_a_users_object_and_carries_it(furnished_scene):
    staging.build(furnished_scene, "turntable", "Cube", {"views": 4})
    vertices, _ = readback.truth_mesh(furnished_scene)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    np.testing.assert_allclose((lower + upper)[:2] / 2, 0, atol=1e-6)
    assert lower[2] == pytest.approx(0, abs=1e-6)
    cube, table = furnished_scene.objects["Cube"], readback.turntable_of(furnished_scene)
    relative = []
    for frame in (1, 2, 3, 4):
        furnished_scene.frame_set(frame)
        relative.append(np.array(table.matrix_world.inverted() @ cube.matrix_world))
    np.testing.assert_allclose(relative[1:], [relative[0]] * 3, atol=1e-6)


def test_only_the_stage_is_rendered(furnished_scene):
    floor, lamp = furnished_scene.objects["Floor"], furnished_scene.objects["Lamp"]
    lamp.hide_render = True  # by the user, and to stay so
    staging.build(furnished_scene, "turntable", "Cube", {"views": 2})
    assert floor.hide_render and not furnished_scene.objects["Cube"].hide_render
    staging.remove(furnished_scene)
    assert not floor.hide_render and lamp.hide_render


def test_what_would_swallow_a_built_in_object_is_hidden_from_view_meanwhile(empty_scene):
    bpy.ops.mesh.primitive_cube_add()  # Blender's first: the object of 0.2 m stands in it
    cube = bpy.context.object
    bpy.ops.mesh.primitive_plane_add(size=5)
    floor = bpy.context.object
    for _ in range(2):  # replacing a stage shows nothing, and hides it again
        staging.build(empty_scene, "turntable", "knot", {"views": 2})
        assert not cube.visible_get() and floor.visible_get()
    staging.remove(empty_scene)
    assert cube.visible_get() and not cube.keys() and not cube.select_get() and floor.select_get()
    cube.select_set(True)
    staging.build(empty_scene, "turntable", "knot", {"views": 2})
    staging.remove(empty_scene)
    assert cube.select_get()
    staging.build(empty_scene, "turntable", cube, {"views": 2})
    assert cube.visible_get()


def test_a_deleted_collection_does_not_keep_objects_hidden(furnished_scene):
    stage = staging.build(furnished_scene, "turntable", "Cube", {"views": 2})
    for member in list(stage.all_objects):
        bpy.data.objects.remove(member)
    bpy.data.collections.remove(stage)
    staging.build(furnished_scene, "turntable", "Floor", {"views": 2})
    staging.remove(furnished_scene)
    assert not furnished_scene.objects["Floor"].hide_render


def test_what_the_user_puts_into_the_stage_survives_it(empty_scene):
    stage = staging.build(empty_scene, "turntable", "knot", {"views": 2})
    note = bpy.data.objects.new("Note", None)
    stage.objects.link(note)
    staging.remove(empty_scene)
    assert [o.name for o in empty_scene.objects] == ["Note"]


def test_one_camera_needs_no_markers_and_several_are_bound(empty_scene):
    staging.build(empty_scene, "turntable", "knot", {"views": 3})
    assert not empty_scene.timeline_markers
    stage = staging.build(empty_scene, "turntable", "knot", {"views": 3, "elevations": "10,30"})
    assert [marker.frame for marker in empty_scene.timeline_markers] == [1, 2, 3, 4, 5, 6]
    cameras = ownership.with_role(stage, "camera")
    for frame in range(1, 7):
        empty_scene.frame_set(frame)
        assert empty_scene.camera == cameras[(frame - 1) % 2]


def test_a_stage_survives_saving(empty_scene, tmp_path):
    staging.build(empty_scene, "turntable", "knot", {"views": 3, "elevations": "10,30"})
    plan, truth = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "stage.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "stage.blend"))
    again = readback.plan_of(bpy.context.scene)
    for found, kept in zip(again.frames, plan.frames, strict=True):
        assert (found.number, found.camera, found.lights) == (kept.number, kept.camera, kept.lights)
    for name, camera in plan.cameras.items():
        np.testing.assert_array_equal(again.cameras[name].P, camera.P)
    np.testing.assert_array_equal(readback.truth_mesh(bpy.context.scene)[0], truth[0])
    staging.remove(bpy.context.scene)
    assert not bpy.context.scene.objects


@pytest.mark.parametrize(("preset", "subject", "options", "message"), [
    ("carousel", "knot", {}, "no preset 'carousel'; the presets are: turntable"),
    ("turntable", "knto", {}, "'knto' is neither built in .*knot.* nor in scene"),
    ("turntable", "knot", {"view": 3}, "no option 'view'"),
    ("turntable", "knot", {"views": 0}, "option views: 0 is not"),
])
def test_bad_input_is_told_before_anything_changes(furnished_scene, preset, subject, options, message):
    staging.build(furnished_scene, "turntable", "Cube", {"views": 3})
    before = inventory(), all_settings(furnished_scene)
    with pytest.raises(ScanstageError, match=message):
        staging.build(furnished_scene, preset, subject, options)
    assert (inventory(), all_settings(furnished_scene)) == before


@pytest.mark.parametrize(("options", "message"), [
    ({"elevations": "20;40"}, "option elevations: '20;40' is not a number"),
    ({"elevations": "20,20"}, "different angles"),
    ({"elevations": "90"}, "between -85 and 85"),
    ({"elevations": "nan"}, "between -85 and 85"),
    ({"distance": 0.05}, "option distance: .* inside the object"),
    ({"elevations": "-30", "backdrop": "black"}, "the platter would hide the object"),
])
def test_a_stage_that_cannot_be_built_leaves_none(furnished_scene, options, message):
    before = inventory(), all_settings(furnished_scene)
    with pytest.raises(ScanstageError, match=message):
        staging.build(furnished_scene, "turntable", "knot", options)
    assert (inventory(), all_settings(furnished_scene)) == before


def test_edit_mode_is_refused(empty_scene):
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(ScanstageError, match="switch to Object Mode"):
        staging.build(empty_scene, "turntable", "Cube", {})
