# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every rig has its picture, and a rig of the user's own is kept as a preset."""

import bpy
import pytest

import addon
from addon.captures.pictures import picture_size
from addon.stage.objects import assets_folder
from addon.stage.presets import PRESETS


@pytest.fixture
def scene(empty_scene, tmp_path, monkeypatch):
    """A scene with the extension registered, and a user folder of its own."""
    monkeypatch.setenv("BLENDER_USER_SCRIPTS", str(tmp_path))
    addon.register()
    yield bpy.context.scene
    addon.unregister()


def test_every_rig_has_a_small_picture():
    pictures = {path.stem: path for path in (assets_folder() / "rigs").iterdir()}
    assert pictures.keys() == PRESETS.keys()
    assert {picture_size(path) for path in pictures.values()} == {(160, 160)}
    assert all(path.stat().st_size < 30_000 for path in pictures.values())


def test_the_users_own_rig_is_kept_and_chosen_again(scene, tmp_path):
    settings = scene.scanstage
    settings.preset, settings.preset_stereo_pair.views = "stereo-pair", 5
    assert bpy.ops.scanstage.save_rig(name="Two eyes") == {'FINISHED'}
    file = tmp_path / "presets" / "scanstage" / "rigs" / "Two_eyes.py"
    assert file.is_file()

    settings.preset, settings.preset_stereo_pair.views, settings.preset_turntable.views = "turntable", 9, 7
    assert bpy.ops.script.execute_preset(filepath=str(file), menu_idname="SCANSTAGE_PT_own_rigs") == {'FINISHED'}
    assert (settings.preset, settings.preset_stereo_pair.views) == ("stereo-pair", 5)
    assert settings.preset_turntable.views == 7  # another rig's options are not the preset's

    assert bpy.ops.scanstage.save_rig(name="Two eyes", remove_name=True) == {'FINISHED'}
    assert not file.exists()
