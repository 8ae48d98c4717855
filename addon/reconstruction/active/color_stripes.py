# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `color-stripes`: depth from one picture of coloured stripes, and finer from several that move (Zhang, Curless & Seitz, 2002).

The picture is rectified, so that along each row the stripes' borders come one after another. Where a row's colour changes is a
border of the picture; `stripe_matching` says which of the projector's it is. In several pictures, each with the stripes one
pixel farther, a border passes over a pixel at some moment (space-time analysis): that moment does not depend on the
surface's own colours, and nearly every pixel has one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...errors import ScanstageError
from ...options import Option
from ...progress import Progress, silent
from ..geometry import Camera
from ..scan import ProjectedPicture, Scan, View
from .color_stripe_code import border_positions, border_steps
from .correspondence import Reason
from .measurement import LEAST_ANGLE, Measurement, measurement_of
from .rectification import RectifiedPair, box_between, onto_pixels, rectified_picture, rectify
from .sequences import number_of, of_kind, only
from .stripe_edges import edges_of
from .stripe_matching import match_borders
from .structured_light import FILL, projections
from .triangulation import meet_lines, pixel_width, rays_through

OPTIONS = (
    Option("passes", 4, "How often what is left is matched again: more than once finds thin things that change the stripes' order",
           minimum=1, maximum=16),
    Option("run", 5, "Least number of neighbouring borders that must be matched as neighbours for one of them to be believed; one more in "
           "later passes", minimum=1, maximum=16),
    Option("crosstalk", 0.0, "Share of each channel's light that leaks into each of the two others", minimum=0.0, maximum=0.3),
    Option("contrast", 0.02, "Least light from the projector, as a share of white, by which a channel is used", minimum=0.0, maximum=1.0),
    Option("space_time", True, "Where the stripes move from picture to picture, take the moment at which a border passes a pixel"),
    FILL,
)
_BORDER_SIGMA = 0.3  # projector pixels: of a border's place in one picture
_TIME_SIGMA = 0.15  # and of the moment at which it passes
_LEVEL = 0.2  # of a channel's range: nearer to a level a value is at it
_STEADY = 0.35  # of a channel's range: what a pixel must change by when a border passes


@dataclass(frozen=True)
class Shot:
    """One picture under stripes, matched.

    Parameters
    ----------
    rows : (n,) int array
    columns : (n,) float array
        Of borders in the rectified picture.
    border : (n,) int array
        Which of the projector's borders each is.
    shift : float
        Of the stripes, in projector pixels.
    """

    rows: np.ndarray
    columns: np.ndarray
    border: np.ndarray
    shift: float


def measure_color_stripes(scan: Scan, *, passes: int = 4, run: int = 5, crosstalk: float = 0.0, contrast: float = 0.02,
                          space_time: bool = True, fill: str = "shell", progress: Progress = silent) -> Measurement:
    """Measure the points of every view under coloured stripes.

    Parameters
    ----------
    scan : Scan
    passes, run, crosstalk, contrast, space_time
        See `OPTIONS`.

    Raises
    ------
    ScanstageError
        No frame was taken under coloured stripes, their fields are wrong, or nothing could be matched.
    """
    views = [(number, view, projector, pictures) for number, view, projector, pictures in projections(scan)
             if of_kind(pictures, "color-stripes")]
    if not views:
        raise ScanstageError("no frame of the capture was taken under coloured stripes, and color-stripes needs them; capture with the rig "
                             "color-stripes")
    parts = []
    for step, (number, view, projector, pictures) in enumerate(views):
        progress(step / len(views), f"Matching view {view.name}")
        box = box_between(view.camera, projector) if scan.bounds is None else np.asarray(scan.bounds)
        parts.append(_measured(view, number, projector, pictures, box, passes=passes, run=run, crosstalk=crosstalk, contrast=contrast,
                               space_time=space_time))
    progress(1.0, "Matched")
    return Measurement.joined(parts)


def _measured(view: View, number: int, projector: Camera, pictures: Sequence[ProjectedPicture], box: np.ndarray, *, passes: int, run: int,
              crosstalk: float, contrast: float, space_time: bool) -> Measurement:
    pair = rectify(view.camera, projector, box, f"frame {view.name}")
    black = only(pictures, "black")
    dark = None if black is None else black.read_image()
    shots, series = [], []
    width, asked = None, np.zeros(pair.first.size[::-1], bool)
    for picture in sorted(of_kind(pictures, "color-stripes"), key=lambda shot: number_of(shot, "shift", 0, 1 << 16)):
        width = number_of(picture, "width", 1.0, 4096.0)
        image = _unmixed(picture.read_image() - (0 if dark is None else dark), crosstalk)
        flat = rectified_picture(view.camera, pair.first, image)
        edges = edges_of(flat, contrast)
        asked[edges.rows, np.rint(edges.columns).astype(int)] = True
        border = match_borders(edges, border_steps(), passes=passes, run=run)
        found = border >= 0
        shots.append(Shot(edges.rows[found], edges.columns[found], border[found], number_of(picture, "shift", 0, 1 << 16)))
        series.append(flat)
    if space_time and len(shots) > 2:
        rows, columns, positions = passing_borders(np.stack(series), shots, border_positions(projector.size, int(width), 0.0), contrast)
        sigma = _TIME_SIGMA
    else:
        rows, columns = (np.concatenate([getattr(shot, name) for shot in shots]) for name in ("rows", "columns"))
        positions = np.concatenate([border_positions(projector.size, int(width), shot.shift)[shot.border] for shot in shots])
        sigma = _BORDER_SIGMA
    return _triangulated(view, number, projector, pair, (rows, columns, positions), sigma, asked)


def passing_borders(series: np.ndarray, shots: Sequence[Shot], borders: np.ndarray,
                    contrast: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the moment at which a border passes over each pixel.

    Over time a pixel under moving stripes goes from one colour to another. The channel that changes most passes the middle of
    its own range at a shift t, whatever the surface reflects; with the border's place e in the unmoved pattern, the pixel
    is lit by the projector's column ``e + t``.

    Parameters
    ----------
    series : (s, h, w, 3) float32 array
        Rectified pictures in the order of their shifts.
    shots : sequence of Shot
        The same pictures' borders.
    borders : (m,) array
        Columns of the projector's borders where the shift is 0.
    contrast : float

    Returns
    -------
    rows, columns : (n,) int arrays
    positions : (n,) float array
        Columns of the projector.
    """
    _, height, width, _ = series.shape
    low, high = series.min(axis=0), series.max(axis=0)
    channel = (high - low).argmax(axis=2)
    pick = channel[None, ..., None]
    values = np.take_along_axis(series, np.broadcast_to(pick, (len(series), height, width, 1)), axis=3)[..., 0]
    least, most = values.min(axis=0), values.max(axis=0)
    above = values > (least + most) / 2
    changes = above[1:] != above[:-1]
    step = changes.argmax(axis=0)
    usable = (changes.sum(axis=0) == 1) & (most - least >= np.maximum(contrast, _STEADY * most))
    rows, columns = np.nonzero(usable)
    step = step[rows, columns]
    moment, sure = _moments(values[:, rows, columns], step)
    rows, columns, moment = rows[sure], columns[sure], moment[sure]
    nearer = np.clip(np.rint(moment), 0, len(shots) - 1).astype(int)
    known = np.full((len(shots), height, width), -1, np.int16)
    for number, shot in enumerate(shots):
        place = np.rint(shot.columns).astype(int)
        for beside in (-1, 1, 0):  # a border passes within a pixel of where it is seen at the nearest shift
            inside = (place + beside >= 0) & (place + beside < width)
            known[number, shot.rows[inside], place[inside] + beside] = shot.border[inside]
    border = known[nearer, rows, columns]
    found = border >= 0
    shifts = np.array([shot.shift for shot in shots])
    return rows[found], columns[found], borders[border[found]] + np.interp(moment[found], np.arange(len(shots)), shifts)


def _moments(values: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return when values (s, n) pass from one level to another, in pictures, and which of these are sure.

    It is the area under what is still to come, which is right for every blur that is alike before and after, as that between
    a projector's pixels. ``step`` (n,) is the last picture before the middle is passed; the two pictures on either side of
    it count. At the ends of the series the level beyond is known if it is that without light, or if the change is seen to begin there.
    """
    last = len(values) - 2
    rising = values[-1] > values[0]
    # At the ends the change may have begun before, or end after; the level without light is known, which is 0.
    open_ended = np.where(rising, step == 0, step == last)
    least, most = np.where(open_ended, 0, values.min(axis=0)), values.max(axis=0)
    share = (values - least) / np.maximum(most - least, 1e-12)
    share = np.where(rising, share, 1 - share)
    area = step - 1.5
    for beside in (-1, 0, 1, 2):
        picture = step + beside
        known = np.take_along_axis(share, np.clip(picture, 0, len(values) - 1)[None], axis=0)[0]
        area = area + 1 - np.where(picture < 0, 0, np.where(picture >= len(values), 1, known))
    begun = np.where(step == 0, share[1] < 1 - _LEVEL, np.where(step == last, share[last] > _LEVEL, True))
    return area, open_ended | begun


def _unmixed(image: np.ndarray, crosstalk: float) -> np.ndarray:
    """Return a picture without what leaked between its channels: the inverse of ``(1 - 2 c) I + c (1 - I)``."""
    if not crosstalk:
        return image
    mixing = np.full((3, 3), crosstalk) + (1 - 3 * crosstalk) * np.eye(3)
    return cv2.transform(image, np.linalg.inv(mixing))


def _triangulated(view: View, number: int, projector: Camera, pair: RectifiedPair, found: tuple[np.ndarray, np.ndarray, np.ndarray],
                  sigma: float, asked: np.ndarray) -> Measurement:
    """Meet the rays of borders with the projector's planes of light; ``asked`` says where in the rectified picture borders are seen."""
    rows, columns, positions = found
    rays = rays_through(pair.first, np.stack((columns, rows), axis=-1).astype(np.float64))
    distance, sine = meet_lines(projector, "column", positions, view.camera.centre, rays)
    with np.errstate(invalid="ignore"):
        points = view.camera.centre + distance[:, None] * rays
        good = (distance > 0) & np.isfinite(points).all(axis=1) & (sine > np.sin(LEAST_ANGLE)) & (projector.project(points)[1] > 0)
    points, sine = points[good], sine[good]
    chosen, pixels = onto_pixels(view.camera, points)
    reason = np.full(view.camera.size[::-1], Reason.UNLIT, np.uint8)
    seen = pair.first.centre + pair.first.rays(np.argwhere(asked)[:, ::-1].astype(np.float64))
    reason[onto_pixels(view.camera, seen)[1]] = Reason.UNCERTAIN
    reason[pixels] = Reason.VALID
    deviation = sigma * pixel_width(projector, "column", points[chosen]) / sine[chosen]
    return measurement_of(view, number, points[chosen], pixels, deviation, reason, projector)


