# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull: the largest shape with the given silhouettes (Laurentini, 1994), as voxels.

Each silhouette, carried back through its camera, is a cone that holds the object; the hull is what all cones share
(Martin & Aggarwal, 1983). With the conservative rule no voxel of the true object is ever removed, provided that the
silhouettes cover it. Concavities that no line of sight misses stay filled: that is the hull's limit, not an error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...errors import ScanstageError
from ...options import Option
from ...progress import Progress, part_of, silent
from ..geometry import VoxelGrid
from ..outcome import Outcome
from ..scan import Scan, View
from ..undistortion import undistorted_view
from .bounds import Silhouette, bounds_from_silhouettes, spread_order
from .octree import Counts, carve, extent_of
from .silhouette_test import RULES, SilhouetteTest
from .volume import SparseVolume

OPTIONS = (
    Option("rule", "conservative", "When a voxel is removed", choices=RULES),
    Option("tolerance", 0, "How many views may see a voxel outside their silhouettes before it is removed: raise it when "
                           "some masks or poses are wrong", minimum=0, maximum=16),
    Option("outside", "unknown", "What lies beyond a picture's border", choices={
        "unknown": "nothing is known there, so nothing is removed",
        "empty": "background, so that a part of the object that leaves a picture is removed"}),
)

SURELY_SAMPLED = 1.42  # px; a voxel this wide holds a pixel's centre, so no sampled silhouette can miss it
_LARGEST_SKEW = 0.01  # of the focal length; real sensors have none
_LARGEST_ASPECT = 0.05  # deviation of fy / fx from the views' common one


def silhouettes_of(views: Sequence[View], *, rule: str, outside: str) -> list[Silhouette]:
    """Return each view's silhouette as a pinhole camera sees it.

    Raises
    ------
    ScanstageError
        There are no views, or one has no mask.
    """
    if not views:
        raise ScanstageError("the capture has no views: a visual hull needs at least one")
    silhouettes = []
    for view in views:
        if view.mask is None:
            raise ScanstageError(f"frame {view.name} has no silhouette: choose how to take it with --set silhouette=...")
        mask, known, camera = undistorted_view(view.mask, view.camera, conservative=rule == "conservative", outside=outside)
        silhouettes.append(Silhouette(camera, mask, known))
    return silhouettes


def working_bounds(scan: Scan, *, rule: str, tolerance: int, outside: str) -> np.ndarray:
    """Return the (2, 3) working volume: the capture's own, or one found from the silhouettes."""
    if scan.bounds is not None:
        return np.asarray(scan.bounds, dtype=np.float64)
    silhouettes = silhouettes_of(scan.views, rule=rule, outside=outside)
    order = spread_order([silhouette.camera for silhouette in silhouettes])
    return bounds_from_silhouettes([silhouettes[i] for i in order], tolerance=tolerance, unknown_outside=outside == "unknown")


def carve_silhouettes(silhouettes: Sequence[Silhouette], grid: VoxelGrid, *, rule: str, tolerance: int, outside: str,
                      progress: Progress = silent) -> tuple[SparseVolume, Counts]:
    """Carve a grid by silhouettes in the order given. See `visual_hull` for the options and `octree.carve` for what is returned."""
    tests = silhouette_tests(silhouettes, grid, rule=rule, outside=outside, progress=part_of(progress, 0.0, 0.2))
    return carve(tests, grid, tolerance=tolerance, progress=part_of(progress, 0.2, 1.0))


def silhouette_tests(silhouettes: Sequence[Silhouette], grid: VoxelGrid, *, rule: str, outside: str,
                     progress: Progress = silent) -> list[SilhouetteTest]:
    """Return what asks each silhouette about the cells of a grid."""
    tests = []
    for step, silhouette in enumerate(silhouettes):
        tests.append(SilhouetteTest(silhouette.camera, silhouette.inside, grid, extent_of(grid), rule=rule,
                                    unknown_outside=outside == "unknown"))
        progress(step / len(silhouettes), "Reading silhouettes")
    return tests


def visual_hull(scan: Scan, grid: VoxelGrid, *, rule: str = "conservative", tolerance: int = 0, outside: str = "unknown",
                carver: Callable[..., tuple[SparseVolume, Counts]] = carve_silhouettes, progress: Progress = silent) -> Outcome:
    """Carve the visual hull of a scan.

    Parameters
    ----------
    scan : Scan
        Every view with a mask. Cameras may have distortion, lie inside the volume or look away from parts of it.
    grid : VoxelGrid
    rule : {'conservative', 'center'}
    tolerance : int
        How many views may disagree with a voxel before it is removed.
    outside : {'unknown', 'empty'}
        What lies beyond a picture's border.
    carver : callable
        Does what `carve_silhouettes` does, elsewhere.

    Returns
    -------
    Outcome
        Its report counts ``tests`` and ``tests_dense`` (voxels times views).

    Raises
    ------
    ScanstageError
        There are no views, a view has no mask, or nothing is left.
    """
    silhouettes = silhouettes_of(scan.views, rule=rule, outside=outside)
    order = spread_order([silhouette.camera for silhouette in silhouettes])
    volume, counts = carver([silhouettes[index] for index in order], grid, rule=rule, tolerance=tolerance, outside=outside,
                            progress=progress)
    names = [scan.views[index].name for index in order]
    _refuse_empty(volume, counts, names)
    dense = grid.count * len(order)
    return Outcome(volume, {"counts": {"tests": counts.tests, "tests_dense": dense},
                            "warnings": capture_warnings(scan) + (_undersampled(scan, grid) if rule == "conservative" else [])})


def _refuse_empty(volume: SparseVolume, counts: Counts, names: Sequence[str]) -> None:
    if len(volume.bricks) or (volume.brick_map != -1).any():
        return
    culprits = [name for name, left in zip(names, counts.alone, strict=True) if left == 0]
    if culprits:
        raise ScanstageError(f"the visual hull is empty: the view of frame {culprits[0]} alone empties the working volume; "
                             "check its mask and pose, or the bounds")
    raise ScanstageError("the visual hull is empty: the views contradict each other; check masks and poses, give other "
                         "bounds, or let some views disagree with --set tolerance=1")


def capture_warnings(scan: Scan) -> list[str]:
    """Return what a user should know about the captures, one sentence each."""
    cameras = {view.name: view.camera for view in scan.views}
    found = []
    mirrored = [name for name, camera in cameras.items() if camera.mirrored]
    if mirrored:
        found.append(f"the calibration is mirrored in {len(mirrored)} of {len(cameras)} views (first: {mirrored[0]}): "
                     "the result is the mirror image of the object")
    aspects = {name: camera.K[1, 1] / camera.K[0, 0] for name, camera in cameras.items()}
    common = float(np.median(list(aspects.values())))
    skewed = [name for name, camera in cameras.items()
              if abs(camera.K[0, 1]) > _LARGEST_SKEW * camera.K[0, 0] or abs(aspects[name] - common) > _LARGEST_ASPECT * common]
    if skewed:
        found.append(f"the calibration is not metric in {len(skewed)} of {len(cameras)} views (first: {skewed[0]}; skewed or "
                     "unequal pixels): shape and size of the result may be distorted")
    cut = [view.name for view in scan.views if _touches_border(view.mask)]
    if cut:
        found.append(f"the object leaves the picture in {len(cut)} of {len(cameras)} views (first: {cut[0]}): nothing is "
                     "removed beyond the border")
    return found


def _undersampled(scan: Scan, grid: VoxelGrid) -> list[str]:
    """Return a warning if the pictures are too coarse for the voxels: the limit of what the conservative rule can promise."""
    middle = (grid.origin + grid.upper) / 2
    pixels = {}
    for view in scan.views:
        depth = view.camera.project(middle)[1]
        if depth > 0:
            pixels[view.name] = min(view.camera.K[0, 0], view.camera.K[1, 1]) * grid.voxel_size / float(depth)
    if not pixels or min(pixels.values()) >= SURELY_SAMPLED:
        return []
    worst = min(pixels, key=pixels.get)
    return [f"a voxel spans {pixels[worst]:.1f} pixels in frame {worst}: parts of the object thinner than {SURELY_SAMPLED} pixels may "
            "be lost; use fewer voxels or larger pictures if there are any"]


def _touches_border(mask: np.ndarray) -> bool:
    return bool(mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
