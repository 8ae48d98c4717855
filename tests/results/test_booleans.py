# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Solids cut by Blender, and the polyhedral hull that is made of them: watertight, and as large as geometry says."""

from dataclasses import replace

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.contours import fill, trace_outlines
from addon.reconstruction.evaluation.voxelization import inside
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.mesh import PolygonMesh, TriangleMesh
from addon.reconstruction.methods import reconstruct
from addon.reconstruction.scan import Scan, View
from addon.reconstruction.volumetric.polyhedral_hull import polyhedral_hull
from addon.reconstruction.volumetric.visual_hull import visual_hull
from addon.results.booleans import difference, solver, triangle_mesh, triangulate
from tests.rigs import Ball, Box, black_picture, camera_at, ring, silhouette, views_of

pytestmark = pytest.mark.usefixtures("empty_scene")

BALL = Ball((0.1, -0.05, 0.2), 0.6)
GRID = VoxelGrid.from_bounds((-0.9, -1, -0.8), (1.1, 1, 1.2), 64)
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
QUADS = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def box(lower, upper) -> PolygonMesh:
    lower, upper = np.array(lower, float), np.array(upper, float)
    return PolygonMesh.joined(lower + CORNERS * (upper - lower), QUADS)


def hull(views, grid=GRID, **options):
    return polyhedral_hull(Scan(tuple(views)), grid, solids=solver(), **options)


def outline(camera, ball, count=240):
    """Return the exact outline (count, 2) of a ball in a picture: the circle in which the tangent cone touches it."""
    axis = np.array(ball.centre) - camera.centre
    distance = np.linalg.norm(axis)
    across = np.linalg.svd(axis[None])[2][1:]
    angle = 2 * np.pi * np.arange(count)[:, None] / count
    radius = ball.radius * np.sqrt(1 - (ball.radius / distance) ** 2)
    circle = radius * (np.cos(angle) * across[0] + np.sin(angle) * across[1])
    return camera.project(np.array(ball.centre) - axis * (ball.radius / distance) ** 2 + circle)[0]


def outlined(cameras, *balls):
    return [View(f"{i:04d}", camera, None, black_picture, contours=tuple(outline(camera, ball) for ball in balls))
            for i, camera in enumerate(cameras)]


def points_on(ball, count=200):
    points = np.random.default_rng(1).normal(size=(count, 3))
    return np.array(ball.centre) + ball.radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def contains(mesh: TriangleMesh, points) -> np.ndarray:
    """Return whether points lie inside, by the solid angle that the mesh fills (van Oosterom & Strackee, 1983)."""
    found = []
    for point in points:
        a, b, c = np.moveaxis(mesh.corners() - point, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        found.append(np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), below).sum() / (2 * np.pi) > 0.5)
    return np.array(found)


def euler(mesh: TriangleMesh) -> int:
    """Return vertices - edges + faces: 2 for each closed part, 2 less for each hole through it."""
    edges = np.sort(np.stack((mesh.triangles, np.roll(mesh.triangles, -1, axis=1)), axis=-1).reshape(-1, 2), axis=1)
    return len(np.unique(mesh.triangles)) - len(np.unique(edges, axis=0)) + len(mesh.triangles)


# --- solids ------------------------------------------------------------------------------------------------------------------

def test_a_box_less_a_box_has_the_difference_of_their_volumes_and_leaves_nothing_in_the_file():
    before = {block.session_uid for block in bpy.data.user_map()}
    left = triangle_mesh(difference(box((0, 0, 0), (2, 1, 1)), box((0.5, 0.25, -1), (1, 0.75, 3))))
    assert left.is_watertight() and euler(left) == 0  # a hole goes through it
    assert left.volume() == pytest.approx(2 - 0.5 * 0.5, rel=1e-6)
    assert {block.session_uid for block in bpy.data.user_map()} == before


def test_solids_that_meet_in_an_edge_can_be_cut():
    first, second = box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))
    vertices, rows = np.unique(np.concatenate((first.vertices, second.vertices)), axis=0, return_inverse=True)
    both = PolygonMesh.joined(vertices, rows.reshape(-1)[np.concatenate((QUADS, QUADS + 8))])
    left = triangle_mesh(difference(both, box((-1, -1, 0.5), (3, 3, 2))))
    assert left.is_watertight() and left.volume() == pytest.approx(1, rel=1e-6)


def test_a_window_with_contours_is_triangulated_by_counting_loops():
    def square(low, high):
        return np.array([(low, low), (high, low), (high, high), (low, high)], float)

    points, triangles = triangulate((square(0, 10),), (square(2, 8)[::-1], square(4, 6), square(9, 12)))
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    areas = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    assert (areas > 0).all() and areas.sum() == pytest.approx(100 - 36 + 4 - 1)


# --- the hull ----------------------------------------------------------------------------------------------------------------

def test_the_hull_of_a_ball_from_a_far_ring_is_the_circumscribed_polygon():
    """methods.md T7a: of 7 views from all but infinity the slice through the middle is a regular 14-gon round the circle."""
    cameras = ring(7, elevation=0, distance=400, focal=40_000, size=(320, 240))
    ball = Ball((0, 0, 0), 0.7)
    found = hull(outlined(cameras, ball), VoxelGrid((-1, -1, -1), 2 / 101, (101, 101, 101)))
    assert found.mesh.is_watertight()
    low, high = found.mesh.bounds()
    np.testing.assert_allclose((low[2], high[2]), (-0.7, 0.7), atol=0.01)  # every view bounds it above and below
    layer, size = found.volume.dense()[:, :, 50], found.volume.grid.voxel_size
    assert layer.sum() * size ** 2 == pytest.approx(14 * np.tan(np.pi / 14) * 0.7 ** 2, rel=0.004)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_hull_holds_the_ball_and_ends_where_lines_of_sight_miss_it(mirrored):
    flip = np.diag((1, 1, -1 if mirrored else 1))
    cameras = [replace(camera, R=camera.R @ flip) for camera in ring(6, size=(160, 120), focal=200)]
    ball = Ball(tuple(flip @ BALL.centre), BALL.radius)
    grid = VoxelGrid.from_bounds((-0.9, -1, -1), (1.1, 1, 1), 48)
    views = [View(f"{i}", camera, None, black_picture, contours=(outline(camera, ball),)) for i, camera in enumerate(cameras)]
    found = hull(views, grid)
    assert found.mesh.is_watertight() and euler(found.mesh) == 2
    # The outline is a polygon of 240 corners: its sides are inside the circle by 1 - cos(pi / 240) = 1e-4 of the radius.
    assert contains(found.mesh, points_on(replace(ball, radius=0.9995 * ball.radius))).all()
    beyond = points_on(replace(ball, radius=1.3 * ball.radius))
    seen = np.all([ball.hit_by(camera.centre, beyond - camera.centre) for camera in cameras], axis=0)
    np.testing.assert_array_equal(contains(found.mesh, beyond), seen)
    assert found.report["polyhedron"]["volume"] == pytest.approx(found.volume.volume(), rel=0.01)


def test_a_lens_changes_nothing_where_its_distortion_is_known():
    cameras = ring(5, size=(160, 120), focal=200)
    grid = VoxelGrid.from_bounds((-0.55, -0.7, -0.45), (0.75, 0.6, 0.85), 32)  # all of it in all pictures
    straight = hull(outlined(cameras, BALL), grid).mesh
    bent = hull(outlined([replace(camera, distortion=(-0.2, 0.05, 0.001, -0.002, 0.0)) for camera in cameras], BALL), grid).mesh
    assert bent.is_watertight() and bent.volume() == pytest.approx(straight.volume(), rel=1e-4)


def test_where_a_lens_cannot_be_inverted_nothing_is_known():
    """At k1 = -0.9 pixels beyond 0.41 focal lengths, 81 pixels, have no line of sight: the corners of these pictures."""
    cameras = [replace(camera, distortion=(-0.9, 0, 0, 0, 0)) for camera in ring(5, size=(160, 120), focal=200)]
    contours = [outline(camera, BALL) for camera in cameras]
    views = [View(str(i), camera, fill([loop], camera.size), black_picture)
             for i, (camera, loop) in enumerate(zip(cameras, contours, strict=True))]
    found = hull(views).mesh
    assert found.is_watertight() and contains(found, points_on(replace(BALL, radius=0.98 * BALL.radius))).all()


def test_holes_and_parts_are_kept():
    bars = [Box(centre, half, np.eye(3)) for centre, half in (
        ((0, 0, 0.5), (0.6, 0.15, 0.1)), ((0, 0, -0.5), (0.6, 0.15, 0.1)), ((0.5, 0, 0), (0.1, 0.15, 0.6)), ((-0.5, 0, 0), (0.1, 0.15, 0.6)))]
    cameras = [camera_at(centre, focal=200, size=(160, 120)) for centre in ((0.5, -4, 0.3), (4, 0.2, 0.1), (-0.4, 4, 0.6), (0.3, 0.2, 4))]
    grid = VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), 48)
    frame = hull(views_of(cameras, bars), grid)
    assert frame.mesh.is_watertight() and euler(frame.mesh) == 0
    two = hull(outlined(ring(5, size=(160, 120), focal=200), Ball((0, 0, 0.5), 0.3), Ball((0, 0, -0.5), 0.2)), grid)
    assert two.mesh.is_watertight() and euler(two.mesh) == 4


def test_against_the_voxel_hull_at_128_no_voxel_differs_but_in_one_layer():
    views = views_of(ring(8, focal=300, size=(240, 180)), [BALL, Ball((-0.3, 0.2, -0.2), 0.35), Box((0.3, 0, -0.3), (0.3, 0.2, 0.4), np.eye(3))])
    grid = VoxelGrid.from_bounds((-0.9, -1, -0.9), (1.1, 1, 1.1), 128)
    found = hull(views, grid)
    ours, theirs = found.volume.dense(), visual_hull(Scan(tuple(views)), grid, rule="center").volume.dense()
    assert found.mesh.is_watertight() and (ours != theirs).any()
    for one, other in ((ours, theirs), (theirs, ours)):
        grown = np.pad(other, 1)
        for axis in range(3):
            grown = grown | np.roll(grown, 1, axis) | np.roll(grown, -1, axis)
        assert not (one & ~grown[1:-1, 1:-1, 1:-1]).any()


def test_conservatively_no_point_of_the_object_is_cut_away():
    cameras = ring(8, size=(120, 90), focal=150)
    dilated = [replace(view, mask=np.pad(view.mask, 1)) for view in views_of(cameras, [BALL])]
    views = [replace(view, mask=np.max([np.roll(view.mask, (y, x), (0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1)], axis=0)[1:-1, 1:-1])
             for view in dilated]
    assert contains(hull(views, rule="conservative", simplify=5.0).mesh, points_on(BALL)).all()


@pytest.mark.parametrize("kind", ["masks", "contours"])
def test_beyond_the_picture_nothing_is_known_unless_it_is_empty(kind):
    cameras = [*ring(5, size=(160, 120), focal=200), camera_at((0, -4, 0.2), (0.1, 0, 0.2), focal=700, size=(160, 120))]
    views = outlined(cameras, BALL) if kind == "contours" else views_of(cameras, [BALL])
    whole = hull(views).mesh
    assert whole.is_watertight()
    assert contains(whole, points_on(replace(BALL, radius=0.95 * BALL.radius))).all()
    points = points_on(replace(BALL, radius=0.95 * BALL.radius))
    pixels = cameras[-1].project(points)[0]
    outside = ((pixels < -1) | (pixels > cameras[-1].size)).any(axis=1)
    if kind == "masks":
        assert 20 < outside.sum() < 180
        np.testing.assert_array_equal(contains(hull(views, outside="empty").mesh, points[outside]), False)


def test_a_camera_inside_the_volume_cuts_what_it_sees():
    near = camera_at((0.1, -0.95, 0.2), (0.1, 0, 0.2), focal=60, size=(160, 120))
    views = outlined(ring(5, size=(160, 120), focal=200), BALL)
    without, found = hull(views).mesh, hull([*views, *outlined([near], BALL)]).mesh
    assert found.is_watertight() and found.volume() < without.volume()
    assert contains(found, points_on(replace(BALL, radius=0.9995 * BALL.radius))).all()
    with pytest.raises(ScanstageError, match="^frame 0000: the camera is inside the working volume"):
        hull(outlined([near], BALL), outside="empty")


def test_the_method_finds_its_bounds_from_contours_and_brings_the_mesh():
    views = [replace(view, read_image=lambda: np.full((120, 160, 3), 0.4, np.float32))
             for view in outlined(ring(6, size=(160, 120), focal=200), BALL)]
    found = reconstruct(Scan(tuple(views)), "polyhedral-hull", voxels=40, solids=solver())
    assert found.mesh.is_watertight() and np.count_nonzero(inside(found.mesh, found.volume.grid).dense() ^ found.volume.dense()) == 0
    assert found.report["counts"]["triangles"] == len(found.mesh.triangles) and found.report["polyhedron"]["watertight"] is True


def test_what_cannot_be_used_is_refused_in_a_sentence():
    camera = ring(1, size=(160, 120), focal=200)[0]
    view = outlined([camera], BALL)[0]
    bow = np.array([(10, 10), (90, 90), (90, 10), (10, 90.0)])
    cases = [([], "has no views"), ([replace(view, contours=None)], "frame 0000 has no silhouette"),
             ([replace(view, contours=(bow,))], r"frame 0000: contours\[0\] crosses"),
             ([replace(view, contours=(bow[:2],))], r"frame 0000: contours\[0\] must be three or more"),
             ([replace(view, contours=(bow * np.nan,))], r"frame 0000: contours\[0\] must be three or more"),
             ([replace(view, contours=(np.array([(1, 1), (158, 1), (158, 118.0)]),),
                       camera=replace(camera, distortion=(-9, 0, 0, 0, 0)))], "lens distortion cannot be inverted")]
    for views, message in cases:
        with pytest.raises(ScanstageError, match=message):
            hull(views)
    with pytest.raises(ScanstageError, match="^the polyhedral hull is empty from frame elsewhere on: that view contradicts the 1 before"):
        hull([view, replace(outlined([camera], Ball((0.1, 0.9, 0.2), 0.1))[0], name="elsewhere")], outside="empty")
    with pytest.raises(ScanstageError, match="^method polyhedral-hull cuts solids with Blender's solver"):
        reconstruct(Scan((view,)), "polyhedral-hull")


def test_a_noisy_silhouette_is_refused_with_what_mends_it():
    views = views_of(ring(3), [Ball((0, 0, 0), 0.5)])
    noise = np.random.default_rng(0).random(views[0].mask.shape) < 0.01
    with pytest.raises(ScanstageError, match=r"^frame 0000: its silhouette has \d+ outlines, .* --set remove_specks=20 --set fill_holes=20$"):
        hull([replace(views[0], mask=views[0].mask ^ noise), *views[1:]])


def test_masks_and_their_own_outlines_give_the_same():
    views = views_of(ring(4, size=(120, 90), focal=150), [BALL])
    traced = [replace(view, mask=None, contours=tuple(trace_outlines(silhouette(view.camera, [BALL])))) for view in views]
    assert hull(views, simplify=0.0).mesh.volume() == pytest.approx(hull(traced).mesh.volume(), rel=1e-5)
