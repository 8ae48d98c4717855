# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A triangle mesh: the form in which a truth is given and surfaces are compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def merge_equal(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct points (m, 3), and for each of the points (n, 3) its row in them (n,) int64."""
    order = np.lexsort(points.T)
    ordered = points[order]
    new = np.append(True, (ordered[1:] != ordered[:-1]).any(axis=1))[:len(points)]
    rows = np.zeros(len(points), np.int64)
    rows[order] = np.cumsum(new) - 1
    return ordered[new], rows


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles over shared vertices.

    Parameters
    ----------
    vertices : (v, 3) float64 array
        In the object frame, in the scene's unit.
    triangles : (t, 3) int32 array
        Rows of ``vertices``, counter-clockwise seen from outside.

    Raises
    ------
    ValueError
        An array has the wrong shape, a coordinate is not finite, or a triangle names a vertex that is not there.
    """

    vertices: np.ndarray
    triangles: np.ndarray

    def __post_init__(self) -> None:
        vertices = np.array(self.vertices, np.float64)
        triangles = np.array(self.triangles)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise ValueError(f"vertices must be (v, 3) finite numbers, not {vertices.shape}")
        if triangles.ndim != 2 or triangles.shape[1] != 3 or (triangles.size and triangles.dtype.kind not in "iu"):
            raise ValueError(f"triangles must be (t, 3) integers, not {triangles.shape} {triangles.dtype}")
        if triangles.size and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
            raise ValueError(f"triangles must name vertices from 0 to {len(vertices) - 1}")
        triangles = triangles.astype(np.int32)
        vertices.flags.writeable = triangles.flags.writeable = False
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    @classmethod
    def from_quads(cls, vertices: np.ndarray, quads: np.ndarray) -> TriangleMesh:
        """Split every (q, 4) quad along its diagonal 0-2; quad ``i`` becomes the triangles ``2 i`` and ``2 i + 1``."""
        return cls(vertices, np.asarray(quads)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))

    def corners(self) -> np.ndarray:
        """Return the (t, 3, 3) positions of every triangle's corners."""
        return self.vertices[self.triangles]

    def bounds(self) -> np.ndarray:
        """Return the (2, 3) lower and upper corner of the vertices that the triangles use.

        Raises
        ------
        ValueError
            The mesh has no triangles.
        """
        if not len(self.triangles):
            raise ValueError("a mesh without triangles has no bounds")
        used = self.vertices[self.triangles.ravel()]
        return np.stack((used.min(axis=0), used.max(axis=0)))

    def areas(self) -> np.ndarray:
        """Return the (t,) area of every triangle."""
        a, b, c = np.moveaxis(self.corners(), 1, 0)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    def area(self) -> float:
        """Return the surface's area."""
        return float(self.areas().sum())

    def volume(self) -> float:
        """Return the enclosed volume by the divergence theorem: negative inside out, meaningless if not watertight."""
        if not len(self.triangles):
            return 0.0
        centre = self.bounds().mean(axis=0)  # near the mesh, so that far from the origin no digits cancel
        a, b, c = np.moveaxis(self.corners() - centre, 1, 0)
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)

    def edge_imbalance(self) -> int:
        """Return by how much, at the worst edge, the triangles that run along it one way outnumber the others.

        0 is a watertight mesh. 1 is one with holes whose triangles still agree on the outside. More means that
        neighbours disagree. Vertices at exactly the same position count as one, so a mesh that was split along seams
        or sharp edges is still watertight.
        """
        if not len(self.triangles):
            return 0
        start = merge_equal(self.vertices)[1][self.triangles]
        stop = np.roll(start, -1, axis=1)
        edge = np.minimum(start, stop) * len(self.vertices) + np.maximum(start, stop)
        order = np.argsort(edge, axis=None)
        first = np.flatnonzero(np.diff(edge.ravel()[order], prepend=-1))
        return int(np.abs(np.add.reduceat(np.sign(stop - start).ravel()[order], first)).max())

    def is_watertight(self) -> bool:
        """Return whether the surface is closed and all triangles agree on which side is out."""
        return self.edge_imbalance() == 0


@dataclass(frozen=True)
class PolygonMesh:
    """Plane polygons over shared vertices: the form in which solids are cut, since every cut would divide triangles anew.

    Parameters
    ----------
    vertices : (v, 3) float64 array
    corners : (c,) int32 array
        The polygons' vertices, one polygon after the other, each counter-clockwise seen from outside.
    starts : (f,) int32 array
        Where in ``corners`` each polygon begins.
    """

    vertices: np.ndarray
    corners: np.ndarray
    starts: np.ndarray

    @classmethod
    def joined(cls, vertices: np.ndarray, *faces: np.ndarray) -> PolygonMesh:
        """Return the mesh of several (f, k) arrays of faces, each of one number of corners."""
        sizes = np.concatenate([np.full(len(part), part.shape[1]) for part in faces])
        corners = np.concatenate([part.ravel() for part in faces]).astype(np.int32)
        return cls(vertices, corners, (np.cumsum(sizes) - sizes).astype(np.int32))

    @property
    def sizes(self) -> np.ndarray:
        """The (f,) number of corners of every polygon."""
        return np.diff(self.starts, append=len(self.corners))

    def without(self, polygons: np.ndarray) -> PolygonMesh:
        """Return the mesh without the polygons where a (f,) bool array is True."""
        sizes = self.sizes[~polygons]
        return PolygonMesh(self.vertices, self.corners[np.repeat(~polygons, self.sizes)], (np.cumsum(sizes) - sizes).astype(np.int32))
