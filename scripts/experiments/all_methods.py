# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The lecture in one page: every method, each with its own rig, on the same object with a texture and without.

The object has three dents, which no silhouette shows. What is compared is what a user gets: the whole path from the rig's
frames to the result folder, and the result's distance from the truth.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from tables import Table
from turntable_captures import without_texture

from addon import workflow
from addon.captures.store import is_capture, read_capture
from addon.errors import ScanstageError
from addon.reconstruction.methods import METHODS

from . import drawing
from .experiment import Experiment
from .stage import MM

OBJECT, VOXELS = "dented-sphere", 96
SURFACES = ("textured", "plain")
SMALL = {"resolution_x": 400, "resolution_y": 300}
RIGS = {
    "turntable": {**SMALL, "views": 24},
    "shadow-array": {**SMALL, "views": 24, "lights": 4, "elevations": "25"},
    "voxel-coloring": {**SMALL, "views": 24},
    "stereo-pair": {**SMALL, "views": 12},
    "gray-code": {**SMALL, "views": 5, "axes": "columns"},
    "phase-shift": {**SMALL, "views": 5},
    "laser-scanner": {**SMALL, "views": 4, "lines": 50},
    "color-stripes": {"views": 5},
    "depth-sensor": {**SMALL, "views": 8},
    "desk-shadow": {**SMALL, "steps": 40},
}
RIG_OF = {"visual-hull": "turntable", "polyhedral-hull": "turntable", "shadow-carving": "shadow-array", "stereo": "stereo-pair",
          "speckle": "depth-sensor", "laser-stripe": "laser-scanner",
          **dict.fromkeys(("voxel-coloring", "space-carving", "generalized-voxel-coloring", "probabilistic-carving", "space-sweep"),
                          "voxel-coloring")}
_ACROSS, _SIDE = 5, 240


@dataclass(frozen=True)
class Row:
    """What one method gives; None where it gives nothing.

    Parameters
    ----------
    frames : int
        Of its capture.
    seconds : float or None
        Of the reconstruction.
    measures : dict
        See `workflow.evaluate_result`; empty where the method failed.
    preview : (h, w, 3) uint8 array or None
    said : str
        The error, or the first warning.
    """

    frames: int
    seconds: float | None
    measures: dict
    preview: np.ndarray | None
    said: str


def rig_of(method):
    """Return the rig that a method is given its frames by."""
    return RIG_OF.get(method, method)


def run(out, progress):
    found = {(surface, method): measured(out, surface, method, progress) for surface in SURFACES for method in METHODS}
    draw(out, found)
    rows = []
    for (surface, method), row in found.items():
        volume, shape = row.measures.get("volume", {}), row.measures.get("points") or row.measures.get("surface", {})
        within = shape.get("accuracy_90")
        rows.append((surface, method, rig_of(method), row.frames, row.seconds, None if within is None else MM * within,
                     shape.get("completeness"), volume.get("excess"), volume.get("loss"), row.said))
    return Table(("surface", "method", "rig", "frames", "seconds", "90 % of it within, mm", "completeness", "excess", "loss",
                  "what the report says first"), tuple(rows),
                 f"The {OBJECT}, 200 mm large, {VOXELS} voxels along its longest side. Accuracy and completeness are those of the points "
                 "where a method measures points, otherwise of the surface; a shell of points has nearly no volume, so its loss means "
                 "nothing. The desk lamp sees the object from one side only.")


def measured(out, surface, method, progress):
    """Capture what is not captured yet, reconstruct and compare."""
    capture = captured(out, surface, rig_of(method), progress)
    frames, result = len(read_capture(capture, require_pictures=False).frames), out / "results" / f"{surface}-{method}"
    try:
        report = workflow.reconstruct(capture, method, result, voxels=VOXELS, progress=progress)
    except ScanstageError as error:
        return Row(frames, None, {}, None, str(error))
    measures = workflow.evaluate_result(result)
    preview = cv2.imread(str(result / "preview.png"))
    return Row(frames, sum(report["seconds"].values()), measures, preview, next(iter(report["warnings"]), ""))


def captured(out, surface, rig, progress):
    """Return the capture set of the object on a rig, which is rendered unless it is there."""
    import bpy

    from addon.cli.progress_bar import drain, muted_stdout
    from addon.render.capture import capture_frames
    from addon.results.blend import new_file
    from addon.stage.staging import build

    folder = out / "captures" / f"all-{surface}-{rig}"
    if not (is_capture(folder) and not read_capture(folder, require_pictures=False).missing):
        with muted_stdout():
            new_file()
            build(bpy.context.scene, rig, OBJECT, RIGS[rig])
            if surface == "plain":
                without_texture(bpy.context.scene)
            drain(capture_frames(bpy.context.scene, folder), progress)
    return folder


def draw(out, found):
    """Draw all previews of each surface, method by method."""
    down = -(-len(METHODS) // _ACROSS)
    figure, axes = drawing.panels(_ACROSS * _SIDE, len(SURFACES) * down * (_SIDE - 20), len(SURFACES) * down, _ACROSS)
    for panel in axes.ravel():
        drawing.bare(panel)
    for number, surface in enumerate(SURFACES):
        for place, method in enumerate(METHODS):
            panel, row = axes[number * down + place // _ACROSS, place % _ACROSS], found[surface, method]
            panel.set_title(f"{method}\n{surface}, {row.frames} frames", fontsize=9)
            if row.preview is None:
                panel.text(0.5, 0.5, "nothing", ha="center", va="center", transform=panel.transAxes, color=drawing.GREY)
            else:
                panel.imshow(cv2.cvtColor(row.preview, cv2.COLOR_BGR2RGB))
    drawing.save(figure, out, EXPERIMENT.name)


EXPERIMENT = Experiment("all-methods", "The lecture in one page: every method with its own rig, with a texture and without.", run)
