# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Results as Blender objects: the mesh is the surface, the colours show, and replacing leaves nothing behind."""

import bpy
import numpy as np
import pytest

from addon.compat import node_tree
from addon.reconstruction.color import linear_to_srgb
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.heatmap import add_heat_map, remove_heat_map
from addon.results.materials import heat_map_material, voxel_material
from addon.results.objects import add_polygon_mesh, add_voxel_mesh, remove_result

pytestmark = pytest.mark.usefixtures("empty_scene")

RGB = np.array([(0.9, 0.05, 0.1), (0.02, 0.6, 0.3), (0.1, 0.2, 0.8)], np.float32)


def made(surface, grid, name="Result", rgb=RGB, **options):
    return add_voxel_mesh(name, surface, rgb, collection=bpy.context.scene.collection, grid=grid, **options)


def read(data, name, width, dtype=np.float32):
    values = np.zeros(len(data) * width, dtype)
    data.foreach_get(name, values)
    return values.reshape(-1, width)


def test_the_mesh_is_the_surface(corner, grid):
    mesh = made(corner, grid).data
    assert not mesh.validate(verbose=True)  # True if anything had to be repaired
    np.testing.assert_allclose(read(mesh.vertices, "co", 3), corner.vertices, atol=1e-6)
    np.testing.assert_array_equal(read(mesh.loops, "vertex_index", 1, np.int32).reshape(-1, 4), corner.quads)
    outward = np.repeat(np.eye(3), 2, axis=0) * np.tile([[-1], [1]], (3, 1))
    np.testing.assert_allclose(read(mesh.polygons, "normal", 3), outward[corner.face_axis], atol=1e-6)
    assert len(mesh.edges) == 28  # closed and of sphere type: edges = vertices (16) + faces (14) - 2
    assert not any(polygon.use_smooth for polygon in mesh.polygons)


def test_colors_and_attributes_lie_on_their_faces(corner, grid):
    views = np.array([3, 65000, 7], np.uint16)
    mesh = made(corner, grid, attributes={"views": views, "depth": np.array([0.5, 1.5, 2.5]),
                                          "seen": np.array([True, False, True])}).data
    assert mesh.color_attributes.active_color_name == mesh.color_attributes.default_color_name == "Color"
    color = mesh.color_attributes["Color"]
    assert (color.data_type, color.domain) == ('FLOAT_COLOR', 'CORNER')
    expected = np.ones((14, 4, 4), np.float32)
    expected[..., :3] = RGB[corner.face_voxel][:, None]
    np.testing.assert_array_equal(read(color.data, "color", 4).reshape(14, 4, 4), expected)
    for name, values, dtype in (("views", views, np.int32), ("depth", [0.5, 1.5, 2.5], np.float32),
                                ("seen", [True, False, True], bool)):
        assert mesh.attributes[name].domain == 'FACE'
        found = read(mesh.attributes[name].data, "value", 1, dtype)[:, 0]
        np.testing.assert_array_equal(found, np.asarray(values)[corner.face_voxel])


def test_it_stands_in_the_frame_and_says_what_it_is(corner, grid):
    frame = np.array([(0, -1, 0, 2), (1, 0, 0, -1), (0, 0, 1, 0.5), (0, 0, 0, 1.0)])
    result = made(corner, grid, frame=frame, method="visual-hull")
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(result.matrix_world), frame, atol=1e-7)
    assert result["voxel_size"] == grid.voxel_size
    assert result["method"] == "visual-hull"
    assert result.name in bpy.context.scene.collection.objects


def test_an_earlier_result_is_replaced_without_orphans(corner, grid):
    add_heat_map(made(corner, grid), np.zeros(14), 0.01)
    result = made(corner, grid, method="second")
    assert list(bpy.data.objects) == [result]
    assert list(bpy.data.meshes) == [result.data]
    assert [material.name for material in bpy.data.materials] == [voxel_material().name]
    assert (result.name, result["method"], bpy.data.materials[0].users) == ("Result", "second", 1)
    remove_result("Result")
    assert not (list(bpy.data.objects) or list(bpy.data.meshes) or list(bpy.data.materials))


def test_what_is_not_a_result_is_never_removed(corner, grid):
    mine = bpy.data.objects.new("Result", bpy.data.meshes.new("Result"))
    result = made(corner, grid)
    remove_result("Result")
    assert set(bpy.data.objects) == {mine, result}
    assert result.name == "Result.001"


def test_a_mesh_the_user_still_uses_is_kept(corner, grid):
    result = made(corner, grid)
    copy = bpy.data.objects.new("Copy", result.data)
    made(corner, grid)
    assert copy.data is not None
    assert copy.data.materials[0] == voxel_material()
    assert len(bpy.data.meshes) == 2


def test_all_voxel_meshes_share_a_material_that_the_user_may_change(corner, grid):
    first = made(corner, grid, "First")
    voxel_material().node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.25
    second = made(corner, grid, "Second")
    assert first.data.materials[0] == second.data.materials[0]
    assert voxel_material().node_tree.nodes["Principled BSDF"].inputs["Roughness"].default_value == 0.25


def test_smoothing_nears_the_ball_and_leaves_the_mesh_alone(ball):
    grid, surface = ball
    result = made(surface, grid, rgb=np.ones((len(surface.voxels), 3)), smooth=True)
    np.testing.assert_allclose(read(result.data.vertices, "co", 3), surface.vertices, atol=1e-6)
    evaluated = result.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    radius = np.linalg.norm(read(evaluated.vertices, "co", 3), axis=1)
    before = np.linalg.norm(surface.vertices, axis=1)
    assert radius.std() < before.std() / 3
    assert abs(radius.mean() - 0.9) < grid.voxel_size / 4  # no shrinkage one would see


@pytest.mark.parametrize(("rgb", "attributes", "name"), [
    (RGB[:2], {}, "rgb"), (RGB, {"views": np.zeros(14)}, "views"), (RGB, {"position": np.zeros(3)}, "position"),
    (RGB, {"Color": np.zeros(3)}, "Color")])
def test_arrays_that_do_not_fit_are_refused_by_name(corner, grid, rgb, attributes, name):
    with pytest.raises(ValueError, match=name):
        made(corner, grid, rgb=rgb, attributes=attributes)
    assert not bpy.data.objects
    assert not bpy.data.meshes


def test_a_face_that_names_no_vertex_is_refused():
    with pytest.raises(ValueError, match="from 0 to 2"):
        add_polygon_mesh("Truth", np.zeros((3, 3)), np.array([[0, 1, 3]]), collection=bpy.context.scene.collection)
    assert not bpy.data.meshes


def test_an_empty_surface_is_an_empty_mesh(corner, grid):
    nothing = type(corner)(np.zeros((0, 3)), np.zeros((0, 4), np.int32), np.zeros((0, 3), np.int32),
                           np.zeros(0, np.int32), np.zeros(0, np.int8))
    assert len(made(nothing, grid, rgb=np.zeros((0, 3))).data.polygons) == 0


@pytest.mark.parametrize(("domain", "count"), [('FACE', 14), ('POINT', 16)])
def test_a_heat_map_stores_distances_and_can_be_taken_off(corner, grid, domain, count):
    result = made(corner, grid)
    twin = bpy.data.objects.new("Twin", result.data)
    distances = np.linspace(0, 0.02, count)
    material = add_heat_map(result, distances, 0.01)
    layer = result.data.attributes["error"]
    assert layer.domain == domain
    np.testing.assert_allclose(read(layer.data, "value", 1)[:, 0], distances, rtol=1e-6)
    assert result.material_slots[0].material == material
    assert twin.material_slots[0].material == voxel_material()  # the mesh itself keeps its colours
    remove_heat_map(result)
    assert result.material_slots[0].material == voxel_material()
    assert "error" not in result.data.attributes
    assert [m.name for m in bpy.data.materials] == [voxel_material().name]


def test_a_second_heat_map_replaces_the_first(corner, grid):
    result = made(corner, grid)
    first = add_heat_map(result, np.zeros(14), 0.01)
    second = add_heat_map(result, np.zeros(16), 0.5, signed=True)
    assert first == second
    assert second.node_tree.nodes["Limit"].outputs[0].default_value == 0.5
    assert len(result.material_slots) == 1


@pytest.mark.parametrize(("distances", "limit", "word"), [
    (np.zeros(15), 1, "faces"), (np.full(14, np.nan), 1, "finite"), (np.zeros(14), 0, "limit")])
def test_a_heat_map_refuses_what_it_cannot_show(corner, grid, distances, limit, word):
    result = made(corner, grid)
    with pytest.raises(ValueError, match=word):
        add_heat_map(result, distances, limit)
    assert result.material_slots[0].material == voxel_material()


def row_of_pixels(folder):
    """Return (4, 3) bytes of sRGB: the scene's square from (0, 0) to (4, 4) from above, in white light on all sides."""
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = 'ORTHO', 4
    scene.camera = bpy.data.objects.new("Camera", camera)
    scene.camera.location = (2, 2, 3)
    scene.collection.objects.link(scene.camera)
    scene.world = bpy.data.worlds.new("World")
    node_tree(scene.world).nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = 'CYCLES', 4, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = 'GAUSSIAN', 0.01
    scene.render.resolution_x, scene.render.resolution_y, scene.render.dither_intensity = 4, 4, 0
    scene.view_settings.view_transform = 'Standard'
    scene.render.filepath = str(folder / "picture.png")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    return np.array(image.pixels[:]).reshape(4, 4, 4)[0, :, :3] * 255


def test_voxel_colors_as_rendered(tmp_path):
    grid = VoxelGrid((0, 0, 0), 1, (4, 4, 1))
    surface = extract_surface(SparseVolume.from_dense(grid, np.ones(grid.shape, bool)))
    rgb = np.array([(0.9, 0.1, 0.1), (0.1, 0.9, 0.1), (0.1, 0.1, 0.9), (0.5, 0.5, 0.5)])[surface.voxels[:, 0]]
    made(surface, grid, rgb=rgb)
    expected = 255 * linear_to_srgb(np.array([(0.9, 0.1, 0.1), (0.1, 0.9, 0.1), (0.1, 0.1, 0.9), (0.5, 0.5, 0.5)]))
    # A matt surface under a uniform sky of 1 reflects its own colour; a rough one loses a little at grazing angles.
    np.testing.assert_allclose(row_of_pixels(tmp_path), expected, atol=8)


@pytest.mark.parametrize(("signed", "errors", "expected"), [
    (False, (-1, 0, 0.01, 1), ("440154", "440154", "fde725", "fde725")),
    (True, (-1, 0, 0.01, 1), ("2166ac", "f7f7f7", "b2182b", "b2182b"))])
def test_colors_of_errors_as_rendered(tmp_path, signed, errors, expected):
    # Four strips side by side, one error each, seen from above: the node tree itself is what is tested.
    lattice = np.stack(np.meshgrid(np.arange(5.0), (0.0, 4.0), (0.0,), indexing="ij"), axis=-1).reshape(-1, 3)
    faces = np.array([(0, 2, 3, 1)]) + 2 * np.arange(4)[:, None]
    strips = add_polygon_mesh("Strips", lattice, faces, collection=bpy.context.scene.collection)
    add_heat_map(strips, np.array(errors), 0.01, signed=signed)
    strips.material_slots[0].material = heat_map_material("Plain", 0.01, signed=signed, lit=False)
    found = row_of_pixels(tmp_path)
    wanted = [list(bytes.fromhex(color)) for color in expected]
    np.testing.assert_allclose(found, wanted, atol=1.01)  # a byte of rounding in the ramp, one in the picture
