# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on disk and in Blender: they come back, a viewer reads them, and files that lie are refused."""

import re

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.points import PointCloud
from addon.results.ply import read_ply
from addon.results.point_file import read_points, write_points
from addon.results.point_objects import POINTS_GROUP, add_points

RANDOM = np.random.default_rng(4)


@pytest.fixture
def cloud():
    normals = RANDOM.normal(size=(50, 3))
    return PointCloud(RANDOM.normal(size=(50, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True), RANDOM.random((50, 3)),
                      RANDOM.random(50) * 1e-3, RANDOM.integers(0, 36, 50))


def test_points_come_back_as_they_went(tmp_path, cloud):
    write_points(tmp_path / "points.ply", cloud)
    read = read_points(tmp_path / "points.ply")
    np.testing.assert_allclose(read.positions, cloud.positions, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(read.normals, cloud.normals)
    np.testing.assert_array_equal(read.sigma, cloud.sigma)
    np.testing.assert_array_equal(read.view, cloud.view)
    np.testing.assert_allclose(read.colors, cloud.colors, atol=0.005)  # half a step of 8-bit sRGB up there


def test_any_ply_reader_finds_the_points(tmp_path, cloud):
    write_points(tmp_path / "points.ply", cloud)
    np.testing.assert_allclose(read_ply(tmp_path / "points.ply").vertices, cloud.positions, rtol=1e-6, atol=1e-6)


def test_no_points_are_points_too(tmp_path):
    write_points(tmp_path / "points.ply", PointCloud.joined([]))
    assert len(read_points(tmp_path / "points.ply")) == 0


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda data: data[:-1], "is not as long as its 50 points"),
    (lambda data: data + b"x", "is not as long as its 50 points"),
    (lambda data: data.replace(b"vertex 50", b"vertex 999999999"), "is not a"),
    (lambda data: data.replace(b"float sigma", b"double sigma"), "is not a point cloud of Scanstage's"),
    (lambda data: b"", "is not a point cloud of Scanstage's"),
    (lambda data: data[:data.index(b"end_header\n") + 11] + np.float32(np.nan).tobytes() + data[data.index(b"end_header\n") + 15:],
     "holds a number that is not finite"),
])
def test_files_that_lie_are_refused(tmp_path, cloud, spoil, words):
    path = tmp_path / "points.ply"
    write_points(path, cloud)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(ScanstageError, match=re.escape(f"{path}: {words}")):
        read_points(path)


def test_points_stand_in_the_scene_with_their_colours(empty_scene, cloud):
    frame = np.eye(4)
    frame[:3, 3] = (1.0, 2.0, 3.0)
    first = add_points("Points", cloud, collection=empty_scene.collection, frame=frame, method="gray-code")
    assert len(first.data.vertices) == 50 and first["method"] == "gray-code"
    colors = np.zeros((50, 4), np.float32)
    first.data.attributes["Color"].data.foreach_get("color", colors.ravel())
    np.testing.assert_array_equal(colors[:, :3], cloud.colors)
    evaluated = first.evaluated_get(bpy.context.evaluated_depsgraph_get())
    drawn = evaluated.evaluated_geometry()
    radii = np.zeros(50, np.float32)
    drawn.pointcloud.attributes["radius"].data.foreach_get("value", radii)
    assert len(drawn.pointcloud.points) == 50 and (radii > 0).all()
    assert [material.name for material in drawn.pointcloud.materials] == ["Scanstage Voxels"]
    np.testing.assert_allclose(np.array(first.matrix_world), frame)
    add_points("Points", cloud.chosen(slice(0, 7)), collection=empty_scene.collection)
    assert [len(found.data.vertices) for found in empty_scene.collection.objects] == [7]
    assert [group.name for group in bpy.data.node_groups] == [POINTS_GROUP]
