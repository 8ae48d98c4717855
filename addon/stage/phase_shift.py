# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of phase shifting: a projector beside the camera shows moving sinusoids (method: `phase-shift`)."""

from __future__ import annotations

from collections.abc import Mapping

import bpy

from ..options import Value
from . import scanner
from .objects import Subject

OPTIONS = scanner.projector_rig_options("phase-shift")


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline: see `scanner.build_projector_rig`."""
    scanner.build_projector_rig(scene, stage, subject, options, "phase-shift")
