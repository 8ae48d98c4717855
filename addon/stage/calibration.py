# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig that calibrates another: a board in many poses before its devices, then lying on a turning table.

At each pose by hand every camera has a frame under its headlight, and the first one then sees a Gray code of columns and rows;
at each pose of the table it has the first of these alone. The devices are placed as for an object as large as the board.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ..errors import ScanstageError
from ..options import Option, Unit, Value
from ..reconstruction.active.patterns import Pattern, make_patterns
from ..reconstruction.calibration.board import DICTIONARIES, KINDS, LEAST_SQUARES, MAX_SQUARES, Board
from ..reconstruction.geometry import Camera, rotation_about
from . import devices, projection, rig, scanner
from .board import add_board, outline
from .objects import Subject
from .readback import camera_of, projector_of
from .timeline import bind_cameras, keyframe_steps, switch_light

_MARKER = 0.75  # side of a marker in squares: the six cells of a 4x4 marker are then an eighth of a square each
_CELLS = 8  # so that cells are whole pixels of the board's picture
_SOFTNESS = 1.4  # pixels of the camera, over which the edges of squares are blended
_TILTS = math.radians(15), math.radians(40)  # less couples focal length and distance, more shortens the squares
_ROLL = math.radians(25)
_NEARER, _FARTHER = -0.12, 0.12  # of the distance
_ASIDE = 0.25  # of the distance, the most; what leaves a picture is drawn back
_GOLDEN = math.pi * (3 - math.sqrt(5))  # turns that never repeat
_CLEAR = 0.02  # of the picture, kept free on each side
_EXPOSED = 0.75  # of the distance: a white surface there is white, and none comes nearer
OPTIONS = (
    Option("board", "charuco", "What is on the board", choices={
        "charuco": "a checkerboard with markers: found also where it is partly hidden",
        "checkerboard": "a plain checkerboard: must be seen whole"}),
    Option("columns", 10, "Squares along the board", minimum=LEAST_SQUARES, maximum=MAX_SQUARES),
    Option("rows", 7, "Squares down the board", minimum=LEAST_SQUARES, maximum=MAX_SQUARES),
    Option("square", 0.02, "Side of a square", unit=Unit.LENGTH, minimum=1e-6, maximum=1e3),
    Option("poses", 15, "Poses of the board by hand, each under the whole Gray code", minimum=1, maximum=200),
    Option("turns", 12, "Poses of the board on the turning table, evenly round the circle; 0 leaves the table's axis uncalibrated",
           minimum=0, maximum=360),
    Option("projector", True, "Calibrate a projector, too: show a Gray code at each pose by hand"),
    Option("cameras", 1, "How many cameras: a second one stands as far to the left as the projector to the right", minimum=1, maximum=2),
    Option("elevation", math.radians(45), "How high above the table's plane the devices stand: the board on the table must be seen",
           unit=Unit.ANGLE, minimum=math.radians(15), maximum=math.radians(85)),
    scanner.ANGLE,
    *scanner.PROJECTOR_OPTIONS,
    *rig.CAMERA_OPTIONS,
    rig.SAMPLES,
)
assert set(OPTIONS[0].choices) == set(KINDS)


def build(scene: bpy.types.Scene, stage: bpy.types.Collection, subject: Subject, options: Mapping[str, Value]) -> None:
    """Fill the stage's collection and plan the timeline; the board stands in the place of any subject.

    Raises
    ------
    ScanstageError
        There is no such board, or the distance cannot be used.
    """
    board = _board(options)
    patterns = make_patterns("gray-code", (options["projector_x"], options["projector_y"])) if options["projector"] else ()
    shots = _shots(options, len(patterns))
    rig.apply_settings(scene, options, frames=len(shots), transparent=True, persistent=True)
    turntable = devices.add_turntable(stage)
    turntable.empty_display_size = float(np.ptp(outline(board), axis=0).max())
    distance, seen_by = _add_devices(scene, stage, board, patterns, shots, options)
    square = board.square * seen_by[0].K[0, 0] / distance  # in pixels
    made = add_board(stage, turntable, board, _CELLS * max(round(square / _SOFTNESS / _CELLS), 1))
    _move(made, [*board_places(board, seen_by, distance, options["poses"]), _lying(board)], shots)
    turns = options["turns"]
    angles = [0.0] * (len(shots) - turns) + [2 * math.pi * turn / turns for turn in range(turns)]
    keyframe_steps(turntable, "rotation_euler", angles, index=2)


@dataclass(frozen=True)
class _Shot:
    """A frame: the board's place, where the last one is on the table, the number of the camera, and that of the pattern."""

    place: int
    camera: int = 0
    pattern: int | None = None


def _shots(options: Mapping[str, Value], patterns: int) -> list[_Shot]:
    by_hand = [_Shot(place, camera, pattern) for place in range(options["poses"]) for camera in range(options["cameras"])
               for pattern in (None, *range(0 if camera else patterns))]
    return by_hand + [_Shot(options["poses"])] * options["turns"]


def _add_devices(scene: bpy.types.Scene, stage: bpy.types.Collection, board: Board, patterns: Sequence[Pattern],
                 shots: Sequence[_Shot], options: Mapping[str, Value]) -> tuple[float, list[Camera]]:
    """Add cameras with headlights and the projector, and plan them; return the cameras' distance, and all devices as they stand."""
    centre, elevation = np.zeros(3), options["elevation"]
    points = _ball(float(np.linalg.norm(np.ptp(outline(board), axis=0))) / 2)
    cameras = rig.add_cameras(stage, options["cameras"], options)
    distance = rig.place_cameras(scene, cameras, [elevation] * len(cameras), points, centre, options["distance"])
    for camera in cameras[1:]:
        devices.aim(camera, rig.offset_of(distance, elevation, -options["angle"]), centre)
    bind_cameras(scene, [cameras[shot.camera] for shot in shots])
    for i, camera in enumerate(cameras):
        light = devices.add_light(stage, camera, 1 + i, _EXPOSED * distance)
        switch_light(light.data, [float(shot.camera == i and shot.pattern is None) for shot in shots])
    projectors = []
    if patterns:
        projectors.append(scanner.add_fitting_projector(stage, points, centre, options))
        projection.show_patterns(projectors[0].data, patterns, [shot.pattern for shot in shots])
    bpy.context.view_layer.update()
    return distance, [*(camera_of(scene, camera) for camera in cameras), *(projector_of(scene, lamp) for lamp in projectors)]


def board_places(board: Board, seen_by: list[Camera], distance: float, count: int) -> list[np.ndarray]:
    """Return poses of a board, tilted all differently and spread over the pictures of all devices.

    Parameters
    ----------
    board : Board
    seen_by : list of Camera
        All look at the origin; the board stays in the pictures of all of them.
    distance : float
        Of the first of them.
    count : int

    Returns
    -------
    list of (4, 4) array
        Board to world.
    """
    toward = np.mean([device.forward for device in seen_by], axis=0)
    right = seen_by[0].R[0]
    right = right - (right @ toward) * toward / (toward @ toward)
    facing = np.column_stack((right, np.cross(toward, right), toward))
    facing /= np.linalg.norm(facing, axis=0)
    corners = np.column_stack((outline(board), np.zeros(4)))
    places = []
    for index in range(count):
        # Low-discrepancy numbers: any count of poses covers tilts, rolls and places evenly.
        tilt, roll, nearer, across, down = (((index + 0.5) * step) % 1 for step in (0.7548777, 0.5698403, 0.4301597, 0.8191725, 0.6710436))
        turn = index * _GOLDEN
        axis = np.array((math.cos(turn), math.sin(turn), 0.0))
        rotation = facing @ rotation_about(axis, np.interp(tilt, (0, 1), _TILTS)) @ rotation_about((0, 0, 1), (2 * roll - 1) * _ROLL)
        middle = facing @ (_ASIDE * (2 * across - 1), _ASIDE * (2 * down - 1), np.interp(nearer, (0, 1), (_NEARER, _FARTHER))) * distance
        for share in np.linspace(1, 0, 11):
            place = _motion(rotation, share * middle - rotation @ corners.mean(axis=0))
            if all(_sees(device, corners @ rotation.T + place[:3, 3]) for device in seen_by):
                break
        places.append(place)
    return places


def _board(options: Mapping[str, Value]) -> Board:
    columns, rows, square = options["columns"], options["rows"], options["square"]
    needed = columns * rows // 2
    fitting = [name for name in DICTIONARIES if name.startswith("4X4") and int(name.split("_")[1]) >= needed]
    if options["board"] == "charuco" and not fitting:
        raise ScanstageError(f"option columns: a board of {columns}x{rows} squares needs {needed} markers, more than there are; "
                             "use fewer squares, or a checkerboard")
    if options["board"] == "checkerboard":
        return Board("checkerboard", columns, rows, square)
    return Board("charuco", columns, rows, square, _MARKER * square, fitting[0])


def _ball(radius: float) -> np.ndarray:
    """Return points about the origin that reach as far as a board of this half diagonal, however it is held."""
    steps = np.linspace(0, math.pi, 33)
    around, polar = np.meshgrid(2 * steps, steps)
    return radius * np.stack((np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)), -1).reshape(-1, 3)


def _sees(device: Camera, points: np.ndarray) -> bool:
    pixels, depth = device.project(points)
    share = (pixels + 0.5) / device.size
    return bool((depth > 0).all() and share.min() > _CLEAR and share.max() < 1 - _CLEAR)


def _lying(board: Board) -> np.ndarray:
    """Return the pose of a board that lies on the table, its middle on the axis, as the camera reads it."""
    rotation = np.diag((1.0, -1.0, -1.0))
    return _motion(rotation, -rotation @ (*outline(board).mean(axis=0), 0.0))


def _motion(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, translation
    return motion


def _move(made: bpy.types.Object, places: list[np.ndarray], shots: list[_Shot]) -> None:
    made.rotation_mode = "QUATERNION"
    parts = [Matrix(motion.tolist()).decompose() for motion in places]
    for path, values in (("location", [part[0] for part in parts]), ("rotation_quaternion", [part[1] for part in parts])):
        for axis in range(len(values[0])):
            keyframe_steps(made, path, [values[shot.place][axis] for shot in shots], index=axis)
