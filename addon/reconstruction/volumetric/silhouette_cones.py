# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What each view sees to be background, as a solid: the cone of lines of sight that miss the object.

A silhouette's own cone would have to reach round everything that the picture does not show: what lies beyond its border
or behind the camera is unknown, and stays. Its complement is bounded by the picture, and the hull is what is left when
each view's background is cut away (compare Reed & Allen, "3-D modeling from range imagery", 1999).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ...errors import ScanstageError
from ..contours import crossing, simplify, trace_outlines
from ..geometry import Camera
from ..mesh import PolygonMesh
from ..scan import View
from ..undistortion import undistort_pixels

SURE_TOLERANCE = 0.29
"""Pixels by which an outline traced round a mask of `silhouettes.cover_partial_pixels` may be off and still hold the object."""
MOST_OUTLINES = 200
"""Of a view; the solver takes minutes for a thousand."""
_NEAREST = 1e-3  # of the farthest depth: where a cone begins whose camera is inside the volume
_BEYOND = 1.01  # by which a cone is longer, or begins sooner, than what it has to cut


@dataclass(frozen=True)
class BackgroundCone:
    """The lines of sight of one view that miss the object.

    Parameters
    ----------
    name : str
        The view's.
    camera : Camera
        Without distortion.
    window, contours : tuple of (n, 2) array
        Loops in the camera's pixels: background is what lies inside the window (within an odd number of its loops) and
        outside the contours (within an even number of theirs).
    near, far : float
        The depths between which the cone is cut off.
    in_front : bool
        Whether all that is to be cut lies between them.
    """

    name: str
    camera: Camera
    window: tuple[np.ndarray, ...]
    contours: tuple[np.ndarray, ...]
    near: float
    far: float
    in_front: bool

    def solid(self, points: np.ndarray, triangles: np.ndarray) -> PolygonMesh:
        """Return the cone as a closed mesh.

        Parameters
        ----------
        points : (p, 2) array
            In the camera's pixels.
        triangles : (t, 3) array
            Rows of ``points``, counter-clockwise as x turns to y: together the background.
        """
        rays, count = self.camera.rays(points), len(points)
        vertices = self.camera.centre + np.concatenate((self.near * rays, self.far * rays))
        start, stop = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
        border = ~np.isin(start * count + stop, stop * count + start)  # no triangle on the other side
        a, b = start[border], stop[border]
        # From x to y to z is right-handed, so the given triangles face along the view: as the far cap must, and not the near.
        caps, walls = np.concatenate((triangles[:, ::-1], triangles + count)), np.stack((a, b, b + count, a + count), axis=1)
        turn = -1 if self.camera.mirrored else 1
        return PolygonMesh.joined(vertices, caps[:, ::turn], walls[:, ::turn])

    def to_view(self, vertices: np.ndarray) -> np.ndarray:
        """Return points (n, 3) as the view sees them: x and y in its picture, z from 0 at the near end to 1 at the far one.

        The map keeps planes, and makes the lines of sight parallel: the cone becomes a prism. A solver that compares boxes
        round faces then finds few that overlap, and is ten times faster. Where the camera is in the volume nothing is mapped.
        """
        if not self.in_front:
            return vertices
        pixels, depth = self.camera.project(vertices)
        z = (1 / self.near - 1 / depth) / (1 / self.near - 1 / self.far)
        return np.column_stack(((pixels - self._middle) / self._extent, z))

    def from_view(self, vertices: np.ndarray) -> np.ndarray:
        """Return what `to_view` was given."""
        if not self.in_front:
            return vertices
        depth = 1 / (1 / self.near - vertices[:, 2:] * (1 / self.near - 1 / self.far))
        return self.camera.centre + depth * self.camera.rays(vertices[:, :2] * self._extent + self._middle)

    @property
    def _middle(self) -> np.ndarray:
        return (np.array(self.camera.size) - 1) / 2

    @property
    def _extent(self) -> np.ndarray:
        """What is 1 along x and y in the view's frame; with the sign that keeps the outside of solids outside."""
        return max(self.camera.size) * np.array([-1 if self.camera.mirrored else 1, 1])


def background_cone(view: View, box: np.ndarray, *, rule: str, tolerance: float, outside: str) -> BackgroundCone | None:
    """Return the background that a view sees in a box, or None if it sees none of the box.

    Parameters
    ----------
    view : View
        Its ``contours`` come before its mask.
    box : (2, 3) array
        Lower and upper corner.
    rule : {'center', 'conservative'}
        See `polyhedral_hull`.
    tolerance : float
        Pixels that the outline of a mask may move to have fewer corners. Contours are taken as they are.
    outside : {'unknown', 'empty'}
        What lies beyond the picture.

    Raises
    ------
    ScanstageError
        The view has neither contours nor mask, they cannot be used, or with nothing beyond the picture the camera is in the box.
    """
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
    ideal = replace(view.camera, distortion=np.zeros(5))
    pixels, depth = ideal.project(corners)
    if depth.max() <= 0:
        return None
    far = float(depth.max()) * _BEYOND
    near = max(float(depth.min()) / _BEYOND, _NEAREST * far)
    in_front = bool(depth.min() > near)
    frame = _frame(view, pixels, in_front) if outside == "empty" else None
    known = _known(view.camera, rim=1 if rule == "conservative" and outside == "unknown" else 0)
    if rule == "conservative":  # a pixel of the ideal picture may be more than one of the real one
        tolerance = 0.0 if view.camera.distorted else min(tolerance, SURE_TOLERANCE)

    def loops_of(mask: np.ndarray) -> list[np.ndarray]:
        loops = trace_outlines(mask)
        if len(loops) > MOST_OUTLINES:
            raise ScanstageError(f"frame {view.name}: its silhouette has {len(loops)} outlines, which is noise, and a solid would be "
                                 "cut along each; leave out the small ones with --set remove_specks=20 --set fill_holes=20")
        return simplify([_undistorted(loop, view) for loop in loops], tolerance)

    if view.contours is not None:
        window, contours = None, [_undistorted(loop, view) for loop in _checked_contours(view)]
    elif view.mask is None:
        raise ScanstageError(f"frame {view.name} has no silhouette: choose how to take it with --set silhouette=...")
    elif frame is None:
        window, contours = loops_of(known & ~view.mask), []
    else:
        window, contours = None, loops_of(view.mask | ~known)
    if window is None:
        window = loops_of(known) if frame is None else [frame]
    return BackgroundCone(view.name, ideal, tuple(window), tuple(contours), near, far, in_front)


def _frame(view: View, pixels: np.ndarray, in_front: bool) -> np.ndarray:
    """Return a loop (4, 2) round the picture and the pixels (n, 2) of the box's corners."""
    if not in_front:
        raise ScanstageError(f"frame {view.name}: the camera is inside the working volume or beside it, where outside=empty cannot "
                             "be used; use outside=unknown")
    points = np.concatenate((pixels, [(0, 0), view.camera.size]))
    (left, top), (right, bottom) = points.min(axis=0) - 1, points.max(axis=0) + 1
    return np.array([(left, top), (right, top), (right, bottom), (left, bottom)])


def _checked_contours(view: View) -> list[np.ndarray]:
    loops = [np.asarray(loop, np.float64) for loop in view.contours]
    for number, loop in enumerate(loops):
        if loop.ndim != 2 or loop.shape[1] != 2 or len(loop) < 3 or not np.isfinite(loop).all():
            raise ScanstageError(f"frame {view.name}: contours[{number}] must be three or more finite points (n, 2), not {loop.shape}")
    if crossing(loops).any():
        raise ScanstageError(f"frame {view.name}: contours[{int(crossing(loops).argmax())}] crosses or touches itself or another "
                             "contour; give closed outlines that do not, holes as outlines of their own")
    return loops


def _known(camera: Camera, rim: int) -> np.ndarray:
    """Return the (height, width) bool mask of the pixels whose line of sight is known; all but a rim, for most lenses."""
    width, height = camera.size
    known = np.zeros((height, width), bool)
    known[rim:height - rim, rim:width - rim] = True
    if camera.distorted:
        pixels = np.stack(np.meshgrid(np.arange(-1.0, width + 1), np.arange(-1.0, height + 1)), axis=-1).reshape(-1, 2)
        inverted = undistort_pixels(pixels, camera)[1].reshape(height + 2, width + 2).astype(np.uint8)
        known &= cv2.erode(inverted, np.ones((3, 3), np.uint8))[1:-1, 1:-1].astype(bool)  # outlines go half a pixel beyond
    return known


def _undistorted(loop: np.ndarray, view: View) -> np.ndarray:
    """Return a loop (n, 2) of the real picture in the ideal one."""
    if not view.camera.distorted:
        return loop
    ideal, inverted = undistort_pixels(loop, view.camera)
    if not inverted.all():
        x, y = loop[inverted.argmin()]
        raise ScanstageError(f"frame {view.name}: the lens distortion cannot be inverted at pixel ({x:.1f}, {y:.1f}); check its "
                             "coefficients")
    return ideal
