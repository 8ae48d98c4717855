# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a reconstruction is from the truth, independently of how it was made.

Nothing in here is shared with the code under judgement: the truth is voxelised and distances are measured from its
triangles alone.
"""

from .distances import SurfaceIndex, sample_surface, vertex_distances
from .explained import EXPLAINED, Kind
from .measures import OPTIONS, evaluate, point_measures, surface_measures, volume_measures
from .overlap import touched
from .voxelization import inside, wholly_inside

__all__ = ["EXPLAINED", "OPTIONS", "Kind", "SurfaceIndex", "evaluate", "inside", "point_measures", "sample_surface", "surface_measures",
           "touched", "vertex_distances", "volume_measures", "wholly_inside"]
