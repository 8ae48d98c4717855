# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What decoding gives: for each camera pixel the place in the projector that lights it, or the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

CONTRAST = 0.02
"""Of full scale: the least light from the projector by which a pixel is decoded."""
NOISE = 1 / 255
"""Of full scale: the standard deviation of pictures that do not tell theirs."""


class Reason(IntEnum):
    """Why a pixel has no correspondence; the values of a `Decoded.reason`."""

    VALID = 0
    UNLIT = 1  # too little light comes straight from the projector: shadow, black surface, background
    SATURATED = 2  # brighter than the camera can tell
    UNCERTAIN = 3  # a bit, period or peak cannot be told: indirect light, an edge, noise
    OUTSIDE = 4  # the code is none of the projector's
    APART = 5  # the rays of camera and projector do not meet
    BEHIND = 6  # they meet behind one of the two, or nearly nowhere


SENTENCES = {
    Reason.VALID: "decoded", Reason.UNLIT: "not lit by the projector", Reason.SATURATED: "too bright for the camera",
    Reason.UNCERTAIN: "code not certain", Reason.OUTSIDE: "code beyond the projector", Reason.APART: "rays do not meet",
    Reason.BEHIND: "behind camera or projector",
}


@dataclass(frozen=True)
class Decoded:
    """One coordinate in the projector for every camera pixel.

    Parameters
    ----------
    position : (height, width) float32 array
        Column or row in projector pixels, the first one's centre at 0; meaningless where ``reason`` is not 0.
    reason : (height, width) uint8 array
        A `Reason`.
    sigma : (height, width) float32 array or float
        Expected standard deviation of ``position``.
    """

    position: np.ndarray
    reason: np.ndarray
    sigma: np.ndarray | float

    @property
    def valid(self) -> np.ndarray:
        """(height, width) bool: where there is a position."""
        return self.reason == Reason.VALID


def full_scale(image: np.ndarray) -> float:
    """Return the largest value that a picture of this type can hold: 1 for floating point."""
    return float(np.iinfo(image.dtype).max) if image.dtype.kind == "u" else 1.0


def tally(reason: np.ndarray) -> dict[str, int]:
    """Return how many pixels there are of each `Reason`, by its name."""
    counts = np.bincount(reason.ravel(), minlength=len(Reason))
    return {kind.name.lower(): int(counts[kind]) for kind in Reason}
