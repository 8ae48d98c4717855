# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of experiments. A new one is one module and one line here."""

from . import (
    accuracy,
    all_methods,
    concavities,
    consistency_measures,
    cost,
    hull_2d,
    lambertian,
    octree_count,
    robustness,
    shadow_carving,
    threshold,
    uniqueness,
    voxel_sizes,
)

EXPERIMENTS = {module.EXPERIMENT.name: module.EXPERIMENT
               for module in (hull_2d, octree_count, cost, voxel_sizes, accuracy, concavities, shadow_carving, uniqueness, lambertian,
                              threshold, consistency_measures, robustness, all_methods)}
