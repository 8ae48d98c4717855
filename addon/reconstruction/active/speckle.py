# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `speckle`: a depth sensor that knows its projector's dots by heart.

As in Kinect, windows of the picture are matched with a memorised picture of the dots on a reference plane. Here that picture
is computed from the calibration, by which it has the projector's own optics: rectified, what the camera would see of a plane
at depth ``Z0``, the farthest of the working volume, is the pattern itself, moved by ``f b / Z0``. A window that matches it at a shift of
d more pixels lies at
``1 / Z = 1 / Z0 + d / (f b)`` (Khoshelham & Elberink, 2012, eq. 5). Shifts are rounded to an eighth of a pixel, as the
sensor's are, so that depths come in steps and their error grows with the square of the depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, silent
from ..geometry import Camera
from ..scan import ProjectedPicture, Scan, View
from .correspondence import Reason
from .measurement import Measurement, measurement_of
from .rectified_pair import RectifiedPair, box_between, rectified_picture, rectify
from .sequences import number_of, of_kind, only, read_grey
from .speckle_code import speckle_image
from .structured_light import FILL, projections

OPTIONS = (
    Option("window", 9, "Side of the window that is matched: more is less noisy, and fattens edges by half of it", unit=Unit.PIXELS,
           minimum=3, maximum=63),
    Option("score", 0.7, "Least correlation of a window with the dots, from -1 to 1", minimum=0.0, maximum=1.0),
    Option("uniqueness", 0.85, "Of the best correlation: what the second best at another place may reach", minimum=0.1, maximum=1.0),
    Option("contrast", 0.004, "Least contrast of a window, as a share of white, for a pixel to count as lit by dots", minimum=0.0,
           maximum=1.0),
    FILL,
)
STEPS = 8
"""Of a pixel: to which shifts are rounded."""
SIGMA = 0.5 / STEPS
"""Pixels: the expected error of a shift (Khoshelham & Elberink, 2012)."""
_MOST_DISPARITIES = 2048
_DROWNED = 0.25  # contrast of the dots against their mean: full contrast is above 1
_SAMPLES = 4  # along each side of a pixel
_SLAB = 32  # rows of the reference that are made together
_STRAY = 0.6  # pixels from the median of its neighbours: more is a window that was led astray
_ISLAND = 2  # windows: what is smaller is dropped
_FLAT = 1e-6


@dataclass(frozen=True)
class Match:
    """Shifts of a rectified picture.

    Parameters
    ----------
    disparity : (h, w) float32 array
        In pixels; meaningless where ``reason`` is not 0.
    reason : (h, w) uint8 array
        A `Reason`.
    """

    disparity: np.ndarray
    reason: np.ndarray


def measure_speckle(scan: Scan, *, window: int = 9, score: float = 0.7, uniqueness: float = 0.85, contrast: float = 0.004,
                    fill: str = "shell", progress: Progress = silent) -> Measurement:
    """Measure a depth map for every picture under dots.

    Parameters
    ----------
    scan : Scan
    window, score, uniqueness, contrast
        See `OPTIONS`.

    Raises
    ------
    ScanstageError
        No frame was taken under dots, their fields are wrong, or nothing could be matched.
    """
    shots = [(number, view, projector, picture, only(pictures, "black"))
             for number, view, projector, pictures in projections(scan) for picture in of_kind(pictures, "speckle")]
    if not shots:
        raise ScanstageError("no frame of the capture was taken under dots, and speckle needs them; capture with the rig depth-sensor")
    parts = []
    for step, (number, view, projector, picture, black) in enumerate(shots):
        progress(step / len(shots), f"Matching frame {picture.name}")
        box = box_between(view.camera, projector) if scan.bounds is None else np.asarray(scan.bounds)
        parts.append(_measured(view, number, projector, picture, black, box, window=window | 1, score=score, uniqueness=uniqueness,
                               contrast=contrast))
    progress(1.0, "Matched")
    return Measurement.joined(parts)


def _measured(view: View, number: int, projector: Camera, picture: ProjectedPicture, black: ProjectedPicture | None, box: np.ndarray, *,
              window: int, score: float, uniqueness: float, contrast: float) -> Measurement:
    where = f"frame {picture.name}"
    pair = rectify(view.camera, projector, box, where)
    if pair.disparities > _MOST_DISPARITIES:
        raise ScanstageError(f"{where}: depths of the working volume differ by {pair.disparities} pixels, more than {_MOST_DISPARITIES}; "
                             "give tighter bounds")
    image = read_grey(picture)
    saturated = image >= 1
    image = image - (0 if black is None else read_grey(black))
    dots = reference_picture(pair, projector, picture)
    found = match_dots(rectified_picture(view.camera, pair.first, image), dots, window=window, score=score, uniqueness=uniqueness,
                       contrast=contrast)
    inside = rectified_picture(view.camera, pair.first, np.ones(image.shape, np.float32))
    found.reason[cv2.erode(inside, np.ones((window, window), np.uint8), borderValue=0) < 1] = Reason.UNLIT  # a window is cut there
    points, reason = pair.points_seen(view.camera, found.disparity, found.reason)
    kept = ~saturated[reason == Reason.VALID]
    points, reason = points[kept], np.where(saturated, np.uint8(Reason.SATURATED), reason)
    depths = (points - pair.first.centre) @ pair.first.forward
    measured = measurement_of(view, number, points, np.nonzero(reason == Reason.VALID), pair.deviation(depths, SIGMA), reason, projector)
    return replace(measured, warnings=measured.warnings + _drowning(where, image if black is None else read_grey(picture), reason, window))


def reference_picture(pair: RectifiedPair, projector: Camera, picture: ProjectedPicture) -> np.ndarray:
    """Return the memorised picture of the dots on the farthest plane of the working volume.

    It is (h, w + d) float32 and begins d columns before the rectified picture, d being the pair's disparities: so far nearer things
    may shift the dots. NaN beyond the projector's picture.

    Raises
    ------
    ScanstageError
        The pattern's fields are wrong.
    """
    fields = {"dot": int(number_of(picture, "dot", 1, 4096)), "density": number_of(picture, "density", 0.0, 0.999),
              "seed": int(number_of(picture, "seed", 0, 1 << 31))}
    pattern = speckle_image(projector.size, fields).astype(np.float32) / 255
    (width, height), more = pair.second.size, pair.disparities
    wide = replace(pair.second, K=pair.second.K + np.array([[0, 0, more], [0, 0, 0], [0, 0, 0]]), size=(width + more, height))
    reference = np.empty((height, width + more), np.float32)
    for first in range(0, height, _SLAB):
        slab = min(_SLAB, height - first)
        part = replace(wide, K=wide.K - np.array([[0, 0, 0], [0, 0, first], [0, 0, 0]]), size=(width + more, slab))
        # A camera's pixel takes in an area: the mean of samples of it. Between the projector's pixels they are blended, since
        # the nearest one would move the dots' edges by up to half a sample.
        fine = rectified_picture(projector, part.scaled(_SAMPLES), pattern, border=np.nan)
        reference[first:first + slab] = fine.reshape(slab, _SAMPLES, width + more, _SAMPLES).mean(axis=(1, 3))
    return reference


def match_dots(image: np.ndarray, reference: np.ndarray, *, window: int, score: float, uniqueness: float, contrast: float) -> Match:
    """Find for every pixel the shift at which its window correlates best with the reference.

    The measure is the zero-mean normalised cross-correlation, which other light and the surface's albedo leave alone. The
    place between pixels is the mean of two estimates from the best score and its neighbours: a parabola's, which is drawn towards
    whole pixels where dots are square, and that of two lines of one slope, which is pushed away from them where dots are blurred.
    The median of 3 x 3 of these places is the disparity.

    Parameters
    ----------
    image : (h, w) float32 array
        Rectified.
    reference : (h, w + d) float32 array
        See `reference_picture`; disparities from 0 to d are tried.
    window : int
        Odd.
    score, uniqueness, contrast
        See `OPTIONS`.
    """
    width, disparities = image.shape[1], reference.shape[1] - image.shape[1]
    mean, deviation = _statistics(image, window)
    whole = cv2.erode(np.isfinite(reference).astype(np.uint8), np.ones((window, window), np.uint8), borderValue=0).astype(np.float32)
    reference = np.nan_to_num(reference)
    best = np.full(image.shape, -1, np.float32)
    before, after, second, previous = (best.copy() for _ in range(4))
    place = np.full(image.shape, -9, np.int32)
    own_mean, own_deviation = _statistics(reference, window)
    for disparity in range(disparities + 1):
        part = slice(disparities - disparity, disparities - disparity + width)
        moved, other, spread, known = (values[:, part] for values in (reference, own_mean, own_deviation, whole))
        covariance = cv2.boxFilter(image * moved, -1, (window, window)) - mean * other
        now = np.where(known > 0, np.clip(covariance / np.maximum(deviation * spread, _FLAT), -1, 1), np.float32(-1))
        np.copyto(after, now, where=place == disparity - 1)
        better, apart = now > best, disparity - place > 1
        np.maximum(second, np.where(better, best, now), out=second, where=apart)
        for kept, fresh in ((before, previous), (best, now), (after, np.float32(-1)), (place, np.int32(disparity))):
            np.copyto(kept, fresh, where=better)
        previous = now
    rise = after - before
    parabola = 0.5 * rise / np.maximum(2 * best - before - after, _FLAT)
    lines = 0.5 * rise / np.maximum(best - np.minimum(before, after), _FLAT)
    disparity = (place + np.clip((parabola + lines) / 2, -0.5, 0.5)).astype(np.float32)
    smooth = cv2.medianBlur(disparity, 3)
    at_end = (place == 0) | (place == disparities)
    strays = np.abs(disparity - smooth) > _STRAY
    reason = np.where((best < score) | (second > uniqueness * best) | at_end | strays, np.uint8(Reason.UNCERTAIN), np.uint8(Reason.VALID))
    disparity = np.round(smooth * STEPS) / STEPS
    islands = np.where(reason == Reason.VALID, disparity * STEPS, -1).astype(np.int16)
    cv2.filterSpeckles(islands, -1, _ISLAND * window * window, STEPS)
    reason[(islands < 0) & (reason == Reason.VALID)] = Reason.UNCERTAIN
    reason[deviation < contrast] = Reason.UNLIT
    return Match(disparity, reason)


def _statistics(values: np.ndarray, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation in the window about each pixel."""
    mean = cv2.boxFilter(values, -1, (window, window))
    return mean, np.sqrt(np.maximum(cv2.boxFilter(values * values, -1, (window, window)) - mean * mean, 0))


def _drowning(where: str, image: np.ndarray, reason: np.ndarray, window: int) -> tuple[str, ...]:
    """Return a warning where other light leaves the dots little contrast."""
    mean, deviation = _statistics(image, window)
    lit = reason != Reason.UNLIT
    if not lit.any():
        return (f"{where}: no dots are seen at all; check the projector, or lower --set contrast=...",)
    contrast = float(np.median(deviation[lit] / np.maximum(mean[lit], _FLAT)))
    if contrast >= _DROWNED:
        return ()
    return (f"{where}: the dots drown in other light: their contrast is {100 * contrast:.0f} % of the brightness; darken the room, or use "
            "a stronger projector",)
