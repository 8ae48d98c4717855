# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Distances from points to meshes, against all triangles and against formulas."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.reconstruction.evaluation import SurfaceIndex, sample_surface, vertex_distances
from addon.reconstruction.evaluation.distances import squared_distances
from addon.reconstruction.mesh import TriangleMesh


def brute_force(points: np.ndarray, mesh: TriangleMesh) -> np.ndarray:
    """Return the distance to the nearest of all triangles, each by region (Ericson, 2004, section 5.1.5)."""
    return np.array([min(np.linalg.norm(p - nearest_on_triangle(p, *corners)) for corners in mesh.corners())
                     for p in points])


def nearest_on_triangle(p, a, b, c):
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab @ ap, ac @ ap
    if d1 <= 0 and d2 <= 0:
        return a
    d3, d4 = ab @ (p - b), ac @ (p - b)
    if d3 >= 0 and d4 <= d3:
        return b
    if d1 * d4 - d3 * d2 <= 0 <= d1 and d3 <= 0:
        return a + d1 / (d1 - d3) * ab
    d5, d6 = ab @ (p - c), ac @ (p - c)
    if d6 >= 0 and d5 <= d6:
        return c
    if d5 * d2 - d1 * d6 <= 0 <= d2 and d6 <= 0:
        return a + d2 / (d2 - d6) * ac
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 >= d3 and d5 >= d6:
        return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
    vb, vc = d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    return a + (vb * ab + vc * ac) / (va + vb + vc)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10 ** 6))
def test_one_triangle_agrees_with_the_regions(seed):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(3, 3)) * rng.choice([0.01, 1, 100])
    points = np.concatenate((rng.normal(size=(20, 3)), corners, corners.mean(axis=0, keepdims=True)))
    found = np.sqrt(squared_distances(points, np.repeat(corners[None], len(points), axis=0)))
    expected = [np.linalg.norm(p - nearest_on_triangle(p, *corners)) for p in points]
    # Squared: what cancels is 1e-16 of the squared size, so 1e-7 of the size near the triangle.
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7 * np.abs(corners).max())


def test_triangles_without_area_are_segments_and_points():
    corners = np.array([[(0, 0, 0), (2, 0, 0), (1, 0, 0)], [(1, 1, 1)] * 3], float)
    points = np.array([(1.5, 3, 4), (1, 1, 3)], float)
    np.testing.assert_array_equal(np.sqrt(squared_distances(points, corners)), (5, 2))


@pytest.mark.parametrize("nodes", [1, 300, 20_000])
@pytest.mark.parametrize("name", ["soup", "box", "torus"])
def test_distances_are_those_to_the_nearest_of_all_triangles(shapes, name, nodes):
    mesh = {"soup": shapes.soup, "box": shapes.box, "torus": lambda: shapes.torus(around=12)}[name]()
    rng = np.random.default_rng(2)
    points = np.concatenate((rng.normal(size=(60, 3)), rng.normal(size=(20, 3)) * 50, mesh.vertices[:20],
                             sample_surface(mesh, 20) + rng.normal(size=(20, 3)) * 1e-3))
    found = SurfaceIndex(mesh, nodes=nodes).distances(points)
    expected = brute_force(points, mesh)
    # Rounding: at the mesh's own points 1e-8 of its size; far away single precision chooses among near equals.
    slack = 1e-7 * (1 + np.abs(points).max(axis=1))
    assert (found.distance >= expected - slack).all()
    assert (found.distance <= expected + found.bound + slack).all()
    assert nodes == 1 or (found.bound[80:] == 0).all()  # on and near the surface there is no doubt


def test_the_worst_case_keeps_its_bound(shapes):
    """From the centre of a sphere all nodes are equally near: nothing is certain, and the bound says how much."""
    mesh = shapes.sphere(rings=20)
    index = SurfaceIndex(mesh, nodes=5000)
    points = np.random.default_rng(0).normal(size=(12, 3)) * 1e-3
    found, expected = index.distances(points), brute_force(points, mesh)
    error = found.distance - expected
    assert (error <= found.bound + 1e-9).all() and (error >= -1e-9).all()
    # About radius^2 / (2 distance), with the rounding of single precision
    assert found.bound.max() <= 1.1 * index.radius ** 2 / 2 + 1e-5


@pytest.mark.parametrize("offset", [(0, 0, 0), (1000, -2000, 500)])
def test_signed_distances_from_a_box_are_its_formula(shapes, offset):
    box = shapes.moved(shapes.box((-1, -2, -3), (1, 2, 3)), offset)
    rng = np.random.default_rng(4)
    points = rng.uniform(-5, 5, (3000, 3))
    points[:200] = np.rint(points[:200])  # on corners, edges, diagonals
    q = np.abs(points) - (1, 2, 3)
    expected = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    found = vertex_distances(points + offset, box)
    np.testing.assert_allclose(found, expected, atol=1e-9 * (1 + np.abs(offset).max()))


def test_signs_hold_at_sharp_edges(shapes):
    """In the wedge outside a thin blade's edge, one face looks towards the point and the other away."""
    blade = TriangleMesh(np.array([(0, 0, 0), (0, 1, 0), (0, 0, 1), (5, 0.3, 0.3)]),
                         [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    assert blade.volume() > 0
    points = np.random.default_rng(0).uniform((-1, -1, -1), (6, 2, 2), (4000, 3))
    normals = np.cross(*(blade.corners()[:, i] - blade.corners()[:, 0] for i in (1, 2)))
    within = (np.einsum("tx,ptx->pt", normals, points[:, None] - blade.corners()[:, 0]) < 0).all(axis=1)
    np.testing.assert_array_equal(vertex_distances(points, blade) < 0, within)


def test_unsigned_distances_are_never_negative(shapes):
    points = np.random.default_rng(0).normal(size=(200, 3))
    sphere = shapes.sphere()
    signed, unsigned = vertex_distances(points, sphere), vertex_distances(points, sphere, signed=False)
    np.testing.assert_array_equal(np.abs(signed), unsigned)
    # 48 rings: the mesh keeps within 1 - cos(pi / 96)^2 = 1.1e-3 of the sphere
    np.testing.assert_allclose(signed, np.linalg.norm(points, axis=1) - 1, atol=1.2e-3)


def test_samples_lie_on_the_surface_in_proportion_to_area(shapes):
    box = shapes.box((0, 0, 0), (1, 2, 4))
    points = sample_surface(box, 10_000)
    np.testing.assert_array_equal(points, sample_surface(box, 10_000))
    assert not (points == sample_surface(box, 10_000, seed=1)).all()
    areas = {(0, 0): 8, (0, 1): 8, (1, 0): 4, (1, 2): 4, (2, 0): 2, (2, 4): 2}
    for (axis, height), area in areas.items():
        side = np.abs(points[:, axis] - height) < 1e-12
        assert abs(side.sum() - 10_000 * area / 28) <= 2  # within one for each of its two triangles
        # Uniform within: the mean lies in the middle, within 5 standard errors.
        middle = np.delete(points[side].mean(axis=0) / (1, 2, 4), axis)
        np.testing.assert_allclose(middle, 0.5, atol=5 * 0.29 / np.sqrt(side.sum()))


def test_surfaces_that_are_not_there_are_refused():
    nothing = TriangleMesh(np.zeros((3, 3)), np.zeros((0, 3), int))
    with pytest.raises(ValueError):
        SurfaceIndex(nothing)
    with pytest.raises(ValueError, match="without area"):
        sample_surface(TriangleMesh(np.zeros((3, 3)), [(0, 1, 2)]), 10)


def test_no_points_have_no_distances(shapes):
    assert vertex_distances(np.zeros((0, 3)), shapes.box()).shape == (0,)
