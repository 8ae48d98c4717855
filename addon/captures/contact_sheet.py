# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""All pictures of a capture set on one sheet, to be looked at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ..reconstruction.color import linear_to_srgb
from .pictures import read_picture, write_picture
from .schema import Capture

_THUMBNAIL = 200  # pixels along the longer side
_GAP = 4
_PAPER = 0.72  # linear grey behind pictures with alpha, and between them
_MOST = 200  # pictures; of more, every n-th is shown


def write_contact_sheet(folder: Path, capture: Capture, out: Path) -> None:
    """Write a sheet of a capture set's pictures, in the order of its frames, as an sRGB PNG.

    Raises
    ------
    ScanstageError
        A picture cannot be read, or the sheet cannot be written.
    """
    frames = capture.frames[::-(-len(capture.frames) // _MOST)]
    thumbnails = []
    for frame in frames:
        rgb, alpha = read_picture(Path(folder) / frame.image, capture.encoding, name=frame.image)
        if alpha is not None:
            rgb = rgb * alpha[..., None] + _PAPER * (1 - alpha[..., None])
        size = [max(1, round(_THUMBNAIL * side / max(rgb.shape[:2]))) for side in rgb.shape[1::-1]]
        thumbnails.append(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
    write_picture(out, linear_to_srgb(_laid_out(thumbnails)), bits=8)


def _laid_out(thumbnails: list[np.ndarray]) -> np.ndarray:
    """Return the thumbnails in rows, on a sheet about one and a half times as wide as high."""
    height, width = (max(t.shape[axis] for t in thumbnails) + _GAP for axis in (0, 1))
    columns = max(1, round(np.sqrt(1.5 * len(thumbnails) * height / width)))
    rows = -(-len(thumbnails) // columns)
    sheet = np.full((rows * height + _GAP, columns * width + _GAP, 3), _PAPER, np.float32)
    for index, thumbnail in enumerate(thumbnails):
        y, x = (index // columns) * height + _GAP, (index % columns) * width + _GAP
        sheet[y:y + thumbnail.shape[0], x:x + thumbnail.shape[1]] = thumbnail
    return sheet
