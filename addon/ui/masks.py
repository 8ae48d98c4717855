# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes in the viewport: each camera shows the masks of its frames as its background image, in step with the timeline."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..captures.scan import MASKS
from ..captures.store import read_capture
from ..errors import ScanstageError
from ..stage.ownership import require_stage

_ALPHA = 0.6


def show_masks(scene: bpy.types.Scene, capture: Path) -> int:
    """Put the masks of a capture set behind the cameras of the scene's stage.

    Returns
    -------
    int
        The number of cameras that show masks.

    Raises
    ------
    ScanstageError
        The scene has no stage, or there are no masks.
    """
    cameras = [member for member in require_stage(scene).all_objects if member.type == 'CAMERA']
    first = capture / MASKS / f"{read_capture(capture).frames[0].id}.png"
    if not first.is_file():
        raise ScanstageError(f"{first}: there is no mask; extract the silhouettes again")
    image = bpy.data.images.load(str(first), check_existing=True)
    image.source, image.name = 'SEQUENCE', "Silhouettes"
    image.reload()
    for camera in cameras:
        data = camera.data
        shown = next((b for b in data.background_images if b.image == image), None) or data.background_images.new()
        shown.image, shown.alpha, shown.display_depth = image, _ALPHA, 'FRONT'
        shown.image_user.frame_start, shown.image_user.frame_duration = scene.frame_start, scene.frame_end - scene.frame_start + 1
        data.show_background_images = True
    return len(cameras)
