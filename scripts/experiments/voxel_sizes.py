# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""24 poses of an object of 20 cm, carved with voxels of 2 mm and of 1 mm."""

import tracemalloc

import numpy as np
from tables import Table
from turntable_captures import thinned

from addon.reconstruction import methods
from addon.reconstruction.evaluation import inside
from addon.reconstruction.preview import render_preview
from addon.reconstruction.volumetric.surface import extract_surface

from . import drawing
from .experiment import Experiment
from .stage import MEASURES, MM, captured, errors

OBJECT, VIEWS = "monkey", 24
SIZES = (2, 1)  # mm
MEGABYTE = 1e6


def whole_millimetres(bounds, step):
    """Return (2, 3) bounds moved outward to multiples of ``step`` mm, and how many steps the longest side has."""
    low, high = np.floor(bounds[0] * MM / step).astype(int), np.ceil(bounds[1] * MM / step).astype(int)
    return np.stack((low, high)) * step / MM, int((high - low).max())


def measure(scan, truth, sizes, progress):
    """Return the table, and the `methods.Reconstruction` of each size."""
    options = {"rule": "conservative", "tolerance": 0, "outside": "unknown"}
    bounds, steps = whole_millimetres(methods.find_method("visual-hull").bounds(scan, **options), max(sizes))
    rows, found = [], {}
    for size in sizes:
        call = {"voxels": steps * max(sizes) // size, "bounds": bounds}
        found[size] = result = methods.reconstruct(scan, "visual-hull", progress=progress, **call)
        error = errors(result, truth)
        seconds = result.report["seconds"]
        rows.append((size, " x ".join(map(str, result.report["grid"]["shape"])), *(error[key] for key in MEASURES), seconds["carve"],
                     sum(seconds.values()), peak(lambda call=call: methods.reconstruct(scan, "visual-hull", **call))))
    titles = "voxel, mm", "grid", *MEASURES.values(), "seconds to carve", "seconds in all", "peak memory, MB"
    note = (f"{len(scan.views)} poses, conservative rule. The excess is the hull's own and that of voxels kept whole; smaller voxels have "
            "less of the second. Memory is what the arrays of a reconstruction take at most, without the masks, which were there before.")
    return Table(titles, tuple(rows), note), found


def peak(work):
    """Return how many megabytes of new arrays a piece of work holds at most."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / MEGABYTE
    finally:
        tracemalloc.stop()


def run(out, progress):
    scan, truth = captured(out, OBJECT, progress)
    table, found = measure(thinned(scan, VIEWS), truth, SIZES, progress)
    fine = found[min(SIZES)].volume.grid
    figure, axes = drawing.panels(900, 290, 1, len(SIZES) + 1)
    truth_surface = extract_surface(inside(truth, fine))
    pictures = {f"truth, in {min(SIZES)} mm voxels": render_preview(truth_surface, fine, size=(600, 500))}
    for (size, result), excess in zip(found.items(), table.column("excess"), strict=True):
        pictures[f"hull, {size} mm: excess {100 * excess:.0f} %"] = render_preview(result.surface, result.volume.grid, size=(600, 500))
    for panel, (title, picture) in zip(axes, pictures.items(), strict=True):
        panel.imshow(picture)
        panel.set_title(title)
        drawing.bare(panel)
    drawing.save(figure, out, EXPERIMENT.name)
    return table


EXPERIMENT = Experiment("voxel-sizes", f"{VIEWS} poses of an object of 20 cm, carved with voxels of 2 mm and of 1 mm.", run)
