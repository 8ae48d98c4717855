# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result stands beside its object, in no render's way, is replaced without a trace, and is compared with the true object."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.captures.store import read_capture, read_picture
from addon.errors import ScanstageError
from addon.reconstruction.evaluation import inside
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.mesh import TriangleMesh
from addon.reconstruction.points import PointCloud
from addon.reconstruction.volumetric.coloring import SurfaceColors
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.render.capture import capture_frames
from addon.results.folder import Result
from addon.results.present import face_errors, results_collection, show_comparison, show_result
from addon.stage import staging
from addon.stage.readback import truth_mesh
from tests.rigs import Ball, sphere_mesh

KINDS = ("scenes", "objects", "meshes", "materials", "curves", "lights", "cameras", "worlds", "collections", "actions", "node_groups")
SMALL = {"views": 4, "resolution_x": 64, "resolution_y": 48}


def inventory():
    return {kind: sorted(getattr(bpy.data, kind).keys()) for kind in KINDS}


def result_of(truth: TriangleMesh, folder, voxels: int = 24) -> Result:
    """Return what a method that knows the truth would find: its voxels, each with a colour of its own."""
    lower, upper = truth.bounds()
    volume = inside(truth, VoxelGrid.from_bounds(lower - 0.01, upper + 0.01, voxels))
    surface = extract_surface(volume)
    count = len(surface.voxels)
    colors = SurfaceColors(np.linspace(0, 1, 3 * count, dtype=np.float32).reshape(count, 3), np.arange(count, dtype=np.uint16))
    return Result(folder, {"method": "visual-hull"}, volume, surface, colors)


@pytest.fixture
def staged(empty_scene):
    staging.build(empty_scene, "turntable", "knot", SMALL)
    return empty_scene


@pytest.fixture
def found(staged, tmp_path):
    return result_of(TriangleMesh(*truth_mesh(staged)), tmp_path / "result")


def points_of(result: Result) -> PointCloud:
    """Return a point at every surface voxel."""
    positions = result.volume.grid.centres(result.surface.voxels)
    count = len(positions)
    return PointCloud(positions, np.tile((0.0, 0.0, 1.0), (count, 1)), np.full((count, 3), 0.5), np.zeros(count), np.zeros(count))


def placed(target) -> np.ndarray:
    """Return the vertices of a mesh object in the world."""
    points = np.zeros((len(target.data.vertices), 3), np.float32)
    target.data.vertices.foreach_get("co", points.ravel())
    matrix = np.array(target.matrix_world)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def compare(scene, result, truth):
    return show_comparison(scene, result, truth, face_errors(result, truth))


# --- the result --------------------------------------------------------------------------------------------------------------

def test_the_result_stands_beside_the_object(staged, found):
    shown = show_result(staged, found)
    bpy.context.view_layer.update()
    truth = truth_mesh(staged)[0]  # the table stands at the origin, so the object frame is the world
    points, voxel = placed(shown), found.volume.grid.voxel_size
    width = np.ptp(found.surface.vertices[:, 0])
    np.testing.assert_allclose(points - found.surface.vertices, np.broadcast_to((1.6 * width, 0, 0), points.shape), atol=1e-6)
    assert points[:, 0].min() - truth[:, 0].max() == pytest.approx(0.6 * width, abs=voxel)
    assert list(results_collection(staged).objects) == [shown]
    assert (shown["method"], shown["voxel_size"]) == ("visual-hull", pytest.approx(voxel))
    assert {"views", "Color"} <= set(shown.data.attributes.keys())


def test_it_stands_as_the_object_did_at_the_first_frame_and_the_timeline_stays(empty_scene, tmp_path):
    """The user's own object, elsewhere, half way round the table."""
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(3, -2, 1))
    cube = bpy.context.object
    staging.build(empty_scene, "turntable", cube.name, SMALL)
    found = result_of(TriangleMesh(*truth_mesh(empty_scene)), tmp_path)
    empty_scene.frame_set(3)
    camera = empty_scene.camera
    points = placed(show_result(empty_scene, found))
    assert (empty_scene.frame_current, empty_scene.camera) == (3, camera)
    np.testing.assert_allclose(points.mean(axis=0)[1:], (-2, 1), atol=found.volume.grid.voxel_size)
    assert points[:, 0].min() > 3.1
    compare(empty_scene, found, TriangleMesh(*truth_mesh(empty_scene)))
    assert (empty_scene.frame_current, empty_scene.camera) == (3, camera)


def test_smoothing_is_a_live_modifier(staged, found):
    assert not show_result(staged, found).modifiers
    assert [modifier.type for modifier in show_result(staged, found, smooth=True).modifiers] == ['SMOOTH']


def test_without_a_stage_it_stands_beside_where_the_object_was(empty_scene, tmp_path):
    """As after an import of photographs."""
    found = result_of(sphere_mesh(Ball((0, 0, 1), 0.5)), tmp_path)
    shown = show_result(empty_scene, replace(found, colors=None))
    assert len(shown.data.color_attributes) == 0
    assert placed(shown)[:, 0].min() > 0.5
    np.testing.assert_allclose(placed(shown).mean(axis=0)[1:], (0, 1), atol=0.02)


def test_a_result_without_voxels_is_refused_and_changes_nothing(staged, found):
    volume = SparseVolume.from_dense(found.volume.grid, np.zeros(found.volume.grid.shape, bool))
    empty = replace(found, volume=volume, surface=extract_surface(volume), colors=None)
    before = inventory()
    for show in (lambda: show_result(staged, empty), lambda: show_comparison(staged, empty, sphere_mesh(Ball((0, 0, 0), 1)), np.zeros(0))):
        with pytest.raises(ScanstageError, match="result: the result has no voxels to show"):
            show()
    assert inventory() == before


# --- what it replaces, and what it does not ----------------------------------------------------------------------------------

def test_showing_again_leaves_no_orphans(staged, found):
    truth = TriangleMesh(*truth_mesh(staged))
    show_result(staged, found)
    compare(staged, found, truth)
    once = inventory()
    for smooth in (True, False):
        show_result(staged, found, smooth=smooth)
        compare(staged, found, truth)
    assert inventory() == once
    assert not [block.name for kind in ("meshes", "curves", "materials") for block in getattr(bpy.data, kind) if not block.users]


def test_an_object_of_the_users_called_result_is_left_alone(staged, found):
    mine = bpy.data.objects.new("Result", bpy.data.meshes.new("Result"))
    staged.collection.objects.link(mine)
    show_result(staged, found)
    before = inventory()
    shown = show_result(staged, found)
    assert inventory() == before and bpy.data.objects["Result"] == mine
    assert list(results_collection(staged).objects) == [shown]


def test_every_scene_has_its_own_result(staged, found):
    first = show_result(staged, found)
    other = bpy.data.scenes.new("Other")
    second = show_result(other, found)
    assert list(results_collection(staged).objects) == [first] and list(results_collection(other).objects) == [second]


def test_the_collection_is_found_where_the_user_moved_it(staged, found):
    show_result(staged, found)
    home, drawer = results_collection(staged), bpy.data.collections.new("Drawer")
    staged.collection.children.link(drawer)
    staged.collection.children.unlink(home)
    drawer.children.link(home)
    show_result(staged, found)
    compare(staged, found, TriangleMesh(*truth_mesh(staged)))
    assert results_collection(staged) == home and len(home.objects) == 1 and home.children.keys() == ["Comparison"]


def test_capturing_again_shows_the_object_alone(staged, found, tmp_path):
    list(capture_frames(staged, tmp_path / "before"))
    shown = show_result(staged, found)
    shown.location = (0, 0, 0)  # in the cameras' way
    compare(staged, found, TriangleMesh(*truth_mesh(staged)))
    list(capture_frames(staged, tmp_path / "after"))
    captures = [read_capture(tmp_path / name) for name in ("before", "after")]
    assert captures[0].lights.keys() == captures[1].lights.keys() and captures[0].cameras.keys() == captures[1].cameras.keys()
    for frame in captures[0].frames:
        pictures = [read_picture(tmp_path / name / frame.image, "linear") for name in ("before", "after")]
        np.testing.assert_array_equal(pictures[0][0], pictures[1][0])
        np.testing.assert_array_equal(pictures[0][1], pictures[1][1])
    assert (tmp_path / "before" / "truth.ply").read_bytes() == (tmp_path / "after" / "truth.ply").read_bytes()


# --- the comparison ----------------------------------------------------------------------------------------------------------

def members(row):
    return [row.objects[f"Comparison {name}"] for name in ("Truth", "Result", "Error")]


def test_truth_result_and_error_stand_in_a_row_behind_the_stage(staged, found):
    row = compare(staged, found, TriangleMesh(*truth_mesh(staged)))
    bpy.context.view_layer.update()
    spans = [(placed(member)[:, 0].min(), placed(member)[:, 0].max()) for member in members(row)]
    assert spans[0][1] < spans[1][0] and spans[1][1] < spans[2][0]
    behind = truth_mesh(staged)[0][:, 1].max()
    assert all(placed(member)[:, 1].min() > behind for member in members(row))
    assert row.name in results_collection(staged).children and row.name not in staged.collection.children
    words = {member.data.body for member in row.objects if member.type == 'FONT'}
    assert any(word.startswith("visual-hull, ") for word in words)


def test_the_staged_object_is_shown_with_its_own_material_if_it_is_the_truth(staged, found):
    row = compare(staged, found, TriangleMesh(*truth_mesh(staged)))
    assert members(row)[0].data == bpy.data.objects["knot"].data


@pytest.mark.parametrize("change", ["another object", "hidden", "no stage"])
def test_otherwise_the_captures_truth_is_shown(staged, found, change):
    truth = TriangleMesh(*truth_mesh(staged))
    if change == "another object":
        staging.build(staged, "turntable", "pot", SMALL)
    elif change == "hidden":
        bpy.data.objects["knot"].hide_render = True
    else:
        staging.remove(staged)
    shown = members(compare(staged, found, truth))[0]
    local = np.array([vertex.co for vertex in shown.data.vertices])
    np.testing.assert_allclose(local, truth.vertices, atol=1e-6)  # single precision of 0.2 m
    assert not [name for name in bpy.data.objects.keys() if name.startswith("Compared")]


def test_errors_are_positive_where_there_is_too_much():
    ball = Ball((0.2, 0.1, -0.3), 0.5)
    truth = sphere_mesh(ball, 48)
    grown = result_of(sphere_mesh(replace(ball, radius=0.7), 48), None, 40)
    errors = face_errors(grown, truth)
    centres = grown.surface.vertices[grown.surface.quads].mean(axis=1)
    # The mesh lies inside the ball by up to 1 - cos(pi / 48) of its radius.
    np.testing.assert_allclose(errors, np.linalg.norm(centres - ball.centre, axis=1) - ball.radius, atol=0.5 * (1 - np.cos(np.pi / 48)) + 1e-6)
    shrunken = face_errors(result_of(sphere_mesh(replace(ball, radius=0.3), 48), None, 40), truth)
    assert errors.min() > 0 > shrunken.max()


def test_the_legend_reaches_as_far_as_nearly_all_errors_and_is_round(staged, found):
    row = show_comparison(staged, found, TriangleMesh(*truth_mesh(staged)), np.full(len(found.surface.quads), 0.0234))
    words = {member.data.body for member in row.objects if member.type == 'FONT'}
    assert {"30 mm", "0", "\u221230 mm"} <= words


def test_measured_points_stand_beside_their_voxels_and_go_with_them(staged, found):
    before = inventory()
    show_result(staged, replace(found, points=points_of(found)))
    home = results_collection(staged)
    voxels, points = (next(member for member in home.objects if member.name == name) for name in ("Result", "Result Points"))
    assert len(points.data.vertices) == len(found.surface.voxels)
    apart = placed(points).mean(axis=0) - placed(voxels).mean(axis=0)
    width = np.ptp(found.surface.vertices[:, 0])
    assert apart[0] > width and np.abs(apart[1:]).max() < 0.1 * width
    show_result(staged, found)
    assert [member.name for member in home.objects] == ["Result"]
    assert inventory()["node_groups"] == before["node_groups"]
