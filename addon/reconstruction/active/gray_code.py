# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Gray code, from pictures to projector coordinates, robust to light that takes a way round.

A bit is the sign of the difference between a picture and its inverse. Where surfaces light each other that sign may be
wrong, so each pixel's light is parted into what comes straight from the projector and what comes by way of other surfaces
(Nayar et al., "Fast separation of direct and global components of a scene", 2006), and a bit is believed only if it could be no
other (Xu & Aliaga, "Robust pixel classification for 3D modeling with structured light", 2007). Neighbouring codes differ in
one bit, so a pixel on the border of two columns has one bit without contrast, and either value is right to within a column.

The arithmetic stays in the pictures' own type, most often bytes, of which a processor compares 32 or more at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce

import cv2
import numpy as np

from .correspondence import CONTRAST, Decoded, Reason, full_scale

_BYTE = 8
_BAND = 1 << 18  # bytes of a picture that are worked on at a time: few calls, and arrays that stay near the processor


def decode_gray(pairs: Iterable[tuple[np.ndarray, np.ndarray | None]], white: np.ndarray, black: np.ndarray, *, length: int,
                finest: int = 0, contrast: float = CONTRAST, robust: bool = True) -> Decoded:
    """Decode one axis of a Gray code.

    Parameters
    ----------
    pairs : iterable of ((h, w) array, (h, w) array or None)
        Each bit's picture and that of its inverse, the coarsest bit first, at most 16; uint8, uint16 or float32, all alike.
        Without inverses a picture is compared with the mean of white and black. An iterator is asked for one after the
        other, so that they need not lie in memory together; a sequence is decoded in bands that fit the processor's cache.
    white, black : (h, w) arrays
        Under full and under no light.
    length : int
        Number of the projector's columns (or rows).
    finest : int
        The last bit that was shown: 1 where cells are two pixels wide.
    contrast : float
        Least direct light, and least difference that tells a bit, as a share of full scale.
    robust : bool
        Whether to believe only bits that could be no other. Otherwise every lit pixel is decoded: simple thresholding.

    Returns
    -------
    Decoded
        The middle of the cell. Its ``sigma`` is that of a place anywhere in a cell, ``2 ** finest / sqrt(12)``.

    Notes
    -----
    With the direct light ``d`` and the indirect light ``g``, a pixel's value lies in ``d .. d + g`` where a pattern is on and in
    ``0 .. g`` where it is off, above that under black. Xu & Aliaga take a bit for certain if ``d > g``, or if of a picture and its
    inverse one is at most ``d`` and the other at least ``g``. Light adds up, the two pictures to ``d + g``, and so both of the
    latter say the same: the two differ by at least ``g - d``.
    """
    def decode(pairs, white: np.ndarray, black: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _decoded(pairs, white, black, length=length, finest=finest, contrast=contrast, robust=robust)

    sigma = 2 ** finest / np.sqrt(12)
    if not isinstance(pairs, Sequence):
        return Decoded(*decode(pairs, white, black), sigma)
    position, reason = np.empty(white.shape, np.float32), np.empty(white.shape, np.uint8)
    height = max(1, _BAND // (white.shape[1] * white.itemsize))
    for top in range(0, white.shape[0], height):
        band = slice(top, top + height)
        pieces = ((image[band], None if inverse is None else inverse[band]) for image, inverse in pairs)
        position[band], reason[band] = decode(pieces, white[band], black[band])
    return Decoded(position, reason, sigma)


def _decoded(pairs: Iterable[tuple[np.ndarray, np.ndarray | None]], white: np.ndarray, black: np.ndarray, *, length: int,
             finest: int, contrast: float, robust: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions and reasons of `decode_gray`."""
    code, contrasts = _Code(white.shape), _Contrasts(white.shape, white.dtype)
    last: list[tuple[np.ndarray, np.ndarray]] = []
    for image, inverse in pairs:
        if inverse is None:
            inverse = _opposite(image, white, black)
        code.add(cv2.compare(image, inverse, cv2.CMP_GT))
        contrasts.add(cv2.absdiff(image, inverse))
        last = [*last[-2:], (image, inverse)]
    position, least = code.position(finest), contrast * full_scale(white)
    # Indirect light is even under fine patterns only, and the finest is blurred by the lenses: the next two serve best.
    fine = last[:2] if finest == 0 and len(last) == 3 else last[-2:]
    direct, indirect = separated([picture for pair in fine for picture in pair], black)
    reason = np.zeros(white.shape, np.uint8)
    if robust:
        doubt = cv2.bitwise_not(contrasts.told(direct, indirect, least)).view(bool)
        np.copyto(reason, np.uint8(Reason.UNCERTAIN), where=doubt)
        np.copyto(reason, np.uint8(Reason.SATURATED), where=doubt & (white >= full_scale(white)))
    np.copyto(reason, np.uint8(Reason.OUTSIDE), where=position > length - 1 + 0.5 * (2 ** finest - 1))
    np.copyto(reason, np.uint8(Reason.UNLIT), where=cv2.compare(direct, least, cv2.CMP_LT).view(bool))
    return position, reason


def separated(pictures: Sequence[np.ndarray], black: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Part the light of a pixel into what comes straight from the projector and what comes by way of other surfaces.

    Parameters
    ----------
    pictures : sequence of (h, w) arrays
        Under fine patterns, half of whose pixels are on, each pixel of the camera once lit and once not.
    black : (h, w) array
        The picture under no light: what it shows is neither.

    Returns
    -------
    direct, indirect : (h, w) arrays
        ``max - min`` and ``2 (min - black)`` (Nayar et al., 2006, with the picture under black for their b), in the type of the
        pictures, which saturates.
    """
    brightest, darkest = reduce(cv2.max, pictures), reduce(cv2.min, pictures)
    half = cv2.subtract(darkest, black)
    return cv2.subtract(brightest, darkest), cv2.add(half, half)


def _opposite(image: np.ndarray, white: np.ndarray, black: np.ndarray) -> np.ndarray:
    """Return what the inverse would have shown, for light adds up: white + black - image."""
    # In this order no sum leaves the type: 0 <= white - image, but for noise, which saturates.
    return cv2.add(cv2.subtract(white, image), black)


class _Code:
    """Gray code to binary as the bits come in, packed into bytes."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self._binary = np.zeros(shape, np.uint8)
        self._bytes: list[np.ndarray] = []
        self._bits = 0

    def add(self, on: np.ndarray) -> None:
        """Append a bit, 255 for 1."""
        if self._bits % _BYTE == 0:
            self._bytes.append(np.zeros_like(on))
        self._bits += 1
        cv2.bitwise_xor(self._binary, on, dst=self._binary)
        byte = self._bytes[-1]
        np.add(byte, byte, out=byte)
        np.subtract(byte, self._binary, out=byte)  # 255 is -1

    def position(self, finest: int) -> np.ndarray:
        """Return the (h, w) float32 middles of the cells that the codes so far number."""
        cell = float(2 ** finest)
        low = self._bits - _BYTE if self._bits > _BYTE else 0
        first, second = (self._bytes * 2)[:2] if low == 0 else self._bytes
        return cv2.addWeighted(first, cell * 2 ** low, second, cell if low else 0.0, (cell - 1) / 2, dtype=cv2.CV_32F)


class _Contrasts:
    """The least and the second least difference of a pixel's pairs: how sure its least certain bit is."""

    def __init__(self, shape: tuple[int, int], dtype: np.dtype) -> None:
        top = np.iinfo(dtype).max if dtype.kind == "u" else np.finfo(dtype).max
        self._weakest, self._second = np.full(shape, top, dtype), np.full(shape, top, dtype)

    def add(self, contrast: np.ndarray) -> None:
        """Take in a pair's difference."""
        cv2.min(self._second, cv2.max(self._weakest, contrast), dst=self._second)
        cv2.min(self._weakest, contrast, dst=self._weakest)

    def told(self, direct: np.ndarray, indirect: np.ndarray, least: float) -> np.ndarray:
        """Return 255 where every bit is certain, but for one without contrast where direct light prevails."""
        certain = cv2.bitwise_and(cv2.compare(self._weakest, cv2.subtract(indirect, direct), cv2.CMP_GE),
                                  cv2.compare(self._weakest, least, cv2.CMP_GE))
        prevails = cv2.bitwise_and(cv2.compare(direct, indirect, cv2.CMP_GT), cv2.compare(self._second, least, cv2.CMP_GE))
        return cv2.bitwise_or(certain, prevails)
