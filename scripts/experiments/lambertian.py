# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One shape in a matte texture, in the same glazed, and in one matte colour: what carving by colour assumes of a surface."""

from tables import Table

from . import drawing
from .colored import OBJECT, SMALL, VIEWS, VOXELS, captured, outcome, preview
from .experiment import Experiment

MATERIALS = ("matte", "shiny", "textureless")
METHODS = ("voxel-coloring", "generalized-voxel-coloring")


def compare(scan, truth, progress, voxels=VOXELS):
    """Return the outcome of each method by name, and as visual-hull that of the volume in which they begin."""
    return {"visual-hull": outcome(scan, truth, "visual-hull", {"rule": "center"}, progress, voxels),
            **{method: outcome(scan, truth, method, {}, progress, voxels) for method in METHODS}}


def tabulate(made):
    rows = [(material, method, each.lost, each.excess, each.colored if method in METHODS else None)
            for material, found in made.items() for method, each in found.items()]
    note = (f"The {OBJECT}, {VIEWS} cameras above it, {SMALL['resolution_x']} x {SMALL['resolution_y']} pixels, {VOXELS} voxels, adaptive "
            "measure at its own threshold. Lost is the share of the truth's surface voxels that are gone, excess is a share of its volume.")
    return Table(("material", "method", "surface lost", "excess", "coloured voxels"), tuple(rows), note)


def run(out, progress):
    made = {material: compare(*captured(out, material, progress), progress) for material in MATERIALS}
    figure, axes = drawing.panels(1100, 700, len(METHODS), len(MATERIALS))
    for row, method in zip(axes, METHODS, strict=True):
        for panel, material in zip(row, MATERIALS, strict=True):
            preview(panel, made[material][method], f"{method}, {material}")
    drawing.save(figure, out, EXPERIMENT.name)
    return tabulate(made)


EXPERIMENT = Experiment("lambertian", "What carving by colour makes of a matte, a shiny and a textureless surface.", run)
