# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How near the visual hull comes to the truth, against the number of views."""

from tables import Table
from turntable_captures import thinned

from addon.reconstruction import methods
from addon.reconstruction.scan import Scan

from . import drawing
from .experiment import Experiment
from .stage import MEASURES, captured, errors

OBJECTS = {"monkey": (drawing.BLUE, "o"), "dented-sphere": (drawing.HULL, "s")}
VIEWS = (4, 6, 8, 9, 12, 18, 24, 36, 72)
TICKS = tuple(count for count in VIEWS if count != 9)  # too near to 8 for a label of its own
VOXELS = 128


def follow(name, scan, truth, counts, voxels, progress):
    """Return the rows of one object: a hull for each number of views, all in the grid of the fewest, the largest."""
    options = {"rule": "conservative", "tolerance": 0, "outside": "unknown"}
    bounds = methods.find_method("visual-hull").bounds(thinned(scan, min(counts)), **options)
    rows = []
    for count in counts:
        part = Scan(thinned(scan, count).views, bounds)
        found = methods.reconstruct(part, "visual-hull", voxels=voxels, progress=progress)
        error = errors(found, truth)
        rows.append((name, count, *(error[key] for key in MEASURES)))
    return rows


def tabulate(rows, voxels):
    note = (f"{voxels} voxels along the longest side of a volume that is the same for all rows of an object; one ring at 20 degrees; "
            "conservative rule. What is left at last no more views of this ring take away: concavities, the cones above and below, and "
            "voxels kept whole.")
    return Table(("object", "views", *MEASURES.values()), tuple(rows), note)


def run(out, progress):
    rows = []
    for name in OBJECTS:
        rows += follow(name, *captured(out, name, progress), VIEWS, VOXELS, progress)
    table = tabulate(rows, VOXELS)
    figure, panels = drawing.panels(900, 400, 1, 2)
    for panel, title, label in ((panels[0], "excess", "excess volume, share of the truth"),
                                (panels[1], "chamfer, mm", "chamfer distance, mm")):
        for name, (color, marker) in OBJECTS.items():
            values = [row[table.titles.index(title)] for row in table.rows if row[0] == name]
            panel.plot(VIEWS, values, color=color, marker=marker, label=name)
        panel.set_xscale("log")
        drawing.plain_numbers(panel.xaxis, TICKS)
        panel.set(xlabel="views", ylabel=label, ylim=(0, None))
    panels[0].legend()
    drawing.save(figure, out, EXPERIMENT.name)
    return table


EXPERIMENT = Experiment("accuracy", "How near the visual hull comes to the truth, against the number of views.", run)
