# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a calibration can be trusted: poses that leave something open, and a picture of what is left unexplained."""

from __future__ import annotations

import cv2
import numpy as np

from .rig import Rig

ENOUGH_POSES = 10
LEAST_NORMALS = np.radians(10.0)  # between the two poses of the board that differ most in tilt
LEAST_BOARD = 0.04  # of the picture's area that the board covers, in the median pose
LEAST_COVERAGE = 0.3  # of the picture's area that the board covers in all poses together
MOST_DEVIATION = 0.01  # of the focal length
MOST_RMS = 2.0  # pixels
_LONGEST_ARROW = 0.03  # of the picture's longer side, for the 95th percentile of the residuals
_MOST_PIXELS = 1600  # along the longer side of a picture of residuals
_LINE = 26  # height of the line of text below such a picture
_PAPER, _INK = (255, 255, 255), (60, 60, 60)


def pose_warnings(rig: Rig, corners: np.ndarray, device: str) -> list[str]:
    """Return a sentence for each thing in which a device's views of the board leave the calibration weak.

    Parameters
    ----------
    rig : Rig
    corners : (n, 3) array
        The board's corners in its own frame.
    device : str
    """
    camera = rig.devices[device]
    own = [sighting for sighting in rig.sightings if sighting.device == device]
    warnings = []
    if len(own) < ENOUGH_POSES:
        warnings.append(f"{device}: only {len(own)} poses of the board; take 10 to 20")
    normals = np.array([camera.R @ rig.poses[sighting.pose][:3, 2] for sighting in own])
    apart = np.arccos(np.clip((normals @ normals.T).min(), -1, 1))
    tilt = np.arccos(np.clip(np.abs(normals[:, 2]).min(), 0, 1))
    if apart < LEAST_NORMALS and tilt < LEAST_NORMALS:
        warnings.append(f"{device}: the board faces it in every pose (tilted by at most {np.degrees(tilt):.0f} degrees), so its focal "
                        "length and the board's distance cannot be told apart; tilt the board by 15 to 45 degrees about different axes")
    elif apart < LEAST_NORMALS:
        warnings.append(f"{device}: the board is only shifted, or turned in its own plane (its tilts differ by {np.degrees(apart):.0f} "
                        "degrees), which says nothing new; tilt it by 15 to 45 degrees about different axes")
    area = camera.size[0] * camera.size[1]
    covered = float(np.median([_hull_area(sighting.pixels) for sighting in own])) / area
    if covered < LEAST_BOARD:
        warnings.append(f"{device}: the board covers only {100 * covered:.1f} % of the picture; bring it nearer or use a larger one")
    together = _hull_area(np.concatenate([sighting.pixels for sighting in own])) / area
    if covered >= LEAST_BOARD and together < LEAST_COVERAGE:
        warnings.append(f"{device}: all poses together cover only {100 * together:.0f} % of the picture, and the lens is unknown beyond; "
                        "show the board towards the corners, too")
    deviation = (rig.deviations[device][:2] / np.diag(camera.K)[:2]).max()
    if deviation > MOST_DEVIATION:
        warnings.append(f"{device}: the focal length has a standard deviation of {100 * deviation:.1f} %; take more poses, with more tilt")
    if rig.rms(device) > MOST_RMS:
        warnings.append(f"{device}: the corners lie {rig.rms(device):.1f} pixels (RMS) from where they should be; look at its picture of "
                        "residuals, and check that the board is flat, its sizes are right and it stood still in each pose")
    return warnings


def _hull_area(pixels: np.ndarray) -> float:
    return float(cv2.contourArea(cv2.convexHull(pixels.astype(np.float32))))


def residual_picture(rig: Rig, device: str) -> np.ndarray:
    """Draw where a device's corners were seen and how far from there they should be.

    Returns
    -------
    (height, width, 3) uint8 array
        sRGB: the device's picture and a line of text. Each corner has an arrow from where it was seen towards where the
        calibration puts it, in its pose's colour and as many times too long as the text says. Arrows that agree with their
        neighbours show a lens that is not modelled.
    """
    size = np.array(rig.devices[device].size)
    scale = min(1.0, _MOST_PIXELS / size.max())
    width, height = np.ceil(size * scale).astype(int)
    sheet = np.full((height + _LINE, width, 3), _PAPER, np.uint8)
    own = [(s, r) for s, r in zip(rig.sightings, rig.residuals, strict=True) if s.device == device]
    typical = np.percentile(np.linalg.norm(np.concatenate([residual for _, residual in own]), axis=1), 95)
    factor = _round_down(_LONGEST_ARROW * size.max() / max(typical, 1e-9))
    for index, (sighting, residual) in enumerate(own):
        color = cv2.cvtColor(np.uint8([[[180 * index // len(own), 200, 190]]]), cv2.COLOR_HSV2RGB)[0, 0].tolist()
        ends = np.stack((sighting.pixels, sighting.pixels - factor * residual), axis=1)
        fixed = np.round(16 * ((ends + 0.5) * scale - 0.5)).clip(-1e6, 1e6).astype(int)  # OpenCV draws in sixteenths of a pixel
        for start, end in fixed.tolist():
            cv2.line(sheet, start, end, color, 1, cv2.LINE_AA, shift=4)
            cv2.circle(sheet, start, 24, color, -1, cv2.LINE_AA, shift=4)
    text = f"{device}: {len(own)} poses, RMS {rig.rms(device):.3f} px, arrows {factor:g} times too long"
    cv2.rectangle(sheet, (0, height), (width, height + _LINE), _INK, -1)
    cv2.putText(sheet, text, (10, height + _LINE - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _PAPER, 1, cv2.LINE_AA)
    return sheet


def _round_down(value: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is no more than a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))
