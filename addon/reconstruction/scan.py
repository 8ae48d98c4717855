# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What every method is given: the captured views, in the object frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .geometry import Camera, Light


@dataclass(frozen=True)
class LitPicture:
    """A picture of a view's own camera and pose, lit by one light alone.

    Parameters
    ----------
    name : str
        The frame's id, for reports.
    light_id : str
        The light's id in the capture set.
    light : Light
        In the object frame.
    read_image : callable
        As `View.read_image`.
    """

    name: str
    light_id: str
    light: Light
    read_image: Callable[[], np.ndarray]


@dataclass(frozen=True)
class ProjectedPicture:
    """A picture of a view's own camera and pose, taken while a pattern was projected.

    Parameters
    ----------
    name : str
        The frame's id, for reports.
    pattern : mapping
        The pattern's fields (see `active.patterns`), but that a ``plane`` is in the object frame.
    projector_id : str, optional
        The projector's id in the capture set.
    projector : Camera, optional
        In the object frame. None where the pattern itself says where its light is, as a laser's does.
    read_image : callable
        As `View.read_image`.
    """

    name: str
    pattern: Mapping[str, object]
    projector_id: str | None
    projector: Camera | None
    read_image: Callable[[], np.ndarray]


@dataclass(frozen=True)
class View:
    """One captured picture, and those that differ from it by their light or by what is projected only.

    Parameters
    ----------
    name : str
        The frame's id, for reports.
    camera : Camera
        In the object frame.
    mask : (height, width) bool array, optional
        The silhouette: True where the object may be.
    read_image : callable
        Returns the picture as (height, width, 3) float32, linear RGB. Called when a method needs it, one view at a
        time, so that a scan's pictures never lie in memory together.
    lit : tuple of LitPicture
        The same camera and pose under single lights of an array.
    projected : tuple of ProjectedPicture
        The same camera and pose under projected patterns. Where every frame has one, the view's own picture is that under
        white, or else the first, and there is no mask.
    """

    name: str
    camera: Camera
    mask: np.ndarray | None
    read_image: Callable[[], np.ndarray]
    lit: tuple[LitPicture, ...] = ()
    projected: tuple[ProjectedPicture, ...] = ()


@dataclass(frozen=True)
class Scan:
    """All views of one capture.

    Parameters
    ----------
    views : tuple of View
    bounds : (2, 3) array, optional
        Lower and upper corner of the working volume in the object frame, where the capture gives one.
    """

    views: tuple[View, ...]
    bounds: np.ndarray | None = None
