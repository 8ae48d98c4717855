# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a pattern is. The table of all patterns is `patterns`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

AXES = ("column", "row")


@dataclass(frozen=True)
class Pattern:
    """One image for a projector.

    Parameters
    ----------
    id : str
        Unique in its set; letters, digits, ``-`` and ``.``.
    fields : mapping
        What it is, in JSON values: see above.
    image : (height, width) or (height, width, 3) uint8 or float32 array
        Linear light, grey or red, green and blue; 255, or 1.0, is the projector's full power. Read-only where it repeats one
        row or column.
    """

    id: str
    fields: Mapping[str, object]
    image: np.ndarray

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.image.shape[1], self.image.shape[0]

    @property
    def light(self) -> np.ndarray:
        """The (height, width, 3) linear red, green and blue, from 0 to 1."""
        light = self.image / np.float32(255) if self.image.dtype == np.uint8 else self.image
        return light if light.ndim == 3 else np.repeat(light[..., None], 3, axis=2)
