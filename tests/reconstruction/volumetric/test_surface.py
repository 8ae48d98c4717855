# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface against a plain scan of the dense array, and the laws that every closed surface obeys."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric import surface as surface_module
from addon.reconstruction.volumetric.surface import Surface, extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume

ORIGIN, SIZE = (-1.0, 0.5, 2.0), 0.25  # binary fractions, so that positions and volumes are exact
SHAPES = st.tuples(*[st.integers(1, 19)] * 3)


@st.composite
def occupancies(draw) -> np.ndarray:
    """Draw single voxels, dust, or blocks that make whole bricks meet empty ones, up to the ends of odd grids."""
    shape = draw(SHAPES)
    if draw(st.booleans()):
        return draw(hnp.arrays(bool, shape, fill=st.booleans()))
    coarse = draw(hnp.arrays(bool, (3, 3, 3)))
    return coarse.repeat(8, 0).repeat(8, 1).repeat(8, 2)[:shape[0], :shape[1], :shape[2]]


def surface_of(occupancy: np.ndarray) -> Surface:
    return extract_surface(SparseVolume.from_dense(VoxelGrid(ORIGIN, SIZE, occupancy.shape), occupancy))


def exposed_faces(occupancy: np.ndarray) -> set[tuple[int, ...]]:
    """Return (x, y, z, direction) of each exposed face, from the definition."""
    faces = set()
    for direction in range(6):
        axis, upper = divmod(direction, 2)
        padded = np.pad(occupancy, 1)
        neighbour = np.roll(padded, -1 if upper else 1, axis)[1:-1, 1:-1, 1:-1]
        faces |= {(*map(int, voxel), direction) for voxel in np.argwhere(occupancy & ~neighbour)}
    return faces


def check_faces(surface: Surface, occupancy: np.ndarray) -> None:
    """The faces are the exposed ones, each once, and lie where they should, turned outward."""
    found = [(*map(int, surface.voxels[voxel]), int(axis))
             for voxel, axis in zip(surface.face_voxel, surface.face_axis, strict=True)]
    assert len(found) == len(set(found))
    assert set(found) == exposed_faces(occupancy)
    corners = surface.vertices[surface.quads]
    outward = np.zeros((len(corners), 3))
    outward[np.arange(len(corners)), surface.face_axis // 2] = 2.0 * (surface.face_axis % 2) - 1
    centre = np.array(ORIGIN) + SIZE * (surface.voxels[surface.face_voxel] + 0.5)
    np.testing.assert_array_equal(corners.mean(axis=1), centre + SIZE / 2 * outward)
    # Each corner's cross product of its two edges is the outward normal times the area: convex, flat, one way round.
    edges = np.roll(corners, -1, axis=1) - corners
    np.testing.assert_array_equal(np.cross(np.roll(edges, 1, axis=1), edges),
                                  np.repeat(SIZE ** 2 * outward[:, None], 4, axis=1))
    np.testing.assert_array_equal(surface.face_normals(), outward)


def check_closed(surface: Surface) -> None:
    """Vertices are shared and all used; every edge is run through as often one way as the other."""
    assert len(np.unique(surface.vertices, axis=0)) == len(surface.vertices)
    np.testing.assert_array_equal(np.unique(surface.quads), np.arange(len(surface.vertices)))
    edges = np.stack((surface.quads, np.roll(surface.quads, -1, axis=1)), axis=-1).reshape(-1, 2)
    forward, times = np.unique(edges, axis=0, return_counts=True)
    backward, times_back = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    np.testing.assert_array_equal(forward, backward)
    np.testing.assert_array_equal(times, times_back)


@settings(max_examples=80, deadline=None)
@given(occupancies())
def test_the_surface_is_the_exposed_faces_closed_and_outward(occupancy):
    surface = surface_of(occupancy)
    check_faces(surface, occupancy)
    check_closed(surface)
    # Divergence theorem: the flux of the position vector through the surface is three times the volume.
    corners = surface.vertices[surface.triangles()]
    flux = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    assert flux / 6 == occupancy.sum() * SIZE ** 3
    assert len(surface.triangles()) == 2 * len(surface.quads)


@settings(max_examples=40, deadline=None)
@given(occupancies())
def test_surface_voxels_are_those_with_an_exposed_face_each_once(occupancy):
    surface = surface_of(occupancy)
    expected = {face[:3] for face in exposed_faces(occupancy)}
    assert len(surface.voxels) == len(expected)
    assert {tuple(map(int, voxel)) for voxel in surface.voxels} == expected
    np.testing.assert_array_equal(np.unique(surface.face_voxel), np.arange(len(surface.voxels)))


@pytest.mark.parametrize("shape", [(1, 1, 1), (8, 8, 8), (9, 17, 5), (16, 24, 24), (24, 16, 24), (24, 24, 16)])
def test_a_full_grid_is_a_box_and_an_empty_one_nothing(shape):
    full = surface_of(np.ones(shape, bool))
    x, y, z = shape
    assert len(full.quads) == 2 * (x * y + y * z + z * x)
    assert len(full.vertices) == len(full.quads) + 2  # Euler, for quads on a sphere
    np.testing.assert_array_equal([full.vertices.min(axis=0), full.vertices.max(axis=0)],
                                  [ORIGIN, np.array(ORIGIN) + SIZE * np.array(shape)])
    check_closed(full)
    empty = surface_of(np.zeros(shape, bool))
    assert [len(array) for array in (empty.vertices, empty.quads, empty.voxels, empty.face_voxel)] == [0] * 4
    assert empty.quads.shape == (0, 4) and empty.triangles().shape == (0, 3)
    assert empty.normals(smoothing=2).shape == (0, 3)


def test_the_result_does_not_depend_on_the_size_of_chunks(monkeypatch):
    occupancy = np.random.default_rng(1).random((30, 21, 18)) < 0.4
    whole = surface_of(occupancy)
    monkeypatch.setattr(surface_module, "CHUNK", 5)
    parts = surface_of(occupancy)
    for name in ("vertices", "quads", "voxels", "face_voxel", "face_axis"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name))
        assert getattr(whole, name).dtype == getattr(parts, name).dtype


def test_arrays_have_the_types_that_are_promised():
    surface = surface_of(np.ones((3, 2, 1), bool))
    assert [array.dtype for array in (surface.vertices, surface.quads, surface.voxels, surface.face_voxel,
                                      surface.face_axis)] == [np.float64, np.int32, np.int32, np.int32, np.int8]


def test_normals_of_a_ball_point_away_from_its_centre():
    where = np.indices((40, 40, 40)) + 0.5 - 20
    surface = surface_of((where ** 2).sum(axis=0) < 15 ** 2)
    away = surface.voxels + 0.5 - 20
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    rough = (surface.normals() * away).sum(axis=1)
    smooth = (surface.normals(smoothing=2) * away).sum(axis=1)
    # Sums of up to three axes are at most 55 degrees off: the angle between an axis and a cube's diagonal. What
    # smoothing cannot mend are plateaus wider than itself: the largest one of radius 15 ends sqrt(2 * 15) = 5.5 voxels
    # from the axis, where the ball leans by 21 degrees; half as much again is allowed.
    assert rough.min() > np.cos(np.radians(55))
    assert smooth.min() > np.cos(np.radians(32))
    assert smooth.mean() > rough.mean()


def test_opposite_faces_cancel_out():
    sheet = surface_of(np.ones((1, 9, 9), bool))
    middle = (sheet.voxels[:, 1:] == 4).all(axis=1)
    np.testing.assert_array_equal(sheet.normals()[middle], [[0, 0, 0]])
    np.testing.assert_allclose(np.linalg.norm(sheet.normals()[(sheet.voxels == 0).all(axis=1)], axis=1), 1)


def test_values_of_voxels_are_put_on_their_faces():
    surface = surface_of(np.random.default_rng(2).random((6, 7, 8)) < 0.5)
    np.testing.assert_array_equal(surface.on_faces(surface.voxels), surface.voxels[surface.face_voxel])
