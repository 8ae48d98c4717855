# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks in the viewport: each camera shows silhouettes or shadows as its background image, in step with the timeline."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..captures.scan import MASKS, SHADOWS
from ..captures.store import read_capture
from ..errors import ScanstageError
from ..stage.ownership import require_stage
from ..stage.timeline import keyframe_steps

_ALPHA = 0.6


def show_masks(scene: bpy.types.Scene, capture: Path) -> int:
    """Put the silhouettes of a capture set behind the cameras of the scene's stage.

    Returns
    -------
    int
        The number of cameras that show them.

    Raises
    ------
    ScanstageError
        The scene has no stage, or there are no masks.
    """
    return _show(scene, capture, MASKS, "Silhouettes", "there is no mask; extract the silhouettes again")


def show_shadows(scene: bpy.types.Scene, capture: Path) -> int:
    """Put the shadows of a capture set behind the cameras of the scene's stage; see `show_masks`."""
    return _show(scene, capture, SHADOWS, "Shadows", "there is no mask; capture each pose under single lights, as the preset "
                 "shadow-array does")


def _show(scene: bpy.types.Scene, capture: Path, folder: str, name: str, remedy: str) -> int:
    cameras = [member.data for member in require_stage(scene).all_objects if member.type == 'CAMERA']
    masks = {frame.id: capture / folder / f"{frame.id}.png" for frame in read_capture(capture).frames}
    masks = {id: path for id, path in masks.items() if path.is_file()}
    if not masks:
        raise ScanstageError(f"{capture / folder}: {remedy}")
    image = bpy.data.images.load(str(next(iter(masks.values()))), check_existing=True)
    image.source, image.name = 'SEQUENCE', name
    image.reload()
    # Blender shows a missing file of a sequence in the colour of errors, and only pictures under a single light have shadows.
    visible = [float(f"{number:04d}" in masks) for number in range(scene.frame_start, scene.frame_end + 1)]
    for camera in dict.fromkeys(cameras):
        shown = next((b for b in camera.background_images if b.image == image), None) or camera.background_images.new()
        shown.image, shown.alpha, shown.display_depth = image, _ALPHA, 'FRONT'
        user = shown.image_user
        user.frame_start, user.frame_duration, user.frame_offset = scene.frame_start, len(visible), scene.frame_start - 1
        keyframe_steps(camera, f"{shown.path_from_id()}.show_background_image", visible, start=scene.frame_start)
        camera.show_background_images = True
    scene.frame_set(scene.frame_current)  # for the keys to act at once
    return len(cameras)
