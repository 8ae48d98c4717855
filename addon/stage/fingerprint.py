# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan's fingerprint, which travels in the pictures.

Blender writes a scene's note into every file that it renders, on any machine and without the extension. The note of a staged
scene is the fingerprint of its plan and of the staged object, so that a picture from elsewhere can be told from one of another
plan: another pose, camera, light, pattern or shape. Materials and the strength of lights have no part in it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass

import bpy
import numpy as np

from .readback import CapturePlan, plan_of, truth_mesh

NOTE = "Note"
"""The keyword under which Blender writes a scene's note into a PNG file."""
_DECIMALS = 6  # of metres, pixels and matrix elements; the same file read twice differs by less


def stamp(scene: bpy.types.Scene) -> str:
    """Let the pictures of a scene carry the fingerprint of its plan as it is now, and return it.

    Raises
    ------
    ScanstageError
        The scene has no plan that can be captured.
    """
    plan = plan_of(scene)
    scene.render.stamp_note_text = fingerprint(plan, truth_mesh(scene) if plan.board is None else None)
    return scene.render.stamp_note_text


def fingerprint(plan: CapturePlan, truth: tuple[np.ndarray, np.ndarray] | None) -> str:
    """Return what tells a plan, and the object that it captures, from any other.

    Parameters
    ----------
    plan : CapturePlan
    truth : ((n, 3) float array, (m, 3) int array), optional
        As `readback.truth_mesh` returns it; None where only a calibration board is captured.
    """
    digest = hashlib.sha256()
    _add(digest, plan)
    _add(digest, truth)
    return f"scanstage plan {digest.hexdigest()[:32]}"


def _add(digest: hashlib._Hash, value: object) -> None:
    """Add a value to a digest: dataclasses, mappings and sequences by their parts, numbers rounded."""
    if is_dataclass(value):
        value = {entry.name: getattr(value, entry.name) for entry in fields(value)}
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        digest.update(str(value.shape).encode() + (np.round(value, _DECIMALS) + 0.0).tobytes())  # -0.0 is 0.0
    elif isinstance(value, np.ndarray):
        digest.update(str(value.shape).encode() + value.astype(np.int64).tobytes())
    elif isinstance(value, (int, np.integer)):
        digest.update(repr(int(value)).encode())
    elif isinstance(value, float):
        _add(digest, np.array(value))
    elif hasattr(value, "items"):
        for name, part in sorted(value.items()):
            digest.update(json.dumps(name).encode())
            _add(digest, part)
    elif isinstance(value, (tuple, list)):
        digest.update(f"[{len(value)}]".encode())
        for part in value:
            _add(digest, part)
    else:
        digest.update(repr(value).encode())
