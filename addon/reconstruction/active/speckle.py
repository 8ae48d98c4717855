# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `speckle`: a depth sensor that knows its projector's dots by heart.

As in Kinect, windows of the picture are matched with a memorised picture of the dots on a reference plane. Here that picture
is computed from the calibration, by which it has the projector's own optics: rectified, what the camera would see of a plane
at depth ``Z0`` is the pattern itself, moved by ``f b / Z0``. A window that matches it at a shift of d more pixels lies at
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
from .rectification import RectifiedPair, box_between, onto_pixels, rectified_picture, rectify
from .sequences import number_of, of_kind, only, read_grey
from .speckle_code import speckle_image
from .structured_light import FILL, projections
from .triangulation import rays_through

OPTIONS = (
    Option("window", 9, "Side of the window that is matched: more is less noisy, and fattens edges by half of it", unit=Unit.PIXELS,
           minimum=3, maximum=63),
    Option("score", 0.5, "Least correlation of a window with the dots, from -1 to 1", minimum=0.0, maximum=1.0),
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
    score : (h, w) float32 array
        The best correlation.
    """

    disparity: np.ndarray
    reason: np.ndarray
    score: np.ndarray


def measure_speckle(scan: Scan, *, window: int = 9, score: float = 0.5, uniqueness: float = 0.85, contrast: float = 0.004,
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
    dots, base = reference_picture(pair, projector, picture)
    found = match_dots(rectified_picture(view.camera, pair.first, image), dots, base, pair.disparities, window=window, score=score,
                       uniqueness=uniqueness, contrast=contrast)
    rows, columns = np.nonzero(found.reason == Reason.VALID)
    points = pair.points(rows, columns, found.disparity[rows, columns])
    chosen, pixels = onto_pixels(view.camera, points)
    points = points[chosen]
    reason = _in_picture(view.camera, pair.first, found.reason)
    reason = np.where(saturated, np.uint8(Reason.SATURATED), np.where(reason == Reason.VALID, np.uint8(Reason.UNCERTAIN), reason))
    reason[pixels] = Reason.VALID
    depths = (points - pair.first.centre) @ pair.first.forward
    measured = measurement_of(view, number, points, pixels, pair.deviation(depths, SIGMA), reason, projector)
    return replace(measured, warnings=measured.warnings + _drowning(where, image if black is None else read_grey(picture), reason, window))


def reference_picture(pair: RectifiedPair, projector: Camera, picture: ProjectedPicture) -> tuple[np.ndarray, int]:
    """Return the memorised picture, (h, w) float32, of the dots on a plane, and how far it is moved.

    The plane lies in the middle of the disparities, so that shifts towards and away from it are as far.

    Raises
    ------
    ScanstageError
        The pattern's fields are wrong.
    """
    fields = {"dot": int(number_of(picture, "dot", 1, 4096)), "density": number_of(picture, "density", 0.0, 1.0),
              "seed": int(number_of(picture, "seed", 0, 1 << 31))}
    pattern = speckle_image(projector.size, fields).astype(np.float32) / 255
    finer = projector.K[0, 0] / pair.second.K[0, 0]  # of the projector's pixels than the rectified ones
    if finer > 1:
        pattern = cv2.GaussianBlur(pattern, (0, 0), 0.5 * np.sqrt(finer ** 2 - 0.9))
    dots = rectified_picture(projector, pair.second, pattern)
    base = pair.disparities // 2
    return _moved(dots, base), base


def match_dots(image: np.ndarray, reference: np.ndarray, base: int, disparities: int, *, window: int, score: float, uniqueness: float,
               contrast: float) -> Match:
    """Find for every pixel the shift at which its window correlates best with the reference.

    The measure is the zero-mean normalised cross-correlation, which other light and the surface's albedo leave alone. A
    parabola through the best score and its neighbours gives the place between pixels.

    Parameters
    ----------
    image, reference : (h, w) float32 arrays
        Rectified.
    base : int
        The disparity of the reference.
    disparities : int
        Disparities from 0 to this are tried.
    window : int
        Odd.
    score, uniqueness, contrast
        See `OPTIONS`.
    """
    mean, deviation = _statistics(image, window)
    best = np.full(image.shape, -1, np.float32)
    before, after, second, previous = (best.copy() for _ in range(4))
    place = np.full(image.shape, -9, np.int32)
    own_mean, own_deviation = _statistics(reference, window)
    for disparity in range(disparities + 1):
        moved, other, spread = (_moved(values, disparity - base) for values in (reference, own_mean, own_deviation))
        covariance = cv2.boxFilter(image * moved, -1, (window, window)) - mean * other
        now = np.clip(covariance / np.maximum(deviation * spread, _FLAT), -1, 1)
        np.copyto(after, now, where=place == disparity - 1)
        better, apart = now > best, disparity - place > 1
        np.maximum(second, np.where(better, best, now), out=second, where=apart)
        for kept, fresh in ((before, previous), (best, now), (after, np.float32(-1)), (place, np.int32(disparity))):
            np.copyto(kept, fresh, where=better)
        previous = now
    curvature = before - 2 * best + after
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(curvature < 0, 0.5 * (before - after) / curvature, 0)
    disparity = (np.round((place + shift) * STEPS) / STEPS).astype(np.float32)
    at_end = (place == 0) | (place == disparities)
    reason = np.where((best < score) | (second > uniqueness * best) | at_end, np.uint8(Reason.UNCERTAIN), np.uint8(Reason.VALID))
    islands = np.where(reason == Reason.VALID, disparity * STEPS, -1).astype(np.int16)
    cv2.filterSpeckles(islands, -1, window * window // 2, STEPS)
    reason[(islands < 0) & (reason == Reason.VALID)] = Reason.UNCERTAIN
    reason[deviation < contrast] = Reason.UNLIT
    return Match(disparity, reason, best)


def _statistics(values: np.ndarray, window: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and standard deviation in the window about each pixel."""
    mean = cv2.boxFilter(values, -1, (window, window))
    return mean, np.sqrt(np.maximum(cv2.boxFilter(values * values, -1, (window, window)) - mean * mean, 0))


def _moved(values: np.ndarray, columns: int) -> np.ndarray:
    """Return values moved to the right; what comes in is 0."""
    out = np.zeros_like(values)
    if abs(columns) < values.shape[1]:
        out[:, max(columns, 0):values.shape[1] + min(columns, 0)] = values[:, max(-columns, 0):values.shape[1] - max(columns, 0)]
    return out


def _in_picture(camera: Camera, ideal: Camera, reason: np.ndarray) -> np.ndarray:
    """Return the reasons of a rectified picture at the pixels of the real one."""
    width, height = camera.size
    rows, columns = np.mgrid[:height, :width]
    pixels, depth = ideal.project(ideal.centre + rays_through(camera, np.stack((columns, rows), axis=-1)))
    pixels = np.where((depth > 0)[..., None], pixels, -2).astype(np.float32)
    return cv2.remap(reason, pixels[..., 0], pixels[..., 1], cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT,
                     borderValue=int(Reason.UNLIT))


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
