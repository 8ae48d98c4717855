# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads a scene back as numbers: exact cameras, the capture plan on the timeline, the true object.

The scene is the only source: what the user moves, keys or adds after staging is in the plan.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from ..errors import ScanstageError
from ..reconstruction.calibration.board import Board
from ..reconstruction.geometry import Camera, Light
from . import ownership
from .board import board_of
from .evaluated import render_mesh
from .laser import is_laser, laser_fields
from .projection import pattern_of
from .projector import is_projector, optics_of
from .stick import stick_fields
from .timeline import light_is_on

_TO_OPENCV = np.diag((1.0, -1.0, -1.0))  # Blender's cameras look along -z with y up
_LIGHT_KINDS = {"POINT": "point", "SUN": "sun", "SPOT": "spot"}


@dataclass(frozen=True)
class PlannedFrame:
    """One capture: a frame of the timeline.

    Parameters
    ----------
    number : int
        The frame of the timeline.
    camera : str
        Id of the camera.
    object_to_world : (4, 4) array
        Where the object frame stands in the world: rigid.
    lights : tuple of str
        Ids of the lights that are on.
    pattern : str, optional
        Id of the pattern that is projected.
    board_pose : str, optional
        Id of the place where the calibration board stands; None where there is no board.
    """

    number: int
    camera: str
    object_to_world: np.ndarray
    lights: tuple[str, ...]
    pattern: str | None = None
    board_pose: str | None = None

    @property
    def id(self) -> str:
        """The frame's id in a capture set, which is also how Blender numbers its file."""
        return f"{self.number:04d}"


@dataclass(frozen=True)
class CapturePlan:
    """What the timeline captures.

    Parameters
    ----------
    cameras : mapping of str to Camera
        In the world. A camera object that moves during the plan is one device for each of its poses.
    lights : mapping of str to Light
    frames : tuple of PlannedFrame
    projectors : mapping of str to Camera
        In the world; those that shine in any frame. One that moves is one device for each of its poses, as a camera is.
    patterns : mapping of str to mapping
        What each pattern is, in the fields of `addon.reconstruction.active.patterns`, with the id of its ``projector``.
    board : Board, optional
        The calibration board that the frames show.
    """

    cameras: Mapping[str, Camera]
    lights: Mapping[str, Light]
    frames: tuple[PlannedFrame, ...]
    projectors: Mapping[str, Camera] = field(default_factory=dict)
    patterns: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    board: Board | None = None


def camera_of(scene: bpy.types.Scene, camera_object: bpy.types.Object) -> Camera:
    """Return a camera as it stands in the world at the present frame.

    Parameters
    ----------
    scene : bpy.types.Scene
        Its resolution, percentage and pixel aspect shape the picture.
    camera_object : bpy.types.Object

    Returns
    -------
    Camera
        With integer pixel centres: half a pixel less than Blender's own coordinates, whose origin is the corner of
        the top-left pixel.

    Raises
    ------
    ScanstageError
        It is not a perspective camera.
    """
    data, render = camera_object.data, scene.render
    if camera_object.type != "CAMERA" or data.type != "PERSP":
        raise ScanstageError(f"camera {camera_object.name!r} is not a perspective camera: set its lens type to "
                             "Perspective")
    width, height = (int(n * render.resolution_percentage / 100) for n in (render.resolution_x, render.resolution_y))
    aspect = render.pixel_aspect_y / render.pixel_aspect_x
    fit = data.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width >= height * aspect else "VERTICAL"
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    across = width if fit == "HORIZONTAL" else height * aspect  # what the sensor's size spans, in pixel widths
    fx = data.lens / sensor * across
    K = [[fx, 0, width / 2 - data.shift_x * across - 0.5],
         [0, fx / aspect, height / 2 + data.shift_y * across / aspect - 0.5],
         [0, 0, 1]]
    world = np.array(camera_object.matrix_world)
    R = _TO_OPENCV @ _rotation(world).T
    return Camera(K, R, -R @ world[:3, 3], (width, height))


def projector_of(scene: bpy.types.Scene, projector_object: bpy.types.Object) -> Camera:
    """Return a projector as it stands in the world at the present frame: the camera that it is, run backwards.

    Parameters
    ----------
    scene : bpy.types.Scene
        For the error message; a projector's picture is its own.
    projector_object : bpy.types.Object

    Raises
    ------
    ScanstageError
        It is no projector.
    """
    if not is_projector(projector_object):
        raise ScanstageError(f"{projector_object.name!r} in scene {scene.name!r} is not a projector: add one, or build a rig with one")
    world = np.array(projector_object.matrix_world)
    R = _TO_OPENCV @ _rotation(world).T
    return replace(optics_of(projector_object.data), R=R, t=-R @ world[:3, 3])


def light_of(light_object: bpy.types.Object) -> Light:
    """Return a light as it stands in the world at the present frame.

    Raises
    ------
    ScanstageError
        It is an area light.
    """
    data = light_object.data
    if data.type not in _LIGHT_KINDS:
        raise ScanstageError(f"light {light_object.name!r} is an area light, which no method can use: make it a point, "
                             "spot or sun light, or hide it from renders")
    world = np.array(light_object.matrix_world)
    radius = 0.0 if data.type == "SUN" else data.shadow_soft_size
    return Light(_LIGHT_KINDS[data.type], world[:3, 3], -_rotation(world)[:, 2], radius)


def plan_of(scene: bpy.types.Scene) -> CapturePlan:
    """Return the plan that the scene's timeline holds. The current frame is what it was, afterwards.

    Raises
    ------
    ScanstageError
        The scene has no stage, a frame has no camera or several patterns at once, or a device cannot be described.
    """
    if scene != bpy.context.scene:
        raise ValueError("only the context's scene is evaluated: the plan of another cannot be read")
    turntable, board = turntable_of(scene), _board(scene)
    cameras, lights, projectors, patterns, places, frames = *(_Devices() for _ in range(5)), []
    with frame_kept(scene):
        for number in range(scene.frame_start, scene.frame_end + 1, scene.frame_step):
            scene.frame_set(number)
            if scene.camera is None:
                raise ScanstageError(f"frame {number} of scene {scene.name!r} has no camera: set the scene's camera")
            camera = cameras.id_of(scene.camera, camera_of(scene, scene.camera))
            lit = tuple(lights.id_of(o, light_of(o)) for o in _lights_on(scene))
            place = None if board is None else places.id_by_name("pose", board, np.array(board.matrix_basis).tobytes())
            frames.append(PlannedFrame(number, camera, rigid_motion(turntable), lit, _shown(scene, projectors, patterns), place))
    return CapturePlan(cameras.found, lights.found, tuple(frames), projectors.found, patterns.found, board and board_of(board))


def truth_mesh(scene: bpy.types.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the staged object as renders see it.

    Returns
    -------
    vertices : (n, 3) float64 array
        In the object frame: the turntable's frame at angle 0.
    triangles : (m, 3) int32 array
        Counter-clockwise seen from outside.

    Raises
    ------
    ScanstageError
        The scene has no stage, or the staged object has no faces.
    """
    turntable = turntable_of(scene)
    with frame_kept(scene):
        scene.frame_set(scene.frame_start)
        vertices, triangles = render_mesh(scene, staged_objects(scene))
        motion = rigid_motion(turntable)
    if not len(triangles):
        raise ScanstageError(f"the staged object of scene {scene.name!r} has no faces that are rendered: "
                             "show it in renders, or stage another object")
    return (vertices - motion[:3, 3]) @ motion[:3, :3], triangles


def staged_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the objects that stand on the turntable, with their children."""
    stage = ownership.require_stage(scene)
    roots = [*ownership.with_role(stage, "object"), *ownership.attached(turntable_of(scene))]
    return list(dict.fromkeys(o for root in roots for o in (root, *root.children_recursive)))


def turntable_of(scene: bpy.types.Scene) -> bpy.types.Object:
    """Return the empty whose rotation is the turntable's.

    Raises
    ------
    ScanstageError
        The scene has no stage, or its turntable was deleted.
    """
    found = ownership.with_role(ownership.require_stage(scene), "turntable")
    if not found:
        raise ScanstageError(f"the turntable of scene {scene.name!r} was deleted: build the stage again")
    return found[0]


@contextmanager
def frame_kept(scene: bpy.types.Scene) -> Iterator[None]:
    """Put the current frame and the scene's camera back when the block ends; markers change it on the way."""
    frame, subframe, camera = scene.frame_current, scene.frame_subframe, scene.camera
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=subframe)
        scene.camera = camera


class _Devices:
    """Gives each device, or pattern, that the plan meets an id, and another one wherever it has changed."""

    def __init__(self) -> None:
        self.found: dict[str, Any] = {}
        self._ids: dict[tuple[str, bytes], str] = {}
        self._counts: dict[str, int] = {}

    def id_of(self, owner: bpy.types.Object, device: Camera | Light) -> str:
        """Return the id of an object's device."""
        return self.id_by_name(ownership.device_id(owner), device, b"".join(np.asarray(value).tobytes() for value in vars(device).values()))

    def id_by_name(self, name: str, entry: object, content: bytes) -> str:
        """Return the name, with a number where other content has it already."""
        if (name, content) not in self._ids:
            id = name
            while id in self.found:
                self._counts[name] = self._counts.get(name, 1) + 1
                id = f"{name}-{self._counts[name]}"
            self._ids[name, content], self.found[id] = id, entry
        return self._ids[name, content]


def _board(scene: bpy.types.Scene) -> bpy.types.Object | None:
    boards = [member for member in ownership.with_role(ownership.require_stage(scene), "board") if not member.hide_render]
    return boards[0] if boards else None


def _emitting(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return sorted((o for o in scene.objects if o.type == "LIGHT" and not o.hide_render), key=lambda o: o.name)


def _lights_on(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return [o for o in _emitting(scene) if not is_projector(o) and light_is_on(o.data)]


def _shown(scene: bpy.types.Scene, projectors: _Devices, patterns: _Devices) -> str | None:
    """Return the id of the pattern that lies on the scene at the present frame."""
    shown = []
    for source in _emitting(scene):
        if is_projector(source) and (pattern := pattern_of(source.data, scene.frame_current)) is not None:
            id, fields = pattern
            shown.append((source, id, {**fields, "projector": projectors.id_of(source, projector_of(scene, source))}))
        elif is_laser(source) and light_is_on(source.data):
            shown.append((source, ownership.device_id(source), laser_fields(source)))
    for member in ownership.with_role(ownership.require_stage(scene), "stick"):
        if (passing := stick_fields(member, scene.frame_current)) is not None:
            shown.append((member, *passing))
    if len(shown) > 1:
        raise ScanstageError(f"frame {scene.frame_current} of scene {scene.name!r}: {shown[0][0].name!r} and {shown[1][0].name!r} shine at "
                             "once, which no decoder can tell apart: let one of them be dark")
    return patterns.id_by_name(shown[0][1], shown[0][2], json.dumps(shown[0][2], sort_keys=True).encode()) if shown else None


def _rotation(world: np.ndarray) -> np.ndarray:
    """Return the rotation part of a matrix, orthonormal to double precision; Blender's are of single precision."""
    scale = np.linalg.norm(world[:3, :3], axis=0)
    u, _, vt = np.linalg.svd(world[:3, :3] / scale)
    return u @ vt


def rigid_motion(turntable: bpy.types.Object) -> np.ndarray:
    """Return the (4, 4) rigid motion from the object frame to the world at the present frame; a turntable's scale has no part in it."""
    world = np.array(turntable.matrix_world)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = _rotation(world), world[:3, 3]
    return motion
