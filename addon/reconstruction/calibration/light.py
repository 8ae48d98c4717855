# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a lamp stands, from the shadows of pencils (Bouguet & Perona, "3D photography on your desk", 1998)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera
from .laser import on_plane

LEAST_PENCILS = 2
WORST_CONDITION = 1000.0  # of the normal equations: there the lines meet at about 4 degrees
_STEPS, _CONVERGED = 50, 1e-10


@dataclass(frozen=True)
class LightPosition:
    """A point light found from shadows, in the frame of the plane that they fall on.

    Parameters
    ----------
    position : (3,) array
    rms : float
        Of the shadows' tips, predicted from the position, in pixels.
    condition : float
        Of the lines' normal equations; large where they are nearly parallel.
    warnings : tuple of str
    """

    position: np.ndarray
    rms: float
    condition: float
    warnings: tuple[str, ...]


def light_from_pencils(camera: Camera, bases, shadow_tips, height: float) -> LightPosition:
    """Find a point light from pencils of one height that stand on the plane ``z = 0`` (where the board lay).

    The light lies on the line from a shadow's tip through the pencil's. First the point nearest to all these lines; then the
    one whose shadows lie nearest, in the picture, to those that were marked.

    Parameters
    ----------
    camera : Camera
        In the plane's frame.
    bases, shadow_tips : (n, 2) arrays
        Pixels: where each pencil stands, and where its tip's shadow ends.
    height : float
        Of the pencils, in the scene's unit. They stand on the side of the plane from which the camera looks.

    Raises
    ------
    ScanstageError
        There are fewer than two pencils, a mark does not lie on the plane, or the lines do not meet in a point.
    """
    bases, shadow_tips = np.asarray(bases, float).reshape(-1, 2), np.asarray(shadow_tips, float).reshape(-1, 2)
    if len(bases) != len(shadow_tips) or len(bases) < LEAST_PENCILS:
        raise ScanstageError(f"the light: {len(bases)} pencils and {len(shadow_tips)} shadows are marked; mark as many of each, at "
                             f"least {LEAST_PENCILS}, better 4 or more")
    tips = on_plane(camera, bases) + (0, 0, np.copysign(height, camera.centre[2]))
    shadows = on_plane(camera, shadow_tips)
    position, condition = intersect_lines(shadows, tips - shadows)
    if not condition < 1e12 or (position[2] - tips[:, 2]).max() * np.sign(tips[0, 2]) <= 0:
        raise ScanstageError("the light: the lines from the shadows' tips through the pencils' meet in no point above them; stand the "
                             "pencils further apart and check the marks and the height")
    position, rms = _refined(camera, position, tips, shadow_tips)
    warnings = []
    if condition > WORST_CONDITION:
        warnings.append(f"the lines from shadows to pencils are nearly parallel (condition {condition:.0f}), so the light's distance is "
                        "uncertain; stand the pencils further apart, or use taller ones")
    return LightPosition(position, rms, condition, tuple(warnings))


def intersect_lines(points, directions) -> tuple[np.ndarray, float]:
    """Return the point nearest to lines, ``[sum(I - v v^T)]^-1 sum(I - v v^T) p``, and that matrix's condition number.

    Parameters
    ----------
    points, directions : (n, 3) arrays
        One point of each line and its direction, of any length.
    """
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - directions[:, :, None] * directions[:, None]
    matrix = across.sum(axis=0)
    return np.linalg.lstsq(matrix, (across @ points[..., None]).sum(axis=0)[:, 0], rcond=None)[0], float(np.linalg.cond(matrix))


def _refined(camera: Camera, position: np.ndarray, tips: np.ndarray, shadow_tips: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the position whose shadows lie nearest to the marked pixels (Gauss & Newton), and their RMS."""
    def errors(light: np.ndarray) -> np.ndarray:
        shadows = light + (tips - light) * (light[2] / (light[2] - tips[:, 2]))[:, None]
        return (shadow_tips - camera.project(shadows)[0]).ravel()

    error = errors(position)
    for _ in range(_STEPS):
        small = 1e-6 * np.linalg.norm(position)
        slopes = np.column_stack([(errors(position + axis) - errors(position - axis)) / (2 * small) for axis in small * np.eye(3)])
        moved = position - np.linalg.lstsq(slopes, error, rcond=None)[0]
        after = errors(moved)
        if not after @ after < error @ error:
            break
        done = np.linalg.norm(moved - position) < _CONVERGED * np.linalg.norm(position)
        position, error = moved, after
        if done:
            break
    return position, float(np.sqrt((error.reshape(-1, 2) ** 2).sum(axis=1).mean()))
