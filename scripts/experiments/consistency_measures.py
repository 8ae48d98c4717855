# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The measures of photo-consistency side by side: what they promise, how well they judge, and what carving makes of them."""

import numpy as np
from color_figures import OFF, area_under_curve, measure_scores
from tables import Table

from . import drawing
from .colored import OBJECT, SMALL, VIEWS, captured, outcome
from .experiment import Experiment

METHOD, VOXELS = "generalized-voxel-coloring", 64


def compare(scan, truth, progress, voxels=VOXELS):
    """Return for each measure, by name, the measure, its area under the curve and its outcome."""
    found = {}
    for measure, good, bad in measure_scores(scan, truth, voxels):
        made = outcome(scan, truth, METHOD, {"consistency": measure.name}, progress, voxels)
        found[measure.name] = measure, area_under_curve(good, bad), made
    return found


def tabulate(found):
    rows = [(name, measure.monotone.value, measure.threshold, area, made.lost, made.excess,
             sum(made.found.report["seconds"].values())) for name, (measure, area, made) in found.items()]
    note = (f"{METHOD} of the {OBJECT} in its matte texture, {VIEWS} cameras above it, {SMALL['resolution_x']} x {SMALL['resolution_y']} "
            f"pixels, {VOXELS} voxels, each measure at its own threshold. The area under the curve is the chance that a voxel {OFF} "
            "voxels off the surface scores worse than one of the surface. Lost is the share of the truth's surface voxels that are gone, "
            "excess is a share of its volume. Seconds are those of the whole reconstruction.")
    return Table(("measure", "monotone", "threshold", "area under the curve", "surface lost", "excess", "seconds"), tuple(rows), note)


def run(out, progress):
    table = tabulate(compare(*captured(out, "matte", progress), progress))
    figure, axes = drawing.panels(1000, 400, 1, 3, sharey=True)
    places = np.arange(len(table.rows))
    for panel, title, color in zip(axes, ("area under the curve", "surface lost", "excess"), (drawing.GREEN, drawing.BLUE, drawing.HULL),
                                   strict=True):
        panel.barh(places, table.column(title), color=color)
        panel.set(title=title)
    axes[0].set_yticks(places, table.column("measure"))
    axes[0].set_xlim(0.5, 1.0)
    axes[0].invert_yaxis()
    drawing.save(figure, out, EXPERIMENT.name)
    return table


EXPERIMENT = Experiment("consistency-measures",
                        "The measures of photo-consistency: monotone or not, how well they judge, and what they carve.", run)
