# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A desk, a lamp and a stick, photographed by hand: for `calibrate`, and then for the method `desk-shadow`.

A folder of ``calib/`` (pictures of a checkerboard; on the first, by name, it lies on the desk) and of one other folder with the
frames of the sweep, in their names' order; and ``annotations.json`` with what cannot be seen by a program: ``chessboard_inner`` [columns,
rows] and ``square_mm``, the marks ``pencil_base_px`` and ``shadow_tip_px`` of pencils of ``pencil_height_mm``, and ``reference_rows_px``,
rows of the picture in which nothing but the desk is seen. Lengths stay in millimetres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...reconstruction.calibration.board import LEAST_SQUARES, MAX_SQUARES
from ...reconstruction.geometry import Light
from ..fields import Field, parse_json
from ..files import read_bytes
from ..schema import Frame, Pencils
from .board import CAMERA, read_board
from .sources import MAX_CALIBRATION_BYTES, Import, checked_size, own_file, pictures_in

NOTES, BOARDS, LAMP, SWEEP = "annotations.json", "calib", "lamp", "shadow"
_OTHERS = ("calib", "light")  # folders that hold no sweep
_HALF = 4  # rows on either side of a reference row


def read_desk(source: Path) -> Import:
    """Read a photographed desk; the camera, the lamp's place and the desk's plane are left to `calibrate`.

    Raises
    ------
    ScanstageError
        A file is not there, a note is not what it must be, or the frames differ in size from the board's.
    """
    notes = _notes(source)
    columns, rows = (side.integer(LEAST_SQUARES - 1, MAX_SQUARES - 1) + 1 for side in _pair(notes["chessboard_inner"]))
    boards = read_board(own_file(source, BOARDS), board="checkerboard", columns=columns, rows=rows,
                        square=notes["square_mm"].number(1e-6, 1e6), marker=0.0, dictionary="")
    first = boards.capture.frames[0].board_pose
    size = boards.capture.cameras[CAMERA].size
    frames = {f"images/{SWEEP}/{path.name}": path for path in _sweep(source)}
    for path in frames.values():
        if checked_size(path, str(source)) != size:
            raise ScanstageError(f"{path.name}: is not of the size of the board's pictures, {size[0]}x{size[1]}; take all with one camera")
    shots = tuple(Frame(f"{SWEEP}-{number:04d}", relative, CAMERA, lights=(LAMP,), pattern=SWEEP)
                  for number, relative in enumerate(frames))
    capture = replace(
        boards.capture, frames=boards.capture.frames + shots, lights={LAMP: Light("point", np.zeros(3))},
        patterns={SWEEP: {"kind": "shadow", "sweep": 0, "strips": _strips(notes["reference_rows_px"], size[1], first)}},
        pencils=Pencils(LAMP, CAMERA, first, notes["pencil_height_mm"].number(1e-6, 1e6), *(
            notes[name].numbers(len(notes["pencil_base_px"].items()), 2) for name in ("pencil_base_px", "shadow_tip_px"))))
    return Import(capture, {**boards.pictures, **frames})


def _notes(source: Path) -> Mapping[str, Field]:
    if not (source / NOTES).is_file():
        raise ScanstageError(f"{source}: has no {NOTES}; give the folder that holds it")
    fields = parse_json(read_bytes(own_file(source, NOTES), MAX_CALIBRATION_BYTES), NOTES).mapping()
    for name in ("chessboard_inner", "square_mm", "pencil_base_px", "shadow_tip_px", "pencil_height_mm", "reference_rows_px"):
        if name not in fields or not fields[name].given:
            raise ScanstageError(f"{NOTES}: {name}: is missing; add it")
    return fields


def _pair(field: Field) -> list[Field]:
    items = field.items()
    if len(items) != 2:
        raise field.error("must be [columns, rows]")
    return items


def _sweep(source: Path) -> list[Path]:
    folders = [item for item in source.iterdir() if item.is_dir() and item.name not in _OTHERS]
    if len(folders) != 1:
        raise ScanstageError(f"{source}: holds {len(folders)} folders beside {' and '.join(_OTHERS)}; leave one, with the "
                             "frames of the sweep")
    return pictures_in(own_file(source, folders[0].name))


def _strips(rows: Field, height: int, board_pose: str) -> list[dict[str, object]]:
    found = [row.integer(_HALF, height - _HALF) for row in rows.items()]
    if len(found) < 2:
        raise rows.error("must name at least 2 rows, before and behind the object")
    return [{"rows": [row - _HALF, row + _HALF], "board_pose": board_pose} for row in found]
