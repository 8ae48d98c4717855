# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `color-stripes`: one picture of coloured stripes, or several of them shifted (Zhang, Curless & Seitz, 2002).

The edges along each epipolar line are matched with those of the code by dynamic programming, in passes. With several shifted
pictures each pixel is asked when an edge passes it, as in spacetime analysis: its colour does not matter, for it does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import ScanstageError
from ...options import Option
from ...progress import Progress, silent
from ..geometry import Camera
from ..scan import ProjectedPicture, Scan, View
from .correspondence import Reason
from .measurement import Measurement, measurement_of, refuse_degenerate
from .patterns import AXES
from .rectification import pixel_map, real_pixels, rectified_camera, rectify
from .sequences import number_of, of_kind, only
from .stereo_stripes import measure_pairs
from .stripe_code import EDGES, WINDOW, edge_scores, stripe_edges
from .stripe_edges import Channels, find_edges, match_edges
from .structured_light import FILL, projections
from .triangulation import LEAST_ANGLE, meet_lines, pixel_width, rays_through

ANALYSES = {"space-time": "When an edge passes each pixel, where there are several shifted pictures",
            "interlaced": "Where the edges are in each picture alone, put together"}
LEAST_RANGE = 0.05
OPTIONS = (
    Option("analysis", "space-time", "How several shifted pictures are used", choices=ANALYSES),
    Option("passes", 8, "How often what is left is matched again: 1 loses thin things in front of others", minimum=1, maximum=64),
    Option("contrast", LEAST_RANGE, "Least range of a channel, as a share of white, by which it is believed", minimum=0.001, maximum=1.0),
    FILL,
)
_PLACE_DEVIATION = 0.25  # pixels of the camera, of an edge's place
_TIME_DEVIATION = 0.25  # frames, of an edge's passing
_NEAR = 0.75  # stripes between two matched edges, over all shifts, up to which what lies between is one surface
_ROWS, _LEAST_ROWS = 3, 3  # rows above and below a match, and how many of them must agree with it
_TIMED_APART = 1.0  # projector pixels between neighbours whose edges are timed
_SHARE_SEEN = 0.75  # of the stripes, about, that a picture shows across where the projector is not known
_AGREEMENT = 1 / 3  # of a stripe by which place and time may differ


@dataclass(frozen=True)
class Matches:
    """Edges of the code that were found in the rectified picture.

    Parameters
    ----------
    rows, places : (n,) arrays
        Of the rectified picture.
    positions : (n,) array
        Columns, or rows, of the projector.
    """

    rows: np.ndarray
    places: np.ndarray
    positions: np.ndarray


@dataclass(frozen=True)
class Stripes:
    """The pictures of one code, in the order of their shifts, and what they show."""

    axis: str
    stripes: int
    width: float
    start: float
    pictures: tuple[ProjectedPicture, ...]
    shifts: np.ndarray

    def position(self, edge: np.ndarray, shift: float = 0.0) -> np.ndarray:
        """Return where in the projector the code's edges lie."""
        return self.start + (edge + 1) * self.width - 0.5 + shift


def measure_color_stripes(scan: Scan, *, analysis: str = "space-time", passes: int = 8, contrast: float = LEAST_RANGE, fill: str = "shell",
                          progress: Progress = silent) -> Measurement:
    """Measure points by stripes of colour: with the projector where it is calibrated, otherwise by two cameras (`stereo_stripes`).

    Raises
    ------
    ScanstageError
        There are no such pictures, a pattern's field is not what it must be, or the picture cannot be rectified.
    """
    alone = [(number, view) for number, view in enumerate(scan.views)
             if (shown := of_kind(view.projected, "color-stripes")) and shown[0].projector is None]
    parts = _measure_pairs(scan, alone, passes, contrast) if alone else []
    numbers = {number for number, _ in alone}
    views = list(projections(Scan(tuple(replace(view, projected=()) if number in numbers else view
                                        for number, view in enumerate(scan.views)))))
    for step, (number, view, projector, pictures) in enumerate(views):
        progress(step / len(views), f"Matching stripes in view {view.name}")
        if (shown := find_stripes(pictures)) is not None:
            parts.append(_measure_view(view, number, projector, pictures, shown, analysis=analysis, passes=passes, contrast=contrast))
    if not parts:
        raise ScanstageError("no frame of the capture was taken under stripes of colour, and color-stripes needs them; capture with a "
                             "projector that shows them")
    progress(1.0, "Measured")
    return Measurement.joined(parts)


def _measure_pairs(scan: Scan, views: Sequence[tuple[int, View]], passes: int, contrast: float) -> list[Measurement]:
    """Measure views whose projector is not calibrated: see `stereo_stripes`."""
    stripes = {view.name: find_stripes(view.projected) for _, view in views}
    for name, shown in stripes.items():
        if shown.axis != "column":
            raise ScanstageError(f"frame {name}: its stripes number the projector's rows, and two cameras without a calibrated projector "
                                 "need columns; project columns, or calibrate the projector")

    def find(images: Sequence[np.ndarray], view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        shown = stripes[view.name]
        width = max(images[0].shape[1] / (_SHARE_SEEN * shown.stripes), 2.0)
        found, _ = match_pictures(images, shown, width, passes=passes, contrast=contrast)
        return found.rows, found.places, found.positions

    return measure_pairs(scan, views, find, lambda view: stripes[view.name].pictures)


def find_stripes(pictures: Sequence[ProjectedPicture]) -> Stripes | None:
    """Find a view's pictures under stripes of colour; None if there are none.

    Raises
    ------
    ScanstageError
        A field is not what it must be, or two pictures are of different stripes or the same shift.
    """
    found: dict[float, ProjectedPicture] = {}
    code = None
    for picture in of_kind(pictures, "color-stripes"):
        if (axis := picture.pattern.get("axis")) not in AXES:
            raise ScanstageError(f"frame {picture.name}: its pattern's axis must be column or row, not {str(axis)[:40]!r}")
        own = (axis, int(number_of(picture, "stripes", WINDOW + 1, EDGES + 1)), number_of(picture, "width", 0.01, 1e5),
               number_of(picture, "start", -1e5, 1e5))
        code, shift = code or own, number_of(picture, "shift", -1e5, 1e5)
        if own != code:
            raise ScanstageError(f"frame {picture.name}: shows other stripes than frame {next(iter(found.values())).name}; leave one of "
                                 "them out")
        if shift in found:
            raise ScanstageError(f"frame {picture.name}: shows the same pattern as frame {found[shift].name}; leave one of them out")
        found[shift] = picture
    return code and Stripes(*code, tuple(found[shift] for shift in sorted(found)), np.array(sorted(found)))


def _measure_view(view: View, number: int, projector: Camera, pictures: Sequence[ProjectedPicture], shown: Stripes, *, analysis: str,
                  passes: int, contrast: float) -> Measurement:
    refuse_degenerate(view.name, view.camera, projector)
    rectified = rectified_camera(view.name, view.camera, projector, shown.axis)
    places = pixel_map(view.camera, rectified)
    images = [rectify(picture.read_image(), places) for picture in shown.pictures]
    found, missed = match_pictures(images, shown, stripe_width(view.camera, projector, shown), passes=passes, contrast=contrast,
                                   channels=_channels(pictures, places, contrast))
    timed = analysis == "space-time" and len(images) > 1
    if timed:
        found = passing_edges(np.stack(images), found, shown, contrast=contrast)
    reason = np.full(view.camera.size[::-1], Reason.UNLIT, np.uint8)
    _mark(reason, real_pixels(view.camera, rectified, missed), Reason.UNCERTAIN)
    pixels = real_pixels(view.camera, rectified, np.stack((found.places, found.rows), axis=-1))
    return _triangulated(view, number, projector, shown.axis, pixels, found.positions, reason, timed)


def _triangulated(view: View, number: int, projector: Camera, axis: str, pixels: np.ndarray, positions: np.ndarray, reason: np.ndarray,
                  timed: bool) -> Measurement:
    origin = view.camera.centre
    rays = rays_through(view.camera, pixels)
    distance, sine = meet_lines(projector, axis, positions, origin, rays)
    with np.errstate(invalid="ignore"):
        points = origin + distance[:, None] * rays
        good = np.isfinite(points).all(axis=1) & (distance > 0) & (sine > np.sin(LEAST_ANGLE)) & (projector.project(points)[1] > 0)
    _mark(reason, pixels[~good], Reason.BEHIND)
    points, sine, pixels, distance = points[good], sine[good], pixels[good], distance[good]
    whole = np.clip(np.rint(pixels).astype(np.intp), 0, np.array(view.camera.size) - 1)
    _mark(reason, pixels, Reason.VALID)
    width = pixel_width(projector, axis, points) * _TIME_DEVIATION if timed else distance / view.camera.K[0, 0] * _PLACE_DEVIATION
    return measurement_of(view, number, points, (whole[:, 1], whole[:, 0]), width / sine, reason, projector)


def _mark(reason: np.ndarray, pixels: np.ndarray, why: Reason) -> None:
    column, row = np.clip(np.rint(pixels).astype(np.intp), 0, np.array(reason.shape[::-1]) - 1).T
    reason[row, column] = why


def stripe_width(camera: Camera, projector: Camera, shown: Stripes) -> float:
    """Return about how wide a stripe is in the camera's picture, on a surface near the origin."""
    far, beside = np.linalg.norm(camera.t), np.linalg.norm(projector.t)
    index = AXES.index(shown.axis)
    return max(shown.width * beside / projector.K[index, index] * camera.K[1, 1] / max(far, 1e-300), 2.0)


def _channels(pictures: Sequence[ProjectedPicture], places: np.ndarray, contrast: float) -> Channels | None:
    """Return what pictures under red, green and blue alone tell; None unless all three are there."""
    by_channel = {int(number_of(picture, "channel", 0, 2)): picture for picture in of_kind(pictures, "primary")}
    if len(by_channel) < 3:
        return None
    seen = np.stack([rectify(by_channel[channel].read_image(), places) for channel in range(3)])
    black = only(pictures, "black")
    return Channels.measured(seen, np.zeros_like(seen[0]) if black is None else rectify(black.read_image(), places), contrast)


def match_pictures(images: Sequence[np.ndarray], shown: Stripes, stripe: float, *, passes: int = 8, contrast: float = LEAST_RANGE,
                   channels: Channels | None = None) -> tuple[Matches, np.ndarray]:
    """Match the edges of each rectified picture alone.

    Returns
    -------
    found : Matches
        Of all pictures.
    missed : (n, 2) array
        Columns and rows of edges that fit nothing.
    """
    found, missed = [], []
    for image, shift in zip(images, shown.shifts, strict=True):
        edges = find_edges(image, stripe, contrast=contrast, channels=channels)
        match = match_edges(edges, shown.stripes, passes=passes)
        good = match >= 0
        alone = Matches(edges.rows[good], edges.places[good], shown.position(match[good], shift))
        alone = agreeing(alone, image.shape[:2], shown.width)
        found.append((alone.rows, alone.places, alone.positions))
        missed.append(np.stack((edges.places[~good], edges.rows[~good]), axis=-1))
    return Matches(*(np.concatenate(part) for part in zip(*found, strict=True))), np.concatenate(missed)


def passing_edges(images: np.ndarray, found: Matches, shown: Stripes, *, contrast: float = LEAST_RANGE) -> Matches:
    """Find at each pixel when an edge passes it; which one is told by the edges that were found about it.

    Parameters
    ----------
    images : (frames, h, w, 3) array
        Rectified, in the order of the shifts.
    found : Matches
        Of all pictures, each alone.
    """
    rows, columns, about = _between(found, images.shape[1:3], _NEAR * shown.width)
    values = images[:, rows, columns]
    change = np.diff(values, axis=0)
    energy = (change ** 2).sum(axis=2)
    peak = energy.argmax(axis=0)
    step = np.take_along_axis(change, peak[None, :, None], axis=0)
    # The centroid of the change in its own direction, one frame to either side: an edge is no sharper than a pixel.
    along = np.maximum((change * step).sum(axis=2), 0) * (np.abs(np.arange(len(change))[:, None] - peak) <= 1)
    middles = (shown.shifts[1:] + shown.shifts[:-1])[:, None] / 2
    time = (along * middles).sum(axis=0) / np.maximum(along.sum(axis=0), 1e-12)
    edge = np.rint((about - shown.position(-1, time)) / shown.width).astype(int) - 1
    position = shown.position(edge, time)
    inside = (edge >= 0) & (edge < shown.stripes - 1) & (np.abs(position - about) <= _AGREEMENT * shown.width)
    code, whole = stripe_edges(shown.stripes), values.max(axis=0)
    total = (along > 0)[..., None] * change
    scores = edge_scores(-total.sum(axis=0) / np.maximum(whole, contrast), code, whole >= 0)
    inside &= np.take_along_axis(scores, np.clip(edge, 0, len(code) - 1)[:, None], axis=1)[:, 0] > 0
    # One that had begun before the first frame, or goes on after the last, would be taken for too late, or early.
    inside &= (peak > 0) & (peak < len(change) - 1) & (whole.max(axis=1) >= contrast)
    return agreeing(Matches(rows[inside], columns[inside].astype(np.float64), position[inside]), images.shape[1:3], _TIMED_APART,
                    2 * _ROWS - 1)


def agreeing(found: Matches, shape: tuple[int, int], apart: float, least: int = _LEAST_ROWS) -> Matches:
    """Return the matches that enough of those beside them in other rows agree with, to within ``apart`` projector pixels.

    Rows are matched alone, so that what is wrong in one is seldom so in the next.
    """
    columns = np.clip(np.rint(found.places).astype(np.intp), 0, shape[1] - 1)
    padded = np.full((shape[0] + 2 * _ROWS, shape[1] + 2), np.nan)
    padded[found.rows + _ROWS, columns + 1] = found.positions
    count = np.zeros(len(found.rows), int)
    for down in (*range(-_ROWS, 0), *range(1, _ROWS + 1)):
        near = [np.abs(padded[found.rows + _ROWS + down, columns + 1 + across] - found.positions) < apart for across in (-1, 0, 1)]
        count += np.logical_or.reduce(near)
    good = count >= least
    return Matches(found.rows[good], found.places[good], found.positions[good])


def _between(found: Matches, shape: tuple[int, int], gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels between matched edges of a row that are at most ``gap`` projector pixels apart, and about where they lie."""
    key = found.rows * (4.0 * shape[1]) + found.places  # no row comes near the next
    order = np.argsort(key)
    key, positions = key[order], found.positions[order]
    rows, columns = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    place = rows * (4.0 * shape[1]) + columns
    after = np.searchsorted(key, place)
    has = (after > 0) & (after < len(key))
    rows, columns, place, after = rows[has], columns[has], place[has], after[has]
    first, last = key[after - 1], key[after]
    share = (place - first) / np.maximum(last - first, 1e-9)
    near = (np.abs(positions[after] - positions[after - 1]) <= gap) & (last - first < shape[1])
    about = positions[after - 1] + share * (positions[after] - positions[after - 1])
    return rows[near], columns[near], about[near]
