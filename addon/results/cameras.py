# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a capture set in Blender, each with its picture behind it: a wrong pose is seen at a glance.

They stand in the object frame, where a result of the set stands as well. Where the scene has no stage of its own, it takes the
pictures' size and shape of pixels, and its timeline leads from camera to camera.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ..captures.scan import views_of_object
from ..captures.schema import FILE_NAME, Capture, Frame
from ..captures.store import read_capture
from ..errors import ScanstageError
from ..reconstruction.geometry import Camera
from ..reconstruction.volumetric.bounds import meeting_point
from ..stage.devices import stand
from ..stage.ownership import find_stage
from .materials import OWNER

COLLECTION_NAME = "Scanstage Cameras"
_KIND = "cameras"  # of what `OWNER` marks
_ALPHA = 0.6  # a result behind is seen as well
_SENSOR = 36.0  # millimetres; any would do, since lens and sensor appear only as a ratio
_SHOWN_SIZE = 0.15  # of a frustum, in distances to where the cameras look
_WORTH_TELLING = 0.5  # px between where a point is drawn and where the picture shows it
_NO_CAMERA = 0.1  # of a picture's diagonal: no camera of Blender's is anything like the calibration
_GRID = 17


@dataclass(frozen=True)
class _Lens:
    """A camera as Blender can have it, in the frame of its scene.

    Parameters
    ----------
    camera : Camera
        With its true pose, never mirrored; `flipped` says whether the picture is.
    lens, shift_x, shift_y : float
        Of Blender's camera, whose sensor is `_SENSOR` wide.
    flipped : bool
    stretched : bool
        Whether the picture fills the frame, or else fits into it.
    error : float
        Pixels of the picture by which a point is drawn elsewhere than the picture shows it, at the most.
    """

    camera: Camera
    lens: float
    shift_x: float
    shift_y: float
    flipped: bool
    stretched: bool
    error: float


def show_cameras(scene: bpy.types.Scene, folder: Path) -> list[str]:
    """Put a capture set's cameras into the scene, one for each view of the object, in place of those that were shown before.

    Parameters
    ----------
    scene : bpy.types.Scene
    folder : Path
        A capture set.

    Returns
    -------
    list of str
        What Blender's cameras cannot show, for the user.

    Raises
    ------
    ScanstageError
        The set cannot be used, or has no view of the object.
    """
    folder = Path(folder)
    capture = read_capture(folder)
    views = views_of_object(capture)
    if not views:
        raise ScanstageError(f"{FILE_NAME}: frames: none shows the object, only the calibration board; calibrate, then capture an object")
    staged = find_stage(scene) is not None
    _remove(scene)
    home = bpy.data.collections.new(COLLECTION_NAME)
    home[OWNER] = _KIND
    home.hide_render = True
    scene.collection.children.link(home)
    cameras = [capture.camera_of(frame) for frame in views]
    if not staged:
        _take_frame(scene, cameras[0])
    lenses = [_lens(camera, scene.render) for camera in cameras]
    target = meeting_point([lens.camera for lens in lenses])
    shown = {frame.id: _add(home, frame, lens, target, folder, capture) for frame, lens in zip(views, lenses, strict=True)
             if lens.error <= _NO_CAMERA * float(np.hypot(*lens.camera.size))}
    if not staged and shown:
        _lead_through(scene, list(shown.values()))
    return _told(dict(zip((frame.id for frame in views), lenses, strict=True)), shown)


def cameras_are_shown(scene: bpy.types.Scene) -> bool:
    """Return whether the scene shows a capture set's cameras."""
    return any(_homes(scene))


def _homes(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    return [found for found in scene.collection.children_recursive if found.get(OWNER) == _KIND]


def _remove(scene: bpy.types.Scene) -> None:
    """Take away what was shown before in this scene, with all that belongs to nothing else."""
    for home in _homes(scene):
        for marker in [marker for marker in scene.timeline_markers if marker.camera in set(home.objects)]:
            scene.timeline_markers.remove(marker)
        for member in [member for member in home.objects if member.get(OWNER) == _KIND]:
            data, images = member.data, {background.image for background in member.data.background_images} - {None}
            bpy.data.objects.remove(member)
            bpy.data.cameras.remove(data)
            for image in [image for image in images if image.users == 0]:
                bpy.data.images.remove(image)
        for member in list(home.objects):  # the user put it here; it stays
            scene.collection.objects.link(member)
        bpy.data.collections.remove(home)


def _take_frame(scene: bpy.types.Scene, camera: Camera) -> None:
    """Give the scene a camera's picture size and shape of pixels."""
    render = scene.render
    render.resolution_x, render.resolution_y = camera.size
    render.resolution_percentage = 100
    aspect = camera.K[0, 0] / camera.K[1, 1]
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1.0 / aspect), max(1.0, aspect)


def _lens(camera: Camera, render: bpy.types.RenderSettings) -> _Lens:
    flipped = camera.mirrored
    if flipped:  # a mirrored camera is one that is not, whose picture is looked at in a mirror
        across = np.diag((-1.0, 1.0, 1.0))
        K = across @ camera.K @ across
        K[0, 2] = camera.size[0] - 1 - camera.K[0, 2]
        lens = camera.distortion * (1, 1, 1, -1, 1)  # p2 bends along x
        camera = Camera(K, across @ camera.R, across @ camera.t, camera.size, lens)
    size, frame = np.array(camera.size, float), np.array((render.resolution_x, render.resolution_y), float)
    aspect = render.pixel_aspect_y / render.pixel_aspect_x
    stretched = bool(abs(size[0] * frame[1] - size[1] * frame[0]) < 0.5)
    scale = frame / size if stretched else np.array((1, 1 / aspect)) * min(frame[0] / size[0], frame[1] * aspect / size[1])
    middle = scale * (camera.K[:2, 2] + 0.5) + (frame - scale * size) / 2 - 0.5
    across = scale[0] * camera.K[0, 0]
    shown = np.array([[camera.K[0, 0], 0, camera.K[0, 2]], [0, across / aspect / scale[1], camera.K[1, 2]], [0, 0, 1]])
    return _Lens(camera, float(across * _SENSOR / frame[0]), float((frame[0] / 2 - middle[0] - 0.5) / frame[0]),
                 float((middle[1] + 0.5 - frame[1] / 2) * aspect / frame[0]), flipped, stretched,
                 _error(camera, replace(camera, K=shown, distortion=np.zeros(5))))


def _error(camera: Camera, shown: Camera) -> float:
    grid = np.stack(np.meshgrid(*(np.linspace(0, side - 1, _GRID) for side in camera.size)), axis=-1)
    pixels, _ = camera.project(camera.centre + shown.rays(grid))
    return float(np.linalg.norm(pixels - grid, axis=-1).max())


def _add(home: bpy.types.Collection, frame: Frame, lens: _Lens, target: np.ndarray, folder: Path, capture: Capture) -> bpy.types.Object:
    data = bpy.data.cameras.new(frame.id)
    data.sensor_fit, data.sensor_width = 'HORIZONTAL', _SENSOR
    data.lens, data.shift_x, data.shift_y = lens.lens, lens.shift_x, lens.shift_y
    distance = float(np.linalg.norm(target - lens.camera.centre))
    data.clip_start, data.clip_end, data.display_size = distance * 1e-3, distance * 100, distance * _SHOWN_SIZE
    added = bpy.data.objects.new(frame.id, data)
    added[OWNER] = _KIND
    home.objects.link(added)
    stand(added, lens.camera.R, lens.camera.t)
    background = data.background_images.new()
    background.image = bpy.data.images.load(str((folder / frame.image).resolve()), check_existing=True)
    if capture.encoding == "linear":
        background.image.colorspace_settings.name = 'Linear Rec.709'
    background.alpha, background.display_depth = _ALPHA, 'FRONT'
    background.frame_method, background.use_flip_x = 'STRETCH' if lens.stretched else 'FIT', lens.flipped
    data.show_background_images = True
    return added


def _lead_through(scene: bpy.types.Scene, cameras: list[bpy.types.Object]) -> None:
    """Let frame n of the timeline be seen by the n-th camera."""
    for number, camera in enumerate(cameras, start=1):
        scene.timeline_markers.new(camera.name, frame=number).camera = camera
    scene.frame_start, scene.frame_end = 1, len(cameras)
    scene.camera = cameras[0]
    scene.frame_set(1)


def _told(lenses: dict[str, _Lens], shown: dict[str, bpy.types.Object]) -> list[str]:
    told = []
    if hidden := [id for id in lenses if id not in shown]:
        told.append(f"{len(hidden)} of {len(lenses)} views are not shown (first: {hidden[0]}): their calibrations, as of a world that is "
                    "not metric, are those of no camera of Blender's; methods use them as they are")
    if flipped := [id for id in shown if lenses[id].flipped]:
        told.append(f"{len(flipped)} views are calibrated in a mirrored world (first: {flipped[0]}): their pictures are shown flipped")
    worst = max(shown, key=lambda id: lenses[id].error, default=None)
    if worst is not None and lenses[worst].error > _WORTH_TELLING:
        told.append(f"lens distortion, skew or pixels of another shape let a point be drawn up to {lenses[worst].error:.1f} px from where "
                    f"the picture shows it (frame {worst}); import with undistort=true to undo a lens")
    return told
