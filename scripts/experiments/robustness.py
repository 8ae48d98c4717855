# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a wrong mask, a poor calibration and noise cost each volumetric method, and whether the report names the wrong view."""

from dataclasses import replace

import numpy as np
from tables import Table
from turntable_captures import rendered

from addon.errors import ScanstageError
from addon.reconstruction import methods
from addon.reconstruction.scan import Scan

from . import drawing
from .experiment import Experiment
from .stage import errors

OBJECT, VIEWS, VOXELS, SEED = "dented-sphere", 36, 64, 1
SMALL = {"resolution_x": 400, "resolution_y": 300}
RIGS = {"turntable": SMALL, "shadow-array": {**SMALL, "lights": 4, "elevations": "25"}, "voxel-coloring": SMALL}
RIG_OF = {"visual-hull": "turntable", "polyhedral-hull": "turntable", "shadow-carving": "shadow-array", "voxel-coloring": "voxel-coloring",
          "space-carving": "voxel-coloring", "generalized-voxel-coloring": "voxel-coloring", "probabilistic-carving": "voxel-coloring"}
WRONG = 7  # the number of the view whose mask is wrong
_MOVED = 0.15  # of the picture's width: how far that mask is moved
_PIXELS = 2.0  # standard deviation of each view's principal point
_SHARE = 0.01  # of the pixels that are salt or pepper
MEASURES = {"loss": "loss", "excess": "excess", "accuracy_90": "90 % within, mm"}
_COLORS = (drawing.TRUTH, drawing.HULL, drawing.BLUE, drawing.PINK)


def with_a_wrong_mask(view, number, random):
    """Return the view, but for one whose silhouette has moved aside."""
    if number != WRONG:
        return view
    return replace(view, mask=np.roll(view.mask, int(_MOVED * view.mask.shape[1]), axis=1), contours=None)


def with_a_poor_calibration(view, number, random):
    """Return a view whose picture lies some pixels off where its camera is thought to have it."""
    K = view.camera.K.copy()
    K[:2, 2] += random.normal(0, _PIXELS, 2)
    return replace(view, camera=replace(view.camera, K=K))


def with_salt_and_pepper(view, number, random):
    """Return a view some of whose pixels are all bright or all dark: in the mask, the picture and the shadows."""
    chosen, salt = random.random(view.mask.shape) < _SHARE, random.random(view.mask.shape) < 0.5
    shadows = view.shadows
    if shadows is not None:
        dark = random.integers(0, np.bitwise_or.reduce(shadows.bits, axis=None) + 1, view.mask.shape).astype(shadows.bits.dtype)
        shadows = replace(shadows, bits=np.where(chosen & shadows.decidable, dark, shadows.bits))

    def read_image():
        return np.where(chosen[..., None], salt[..., None].astype(np.float32), view.read_image())

    return replace(view, mask=np.where(chosen, salt, view.mask), shadows=shadows, read_image=read_image, contours=None)


FAULTS = {"none": lambda view, number, random: view, f"1 wrong mask of {VIEWS}": with_a_wrong_mask,
          f"calibration, {_PIXELS:g} px": with_a_poor_calibration, f"salt and pepper, {100 * _SHARE:g} %": with_salt_and_pepper}


def faulty(scan, fault):
    """Return a scan with one of `FAULTS`; the same every time."""
    random = np.random.default_rng(SEED)
    return Scan(tuple(FAULTS[fault](view, number, random) for number, view in enumerate(scan.views)), scan.bounds, scan.unused_lights)


def judged(scan, truth, method, fault, tolerance, bounds, progress):
    """Return a row of the table: what a method makes of a faulty scan, and which view its report names."""
    from addon.results.booleans import solver

    entry = methods.find_method(method)
    options = {} if tolerance is None else {"tolerance": tolerance}
    head = (method, fault, "-" if tolerance is None else tolerance)
    try:
        found = methods.reconstruct(faulty(scan, fault), method, voxels=VOXELS, bounds=bounds, options=options, progress=progress,
                                    solids=solver() if entry.cuts_solids else None)
    except ScanstageError as error:
        return (*head, *[None] * len(MEASURES), str(error))
    error = errors(found, truth)
    named = [warning for warning in found.report["warnings"] if "do not fit the others" in warning]
    wrong = scan.views[WRONG].name
    says = "" if not named else f"names {wrong}" if f"frame {wrong} (" in named[0] else named[0]
    return (*head, *(error[key] for key in MEASURES), says)


def tolerances(method):
    """Return what a method's option ``tolerance`` is set to: 0 and 1, or None where it has none."""
    return (0, 1) if any(option.name == "tolerance" for option in methods.find_method(method).options) else (None,)


def run(out, progress):
    rows, scans = [], {}
    for method, rig in RIG_OF.items():
        if rig not in scans:
            scans[rig] = rendered(OBJECT, out / "captures" / f"robustness-{rig}", progress, VIEWS, rig, RIGS[rig],
                                  {} if rig == "shadow-array" else None)
        scan, truth = scans[rig]
        lower, upper = truth.vertices.min(axis=0), truth.vertices.max(axis=0)
        bounds = np.stack((lower - 0.15 * (upper - lower), upper + 0.15 * (upper - lower)))
        rows += [judged(scan, truth, method, fault, tolerance, bounds, progress) for fault in FAULTS for tolerance in tolerances(method)]
    draw(out, rows)
    note = (f"The {OBJECT}, 200 mm large, {VIEWS} views of 400x300, {VOXELS} voxels, each method's own rig, one run of each row with "
            f"the seed {SEED}. Wrong mask: moved aside by {100 * _MOVED:.0f} % of the picture's width. Calibration: every view's principal "
            f"point is off by {_PIXELS:g} pixels (standard deviation) along x and y. Salt and pepper: {100 * _SHARE:g} % of the pixels, "
            "half of them bright, in masks, pictures and shadows.")
    return Table(("method", "fault", "tolerance", *MEASURES.values(), "what the report says of it"), tuple(rows), note)


def draw(out, rows):
    """Draw how far 90 % of each result's surface is from the truth, the better of the tolerances dotted."""
    figure, axes = drawing.panels(900, 420)
    for place, method in enumerate(RIG_OF):
        for number, (fault, color) in enumerate(zip(FAULTS, _COLORS, strict=True)):
            values = [row[5] for row in rows if row[:2] == (method, fault)]
            at = place + 0.2 * (number - 1.5)
            axes.bar(at, values[0] or 0, 0.18, color=color)
            if values[0] is None:
                axes.text(at, 0, "nothing", rotation=90, ha="center", va="bottom", fontsize=8)
            if len(values) > 1 and values[1] is not None:
                axes.plot([at - 0.09, at + 0.09], [values[1]] * 2, color=drawing.GREEN)
    axes.set_xticks(range(len(RIG_OF)), [name.replace("-", "\n") for name in RIG_OF], fontsize=9)
    axes.set_ylabel("90 % of the surface within, mm")
    drawing.key(figure, **dict(zip((fault.replace(" ", "_") for fault in FAULTS), _COLORS, strict=True)), with_tolerance_1=drawing.GREEN)
    drawing.save(figure, out, EXPERIMENT.name)


EXPERIMENT = Experiment("robustness", "What a wrong mask, a poor calibration and noise cost each volumetric method.", run)
