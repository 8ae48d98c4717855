# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a rig covers an object: views, lights and projector pixels of each triangle, and the error of depth to be expected there.

A rig with projectors or lasers measures by them. One without can only match what its pictures show alike: each view with its nearest
neighbour, as the method ``stereo`` does, and on a surface with texture. Silhouettes measure no depth at all: their error is that of
the hull, which no pixel's error tells.

The error comes from the rig's geometry alone. A device that sees a point with an error of s pixels, each f across at the point, knows
it to ``s f`` across its ray and not at all along it: its information about the point is ``(I - d d^T) / (s f)^2``, with the ray's
direction d. That of all devices which work together adds up, and the inverse of the sum is the point's covariance (Hartley &
Zisserman, 2004, section 5.2). Between a camera's ray and an exactly known sheet of light at the angle theta this is the
usual ``s f / sin(theta)``; between two equal cameras it is ``sqrt(2) s Z^2 / (focal length * baseline)`` along their common axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..geometry import Camera, Light
from ..mesh import TriangleMesh
from ..neighbours import nearest_views
from .depth_buffer import Sight

PIXEL_ERROR = 0.2  # pixels: a match is right to about a quarter, as difference of two such; a stripe's centre to a tenth
_FAR = 1e3  # of the object's size: where a sun stands
_EXACT = 0.03  # of a pixel's error: how well the sheet of a laser is known; far less would drown the rest in rounding
_SINGULAR = 1e-10  # determinant over the cube of the trace: two rays at a hundredth of a degree


@dataclass(frozen=True)
class Sheet:
    """A laser whose sheet of light turns about a line.

    Parameters
    ----------
    centre, axis : (3,) array
        A point of the line, from which the light comes, and the line's direction.
    """

    centre: np.ndarray
    axis: np.ndarray


@dataclass(frozen=True)
class Shot:
    """A camera at one pose of the object, with all that shines in its frames there; everything in the object frame.

    Parameters
    ----------
    camera : Camera
    lights : tuple of Light
    projectors : tuple of Camera
    sheets : tuple of Sheet
    """

    camera: Camera
    lights: tuple[Light, ...] = ()
    projectors: tuple[Camera, ...] = ()
    sheets: tuple[Sheet, ...] = ()


@dataclass(frozen=True)
class Coverage:
    """What reaches the triangles of a surface.

    Parameters
    ----------
    areas : (n,) float64 array
        Of the triangles.
    views : (n,) int array
        Shots whose camera sees the triangle's middle in its picture.
    lights : (n,) int array
        Lights, or places of one, that shine on it.
    projector_pixels : (n,) float64 array
        Pixels of the projector that lie on a unit of area, at the pose where they are most.
    depth_error : (n,) float64 array
        Standard deviation along the normal, in the scene's unit; infinite where the rig measures no depth.
    active : bool
        Whether depth is measured by projectors or lasers, and not by matching pictures of a textured surface.
    """

    areas: np.ndarray
    views: np.ndarray
    lights: np.ndarray
    projector_pixels: np.ndarray
    depth_error: np.ndarray
    active: bool = True

    def summary(self) -> dict[str, float | None]:
        """Return what the rig misses: shares of the surface's area, from 0 to 1, and the median error of depth where there is one."""
        total = max(float(self.areas.sum()), 1e-300)

        def share(where: np.ndarray) -> float:
            return float(self.areas[where].sum()) / total

        measured = np.isfinite(self.depth_error)
        return {**{f"seen_by_less_than_{count}": share(self.views < count) for count in (1, 2, 3)},
                "unlit": share(self.lights == 0), "beyond_projectors": share(self.projector_pixels == 0),
                "without_depth": share(~measured),
                "median_depth_error": _weighted_median(self.depth_error[measured], self.areas[measured])}


@dataclass
class Surveyor:
    """Measures the coverage of one surface, again and again; what is seen from a place is found once.

    Parameters
    ----------
    mesh : TriangleMesh
        What hides and is hidden.
    corners : (n, 3, 3) array
        The triangles that are asked about: the mesh's, or parts of them.

    Attributes
    ----------
    normals : (n, 3) array
        Theirs, of unit length.
    """

    mesh: TriangleMesh
    corners: np.ndarray
    _sights: dict[bytes, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        a, b, c = np.moveaxis(self.corners, 1, 0)
        across = np.cross(b - a, c - a)
        length = np.linalg.norm(across, axis=1)
        self._points, self._areas = (a + b + c) / 3, length / 2
        self.normals = across / np.maximum(length, 1e-300)[:, None]
        lower, upper = self.mesh.bounds()
        self._middle, self._size = (lower + upper) / 2, float(np.linalg.norm(upper - lower))

    def coverage(self, shots: Sequence[Shot], *, pixel_error: float = PIXEL_ERROR) -> Coverage:
        """Return what the shots cover.

        With projectors or lasers in any of them, depth is measured within each shot, without by each view and its nearest neighbour;
        the best of these counts.

        Parameters
        ----------
        shots : sequence of Shot
        pixel_error : float
            Standard deviation of a position in a picture, camera's or projector's, in pixels.
        """
        count, used = len(self._points), set()
        views, lights, pixels = np.zeros(count, int), np.zeros(count, int), np.zeros(count)
        best = np.full(count, np.inf)
        active, lit = any(shot.projectors or shot.sheets for shot in shots), set()
        for shot in shots:
            seen = self._in_picture(shot.camera, used)
            views += seen
            for place in map(self._place_of, shot.lights):
                if (key := self._key(place)) not in lit:
                    lit.add(key)
                    lights += self._seen_from(place, used)
            if not active:
                continue
            information = self._by_ray(shot.camera, seen, pixel_error)
            sources = np.zeros_like(information)
            for projector in shot.projectors:
                reached = self._in_picture(projector, used)
                pixels = np.maximum(pixels, np.where(reached, self._density(projector), 0))
                sources += self._by_ray(projector, reached & seen, pixel_error)
            for sheet in shot.sheets:
                sources += self._by_sheet(sheet, shot.camera, self._seen_from(sheet.centre, used) & seen, pixel_error)
            best = np.minimum(best, self._error(information + sources))
        if not active:
            best = self._by_pairs([shot.camera for shot in shots], used, pixel_error)
        self._sights = {key: seen for key, seen in self._sights.items() if key in used}
        return Coverage(self._areas, views, lights, pixels, best, active)

    def _by_pairs(self, cameras: Sequence[Camera], used: set[bytes], pixel_error: float) -> np.ndarray:
        """Return the error (n,) of the best pair of neighbours that sees each triangle."""
        best = np.full(len(self._points), np.inf)
        for first, second in {tuple(sorted(pair)) for pair in nearest_views(cameras, self._middle)}:
            pair = cameras[first], cameras[second]
            seen = self._in_picture(pair[0], used) & self._in_picture(pair[1], used)
            best = np.minimum(best, self._error(sum(self._by_ray(camera, seen, pixel_error) for camera in pair)))
        return best

    def _key(self, place: np.ndarray) -> bytes:
        return np.round((place - self._middle) / self._size * 1e5).astype(np.int64).tobytes()

    def _seen_from(self, place: np.ndarray, used: set[bytes]) -> np.ndarray:
        key = self._key(place)
        used.add(key)
        if key not in self._sights:
            self._sights[key] = Sight(self.mesh, place).sees(self._points, self.normals)
        return self._sights[key]

    def _in_picture(self, device: Camera, used: set[bytes]) -> np.ndarray:
        pixels, depth = device.project(self._points)
        with np.errstate(invalid="ignore"):
            inside = (depth > 0) & (pixels >= -0.5).all(axis=1) & (pixels < np.array(device.size) - 0.5).all(axis=1)
        return inside & self._seen_from(device.centre, used)

    def _place_of(self, light: Light) -> np.ndarray:
        if light.kind == "sun":
            return self._middle - _FAR * self._size * np.asarray(light.direction)
        return np.asarray(light.position, np.float64)

    def _density(self, projector: Camera) -> np.ndarray:
        """Return how many pixels lie on a unit of area: ``f^2 cos(incidence) / (distance^2 cos(off axis)^3)``."""
        way = self._points - projector.centre
        distance = np.maximum(np.linalg.norm(way, axis=1), 1e-300)
        facing = -np.einsum("ij,ij->i", way, self.normals) / distance
        off_axis = np.maximum(way @ projector.forward / distance, 1e-9)
        return projector.K[0, 0] * projector.K[1, 1] * np.maximum(facing, 0) / (distance ** 2 * off_axis ** 3)

    def _by_ray(self, device: Camera, seen: np.ndarray, pixel_error: float) -> np.ndarray:
        """Return the information (n, 3, 3) of a device that images points; zero where it does not see them."""
        way = self._points - device.centre
        distance = np.maximum(np.linalg.norm(way, axis=1), 1e-300)
        weight = np.where(seen, (_focal(device) / (pixel_error * distance)) ** 2, 0)
        way *= (np.sqrt(weight) / distance)[:, None]
        return weight[:, None, None] * np.eye(3) - way[:, :, None] * way[:, None, :]

    def _by_sheet(self, sheet: Sheet, camera: Camera, seen: np.ndarray, pixel_error: float) -> np.ndarray:
        normal = np.cross(self._points - sheet.centre, sheet.axis)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        distance = np.linalg.norm(self._points - camera.centre, axis=1)
        normal *= np.where(seen, _focal(camera) / (_EXACT * pixel_error * np.maximum(distance, 1e-300)), 0)[:, None]
        return normal[:, :, None] * normal[:, None, :]

    def _error(self, information: np.ndarray) -> np.ndarray:
        """Return the standard deviation (n,) along the normals; infinite where the information has no inverse."""
        rows = information[:, 0], information[:, 1], information[:, 2]
        adjugate = np.stack([np.cross(rows[(k + 1) % 3], rows[(k + 2) % 3]) for k in range(3)], axis=1)
        determinant = np.einsum("ij,ij->i", rows[0], adjugate[:, 0])
        squared = np.einsum("ij,ijk,ik->i", self.normals, adjugate, self.normals)
        trace = np.einsum("ijj->i", information)
        known = determinant > _SINGULAR * trace ** 3
        return np.sqrt(np.divide(np.maximum(squared, 0), determinant, out=np.full(len(squared), np.inf), where=known))


def _focal(device: Camera) -> float:
    return float(np.sqrt(device.K[0, 0] * device.K[1, 1]))


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float | None:
    if not len(values):
        return None
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2)]])
