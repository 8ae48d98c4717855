# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The live threshold of a result whose voxels have probabilities: what its slider does while it is dragged."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import bpy

from ..errors import ScanstageError
from ..results.folder import REPORT, Result, read_result
from ..results.present import FOLDER, show_above, shown_probabilities
from ..results.probability import has_probabilities, threshold_of


def show_again(settings: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """Show the result with the threshold and the colours that the panel says: the update of both properties."""
    shown = shown_probabilities(settings.id_data)
    if shown is None:
        return
    try:
        report = Path(shown[FOLDER]) / REPORT
        result = _read(report.parent, report.stat().st_mtime_ns)
    except (ScanstageError, OSError):
        return  # the result is gone from the disk: what is shown stays
    if has_probabilities(result):
        show_above(shown, result, settings.least_probability, ramp=settings.probability_colors)


def start_at_threshold(settings: bpy.types.PropertyGroup, result: Result) -> None:
    """Put the slider where the result was made."""
    if has_probabilities(result):
        settings.least_probability = threshold_of(result)


@lru_cache(maxsize=1)
def _read(folder: Path, changed: int) -> Result:
    """Return the result in a folder; once, as long as it is not ``changed``."""
    return read_result(folder)
