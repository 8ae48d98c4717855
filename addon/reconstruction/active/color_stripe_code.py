# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Coloured stripes of which any three neighbouring borders are unique (Zhang, Curless & Seitz, 2002).

A stripe's colour is three bits, one for each of red, green and blue. From stripe to stripe some bits flip, by a De Bruijn
sequence of five symbols and a window of three: 125 borders. The symbols are the flips of two or three channels and of
green alone, the brightest; a border that flips nothing does not exist, so that neighbouring stripes always differ.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .pattern import Pattern

WINDOW, SYMBOLS = 3, ((1, 1, 0), (0, 1, 1), (1, 0, 1), (1, 1, 1), (0, 1, 0))


def color_stripes(size: tuple[int, int], *, width: int = 8, shifts: int = 1, dark: bool = True) -> tuple[Pattern, ...]:
    """Return the stripes, each pattern one pixel farther to the right than the one before, and black.

    All 126 stripes stand in the middle of the projector's picture, as far as it holds them; what is beside them stays dark.
    """
    patterns = tuple(Pattern(f"color-stripes-{shift:02d}", {"kind": "color-stripes", "axis": "column", "width": width, "shift": shift},
                             _image(size, width, shift)) for shift in range(shifts))
    black = Pattern("black", {"kind": "black"}, np.broadcast_to(np.uint8(0), size[::-1]))
    return (*patterns, black) if dark else patterns


@lru_cache(maxsize=1)
def stripe_colors() -> np.ndarray:
    """Return the (126, 3) bits of the stripes, from left to right."""
    flips = np.array([SYMBOLS[symbol] for symbol in de_bruijn(len(SYMBOLS), WINDOW)])
    return (np.cumsum(np.concatenate(([[1, 1, 1]], flips)), axis=0) % 2).astype(np.int16)


def border_positions(size: tuple[int, int], width: int, shift: float) -> np.ndarray:
    """Return the (125,) columns, in pixels, of the borders between the stripes."""
    count = len(stripe_colors())
    first = (size[0] - count * width) // 2
    return first + width * np.arange(1, count) + shift - 0.5


def border_steps() -> np.ndarray:
    """Return the (125, 3) changes of red, green and blue across the borders: -1, 0 or 1."""
    return np.diff(stripe_colors(), axis=0)


def de_bruijn(symbols: int, window: int) -> list[int]:
    """Return a cyclic sequence in which each word of a length occurs once: Lyndon words, joined (Fredricksen & Maiorana, 1978)."""
    sequence: list[int] = []
    word = [-1]
    while word:
        word[-1] += 1
        if window % len(word) == 0:
            sequence += word
        word = [word[i % len(word)] for i in range(window)]
        while word and word[-1] == symbols - 1:
            word.pop()
    return sequence


def _image(size: tuple[int, int], width: int, shift: int) -> np.ndarray:
    colors = stripe_colors()
    columns = np.arange(size[0]) - shift - (size[0] - len(colors) * width) // 2
    inside = (columns >= 0) & (columns < len(colors) * width)
    line = np.where(inside[:, None], 255 * colors.take(np.clip(columns // width, 0, len(colors) - 1), axis=0), 0).astype(np.uint8)
    return np.broadcast_to(line, (size[1], *line.shape))
