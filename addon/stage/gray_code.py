# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of Gray code: a projector beside the camera numbers its columns and rows (method: `gray-code`)."""

from __future__ import annotations

from collections.abc import Mapping

import bpy

from ..options import Value
from ..reconstruction.active.patterns import PATTERN_SETS, make_patterns
from . import scanner
from .objects import Subject

_CODE = PATTERN_SETS["gray-code"].options
OPTIONS = (scanner.VIEWS, *_CODE, *scanner.PROJECTOR_OPTIONS, *scanner.COMMON)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline. ``options`` has a checked value for each of `OPTIONS`.

    Raises
    ------
    ScanstageError
        An option cannot be used, or the object cannot be staged.
    """
    size = options["projector_x"], options["projector_y"]
    patterns = make_patterns("gray-code", size, {option.name: options[option.name] for option in _CODE})
    scanner.build_projector_rig(scene, stage, subject, options, patterns)
