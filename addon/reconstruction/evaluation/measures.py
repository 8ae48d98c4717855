# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The numbers in which a reconstruction is compared with the truth.

All are in the scene's unit (its cube for volumes) or are shares from 0 to 1. A number that has no meaning, such as a
distance from a surface that is not there, is None.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, part_of, silent
from ..geometry import VoxelGrid
from ..mesh import TriangleMesh
from ..points import PointCloud
from ..volumetric.surface import Surface
from ..volumetric.volume import BRICK, SparseVolume
from .distances import SurfaceIndex, nearest_distances, sample_surface
from .overlap import slabs_of, touched_indices
from .voxelization import inside_slabs

OPTIONS = (
    Option("samples", 100_000, "Points taken on each of the two surfaces", minimum=100, maximum=10_000_000),
    Option("tolerance", 0.0, "Distance within which a point counts as found, for completeness and F-score; 0 stands "
           "for 1 % of the diagonal of the truth's bounding box", unit=Unit.LENGTH, minimum=0.0),
)

MAX_VOXELS = 1 << 32  # of the grid extended to the whole truth: minutes of work
TOLERANCE_SHARE = 0.01

Measures = dict[str, float | int | None]


def volume_measures(volume: SparseVolume, truth: TriangleMesh, *, progress: Progress = silent) -> Measures:
    """Compare a volume with the truth voxel by voxel.

    The truth is voxelised on the volume's own grid, continued as far as the truth reaches: what of it lies beyond the
    grid is lost. A voxel belongs to the truth if its centre does.

    Parameters
    ----------
    volume : SparseVolume
    truth : TriangleMesh
        Closed; see `voxelization.inside` for what becomes of holes.
    progress : Progress

    Returns
    -------
    dict
        ``result`` and ``truth``, the volumes |R| and |O|; ``excess`` |R without O| / |O|; ``loss`` |O without R| / |O|;
        ``iou`` |R and O| / |R or O|; ``truth_voxels_removed``, the count of voxels that lie wholly inside the truth
        and are not in the result.

    Raises
    ------
    ScanstageError
        The truth has no faces, or is so much larger than the grid that its unit must be wrong.

    Notes
    -----
    A conservative method keeps every voxel that the truth touches, so that even a perfect one has an excess: half a
    voxel along a surface parallel to the grid, 0.87 along its diagonals, and 0.75 on average over all directions. The
    floor of ``excess`` is thus about ``0.75 * area * voxel_size / truth``.
    """
    if not len(truth.triangles):
        raise ScanstageError("truth: the mesh has no faces; give a closed mesh")
    grid, offset = _extended(volume.grid, truth)
    shells = slabs_of(grid, touched_indices(truth, grid))
    slabs = zip(_moved_slabs(volume, grid, offset), inside_slabs(truth, grid), shells, strict=True)
    counts = np.zeros(4, np.int64)
    for row, (occupied, within, shell) in enumerate(slabs):
        progress(row * BRICK / grid.shape[0], "Comparing volumes")
        missing = within & ~shell & ~occupied
        counts += [np.count_nonzero(slab) for slab in (occupied, within, occupied & within, missing)]
    result, true, both, removed = counts.tolist()
    cube = grid.voxel_size ** 3
    return {"result": result * cube,
            "truth": true * cube,
            "excess": _ratio(result - both, true),
            "loss": _ratio(true - both, true),
            "iou": _ratio(both, result + true - both),
            "truth_voxels_removed": removed}


def _ratio(part: float, whole: float) -> float | None:
    return float(part / whole) if whole else None


def _extended(grid: VoxelGrid, truth: TriangleMesh) -> tuple[VoxelGrid, np.ndarray]:
    """Return the grid continued over the whole truth, and the index that voxel (0, 0, 0) has in it."""
    low, high = (truth.bounds() - grid.origin) / grid.voxel_size
    with np.errstate(over="ignore"):
        before = np.maximum(0, np.ceil(-low / BRICK)) * BRICK  # whole bricks, so that slabs stay slabs
        shape = before + np.maximum(np.ceil(high), grid.shape)
    if not shape.prod() <= max(MAX_VOXELS, 2 * grid.count):
        raise ScanstageError(f"truth: the mesh is {(high - low).max():.3g} voxels long, far more than the result's "
                             "grid; check that both are in the same unit")
    before = before.astype(int)
    return VoxelGrid(grid.origin - before * grid.voxel_size, grid.voxel_size, tuple(shape.astype(int))), before


def _moved_slabs(volume: SparseVolume, grid: VoxelGrid, offset: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the slabs of a volume on a larger grid."""
    ny, nz = volume.grid.shape[1:]
    x, y, z = offset
    source = volume.slabs()
    for start in range(0, grid.shape[0], BRICK):
        slab = np.zeros((min(BRICK, grid.shape[0] - start), *grid.shape[1:]), bool)
        if x <= start < x + volume.grid.shape[0]:
            part = next(source)
            slab[:len(part), y:y + ny, z:z + nz] = part
        yield slab


def surface_measures(result: TriangleMesh, truth: TriangleMesh, *, samples: int = 100_000, tolerance: float = 0.0,
                     seed: int = 0, progress: Progress = silent) -> Measures:
    """Compare two surfaces by the distances of points on each from the other.

    Parameters
    ----------
    result, truth : TriangleMesh
        In the same frame. Of the result only the surface counts, not which side is out.
    samples : int
        Points on each surface, spread by area.
    tolerance : float
        For completeness and F-score; 0 stands for 1 % of the diagonal of the truth's bounding box.
    seed : int
        Of the points' places. The same seed gives the same numbers.
    progress : Progress

    Returns
    -------
    dict
        ``accuracy_90``: 90 % of the result is within this distance of the truth (Seitz et al., "A comparison and
        evaluation of multi-view stereo reconstruction algorithms", 2006).
        ``completeness``: the share of the truth within the tolerance of the result (same).
        ``chamfer``: mean distance from result to truth plus mean distance from truth to result, not squared, not
        halved.
        ``hausdorff``: the greatest of all distances in either direction.
        ``f_score``: harmonic mean of completeness and of the share of the result within the tolerance of the truth
        (Knapitsch et al., "Tanks and Temples", 2017).
        ``rms``: root mean square distance from result to truth.

    Raises
    ------
    ScanstageError
        The truth has no surface.

    Notes
    -----
    Distances are from points to triangles, not to other points, so that equal surfaces are at a distance of 0. What
    remains of the sampling is chance: `hausdorff` may miss a spike between points, mean spacing
    ``sqrt(area / samples)``.
    """
    if not truth.area() > 0:
        raise ScanstageError("truth: the mesh has no faces with an area; give a mesh with a surface")
    if not result.area() > 0:
        return {"accuracy_90": None, "completeness": 0.0, "chamfer": None, "hausdorff": None, "f_score": 0.0,
                "rms": None}
    tolerance = tolerance or TOLERANCE_SHARE * float(np.linalg.norm(np.ptp(truth.bounds(), axis=0)))
    progress(0.0, "Measuring the result's distance from the truth")
    to_truth = SurfaceIndex(truth, nodes=samples).distances(sample_surface(result, samples, seed=seed)).distance
    progress(0.5, "Measuring the truth's distance from the result")
    to_result = SurfaceIndex(result, nodes=samples).distances(sample_surface(truth, samples, seed=seed)).distance
    precision, completeness = (float((distance <= tolerance).mean()) for distance in (to_truth, to_result))
    total = precision + completeness
    return {"accuracy_90": float(np.percentile(to_truth, 90)),
            "completeness": completeness,
            "chamfer": float(to_truth.mean() + to_result.mean()),
            "hausdorff": float(max(to_truth.max(), to_result.max())),
            "f_score": 2 * precision * completeness / total if total else 0.0,
            "rms": float(np.sqrt(np.mean(to_truth ** 2)))}


def point_measures(cloud: PointCloud, truth: TriangleMesh, *, samples: int = 100_000, tolerance: float = 0.0,
                   seed: int = 0) -> Measures:
    """Compare measured points with the truth, as they are: no registration hides an error of the calibration.

    Parameters
    ----------
    cloud : PointCloud
    truth : TriangleMesh
    samples, tolerance, seed
        As in `surface_measures`; of more points than ``samples``, so many are drawn at random.

    Returns
    -------
    dict
        ``count`` of the points; ``accuracy_90``, ``median``, ``rms`` of their distances from the truth; ``completeness``, the share of
        the truth within the tolerance of a point, and of all of it: also of what no view saw.

    Raises
    ------
    ScanstageError
        The truth has no surface.
    """
    if not truth.area() > 0:
        raise ScanstageError("truth: the mesh has no faces with an area; give a mesh with a surface")
    if not len(cloud):
        return {"count": 0, "accuracy_90": None, "median": None, "rms": None, "completeness": 0.0}
    tolerance = tolerance or TOLERANCE_SHARE * float(np.linalg.norm(np.ptp(truth.bounds(), axis=0)))
    chosen = np.arange(len(cloud))
    if len(cloud) > samples:
        chosen = np.random.default_rng(seed).choice(len(cloud), samples, replace=False)
    distance = SurfaceIndex(truth, nodes=samples).distances(cloud.positions[chosen]).distance
    to_points = nearest_distances(sample_surface(truth, samples, seed=seed), cloud.positions)
    return {"count": len(cloud), "accuracy_90": float(np.percentile(distance, 90)), "median": float(np.median(distance)),
            "rms": float(np.sqrt(np.mean(distance ** 2))), "completeness": float((to_points <= tolerance).mean())}


def evaluate(volume: SparseVolume | None, surface: Surface | TriangleMesh, truth: TriangleMesh, *, points: PointCloud | None = None,
             samples: int = 100_000, tolerance: float = 0.0, progress: Progress = silent) -> dict[str, Measures]:
    """Return all measures of a result: ``volume`` and ``points`` (where it has them) and ``surface``.

    Parameters
    ----------
    volume : SparseVolume, optional
        None for a method that finds points only.
    surface : Surface or TriangleMesh
        The result's surface.
    truth : TriangleMesh
    points : PointCloud, optional
        The result's, where it has some.
    samples, tolerance
        As in `surface_measures`.
    progress : Progress

    Raises
    ------
    ScanstageError
        As `volume_measures` and `surface_measures` do.
    """
    if isinstance(surface, Surface):
        surface = TriangleMesh.from_quads(surface.vertices, surface.quads)
    report = {}
    if volume is not None:
        report["volume"] = volume_measures(volume, truth, progress=part_of(progress, 0.0, 0.5))
    report["surface"] = surface_measures(surface, truth, samples=samples, tolerance=tolerance,
                                         progress=part_of(progress, 0.5, 0.9))
    if points is not None:
        report["points"] = point_measures(points, truth, samples=samples, tolerance=tolerance)
    progress(1.0, "Compared with the truth")
    return report
