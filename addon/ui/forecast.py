# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a button will cost, told before it is pressed."""

from __future__ import annotations

import bpy
import numpy as np

from ..memory import amount, available_memory
from ..reconstruction.forecast import Workload
from ..reconstruction.geometry import VoxelGrid
from ..reconstruction.methods import METHODS


def capture_cost(scene: bpy.types.Scene) -> str:
    """Return the frames of the plan, and the time they take once a frame has been rendered."""
    frames, each = scene.frame_end - scene.frame_start + 1, scene.scanstage.frame_seconds
    return f"{frames} frames: about {duration(frames * each)}" if each else f"{frames} frames: capture one to know the time"


def reconstruction_cost(settings: bpy.types.PropertyGroup) -> list[str]:
    """Return the voxels and the memory that a reconstruction takes at most; the second line starts with "! " if there is less."""
    shape = (settings.voxels,) * 3
    if settings.use_bounds:
        try:
            shape = VoxelGrid.from_bounds(np.array(settings.bounds_lower), np.array(settings.bounds_upper), settings.voxels).shape
        except ValueError as error:
            return [f"! {error}"]
    work = Workload.most(shape, settings.capture_frames, int(settings.capture_pixels))
    need, there = METHODS[settings.method].memory(work), available_memory()
    return [f"{' x '.join(map(str, shape))} voxels at most",
            f"{'! ' if need > there else ''}{amount(need)} of memory, {amount(there)} free"]


def duration(seconds: float) -> str:
    """Return a duration as a person says it."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 90 * 60 else f"{seconds / 3600:.1f} h"
