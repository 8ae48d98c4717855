# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job, end to end: what a user does in the five panels, in one go."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy

from ..captures.contact_sheet import write_contact_sheet
from ..captures.store import read_capture
from ..options import Option, Value, resolve
from ..progress import Progress, part_of
from ..render.capture import capture_frames
from ..results.blend import frame_scene, new_file, save_blend
from ..results.comparison import render_comparison
from ..results.folder import check_replaceable, read_result
from ..results.present import face_errors, show_comparison, show_result
from ..stage.staging import build
from ..workflow import evaluate_result, reconstruct, truth_of
from .progress_bar import drain
from .text import measure_lines, reconstruction_lines

OPTIONS = (
    Option("object", "dented-sphere", "A built-in object or a mesh file"),
    Option("voxels", 160, "Along the longest side of the working volume", minimum=8, maximum=2048),
    Option("views", 24, "Poses of the turntable", minimum=3, maximum=360),
)


def run_demo(out: Path, settings: Mapping[str, Value], progress: Progress) -> dict:
    """Stage, capture, reconstruct, evaluate; leave the .blend, the capture set, the result and the pictures in ``out``.

    Run again into the same folder, it keeps the frames that are there.

    Returns
    -------
    dict
        ``result`` (as in ``result.json``), ``evaluation``, and ``lines`` for the terminal.
    """
    options = resolve(OPTIONS, settings, "demo")
    capture, result = out / "capture", out / "result"
    check_replaceable(result)
    new_file()
    scene = bpy.context.scene
    progress(0.0, "Building the stage")
    build(scene, "turntable", options["object"], {"views": options["views"]})
    drain(capture_frames(scene, capture), part_of(progress, 0.02, 0.5))
    write_contact_sheet(capture, read_capture(capture), out / "contact_sheet.png")
    report = reconstruct(capture, "visual-hull", result, voxels=options["voxels"], progress=part_of(progress, 0.5, 0.7))
    measures = evaluate_result(result, progress=part_of(progress, 0.7, 0.78))
    progress(0.78, "Measuring the error of every face")
    found = read_result(result)
    truth = truth_of(found)
    show_result(scene, found)
    show_comparison(scene, found, truth, face_errors(found, truth))
    progress(0.85, "Taking the picture")
    render_comparison(out / "preview.png")
    frame_scene(bpy.context.scene)
    save_blend(out / "scanstage.blend")
    progress(1.0, "Done")
    return {"result": report, "evaluation": measures, "lines": [
        *reconstruction_lines(result, report), *measure_lines(measures), "",
        f"open     {out / 'scanstage.blend'}", f"look at  {out / 'preview.png'} and {out / 'contact_sheet.png'}"]}
