# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of colour stripes: a projector beside the camera shows one picture of stripes at each pose (method: `color-stripes`)."""

from __future__ import annotations

from collections.abc import Mapping

import bpy

from ..options import Value
from . import scanner
from .objects import Subject

OPTIONS = scanner.projector_rig_options("color-stripes")


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline: see `scanner.build_projector_rig`."""
    scanner.build_projector_rig(scene, stage, subject, options, "color-stripes")
