# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the shadows of an array of lights take off the visual hull, and why a deep pit must be looked into from above."""

import numpy as np
from shadow_figures import LECTURE_VOXELS, LIGHTS, PIT_LIGHTS, PIT_VIEWS, PIT_VOXELS, VIEWS, lecture_rows, pit_depths, pit_rows
from tables import Table

from addon.reconstruction.evaluation import inside

from . import drawing
from .concavities import CONCAVITIES, section
from .experiment import Experiment

COUNTS, LAMPS = (8, 24, 72), (1, 4, 8)
DRAWN = "25", "60"  # degrees
_COLORS = {0: (drawing.GREY, "s"), 1: (drawing.HULL, "o"), 4: (drawing.BLUE, "^"), 8: (drawing.GREEN, "D")}


def run(out, progress):
    found = dict(lecture_rows(out / "captures", progress, [(views, lights) for views in COUNTS for lights in LAMPS]))
    pits = dict(pit_rows(out / "captures", progress))
    figure, axes = drawing.panels(1200, 460, 1, 1 + len(DRAWN), width_ratios=(1.25, *[1] * len(DRAWN)))
    draw_growth(axes[0], found)
    for panel, elevation in zip(axes[1:], DRAWN, strict=True):
        draw_pit(panel, elevation, *pits[elevation])
    drawing.key(figure, truth=drawing.TRUTH, left_by_shadows=drawing.HULL, carved_by_shadows=drawing.PALE_HULL)
    drawing.save(figure, out, EXPERIMENT.name)
    return tabulate(found, pits)


def tabulate(found, pits):
    rows = [("dented-sphere, 25", views, lights, row.hull_excess, row.excess, row.ratio, row.removed, None, None)
            for (views, lights), row in found.items()]
    for elevations, (truth, row) in pits.items():
        _, shown, opened = pit_depths(truth, row)
        rows.append((f"pot, {elevations}", PIT_VIEWS * len(elevations.split(",")), PIT_LIGHTS, row.hull_excess, row.excess, row.ratio,
                     row.removed, shown, opened))
    note = (f"{LECTURE_VOXELS} voxels, the pot {PIT_VOXELS}; views and lights of the dented sphere are taken "
            f"out of {VIEWS} x {LIGHTS}. Excess is a share of the "
            "truth's volume, and conservative volumes have some even where they are perfect. A pit's depth is below its mouth, on the "
            "axis: a camera that looks less steeply than from the pit's floor to its rim sees no floor, and no shadow on it.")
    return Table(("object, camera's elevation in degrees", "views", "lights", "hull excess", "carved excess", "ratio",
                  "truth voxels removed", "pit open in the hull, mm", "pit open after carving, mm"), tuple(rows), note)


def draw_growth(panel, found):
    """Draw the excess against the number of views: of the hull, and for each number of lights."""
    for lights in (0, *LAMPS):
        rows = [found[views, lights or LAMPS[0]] for views in COUNTS]
        color, marker = _COLORS[lights]
        panel.plot(COUNTS, [row.excess if lights else row.hull_excess for row in rows], color=color, marker=marker,
                   label=f"{lights} light{'s' * (lights > 1)}" if lights else "visual hull")
    panel.set_xscale("log")
    drawing.plain_numbers(panel.xaxis, COUNTS)
    panel.set(xlabel="views", ylabel="excess volume, share of the truth", ylim=(0, None), title="dented sphere")
    panel.legend()


def draw_pit(panel, elevation, truth, row):
    """Draw the section through the pot: the truth, what shadows took and what they left."""
    pit = next(concavity for concavity in CONCAVITIES if concavity.label == "pit")
    (true, extent), (hull, _), (left, _) = (section(pit, volume) for volume in (inside(truth, row.hull.grid), row.hull, row.volume))
    drawing.show(panel, np.where(true, 3, np.where(left, 2, hull.astype(int))),
                 ("white", drawing.PALE_HULL, drawing.HULL, drawing.TRUTH), extent)
    panel.set(xlabel="across, mm", ylabel="height, mm", title=f"pot, cameras at {elevation} degrees")


EXPERIMENT = Experiment("shadow-carving", "What shadows take off the visual hull, against views and lights, and of a deep pit.", run)
