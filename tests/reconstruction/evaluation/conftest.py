# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes with known volume, area and inside."""

import numpy as np
import pytest

from addon.reconstruction.geometry import rotation_about
from addon.reconstruction.mesh import TriangleMesh


def revolved(profile: np.ndarray, around: int) -> TriangleMesh:
    """Return the closed surface of a closed profile (n, 2) of (radius, z), clockwise, turned about z."""
    n = len(profile)
    angle = np.arange(around) * 2 * np.pi / around
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    vertices = np.concatenate((profile[None, :, :1] * ring[:, None], np.tile(profile[:, 1:], (around, 1, 1))), axis=2)
    i, j = np.meshgrid(np.arange(around), np.arange(n), indexing="ij")
    corner = [((i + a) % around * n + (j + b) % n).ravel() for a, b in ((0, 0), (0, 1), (1, 1), (1, 0))]
    triangles = np.concatenate([np.stack([corner[k] for k in rows], axis=1) for rows in ((0, 1, 2), (0, 2, 3))])
    return TriangleMesh(vertices.reshape(-1, 3), triangles)


class Shapes:
    """Makers of closed meshes, all counter-clockwise seen from outside."""

    @staticmethod
    def sphere(radius=1.0, centre=(0, 0, 0), rings=48):
        polar = np.linspace(0, np.pi, rings + 1)
        # A half circle from the top. What closes it along the axis has no area. The poles are many equal vertices.
        mesh = revolved(radius * np.stack((np.sin(polar), np.cos(polar)), axis=1), 2 * rings)
        poles = np.isclose(np.abs(mesh.vertices[:, 2]), radius)
        mesh.vertices.flags.writeable = True
        mesh.vertices[poles, :2] = 0.0
        return Shapes.moved(TriangleMesh(mesh.vertices, mesh.triangles[mesh.areas() > 0]), centre)

    @staticmethod
    def torus(major=1.0, minor=0.4, around=96):
        angle = -np.linspace(0, 2 * np.pi, around, endpoint=False)
        return revolved(np.stack((major + minor * np.cos(angle), minor * np.sin(angle)), axis=1), around)

    @staticmethod
    def box(lower=(0, 0, 0), upper=(1, 1, 1)):
        bits = np.array([(i >> 2 & 1, i >> 1 & 1, i & 1) for i in range(8)])
        quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
        return TriangleMesh.from_quads(np.array(lower) + bits * np.subtract(upper, lower), quads)

    @staticmethod
    def moved(mesh, offset=(0, 0, 0), axis=(0, 0, 1), angle=0.0):
        return TriangleMesh(mesh.vertices @ rotation_about(axis, angle).T + offset, mesh.triangles)

    @staticmethod
    def joined(*meshes):
        starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
        triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=False)]
        return TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))

    @staticmethod
    def inside_out(mesh):
        return TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1])

    @staticmethod
    def soup(triangles=40, seed=0, extent=1.0):
        """Return triangles of all sizes and shapes, slivers and points among them."""
        rng = np.random.default_rng(seed)
        corners = rng.random((triangles, 3, 3)) * extent
        corners[::4] = corners[::4, :1] + 0.05 * (corners[::4] - corners[::4, :1])
        corners[1::8, 2] = (corners[1::8, 0] + corners[1::8, 1]) / 2  # almost or exactly without area
        corners[2::16] = corners[2::16, :1]
        return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * triangles).reshape(-1, 3))


@pytest.fixture(scope="session")
def shapes():
    return Shapes
