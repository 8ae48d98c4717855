# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Add > Scan Rig builds the rig of the entry, round the selected objects if there are any."""

import bpy
import numpy as np
import pytest

import addon
from addon.stage import ownership, readback


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


def test_a_rig_is_laid_round_all_that_is_selected_and_built_again_round_the_same(scene):
    for place in (0, 1):
        bpy.ops.mesh.primitive_cube_add(size=0.1, location=(place, 0, 0))
    bpy.ops.object.light_add()
    bpy.ops.object.select_all(action='SELECT')
    assert bpy.ops.scanstage.add_rig(preset="turntable") == {'FINISHED'}
    assert scene.scanstage.source == 'SELECTION'
    both = {member for member in scene.objects if member.type == 'MESH' and not ownership.is_marked(member)}
    assert len(both) == 2 and set(readback.staged_objects(scene)) == both
    bpy.ops.object.select_all(action='DESELECT')
    assert bpy.ops.scanstage.stage() == {'FINISHED'}
    assert set(readback.staged_objects(scene)) == both
    bpy.ops.scanstage.remove_stage()
    with pytest.raises(RuntimeError, match="Select the objects"):
        bpy.ops.scanstage.stage()


def test_the_gallery_builds_round_what_the_panel_names(scene):
    bpy.ops.mesh.primitive_cube_add()  # selected, as Blender's first cube is
    assert bpy.ops.scanstage.add_rig(preset="turntable", use_selection=False) == {'FINISHED'}
    assert scene.scanstage.source == 'BUILTIN'


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
