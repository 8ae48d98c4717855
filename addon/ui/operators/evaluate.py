# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The button that compares a result with the truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import bpy

from ... import workflow
from ...results import folder as results
from ...results.present import face_errors, show_comparison
from ..jobs import Job, idle, in_thread
from ..viewport import show_colors
from .requirements import has_result, result_folder


class SCANSTAGE_OT_evaluate(Job, bpy.types.Operator):
    """Compare the result with the true object, and lay truth, result and error side by side"""

    bl_idname = "scanstage.evaluate"
    bl_label = "Evaluate"
    bl_options = {'REGISTER', 'UNDO'}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return has_result(cls, context) and idle(cls, context)

    def steps(self, context: bpy.types.Context) -> Iterator[tuple[float, str]]:
        scene, settings = context.scene, context.scene.scanstage
        folder = result_folder(context.scene)
        measures = yield from in_thread(workflow.evaluate_result, folder)
        found, truth, errors = yield from in_thread(_compare, folder)
        show_comparison(scene, found, truth, errors)
        settings.measures = json.dumps(measures)

    def show(self, context: bpy.types.Context) -> None:
        show_colors(context)


def _compare(folder: Path, progress):
    """Return what `show_comparison` takes, computed away from Blender."""
    found = results.read_result(folder)
    truth = workflow.truth_of(found)
    progress(0.97, "Measuring the error of every face")
    return found, truth, face_errors(found, truth)


CLASSES = (SCANSTAGE_OT_evaluate,)
