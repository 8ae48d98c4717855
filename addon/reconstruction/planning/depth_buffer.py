# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of a mesh a place sees: a depth buffer of its triangles (Catmull, 1974).

The buffer is made for the question, not for a device: a square picture that the mesh's bounding ball fills, seen from the device's
centre. So it serves cameras, projectors and lights alike, and its pixels are as fine on the object for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..geometry import Camera, look_at
from ..mesh import TriangleMesh
from ..volumetric.item_buffer import box_pixels

PIXELS = 256  # along a side of a buffer
_WIDEST = np.radians(60)  # half the angle of a buffer's picture, for places within the ball
_TRIANGLES = 1 << 15  # worked on together
_SLACK = 1.0  # pixels' footprints that a point may lie behind the buffer and be seen: where the surface is bent inwards
_STEEPEST = 8.0  # footprints of depth from one pixel to the next: beyond, a face is seen so flatly that its slope says nothing


class Sight:
    """What is seen of a mesh from one place.

    Parameters
    ----------
    mesh : TriangleMesh
        Triangles that reach behind the place hide nothing.
    place : (3,) array
        The device's centre, in the mesh's frame.
    """

    def __init__(self, mesh: TriangleMesh, place: np.ndarray) -> None:
        lower, upper = mesh.bounds()
        middle = (lower + upper) / 2
        self._camera = _facing(np.asarray(place, np.float64), middle, float(np.linalg.norm(upper - lower)) / 2)
        self._depth = depth_buffer(mesh, self._camera)

    def sees(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return which points of the mesh's surface are turned to the place with nothing between.

        A point is compared with the buffer's nearest pixel at the depth that the plane through it, across its normal, has at
        that pixel, so that slanted surfaces do not hide themselves. Beside the outline of what hides it a point is right to
        half a pixel of the buffer.

        Parameters
        ----------
        points, normals : (n, 3) array
            Normals of any length, towards the outside.

        Returns
        -------
        (n,) bool array
        """
        camera = self._camera
        pixels, depth = camera.project(points)
        turned = np.einsum("ij,ij->i", normals, camera.centre - points) > 0
        with np.errstate(invalid="ignore"):
            near = np.rint(pixels)
            inside = turned & (depth > 0) & (near >= 0).all(axis=1) & (near < PIXELS).all(axis=1)
        asked = np.flatnonzero(inside)
        u, v = near[asked].astype(np.int64).T
        n, z = normals[asked], depth[asked]
        footprint = z / camera.K[0, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = np.einsum("ij,ij->i", n, points[asked] - camera.centre) / np.einsum("ij,ij->i", n, camera.rays(near[asked]))
        plane = np.clip(np.where(np.isfinite(plane), plane, z), z - _STEEPEST * footprint, z + _STEEPEST * footprint)
        seen = turned & (depth > 0)  # beyond the picture lies nothing that could hide a point
        seen[asked] = plane <= self._depth[v, u] + _SLACK * footprint
        return seen


def depth_buffer(mesh: TriangleMesh, camera: Camera) -> np.ndarray:
    """Return the depth (height, width) along the optical axis that the rays through pixels' centres meet first; infinite for none.

    Parameters
    ----------
    mesh : TriangleMesh
    camera : Camera
        In the mesh's frame, without distortion. Triangles that reach behind its plane are left out.
    """
    width, height = camera.size
    nearest = np.full(width * height, np.inf, np.float32)
    pixels, depth = camera.project(mesh.vertices)
    local = mesh.vertices @ camera.R.T + camera.t
    rays = np.linalg.inv(camera.K)
    ahead = mesh.triangles[(depth[mesh.triangles] > 0).all(axis=1)]
    for start in range(0, len(ahead), _TRIANGLES):
        triangles = ahead[start:start + _TRIANGLES]
        a, b, c = np.moveaxis(local[triangles], 1, 0)
        normal = np.cross(b - a, c - a)
        slope, reach = normal @ rays, np.einsum("ij,ij->i", normal, a)  # depth = reach / (slope . pixel)
        for pixel, triangle, bottom in _covered(pixels[triangles], slope, camera):
            with np.errstate(divide="ignore", invalid="ignore"):
                met = reach.take(triangle) / bottom
            np.minimum.at(nearest, pixel, np.where(met > 0, met, np.inf).astype(np.float32))
    return nearest.reshape(height, width)


def _covered(corners: np.ndarray, slope: np.ndarray, camera: Camera) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the pixels whose centres triangles (t, 3, 2) cover: flat pixel, triangle, and its slope's product with the pixel; (n,) each."""
    first = np.maximum(np.ceil(corners.min(axis=1) - 1e-6), 0)
    last = np.minimum(np.floor(corners.max(axis=1) + 1e-6), np.array(camera.size) - 1)
    box = np.concatenate((first, np.maximum(last - first + 1, 0)), axis=1).T
    following = np.roll(corners, -1, axis=1)
    side = following - corners
    area = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]
    side *= np.where(area < 0, -1.0, 1.0)[:, None, None]
    offset = side[..., 1] * corners[..., 0] - side[..., 0] * corners[..., 1]
    for triangle, u, v in box_pixels(box.astype(np.int64)):
        inside = np.ones(len(u), bool)
        for k in range(3):  # a side's own pixels belong to both triangles: no cracks
            inside &= side[:, k, 0].take(triangle) * v - side[:, k, 1].take(triangle) * u + offset[:, k].take(triangle) >= -1e-9
        hit = np.flatnonzero(inside)
        triangle, u, v = triangle.take(hit), u.take(hit), v.take(hit)
        x, y, one = (slope[:, k].take(triangle) for k in range(3))
        yield v * camera.size[0] + u, triangle, x * u + y * v + one


def _facing(place: np.ndarray, middle: np.ndarray, radius: float) -> Camera:
    """Return a camera at ``place`` whose picture a ball round ``middle`` fills."""
    way = middle - place
    distance = float(np.linalg.norm(way))
    half = min(np.arcsin(min(radius / max(distance, 1e-300), 1.0)), _WIDEST)
    if not distance > 0:
        way = np.array([0.0, 1.0, 0.0])
    steep = abs(way[2]) > 0.9 * np.linalg.norm(way)
    R, t = look_at(place, place + way, up=(0.0, 1.0, 0.0) if steep else (0.0, 0.0, 1.0))
    focal = (PIXELS / 2 - 1) / np.tan(half)
    return Camera([[focal, 0, (PIXELS - 1) / 2], [0, focal, (PIXELS - 1) / 2], [0, 0, 1]], R, t, (PIXELS, PIXELS))
