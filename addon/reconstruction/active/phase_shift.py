# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase shifting: projector coordinates between the columns, from sinusoids and what tells their periods apart.

A pixel's picture at step k of N is ``A + B cos(phase - 2 pi k / N)``, and its phase the argument of the first Fourier coefficient
over the steps. Noise of the pictures, sigma_I, reaches the phase as ``sigma_I / B sqrt(2 / N)``. The second harmonic, which
a gamma adds, does so for N = 3 only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from .correspondence import CONTRAST, Decoded, Reason, full_scale

_TURN = 2 * np.pi


@dataclass(frozen=True)
class Phase:
    """A sinusoid fitted to each pixel.

    Parameters
    ----------
    phase : (h, w) float32 array
        From 0 to 2 pi, radians; of a crest 0.
    amplitude : (h, w) float32 array
        B, in the unit of the pictures.
    residual : (h, w) float32 array
        Sum of the squares that the sinusoid leaves, over the steps.
    steps : int
    saturated : (h, w) bool array
        Where a picture reaches the end of its scale.
    scale : float
        That end.
    """

    phase: np.ndarray
    amplitude: np.ndarray
    residual: np.ndarray
    steps: int
    saturated: np.ndarray
    scale: float

    def lit(self, contrast: float) -> np.ndarray:
        """Return (h, w) bool: where the sinusoid's range, twice its amplitude, is at least a share of full scale."""
        return self.amplitude >= 0.5 * contrast * self.scale

    def noise(self, contrast: float) -> float | None:
        """Return the pictures' standard deviation sigma_I, in their unit, from what the sinusoids leave; None for 3 steps.

        The median over the lit pixels, so that edges do not count, of a chi-square with N - 3 degrees of freedom.
        """
        freedom = self.steps - 3
        lit = self.lit(contrast) & ~self.saturated
        if freedom < 1 or not lit.any():
            return None
        median = freedom * (1 - 2 / (9 * freedom)) ** 3  # of the chi-square distribution (Wilson & Hilferty, 1931)
        if freedom == 1:
            median = 0.4549  # where the approximation is 4 % off
        return float(np.sqrt(np.median(self.residual[lit]) / median))


def fit_phase(images: Iterable[np.ndarray], steps: int) -> Phase:
    """Fit a sinusoid to each pixel of equally shifted pictures.

    Parameters
    ----------
    images : iterable of (h, w) arrays
        In the order of their steps; uint8, uint16 or float32. Taken one by one.
    steps : int
        Their number, at least 3.

    Returns
    -------
    Phase
    """
    sums = None
    for step, image in enumerate(images):
        if sums is None:
            scale = full_scale(image)
            sums = [np.zeros(image.shape, np.float32) for _ in range(4)]
            saturated = np.zeros(image.shape, np.uint8)
        total, square, cosine, sine = sums
        value = image.astype(np.float32)
        cv2.accumulate(value, total)
        cv2.accumulateSquare(value, square)
        for weight, accumulator in ((np.cos(_TURN * step / steps), cosine), (np.sin(_TURN * step / steps), sine)):
            if abs(weight) > 1e-12:
                cv2.scaleAdd(value, float(weight), accumulator, dst=accumulator)
        cv2.max(saturated, cv2.compare(image, scale, cv2.CMP_GE), dst=saturated)
    total, square, cosine, sine = sums
    amplitude = cv2.magnitude(cosine, sine) * np.float32(2 / steps)
    residual = square - total * total / np.float32(steps) - amplitude * amplitude * np.float32(steps / 2)
    return Phase(cv2.phase(cosine, sine), amplitude, np.maximum(residual, 0), steps, saturated != 0, scale)


def unwrap_by_position(phase: Phase, period: float, coarse: Decoded, *, noise: float, length: int,
                       contrast: float = CONTRAST) -> Decoded:
    """Choose each pixel's period by a coarse position, such as a Gray code's.

    The period is the one that brings the phase nearest to the coarse position, ``K = round((Phi_coarse - phi) / 2 pi)``: where
    the borders of the code and the wraps of the phase do not agree to the pixel, as they never do, nothing happens as
    long as the coarse position is right to less than half a period.

    Parameters
    ----------
    phase : Phase
    period : float
        Of the sinusoid, in projector pixels.
    coarse : Decoded
    noise : float
        Standard deviation of the pictures.
    length : int
        Number of the projector's columns (or rows).
    contrast : float
        Least range of the sinusoid, as a share of full scale.
    """
    turns = phase.phase * np.float32(1 / _TURN)
    position = (turns + np.rint(coarse.position / np.float32(period) - turns)) * np.float32(period)
    return _judged(phase, position, period, coarse.reason, noise, length, contrast)


def unwrap_by_frequencies(phases: Sequence[tuple[float, Phase]], *, noise: float, length: int,
                          contrast: float = CONTRAST) -> Decoded:
    """Choose each pixel's period by sinusoids of longer and longer periods (temporal unwrapping: Huntley & Saldner, 1993).

    Parameters
    ----------
    phases : sequence of (float, Phase)
        Periods in projector pixels with their phases, the longest first; that one must span the projector.
    noise : float
        Standard deviation of the pictures.
    length : int
        Number of the projector's columns (or rows).
    contrast : float
        Least range of the sinusoids, as a share of full scale.

    Notes
    -----
    Each position must be right to half a period of the next sinusoid. Where noise makes that less than sure, by 3.5
    standard deviations, the pixel is `Reason.UNCERTAIN`.
    """
    longest, first = phases[0]
    turns = first.phase * np.float32(1 / _TURN)
    # Half a pixel before the first column is a phase below 0, which shows as one just below a turn.
    turns = np.where(turns > (length / longest + 1) / 2, turns - 1, turns) if length < longest else turns
    position = turns * np.float32(longest)
    reason = np.zeros(position.shape, np.uint8)
    for (period, phase), (before, last) in zip(phases[1:], phases, strict=False):
        turns = phase.phase * np.float32(1 / _TURN)
        position = (turns + np.rint(position / np.float32(period) - turns)) * np.float32(period)
        unsure = 3.5 * _deviation(last, before, noise) > period / 2
        reason[unsure | ~last.lit(contrast)] = Reason.UNCERTAIN
    return _judged(phases[-1][1], position, phases[-1][0], reason, noise, length, contrast)


def _deviation(phase: Phase, period: float, noise: float) -> np.ndarray:
    """Return the expected standard deviation of a position, in projector pixels: ``period / 2 pi * sigma_I / B sqrt(2 / N)``."""
    factor = period / _TURN * noise * np.sqrt(2 / phase.steps)
    return np.float32(factor) / np.maximum(phase.amplitude, np.float32(1e-6 * phase.scale))


def _judged(phase: Phase, position: np.ndarray, period: float, reason: np.ndarray, noise: float, length: int,
            contrast: float) -> Decoded:
    reason = reason.copy()
    reason[(position < -1) | (position > length)] = Reason.OUTSIDE
    reason[phase.saturated] = Reason.SATURATED
    reason[~phase.lit(contrast)] = Reason.UNLIT
    return Decoded(position, reason, _deviation(phase, period, noise))
