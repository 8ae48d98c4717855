# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene settings that make a picture a measurement, as one table of paths and values.

Staging writes them into the scene, so that Blender's own animation render makes the captures; rendering applies them
again for its duration. A snapshot of the same paths puts the scene back as it was.
"""

from collections.abc import Iterable, Mapping

import bpy

from .. import compat

# The order counts: a display device before its view transforms, a file format before its colour depth.
CAPTURE_SETTINGS: Mapping[str, object] = {
    "render.engine": "CYCLES",
    "cycles.use_adaptive_sampling": False,
    "cycles.use_denoising": False,
    "cycles.glossy_bounces": 0,
    "cycles.transmission_bounces": 0,
    "cycles.volume_bounces": 0,
    "cycles.sample_clamp_direct": 0.0,
    "cycles.light_sampling_threshold": 0.0,
    "cycles.use_light_tree": False,  # lights are sampled in turn: as many samples as lights see each of them once
    "cycles.film_exposure": 1.0,
    # The ray goes through the pixel's centre. A box filter ignores its width and always spans a whole pixel.
    "cycles.pixel_filter_type": "GAUSSIAN",
    "cycles.filter_width": 0.01,
    "cycles.time_limit": 0.0,
    "render.use_motion_blur": False,
    "render.use_compositing": False,
    "render.use_sequencer": False,
    "render.use_multiview": False,
    "render.use_freestyle": False,
    "render.use_simplify": False,
    "render.use_border": False,
    "render.use_crop_to_border": False,
    "render.use_stamp": False,
    # Not on the picture: in its file, where `fingerprint` lets it say of which plan it is.
    "render.use_stamp_note": True,
    "render.use_file_extension": True,
    "render.use_overwrite": True,
    "render.use_placeholder": False,
    "render.dither_intensity": 0.0,
    "render.image_settings.file_format": "PNG",
    "render.image_settings.color_mode": "RGBA",
    "render.image_settings.color_depth": "16",
    "render.image_settings.compression": 15,
    # The files alone are linear: what the user sees in the viewport keeps the scene's own view transform.
    "render.image_settings.color_management": "OVERRIDE",
    "render.image_settings.display_settings.display_device": "sRGB",
    "render.image_settings.view_settings.view_transform": "Raw",
    "render.image_settings.view_settings.look": "None",
    "render.image_settings.view_settings.exposure": 0.0,
    "render.image_settings.view_settings.gamma": 1.0,
    "render.image_settings.view_settings.use_curve_mapping": False,
    "render.image_settings.view_settings.use_white_balance": False,
}

# What a preset decides for its scene, besides the table above.
STAGE_SETTINGS = (
    "cycles.use_fast_gi",
    "cycles.fast_gi_method",
    "cycles.samples",
    # None for most: a diffuse bounce is noise at one sample and colours every silhouette's neighbourhood.
    "cycles.max_bounces",
    "cycles.diffuse_bounces",
    "render.film_transparent",
    "render.filepath",
    "render.stamp_note_text",
    "render.resolution_x",
    "render.resolution_y",
    "render.resolution_percentage",
    "render.pixel_aspect_x",
    "render.pixel_aspect_y",
    "render.use_persistent_data",
    "render.frame_map_old",
    "render.frame_map_new",
    "frame_start",
    "frame_end",
    "frame_step",
)

# Those of them that only some presets want otherwise: staging sets them before a preset does.
STAGE_DEFAULTS: Mapping[str, object] = {"cycles.use_fast_gi": False}

# With a world's ambient factor: light from all round, in closed form.
AMBIENT_LIGHT: Mapping[str, object] = {"cycles.use_fast_gi": True, "cycles.fast_gi_method": "ADD"}


def capture_settings(scene: bpy.types.Scene) -> dict[str, object]:
    """Return the capture settings of this version of Blender, by path from the scene."""
    return {**CAPTURE_SETTINGS, **compat.optional_settings(scene)}


def snapshot(scene: bpy.types.Scene, paths: Iterable[str]) -> dict[str, object]:
    """Return the present values (numbers, bools and text) of settings given by their paths from the scene."""
    return {path: getattr(*_resolve(scene, path)) for path in paths}


def apply(scene: bpy.types.Scene, values: Mapping[str, object]) -> None:
    """Set settings by their paths from the scene, in the order given."""
    for path, value in values.items():
        compat.set_value(*_resolve(scene, path), value)


def _resolve(scene: bpy.types.Scene, path: str) -> tuple[bpy.types.bpy_struct, str]:
    *owners, name = path.split(".")
    owner = scene
    for part in owners:
        owner = getattr(owner, part)
    return owner, name
