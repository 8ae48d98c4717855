# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the projectors show at the present frame, where their frusta end: for the viewport to draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ..errors import ScanstageError
from .projection import picture_places
from .projector import is_projector, rays_through
from .readback import projector_of
from .sketch import object_place, reach_of

_CELLS = 12  # along each side: the picture is bent where the lens distorts


@dataclass(frozen=True)
class Projected:
    """A projector's picture in the world.

    Parameters
    ----------
    image : bpy.types.Image
    corners : (n, 3, 3) array
        Triangles.
    places : (n, 3, 2) array
        Where their corners are in the image, from 0 at its left and its foot to 1.
    """

    image: bpy.types.Image
    corners: np.ndarray
    places: np.ndarray


def projected_pictures(scene: bpy.types.Scene) -> Iterator[Projected]:
    """Yield the picture of each projector that shows one at the present frame.

    Raises
    ------
    ScanstageError
        The scene has no stage.
    """
    middle = object_place(scene)[0]
    steps = np.linspace(0, 1, _CELLS + 1)
    share = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    first = (np.arange(_CELLS)[:, None] * (_CELLS + 1) + np.arange(_CELLS)).ravel()
    triangles = first[:, None, None] + np.array([[0, 1, _CELLS + 2], [0, _CELLS + 2, _CELLS + 1]])
    triangles = triangles.reshape(-1, 3)
    for light in sorted((o for o in scene.objects if is_projector(o) and not o.hide_render), key=lambda o: o.name):
        try:
            shown, optics = picture_places(light.data, share), projector_of(scene, light)
        except ScanstageError:
            continue  # what cannot be described has no picture; capturing says why
        if shown is not None:
            image, places = shown
            corners = optics.centre + reach_of(optics, middle) * rays_through(optics, share * optics.size - 0.5)
            yield Projected(image, corners[triangles], places[triangles])
