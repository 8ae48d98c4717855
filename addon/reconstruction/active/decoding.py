# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From the pictures of one view under one projector to projector coordinates, whatever the code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import ScanstageError
from ..scan import ProjectedPicture
from .continuity import settle_by_neighbours
from .correspondence import CONTRAST, NOISE, Decoded
from .gray_code import decode_gray
from .patterns import AXES
from .phase_shift import Phase, fit_phase, unwrap_by_frequencies, unwrap_by_position
from .sequences import (
    AGAIN,
    GrayPictures,
    PhasePictures,
    gray_pictures,
    only,
    phase_pictures,
    read_grey,
    refuse_dark,
    refuse_saturated,
)

_LARGEST_REMAINDER = 0.1  # of their own power that the sinusoids may leave: two steps of eight that are mixed up leave 0.16
_APART, _MOST_APART = 0.3, 0.25  # periods from the Gray code, whose cells reach 0.25 far, and the share of pixels that may be so far


def decode_view(pictures: Sequence[ProjectedPicture], size: tuple[int, int], *, code: str = "auto", contrast: float = CONTRAST,
                robust: bool = True, noise: float = 0.0, where: str = "the view") -> dict[str, Decoded]:
    """Decode all axes that a view's pictures encode.

    Parameters
    ----------
    pictures : sequence of ProjectedPicture
        Of one view and one projector; others than those of the code are passed over.
    size : (int, int)
        Width and height of the projector.
    code : {'auto', 'gray-code', 'phase-shift'}
        Phase where there are sinusoids, else Gray code; or one of the two.
    contrast : float
        Least direct light, and least difference that tells a bit, as a share of full scale.
    robust : bool
        As in `gray_code.decode_gray`; uncertain codes are then believed where they continue their neighbours'.
    noise : float
        Standard deviation of the pictures as a share of full scale; 0 to take it from the sinusoids themselves.
    where : str
        The view, for error messages.

    Returns
    -------
    dict of str to Decoded
        By ``column`` and ``row``: those that are encoded, at least one.

    Raises
    ------
    ScanstageError
        Pictures are missing, of the wrong pattern or size, out of order, or saturated.
    """
    white, black = only(pictures, "white"), only(pictures, "black")
    gray = {axis: found for axis, length in zip(AXES, size, strict=True)
            if (found := gray_pictures(pictures, axis, length, where)) is not None}
    phases = {axis: found for axis in AXES if (found := phase_pictures(pictures, axis, where))} if code != "gray-code" else {}
    if not (phases if code == "phase-shift" else gray or phases):
        kind = "sinusoids" if code == "phase-shift" else "Gray code"
        raise ScanstageError(f"{where}: has no frames with {kind}; capture them, or choose another method")
    bright, dark = _white_and_black(white, black, gray, contrast) if gray else (None, None)
    decoded = {}
    for axis in phases or gray:
        length = size[AXES.index(axis)]
        coarse = None
        if axis in gray:
            coarse = decode_gray(gray[axis].read(bright, dark), bright, dark, length=length, finest=gray[axis].finest,
                                 contrast=contrast, robust=robust)
            coarse = settle_by_neighbours(coarse) if robust else coarse
        decoded[axis] = _decode_phases(phases[axis], coarse, length, axis, noise=noise, contrast=contrast) if axis in phases else coarse
    return decoded


def _white_and_black(white: ProjectedPicture | None, black: ProjectedPicture | None, gray: dict[str, GrayPictures],
                     contrast: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pictures under white and black, or what takes their place where each pattern has its inverse."""
    on, off = next(iter(gray.values())).pairs[0]
    if white is None or black is None:
        for found in gray.values():
            for picture, inverse in found.pairs:
                if inverse is None:
                    raise ScanstageError(f"frame {picture.name}: has neither an inverse nor frames under white and black to be "
                                         "compared with; capture those two, too")
    dark = None if black is None else read_grey(black)
    if white is not None:
        bright = read_grey(white)
    else:  # light adds up
        bright = np.minimum(read_grey(on) + read_grey(off) - (0 if dark is None else dark), 1)
    dark = np.zeros_like(bright) if dark is None else dark
    if white is not None:
        refuse_saturated(white, bright, dark, contrast)
        if black is not None:
            refuse_dark(white, black, bright, dark, contrast)
    return bright, dark


def _decode_phases(sinusoids: Sequence[PhasePictures], coarse: Decoded | None, length: int, axis: str, *, noise: float,
                   contrast: float) -> Decoded:
    phases = [_fitted(sinusoid, contrast) for sinusoid in sinusoids]
    measured = [found for phase in phases if (found := phase.noise(contrast)) is not None]
    deviation = noise or (float(np.median(measured)) if measured else NOISE)
    finest, phase = sinusoids[-1], phases[-1]
    if coarse is not None:
        decoded = unwrap_by_position(phase, finest.period, coarse, noise=deviation, length=length, contrast=contrast)
        _refuse_disagreement(decoded, coarse, finest)
        return decoded
    if sinusoids[0].period < length:
        raise ScanstageError(f"{sinusoids[0].frames}: no Gray code and no sinusoid as long as the projector's {length} {axis}s tells the "
                             "periods apart; capture one of them, too")
    return unwrap_by_frequencies(list(zip((sinusoid.period for sinusoid in sinusoids), phases, strict=True)), noise=deviation,
                                 length=length, contrast=contrast)


def _fitted(sinusoid: PhasePictures, contrast: float) -> Phase:
    phase = fit_phase((read_grey(picture) for picture in sinusoid.pictures), len(sinusoid.pictures))
    lit = phase.lit(contrast)
    saturated = np.count_nonzero(lit & phase.saturated) / max(np.count_nonzero(lit), 1)
    if saturated > 0.5:
        raise ScanstageError(f"{sinusoid.frames}: {100 * saturated:.0f} % of what the projector lights is saturated; capture with less "
                             "exposure or a weaker projector")
    power = float((phase.amplitude[lit] ** 2).sum()) * phase.steps / 2
    if phase.residual[lit].sum() > _LARGEST_REMAINDER * power:
        raise ScanstageError(f"{sinusoid.frames}: do not follow a sinusoid of {phase.steps} steps; {AGAIN}, or capture with more light")
    return phase


def _refuse_disagreement(decoded: Decoded, coarse: Decoded, sinusoid: PhasePictures) -> None:
    """Refuse phases that are out of order although they leave no residual: shifted by a step, or running backwards.

    All orders of three steps are one of the two, and of four the exchange of two opposite ones.
    """
    both = decoded.valid & coarse.valid
    apart = np.abs(decoded.position - coarse.position)[both] > _APART * sinusoid.period
    if apart.size and (apart.mean() > _MOST_APART or _runs_backwards(decoded.position, coarse.position, both)):
        raise ScanstageError(f"{sinusoid.frames}: their phase does not agree with the Gray code; {AGAIN}")


def _runs_backwards(position: np.ndarray, coarse: np.ndarray, valid: np.ndarray) -> bool:
    """Return whether positions fall within the cells of a code along the direction in which the cells' numbers rise."""
    trends = []
    for axis in (0, 1):
        pairs = np.logical_and(*(np.take(valid, range(start, valid.shape[axis] - 1 + start), axis) for start in (0, 1)))
        fine, rough = (np.diff(values, axis=axis)[pairs] for values in (position, coarse))
        trends.append((float(rough.sum()), float(fine[rough == 0].sum())))
    rough, fine = max(trends, key=lambda trend: abs(trend[0]))
    return rough * fine < 0
