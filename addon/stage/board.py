# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The calibration board as an object: a flat picture whose own axes are the board's, so that its pose is the board's pose."""

from __future__ import annotations

import json
from dataclasses import asdict

import bpy
import numpy as np

from ..reconstruction.calibration.board import Board
from . import ownership
from .materials import printed

_BOARD = "scanstage_board"
_MARGIN = 0.5  # of white round the squares, in squares: detectors need it
_PAPER, _INK = 0.9, 0.04  # albedo of white and black


def add_board(stage: bpy.types.Collection, turntable: bpy.types.Object, board: Board, pixels_per_square: int) -> bpy.types.Object:
    """Add a board that the turntable carries.

    Parameters
    ----------
    stage : bpy.types.Collection
    turntable : bpy.types.Object
    board : Board
    pixels_per_square : int
        Even. Between its pixels the board's picture is blended: about as fine as the camera's, it gives edges as soft as a
        lens does, which at one sample a pixel nothing else would.
    """
    picture = board.draw(pixels_per_square, _MARGIN)
    x, y = outline(board).T
    mesh = bpy.data.meshes.new("Scanstage Board")
    mesh.from_pydata(np.column_stack((x, y, np.zeros(4))).tolist(), [], [(0, 1, 2, 3)])
    corners = mesh.uv_layers.new(name="Board").data
    corners.foreach_set("uv", [0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0])
    mesh.materials.append(printed("Scanstage Board", _image(picture), _INK, _PAPER))
    made = ownership.add(stage, "Scanstage Board", mesh, "board")
    made.parent = turntable
    made[_BOARD] = json.dumps(asdict(board))
    return made


def board_of(candidate: bpy.types.Object) -> Board:
    """Return what a board is, with its sizes in the world: the object may have been scaled."""
    board = Board(**json.loads(candidate[_BOARD]))
    scale = float(np.linalg.norm(np.array(candidate.matrix_world)[:3, 0]))
    return board if abs(scale - 1) < 1e-6 else Board(board.kind, board.columns, board.rows, board.square * scale, board.marker * scale,
                                                     board.dictionary)


def outline(board: Board) -> np.ndarray:
    """Return the (4, 2) outer corners of the board's picture in its own frame: top left, bottom left, bottom right, top right."""
    lower = -(1 + _MARGIN)
    right, bottom = board.columns - 1 + _MARGIN, board.rows - 1 + _MARGIN
    return board.square * np.array([(lower, lower), (lower, bottom), (right, bottom), (right, lower)])


def _image(picture: np.ndarray) -> bpy.types.Image:
    height, width = picture.shape
    image = ownership.mark(bpy.data.images.new("Scanstage Board", width, height, is_data=True))
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = picture[::-1, :, None] / 255
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image
