# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How many cells a quadtree looks at where a grid has 1,024: the lecture's 617, and what a strict quadtree counts."""

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.patches import Rectangle
from tables import Table

from . import drawing
from .experiment import Experiment

SIDE = 32
DISCS = (6, 9, 11, 13)  # radii, in cells
DISC_CENTRE = 16.2  # in both axes; the middle of the first cell is 0
LIMBS = (  # of a horse, in cells from the lower left corner: from (x, y) to (x, y), half thickness
    ((9, 17), (23, 18), 4.0), ((23, 17), (27, 22), 3.0), ((27, 22), (28, 19), 1.5), ((8, 19), (2, 23), 1.0),
    ((9, 17), (5, 3), 1.5), ((10, 17), (13, 3), 1.5), ((22, 17), (19, 2), 1.5), ((23, 17), (26, 2), 1.5))


def horse():
    """Return a (32, 32) bool figure with the lecture's counts: 13 of its 16 cells of 8 are mixed, and 34 of their 52 children."""
    points = np.stack(np.meshgrid(*[np.arange(SIDE) + 0.5] * 2), -1)
    found = np.zeros((SIDE, SIDE), bool)
    for start, stop, half in LIMBS:
        offset, along = points - start, np.subtract(stop, start)
        share = np.clip(offset @ along / (along @ along), 0, 1)
        found |= ((offset - share[..., None] * along) ** 2).sum(-1) <= half ** 2
    return found


def disc(radius):
    """Return a (32, 32) bool figure of a disc."""
    rows, columns = np.mgrid[:SIDE, :SIDE] - DISC_CENTRE
    return rows ** 2 + columns ** 2 <= radius ** 2


def tested_cells(figure, *, skip_last_level=False):
    """Return the cells that a quadtree tests, level by level.

    A cell that holds both figure and background is divided, and its children are tested, down to single cells of the grid.

    Parameters
    ----------
    figure : (n, n) bool array
        With n a power of two.
    skip_last_level : bool
        Divide cells of 4 at once into their 16 single cells, as the lecture's slide does, and leave out those of 2.

    Returns
    -------
    list of (int, (m, 2) array)
        The cells' edge, and the row and column of their lower corners; the root first.
    """
    edge, levels = len(figure), [(len(figure), np.zeros((1, 2), int))]
    while edge > 1:
        mixed = np.argwhere(_mixed(figure, edge)) * edge
        if not len(mixed):
            break
        step = 1 if skip_last_level and edge == 4 else edge // 2
        children = np.stack(np.meshgrid(*[np.arange(0, edge, step)] * 2, indexing="ij"), -1).reshape(-1, 2)
        edge = step
        levels.append((edge, (mixed[:, None] + children).reshape(-1, 2)))
    return levels


def _mixed(figure, edge):
    """Return which cells of ``edge`` are neither empty nor full. (The parent of such a cell is one, too.)"""
    side = len(figure) // edge
    blocks = figure.reshape(side, edge, side, edge)
    return blocks.any(axis=(1, 3)) & ~blocks.all(axis=(1, 3))


def count(figure, *, skip_last_level=False):
    """Return the number of tests at each level, the root first."""
    return [len(corners) for _, corners in tested_cells(figure, skip_last_level=skip_last_level)]


def tabulate():
    """Return the table of the figures."""
    cases = [("the slide's, cells of 2 left out", horse(), True), ("the slide's, strict quadtree", horse(), False),
             *((f"disc of radius {radius}", disc(radius), False) for radius in DISCS)]
    rows = []
    for name, figure, skip in cases:
        tests = count(figure, skip_last_level=skip)
        rows.append((name, " + ".join(map(str, tests)), sum(tests), sum(tests) / figure.size))
    note = ("The slide prints 4 + 16 + 52 + 16 x 34 = 617, but these terms add up to 616: the root is counted and not printed. Its last "
            "step goes from cells of 4 straight to single cells. A strict quadtree halves there, too, and is cheaper whenever fewer than "
            f"102 cells of 2 are mixed. The horse stands for the slide's figure: it has the same counts. The discs' middle is "
            f"({DISC_CENTRE}, {DISC_CENTRE}), where (0, 0) is that of the first cell. Without a tree there are {SIDE ** 2:,} tests a view.")
    return Table(("figure", "tests at each level", "tests", "tests / N²"), tuple(rows), note)


def run(out, progress):
    figure, axes = drawing.panels(900, 480, 1, 2)
    for panel, skip, name in zip(axes, (True, False), ("cells of 2 left out, as on the slide", "strict quadtree"), strict=True):
        draw(panel, horse(), skip)
        panel.set_title(f"{name}: {sum(count(horse(), skip_last_level=skip))} tests")
    drawing.save(figure, out, EXPERIMENT.name)
    progress(1.0, "counted")
    return tabulate()


def draw(panel, figure, skip):
    """Draw a figure under the cells that are tested."""
    for edge, corners in tested_cells(figure, skip_last_level=skip):
        cells = PatchCollection([Rectangle((column, row), edge, edge) for row, column in corners], facecolor="none",
                                edgecolor=drawing.BLUE, linewidth=0.5 if edge < 4 else 1.1)
        panel.add_collection(cells)
    drawing.show(panel, figure, ("white", drawing.PALE_HULL), (0, SIDE, 0, SIDE))
    panel.set(xticks=range(0, SIDE + 1, 8), yticks=range(0, SIDE + 1, 8), xlabel="x, cells", ylabel="y, cells")


EXPERIMENT = Experiment("octree-count", "How many cells a quadtree tests where a grid has 1,024: the lecture's 617.", run)
