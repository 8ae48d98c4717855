# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The coverage of a surface as colours, and the legend that explains them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..reconstruction.planning.coverage import Coverage
from ..results.materials import VIRIDIS

SHOWN = (
    ('NONE', "None", "The object's surface as it is"),
    ('VIEWS', "Views", "How many views see each place of the surface"),
    ('LIGHTS', "Lights", "How many lights, or places of one, shine on it"),
    ('PIXELS', "Projector Pixels", "How many of a projector's pixels fall on it, at the pose where they are most"),
    ('ERROR', "Depth Error", "What error of depth the rig's geometry lets one expect, as a standard deviation: by its projectors and "
     "lasers, or without them by matching each view with its nearest neighbour, if the surface has texture. Silhouettes measure none"),
)
NEVER = np.array([0.62, 0.09, 0.16])  # of what nothing reaches
_TITLES = {'VIEWS': "Views", 'LIGHTS': "Lights", 'PIXELS': "Projector pixels per square mm", 'ERROR': "Expected depth error"}
_NOTES = {True: "by triangulation with the light", False: "if textured: by matching neighbours"}
_STEPS = 6  # swatches of a legend
_ENDS = 5.0, 95.0  # percent of the triangles between which the ramp runs: the rest has its first or last colour
_LIGHT = np.array([0.35, -0.5, 0.79])  # from the front, above: the form is seen, however the view is turned
_SQUARE_MM = 1e-6


@dataclass(frozen=True)
class Legend:
    """What colours mean.

    Parameters
    ----------
    title : str
    entries : tuple of ((3,) array, str)
        A colour as screens show it, and what it stands for.
    note : str
        What is assumed.
    """

    title: str
    entries: tuple[tuple[np.ndarray, str], ...]
    note: str = ""


def colors_of(coverage: Coverage, shown: str, length: Callable[[float], str]) -> tuple[np.ndarray, Legend]:
    """Return the colour (n, 3) of every triangle, as screens show it, and their legend.

    Parameters
    ----------
    coverage : Coverage
    shown : str
        One of `SHOWN`, other than ``NONE``.
    length : callable
        Writes a length in the scene's unit.
    """
    if shown in ('VIEWS', 'LIGHTS'):
        return _of_counts(coverage.views if shown == 'VIEWS' else coverage.lights, _TITLES[shown])
    if shown == 'PIXELS':
        return _of_amounts(coverage.projector_pixels * _SQUARE_MM, coverage.projector_pixels > 0, _TITLES[shown], "none", "{:.3g}".format)
    colors, legend = _of_amounts(coverage.depth_error, np.isfinite(coverage.depth_error), _TITLES[shown], "no depth", length, turned=True)
    return colors, replace(legend, note=_NOTES[coverage.active])


def shaded(colors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return colours (n, 3) lit so that the form is seen, given normals (n, 3) of unit length."""
    return colors * (0.72 + 0.28 * (normals @ _LIGHT))[:, None]


def ramp(share: np.ndarray) -> np.ndarray:
    """Return the colours (..., 3) of viridis at shares from 0 to 1."""
    stops = np.array([[int(color.lstrip("#")[i:i + 2], 16) / 255 for i in (0, 2, 4)] for color in VIRIDIS])
    places = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(share, places, stops[:, channel]) for channel in range(3)], axis=-1)


def _of_counts(counts: np.ndarray, title: str) -> tuple[np.ndarray, Legend]:
    """Return the colours of whole numbers: each has its own while they are few, and 1 and 2 always have."""
    most = max(int(counts.max(initial=0)), 1)
    # The ramp by logarithm: from 1 to 2 views is more than from 21 to 22.
    share = np.log(np.maximum(counts, 1)) / max(np.log(most), 1e-9)
    steps = np.unique(np.rint(np.geomspace(1, most, min(_STEPS, most))).astype(int))
    colors = np.where((counts > 0)[:, None], ramp(share), NEVER)
    entries = [(NEVER, "0")] + [(ramp(np.log(step) / max(np.log(most), 1e-9)), str(step)) for step in steps]
    return colors, Legend(title, tuple(entries))


def _of_amounts(values: np.ndarray, there: np.ndarray, title: str, none: str, text: Callable[[float], str], *,
                turned: bool = False) -> tuple[np.ndarray, Legend]:
    """Return the colours of amounts; with ``turned`` the least, not the most, is the brightest: the best."""
    entries = [(NEVER, none)] if not there.all() else []
    if not there.any():
        return np.broadcast_to(NEVER, (len(values), 3)), Legend(title, tuple(entries))
    low, high = np.percentile(values[there], _ENDS)
    share = np.clip((np.where(there, values, low) - low) / max(high - low, 1e-12 * high), 0, 1)
    colors = np.where(there[:, None], ramp(1 - share if turned else share), NEVER)
    for step in np.linspace(0, 1, _STEPS):
        amount = text(low + step * (high - low)) + {0.0: " and less", 1.0: " and more"}.get(step, "")
        entries.append((ramp(1 - step if turned else step), amount))
    return colors, Legend(title, tuple(entries))
