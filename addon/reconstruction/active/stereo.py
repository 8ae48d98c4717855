# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The method `stereo`: what two cameras see without any projector, matched by their texture.

The lecture's baseline, which shows what a projector buys. Each view is rectified with its nearest neighbour and matched by
OpenCV's semi-global matching (Hirschmueller, 2008), which takes care of consistency between left and right. Where a
surface shows no texture nothing can be matched: such pixels are left out, and the report says how many.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, silent
from ..color import linear_to_srgb
from ..neighbours import NARROWEST, WIDEST, nearest_views
from ..scan import Scan, View
from ..volumetric.visual_hull import working_bounds
from .correspondence import Reason
from .measurement import Measurement, measurement_of
from .rectified_pair import RectifiedPair, rectified_picture, rectify
from .structured_light import FILL

OPTIONS = (
    Option("block", 5, "Side of the window that is matched: more is less noisy, and blunter at edges", unit=Unit.PIXELS, minimum=1,
           maximum=31),
    Option("widest", WIDEST, "Greatest angle between two views that are matched, seen from the object", unit=Unit.ANGLE,
           minimum=np.radians(1.0), maximum=np.radians(80.0)),
    Option("texture", 1.5, "Least standard deviation of a window, in 8-bit levels, for its pixel to be matched", minimum=0.0, maximum=64.0),
    FILL,
)
_MOST_DISPARITIES = 1024  # finer pictures are matched at a lower resolution
_SIGMA = 0.25  # pixels: semi-global matching's sub-pixel estimate
_UNIQUENESS = 10  # percent by which the best match must win
_SPECKLE = 100, 2  # pixels and disparities of islands that are dropped
_FEW = 0.5  # share of a silhouette


def measure_stereo(scan: Scan, *, block: int = 5, widest: float = WIDEST, texture: float = 1.5, fill: str = "shell",
                   progress: Progress = silent) -> Measurement:
    """Match every view with its nearest neighbour.

    Parameters
    ----------
    scan : Scan
        With silhouettes.
    block, widest, texture
        See `OPTIONS`.

    Raises
    ------
    ScanstageError
        No two views are near enough to each other, or nothing could be matched.
    """
    box = np.asarray(working_bounds(scan, rule="conservative", tolerance=0, outside="unknown") if scan.bounds is None else scan.bounds)
    neighbours = nearest_views([view.camera for view in scan.views], box.mean(axis=0), widest)
    if not neighbours:
        raise ScanstageError(f"no two views are {np.degrees(NARROWEST):g} to {np.degrees(widest):g} degrees apart, seen from the "
                             "object; capture more views, or raise --set widest=...")
    parts = []
    for step, (number, other) in enumerate(neighbours):
        view = scan.views[number]
        progress(step / len(neighbours), f"Matching view {view.name}")
        parts.append(match_views(view, number, scan.views[other], box, block=block, texture=texture))
    progress(1.0, "Matched")
    if not any(len(part.cloud) for part in parts):
        raise ScanstageError("no pixel could be matched: the surface shows too little texture for stereo without a projector; project a "
                             "pattern on it (gray-code, color-stripes, speckle), or lower --set texture=...")
    return Measurement.joined(parts)


def match_views(view: View, number: int, other: View, box: np.ndarray, *, block: int, texture: float) -> Measurement:
    """Match a view with another one; the points are those of the view's own pixels."""
    cameras = [view.camera, other.camera]
    pair = rectify(*cameras, box, f"frame {view.name} beside {other.name}")
    if pair.disparities > _MOST_DISPARITIES:
        cameras = [camera.scaled(_MOST_DISPARITIES / pair.disparities) for camera in cameras]
        pair = rectify(*cameras, box, f"frame {view.name} beside {other.name}")
    pictures = [_levels(one, camera, ideal) for one, camera, ideal in zip((view, other), cameras, (pair.first, pair.second), strict=True)]
    inside = rectified_picture(view.camera, pair.first, view.mask.astype(np.uint8), interpolation=cv2.INTER_NEAREST) > 0
    disparity = semi_global_disparity(*pictures, pair.disparities, block)
    textured = local_deviation(pictures[0], inside, block) >= texture
    reason = np.where((disparity >= 0) & inside & textured, np.uint8(Reason.VALID), np.uint8(Reason.UNCERTAIN))
    points, reason = pair.points_seen(view.camera, disparity, reason)
    points, reason = points[view.mask[reason == Reason.VALID]], np.where(view.mask, reason, np.uint8(Reason.UNLIT))
    found = measurement_of(view, number, points, np.nonzero(reason == Reason.VALID), _deviation(pair, points), reason, None)
    return replace(found, warnings=_warnings(view, other, inside, textured, len(points)))


def semi_global_disparity(first: np.ndarray, second: np.ndarray, disparities: int, block: int) -> np.ndarray:
    """Return disparities (h, w) float32 of two rectified 8-bit pictures from 0 to ``disparities``; -1 where there is none."""
    count = 16 * (1 + disparities // 16)
    channels = first.shape[2]
    matcher = cv2.StereoSGBM_create(minDisparity=0, numDisparities=count, blockSize=block | 1, P1=8 * channels * block ** 2,
                                    P2=32 * channels * block ** 2, disp12MaxDiff=1, uniquenessRatio=_UNIQUENESS,
                                    speckleWindowSize=_SPECKLE[0], speckleRange=_SPECKLE[1], mode=cv2.STEREO_SGBM_MODE_SGBM)
    # The matcher leaves the first columns out, as many as there are disparities.
    padded = [cv2.copyMakeBorder(picture, 0, 0, count, 0, cv2.BORDER_CONSTANT) for picture in (first, second)]
    found = matcher.compute(*padded)[:, count:].astype(np.float32) / 16
    return np.where(found < 0, np.float32(-1), found)


def local_deviation(picture: np.ndarray, inside: np.ndarray, block: int) -> np.ndarray:
    """Return the (h, w) float32 standard deviation of the grey levels in a window, of pixels inside the silhouette only.

    The outline's contrast with the background is no texture of the surface.
    """
    weight = cv2.erode(inside.astype(np.float32), np.ones((3, 3), np.uint8))  # the outermost pixels show some background
    grey = weight * picture.astype(np.float32).mean(axis=2)
    count, mean, square = (cv2.boxFilter(values, -1, (block | 1,) * 2) for values in (weight, grey, grey * grey))
    mean, square = (values / np.maximum(count, 1e-6) for values in (mean, square))
    return np.sqrt(np.maximum(square - mean * mean, 0))


def _levels(view: View, camera, ideal) -> np.ndarray:
    """Return a view's picture, rectified, as 8-bit sRGB: where matching works best, dark and bright count alike."""
    picture = view.read_image()
    if camera.size != view.camera.size:
        picture = cv2.resize(picture, camera.size, interpolation=cv2.INTER_AREA)
    picture = np.where(_as_sized(view.mask, camera.size)[..., None], np.clip(picture, 0, 1), 0)
    return rectified_picture(camera, ideal, np.rint(255 * linear_to_srgb(picture)).astype(np.uint8))


def _as_sized(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return mask if mask.shape == size[::-1] else cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0


def _deviation(pair: RectifiedPair, points: np.ndarray) -> np.ndarray:
    return pair.deviation((points - pair.first.centre) @ pair.first.forward, _SIGMA)


def _warnings(view: View, other: View, inside: np.ndarray, textured: np.ndarray, matched: int) -> tuple[str, ...]:
    area, plain = int(np.count_nonzero(view.mask)), 1 - np.count_nonzero(textured & inside) / max(np.count_nonzero(inside), 1)
    if matched >= _FEW * area:
        return ()
    why = (f"{100 * plain:.0f} % of it shows no texture: project a pattern on it" if plain > _FEW
           else "what the two see differs too much: bring the views nearer to each other")
    share = 100 * matched / max(area, 1)
    return (f"frame {view.name}: only {share:.0f} % of the silhouette could be matched with frame {other.name}; {why}",)
