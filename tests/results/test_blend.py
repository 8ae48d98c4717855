# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole .blend files: what is saved is opened again, and what cannot be is one sentence with the file's name."""

import bpy
import numpy as np
import pytest
from mathutils import Vector

from addon.errors import ScanstageError
from addon.results.blend import frame_scene, new_file, open_blend, save_blend

pytestmark = pytest.mark.usefixtures("empty_scene")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def add_empty(name):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, None))


def test_a_new_file_is_empty_and_in_metres():
    add_empty("Left Over")
    bpy.context.scene.unit_settings.scale_length = 0.01
    new_file()
    assert not bpy.data.objects and not bpy.data.meshes
    units = bpy.context.scene.unit_settings
    assert (units.system, units.scale_length, units.length_unit) == ('METRIC', 1.0, 'METERS')


def test_what_is_saved_is_opened_again(tmp_path):
    add_empty("Kept")
    path = tmp_path / "deep" / "er" / "scene.blend"
    save_blend(path)
    new_file()
    open_blend(path)
    assert bpy.data.objects.keys() == ["Kept"]
    assert bpy.data.filepath == str(path)
    assert names(path.parent) == ["scene.blend"]


def test_saving_leaves_the_open_file_alone(tmp_path):
    save_blend(tmp_path / "scene.blend")
    assert bpy.data.filepath == ""


def test_an_older_file_is_replaced_and_files_with_like_names_are_not(tmp_path):
    """Blender appends the ending .blend to a temporary name: it must not become another file's."""
    for name in ("scene.blend", ".scene.blend.blend", ".scene.blend", "scene.blend1"):
        (tmp_path / name).write_text("mine")
    add_empty("Kept")
    save_blend(tmp_path / "scene.blend")
    assert names(tmp_path) == [".scene.blend", ".scene.blend.blend", "scene.blend", "scene.blend1"]
    assert [(tmp_path / name).read_text() for name in (".scene.blend.blend", ".scene.blend", "scene.blend1")] == ["mine"] * 3
    open_blend(tmp_path / "scene.blend")
    assert bpy.data.objects.keys() == ["Kept"]


def test_paths_are_relative_to_the_file(tmp_path):
    picture = bpy.data.images.new("Picture", 4, 4)
    picture.filepath_raw, picture.file_format = str(tmp_path / "picture.png"), 'PNG'
    picture.save()
    picture.use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "first.blend"))  # Blender knows relative paths from here on
    bpy.ops.file.make_paths_relative()
    save_blend(tmp_path / "sub" / "scene.blend")
    open_blend(tmp_path / "sub" / "scene.blend")
    assert bpy.data.images["Picture"].filepath.replace("\\", "/") == "//../picture.png"


@pytest.mark.parametrize("name", ["scene", "scene.txt", "scene.blend.gz"])
def test_another_ending_is_refused(tmp_path, name):
    with pytest.raises(ScanstageError, match=f"{name}: a scene is saved as .blend; change the file's ending$"):
        save_blend(tmp_path / name)
    assert not names(tmp_path)


@pytest.mark.parametrize("place", ["file/scene.blend", "folder.blend"])
def test_a_place_that_cannot_be_written_is_named_and_left_as_it_was(tmp_path, place):
    (tmp_path / "file").touch()
    (tmp_path / "folder.blend").mkdir()
    with pytest.raises(ScanstageError, match=f"{place}: cannot be written") as caught:
        save_blend(tmp_path / place)
    assert "\n" not in str(caught.value) and str(caught.value).count("scene.blend") <= 1
    assert names(tmp_path) == ["file", "folder.blend"]


def test_a_file_that_is_not_there_says_how_to_make_one(tmp_path):
    with pytest.raises(ScanstageError, match=r"none.blend: there is no such file; make one with `scanstage stage PRESET --out .*`$"):
        open_blend(tmp_path / "none.blend")
    with pytest.raises(ScanstageError, match="there is no such file"):
        open_blend(tmp_path)


@pytest.mark.parametrize("content", ["nothing", "garbage", "half"])
def test_a_file_that_is_no_blend_is_named(tmp_path, content):
    path = tmp_path / "bad.blend"
    add_empty("Kept")
    save_blend(path)
    data = path.read_bytes()
    path.write_bytes({"nothing": b"", "garbage": b"BLENDER but no more", "half": data[:len(data) // 2]}[content])
    with pytest.raises(ScanstageError, match="bad.blend: Blender cannot open it") as caught:
        open_blend(path)
    assert "\n" not in str(caught.value)


def views():
    return [area.spaces.active for screen in bpy.data.screens for area in screen.areas if area.type == 'VIEW_3D']


def test_a_saved_file_opens_with_the_whole_scene_in_view(tmp_path):
    """All of it lies in the ball that the view shows: a mesh counts with its corners, a rig's empty with its place."""
    new_file()
    box = bpy.data.meshes.new("Box")
    box.from_pydata([(x, y, z) for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)], [], [])
    member = bpy.data.objects.new("Box", box)
    member.location = (1, 2, 3)
    bpy.context.scene.collection.objects.link(member)
    add_empty("Camera's Place")
    frame_scene(bpy.context.scene)
    save_blend(tmp_path / "scene.blend")
    open_blend(tmp_path / "scene.blend")
    far_corner = Vector((1.1, 2.2, 3.3))
    assert views()
    for view in views():
        np.testing.assert_allclose(view.region_3d.view_location, far_corner / 2, rtol=1e-6)
        assert view.region_3d.view_distance == pytest.approx(far_corner.length, rel=1e-6)
        assert view.shading.type == 'MATERIAL'


def test_the_view_of_an_empty_scene_is_left_as_it_was():
    new_file()
    before = [(tuple(view.region_3d.view_location), view.region_3d.view_distance, view.shading.type) for view in views()]
    frame_scene(bpy.context.scene)
    assert before == [(tuple(view.region_3d.view_location), view.region_3d.view_distance, view.shading.type) for view in views()]
