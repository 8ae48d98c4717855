# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull as a polyhedron: exact for the silhouettes' outlines, without voxels (Matusik et al., 2001).

From the box of the working volume each view's background is cut away as a solid. The cutting itself is done by `Solids`, which
the caller brings along: a solver of solids, tested elsewhere, is not ours to write.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, silent
from ..contours import fill
from ..evaluation.voxelization import inside
from ..geometry import Camera, VoxelGrid
from ..mesh import PolygonMesh, TriangleMesh
from ..outcome import Outcome
from ..scan import Scan
from . import visual_hull
from .bounds import spread_order
from .silhouette_cones import SURE_TOLERANCE, BackgroundCone, background_cone

OPTIONS = (
    Option("rule", "center", "Where an outline runs", choices={
        "center": "midway between the centres of the silhouette's pixels and of the background's: unbiased",
        "conservative": "outside every pixel that the object touches, so that no piece of it is ever cut away"}),
    Option("simplify", 0.4, "Distance that an outline may move to have fewer corners; with rule=conservative at most "
                             f"{SURE_TOLERANCE}", unit=Unit.PIXELS, minimum=0.0, maximum=10.0),
    Option("outside", "unknown", "What lies beyond a picture's border", choices={
        "unknown": "nothing is known there, so nothing is removed",
        "empty": "background, so that a part of the object that leaves a picture is removed"}),
)


@dataclass(frozen=True)
class Solids:
    """The solver of solids that the caller brings along.

    Parameters
    ----------
    carve : callable
        ``carve(body, cone)`` returns what of a solid lies outside a cone, as a PolygonMesh.
    triangulate : callable
        ``triangulate(body)`` returns a solid's surface as a watertight TriangleMesh.
    """

    carve: Callable[[PolygonMesh, BackgroundCone], PolygonMesh]
    triangulate: Callable[[PolygonMesh], TriangleMesh]


_BOX = np.array([[0, 0, 1, 1, 0, 0, 1, 1], [0, 0, 0, 0, 1, 1, 1, 1], [0, 1, 0, 1, 0, 1, 0, 1]], float).T
_QUADS = np.array([(0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6), (0, 4, 6, 2), (1, 3, 7, 5)])


def working_bounds(scan: Scan, *, rule: str, simplify: float, outside: str) -> np.ndarray:
    """Return the (2, 3) working volume: the capture's own, or one found from the silhouettes' masks."""
    return visual_hull.working_bounds(_with_masks(scan), rule=rule, tolerance=0, outside=outside)


def polyhedral_hull(scan: Scan, grid: VoxelGrid, *, rule: str = "center", simplify: float = 0.4, outside: str = "unknown",
                    solids: Solids, progress: Progress = silent) -> Outcome:
    """Cut the visual hull of a scan out of the grid's box.

    Parameters
    ----------
    scan : Scan
        Every view with a mask or with contours. Cameras may have distortion, lie inside the volume or look away from it.
    grid : VoxelGrid
        Its box is where the hull is looked for, and its voxels are those of the outcome's volume: the ones with their
        centre inside the polyhedron.
    rule : {'center', 'conservative'}
        The latter holds the object if the masks were grown by `silhouettes.cover_partial_pixels`: such a mask's outline
        keeps `SURE_TOLERANCE` from all that the proof there allows, and the views' outermost pixels are not believed.
    simplify : float
        In pixels.
    outside : {'unknown', 'empty'}
    solids : Solids
        It is given solids in a frame in which the box is one unit long.

    Returns
    -------
    Outcome
        Its ``mesh`` is the polyhedron.

    Raises
    ------
    ScanstageError
        There are no views, a silhouette cannot be used, or nothing is left.
    """
    if not scan.views:
        raise ScanstageError("the capture has no views: a visual hull needs at least one")
    unit = float((grid.upper - grid.origin).max())
    box = np.stack((np.zeros(3), (grid.upper - grid.origin) / unit))
    body, sides = PolygonMesh.joined(_BOX * box[1], _QUADS), 0
    order = spread_order([view.camera for view in scan.views])
    for step, index in enumerate(order):
        view = scan.views[index]
        progress(step / len(order), f"Cutting view {step + 1} of {len(order)}")
        moved = replace(view, camera=_in_unit_box(view.camera, grid.origin, unit))
        cone = background_cone(moved, box, rule=rule, tolerance=simplify, outside=outside)
        if cone is None or not cone.window:
            continue
        sides += sum(len(loop) for loop in cone.window + cone.contours)
        body = solids.carve(body, cone)
        if not len(body.starts):
            raise ScanstageError(f"the polyhedral hull is empty from frame {view.name} on: that view contradicts the {step} before "
                                 "it; check masks and poses, or the bounds")
    surface = solids.triangulate(body)
    mesh = TriangleMesh(grid.origin + unit * surface.vertices, surface.triangles)
    progress(1.0, "Counting voxels")
    volume = inside(mesh, grid)
    if not volume.count():
        raise ScanstageError("the polyhedral hull is thinner than a voxel: give more --voxels, or narrower --bounds")
    counts = {"outline_sides": sides, "vertices": len(mesh.vertices), "triangles": len(mesh.triangles)}
    return Outcome(volume, {"counts": counts, "polyhedron": {"watertight": mesh.is_watertight(), "volume": mesh.volume()},
                            "warnings": visual_hull.capture_warnings(_with_masks(scan))}, mesh=mesh)


def _with_masks(scan: Scan) -> Scan:
    """Return the scan with the contours' own masks, for what needs no more."""
    return replace(scan, views=tuple(view if view.contours is None else replace(view, mask=fill(view.contours, view.camera.size))
                                     for view in scan.views))


def _in_unit_box(camera: Camera, origin: np.ndarray, unit: float) -> Camera:
    """Return the camera in coordinates that begin at ``origin`` and count in ``unit``: single precision is finest there."""
    return replace(camera, t=(camera.R @ origin + camera.t) / unit)
