# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which pixels lie in the shadow of a light: found so that what is called shadow is shadow.

Dark paint looks like a shadow, but under every light. So a pixel is decided only where some picture of the view shows it
bright, and it is in a light's shadow where that light's picture is dark beside the brightest. Light that bounces or comes
from elsewhere brightens shadows: they are then missed, which costs a method that carves by shadows some of its power and
never a part of the object. What could darken a lit pixel is left out: pixels about a highlight, the rim of every shadow,
specks. A surface that the light grazes is lit by a small share only; the threshold is low for its sake.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..options import Option, Unit
from .arrays import grown

SHADOW_OPTIONS = (
    Option("shadow_ratio", 0.02, "How dark a pixel must be, beside its brightness under the brightest light, to lie in shadow: raise it "
           "where other light reaches the shadows", minimum=0.0, maximum=0.9),
    Option("lit_level", 0.04, "How bright some light must show a pixel, of full scale, for it to be decided: below, dark paint and "
           "shadow cannot be told apart", minimum=1e-4, maximum=1.0),
    Option("shadow_margin", 1, "By how much shadows are made narrower on every side", unit=Unit.PIXELS, minimum=0, maximum=100),
    Option("shadow_area", 20, "Shadows of fewer pixels are dropped as noise", minimum=1, maximum=1_000_000),
)
SATURATED = 0.995  # of full scale
_HIGHLIGHT_RIM = 3  # px round saturated pixels that are not decided either
MOST_LIGHTS = 32


@dataclass(frozen=True)
class ShadowMasks:
    """The shadows in one view.

    Parameters
    ----------
    bits : (height, width) array of unsigned integers
        Bit ``i`` is set where the pixel lies in the shadow of the view's light ``i``.
    decidable : (height, width) bool array
        Where a shadow would have been told from dark paint.
    """

    bits: np.ndarray
    decidable: np.ndarray

    def of(self, light: int) -> np.ndarray:
        """Return the (height, width) bool shadow of one light."""
        return (self.bits >> self.bits.dtype.type(light) & self.bits.dtype.type(1)).astype(bool)

    def reduced(self, step: int) -> ShadowMasks:
        """Return the masks in blocks of step x step pixels, a block being in shadow, or decidable, where all of it is.

        They fit the camera's `scaled` by ``1 / step``.
        """
        if step == 1:
            return self
        return ShadowMasks(_all_of_blocks(self.bits, step), _all_of_blocks(self.decidable, step))

    def picture(self, light: int) -> np.ndarray:
        """Return one light's shadow to be looked at, (height, width) uint8: white in shadow, black in the light, grey undecided."""
        return np.where(self.of(light), np.uint8(255), np.where(self.decidable, np.uint8(0), np.uint8(128)))


def detect_shadows(lit: Sequence[np.ndarray], reference: np.ndarray, *, shadow_ratio: float, lit_level: float, shadow_margin: int,
                   shadow_area: int) -> ShadowMasks:
    """Find the shadows of each light in the pictures of one view.

    Parameters
    ----------
    lit : sequence of (height, width, 3) float arrays
        Linear; the view under each of its lights alone, at most `MOST_LIGHTS`.
    reference : (height, width, 3) float array
        The view under all lights.
    shadow_ratio, lit_level, shadow_margin, shadow_area
        See `SHADOW_OPTIONS`.

    Returns
    -------
    ShadowMasks

    Raises
    ------
    ValueError
        There are no pictures, or more than `MOST_LIGHTS`.
    """
    if not 1 <= len(lit) <= MOST_LIGHTS:
        raise ValueError(f"shadows are found for 1 to {MOST_LIGHTS} lights, not {len(lit)}")
    brightest = np.maximum.reduce([_brightness(picture) for picture in (*lit, reference)])
    saturated = np.logical_or.reduce([(picture >= SATURATED).any(axis=2) for picture in (*lit, reference)])
    decidable = (brightest >= lit_level) & ~grown(saturated, _HIGHLIGHT_RIM)
    dtype = next(kind for kind in (np.uint8, np.uint16, np.uint32) if len(lit) <= np.iinfo(kind).bits)
    bits = np.zeros(brightest.shape, dtype)
    for light, picture in enumerate(lit):
        shadow = decidable & (_brightness(picture) <= shadow_ratio * brightest)
        shadow = _without_specks(_shrunk(shadow, shadow_margin), shadow_area)
        bits |= shadow.astype(dtype) << dtype(light)
    return ShadowMasks(bits, decidable)


def _all_of_blocks(values: np.ndarray, step: int) -> np.ndarray:
    """Return the bitwise and of blocks of pixels; those that the picture cuts are 0."""
    height, width = values.shape
    padded = np.pad(values, ((0, -height % step), (0, -width % step)))
    return np.bitwise_and.reduce(padded.reshape(padded.shape[0] // step, step, -1, step), axis=(1, 3))


def _brightness(picture: np.ndarray) -> np.ndarray:
    return picture.mean(axis=2, dtype=np.float32)


def _shrunk(mask: np.ndarray, margin: int) -> np.ndarray:
    """Return the mask narrower by a margin on every side, the picture's border counting as light."""
    kernel = np.ones((2 * margin + 1,) * 2, np.uint8)
    return cv2.erode(mask.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0).astype(bool)


def _without_specks(mask: np.ndarray, least: int) -> np.ndarray:
    """Return the mask without its connected parts of fewer than ``least`` pixels."""
    _, labels, parts, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    large = parts[:, cv2.CC_STAT_AREA] >= least
    large[0] = False  # the background
    return large.take(labels)
