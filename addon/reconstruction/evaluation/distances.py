# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Distances from points to the surface of a mesh, and samples of a surface.

Nearest triangles are found through points. The triangles are cut small, and the corners of the pieces are the *nodes*:
every point of a triangle's face, of its edge, or its corner then has within a radius ``r`` a node of that same
face, edge or corner. If ``q`` is the point of the mesh nearest to ``p``, at the distance ``d``, then ``p - q`` is
perpendicular to the face or edge it lies in, and so by Pythagoras that node is at most ``sqrt(d^2 + r^2)`` from ``p``.
All triangles around all nodes that near contain ``q``: their exact distances give ``d``.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..mesh import TriangleMesh, merge_equal
from .pieces import bisect, expand, sorted_unique, squared_edges

NODES = 100_000
NEIGHBOURS = (8, 48)  # nodes looked at, then again where the first were not certain to be enough
CHUNK = 1 << 16
KDTREE_SINGLE = 4  # cv2.flann's exact tree for few dimensions; cv2 exports no constant for it
FLOAT32 = 4 * 2.0 ** -23  # the tree's single precision: coordinates rounded, differences squared and summed


@dataclass(frozen=True)
class Distances:
    """Distances of points from a surface.

    Parameters
    ----------
    distance : (n,) float64 array
        Exact for the triangles looked at; never less than the true one.
    bound : (n,) float64 array
        At most this much greater than the true one. 0 where the search was certain, which is nearly everywhere.
    """

    distance: np.ndarray
    bound: np.ndarray


class SurfaceIndex:
    """A mesh prepared for many questions about what lies nearest.

    Parameters
    ----------
    mesh : TriangleMesh
    nodes : int
        About how many points the search goes through; a mesh with more vertices has all of them. The distances are the
        same with more or fewer. As many as there will be questions is a good choice.

    Raises
    ------
    ValueError
        The mesh has no triangles.
    """

    def __init__(self, mesh: TriangleMesh, *, nodes: int = NODES) -> None:
        low, high = mesh.bounds()
        self._centre = (low + high) / 2  # single precision serves best round zero
        used = np.zeros(len(mesh.vertices), bool)
        used[mesh.triangles] = True
        # A file may repeat a vertex for each of its triangles; the tree would find all of them and nothing else.
        vertices, row = merge_equal(mesh.vertices[used])
        triangles = row[(np.cumsum(used) - 1)[mesh.triangles]]
        vertices = vertices - self._centre
        # Bisection tends to right isosceles triangles of 1/8 to 1/4 of the longest edge squared, two for each node.
        longest = np.sqrt(3 * mesh.area() / max(nodes, len(vertices)))
        longest = max(longest, np.linalg.norm(high - low) / nodes, np.finfo(float).tiny)
        points, pieces, parent = bisect(vertices, triangles, longest)
        # No point of a triangle is farther from its nearest corner than its longest edge / sqrt(3).
        self.radius = float(np.sqrt(squared_edges(points, pieces).max() / 3))
        # All pairs of a node and a triangle around it, once each, in order.
        around = sorted_unique((pieces * len(triangles) + parent[:, None]).ravel())
        node, self._triangle = np.divmod(around, len(triangles))
        self._count = np.bincount(node, minlength=len(points))
        self._first = np.cumsum(self._count) - self._count
        self._corners = vertices[triangles]
        self._points = points.astype(np.float32)  # the tree keeps no copy
        self._tree = cv2.flann_Index(self._points, {"algorithm": KDTREE_SINGLE, "leaf_max_size": 10})

    def distances(self, points: np.ndarray) -> Distances:
        """Return how far points (n, 3) are from the nearest point of the surface.

        Notes
        -----
        Up to 48 nodes are looked at. They are enough, and the distance exact, unless the point sees very much of the
        surface at almost the same distance, such as from the centre of a sphere. There the error is still at most
        about ``radius^2 / (2 distance)``, and `Distances.bound` says how much it may be.
        """
        points = np.asarray(points, np.float64)
        distance, bound = np.zeros(len(points)), np.zeros(len(points))
        for start in range(0, len(points), CHUNK):
            part = slice(start, start + CHUNK)
            distance[part], bound[part], _ = self._search(points[part] - self._centre)
        return Distances(distance, bound)

    def signed_distances(self, points: np.ndarray) -> np.ndarray:
        """Return the distances (n,) of points (n, 3), negative inside.

        Inside is where the angle-weighted normal at the nearest point turns away (Baerentzen & Aanaes, "Signed
        distance computation using the angle weighted pseudonormal", 2005).
        """
        points = np.asarray(points, np.float64)
        signed = np.zeros(len(points))
        for start in range(0, len(points), CHUNK):
            local = points[start:start + CHUNK] - self._centre
            distance, _, pairs = self._search(local, keep=True)
            side = self._side(local, distance, *(np.concatenate(column) for column in zip(*pairs, strict=True)))
            signed[start:start + CHUNK] = np.where(side < 0, -distance, distance)
        return signed

    def _search(self, points: np.ndarray, *, keep: bool = False) -> tuple[np.ndarray, np.ndarray, list]:
        """Return distances, their bounds, and if wanted all pairs looked at: [(point, triangle, squared distance)]."""
        best, bound = np.full(len(points), np.inf), np.zeros(len(points))
        pairs, todo = [], np.arange(len(points))
        # What single precision may have taken off the distances that the tree reports.
        loss = FLOAT32 * (np.abs(points).max(axis=1, initial=0) + np.abs(self._points).max())
        for neighbours in NEIGHBOURS:
            neighbours = min(neighbours, len(self._points))
            near, squared = self._tree.knnSearch(points[todo].astype(np.float32), neighbours, params={"checks": -1})
            at_least = np.maximum(np.sqrt(squared) * (1 - FLOAT32) - loss[todo, None], 0)
            row = np.arange(len(todo))
            for rank in range(neighbours):
                row = row[at_least[row, rank] ** 2 <= best[todo[row]] + self.radius ** 2]  # not yet certain
                found = self._around(points, todo[row], near[row, rank], best)
                pairs += [found] if keep else []
            # Whatever was not looked at has all its nodes at least as far away as the last one.
            unseen = np.sqrt(np.maximum(at_least[row, -1] ** 2 - self.radius ** 2, 0))
            bound[todo] = 0
            if neighbours == len(self._points):  # everything was looked at
                break
            todo = todo[row]
            bound[todo] = np.maximum(np.sqrt(best[todo]) - unseen, 0)
            todo = todo[bound[todo] > 0]
            if not len(todo):
                break
        return np.sqrt(best), bound, pairs

    def _around(self, points: np.ndarray, rows: np.ndarray, nodes: np.ndarray,
                best: np.ndarray) -> tuple[np.ndarray, ...]:
        """Measure points[rows] against all triangles around one node each; lower ``best`` (squared distances)."""
        found = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
        for owner, position in expand(self._count[nodes], CHUNK):
            row, triangle = rows[owner], self._triangle[self._first[nodes[owner]] + position]
            squared = squared_distances(points[row], self._corners[triangle])
            np.minimum.at(best, row, squared)
            found.append((row, triangle, squared))
        return tuple(np.concatenate(column) for column in zip(*found, strict=True))

    def _side(self, points: np.ndarray, distance: np.ndarray, row: np.ndarray, triangle: np.ndarray,
              squared: np.ndarray) -> np.ndarray:
        """Return (n,) numbers whose sign is the side of the surface that each point is on."""
        scale = self.radius + np.abs(points).max(initial=0)
        nearest = np.sqrt(squared) <= distance[row] * (1 + 1e-9) + 1e-12 * scale
        # Once each: a triangle lies round several nodes.
        pair = sorted_unique(row[nearest] * len(self._corners) + triangle[nearest])
        row, triangle = np.divmod(pair, len(self._corners))
        corners = self._corners[triangle]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
        towards = (normal * (points[row] - corners[:, 0])).sum(axis=1)
        return np.bincount(row, _angle_at_nearest(points[row], corners) * towards, minlength=len(points))


def squared_distances(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the squared distance (n,) of points (n, 3) from one triangle (n, 3, 3) each, without area too."""
    offset = [points - corners[:, i] for i in range(3)]
    edge = [corners[:, (i + 1) % 3] - corners[:, i] for i in range(3)]
    normal = np.cross(edge[0], edge[1])
    best, above = None, (normal != 0).any(axis=1)
    for i in range(3):
        length = _dot(edge[i], edge[i])
        along = np.clip(_dot(offset[i], edge[i]) / np.where(length == 0, 1, length), 0, 1)
        rest = offset[i] - along[:, None] * edge[i]
        squared = _dot(rest, rest)
        best = squared if best is None else np.minimum(best, squared)
        above &= _dot(np.cross(normal, edge[i]), offset[i]) >= 0
    area = _dot(normal, normal)
    plane = _dot(offset[0], normal) ** 2 / np.where(area == 0, 1, area)
    return np.where(above, np.minimum(plane, best), best)


def _angle_at_nearest(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the angle (n,) that each triangle has round its point nearest to ``points``.

    That of its corner at a corner, half a turn at an edge, a turn in its middle.
    """
    weights = _barycentric(points, corners)
    angle = np.full(len(points), 2 * np.pi)
    angle[(weights <= 1e-9).sum(axis=1) == 1] = np.pi
    for i in range(3):
        at = weights[:, i] >= 1 - 1e-9
        first, second = (corners[at, (i + k) % 3] - corners[at, i] for k in (1, 2))
        angle[at] = np.arctan2(np.linalg.norm(np.cross(first, second), axis=1), _dot(first, second))
    return angle


def _barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the barycentric coordinates (n, 3) of the points of triangles (n, 3, 3) that are nearest to ``points``."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.where(_dot(normal, normal) == 0, 1, _dot(normal, normal))
    weights, best = np.zeros((len(points), 3)), np.full(len(points), np.inf)
    inner = np.zeros((len(points), 3))
    for i in range(3):
        a, b = corners[:, i], corners[:, (i + 1) % 3]
        edge = b - a
        inner[:, (i + 2) % 3] = _dot(np.cross(normal, edge), points - a) / area
        length = _dot(edge, edge)
        along = np.clip(_dot(points - a, edge) / np.where(length == 0, 1, length), 0, 1)
        rest = points - a - along[:, None] * edge
        closer = _dot(rest, rest) < best
        best = np.where(closer, _dot(rest, rest), best)
        on_edge = np.zeros((len(points), 3))
        on_edge[:, i], on_edge[:, (i + 1) % 3] = 1 - along, along
        weights = np.where(closer[:, None], on_edge, weights)
    within = (inner >= 0).all(axis=1) & (normal != 0).any(axis=1)
    return np.where(within[:, None], inner, weights)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)


def nearest_distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return how far points (n, 3) are from the nearest of other points (m, 3), at least one: (n,) float64."""
    others = np.asarray(others, np.float64)
    centre = others.mean(axis=0)  # single precision serves best round zero
    kept = (others - centre).astype(np.float32)  # the tree keeps no copy
    tree = cv2.flann_Index(kept, {"algorithm": KDTREE_SINGLE, "leaf_max_size": 10})
    distance = np.zeros(len(points))
    for start in range(0, len(points), CHUNK):
        near, _ = tree.knnSearch((points[start:start + CHUNK] - centre).astype(np.float32), 1, params={"checks": -1})
        distance[start:start + CHUNK] = np.linalg.norm(points[start:start + CHUNK] - others[near[:, 0]], axis=1)
    return distance


def vertex_distances(points: np.ndarray, mesh: TriangleMesh, *, signed: bool = True) -> np.ndarray:
    """Return how far points, such as the vertices of a result, are from a mesh: the numbers of a heat map.

    Parameters
    ----------
    points : (n, 3) array
        In the frame of the mesh.
    mesh : TriangleMesh
    signed : bool
        Negative inside the mesh, which must then be closed; otherwise never negative.

    Returns
    -------
    (n,) float64 array
        In the unit of the mesh.

    Raises
    ------
    ValueError
        The mesh has no triangles.
    """
    index = SurfaceIndex(mesh)
    return index.signed_distances(points) if signed else index.distances(points).distance


def sample_surface(mesh: TriangleMesh, count: int, *, seed: int = 0) -> np.ndarray:
    """Return (count, 3) points spread over a mesh in proportion to area.

    One point is drawn from each of ``count`` equal shares of the area, in the order of the triangles, so that every
    part of the surface gets its due; the place within a triangle is uniform (Osada et al., 2002).

    Raises
    ------
    ValueError
        The mesh has no area.
    """
    areas = mesh.areas()
    reached = np.cumsum(areas)
    if not len(areas) or not reached[-1] > 0:
        raise ValueError("a mesh without area cannot be sampled")
    random = np.random.default_rng(seed)
    steps = (np.arange(count) + random.random(count)) * (reached[-1] / count)
    triangle = np.minimum(np.searchsorted(reached, steps, side="right"), np.flatnonzero(areas)[-1])
    root, along = np.sqrt(random.random(count))[:, None], random.random(count)[:, None]
    a, b, c = np.moveaxis(mesh.corners()[triangle], 1, 0)
    return (1 - root) * a + root * (1 - along) * b + root * along * c
