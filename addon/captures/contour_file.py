# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes as outlines in a text file: finer than a mask's pixels can be.

``x y`` of one point on a line, in the picture's pixels with the centre of the top-left one at (0, 0). An empty line ends an outline,
whose last point joins its first; holes are outlines of their own. Lines that begin with # are comments.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from .files import read_bytes
from .schema import MAX_SIDE

SUFFIX = ".txt"
MAX_BYTES = 1 << 24


def read_contours(path: Path, name: str | None = None) -> tuple[np.ndarray, ...]:
    """Return the outlines, each an (n, 2) array of x, y.

    Parameters
    ----------
    path : Path
    name : str, optional
        What error messages call the file; its last component if not given.

    Raises
    ------
    ScanstageError
        The file is not there, or a line of it cannot be used.
    """
    name = name or path.name
    try:
        lines = read_bytes(path, MAX_BYTES, name).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ScanstageError(f"{name}: is not a text file; check that it is the right file") from None
    loops: list[list[tuple[float, float]]] = [[]]
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words and loops[-1]:
            loops.append([])
        elif words and not words[0].startswith("#"):
            loops[-1].append(_point(words, f"{name}: line {number}"))
    found = tuple(np.array(loop) for loop in loops if loop)
    if not found:
        raise ScanstageError(f"{name}: holds no outline; check that it is the right file")
    for number, loop in enumerate(found, start=1):
        if len(loop) < 3:
            raise ScanstageError(f"{name}: outline {number} has {len(loop)} points where 3 or more are needed; correct it")
    return found


def _point(words: list[str], place: str) -> tuple[float, float]:
    try:
        x, y = (float(word) for word in words)
    except ValueError:
        raise ScanstageError(f"{place}: must be the two numbers x y; correct it") from None
    if not (abs(x) <= MAX_SIDE and abs(y) <= MAX_SIDE):
        raise ScanstageError(f"{place}: a number is not finite or lies far outside of any picture; correct it")
    return x, y


def contours_text(loops: Sequence[np.ndarray]) -> bytes:
    """Return outlines as `read_contours` reads them, with all their digits."""
    return "\n".join("".join(f"{float(x)!r} {float(y)!r}\n" for x, y in loop) for loop in loops).encode()
