# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""One look for all pictures: colours that colour-blind readers tell apart (Okabe & Ito, 2008), few lines, small files."""

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from PIL import Image

TRUTH, HULL, BLUE, GREEN, PINK, GREY = "#333333", "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#999999"
PALE_HULL = "#F8DCA3"
_DPI = 100

matplotlib.rcParams.update({
    "font.size": 11, "axes.titlesize": 12, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#E4E4E4", "axes.axisbelow": True, "legend.frameon": False, "lines.linewidth": 1.8})


def panels(width, height, rows=1, columns=1, **options):
    """Return a figure of ``width`` x ``height`` pixels and its axes, as an array where there are several."""
    figure = Figure((width / _DPI, height / _DPI), dpi=_DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def bare(axes):
    """Take away an axes' frame, ticks and grid: for pictures that need no scale."""
    axes.set_axis_off()


def plain_numbers(axis, ticks):
    """Label a logarithmic axis at these numbers and nowhere else."""
    axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_ticks([], minor=True)


def show(axes, codes, colors, extent):
    """Draw an array of whole numbers, or bools: 0 in the first colour, 1 in the second. The first row is the lowest.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    codes : (h, w) array
    colors : sequence of str
    extent : (x0, x1, y0, y1)
        Of the array in the axes' unit.
    """
    axes.imshow(codes, cmap=ListedColormap(colors), vmin=0, vmax=len(colors) - 1, extent=extent, origin="lower",
                interpolation="auto", interpolation_stage="rgba")
    axes.grid(False)


def key(figure, **colors):
    """Put a legend of colours below all axes; an underscore in a name stands for a space."""
    figure.legend(handles=[Patch(color=color, label=name.replace("_", " ")) for name, color in colors.items()],
                  loc="outside lower center", ncols=len(colors))


def save(figure, out, name):
    """Write the picture of an experiment, in 256 colours."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    picture.quantize(256, dither=Image.Dither.NONE).save(out / f"{name}.png", optimize=True)
