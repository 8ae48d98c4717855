# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder of pictures of a calibration board, moved by hand before one camera, for `calibrate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit
from ...reconstruction.calibration.board import DICTIONARIES, LEAST_SQUARES, MAX_SQUARES, Board
from ...reconstruction.geometry import Camera
from .sources import Import, assemble, common_size, pictures_in

BOARD_OPTIONS = (
    Option("board", "checkerboard", "The board's kind", choices={
        "checkerboard": "Black and white squares", "charuco": "Markers in the white squares: may be seen in part"}),
    Option("columns", 10, "Squares along one side, one more than the inner corners", minimum=LEAST_SQUARES, maximum=MAX_SQUARES),
    Option("rows", 7, "Squares along the other side", minimum=LEAST_SQUARES, maximum=MAX_SQUARES),
    Option("square", 0.025, "Side of a square", unit=Unit.LENGTH, minimum=1e-6, maximum=1e6),
    Option("marker", 0.018, "Side of a marker of a ChArUco board", unit=Unit.LENGTH, minimum=1e-6, maximum=1e6),
    Option("dictionary", "5X5_100", "Markers of a ChArUco board", choices=dict.fromkeys(DICTIONARIES, "as OpenCV names them")),
)
CAMERA = "camera"
_FOCAL = 1.2  # times the longer side: what most lenses have, until it is calibrated


def read_board(source: Path, *, board: str, columns: int, rows: int, square: float, marker: float, dictionary: str) -> Import:
    """Take each picture of a folder as one pose of the board.

    Raises
    ------
    ScanstageError
        There are no pictures, they differ in size, or there can be no such board.
    """
    if not source.is_dir():
        raise ScanstageError(f"{source}: is a file; give the folder of the board's pictures")
    try:
        shown = Board(board, columns, rows, square, *((marker, dictionary) if board == "charuco" else ()))
    except ValueError as error:
        raise ScanstageError(f"import board: {error}") from None
    pictures = pictures_in(source)
    size = common_size(pictures, str(source))
    (width, height), focal = size, _FOCAL * max(size)
    camera = Camera([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]], np.eye(3), np.zeros(3), size)
    found = assemble([(path, camera) for path in pictures])
    frames = tuple(replace(frame, camera=CAMERA, board_pose=frame.id) for frame in found.capture.frames)
    return replace(found, capture=replace(found.capture, cameras={CAMERA: camera}, frames=frames, board=shown))
