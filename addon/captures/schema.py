# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a capture set says: devices, frames, encoding, working volume; to and from the JSON of `capture.json`.

Poses are stored as a calibrated rig knows them: each device's pose in the world as the rig stands, and for each frame
the motion ``object_to_world`` of the turntable. `Capture.camera_of` turns them into the object frame.

Frames for `calibrate` show the set's ``board`` (columns and rows count squares, lengths are the scene's)::

    "board": {"kind": "charuco", "columns": 10, "rows": 7, "square": 0.03, "marker": 0.022, "dictionary": "5X5_100"},
    "frames": [{"id": "0001", "board_pose": "free-01", ...}, ...]

``board_pose`` names a place of the board in the object frame. Frames of one name and one ``object_to_world`` show the board
at rest, whatever is projected: a white picture and a Gray code, say. A board that is moved by hand has a new name at each
pose; one that stands on the turntable keeps its name while ``object_to_world`` turns. A frame without is of the object. The
devices of such a set hold what is known beforehand (or the truth, where rendered): of them `calibrate` uses the sizes only,
and the first camera's pose, which says where the world is. A light is found from `Pencils`, a laser's plane where its pattern
crosses the board.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import PurePosixPath

import numpy as np

from ..options import Value
from ..reconstruction.calibration.board import DICTIONARIES, KINDS, MAX_SQUARES, Board
from ..reconstruction.geometry import MAX_SKEW_OF_ROTATION, Camera, Light
from .fields import MAX_NUMBER, Field

FORMAT, VERSION = "scanstage-capture", 1
FILE_NAME = "capture.json"
ENCODINGS = ("linear", "srgb")
LIGHT_KINDS = ("point", "sun", "spot")
MAX_SIDE, MAX_PIXELS = 1 << 16, 1 << 28
FRAME_ID = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}")  # it becomes a file's name, on every system


@dataclass(frozen=True)
class Frame:
    """One picture of the set.

    Parameters
    ----------
    id : str
        Letters, digits, ``._-``; unique in the set also where capitals do not count.
    image : str
        The picture's path inside the set, with forward slashes.
    camera : str
        Id of the camera that took it.
    object_to_world : (4, 4) array
        The rigid motion of the turntable: where the object frame stands in the world.
    lights : tuple of str
        Ids of the lights that are on.
    pattern : str, optional
        Id of the pattern that is projected.
    mask : str, optional
        Path inside the set of a silhouette that came with the picture.
    board_pose : str, optional
        Id of the place in the object frame where the calibration board stands; None where the picture is of the object.
    contours : str, optional
        Path inside the set of the silhouette as outlines (see `contour_file`); they come before a mask.
    """

    id: str
    image: str
    camera: str
    object_to_world: np.ndarray = field(default_factory=lambda: np.eye(4))
    lights: tuple[str, ...] = ()
    pattern: str | None = None
    mask: str | None = None
    board_pose: str | None = None
    contours: str | None = None


@dataclass(frozen=True)
class Pencils:
    """Marks of pencils that stood on the plane where the board lay, and of their shadows: they tell where a light is.

    Parameters
    ----------
    light : str
        Id of the light, a point or spot.
    camera : str
        Id of the camera in whose pictures the marks are.
    board_pose : str
        Id of the place of the board whose plane it was.
    height : float
        Of the pencils.
    bases, shadow_tips : (n, 2) arrays
        Pixels: where each stands, and where its tip's shadow ends.
    """

    light: str
    camera: str
    board_pose: str
    height: float
    bases: np.ndarray
    shadow_tips: np.ndarray


@dataclass(frozen=True)
class Capture:
    """A capture set.

    Parameters
    ----------
    cameras, projectors : mapping of str to Camera
        In the world, as the rig stands.
    frames : tuple of Frame
        At least one, in the order of capture.
    encoding : str
        How the pictures' values stand for light: ``linear`` or ``srgb``.
    lights : mapping of str to Light
    patterns : mapping of str to mapping
        What each projected pattern is, as the method that made it describes it.
    silhouette : mapping of str to value
        Defaults of this set for `addon.reconstruction.silhouettes.SILHOUETTE_OPTIONS`.
    plates : mapping of str to str
        Per camera, the picture of the scene without the object.
    bounds : (2, 3) array, optional
        Lower and upper corner of the working volume in the object frame.
    truth_mesh : str, optional
        Path inside the set of the true object, in the object frame.
    board : Board, optional
        The calibration board that the frames with a ``board_pose`` show.
    pencils : Pencils, optional
    missing : tuple of str
        Ids of the frames that are not yet rendered.
    generator : str
        The program that wrote the set.
    """

    cameras: Mapping[str, Camera]
    frames: tuple[Frame, ...]
    encoding: str = "linear"
    projectors: Mapping[str, Camera] = field(default_factory=dict)
    lights: Mapping[str, Light] = field(default_factory=dict)
    patterns: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    silhouette: Mapping[str, Value] = field(default_factory=dict)
    plates: Mapping[str, str] = field(default_factory=dict)
    bounds: np.ndarray | None = None
    truth_mesh: str | None = None
    board: Board | None = None
    pencils: Pencils | None = None
    missing: tuple[str, ...] = ()
    generator: str = "scanstage"

    def camera_of(self, frame: Frame) -> Camera:
        """Return the camera that took ``frame``, in the object frame."""
        return self.cameras[frame.camera].moved(frame.object_to_world)

    def with_missing(self, missing) -> Capture:
        """Return the same set with other frames not yet rendered."""
        return replace(self, missing=tuple(missing))


def capture_to_dict(capture: Capture) -> dict[str, object]:
    """Return the capture set as the JSON object of `capture.json`."""
    return {
        "format": FORMAT, "version": VERSION, "generator": capture.generator,
        "devices": {"cameras": {id: _camera_to_dict(camera) for id, camera in capture.cameras.items()},
                    "projectors": {id: _camera_to_dict(camera) for id, camera in capture.projectors.items()},
                    "lights": {id: _light_to_dict(light) for id, light in capture.lights.items()}},
        "frames": [{"id": frame.id, "image": frame.image, "camera": frame.camera,
                    "object_to_world": np.asarray(frame.object_to_world, float).tolist(),
                    "lights": list(frame.lights), "pattern": frame.pattern, "mask": frame.mask,
                    "board_pose": frame.board_pose, "contours": frame.contours}
                   for frame in capture.frames],
        "patterns": {id: dict(pattern) for id, pattern in capture.patterns.items()},
        "encoding": capture.encoding,
        "silhouette": dict(capture.silhouette),
        "plate": dict(capture.plates) or None,
        "bounds": None if capture.bounds is None else np.asarray(capture.bounds, float).tolist(),
        "truth": None if capture.truth_mesh is None else {"mesh": capture.truth_mesh},
        "board": None if capture.board is None else asdict(capture.board),
        "pencils": None if capture.pencils is None else {
            name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(capture.pencils).items()},
        "missing": list(capture.missing),
    }


def _camera_to_dict(camera: Camera) -> dict[str, object]:
    return {"size": list(camera.size), "K": camera.K.tolist(), "distortion": camera.distortion.tolist(),
            "R": camera.R.tolist(), "t": camera.t.tolist(), "mirrored": camera.mirrored}


def _light_to_dict(light: Light) -> dict[str, object]:
    vectors = {name: None if value is None else np.asarray(value, float).tolist()
               for name, value in (("position", light.position), ("direction", light.direction))}
    return {"kind": light.kind, **vectors, "radius": light.radius}


def capture_from_field(document: Field) -> Capture:
    """Return the capture set that a document holds.

    Raises
    ------
    ScanstageError
        Anything in it is absent, of another type, not finite, contradictory or not known.
    """
    version = document.value.get("version") if isinstance(document.value, dict) else None
    top = document.object(("format", "version", "devices", "frames", "encoding"),
                          ("generator", "patterns", "silhouette", "plate", "bounds", "truth", "board", "pencils", "missing")
                          if version in (None, VERSION) else document.value)
    if top["format"].value != FORMAT:
        raise top["format"].error(f"must be {FORMAT!r}; check that this is a capture set")
    if type(version) is not int or version != VERSION:
        raise top["version"].error(f"must be {VERSION}; this set was written for another version of Scanstage")
    devices = top["devices"].object(("cameras",), ("projectors", "lights"))
    cameras = {id: _camera(item) for id, item in devices["cameras"].mapping().items()}
    lights = {id: _light(item) for id, item in devices["lights"].mapping().items()}
    patterns = {id: _json_object(item) for id, item in top["patterns"].mapping().items()}
    board = _board(top["board"]) if top["board"].given else None
    frames = _frames(top["frames"], cameras, lights, patterns, board)
    ids = {frame.id for frame in frames}
    return Capture(
        cameras=cameras, frames=frames, lights=lights, patterns=patterns,
        projectors={id: _camera(item) for id, item in devices["projectors"].mapping().items()},
        encoding=top["encoding"].choice(ENCODINGS, "an encoding"),
        silhouette={name: _option(item) for name, item in top["silhouette"].mapping(100).items()},
        plates=_plates(top["plate"], cameras),
        bounds=_bounds(top["bounds"]) if top["bounds"].given else None,
        truth_mesh=relative_path(top["truth"].object(("mesh",))["mesh"]) if top["truth"].given else None,
        board=board,
        pencils=_pencils(top["pencils"], cameras, lights, frames) if top["pencils"].given else None,
        missing=tuple(item.choice(ids, "a frame") for item in top["missing"].items()),
        generator=top["generator"].text() if top["generator"].given else "unknown")


def relative_path(item: Field) -> str:
    """Return a path that stays inside the set, by its text alone (links are checked where it is opened)."""
    text = item.text()
    if "\\" in text or ":" in text or PurePosixPath(text).is_absolute() or ".." in PurePosixPath(text).parts \
            or not PurePosixPath(text).name:
        raise item.error(f"{text[:200]!r} leaves the capture set; use a path inside its folder, with forward slashes")
    return text


def _camera(item: Field) -> Camera:
    fields = item.object(("size", "K", "R", "t"), ("distortion", "mirrored"))
    sides = fields["size"].items(2)
    if len(sides) != 2:
        raise fields["size"].error("must be [width, height]")
    width, height = (side.integer(1, MAX_SIDE) for side in sides)
    if width * height > MAX_PIXELS:
        raise fields["size"].error(f"{width}x{height} is more than {MAX_PIXELS} pixels; use smaller pictures")
    matrices = {"K": fields["K"].numbers(3, 3), "R": fields["R"].numbers(3, 3), "t": fields["t"].numbers(3)}
    if fields["distortion"].given:
        matrices["distortion"] = fields["distortion"].numbers(5)
    try:
        camera = Camera(size=(width, height), **matrices)
    except ValueError as error:  # its message begins with the field's name
        name, _, problem = str(error).partition(" ")
        raise fields[name].error(f"{problem}; correct the calibration") from None
    if camera.mirrored != fields["mirrored"].boolean():
        raise fields["R"].error("is not a rotation: its determinant is -1; correct it, or set \"mirrored\": true where "
                                "the calibration is of a mirrored world" if camera.mirrored else
                                "is a rotation although \"mirrored\" is true; set it to false")
    return camera


def _light(item: Field) -> Light:
    fields = item.object(("kind",), ("position", "direction", "radius"))
    kind = fields["kind"].choice(LIGHT_KINDS, "a kind of light")
    for name in {"point": ("position",), "sun": ("direction",), "spot": ("position", "direction")}[kind]:
        if not fields[name].given:
            raise fields[name].error(f"is missing; a {kind} light has one")
    direction = fields["direction"].numbers(3) if fields["direction"].given else None
    if direction is not None and not abs(np.linalg.norm(direction) - 1) < 1e-3:
        raise fields["direction"].error("must be a unit vector")
    return Light(kind, fields["position"].numbers(3) if fields["position"].given else None, direction,
                 fields["radius"].number(0.0) if fields["radius"].given else 0.0)


def _board(item: Field) -> Board:
    fields = item.object(("kind", "columns", "rows", "square"), ("marker", "dictionary"))
    values = {"kind": fields["kind"].choice(KINDS, "a kind of board"), "square": fields["square"].number(0.0)}
    values |= {name: fields[name].integer(1, MAX_SQUARES) for name in ("columns", "rows")}
    if fields["marker"].given:
        values["marker"] = fields["marker"].number(0.0)
    if fields["dictionary"].given:
        values["dictionary"] = fields["dictionary"].choice(DICTIONARIES, "a dictionary of markers")
    try:
        return Board(**values)
    except ValueError as error:  # its message begins with the field's name
        name, _, problem = str(error).partition(" ")
        raise fields[name].error(f"{problem}; correct the board") from None


def _pencils(item: Field, cameras: Mapping, lights: Mapping, frames: tuple[Frame, ...]) -> Pencils:
    fields = item.object(("light", "camera", "board_pose", "height", "bases", "shadow_tips"))
    placed = [id for id, light in lights.items() if light.position is not None]
    poses = {frame.board_pose for frame in frames} - {None}
    bases, tips = ([place.numbers(2) for place in fields[name].items(1000)] for name in ("bases", "shadow_tips"))
    if len(bases) != len(tips):
        raise fields["shadow_tips"].error(f"has {len(tips)} marks and bases {len(bases)}; mark both of each pencil")
    return Pencils(fields["light"].choice(placed, "a point or spot light of this set"),
                   fields["camera"].choice(cameras, "a camera of this set"), fields["board_pose"].choice(poses, "a board_pose of a frame"),
                   fields["height"].number(0.0), np.reshape(bases, (-1, 2)), np.reshape(tips, (-1, 2)))


def _frames(item: Field, cameras: Mapping, lights: Mapping, patterns: Mapping, board: Board | None) -> tuple[Frame, ...]:
    frames, seen = [], {}
    for index, entry in enumerate(item.items()):
        fields = entry.object(("id", "image", "camera"), ("object_to_world", "lights", "pattern", "mask", "board_pose", "contours"))
        id = fields["id"].text()
        if not FRAME_ID.fullmatch(id):
            raise fields["id"].error(f"{id[:40]!r} cannot be a file's name; use letters, digits and ._-")
        if seen.setdefault(id.casefold(), index) != index:
            raise fields["id"].error(f"{id!r} is also the id of frames[{seen[id.casefold()]}]; make ids unique")
        motion, board_pose = fields["object_to_world"], fields["board_pose"]
        if board_pose.given and board is None:
            raise board_pose.error("names a place of the board, but the set has none; add board at the top")
        frames.append(Frame(
            id, relative_path(fields["image"]), fields["camera"].choice(cameras, "a camera of this set"),
            _motion(motion) if motion.given else np.eye(4),
            tuple(light.choice(lights, "a light of this set") for light in fields["lights"].items()),
            fields["pattern"].choice(patterns, "a pattern of this set") if fields["pattern"].given else None,
            relative_path(fields["mask"]) if fields["mask"].given else None,
            board_pose.text() if board_pose.given else None,
            relative_path(fields["contours"]) if fields["contours"].given else None))
    if not frames:
        raise item.error("is empty; capture at least one frame")
    return tuple(frames)


def _motion(item: Field) -> np.ndarray:
    motion = item.numbers(4, 4)
    rotation = motion[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > MAX_SKEW_OF_ROTATION or np.linalg.det(rotation) < 0:
        raise item.error("is not a rigid motion: its upper left 3x3 part must be a rotation")
    if np.abs(motion[3] - (0, 0, 0, 1)).max() > 0:
        raise item.error("is not a rigid motion: its last row must be 0 0 0 1")
    return motion


def _bounds(item: Field) -> np.ndarray:
    bounds = item.numbers(2, 3)
    if not (bounds[0] < bounds[1]).all():
        raise item.error("has no volume: every upper bound must be greater than its lower bound")
    return bounds


def _plates(item: Field, cameras: Mapping) -> dict[str, str]:
    plates = {}
    for id, path in item.mapping().items():
        if id not in cameras:
            raise path.error(f"{id!r} is not a camera of this set")
        plates[id] = relative_path(path)
    return plates


def _option(item: Field) -> Value:
    # Names and bounds are the option table's to check, which an older or newer set may not share in full.
    if type(item.value) in (bool, str):
        return item.value if isinstance(item.value, bool) else item.text()
    return item.integer(-int(MAX_NUMBER), int(MAX_NUMBER)) if type(item.value) is int else item.number()


def _json_object(item: Field) -> dict[str, object]:
    item.mapping()
    try:
        json.dumps(item.value, allow_nan=False)
    except ValueError:
        raise item.error("holds a number that is not finite; correct it") from None
    return item.value
