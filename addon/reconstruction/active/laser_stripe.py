# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `laser-stripe`: a stripe, or a point, of light that sweeps over the object.

Where is the stripe in a picture? Its brightest place along a line of pixels is right only if the surface under the whole
stripe is flat and of one colour. Curless & Levoy ("Better optical triangulation through spacetime analysis", 1995) ask
instead when the stripe passes a point of the surface: each point sees the profile of the beam go by, brighter or darker but
unchanged in shape, and the mean of that time is right whatever is beside the point. With a camera that stands still, as here, a
pixel is such a point, and no spacetime image has to be rotated.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, silent
from ..scan import ProjectedPicture, Scan, View
from .correspondence import NOISE, Reason
from .measurement import MAX_GAP, Measurement, measurement_of, refuse_degenerate
from .peaks import ESTIMATORS, centroid_deviations, peak_offsets
from .sequences import number_of, of_kind, read_grey
from .structured_light import FILL
from .sweeps import Sweep, find_sweeps
from .triangulation import LEAST_ANGLE, meet_rays, picture_rays, pixel_width, rays_through

ANALYSES = {"temporal": "When the stripe passes each pixel (Curless & Levoy): right also where colour or shape change under the stripe",
            "spatial": "Where the stripe is in each picture: its peak along lines of pixels"}
LEAST_PEAK = 0.05
"""Of full scale: more than the highest of hundreds of noisy samples in the dark."""
OPTIONS = (
    Option("analysis", "temporal", "How the stripe is found", choices=ANALYSES),
    Option("estimator", "centroid", "How its middle is found between samples", choices=ESTIMATORS),
    Option("contrast", LEAST_PEAK, "Least light of the stripe, as a share of white, by which it is found", minimum=0.0, maximum=1.0),
    Option("noise", NOISE, "Noise of the pictures, as a share of white, for the expected error of the points", minimum=0.0, maximum=1.0),
    Option("max_gap", MAX_GAP, "How far the rays of camera and projector may miss each other, for points of light", unit=Unit.PIXELS,
           minimum=0.0, maximum=1000.0),
    FILL,
)
_SMOOTHING = 1.5  # pixels, by which a picture is smoothed before its brightest point is looked for
_SPOT = 3  # widths of a point of light in the window in which its middle is found


def measure_laser_stripe(scan: Scan, *, analysis: str = "temporal", estimator: str = "centroid", contrast: float = LEAST_PEAK,
                         noise: float = NOISE, max_gap: float = MAX_GAP, fill: str = "shell",
                         progress: Progress = silent) -> Measurement:
    """Measure points by stripes (of a projector or a laser) and by single points of light.

    Raises
    ------
    ScanstageError
        There are neither, a sweep has too few frames, or a projector stands where the camera does.
    """
    parts = []
    for number, view in enumerate(scan.views):
        progress(number / len(scan.views), f"Following the light in view {view.name}")
        for sweep in find_sweeps(view.projected, f"the view of frame {view.name}"):
            if sweep.projector is not None:
                refuse_degenerate(view.name, view.camera, sweep.projector)
            measure = _temporal if analysis == "temporal" else _spatial
            parts.append(measure(view, number, sweep, estimator=estimator, contrast=contrast, noise=noise))
        if points := of_kind(view.projected, "point"):
            parts.append(_points(view, number, points, contrast=contrast, noise=noise, max_gap=max_gap))
    if not parts:
        raise ScanstageError("no frame of the capture was taken under a stripe or a point of light, and laser-stripe needs them; capture a "
                             "sweep")
    progress(1.0, "Measured")
    return Measurement.joined(parts)


def _temporal(view: View, number: int, sweep: Sweep, *, estimator: str, contrast: float, noise: float) -> Measurement:
    half = max(1, min(int(np.ceil(sweep.extent(view.camera)[0])), (len(sweep.pictures) - 1) // 2))
    index, deviation, reason = passing_times((read_grey(picture) for picture in sweep.pictures), len(sweep.pictures), half,
                                             estimator=estimator, contrast=contrast, noise=noise)
    rows, columns = np.nonzero(reason == Reason.VALID)
    rays = picture_rays(view.camera)[rows, columns]
    return _triangulated(view, number, sweep, sweep.at(index[rows, columns].astype(np.float64)), rays, (rows, columns),
                         deviation[rows, columns] * sweep.spacing, reason)


def passing_times(images, frames: int, half: int, *, estimator: str = "centroid", contrast: float = LEAST_PEAK,
                  noise: float = NOISE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find when a stripe passes each pixel.

    Only as many pictures as the window holds are in memory at a time: a pixel is judged when its brightest frame so far is in
    the middle of them, and again if a brighter one comes.

    Parameters
    ----------
    images : iterable of (h, w) float32 arrays
        In the order of the sweep, from 0 to 1.
    frames : int
        Their number.
    half : int
        Frames in the window on either side of the brightest one.
    estimator : str
        One of `peaks.ESTIMATORS`.
    contrast, noise : float
        Least height of the peak above the least value in its window, and noise, as shares of full scale.

    Returns
    -------
    index : (h, w) float32 array
        Frame number, with a fraction.
    deviation : (h, w) float32 array
        Expected, in frames.
    reason : (h, w) uint8 array
        A `Reason`.
    """
    window: deque[np.ndarray] = deque(maxlen=2 * half + 1)
    for frame, image in enumerate(images):
        if frame == 0:
            best, when = np.full(image.shape, -1, np.float32), np.zeros(image.shape, np.int32)
            index, deviation = np.zeros(image.shape, np.float32), np.zeros(image.shape, np.float32)
            reason = np.full(image.shape, Reason.UNLIT, np.uint8)
        window.append(image)
        brighter = image > best
        np.copyto(best, image, where=brighter)
        np.copyto(when, frame, where=brighter)
        if frame < 2 * half:
            continue
        rows, columns = np.nonzero((when == frame - half) & (best >= contrast))
        samples = np.stack([kept[rows, columns] for kept in window])
        offset = peak_offsets(samples, estimator)
        lit = samples[half] - samples.min(axis=0) >= contrast
        index[rows, columns] = frame - half + np.nan_to_num(offset)
        deviation[rows, columns] = centroid_deviations(samples, noise)
        found = np.where(np.abs(offset) <= half, np.uint8(Reason.VALID), np.uint8(Reason.UNCERTAIN))
        found = np.where(samples[half] >= 1, np.uint8(Reason.SATURATED), found)
        reason[rows, columns] = np.where(lit, found, np.uint8(Reason.UNLIT))
    cut = ((when < half) | (when > frames - 1 - half)) & (best >= contrast)
    reason[cut] = Reason.UNCERTAIN  # the sweep begins or ends before the stripe has passed
    return index, deviation, reason


def _spatial(view: View, number: int, sweep: Sweep, *, estimator: str, contrast: float, noise: float) -> Measurement:
    half = max(1, int(np.ceil(sweep.extent(view.camera)[1])))
    normal = view.camera.R @ sweep.planes[len(sweep.planes) // 2, :3]
    upright = abs(normal[0]) >= abs(normal[1])
    reason = np.full(view.camera.size[::-1], Reason.UNLIT, np.uint8)
    found = []
    for picture, position in zip(sweep.pictures, sweep.positions, strict=True):
        image = read_grey(picture)
        lines, places, deviation, bad = stripe_peaks(image if upright else image.T, half, estimator=estimator, contrast=contrast,
                                                     noise=noise)
        pixels = np.stack((places, lines) if upright else (lines, places), axis=-1)
        whole = np.rint(pixels).astype(np.intp)
        reason[whole[:, 1], whole[:, 0]] = bad
        found.append(np.column_stack((pixels, np.full(len(lines), position), deviation))[bad == Reason.VALID])
    column, row, position, deviation = np.concatenate(found).T
    pixels = np.stack((column, row), axis=-1)
    rays = rays_through(view.camera, pixels)
    whole = tuple(np.rint(pixels).astype(np.intp).T[::-1])
    points = view.camera.centre + sweep.meet(view.camera.centre, rays, position)[0][:, None] * rays
    depth = np.abs((points - view.camera.centre) @ view.camera.forward)
    # An error in the camera's picture, in the unit of the light's position.
    deviation = deviation * depth / view.camera.K[0, 0] / np.maximum(sweep.step_at(points, position), 1e-300)
    return _triangulated(view, number, sweep, position, rays, whole, deviation, reason)


def stripe_peaks(image: np.ndarray, half: int, *, estimator: str, contrast: float,
                 noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find where an upright stripe crosses each line of a picture.

    Parameters
    ----------
    image : (h, w) float32 array
    half : int
        Pixels in the window on either side of the brightest one.
    estimator, contrast, noise
        As in `passing_times`.

    Returns
    -------
    lines : (n,) integer array
        Those with a stripe.
    places : (n,) float64 array
        Along them, in pixels.
    deviation : (n,) array
        Expected, in pixels.
    reason : (n,) uint8 array
    """
    brightest = image.argmax(axis=1)
    whole = (brightest >= half) & (brightest < image.shape[1] - half)  # a window that the picture cuts is none
    lines = np.flatnonzero(whole & (image.max(axis=1) >= contrast))
    samples = image[lines, brightest[lines] + np.arange(-half, half + 1)[:, None]]
    lit = samples[half] - samples.min(axis=0) >= contrast
    lines, samples = lines[lit], samples[:, lit]
    offset = peak_offsets(samples, estimator)
    reason = np.where(np.abs(offset) <= half, np.uint8(Reason.VALID), np.uint8(Reason.UNCERTAIN))
    reason[samples[half] >= 1] = Reason.SATURATED
    return lines, brightest[lines] + np.nan_to_num(offset), centroid_deviations(samples, noise), reason


def _triangulated(view: View, number: int, sweep: Sweep, positions: np.ndarray, rays: np.ndarray, pixels: tuple[np.ndarray, np.ndarray],
                  deviation: np.ndarray, reason: np.ndarray) -> Measurement:
    """Return the points where rays (n, 3) of pixels meet the light at its positions (n,), whose expected error is given."""
    distance, sine = sweep.meet(view.camera.centre, rays, positions)
    with np.errstate(invalid="ignore"):
        points = view.camera.centre + distance[:, None] * rays
        good = np.isfinite(distance) & (distance > 0) & (sine > np.sin(LEAST_ANGLE))
        if sweep.projector is not None:
            good &= sweep.projector.project(points)[1] > 0
    reason[pixels[0][~good], pixels[1][~good]] = Reason.BEHIND
    points, sine, positions = points[good], sine[good], positions[good]
    deviation = deviation[good] * sweep.step_at(points, positions) / sine
    return measurement_of(view, number, points, (pixels[0][good], pixels[1][good]), deviation, reason, sweep.projector)


def _points(view: View, number: int, pictures: Sequence[ProjectedPicture], *, contrast: float, noise: float,
            max_gap: float) -> Measurement:
    """Return the points of single points of light, each in its own picture: rays that meet rays."""
    reason = np.full(view.camera.size[::-1], Reason.UNLIT, np.uint8)
    spots, places, deviations, projector = [], [], [], pictures[0].projector
    for picture in pictures:
        if picture.projector is None:
            raise ScanstageError(f"frame {picture.name}: its point of light has no projector; calibrate one and add it to the capture set")
        refuse_degenerate(picture.name, view.camera, picture.projector)
        found = _spot(read_grey(picture), contrast, noise)
        if found is not None:
            spots.append(found[:2])
            deviations.append(found[2])
            places.append([number_of(picture, name, -1e6, 1e6) for name in ("column", "row")])
    spots, places = np.reshape(spots, (-1, 2)), np.reshape(places, (-1, 2))
    meeting = meet_rays(view.camera.centre, rays_through(view.camera, spots), projector.centre, rays_through(projector, places))
    with np.errstate(invalid="ignore"):
        good = np.isfinite(meeting.points).all(axis=1) & (meeting.along > 0) & (meeting.beside > 0) & (meeting.sine > np.sin(LEAST_ANGLE))
        apart = meeting.gap > max_gap * pixel_width(projector, "column", meeting.points)
    columns, rows = np.rint(spots).astype(np.intp).T
    reason[rows, columns] = np.where(~good, np.uint8(Reason.BEHIND), np.where(apart, np.uint8(Reason.APART), np.uint8(Reason.VALID)))
    good &= ~apart
    deviation = np.array(deviations)[good] * meeting.along[good] / view.camera.K[0, 0] / meeting.sine[good]
    return measurement_of(view, number, meeting.points[good], (rows[good], columns[good]), deviation, reason, projector)


def _spot(image: np.ndarray, contrast: float, noise: float) -> tuple[float, float, float] | None:
    """Return column and row of the brightest point's middle, and its expected error in pixels; None if it is too dark
    or cut by the picture."""
    background = float(np.median(image))
    smooth = cv2.GaussianBlur(image, (0, 0), _SMOOTHING)
    _, peak, _, (column, row) = cv2.minMaxLoc(smooth)
    if peak - background < contrast:
        return None
    # Grown until the light has fallen off, so that all of the point is in the window and no more.
    radius = int(np.ceil(_SPOT * np.sqrt(max(np.count_nonzero(smooth - background > 0.5 * (peak - background)), 1) / np.pi))) + 1
    if not (radius <= row < image.shape[0] - radius and radius <= column < image.shape[1] - radius):
        return None  # the picture may have cut it
    places = np.arange(-radius, radius + 1)
    light = np.maximum(image[row - radius:row + radius + 1, column - radius:column + radius + 1] - background, 0).astype(np.float64)
    total, spread = light.sum(), np.sqrt((places ** 2).sum() * len(places))
    across, down = (float(light.sum(axis=axis) @ places / total) for axis in (0, 1))
    return column + across, row + down, float(noise * spread / total)
