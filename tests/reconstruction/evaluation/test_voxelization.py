# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxels inside a mesh, touched by it, and wholly inside it, against shapes whose inside is a formula."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.reconstruction.arrays import expand
from addon.reconstruction.evaluation import inside, touched, wholly_inside
from addon.reconstruction.evaluation.pieces import bisect
from addon.reconstruction.geometry import VoxelGrid, rotation_about
from addon.reconstruction.mesh import TriangleMesh

GRID = VoxelGrid((-1.3, -1.2, -1.1), 0.057, (45, 43, 39))


def centres(grid: VoxelGrid) -> np.ndarray:
    return grid.centres(np.moveaxis(np.indices(grid.shape), 0, -1))


def in_convex(mesh: TriangleMesh, points: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Return whether points (..., 3) are behind all face planes of a convex mesh: an oracle of its own."""
    out = np.ones(points.shape[:-1], bool)
    for a, b, c in mesh.corners():
        normal = np.cross(b - a, c - a)
        if normal.any():
            out &= (points - a) @ (normal / np.linalg.norm(normal)) <= margin
    return out


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
def test_inside_a_sphere_and_a_tilted_box(shapes, angle):
    for mesh in (shapes.moved(shapes.sphere(rings=16), (0.05, 0, 0.02), (1, 2, 3), angle),
                 shapes.moved(shapes.box((-0.8, -0.6, -0.5), (0.7, 0.9, 0.4)), (0, 0, 0), (3, -1, 2), angle)):
        np.testing.assert_array_equal(inside(mesh, GRID).dense(), in_convex(mesh, centres(GRID)))


def test_inside_a_torus(shapes):
    mesh = shapes.torus(0.8, 0.3)
    x, y, z = np.moveaxis(centres(GRID), -1, 0)
    off = np.hypot(np.hypot(x, y) - 0.8, z)
    filled = inside(mesh, GRID).dense()
    # 96 segments: the mesh keeps within 1.1 (1 - cos(pi / 96)) = 6e-4 of the torus
    assert filled[off < 0.3 - 6e-4].all() and not filled[off > 0.3].any()


@pytest.mark.parametrize("rings", [8, 31])
def test_voxel_volume_tends_to_the_volume(shapes, rings):
    mesh = shapes.moved(shapes.sphere(rings=rings), (0, 0, 0), (1, 1, 0), 0.7)
    # The error of counting lattice points in a ball of radius r / h = 33 voxels is far below one per cent.
    assert inside(mesh, VoxelGrid((-1.1,) * 3, 0.03, (74,) * 3)).volume() == pytest.approx(mesh.volume(), rel=0.003)


@pytest.mark.parametrize("axis", range(3))
def test_surfaces_through_the_centres_are_counted_once(shapes, axis):
    """Faces, edges and diagonals that run exactly through voxel centres: never counted twice, never lost."""
    grid = VoxelGrid((0, 0, 0), 1.0, (8, 8, 8))
    middle, end = np.full(3, 6.5), np.full(3, 0.5)
    middle[axis] = end[axis] = 3.5
    halves = shapes.box((0.5, 0.5, 0.5), middle), shapes.box(end, (6.5, 6.5, 6.5))
    first, second = (inside(half, grid).dense() for half in halves)
    assert not (first & second).any()
    assert first.sum() == second.sum() == 3 * 6 * 6


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10 ** 6))
def test_lattice_tetrahedra_fill_space_without_overlap(seed):
    """Six tetrahedra round a random lattice point's diagonal make a cube, whatever vertex meets whatever centre."""
    rng = np.random.default_rng(seed)
    lower, size = rng.integers(0, 4, 3) + 0.5, rng.integers(1, 5)
    corners = lower + size * np.array([(i >> 2 & 1, i >> 1 & 1, i & 1) for i in range(8)])
    grid, total = VoxelGrid((0, 0, 0), 1.0, (9, 9, 9)), np.zeros((9, 9, 9), int)
    for a, b in ((1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1)):
        tetrahedron = TriangleMesh(corners[[0, a, b, 7]], [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
        total += inside(tetrahedron, grid).dense()
    assert total.max() == 1 and total.sum() == size ** 3


def test_overlapping_shells_are_a_union_and_inverted_ones_a_cavity(shapes):
    big, small, other = shapes.sphere(0.9), shapes.sphere(0.4), shapes.sphere(0.5, (0.8, 0, 0))
    a, b, c = (inside(mesh, GRID).dense() for mesh in (big, small, other))
    np.testing.assert_array_equal(inside(shapes.joined(big, other), GRID).dense(), a | c)
    np.testing.assert_array_equal(inside(shapes.joined(big, shapes.inside_out(small)), GRID).dense(), a & ~b)
    np.testing.assert_array_equal(inside(shapes.inside_out(big), GRID).dense(), a)


@pytest.mark.parametrize("seed", range(3))
def test_holes_and_flipped_triangles_are_outvoted(shapes, seed):
    sphere = shapes.moved(shapes.sphere(0.9, rings=24), (0, 0, 0), (1, 2, 0), 0.4)
    whole = inside(sphere, GRID).dense()
    rng = np.random.default_rng(seed)
    solid = np.flatnonzero(sphere.areas() > 0)
    flipped = sphere.triangles.copy()
    some = rng.choice(solid, len(solid) // 3, replace=False)
    flipped[some] = flipped[some, ::-1]
    np.testing.assert_array_equal(inside(TriangleMesh(sphere.vertices, flipped), GRID).dense(), whole)
    direction = rng.normal(size=3)
    cap = sphere.corners().mean(axis=1) @ (direction / np.linalg.norm(direction)) > 0.85
    opened = inside(TriangleMesh(sphere.vertices, sphere.triangles[~cap]), GRID).dense()
    # A hole of 2 % of the surface is seen along one axis: the other two restore the ball but for its lid, the cap
    # between the hole and the sphere, less than 1 % of the ball.
    assert (opened != whole).sum() < 0.01 * whole.sum()


def test_only_the_grid_is_filled(shapes):
    mesh = shapes.sphere(1.0)
    small = VoxelGrid((0.2, -3, 0.1), 0.1, (4, 60, 5))
    np.testing.assert_array_equal(inside(mesh, small).dense(), in_convex(mesh, centres(small)))
    beyond = VoxelGrid((5, 5, 5), 0.1, (9, 9, 9))
    assert inside(mesh, beyond).count() == touched(mesh, beyond).count() == 0


def sampled(mesh: TriangleMesh, grid: VoxelGrid, per_triangle: int) -> np.ndarray:
    """Return the voxels in which points spread over the triangles lie, those near a voxel's side left out."""
    rng = np.random.default_rng(1)
    weights = rng.dirichlet((0.7, 0.7, 0.7), per_triangle)
    points = (np.einsum("pc,tcx->tpx", weights, mesh.corners()).reshape(-1, 3) - grid.origin) / grid.voxel_size
    index = np.floor(points).astype(int)
    clear = (np.abs(points - np.rint(points)) > 1e-5).all(axis=1) & ((index >= 0) & (index < grid.shape)).all(axis=1)
    out = np.zeros(grid.shape, bool)
    out[tuple(index[clear].T)] = True
    return out


def clip_overlaps(triangle: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> bool:
    """Return whether clipping the triangle by the six sides of a box leaves anything (Sutherland & Hodgman, 1974)."""
    polygon = list(triangle)
    for axis in range(3):
        for sign, limit in ((1, upper[axis]), (-1, -lower[axis])):
            clipped = []
            for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                dp, dq = sign * p[axis] - limit, sign * q[axis] - limit
                if dp <= 0:
                    clipped.append(p)
                if dp * dq < 0:
                    clipped.append(p + dp / (dp - dq) * (q - p))
            polygon = clipped
    return bool(polygon)


@pytest.mark.parametrize("seed", range(4))
def test_touched_is_what_clipping_leaves(shapes, seed):
    mesh = shapes.soup(24, seed, extent=1.4)
    grid = VoxelGrid((0.2, 0.1, 0.15), 0.17, (6, 5, 7))
    found = touched(mesh, grid).dense()
    expected = np.zeros(grid.shape, bool)
    for index in np.ndindex(*grid.shape):
        lower = grid.origin + grid.voxel_size * np.array(index)
        expected[index] = any(clip_overlaps(triangle, lower, lower + grid.voxel_size) for triangle in mesh.corners())
    np.testing.assert_array_equal(found, expected)


def test_large_triangles_and_slivers_touch_every_voxel_they_pass(shapes):
    grid = VoxelGrid((-1, -1, -1), 0.02, (100, 100, 100))
    corners = np.array([[(-9, -8, -7), (8, 9, 7), (7.9, -8, 8)], [(-1, -1, -1), (1, 1, 1), (0.9, 1, 1)],
                        [(-1, 0.3, -1), (1, -0.3, 1), (1, -0.3, 1)], [(-0.9, 0, 0.2), (-0.9, 0, 0.2), (-0.9, 0, 0.2)]])
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(12).reshape(4, 3))
    found = touched(mesh, grid).dense()
    hit = sampled(mesh, grid, 100_000)
    assert not (hit & ~found).any()
    # A plane touches few voxels: those whose centre is within half a voxel's diagonal of it.
    near = np.zeros(grid.shape, bool)
    for a, b, c in corners[:2]:
        normal = np.cross(b - a, c - a)
        near |= np.abs((centres(grid) - a) @ (normal / np.linalg.norm(normal))) <= 0.02 * np.sqrt(3) / 2
    assert found[~near].sum() < 200 * 4  # the rest is the segment and the point, at most 4 voxels a layer


def test_a_surface_in_the_voxels_sides_touches_none(shapes):
    grid = VoxelGrid((0, 0, 0), 0.25, (8, 8, 8))
    box = shapes.box((0.5, 0.25, 0.75), (1.5, 1.75, 1.25))
    assert touched(box, grid).count() == 0
    assert wholly_inside(box, grid).count() == inside(box, grid).count() == 4 * 6 * 2
    assert touched(shapes.moved(box, (1e-4, 0, 0)), grid).count() == 2 * 6 * 2


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10 ** 6))
def test_no_point_of_a_voxel_wholly_inside_is_outside(shapes, seed):
    rng = np.random.default_rng(seed)
    box = shapes.moved(shapes.box(-rng.uniform(0.3, 1, 3), rng.uniform(0.3, 1, 3)), rng.normal(0, 0.1, 3),
                       rng.normal(size=3), rng.uniform(0, 7))
    grid = VoxelGrid(rng.uniform(-1.3, -1, 3), rng.uniform(0.08, 0.2), (14, 13, 12))
    found = wholly_inside(box, grid).dense()
    lower = grid.origin + grid.voxel_size * np.moveaxis(np.indices(grid.shape), 0, -1)
    corners = lower[..., None, :] + grid.voxel_size * np.array([(i >> 2 & 1, i >> 1 & 1, i & 1) for i in range(8)])
    # A box is convex: a voxel is wholly inside exactly if its corners are, but for the stated 1e-6 of a voxel.
    margin = 4e-6 * grid.voxel_size
    assert (in_convex(box, corners[found], margin)).all()
    assert not (in_convex(box, corners[~found], -margin).all(axis=-1)).any()


def test_wholly_inside_a_torus_is_inside_by_formula(shapes):
    mesh = shapes.moved(shapes.torus(0.8, 0.35), (0, 0, 0), (1, 0, 0), 0.5)
    chosen = np.argwhere(wholly_inside(mesh, GRID).dense())
    points = GRID.origin + GRID.voxel_size * (chosen[:, None] + np.random.default_rng(0).random((len(chosen), 40, 3)))
    x, y, z = np.moveaxis(points @ rotation_about((1, 0, 0), 0.5), -1, 0)
    assert len(chosen) > 100 and (np.hypot(np.hypot(x, y) - 0.8, z) <= 0.35).all()


def test_expand_enumerates_lists_whatever_the_chunk():
    counts = np.array([0, 3, 0, 0, 7, 1, 0])
    expected = [(i, j) for i, n in enumerate(counts) for j in range(n)]
    for chunk in (1, 2, 5, 100):
        pieces = list(expand(counts, chunk))
        assert max(len(owner) for owner, _ in pieces) <= chunk
        assert [pair for owner, position in pieces for pair in zip(owner, position, strict=True)] == expected
    assert not list(expand(np.zeros(4, int), 5)) and not list(expand(np.zeros(0, int), 5))


def test_bisection_keeps_area_and_parents(shapes):
    mesh = shapes.soup(20, 3)
    vertices, pieces, parent = bisect(mesh.vertices, mesh.triangles, 0.11)
    corners = vertices[pieces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.11
    areas = TriangleMesh(vertices, pieces).areas()
    np.testing.assert_allclose(np.bincount(parent, areas, minlength=20), mesh.areas(), rtol=1e-9, atol=1e-15)
