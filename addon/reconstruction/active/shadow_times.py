# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""When the edge of a passing shadow meets each pixel (Bouguet & Perona, "3D photography on your desk", 1998).

A pixel is in shadow while it is darker than the middle between its own brightest and darkest value: where half of the lamp is
hidden, whatever the surface reflects. The time at which it becomes so is found between two frames by a line. All is
done frame by frame: a few pictures lie in memory, not the sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from .correspondence import Reason

Frames = Callable[[], Iterable[np.ndarray]]


@dataclass(frozen=True)
class ShadowTimes:
    """When the shadow's leading edge came.

    Parameters
    ----------
    times : (h, w) float32 array
        In frames; NaN where it is not known.
    slopes : (h, w) float32 array
        How much darker a pixel became from the frame before to the frame after, as a share of white.
    reason : (h, w) uint8 array
        A `Reason`.
    """

    times: np.ndarray
    slopes: np.ndarray
    reason: np.ndarray


def shadow_times(frames: Frames, contrast: float) -> ShadowTimes:
    """Find when a shadow's leading edge passes each pixel.

    The edge is the last fall below the middle before a pixel is darkest: the stick itself, or another shadow, may pass
    a pixel at other times.

    Parameters
    ----------
    frames : callable
        Returns the sequence of (h, w) float32 grey pictures; called twice.
    contrast : float
        Least difference between a pixel's brightest and darkest value, as a share of white.
    """
    lightest = darkest = None
    for grey in frames():
        lightest = grey.copy() if lightest is None else np.maximum(lightest, grey)
        darkest = grey.copy() if darkest is None else np.minimum(darkest, grey)
    middle = (lightest + darkest) / 2
    times, slopes = (np.full(middle.shape, np.nan, np.float32) for _ in range(2))
    fell, fall, least, before = (np.full(middle.shape, value, np.float32) for value in (np.nan, np.nan, np.inf, np.nan))
    for number, grey in enumerate(frames()):
        above = grey - middle
        crossed = (before >= 0) & (above < 0)  # not so in the first frame, where nothing is known to be before
        drop = (before - above)[crossed]
        fell[crossed], fall[crossed] = number - 1 + before[crossed] / drop, drop
        darker = grey < least
        np.copyto(least, grey, where=darker)
        np.copyto(times, fell, where=darker)
        np.copyto(slopes, fall, where=darker)
        before = above
    enough = lightest - darkest >= contrast
    known = enough & np.isfinite(times)
    reason = np.where(known, np.uint8(Reason.VALID), np.where(enough, np.uint8(Reason.UNCERTAIN), np.uint8(Reason.UNLIT)))
    return ShadowTimes(np.where(known, times, np.float32(np.nan)), slopes, reason)
