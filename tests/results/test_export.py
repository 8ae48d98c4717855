# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every format written and read again by Blender: same place, same colours, and nothing disturbed."""

import json
import struct

import bpy
import numpy as np
import pytest

from addon import compat
from addon.errors import ScanstageError
from addon.reconstruction.volumetric.coloring import SurfaceColors
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.export import FORMATS, export_mesh, export_result, split_voxels
from addon.results.folder import write_result
from addon.results.objects import add_voxel_mesh

pytestmark = pytest.mark.usefixtures("empty_scene")

ENDINGS = [ending for ending in FORMATS if ending != ".vdb" or compat.openvdb() is not None]
RGB = np.array([(0.9, 0.05, 0.1), (0.02, 0.6, 0.3), (0.1, 0.2, 0.8)], np.float32)
FRAME = np.array([(0, -1, 0, 2.0), (1, 0, 0, -1.0), (0, 0, 1, 0.5), (0, 0, 0, 1)])

IMPORTERS = {".ply": lambda path: bpy.ops.wm.ply_import(filepath=path),
             ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
             ".stl": lambda path: bpy.ops.wm.stl_import(filepath=path),
             ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
             ".blend": lambda path: bpy.ops.wm.open_mainfile(filepath=path)}


def face_colors(mesh):
    """Return each face's centre in the mesh's frame and its corners' mean colour, linear."""
    layer = mesh.color_attributes.active_color
    colors = np.array([value.color[:3] for value in layer.data])
    if layer.domain == 'POINT':
        colors = colors[[loop.vertex_index for loop in mesh.loops]]
    spread = [np.ptp(colors[p.loop_start:p.loop_start + p.loop_total], axis=0).max() for p in mesh.polygons]
    means = [colors[p.loop_start:p.loop_start + p.loop_total].mean(axis=0) for p in mesh.polygons]
    return np.array([p.center for p in mesh.polygons]), np.array(means), max(spread)


@pytest.mark.parametrize("ending", IMPORTERS)
def test_imported_again_it_stands_where_it_stood(tmp_path, corner, grid, ending):
    path = tmp_path / f"made{ending}"
    export_mesh(corner, RGB, path, grid=grid, frame=FRAME)
    IMPORTERS[ending](str(path))
    (found,) = bpy.data.objects
    bpy.context.view_layer.update()
    placed = np.array([found.matrix_world @ vertex.co for vertex in found.data.vertices])
    expected = corner.vertices @ FRAME[:3, :3].T + FRAME[:3, 3]
    # Coordinates near 2 in single precision; .obj writes six decimals.
    np.testing.assert_allclose(placed.min(axis=0), expected.min(axis=0), atol=2e-6)
    np.testing.assert_allclose(placed.max(axis=0), expected.max(axis=0), atol=2e-6)


@pytest.mark.parametrize("ending", [".ply", ".obj", ".glb", ".blend"])
def test_every_face_keeps_the_color_of_its_voxel(tmp_path, corner, grid, ending):
    path = tmp_path / f"made{ending}"
    export_mesh(corner, RGB, path, grid=grid)
    IMPORTERS[ending](str(path))
    (found,) = bpy.data.objects
    centres, colors, spread = face_colors(found.data)
    centres = np.array([found.matrix_world @ found.data.vertices[0].co.__class__(c) for c in centres])
    # A face belongs to the voxel whose centre is nearest: half a voxel away, the next one more.
    nearest = np.linalg.norm(centres[:, None] - grid.centres(corner.voxels), axis=2).argmin(axis=1)
    # .ply holds bytes of sRGB, and Blender imports .glb colours as such: half a step of 1/255, times the curve's
    # greatest slope of 2.3. .obj holds four decimals of sRGB.
    tolerance = {".ply": 0.0046, ".obj": 1.2e-4, ".glb": 0.0046, ".blend": 1e-7}[ending]
    np.testing.assert_allclose(colors, RGB[nearest], atol=tolerance)
    assert spread <= tolerance


def test_the_glb_shows_its_colors_in_any_viewer(tmp_path, corner, grid):
    path = tmp_path / "made.glb"
    export_mesh(corner, RGB, path, grid=grid)
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document, binary = json.loads(data[20:20 + length]), data[28 + length:]
    assert len(document["scenes"]) == 1  # not the user's
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, one = {5126: ("<f4", 1), 5123: ("<u2", 65535)}[accessor["componentType"]]  # Blender 4.5, Blender 5
    width = {"VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stored = np.frombuffer(binary, dtype, accessor["count"] * width, start).reshape(-1, width)[:, :3] / one
    # The format's colours are linear; 16 bits hold them to half a step.
    assert np.abs(stored[:, None] - RGB).max(axis=2).min(axis=1).max() < 1 / 65535
    # A viewer multiplies the colour by this factor, white if it is not given.
    material = document["materials"][primitive["material"]]
    assert material.get("pbrMetallicRoughness", {}).get("baseColorFactor", [1, 1, 1, 1]) == [1, 1, 1, 1]


def test_an_obj_names_the_material_file_beside_it(tmp_path, corner, grid):
    export_mesh(corner, RGB, tmp_path / "made.obj", grid=grid)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["made.mtl", "made.obj"]
    assert "mtllib made.mtl" in (tmp_path / "made.obj").read_text().splitlines()


@pytest.mark.parametrize("ending", ENDINGS)
def test_the_session_is_left_as_it_was(tmp_path, corner, grid, ending):
    mine = add_voxel_mesh("made", corner, RGB, collection=bpy.context.scene.collection, grid=grid)
    mine.select_set(True)
    bpy.context.view_layer.objects.active = mine
    before = {kind: sorted(getattr(bpy.data, kind).keys()) for kind in
              ("scenes", "objects", "meshes", "materials", "collections", "worlds", "images", "node_groups")}
    scene = bpy.context.scene
    export_mesh(corner, RGB, tmp_path / f"made{ending}", grid=grid)
    assert {kind: sorted(getattr(bpy.data, kind).keys()) for kind in before} == before
    assert bpy.context.scene == scene
    assert bpy.context.view_layer.objects.active == mine
    assert mine.select_get()
    assert {p.suffix for p in tmp_path.iterdir()} <= {ending, ".mtl"}


def test_an_older_file_is_replaced_and_capital_endings_are_known(tmp_path, corner, grid):
    path = tmp_path / "MADE.PLY"
    path.write_text("older")
    export_mesh(corner, RGB, path, grid=grid)
    assert path.read_bytes().startswith(b"ply\n")
    assert list(tmp_path.iterdir()) == [path]


def test_errors_name_the_file_and_leave_nothing(tmp_path, corner, grid):
    with pytest.raises(ScanstageError, match=r"made\.fbx.*\.blend \.ply \.obj \.stl \.glb \.vox \.npz \.txt \.vdb"):
        export_mesh(corner, RGB, tmp_path / "made.fbx", grid=grid)
    for ending in ENDINGS:
        with pytest.raises(ScanstageError, match="cannot be written"):
            export_mesh(corner, RGB, tmp_path / "none" / f"made{ending}", grid=grid)
    nothing = type(corner)(np.zeros((0, 3)), np.zeros((0, 4), np.int32), np.zeros((0, 3), np.int32),
                           np.zeros(0, np.int32), np.zeros(0, np.int8))
    with pytest.raises(ScanstageError, match="no voxels"):
        export_mesh(nothing, np.zeros((0, 3)), tmp_path / "made.ply", grid=grid)
    assert not list(tmp_path.iterdir())
    assert not bpy.data.objects
    assert not bpy.data.meshes


def test_split_voxels_share_no_vertex_and_keep_their_shape(ball):
    _, surface = ball
    split = split_voxels(surface)
    np.testing.assert_array_equal(split.vertices[split.quads], surface.vertices[surface.quads])
    owners = np.unique(np.stack((split.quads.ravel(), np.repeat(split.face_voxel, 4))), axis=1)
    assert owners.shape[1] == len(split.vertices)  # every vertex has exactly one owner


def test_smoothing_reaches_the_file(tmp_path, ball):
    grid, surface = ball
    for ending in (".ply", ".obj", ".stl", ".glb"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        export_mesh(surface, np.ones((len(surface.voxels), 3)), tmp_path / f"made{ending}", grid=grid, smooth=True)
        IMPORTERS[ending](str(tmp_path / f"made{ending}"))
        vertices = np.array([bpy.data.objects[0].matrix_world @ v.co for v in bpy.data.objects[0].data.vertices])
        assert np.linalg.norm(vertices, axis=1).std() < np.linalg.norm(surface.vertices, axis=1).std() / 3


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_result_without_colors_is_written_too(tmp_path, corner, grid, ending):
    path = tmp_path / f"made{ending}"
    export_mesh(corner, None, path, grid=grid)
    if ending in IMPORTERS:
        IMPORTERS[ending](str(path))
        assert len(bpy.data.objects[0].data.color_attributes) == 0


def test_a_result_folder_is_exported_with_its_options(tmp_path, corner, grid):
    occupancy = np.zeros(grid.shape, bool)
    occupancy[tuple(corner.voxels.T)] = True
    write_result(tmp_path / "result", volume=SparseVolume.from_dense(grid, occupancy), surface=corner,
                 colors=SurfaceColors(RGB, np.ones(3, np.uint16)), report={"method": "visual-hull"},
                 preview=np.zeros((4, 4, 3), np.uint8))
    assert export_result(tmp_path / "result", tmp_path / "made.blend", {"smooth": "yes"}) == 14
    IMPORTERS[".blend"](str(tmp_path / "made.blend"))
    (found,) = bpy.context.scene.objects
    assert (found["method"], found["voxel_size"], len(found.modifiers)) == ("visual-hull", grid.voxel_size, 1)
    with pytest.raises(ScanstageError, match="no option 'rough'"):
        export_result(tmp_path / "result", tmp_path / "made.ply", {"rough": True})
