# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of a depth sensor: a projector of pseudo-random dots beside the camera (method: `speckle`)."""

from __future__ import annotations

import math
from collections.abc import Mapping

import bpy

from ..options import Value
from . import scanner
from .objects import Subject

OPTIONS = (*scanner.projector_rig_options("speckle", angle=math.radians(7), views=8), scanner.AMBIENT)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline: see `scanner.build_projector_rig`."""
    scanner.build_projector_rig(scene, stage, subject, options, "speckle")
