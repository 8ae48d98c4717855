# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""``transforms.json``; see `importers.transforms` for its conventions."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np

from ..importers.colmap import HALF_PIXEL
from ..importers.transforms import AXES, FILE, LENS
from .views import ExportedView, refuse_unsayable


def transforms_files(views: Sequence[ExportedView]) -> dict[str, bytes]:
    """Return the file. Intrinsics that all frames share stand at its top, others in the frames."""
    frames = []
    for view in views:
        refuse_unsayable(view, "transforms.json")
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = view.camera.R.T @ AXES, view.camera.centre
        frames.append({"file_path": view.file, **({} if view.mask is None else {"mask_path": view.mask}),
                       "transform_matrix": motion.tolist(), **_lens(view)})
    shared = {name: value for name, value in _lens(views[0]).items() if all(frame[name] == value for frame in frames)}
    frames = [{name: value for name, value in frame.items() if name not in shared} for frame in frames]
    return {FILE: json.dumps({"camera_model": "OPENCV", **shared, "frames": frames}, indent=1).encode() + b"\n"}


def _lens(view: ExportedView) -> dict[str, float]:
    K, (width, height) = view.camera.K, view.camera.size
    return {"fl_x": float(K[0, 0]), "fl_y": float(K[1, 1]), "cx": float(K[0, 2]) + HALF_PIXEL, "cy": float(K[1, 2]) + HALF_PIXEL,
            "w": width, "h": height, **dict(zip(LENS, map(float, view.camera.distortion), strict=True))}
