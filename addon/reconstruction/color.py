# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""sRGB's transfer curve (IEC 61966-2-1), both ways. All else in this package is linear light."""

from __future__ import annotations

import numpy as np


def srgb_to_linear(value) -> np.ndarray:
    """Decode sRGB values from 0 to 1, of any shape; float32 stays float32, all else becomes float64."""
    value = _floating(value)
    return np.where(value <= 0.04045, value / 12.92, ((np.maximum(value, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(value) -> np.ndarray:
    """Encode linear values from 0 to 1 as sRGB, of any shape; float32 stays float32, all else becomes float64."""
    value = _floating(value)
    return np.where(value <= 0.0031308, value * 12.92, 1.055 * np.maximum(value, 0) ** (1 / 2.4) - 0.055)


def _floating(value) -> np.ndarray:
    value = np.asarray(value)
    # Python numbers beside a float32 array keep it float32, but turn a float32 scalar into float64 in numpy 1.26
    return value if value.dtype == np.float32 else value.astype(np.float64)
