# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of the live hull, for scripts/figures.py: how long the viewport's hull takes to follow a camera."""

import time

from tables import print_head, print_line

OBJECTS = ("figure", "pot", "knot")
VIEWS = 24
TARGETS = {64: 200, 128: None}  # voxels along the longest side, and at most so many milliseconds of two cores
TIMES = 9


def live_hull(bar):
    """Print the medians of the time from a moved camera to the new hull's surface; return how many targets are missed."""
    import bpy
    import numpy as np

    from addon.reconstruction.planning.outlines import Outliner
    from addon.reconstruction.planning.preview_hull import preview_grid, preview_hull
    from addon.reconstruction.volumetric.surface import extract_surface
    from addon.stage import readback, staging, survey

    scene, missed = bpy.context.scene, 0
    print_head("object", "triangles", "views", "voxels", "CPU ms", "wall ms", "target, wall ms")
    for name in OBJECTS:
        staging.build(scene, "turntable", name, {"views": VIEWS})
        plan, mesh = readback.plan_of(scene), survey.workable(survey.viewport_mesh(scene))
        outliner = Outliner(mesh)
        for voxels, target in TARGETS.items():
            grid, spent = preview_grid(mesh, voxels), []
            for _ in range(TIMES):
                bar(len(spent) / TIMES, name)
                scene.camera.location.z += 0.002
                bpy.context.view_layer.update()
                processor, wall = time.process_time(), time.perf_counter()
                shots = survey.shots_of(scene, survey.with_present_devices(scene, plan))
                extract_surface(preview_hull(outliner, [shot.camera for shot in shots], grid))
                spent.append((time.process_time() - processor, time.perf_counter() - wall))
            bar.close()
            processor, wall = 1000 * np.median(spent, axis=0)
            missed += target is not None and wall > target
            print_line(name, len(mesh.triangles), len(shots), voxels, f"{processor:.0f}", f"{wall:.0f}", target)
    return missed


TABLES = {"live-hull": live_hull}
