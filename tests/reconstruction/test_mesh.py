# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Area, volume and closedness of meshes that are known."""

import numpy as np
import pytest

from addon.reconstruction.mesh import TriangleMesh

TETRAHEDRON = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)


def test_a_tetrahedron_is_one_sixth_of_its_cube():
    mesh = TriangleMesh(CORNERS * 2 + 1000, TETRAHEDRON)
    assert mesh.volume() == pytest.approx(8 / 6, rel=1e-12)
    assert mesh.area() == pytest.approx(4 * (1.5 + np.sqrt(3) / 2), rel=1e-12)
    np.testing.assert_array_equal(mesh.bounds(), [(1000, 1000, 1000), (1002, 1002, 1002)])
    assert TriangleMesh(CORNERS, TETRAHEDRON[:, ::-1]).volume() == pytest.approx(-1 / 6, rel=1e-12)


def test_bounds_leave_out_vertices_that_no_triangle_uses():
    mesh = TriangleMesh(np.concatenate((CORNERS, [(99, 99, 99)])), TETRAHEDRON)
    assert mesh.bounds().max() == 1


def test_watertight_is_closed_and_of_one_orientation():
    flipped = TETRAHEDRON.copy()
    flipped[0] = flipped[0, ::-1]
    assert TriangleMesh(CORNERS, TETRAHEDRON).edge_imbalance() == 0
    assert TriangleMesh(CORNERS, TETRAHEDRON[1:]).edge_imbalance() == 1
    assert TriangleMesh(CORNERS, flipped).edge_imbalance() == 2
    assert TriangleMesh(CORNERS[TETRAHEDRON].reshape(-1, 3), np.arange(12).reshape(4, 3)).is_watertight()
    assert not TriangleMesh(CORNERS, TETRAHEDRON[1:]).is_watertight()


def test_quads_are_cut_along_their_diagonal():
    square = TriangleMesh.from_quads(np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]), [(0, 1, 2, 3)])
    np.testing.assert_array_equal(square.triangles, [(0, 1, 2), (0, 2, 3)])
    assert square.area() == 1


@pytest.mark.parametrize(("vertices", "triangles"), [
    (CORNERS[:, :2], TETRAHEDRON), (CORNERS * np.nan, TETRAHEDRON), (CORNERS, TETRAHEDRON[:, :2]),
    (CORNERS, TETRAHEDRON + 1), (CORNERS, TETRAHEDRON - 1), (CORNERS, TETRAHEDRON.astype(float)),
])
def test_wrong_arrays_are_refused(vertices, triangles):
    with pytest.raises(ValueError, match="vertices|triangles"):
        TriangleMesh(vertices, triangles)


def test_nothing_has_no_area_volume_or_bounds():
    empty = TriangleMesh(CORNERS, np.zeros((0, 3), int))
    assert empty.area() == empty.volume() == 0 and empty.is_watertight()
    with pytest.raises(ValueError, match="no bounds"):
        empty.bounds()
