# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From a capture set that shows a calibration board to one whose devices are calibrated: the verb `calibrate`."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np

from .captures.placing import check_place, put_in_place
from .captures.scan import load_board_views
from .captures.schema import FILE_NAME, Capture
from .captures.store import files_of, read_capture
from .errors import ScanstageError
from .options import Option, Value, resolve
from .progress import Progress, part_of, silent
from .reconstruction.active.sequences import of_kind, read_grey
from .reconstruction.calibration.bundle import motion
from .reconstruction.calibration.laser import laser_plane, stripe_on_board
from .reconstruction.calibration.light import light_from_pencils
from .reconstruction.calibration.quality import pose_warnings, residual_picture
from .reconstruction.calibration.rig import Rig, calibrate_rig, rms
from .reconstruction.calibration.sightings import BoardView, find_sightings
from .reconstruction.geometry import Camera

FOLDER, REPORT = "calibration", "report.json"
MOST_ANGLE_ERROR = np.radians(1.0)  # of the table, against what it was told
MOST_TILT = np.radians(0.5)  # of the table's axis, from pose to pose

_LENSES = {"none": "No distortion", "radial": "k1 and k2", "full": "k1, k2, p1, p2 and k3: needs the board in the picture's corners",
           "brown": "k1, k2 and the tangential p1, p2, which the principal point can hardly be told from"}
OPTIONS = (
    Option("camera_lens", "radial", "What is estimated of the cameras' lens distortion", choices=_LENSES),
    Option("projector_lens", "radial", "What is estimated of the projectors' lens distortion", choices=_LENSES),
    Option("window", 1.0, "Side, in squares of the board, of the patch round a corner whose decoded pixels carry it into the projector: "
           "smaller follows the lenses better, larger averages more", minimum=0.2, maximum=10.0),
)


def calibrate(capture: Path, out: Path, *, options: Mapping[str, Value] | None = None, progress: Progress = silent) -> dict:
    """Calibrate the devices of a capture set from its frames of the board.

    The first camera keeps the pose that it has in the set, and so the world stays where it was. If the board stood on the
    turntable in frames at different ``object_to_world``, the camera's pose is corrected so that the board turned as those say;
    the angle about the axis and the height along it, of which the board says nothing, are kept. All else of the set is copied.

    Parameters
    ----------
    capture, out : Path
        Folders; ``out`` also gets the report, as ``calibration/report.json``, and a picture of each device's residuals.
    options : mapping, optional
        See `OPTIONS`.

    Returns
    -------
    dict
        The report. Of each device ``rms`` and ``views`` (the RMS of each frame) in pixels, ``K``, ``distortion``, ``deviations``
        (standard deviations of fx fy cx cy k1 k2 p1 p2 k3), and ``difference`` from what the set had: where that was rendered,
        the error. ``turntable`` or None, angles in degrees; ``lasers``, the plane of each laser's pattern; ``lights``, the position;
        ``board_poses``, board to world; ``not_found``, frames; and ``warnings``, sentences.

    Raises
    ------
    ScanstageError
        The set, an option or the place cannot be used, or the board's poses do not bear a calibration: nothing is then written.
    """
    capture, out = Path(capture), Path(out)
    values = resolve(OPTIONS, options or {}, "calibrate")
    check_place(capture, out)
    before = read_capture(capture)
    views = load_board_views(capture, before)
    _refuse_ambiguity(before, views)
    sightings = find_sightings(before.board, views, {id: device.size for id, device in before.projectors.items()},
                               window=values["window"], progress=part_of(progress, 0.0, 0.8))
    progress(0.8, "Calibrating")
    known = _devices(before)
    seeing = {sighting.device for sighting in sightings.found}
    sizes = {name: known[name].size for name in known if name in seeing}
    first = known[next(iter(sizes))]
    lenses = {name: values["camera_lens" if name.startswith("camera ") else "projector_lens"] for name in sizes}
    rig = calibrate_rig(before.board.corners, sightings.found, sizes, lenses, world=motion(first.R, first.t), turns=_turns(views))
    warnings = [*sightings.warnings, *(f"{name}: has no frames of the board; left as it was" for name in known if name not in seeing),
                *(warning for name in rig.devices for warning in pose_warnings(rig, before.board.corners, name)), *_table_warnings(rig)]
    lasers, laser_warnings = _lasers(before, views, rig)
    lights, light_warnings = _lights(before, views, rig)
    report = {**_report(before, rig), "lasers": lasers, "lights": lights, "not_found": list(sightings.not_found),
              "warnings": [*warnings, *laser_warnings, *light_warnings]}
    extra = {f"{FOLDER}/{_file_name(name)}.png": _png(residual_picture(rig, name)) for name in rig.devices}
    extra[f"{FOLDER}/{REPORT}"] = json.dumps(report, indent=1, allow_nan=False).encode()
    pictures = {path: capture / path for _, path, _ in files_of(before)}
    put_in_place(_calibrated(before, rig, lasers, lights), pictures, out, part_of(progress, 0.9, 1.0), extra=extra)
    return report


def _calibrated(capture: Capture, rig: Rig, lasers: Mapping[str, dict], lights: Mapping[str, dict]) -> Capture:
    """Return the set with what was found in the place of what it had."""
    devices = {name: device.moved(rig.world) for name, device in rig.devices.items()}
    patterns = {id: {**fields, "plane": lasers[id]["plane"]} if id in lasers else _on_boards(fields, rig)
                for id, fields in capture.patterns.items()}
    return replace(capture, patterns=patterns,
                   cameras={id: devices.get(f"camera {id}", camera) for id, camera in capture.cameras.items()},
                   projectors={id: devices.get(f"projector {id}", one) for id, one in capture.projectors.items()},
                   lights={id: replace(light, position=np.array(lights[id]["position"])) if id in lights else light
                           for id, light in capture.lights.items()})


def _on_boards(fields: Mapping[str, object], rig: Rig) -> Mapping[str, object]:
    """Return a shadow's pattern with the planes, in the world, of those strips that name a board which lay there."""
    if not isinstance(fields.get("strips"), list):
        return fields
    to_world = np.linalg.inv(rig.world)
    poses = {name.rpartition("/")[0]: to_world @ pose for name, pose in rig.poses.items()}

    def placed(strip: object) -> object:
        pose = poses.get(str(strip.get("board_pose"))) if isinstance(strip, dict) else None
        return strip if pose is None else {**strip, "plane": [*pose[:3, 2].tolist(), float(pose[:3, 2] @ pose[:3, 3])]}

    return {**fields, "strips": [placed(strip) for strip in fields["strips"]]}


def _devices(capture: Capture) -> dict[str, Camera]:
    """Return a set's cameras and projectors by the names that sightings have for them."""
    return {f"{kind} {id}": device for kind, devices in (("camera", capture.cameras), ("projector", capture.projectors))
            for id, device in devices.items()}


def _refuse_ambiguity(capture: Capture, views: Sequence[BoardView]) -> None:
    """Refuse what would leave two answers: a mirrored first camera, or poses to be compared of a board that half a turn keeps."""
    seeing = {shown.camera_id for shown in views}
    first, *others = [id for id in capture.cameras if id in seeing]
    if capture.cameras[first].mirrored:
        raise ScanstageError(f"{FILE_NAME}: devices.cameras.{first}.R: is mirrored, and a calibrated camera is not; give a rotation")
    if capture.board.symmetric and (others or _turns(views)):
        raise ScanstageError(f"{FILE_NAME}: board: half a turn leaves a checkerboard of {capture.board.columns} x {capture.board.rows} "
                             f"squares as it is, so {'cameras' if others else 'poses on the turntable'} cannot be related by it; use one "
                             "with an odd sum of columns and rows, or ChArUco")


def _turns(views: Sequence[BoardView]) -> dict[str, tuple[str, np.ndarray]]:
    """Return placement and motion of each pose on the turntable: those of placements that were seen at several motions."""
    poses: dict[str, set[str]] = {}
    for shown in views:
        poses.setdefault(shown.placement, set()).add(shown.pose)
    return {shown.pose: (shown.placement, shown.motion) for shown in views if len(poses[shown.placement]) > 1}


def _table_warnings(rig: Rig) -> list[str]:
    warnings = []
    if rig.turntable is not None and (error := max(map(abs, rig.turntable.errors.values()))) > MOST_ANGLE_ERROR:
        warnings.append(f"turntable: it turned by up to {np.degrees(error):.1f} degrees more or less than its frames say; check "
                        "object_to_world, and that the board did not slip")
    if rig.turntable is not None and rig.turntable.axis.tilt > MOST_TILT:
        warnings.append(f"turntable: its poses share no axis (they tilt it by {np.degrees(rig.turntable.axis.tilt):.1f} degrees); check "
                        "that neither table nor board wobble")
    return warnings


def _lights(capture: Capture, views: Sequence[BoardView], rig: Rig) -> tuple[dict[str, dict], list[str]]:
    """Return where in the world the light with pencils is, and warnings."""
    pencils = capture.pencils
    if pencils is None:
        return {}, []
    place = f"{FILE_NAME}: pencils"
    pose = next((shown.pose for shown in views if shown.placement == pencils.board_pose and shown.pose in rig.poses), None)
    if pose is None or f"camera {pencils.camera}" not in rig.devices:
        raise ScanstageError(f"{place}: the board is not found at {pencils.board_pose!r}, or not by camera {pencils.camera}; name another")
    on_board = rig.poses[pose]
    camera = rig.devices[f"camera {pencils.camera}"].moved(on_board)
    try:
        found = light_from_pencils(camera, pencils.bases, pencils.shadow_tips, pencils.height)
    except ScanstageError as error:
        raise ScanstageError(f"{place}: {error}") from None
    position = (np.linalg.inv(rig.world) @ on_board @ np.append(found.position, 1.0))[:3]
    return ({pencils.light: {"position": position.tolist(), "rms": found.rms, "condition": found.condition}},
            [f"light {pencils.light}: {warning}" for warning in found.warnings])


def _report(capture: Capture, rig: Rig) -> dict:
    known, to_world = _devices(capture), np.linalg.inv(rig.world)
    return {"board": asdict(capture.board), "devices": {name: _device_report(rig, name, known[name]) for name in rig.devices},
            "turntable": _table_report(rig), "board_poses": {name: (to_world @ pose).tolist() for name, pose in rig.poses.items()}}


def _table_report(rig: Rig) -> dict | None:
    if rig.turntable is None:
        return None
    axis = rig.turntable.axis
    return {"poses": len(rig.turntable.errors), "angle_errors": {pose: float(np.degrees(e)) for pose, e in rig.turntable.errors.items()},
            "tilt": float(np.degrees(axis.tilt)), "offset": axis.offset}


def _lasers(capture: Capture, views: Sequence[BoardView], rig: Rig) -> tuple[dict[str, dict], list[str]]:
    """Return the plane in the world of each laser's pattern that crosses the board, and warnings."""
    pattern_of = {frame.id: frame.pattern for frame in capture.frames}
    seen: dict[str, list[tuple[Camera, np.ndarray, np.ndarray]]] = {}
    for shown in views:
        camera = rig.devices.get(f"camera {shown.camera_id}")
        for picture in of_kind(shown.view.projected, "laser") if camera is not None and shown.pose in rig.poses else ():
            in_world = camera.moved(rig.world), np.linalg.inv(rig.world) @ rig.poses[shown.pose]
            stripe = stripe_on_board(capture.board, *in_world, read_grey(picture))
            if len(stripe):
                seen.setdefault(pattern_of[picture.name], []).append((*in_world, stripe))
    found, warnings = {}, []
    for id, stripes in seen.items():
        if len(stripes) < 2:
            warnings.append(f"laser {id}: crosses the board in one pose only; its plane is left as it was")
            continue
        plane = laser_plane(*zip(*stripes, strict=True))
        found[id] = {"plane": [*plane.normal.tolist(), plane.distance], "rms": plane.rms, "poses": len(stripes)}
        warnings += [f"laser {id}: {warning}" for warning in plane.warnings]
    return found, warnings


def _device_report(rig: Rig, name: str, before: Camera) -> dict:
    device = rig.devices[name].moved(rig.world)
    views: dict[str, float] = {}
    for sighting, residual in zip(rig.sightings, rig.residuals, strict=True):
        if sighting.device == name:
            views[sighting.name] = rms([residual])
    return {"rms": rig.rms(name), "views": views, "size": list(device.size), "K": device.K.tolist(),
            "distortion": device.distortion.tolist(), "deviations": rig.deviations[name].tolist(),
            "difference": _difference(device, before)}


def _difference(device: Camera, before: Camera) -> dict[str, float]:
    return {"focal_length_percent": float(100 * np.abs(np.diag(device.K)[:2] / np.diag(before.K)[:2] - 1).max()),
            "principal_point_pixels": float(np.linalg.norm(device.K[:2, 2] - before.K[:2, 2])),
            "rotation_degrees": float(np.degrees(np.linalg.norm(cv2.Rodrigues(device.R @ before.R.T)[0]))),
            "centre": float(np.linalg.norm(device.centre - before.centre))}


def _file_name(device: str) -> str:
    """Return a device's name as that of a file: ids may hold what leads out of the folder."""
    return re.sub(r"[^A-Za-z0-9._-]", "-", device)


def _png(picture: np.ndarray) -> bytes:
    return cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
