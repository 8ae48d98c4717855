# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Projectors and lasers added by hand are the user's, show what they are told, and have frusta that follow their optics."""

import bpy
import cv2
import numpy as np
import pytest

import addon
from addon.reconstruction.active.patterns import make_patterns
from addon.stage import laser, ownership, projection, projector, readback, staging


@pytest.fixture
def scene(empty_scene):
    """An empty scene with the extension registered."""
    addon.register()
    yield bpy.context.scene
    addon.unregister()


def frustum_of(made):
    child, = made.children
    points = np.empty(len(child.data.vertices) * 3, np.float32)
    child.data.vertices.foreach_get("co", points)
    return child, points.reshape(-1, 3)


def type_in(made, name, value):
    """Change one input of a projector's optics, as its panel does."""
    projector.lens_of(made.data).inputs[name].default_value = value
    made.data.node_tree.update_tag()
    made.data.update_tag()
    bpy.context.view_layer.update()


def test_a_projector_stands_at_the_cursor_and_is_the_users(scene):
    scene.cursor.location = (1, 2, 3)
    assert bpy.ops.scanstage.add_projector() == {'FINISHED'}
    made = bpy.context.object
    assert projector.is_projector(made) and tuple(made.location) == (1, 2, 3) and made.select_get()
    bpy.ops.scanstage.add_projector()
    assert [ownership.device_id(o) for o in scene.objects if projector.is_projector(o)] == ["projector-1", "projector-2"]
    staging.build(scene, "turntable", "knot", {"views": 1})
    staging.remove(scene)
    assert len(scene.objects) == 4 and not any(o.hide_render for o in scene.objects if o.type == "LIGHT")


def test_the_frustum_is_the_picture_and_follows_the_optics(scene):
    bpy.ops.scanstage.add_projector()
    made = bpy.context.object
    child, before = frustum_of(made)
    assert child.hide_render
    for name, value in (("Throw Ratio", 2.0), ("Shift X", 0.25), ("K1", -0.2)):
        type_in(made, name, value)
    optics = readback.projector_of(scene, made)
    world = np.array(child.matrix_world)
    _, rim = frustum_of(made)
    assert not np.allclose(rim, before)
    pixels, depth = optics.project(rim[:-1] @ world[:3, :3].T + world[:3, 3])
    np.testing.assert_allclose(depth, depth[0], rtol=1e-5)
    from_border = np.abs(np.stack((pixels + 0.5, pixels + 0.5 - optics.size))).min(axis=(0, 2))
    np.testing.assert_allclose(from_border, 0, atol=0.05)  # single precision of a mesh, and OpenCV's iterations
    np.testing.assert_allclose(rim[-1], 0)


def test_a_frustum_of_a_lens_that_folds_is_still_drawn(scene):
    bpy.ops.scanstage.add_projector()
    type_in(bpy.context.object, "K1", -3.0)
    _, rim = frustum_of(bpy.context.object)
    assert np.isfinite(rim).all() and np.abs(rim).max() < 1


def test_a_lasers_fan_turns_with_its_sheet(scene):
    bpy.ops.scanstage.add_laser()
    made = bpy.context.object
    laser.sweep(made.data, [-0.4, 0.3], [True, True])
    for frame in (1, 2):
        scene.frame_set(frame)
        child, fan = frustum_of(made)
        world = np.array(child.matrix_world)
        normal, offset = laser.plane_of(made)
        corners = fan @ world[:3, :3].T + world[:3, 3]
        assert child.hide_render and np.ptp(corners, axis=0).max() > 0.1
        np.testing.assert_allclose(corners @ normal, offset, atol=1e-6)
        assert (corners.sum(axis=0)[0] > 0) == (frame == 2)  # positive is to the right


def test_patterns_and_images(scene, tmp_path):
    bpy.ops.scanstage.add_projector()
    made = bpy.context.object
    for name, value in (("Width", 32), ("Height", 24)):
        projector.lens_of(made.data).inputs[name].default_value = value
    scene.frame_start = 5
    assert bpy.ops.scanstage.project_patterns(pattern_set="gray-code") == {'FINISHED'}
    patterns = make_patterns("gray-code", (32, 24))
    assert (scene.frame_current, scene.frame_end) == (5, 4 + len(patterns))
    for number, pattern in enumerate(patterns, start=5):
        scene.frame_set(number)
        assert projection.pattern_of(made.data, number) == (pattern.id, dict(pattern.fields))
    cv2.imwrite(str(tmp_path / "a.png"), np.full((4, 4, 3), 255, np.uint8))
    assert bpy.ops.scanstage.project_image(filepath=str(tmp_path / "a.png")) == {'FINISHED'}
    assert projection.pattern_of(made.data, 5) == ("image", {"kind": "image", "image": "a.png"})
    for number in (7, 8, 9, 11):
        cv2.imwrite(str(tmp_path / f"s{number:03d}.png"), np.full((4, 4, 3), 255, np.uint8))
    assert bpy.ops.scanstage.project_image(filepath=str(tmp_path / "s007.png"), sequence=True) == {'FINISHED'}
    shown = [projection.pattern_of(made.data, frame)[1]["frame"] for frame in range(5, 10)]
    assert shown == [7, 8, 9, 9, 9]  # the timeline begins at 5; number 10 is missing


def test_bad_input_is_reported(scene, tmp_path):
    bpy.ops.scanstage.add_projector()
    projector.lens_of(bpy.context.object.data).inputs["Width"].default_value = 1
    with pytest.raises(RuntimeError, match="a projector with a single column"):
        bpy.ops.scanstage.project_patterns(pattern_set="gray-code")
    with pytest.raises(RuntimeError, match="cannot be read"):
        bpy.ops.scanstage.project_image(filepath=str(tmp_path / "none.png"))
    bpy.ops.scanstage.add_laser()
    assert laser.is_laser(bpy.context.object)
    with pytest.raises(RuntimeError, match="poll"):
        bpy.ops.scanstage.project_patterns(pattern_set="gray-code")


def test_registering_leaves_nothing_behind(scene):
    def ours():
        return [handler for name in dir(bpy.app.handlers) if isinstance(handlers := getattr(bpy.app.handlers, name), list)
                for handler in handlers if getattr(handler, "__module__", "").startswith("addon.")]

    assert ours()
    addon.unregister()
    assert not ours() and not hasattr(bpy.types.WindowManager, "scanstage_view")
    addon.register()
