# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How high the threshold of photo-consistency is set: holes below, fat surfaces above."""

from tables import Table

from addon.reconstruction.volumetric.consistency import MEASURES

from . import drawing
from .colored import OBJECT, SMALL, VIEWS, captured, outcome, preview
from .experiment import Experiment

METHOD, MEASURE, VOXELS = "space-carving", "adaptive", 64
THRESHOLDS = (0.01, 0.015, 0.02, 0.03, 0.04, 0.08, 0.16, 0.32)
DRAWN = (0.02, 0.04, 0.32)


def sweep(scan, truth, progress, thresholds=THRESHOLDS, voxels=VOXELS):
    """Return the outcome at each threshold."""
    return {threshold: outcome(scan, truth, METHOD, {"consistency": MEASURE, "consistency_threshold": threshold}, progress, voxels)
            for threshold in thresholds}


def tabulate(made):
    rows = [(threshold, each.lost, each.excess, each.colored) for threshold, each in made.items()]
    note = (f"{METHOD} of the {OBJECT} in its matte texture, {VIEWS} cameras above it, {SMALL['resolution_x']} x {SMALL['resolution_y']} "
            f"pixels, {VOXELS} voxels, measure {MEASURE}, whose own threshold is {MEASURES[MEASURE].threshold:g}. Lost is the share of "
            "the truth's surface voxels that are gone, excess is a share of its volume.")
    return Table(("threshold", "surface lost", "excess", "coloured voxels"), tuple(rows), note)


def run(out, progress):
    made = sweep(*captured(out, "matte", progress), progress)
    figure, axes = drawing.panels(1200, 420, 1, 1 + len(DRAWN), width_ratios=(1.5, *[1] * len(DRAWN)))
    for attribute, label, color, marker in (("lost", "surface lost", drawing.BLUE, "o"), ("excess", "excess volume", drawing.HULL, "s")):
        axes[0].plot(THRESHOLDS, [getattr(each, attribute) for each in made.values()], color=color, marker=marker, label=label)
    axes[0].set_xscale("log")
    drawing.plain_numbers(axes[0].xaxis, THRESHOLDS)
    axes[0].tick_params(axis="x", labelrotation=45)
    axes[0].set(xlabel="threshold", ylabel="share of the truth", ylim=(0, None))
    axes[0].legend()
    for panel, threshold in zip(axes[1:], DRAWN, strict=True):
        preview(panel, made[threshold], f"threshold {threshold:g}")
    drawing.save(figure, out, EXPERIMENT.name)
    return tabulate(made)


EXPERIMENT = Experiment("threshold", "What space carving loses and what it leaves too much, against the threshold of consistency.", run)
