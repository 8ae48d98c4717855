# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes: where in a picture the object may be.

Extractors take linear RGB and return a bool mask, True on the object. `extract` chooses one by its options, cleans the
mask and, where a method must never lose a piece of the object, makes it conservative with `cover_partial_pixels`.
A shadow carver and a visual hull stand or fall with that: one lost pixel drills a tunnel through the volume.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from ..errors import ScanstageError
from ..options import Option, Unit
from .color import linear_to_srgb, srgb_to_linear

EXTRACTORS = {
    "auto": "A mask that came with the picture, else its alpha, else a clean plate, else the threshold",
    "mask": "The mask that came with the picture",
    "alpha": "The picture's alpha channel",
    "chroma": "All that has not the backdrop's colour, however dark the backdrop's shadows are",
    "plate": "All that differs from a picture of the scene without the object by more than a shadow",
    "threshold": "All that is brighter than the threshold, before a dark background",
}

SILHOUETTE_OPTIONS = (
    Option("silhouette", "auto", "How the object is told from the background", choices=EXTRACTORS),
    Option("threshold", 0.12, "Grey value, as a screen shows it from 0 to 1, above which a pixel is the object",
           minimum=0.0, maximum=1.0),
    Option("backdrop", "auto", "Colour of the backdrop, as #rrggbb, or auto for the colour of the picture's border"),
    Option("chroma_angle", math.radians(12), "How far a colour may turn from the backdrop's and still be the backdrop",
           unit=Unit.ANGLE, minimum=0.0, maximum=math.pi / 2),
    Option("chroma_floor", 0.01, "Linear brightness below which a colour is not trusted and counts as the object",
           minimum=0.0, maximum=1.0),
    Option("plate_difference", 0.02, "Linear difference from the clean plate above which a pixel is the object",
           minimum=0.0, maximum=1.0),
    Option("plate_shadow", 0.4, "Share of the plate's brightness that is left in the deepest shadow on the background",
           minimum=0.0, maximum=1.0),
    Option("remove_specks", 0, "Parts of the silhouette with fewer pixels than this are dropped", unit=Unit.PIXELS,
           minimum=0),
    Option("fill_holes", 0, "Holes in the silhouette with fewer pixels than this are filled", unit=Unit.PIXELS,
           minimum=0),
    Option("dilate", 0, "Growth of the silhouette on all sides", unit=Unit.PIXELS, minimum=0, maximum=100),
    Option("erode", 0, "Shrinkage of the silhouette on all sides, after it has grown", unit=Unit.PIXELS, minimum=0,
           maximum=100),
    Option("conservative", True, "Cover every pixel that the object touches, so that no piece of it is ever carved"),
)


def extract(rgb: np.ndarray, alpha: np.ndarray | None, given: np.ndarray | None, plate: np.ndarray | None, *,
            silhouette: str, threshold: float, backdrop: str, chroma_angle: float, chroma_floor: float,
            plate_difference: float, plate_shadow: float, remove_specks: int, fill_holes: int, dilate: int, erode: int,
            conservative: bool) -> np.ndarray:
    """Return the silhouette of one picture.

    Parameters
    ----------
    rgb : (h, w, 3) float32 array
        Linear.
    alpha : (h, w) float32 array, optional
        The picture's own.
    given : (h, w) bool array, optional
        A mask that came with the picture.
    plate : (h, w, 3) float32 array, optional
        The scene without the object, linear.
    silhouette, threshold, ..., conservative
        The options of `SILHOUETTE_OPTIONS`, by name.

    Returns
    -------
    (h, w) bool array

    Raises
    ------
    ScanstageError
        The picture lacks what the chosen extractor needs, or the backdrop is no colour.
    """
    if silhouette == "auto":
        silhouette = choose(alpha, given, plate)
    lacking = {"mask": given is None, "alpha": alpha is None, "plate": plate is None}.get(silhouette, False)
    if lacking:
        what = {"mask": "mask of its own", "alpha": "alpha channel", "plate": "clean plate"}[silhouette]
        raise ScanstageError(f"there is no {what}, which silhouette={silhouette} needs; choose another silhouette")
    if silhouette == "mask":
        mask = given
    elif silhouette == "alpha":
        mask = from_alpha(alpha, conservative=conservative)
    elif silhouette == "plate":
        mask = from_plate(rgb, plate, difference=plate_difference, shadow=plate_shadow)
    elif silhouette == "chroma":
        color = border_color(rgb) if backdrop == "auto" else parse_color(backdrop)
        mask = from_chroma(rgb, color, angle=chroma_angle, floor=chroma_floor)
    else:
        mask = from_threshold(rgb, threshold=threshold)
    mask = clean(mask, remove_specks=remove_specks, fill_holes=fill_holes, dilate=dilate, erode=erode)
    return cover_partial_pixels(mask) if conservative else mask


def choose(alpha: np.ndarray | None, given: np.ndarray | None, plate: np.ndarray | None) -> str:
    """Return the extractor that ``auto`` stands for: the one that rests on most knowledge."""
    available = (("mask", given), ("alpha", alpha), ("plate", plate))
    return next((name for name, source in available if source is not None), "threshold")


def from_alpha(alpha: np.ndarray, *, conservative: bool) -> np.ndarray:
    """Return where the alpha is at least half or, conservatively, where it is anything at all."""
    return alpha > 0 if conservative else alpha >= 0.5


def from_threshold(rgb: np.ndarray, *, threshold: float) -> np.ndarray:
    """Return where the grey value (Rec. 601 luma of the sRGB-encoded picture, 0 to 1) exceeds the threshold.

    The Middlebury recipe for the dinosaur is 0.19, then ``dilate=10, erode=7``.
    """
    encoded = linear_to_srgb(np.clip(rgb, 0, 1).astype(np.float32))
    return cv2.cvtColor(encoded, cv2.COLOR_RGB2GRAY) > threshold


def from_chroma(rgb: np.ndarray, backdrop: np.ndarray, *, angle: float, floor: float) -> np.ndarray:
    """Return where the colour is not the backdrop's.

    Linear RGB is compared by direction alone: a shadow scales it and leaves its direction. Where it is nearly black
    the direction is noise; such pixels count as object, since a dark object must not be lost.

    Parameters
    ----------
    rgb : (h, w, 3) array
        Linear.
    backdrop : (3,) array
        Linear, of any brightness above 0.
    angle : float
        Radians between two colours, as vectors, up to which they are the same.
    floor : float
        Length of the colour vector below which a pixel is too dark to tell.
    """
    length = np.linalg.norm(rgb, axis=-1)
    along = rgb @ np.asarray(backdrop / np.linalg.norm(backdrop), np.float32)
    return (along < math.cos(angle) * length) | (length < floor)


def from_plate(rgb: np.ndarray, plate: np.ndarray, *, difference: float, shadow: float) -> np.ndarray:
    """Return where the picture differs from the clean plate by more than a shadow (after Horprasert et al., 1999).

    The plate's colour, scaled by the factor that fits best, is subtracted from the picture's: what remains is a
    difference of colour. The factor itself tells a shadow (``shadow`` to 1) from an object in the background's colour.

    Parameters
    ----------
    rgb, plate : (h, w, 3) array
        Linear.
    difference : float
        Length of the remaining colour vector up to which two colours are the same.
    shadow : float
        The least factor that is a shadow; 1 makes every darker pixel the object.
    """
    square = np.einsum("hwc,hwc->hw", plate, plate)
    factor = np.einsum("hwc,hwc->hw", rgb, plate) / np.maximum(square, np.float32(1e-12))
    factor = np.clip(factor, shadow, 1).astype(np.float32)
    return np.linalg.norm(rgb - factor[..., None] * plate, axis=-1) > difference


def border_color(rgb: np.ndarray) -> np.ndarray:
    """Return the (3,) median colour of the brighter half of the picture's outermost pixels.

    Raises
    ------
    ScanstageError
        The border is black: it has no colour.
    """
    border = np.concatenate((rgb[0], rgb[-1], rgb[:, 0], rgb[:, -1]))
    length = np.linalg.norm(border, axis=-1)
    color = np.median(border[length >= np.median(length)], axis=0)  # without shadows, and feet that leave the picture
    if not np.linalg.norm(color) > 1e-6:
        raise ScanstageError("the picture's border is black; give the option backdrop the colour of the backdrop")
    return color


def parse_color(text: str) -> np.ndarray:
    """Return the (3,) linear colour of ``#rrggbb``.

    Raises
    ------
    ScanstageError
        It is no such colour, or it is black.
    """
    try:
        value = int(text.removeprefix("#"), 16) if len(text.removeprefix("#")) == 6 else 0
    except ValueError:
        value = 0
    if value <= 0:
        raise ScanstageError(f"option backdrop: {text[:40]!r} is no colour; give it as #rrggbb, not black, or auto")
    return srgb_to_linear(np.array([value >> 16, value >> 8 & 255, value & 255]) / 255)


def clean(mask: np.ndarray, *, remove_specks: int, fill_holes: int, dilate: int, erode: int) -> np.ndarray:
    """Drop small parts, fill small holes, then grow and shrink the silhouette, in this order.

    Beyond the picture's border the silhouette is taken to go on as it meets the border: an object that leaves the
    picture is not eroded there, and one that only grows across the border shrinks back from it.
    """
    if remove_specks:
        mask = mask & ~_parts_below(mask, remove_specks, connectivity=8)
    if fill_holes:
        mask = mask | _parts_below(~np.pad(mask, 1), fill_holes, connectivity=4)[1:-1, 1:-1]
    if not dilate and not erode:
        return mask
    beyond = dilate + erode
    grown = np.pad(mask.astype(np.uint8), beyond, mode="edge")
    if dilate:
        grown = cv2.dilate(grown, disc(dilate))
    if erode:
        grown = cv2.erode(grown, disc(erode))
    return grown[beyond:-beyond, beyond:-beyond].astype(bool)


def _parts_below(mask: np.ndarray, pixels: int, *, connectivity: int) -> np.ndarray:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=connectivity)
    small = stats[:, cv2.CC_STAT_AREA] < pixels
    small[0] = False  # label 0 is all that is False in the mask
    return small[labels]


def disc(radius: int) -> np.ndarray:
    """Return the (2 r + 1, 2 r + 1) uint8 structuring element of the pixels within ``radius + 0.5``; 3x3 for 1."""
    offset = np.arange(-radius, radius + 1) ** 2
    return (offset[:, None] + offset <= (radius + 0.5) ** 2).astype(np.uint8)


def cover_partial_pixels(mask: np.ndarray) -> np.ndarray:
    """Grow a silhouette that was sampled at pixel centres until it covers every pixel that the object touches.

    A renderer with one sample a pixel says whether the pixel's *centre* is covered. Growing by a 3x3 square covers all
    partly covered pixels if the true silhouette is a union of discs of radius ``r = 1/sqrt(2)`` px or more, that is,
    if no part of it is thinner than 1.42 px:

    A larger disc is itself a union of discs of radius r, so let x be a point of such a disc with centre c. The pixel
    centre m nearest to c is at most 1/2 away along each axis, so ``|m - c| <= 1/sqrt(2) = r``: m lies in the disc, and
    its sample is True. Along each axis ``|x - m| <= |x - c| + |c - m| <= r + 1/2 < 3/2``: x lies in the 3x3 pixels
    about m. What is left, 0.29 px, is spare for a sample that is not exactly at the centre.

    The proof needs m inside the picture. It may lie one pixel outside for x in the outermost pixels, so of those
    nothing is proven: `undistortion.undistorted_view` leaves them out.

    Parameters
    ----------
    mask : (h, w) bool array

    Returns
    -------
    (h, w) bool array
    """
    return cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
