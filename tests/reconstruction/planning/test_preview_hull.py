# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes from contour edges, hulls made of them, and meshes in triangles of one size."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from addon.errors import ScanstageError
from addon.reconstruction.geometry import VoxelGrid, rotation_about
from addon.reconstruction.mesh import TriangleMesh
from addon.reconstruction.planning.outlines import Outliner
from addon.reconstruction.planning.preview_hull import growing_hulls, preview_grid, preview_hull
from addon.reconstruction.planning.tessellation import divided, simplified
from addon.reconstruction.scan import Scan
from addon.reconstruction.volumetric.visual_hull import visual_hull
from tests.rigs import Ball, Box, camera_at, ring, silhouette, sphere_mesh, views_of

BOXES = (Box((0.0, 0.2, 0.1), (0.9, 0.3, 0.2), rotation_about((1, 2, 3), 0.7)), Box((0.3, -0.5, -0.2), (0.2, 0.5, 0.6), rotation_about((0, 1, 1), 0.4)))


def box_mesh(box: Box) -> TriangleMesh:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return TriangleMesh.from_quads(np.array(box.centre) + (corners * box.half) @ box.rotation.T, np.array(quads))


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    start = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]),
                        np.concatenate([mesh.triangles + first for mesh, first in zip(meshes, start[:-1], strict=True)]))


def same_but_for_rounding(found, true):
    """A pixel's centre that lies on the outline to the last digit may fall to either side."""
    return np.count_nonzero(found ^ true) <= 2


@pytest.mark.parametrize("camera", ring(5, elevation=35) + [camera_at((0.1, 0.2, 5.0), (0.1, 0.3, 0.0))], ids=range(6))
def test_the_silhouette_of_boxes_that_cross_is_that_of_their_rays(camera):
    assert same_but_for_rounding(Outliner(joined(*map(box_mesh, BOXES))).silhouette(camera), silhouette(camera, BOXES))


def test_an_object_that_leaves_the_picture_is_cut_at_its_border():
    camera = camera_at((0.0, -2.0, 0.4), focal=900.0, size=(200, 120))
    seen = silhouette(camera, BOXES)
    assert seen[0].any() and seen[:, -1].any()
    assert same_but_for_rounding(Outliner(joined(*map(box_mesh, BOXES))).silhouette(camera), seen)


def test_an_open_mesh_and_one_inside_out_cover_what_their_triangles_cover():
    mesh = box_mesh(BOXES[0])
    camera = camera_at((3.0, -4.0, 1.0))
    whole = Outliner(mesh).silhouette(camera)
    assert same_but_for_rounding(Outliner(TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1])).silhouette(camera), whole)
    parts = [Outliner(TriangleMesh(mesh.vertices, mesh.triangles[k:k + 1])).silhouette(camera) for k in range(12)]
    assert same_but_for_rounding(np.logical_or.reduce(parts), whole)


def test_a_view_with_a_part_of_the_object_behind_it_has_no_silhouette():
    assert Outliner(box_mesh(BOXES[0])).silhouette(camera_at((0.0, 0.2, 0.1), (5.0, 0.0, 0.0))) is None


def test_the_preview_is_the_hull_of_the_true_silhouettes_within_a_voxel():
    ball, cameras = Ball((0.1, 0.0, 0.05), 0.8), ring(8, elevation=25, distance=5, focal=600)
    mesh = sphere_mesh(ball, 48)
    grid = preview_grid(mesh, 48)
    found = preview_hull(Outliner(mesh), cameras, grid).dense()
    true = visual_hull(Scan(views_of(cameras, [ball])), grid, rule="center").volume.dense()
    for less, more in ((found, true), (true, found)):
        padded = np.pad(more, 1)
        grown = sliding_window_view(padded, (3, 3, 3)).any(axis=(3, 4, 5))
        assert np.count_nonzero(less & ~grown) <= 1e-4 * np.count_nonzero(true)  # tips, where the cones meet at small angles
    assert np.count_nonzero(found ^ true) < 0.02 * np.count_nonzero(true)


def test_a_hull_of_more_views_is_within_that_of_fewer():
    mesh = box_mesh(BOXES[0])
    grid = preview_grid(mesh, 24)
    hulls = list(growing_hulls(Outliner(mesh), ring(6), grid))
    assert [count for count, _ in hulls] == [1, 2, 4, 6]
    for (_, more), (_, less) in pairwise(hulls):
        assert not (less.dense() & ~more.dense()).any() and less.count() < more.count()
    assert (hulls[-1][1].dense() == preview_hull(Outliner(mesh), ring(6), grid).dense()).all()
    assert [count for count, _ in growing_hulls(Outliner(mesh), ring(1), grid)] == [1]


def test_a_rig_without_views_or_amid_the_object_says_so():
    mesh = box_mesh(BOXES[0])
    grid = VoxelGrid.from_bounds(*mesh.bounds(), 16)
    with pytest.raises(ScanstageError, match="no views"):
        preview_hull(Outliner(mesh), [], grid)
    with pytest.raises(ScanstageError, match="move the cameras away"):
        preview_hull(Outliner(mesh), [camera_at((0.0, 0.2, 0.1), (1.0, 0.3, 0.0))], grid)


def test_cut_triangles_are_small_enough_and_the_same_surface():
    mesh = box_mesh(BOXES[0])
    pieces = divided(mesh.corners(), 0.2, 100_000)
    across = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])
    assert np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2).max() <= 0.2
    assert np.isclose(np.linalg.norm(across, axis=1).sum() / 2, mesh.area())
    assert np.isclose(np.einsum("ij,ij->", across, pieces[:, 0]) / 6, mesh.volume())  # divergence theorem: none was turned over
    assert len(divided(mesh.corners(), 0.001, 100)) <= 100


def test_a_simplified_mesh_has_fewer_triangles_and_is_off_by_no_more_than_a_cell():
    ball = Ball((1.0, 2.0, 3.0), 0.5)
    mesh = sphere_mesh(ball, 200)
    few = simplified(mesh, 20)
    assert len(few.triangles) < 0.1 * len(mesh.triangles)
    assert few.is_watertight()
    assert np.abs(np.linalg.norm(few.vertices - ball.centre, axis=1) - ball.radius).max() <= np.sqrt(3) / 20
    assert np.isclose(few.volume(), mesh.volume(), rtol=0.05)
