# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The dots of a depth sensor's projector: pseudo-random, and the same for everybody who knows their seed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


def speckle_image(size: tuple[int, int], fields: Mapping[str, object]) -> np.ndarray:
    """Return the (height, width) uint8 picture that a pattern's fields stand for."""
    width, height = size
    dot = int(fields["dot"])
    rows, columns = (np.arange(-(-side // dot), dtype=np.uint64) for side in (height, width))
    coins = _mixed(_mixed(rows[:, None] + np.uint64(int(fields["seed"]) << 32)) + columns)
    lit = coins < np.uint64(float(fields["density"]) * 2.0 ** 64)
    return np.repeat(np.repeat(np.where(lit, np.uint8(255), np.uint8(0)), dot, axis=0), dot, axis=1)[:height, :width]


def _mixed(values: np.ndarray) -> np.ndarray:
    """Return the finaliser of SplitMix64 (Steele, Lea & Flood, 2014): bits that look random, alike on every machine."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ values >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ values >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    return values ^ values >> np.uint64(31)
