# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Add > Scan Rig builds the rig of the entry, round the selected mesh if there is one."""

import bpy
import numpy as np
import pytest

import addon
from addon.stage import ownership


@pytest.fixture
def scene(empty_scene):
    """A scene with the extension registered."""
    addon.register()
    yield bpy.context.scene
    addon.unregister()


def test_a_rig_is_laid_round_the_selected_mesh(scene):
    bpy.ops.mesh.primitive_cube_add(size=0.1, location=(1, 2, 3))
    cube = bpy.context.object
    assert bpy.ops.scanstage.add_rig(preset="stereo-pair") == {'FINISHED'}
    assert (scene.scanstage.preset, scene.scanstage.source, scene.scanstage.subject) == ("stereo-pair", 'SCENE', cube)
    assert np.allclose(cube.matrix_world.translation, (1, 2, 3))
    assert ownership.find_stage(scene) is not None


def test_without_a_selected_mesh_the_panel_names_the_object(scene):
    bpy.ops.mesh.primitive_cube_add(size=0.1)
    bpy.context.object.select_set(False)
    assert bpy.ops.scanstage.add_rig(preset="turntable") == {'FINISHED'}
    assert (scene.scanstage.source, scene.scanstage.subject) == ('BUILTIN', None)


def test_the_object_of_the_rig_that_is_replaced_is_not_taken_for_the_users(scene):
    assert bpy.ops.scanstage.add_rig(preset="turntable") == {'FINISHED'}
    staged = next(member for member in ownership.find_stage(scene).all_objects if member.type == 'MESH')
    bpy.context.view_layer.objects.active = staged
    staged.select_set(True)
    assert bpy.ops.scanstage.add_rig(preset="stereo-pair") == {'FINISHED'}
    assert (scene.scanstage.source, scene.scanstage.subject) == ('BUILTIN', None)


def test_a_rig_that_cannot_be_built_leaves_the_choice(scene):
    bpy.ops.mesh.primitive_cube_add(size=0.1)
    bpy.context.object.data.clear_geometry()
    before = scene.scanstage.preset
    with pytest.raises(RuntimeError):
        bpy.ops.scanstage.add_rig(preset="stereo-pair")
    assert (scene.scanstage.preset, scene.scanstage.source, scene.scanstage.subject) == (before, 'BUILTIN', None)
