# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A truth from any mesh file: the same triangles from every format, where the file says they are, and nothing left behind."""

import sys

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.geometry import rotation_about
from addon.reconstruction.mesh import TriangleMesh
from addon.results.meshes import read_mesh
from addon.results.ply import write_ply
from tests.rigs import Ball, sphere_mesh

pytestmark = [pytest.mark.usefixtures("empty_scene"),
              # Blender 5.2's .fbx exporter, which only these tests use, with a numpy newer than its own
              pytest.mark.filterwarnings("ignore:Setting the shape on a NumPy array:DeprecationWarning")]

MESH = sphere_mesh(Ball((0.3, -0.2, 0.5), 0.4), 8)
EXPORTERS = {
    ".ply": lambda path: bpy.ops.wm.ply_export(filepath=path),
    ".obj": lambda path: bpy.ops.wm.obj_export(filepath=path),
    ".stl": lambda path: bpy.ops.wm.stl_export(filepath=path),
    ".glb": lambda path: bpy.ops.export_scene.gltf(filepath=path, export_format='GLB'),
    ".gltf": lambda path: bpy.ops.export_scene.gltf(filepath=path, export_format='GLTF_SEPARATE'),
    ".fbx": lambda path: bpy.ops.export_scene.fbx(filepath=path, global_scale=1.0),
    ".blend": lambda path: bpy.ops.wm.save_as_mainfile(filepath=path, copy=True),
}
EVERY_FORMAT = pytest.mark.parametrize("ending", EXPORTERS)


def inventory():
    return sorted((type(block).__name__, block.name, block.session_uid) for block in bpy.data.user_map())


def add(name, mesh: TriangleMesh, **placed):
    data = bpy.data.meshes.new(name)
    data.from_pydata(mesh.vertices.tolist(), [], mesh.triangles.tolist())
    added = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(added)
    for field, value in placed.items():
        setattr(added, field, value)
    return added


def corners(mesh: TriangleMesh) -> np.ndarray:
    """Return the triangles' corners in an order that does not depend on the file: a format may number them anew."""
    triangles = mesh.corners().reshape(-1, 9)
    turned = np.stack([np.roll(triangles, 3 * turn, axis=1) for turn in range(3)], axis=1)  # the same triangle from each corner
    keys = np.round(turned, 4)
    first = [max(range(3), key=lambda turn, row=row: tuple(row[turn])) for row in keys]
    ordered = turned[np.arange(len(turned)), first]
    return ordered[np.lexsort(np.round(ordered, 4).T)]


@EVERY_FORMAT
def test_every_format_gives_the_same_triangles_and_leaves_nothing(tmp_path, ending):
    add("Truth", MESH)
    path = tmp_path / f"truth{ending}"
    EXPORTERS[ending](str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mine = add("Truth", MESH, location=(9, 9, 9))  # of the same name
    before = inventory()
    found = read_mesh(path)
    assert inventory() == before and mine.name == "Truth" and list(bpy.context.scene.objects) == [mine]
    # Single precision, and six decimals in .obj.
    assert found.volume() == pytest.approx(MESH.volume(), rel=1e-5)
    np.testing.assert_allclose(corners(found), corners(MESH), atol=2e-6)


@EVERY_FORMAT
def test_objects_stand_where_their_parents_and_transforms_put_them(tmp_path, ending):
    """The test is blind unless the object's own vertices lie elsewhere: a parent that moves, turns and scales sees to it."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.location, parent.rotation_euler, parent.scale = (3.0, 1.0, -2.0), (0, 0, 0.5), (2, 2, 2)
    add("Truth", MESH, parent=parent, location=(0, 0, 0.25))
    bpy.context.view_layer.update()
    EXPORTERS[ending](str(tmp_path / f"truth{ending}"))
    expected = TriangleMesh(2 * (MESH.vertices + (0, 0, 0.25)) @ rotation_about((0, 0, 1), 0.5).T + (3, 1, -2), MESH.triangles)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    found = read_mesh(tmp_path / f"truth{ending}")
    np.testing.assert_allclose(found.bounds(), expected.bounds(), atol=1e-5)
    assert found.volume() == pytest.approx(8 * MESH.volume(), rel=1e-5)


@pytest.mark.parametrize("ending", [".blend", ".glb"])
def test_several_objects_are_one_mesh_and_what_has_no_surface_is_ignored(tmp_path, ending):
    add("One", MESH)
    add("Other", MESH, location=(5, 0, 0))
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", 'POINT'))
    bpy.context.scene.collection.objects.link(lamp)
    EXPORTERS[ending](str(tmp_path / f"truth{ending}"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    found = read_mesh(tmp_path / f"truth{ending}")
    assert len(found.triangles) == 2 * len(MESH.triangles)
    assert found.volume() == pytest.approx(2 * MESH.volume(), rel=1e-5)
    assert "Lamp" not in bpy.data.lights


def test_modifiers_count_as_they_do_where_the_object_is_staged(tmp_path):
    add("Truth", MESH).modifiers.new("Twice", 'ARRAY').relative_offset_displace = (3, 0, 0)
    EXPORTERS[".blend"](str(tmp_path / "truth.blend"))
    assert read_mesh(tmp_path / "truth.blend").volume() == pytest.approx(2 * MESH.volume(), rel=1e-5)


def test_a_ply_needs_no_blender(tmp_path, monkeypatch):
    write_ply(tmp_path / "TRUTH.PLY", MESH.vertices, MESH.triangles, double=True)
    monkeypatch.setitem(sys.modules, "bpy", None)
    np.testing.assert_array_equal(read_mesh(tmp_path / "TRUTH.PLY").vertices, MESH.vertices)


@pytest.mark.parametrize(("name", "content", "message"), [
    ("none.obj", None, "there is no such file"), ("truth.xyz", b"1 2 3", r"unknown ending; a mesh can be read from \.ply \.obj"),
    ("truth", b"", "unknown ending"), ("bad.ply", b"garbage", "it is not a PLY file"),
    ("points.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n",
     "holds no mesh"),
    ("bad.obj", b"garbage", "holds no mesh"), ("bad.stl", b"garbage", "cannot be read"), ("bad.glb", b"garbage", "cannot be read"),
    ("bad.fbx", b"garbage", "cannot be read"), ("bad.blend", b"garbage", "cannot be read"),
])
def test_a_bad_file_is_named_in_one_sentence_and_leaves_nothing(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    before = inventory()
    with pytest.raises(ScanstageError, match=f"{name}: ({message})") as caught:
        read_mesh(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert inventory() == before


@pytest.mark.parametrize("ending", [".ply", ".blend"])
def test_a_coordinate_that_is_not_finite_is_refused(tmp_path, ending):
    """Blender's importers make zeros of them in text; in these two formats they come through."""
    add("Truth", MESH).data.vertices[3].co.x = float("nan")
    EXPORTERS[ending](str(tmp_path / f"truth{ending}"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with pytest.raises(ScanstageError, match=f"truth{ending}: .*finite"):
        read_mesh(tmp_path / f"truth{ending}")
    assert not bpy.data.objects
