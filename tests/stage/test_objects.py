# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Built-in objects are closed and stand on the table; files come in their own units, or fail in one sentence."""

import shutil

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.results.ply import read_ply, write_ply
from addon.stage import objects, readback, staging
from scripts import make_assets


def edges_of(triangles):
    """Return every directed edge as one number."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)
    return edges[:, 0] * (triangles.max() + 1) + edges[:, 1], edges[:, 1] * (triangles.max() + 1) + edges[:, 0]


def volume_of(vertices, triangles):
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("name", objects.BUILTINS)
def test_builtins_are_closed_and_stand_on_the_table(empty_scene, name):
    staging.build(empty_scene, "turntable", name, {"views": 2})
    vertices, triangles = readback.truth_mesh(empty_scene)
    forward, backward = edges_of(triangles)
    assert len(np.unique(forward)) == len(forward)  # no edge runs twice the same way
    assert np.array_equal(np.sort(forward), np.sort(backward))  # and each runs once each way: closed, well oriented
    assert volume_of(vertices, triangles) > 0
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    assert (upper - lower).max() == pytest.approx(objects.BUILTIN_SIZE, rel=1e-5)
    np.testing.assert_allclose([*(lower + upper)[:2], lower[2]], 0, atol=1e-6)


@pytest.mark.parametrize("name", make_assets.OBJECTS)
def test_assets_are_what_the_script_makes(name):
    path = objects.assets_folder() / "objects" / f"{name}.ply"
    assert path.stat().st_size < 300_000
    stored = read_ply(path)
    vertices, triangles = make_assets.make(name)
    # Another Blender may decimate differently; the shape is the same.
    assert len(triangles) == pytest.approx(len(stored.triangles), rel=0.05)
    assert volume_of(vertices, triangles) == pytest.approx(volume_of(stored.vertices, stored.triangles), rel=0.01)
    np.testing.assert_allclose(vertices.min(axis=0), stored.vertices.min(axis=0), atol=0.001)
    np.testing.assert_allclose(vertices.max(axis=0), stored.vertices.max(axis=0), atol=0.001)


def test_the_pit_of_the_pot_is_two_thirds_as_deep_as_wide():
    pot = read_ply(objects.assets_folder() / "objects" / "pot.ply")
    radius, height = np.linalg.norm(pot.vertices[:, :2], axis=1), pot.vertices[:, 2]
    floor = height[(radius < 0.005) & (height > 0.005)].max()
    # Subdivision rounds the profile, so the pit is not to the point what its profile says.
    mouth = 2 * radius[(height > height.max() * 0.6) & (radius < 0.7 * radius.max() + 0.01)].min()
    assert (height.max() - floor) / mouth == pytest.approx(0.67, abs=0.03)


def test_the_installed_package_has_its_assets_inside(tmp_path, monkeypatch):
    package = tmp_path / "package"
    (package / "stage").mkdir(parents=True)
    monkeypatch.setattr(objects, "__file__", str(package / "stage" / "objects.py"))
    assert objects.assets_folder() == tmp_path / "assets"  # a clone
    (package / "assets").mkdir()
    assert objects.assets_folder() == package / "assets"


@pytest.fixture
def wedge(empty_scene):
    """Return a mesh object without any symmetry, 1 x 2 x 3 in its box."""
    mesh = bpy.data.meshes.new("wedge")
    mesh.from_pydata([(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)], [], [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    wedge = bpy.data.objects.new("wedge", mesh)
    empty_scene.collection.objects.link(wedge)
    wedge.select_set(True)
    bpy.context.view_layer.objects.active = wedge
    return wedge


EXPORTERS = {
    ".ply": lambda path: bpy.ops.wm.ply_export(filepath=path, export_selected_objects=True),
    ".obj": lambda path: bpy.ops.wm.obj_export(filepath=path, export_selected_objects=True),
    ".stl": lambda path: bpy.ops.wm.stl_export(filepath=path, export_selected_objects=True),
    ".glb": lambda path: bpy.ops.export_scene.gltf(filepath=path, use_selection=True),
    ".gltf": lambda path: bpy.ops.export_scene.gltf(filepath=path, use_selection=True, export_format="GLTF_SEPARATE"),
    ".fbx": lambda path: bpy.ops.export_scene.fbx(filepath=path, use_selection=True),
    ".blend": lambda path: bpy.ops.wm.save_as_mainfile(filepath=path, copy=True),
}


# Blender's own exporters of glTF and FBX warn about their future.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("ending", objects.IMPORTERS)
def test_files_of_every_kind(wedge, tmp_path, ending):
    path = tmp_path / f"my wedge{ending.upper() if ending == '.stl' else ending}"
    EXPORTERS[ending](str(path))
    if ending == ".blend":  # a camera and a light in the file are not part of the object
        bpy.ops.wm.open_mainfile(filepath=str(path))
        bpy.ops.object.camera_add()
        bpy.ops.object.light_add()
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    staging.build(scene, "turntable", str(path), {"views": 2})
    vertices, triangles = readback.truth_mesh(scene)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), (1, 2, 3), atol=1e-5)  # in metres, upright
    assert volume_of(vertices, triangles) == pytest.approx(1.0, rel=1e-4)  # 1 * 2 * 3 / 6, seen from outside
    assert vertices[:, 2].min() == pytest.approx(0, abs=1e-6)
    assert [o.type for o in scene.objects].count("CAMERA") == 1
    staging.remove(scene)
    assert not [*bpy.data.objects, *bpy.data.meshes, *bpy.data.materials, *bpy.data.actions, *bpy.data.collections]


def test_fit_scales_a_file(wedge, tmp_path):
    EXPORTERS[".ply"](str(tmp_path / "wedge.ply"))
    staging.build(bpy.context.scene, "turntable", tmp_path / "wedge.ply", {"views": 2, "fit": 0.5})
    vertices, _ = readback.truth_mesh(bpy.context.scene)
    np.testing.assert_allclose(np.ptp(vertices, axis=0), np.array((1, 2, 3)) / 6, rtol=1e-5)
    np.testing.assert_allclose(vertices.min(axis=0)[2], 0, atol=1e-6)


def test_importing_keeps_the_selection(wedge, tmp_path):
    EXPORTERS[".ply"](str(tmp_path / "file.ply"))
    wedge.location.x = 5  # where it is not in the way
    bpy.context.view_layer.update()
    staging.build(bpy.context.scene, "turntable", str(tmp_path / "file.ply"), {"views": 2})
    assert bpy.context.view_layer.objects.active == wedge and bpy.context.selected_objects == [wedge]


def test_fit_does_not_touch_an_object_of_the_scene(wedge):
    with pytest.raises(ScanstageError, match="option fit: object 'wedge' is in the scene already"):
        staging.build(bpy.context.scene, "turntable", "wedge", {"fit": 0.5})


def test_bad_files_are_told_in_one_sentence(empty_scene, tmp_path):
    (tmp_path / "table.txt").write_text("no mesh")
    (tmp_path / "broken.glb").write_bytes(b"glTF is not this")
    (tmp_path / "broken.blend").write_bytes(b"nor is this a .blend")
    (tmp_path / "empty.obj").write_text("# nothing in here\n")
    write_ply(tmp_path / "points.ply", np.random.default_rng(1).random((9, 3)))
    shutil.copyfile(objects.assets_folder() / "objects" / "pot.ply", tmp_path / "cut.ply")
    with open(tmp_path / "cut.ply", "r+b") as file:
        file.truncate(3000)
    problems = {"table.txt": "files ending with '.txt' cannot be staged; use one of .ply", "no.ply": "no such file",
                "broken.glb": "Blender cannot read", "broken.blend": "Blender cannot read",
                "empty.obj": "holds no mesh", "points.ply": "has no faces", "cut.ply": "cut.ply"}
    for name, problem in problems.items():
        with pytest.raises(ScanstageError, match=problem) as error:
            staging.build(empty_scene, "turntable", str(tmp_path / name), {})
        assert name in str(error.value) and "\n" not in str(error.value)
        assert not empty_scene.objects and not bpy.data.meshes
