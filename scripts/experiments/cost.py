# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What carving costs against the grid's size: every voxel in every view, and the octree."""

import time

import numpy as np
from tables import Table
from turntable_captures import thinned

from addon.reconstruction import methods
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.scan import Scan

from . import drawing
from .experiment import Experiment
from .stage import captured

OBJECT, VIEWS = "monkey", 24
SIZES = (32, 64, 128, 256, 512)
LARGEST_DENSE = 128  # timed; beyond, the time is known to grow with the tests
_LAYERS = 8  # of voxels that are tested at once, so that memory does not grow with N^3


def dense_hull(scan, grid):
    """Return the dense hull by testing every voxel's centre in every view: what the octree is compared with.

    Parameters
    ----------
    scan : Scan
        Views without distortion.
    grid : VoxelGrid
    """
    inside = np.ones(grid.shape, bool)
    for start in range(0, grid.shape[0], _LAYERS):
        slab = inside[start:start + _LAYERS]
        centres = grid.centres(np.moveaxis(np.indices(slab.shape), 0, -1) + (start, 0, 0))
        for view in scan.views:
            pixels, depth = view.camera.project(centres)
            column, row = np.floor(np.moveaxis(pixels, -1, 0) + 0.5).astype(int)
            width, height = view.camera.size
            seen = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (depth > 0)
            slab &= ~seen | view.mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return inside


def cube(bounds):
    """Return the (2, 3) smallest cube round a box, with the same middle: its grid has N^3 voxels."""
    middle, half = np.mean(bounds, axis=0), np.ptp(bounds, axis=0).max() / 2
    return np.stack((middle - half, middle + half))


def compare(scan, sizes, largest_dense, progress):
    """Return the table: a row for each grid size, by the centre rule."""
    bounds = cube(methods.find_method("visual-hull").bounds(scan, rule="center", tolerance=0, outside="unknown"))
    scan, rows = Scan(scan.views, bounds), []
    methods.reconstruct(scan, "visual-hull", voxels=min(sizes), options={"rule": "center"})  # the first call is slower
    for voxels in sizes:
        found = methods.reconstruct(scan, "visual-hull", voxels=voxels, options={"rule": "center"}, progress=progress)
        counts, seconds, differing = found.report["counts"], None, None
        if voxels <= largest_dense:
            start = time.perf_counter()
            dense = dense_hull(scan, VoxelGrid.from_bounds(*bounds, voxels))
            seconds, differing = time.perf_counter() - start, int((dense != found.volume.dense()).sum())
        rows.append((voxels, counts["tests_dense"], counts["tests"], counts["tests"] / counts["tests_dense"],
                     seconds, found.report["seconds"]["carve"], differing))
    titles = "N", "tests, dense", "tests, octree", "share", "seconds, dense", "seconds, octree", "voxels that differ"
    tests = [slope([row[0] for row in rows], [row[index] for row in rows]) for index in (1, 2)]
    note = (f"{len(scan.views)} views, centre rule. By a fit in log-log, the dense tests grow as N^{tests[0]:.2f} and the octree's as "
            f"N^{tests[1]:.2f}. That is less than the surface, N^2: the smaller a cell on the surface is, the fewer views graze it and "
            f"must be asked. The dense loop is plain numpy without early exit, timed up to {largest_dense} voxels a side; "
            "scripts/benchmark.py has a compiled one. The octree's seconds contain the views' preparation.")
    return Table(titles, tuple(rows), note)


def slope(sizes, costs):
    """Return the exponent p of the best costs ~ sizes^p, by least squares in logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def run(out, progress):
    table = compare(thinned(captured(out, OBJECT, progress)[0], VIEWS), SIZES, LARGEST_DENSE, progress)
    figure, (left, right) = drawing.panels(900, 420, 1, 2)
    for axes, quantity in ((left, "tests"), (right, "seconds")):
        for kind, color, marker in (("dense", drawing.HULL, "s"), ("octree", drawing.BLUE, "o")):
            pairs = [(n, cost) for n, cost in zip(table.column("N"), table.column(f"{quantity}, {kind}"), strict=True) if cost]
            n, cost = zip(*pairs, strict=True)
            growth = f": $\\sim N^{{{slope(n, cost):.1f}}}$" if quantity == "tests" else ""
            axes.loglog(n, cost, color=color, marker=marker, label=kind + growth)
        drawing.plain_numbers(axes.xaxis, SIZES)
        if quantity == "seconds":
            drawing.plain_numbers(axes.yaxis, (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10))
        axes.set(xlabel="N, voxels a side", title=f"{quantity.capitalize()} against N, {VIEWS} views", ylabel=quantity)
        axes.legend(loc="upper left")
    drawing.save(figure, out, EXPERIMENT.name)
    return table


EXPERIMENT = Experiment("cost", "What carving costs against N: every voxel in every view, and the octree.", run)
