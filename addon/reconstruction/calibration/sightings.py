# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From pictures of the board to its corners, in the pixels of every camera and projector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import ScanstageError
from ...progress import Progress, silent
from ..active.decoding import decode_view
from ..active.patterns import AXES
from ..scan import ProjectedPicture, View
from .board import LEAST_CORNERS, Board
from .camera import Sighting
from .projector import projector_corners

_MOST_NAMED = 8  # frames in one sentence


@dataclass(frozen=True)
class BoardView:
    """The board at rest before one camera.

    Parameters
    ----------
    placement : str
        Where it stands in the object frame: a frame's ``board_pose``.
    motion : (4, 4) array
        Where the turntable had the object frame in the world, as far as that is known beforehand.
    pose : str
        Id of placement and motion together.
    camera_id : str
    view : View
        With its pictures under patterns.
    """

    placement: str
    motion: np.ndarray
    pose: str
    camera_id: str
    view: View


@dataclass(frozen=True)
class Sightings:
    """What was found of the board.

    Parameters
    ----------
    found : tuple of Sighting
        Devices are called ``camera ID`` and ``projector ID``.
    not_found : tuple of str
        Frames in which the board is not found.
    warnings : tuple of str
    """

    found: tuple[Sighting, ...]
    not_found: tuple[str, ...]
    warnings: tuple[str, ...]


def find_sightings(board: Board, views: Sequence[BoardView], projector_sizes: Mapping[str, tuple[int, int]], *, window: float = 1.0,
                   progress: Progress = silent) -> Sightings:
    """Find the board in every view and, where a code is projected, carry its corners over into the projectors.

    Parameters
    ----------
    board : Board
    views : sequence of BoardView
    projector_sizes : mapping of str to (int, int)
        By the projectors' ids.
    window : float
        See `projector_corners`.
    progress : Progress

    Raises
    ------
    ScanstageError
        A camera sees the board nowhere, or a code cannot be decoded.
    """
    found: list[Sighting] = []
    not_found: list[str] = []
    lost: list[str] = []
    for number, shown in enumerate(views):
        progress(number / len(views), f"Board {number + 1} of {len(views)}")
        corners = board.find(shown.view.read_image())
        if corners is None:
            not_found.append(shown.view.name)
            continue
        own = Sighting(f"camera {shown.camera_id}", shown.pose, shown.view.name, *corners)
        found.append(own)
        for id, pictures in _by_projector(shown.view).items():
            lit = _lit(own, pictures, projector_sizes[id], f"projector {id}", window)
            if lit is None:
                lost.append(shown.view.name)
            elif not any((one.device, one.pose) == (lit.device, lit.pose) for one in found):  # another camera has said so
                found.append(lit)
    _refuse_unseen(board, views, {sighting.device for sighting in found})
    warnings = []
    if not_found:
        warnings.append(f"{frames_text(not_found)}: the board is not found; left out")
    if lost:
        warnings.append(f"{frames_text(lost)}: the code is decoded round fewer than {LEAST_CORNERS} corners of the board; left out for the "
                        "projector")
    return Sightings(tuple(found), tuple(not_found), tuple(warnings))


def frames_text(names: Sequence[str]) -> str:
    """Return frames by their names, as a sentence begins: ``frames 0001, 0002``."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"frame{'s' * (len(names) > 1)} {', '.join(names[:_MOST_NAMED])}{more}"


def _refuse_unseen(board: Board, views: Sequence[BoardView], seeing: set[str]) -> None:
    for id in dict.fromkeys(shown.camera_id for shown in views):
        if f"camera {id}" not in seeing:
            names = [shown.view.name for shown in views if shown.camera_id == id]
            raise ScanstageError(f"{frames_text(names)}: camera {id} shows the {board.kind} of {board.columns} x {board.rows} squares "
                                 "in none of them; check the board's kind and numbers (squares, one more than inner corners), and that it "
                                 "is whole, sharp, well lit and a good part of the picture, which takes enough pixels")


def _by_projector(view: View) -> dict[str, list[ProjectedPicture]]:
    """Return the pictures that carry a code, or belong to one, by the projector's id."""
    pictures: dict[str, list[ProjectedPicture]] = {}
    for picture in view.projected:
        if picture.projector_id is not None:
            pictures.setdefault(picture.projector_id, []).append(picture)
    return {id: own for id, own in pictures.items() if any(one.pattern.get("kind") in ("gray-code", "phase-shift") for one in own)}


def _lit(seen: Sighting, pictures: Sequence[ProjectedPicture], size: tuple[int, int], device: str, window: float) -> Sighting | None:
    """Return the corners in the projector's pixels, or None where too few can be carried over."""
    decoded = decode_view(pictures, size, where=f"frame {seen.name}")
    if missing := [axis for axis in AXES if axis not in decoded]:
        raise ScanstageError(f"frame {seen.name}: the code does not number the {missing[0]}s of {device}, and a calibration needs columns "
                             "and rows; project both")
    places = np.stack([np.where(decoded[axis].valid, decoded[axis].position, np.nan) for axis in AXES], axis=-1)
    known, pixels = projector_corners(seen.pixels, places, window)
    return Sighting(device, seen.pose, seen.name, seen.ids[known], pixels) if known.sum() >= LEAST_CORNERS else None
