# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A file saved by hand carries the fingerprint of its plan as it then was."""

import bpy
import pytest

from addon.stage import staging
from addon.stage.fingerprint import fingerprint
from addon.stage.readback import plan_of, truth_mesh
from addon.ui import saving


@pytest.fixture
def stamping():
    saving.register()
    yield
    saving.unregister()


def test_a_saved_stage_is_stamped_as_it_is(empty_scene, stamping, tmp_path):
    file = str(tmp_path / "rig.blend")
    staging.build(empty_scene, "turntable", "knot", {"views": 3})
    bpy.ops.wm.save_as_mainfile(filepath=file)
    first = empty_scene.render.stamp_note_text
    empty_scene.camera.location.x += 0.01
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    scene = bpy.context.scene
    assert scene.render.stamp_note_text == fingerprint(plan_of(scene), truth_mesh(scene)) != first


def test_a_file_without_a_stage_keeps_its_note(empty_scene, stamping, tmp_path):
    empty_scene.render.stamp_note_text = "mine"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "own.blend"))
    assert empty_scene.render.stamp_note_text == "mine"
    staging.build(empty_scene, "turntable", "knot", {"views": 3})
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "own.blend"))
    assert empty_scene.render.stamp_note_text != "mine"
    staging.remove(empty_scene)
    assert empty_scene.render.stamp_note_text == "mine"
