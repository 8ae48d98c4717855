# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull as it grows: one shape for 1, 2, 4, 8 ... views, shown one after another along the timeline."""

from __future__ import annotations

import bpy
import numpy as np

from ..reconstruction.mesh import TriangleMesh
from ..reconstruction.planning.outlines import Outliner
from ..reconstruction.planning.preview_hull import growing_hulls, preview_grid
from ..reconstruction.volumetric.surface import extract_surface
from ..stage.readback import frame_kept, plan_of, rigid_motion, truth_mesh, turntable_of
from ..stage.survey import shots_of, workable
from ..stage.timeline import keyframe_steps
from .materials import OWNER
from .objects import add_voxel_mesh, remove_result
from .present import results_collection

GROWING = "scanstage_growing"
_GAP = 0.6  # between the object and the hulls beside it, in widths of the object


def show_growing_hulls(scene: bpy.types.Scene, *, voxels: int) -> list[bpy.types.Object]:
    """Put the hulls of the first 1, 2, 4, ... views of the plan beside the object, each visible in its part of the timeline.

    They are carved from the object's true silhouettes: nothing is rendered. Earlier ones are replaced.

    Parameters
    ----------
    scene : bpy.types.Scene
        With a stage.
    voxels : int
        Along the longest side.

    Returns
    -------
    list of bpy.types.Object
        In the collection of results.

    Raises
    ------
    ScanstageError
        The scene has no stage, or its plan cannot be read, or no view has the object before it.
    """
    mesh = workable(TriangleMesh(*truth_mesh(scene)))
    cameras = [shot.camera for shot in shots_of(scene, plan_of(scene))]
    hulls = list(growing_hulls(Outliner(mesh), cameras, preview_grid(mesh, voxels)))
    with frame_kept(scene):
        scene.frame_set(scene.frame_start)
        frame = rigid_motion(turntable_of(scene))
    frame[:3, 3] += [(1 + _GAP) * float(np.ptp(mesh.bounds()[:, 0])) * 1.2, 0, 0]
    home = results_collection(scene)
    for earlier in [member.name for member in home.objects if GROWING in member and member.get(OWNER) == "result"]:
        remove_result(earlier)
    shown = []
    for number, (count, volume) in enumerate(hulls):
        made = add_voxel_mesh(f"Hull of {count} View{'s' if count > 1 else ''}", extract_surface(volume), None, collection=home,
                              grid=volume.grid, frame=frame, method="visual-hull", attributes={}, replace=False)
        made[GROWING] = count
        _show_in_part(made, scene, number, len(hulls))
        shown.append(made)
    scene.frame_set(scene.frame_current)
    return shown


def _show_in_part(shown: bpy.types.Object, scene: bpy.types.Scene, number: int, count: int) -> None:
    """Let an object be visible in one of ``count`` equal parts of the timeline; the last stays to the end."""
    length = max(scene.frame_end - scene.frame_start + 1, count)
    first, last = (round(length * part / count) for part in (number, number + 1))
    hidden = np.ones(length + 1)
    hidden[first:last if number + 1 < count else None] = 0
    for path in ("hide_viewport", "hide_render"):
        keyframe_steps(shown, path, hidden.tolist(), start=scene.frame_start)
