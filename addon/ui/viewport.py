# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a button may do to the user's view: little, and only so that its result can be seen."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np
from mathutils import Matrix

from ..results.studio import BACK, RIGHT, UP
from ..stage.extents import corners_of
from ..stage.ownership import require_stage

_FULL = 72.0  # millimetres that a view's longer side spans at the distance of its focal length
_MARGIN = 0.92  # of what is free, that is filled


def frame_stage(context: bpy.types.Context) -> None:
    """Turn the view that was clicked in towards the whole stage."""
    if _can_turn(context):
        _frame(context, corners_of(require_stage(context.scene).all_objects))


def frame_shown(context: bpy.types.Context, shown: Iterable[bpy.types.Object], *, from_front: bool = False) -> None:
    """Bring objects into the view that was clicked in, unless they are there.

    Parameters
    ----------
    shown : iterable of bpy.types.Object
    from_front : bool
        Look the way in which a comparison is made to be looked at, in any case.
    """
    shown = list(shown)
    if not shown or not _can_turn(context):
        return
    context.view_layer.update()
    corners, view = corners_of(shown), context.space_data.region_3d
    if from_front:
        view.view_rotation = Matrix(np.stack((RIGHT, UP, BACK), axis=1).tolist()).to_quaternion()
    elif _is_seen(context, corners):
        return
    _frame(context, corners)


def show_colors(context: bpy.types.Context) -> None:
    """Show materials where the view that was clicked in shows solids: the colours of a result are in its material."""
    shading = getattr(context.space_data, "shading", None)
    if shading is not None and shading.type == 'SOLID':
        shading.type = 'MATERIAL'


def show_image(context: bpy.types.Context, image: bpy.types.Image) -> None:
    """Show an image in the Image Editors of the screen that was clicked in."""
    for area in context.screen.areas if context.screen else ():
        if area.type == 'IMAGE_EDITOR':
            area.spaces.active.image = image


def frustum_about(points: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Return the nearest eye (3,) that sees points, itself in the view's axes as they are: x right, y up, z towards the eye.

    Parameters
    ----------
    points : (n, 3) array
    tangents : (2, 2) array
        Of the angles at which the view ends: below 0 to the left, above to the right; the same downward and upward.
    """
    eye, ends = np.zeros(3), []
    for axis in (0, 1):
        low, high = tangents[axis]
        ends.append((-(points[:, axis] + low * points[:, 2]).min(), (points[:, axis] + high * points[:, 2]).max()))
    # A point is between the planes on both sides where low (eye_z - z) <= x - eye_x <= high (eye_z - z).
    eye[2] = max((below + above) / (high - low) for (below, above), (low, high) in zip(ends, tangents, strict=True))
    for axis, (below, above) in enumerate(ends):
        low, high = tangents[axis]
        eye[axis] = ((above - high * eye[2]) + (-below - low * eye[2])) / 2
    return eye


def _can_turn(context: bpy.types.Context) -> bool:
    return getattr(context.space_data, "region_3d", None) is not None and _window(context) is not None


def _window(context: bpy.types.Context) -> bpy.types.Region | None:
    return next((region for region in context.area.regions if region.type == 'WINDOW'), None) if context.area else None


def _free(context: bpy.types.Context) -> tuple[float, float, float, float]:
    """Return what no toolbar, sidebar or header covers of the view: left, right, lower and upper end, in its pixels."""
    window = _window(context)
    left, right, lower, upper = 0, window.width, 0, window.height
    for region in context.area.regions:
        x, y = region.x - window.x, region.y - window.y
        if region.type == 'TOOLS' and region.width > 1 and x < right / 2:
            left = max(left, x + region.width)
        elif region.type == 'UI' and region.width > 1 and x > left:
            right = min(right, x)
        elif region.type in ('HEADER', 'TOOL_HEADER') and region.height > 1 and y > upper / 2:
            upper = min(upper, y)
    return (left, right, lower, upper) if left < right and lower < upper else (0, window.width, 0, window.height)


def _tangents(context: bpy.types.Context) -> np.ndarray:
    """Return where the free part of a perspective view ends; see `frustum_about`."""
    window = _window(context)
    a_pixel = _FULL / context.space_data.lens / max(window.width, window.height)
    left, right, lower, upper = _free(context)
    ends = np.array([[left, right], [lower, upper]]) - [[window.width / 2], [window.height / 2]]
    middle = ends.mean(axis=1, keepdims=True)
    return (middle + _MARGIN * (ends - middle)) * a_pixel


def _frame(context: bpy.types.Context, corners: np.ndarray) -> None:
    view = context.space_data.region_3d
    axes = np.array(view.view_rotation.to_matrix())
    local = corners @ axes
    eye = frustum_about(local, _tangents(context))
    view.view_perspective = 'PERSP'
    distance = max(eye[2] - (local[:, 2].min() + local[:, 2].max()) / 2, 1e-6)
    view.view_location = axes @ (eye - [0, 0, distance])
    view.view_distance = distance


def _is_seen(context: bpy.types.Context, corners: np.ndarray) -> bool:
    """Return whether the view shows all of the points, and none of them under its sidebar."""
    view = context.space_data.region_3d
    if view.view_perspective != 'PERSP':
        return False
    axes = np.array(view.view_rotation.to_matrix())
    local = (corners - np.array(view.view_location)) @ axes - [0, 0, view.view_distance]
    tangents = _tangents(context)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = local[:, :2] / -local[:, 2:]
    return bool(((local[:, 2] < 0)[:, None] & (at >= tangents[:, 0]) & (at <= tangents[:, 1])).all())
