# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture set as methods take it: views in the object frame, with their silhouettes.

The one place where a rig's poses and the turntable's become cameras in the object frame, and pictures become masks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..options import Value, resolve
from ..progress import Progress, silent
from ..reconstruction.calibration.sightings import BoardView
from ..reconstruction.contours import centres_within
from ..reconstruction.geometry import MAX_SKEW_OF_ROTATION
from ..reconstruction.scan import LitPicture, ProjectedPicture, Scan, View
from ..reconstruction.shadows import MOST_LIGHTS, SHADOW_OPTIONS, detect_shadows
from ..reconstruction.silhouettes import SILHOUETTE_OPTIONS, extract
from .contour_file import read_contours
from .fields import Field
from .files import inside
from .pictures import read_mask, read_picture, write_levels
from .schema import FILE_NAME, Capture, Frame
from .store import files_of, read_capture

MASKS, SHADOWS = "masks", "shadows"


def load_scan(folder: Path, silhouette_options: Mapping[str, Value] | None = None, progress: Progress = silent, *,
              silhouettes: bool = True, shadow_options: Mapping[str, Value] | None = None) -> Scan:
    """Read a capture set's views, take their silhouettes and, where asked, find their shadows.

    Each silhouette is also written to ``masks/<frame id>.png`` in the set, to be looked at, unless the set cannot be
    written to or already names a file of its own so. Frames under a projected pattern are no views of their own, since what
    is projected changes the silhouette's look: they are `View.projected` of the frame that shares their camera and pose.
    Frames of the calibration board are left out. Frames of one camera and pose under different lights are one view (see
    `lighting_groups`).

    Parameters
    ----------
    folder : Path
    silhouette_options : mapping of str to value, optional
        By the names of `SILHOUETTE_OPTIONS`; they override those that the set itself gives.
    progress : Progress
    silhouettes : bool
        False for a method that needs none: no mask is taken or written, and a set with a pattern in every frame will do.
    shadow_options : mapping of str to value, optional
        By the names of `SHADOW_OPTIONS`. If given, the shadows of views with pictures under single lights are found, and
        written to ``shadows/<frame id>.png`` as the silhouettes are.

    Returns
    -------
    Scan
        ``View.read_image`` reads the picture when it is called. Masks take one byte a pixel.

    Raises
    ------
    ScanstageError
        The set cannot be used, frames are not rendered yet, an option is not allowed, or a silhouette is empty.
    """
    folder = Path(folder)
    capture = read_capture(folder)
    if capture.missing:
        raise ScanstageError(f"{FILE_NAME}: missing: {len(capture.missing)} of {len(capture.frames)} frames are not "
                             f"rendered yet (first: {capture.missing[0]}); run capture again to render them")
    of_object = tuple(frame for frame in capture.frames if frame.board_pose is None)
    if not of_object:
        raise ScanstageError(f"{FILE_NAME}: frames: the calibration board is in every frame; capture an object with these devices")
    projected = _projected(folder, replace(capture, frames=of_object))
    frames = [frame for frame in of_object if frame.pattern is None]
    if silhouettes and not frames:
        raise ScanstageError(f"{FILE_NAME}: frames: a pattern is projected in every frame; "
                             "capture at least one frame without a pattern")
    options = resolve(SILHOUETTE_OPTIONS, {**capture.silhouette, **(silhouette_options or {})}, "silhouette")
    shadows = None if shadow_options is None else resolve(SHADOW_OPTIONS, shadow_options, "shadows")
    step = "Shadows" if shadows is not None else "Silhouette" if silhouettes else "View"
    views, groups = [], lighting_groups(frames)
    for index, group in enumerate(groups):
        progress(index / len(groups), f"{step} {index + 1} of {len(groups)}")
        view = _view(folder, capture, group, options if silhouettes else None, projected.pop(_place(group[0]), ()))
        views.append(view if shadows is None else _with_shadows(folder, capture, view, shadows))
    if not silhouettes:
        views += [_projected_view(capture, pictures) for pictures in projected.values()]
    progress(1.0, f"{len(views)} views")
    used = {light for frame in capture.frames for light in frame.lights}
    return Scan(tuple(views), None if capture.bounds is None else np.array(capture.bounds),
                tuple(light for light in capture.lights if light not in used))


def load_board_views(folder: Path, capture: Capture) -> list[BoardView]:
    """Return the views of the calibration board, in the order of capture.

    Parameters
    ----------
    folder : Path
    capture : Capture
        The set in it.

    Raises
    ------
    ScanstageError
        No frame shows a board, one that does is not rendered yet, or a pattern names no projector.
    """
    shown = [frame for frame in capture.frames if frame.board_pose is not None]
    if not shown:
        raise ScanstageError(f"{FILE_NAME}: frames: none has a board_pose, so none shows the calibration board; capture it")
    if missing := [frame.id for frame in shown if frame.id in set(capture.missing)]:
        raise ScanstageError(f"{FILE_NAME}: missing: {len(missing)} of {len(shown)} frames of the board are not rendered yet (first: "
                             f"{missing[0]}); run capture again to render them")
    views, poses = [], {}
    for placement in dict.fromkeys(frame.board_pose for frame in shown):
        own = replace(capture, frames=tuple(frame for frame in shown if frame.board_pose == placement))
        projected = _projected(folder, own)
        plain = {_place(group[0]): group for group in reversed(lighting_groups(frame for frame in own.frames if frame.pattern is None))}
        for place, frame in {_place(frame): frame for frame in own.frames}.items():
            view = _view(folder, capture, plain[place], None, projected.get(place, ())) if place in plain \
                else _projected_view(own, projected[place])
            pose = poses.setdefault((placement, place[1]), f"{placement}/{len(poses) + 1}")
            views.append(BoardView(placement, np.asarray(frame.object_to_world, float), pose, frame.camera, view))
    return views


def _place(frame: Frame) -> tuple[str, bytes]:
    """Return what frames of one view share: the camera and the turntable's pose."""
    return frame.camera, (np.asarray(frame.object_to_world, float) + 0.0).tobytes()  # -0.0 is the same pose as 0.0


def _projected(folder: Path, capture: Capture) -> dict[tuple[str, bytes], tuple[ProjectedPicture, ...]]:
    """Return the pictures under patterns of each camera and pose, in the order of capture."""
    found: dict[tuple[str, bytes], list[ProjectedPicture]] = {}
    for frame in capture.frames:
        if frame.pattern is None:
            continue
        motion = np.asarray(frame.object_to_world, float)
        fields = dict(capture.patterns[frame.pattern])
        if "plane" in fields:
            fields["plane"] = _moved_plane(fields["plane"], motion, f"{FILE_NAME}: patterns.{frame.pattern}.plane")
        if isinstance(fields.get("strips"), list):
            place = f"{FILE_NAME}: patterns.{frame.pattern}.strips"
            fields["strips"] = [{**strip, "plane": _moved_plane(strip["plane"], motion, f"{place}[{number}].plane")}
                                if isinstance(strip, dict) and "plane" in strip else strip for number, strip in enumerate(fields["strips"])]
        id = _projector_of(capture, frame, fields)
        projector = None if id is None else capture.projectors[id].moved(motion)
        light = capture.lights[frame.lights[0]].moved(motion) if len(frame.lights) == 1 else None
        picture = ProjectedPicture(frame.id, fields, id, projector, _reader(folder, capture, frame), light)
        found.setdefault(_place(frame), []).append(picture)
    return {place: tuple(pictures) for place, pictures in found.items()}


def _projector_of(capture: Capture, frame: Frame, fields: Mapping[str, object]) -> str | None:
    """Return the id of the projector that shows a frame's pattern: the one it names, or the only one there is."""
    place = f"{FILE_NAME}: patterns.{frame.pattern}"
    id = fields.get("projector")
    if id is None and len(capture.projectors) > 1 and "plane" not in fields:
        raise ScanstageError(f"{place}: must name its projector, one of {', '.join(capture.projectors)}")
    if id is not None and id not in capture.projectors:
        raise ScanstageError(f"{place}.projector: {str(id)[:40]!r} is not a projector of this set")
    return id if id is not None else next(iter(capture.projectors), None) if len(capture.projectors) == 1 else None


def _moved_plane(plane: object, motion: np.ndarray, place: str) -> list[float]:
    """Return ``[nx, ny, nz, d]``, given in the world, in the frame that lies at ``motion`` in the world."""
    *normal, offset = Field(plane, place, "").numbers(4)
    if abs(np.linalg.norm(normal) - 1) > MAX_SKEW_OF_ROTATION:
        raise ScanstageError(f"{place}: must begin with a unit normal")
    return [*(motion[:3, :3].T @ normal), offset - np.dot(normal, motion[:3, 3])]


def _projected_view(capture: Capture, pictures: tuple[ProjectedPicture, ...]) -> View:
    """Return the view of a camera and pose that were captured under patterns only."""
    own = next((picture for picture in pictures if picture.pattern.get("kind") == "white"), pictures[0])
    frame = next(frame for frame in capture.frames if frame.id == own.name)
    return View(frame.id, capture.camera_of(frame), None, own.read_image, projected=pictures)


def views_of_object(capture: Capture) -> list[Frame]:
    """Return of each camera and pose the frame with the most light, none of a calibration board.

    Where every frame is under a pattern, it is the first of each camera and pose.
    """
    of_object = [frame for frame in capture.frames if frame.board_pose is None]
    plain = [frame for frame in of_object if frame.pattern is None]
    if plain:
        return [group[0] for group in lighting_groups(plain)]
    return list({_place(frame): frame for frame in reversed(of_object)}.values())[::-1]


def lighting_groups(frames: Iterable[Frame]) -> list[tuple[Frame, ...]]:
    """Return the frames that differ by their lights only, as one group each, in the order of their first frames.

    Of each group the frame with the most lights comes first: it shows the object without shadows where any does. Frames
    that name the same lights, or none, are views of their own: nothing says that they belong together.
    """
    groups: dict[object, dict[frozenset[str], Frame]] = {}
    for frame in frames:
        group = groups.setdefault(_place(frame), {})
        if not frame.lights or frozenset(frame.lights) in group:
            group = groups.setdefault(frame.id, {})
        group[frozenset(frame.lights)] = frame
    return [tuple(sorted(group.values(), key=lambda frame: -len(frame.lights))) for group in groups.values() if group]


def _view(folder: Path, capture: Capture, group: tuple[Frame, ...], options: Mapping[str, Value] | None,
          projected: tuple[ProjectedPicture, ...]) -> View:
    frame, camera = group[0], capture.camera_of(group[0])
    contours = None
    if options is not None and frame.contours is not None and options["silhouette"] in ("auto", "mask"):
        contours = read_contours(folder / frame.contours, frame.contours)
    mask = None if options is None else _checked_silhouette(folder, capture, frame, options, contours)
    return View(frame.id, camera, mask, _reader(folder, capture, frame), tuple(
        LitPicture(lit.id, lit.lights[0], capture.lights[lit.lights[0]].moved(lit.object_to_world), _reader(folder, capture, lit))
        for lit in group if len(lit.lights) == 1), contours=contours, projected=projected)


def _checked_silhouette(folder: Path, capture: Capture, frame: Frame, options: Mapping[str, Value],
                        contours: tuple[np.ndarray, ...] | None) -> np.ndarray:
    mask = _silhouette(folder, capture, frame, options, contours)
    if not mask.any():
        raise ScanstageError(f"{frame.image}: the silhouette of frame {frame.id} is empty; check the picture, or take "
                             "the silhouette in another way with the silhouette options")
    _write_mask(folder, capture, f"{MASKS}/{frame.id}.png", np.where(mask, np.uint8(255), np.uint8(0)))
    return mask


def _silhouette(folder: Path, capture: Capture, frame: Frame, options: Mapping[str, Value],
                contours: tuple[np.ndarray, ...] | None) -> np.ndarray:
    size = capture.cameras[frame.camera].size
    rgb, alpha = read_picture(folder / frame.image, capture.encoding, size=size, name=frame.image)
    chosen = options["silhouette"]
    given = plate = None
    if contours is not None:
        given = centres_within(contours, size)
    elif frame.mask is not None and chosen in ("auto", "mask"):
        given = read_mask(folder / frame.mask, size=size, name=frame.mask)
    if frame.camera in capture.plates and chosen in ("auto", "plate"):
        name = capture.plates[frame.camera]
        plate = read_picture(folder / name, capture.encoding, size=size, name=name)[0]
    try:
        return extract(rgb, alpha, given, plate, **options)
    except ScanstageError as error:
        raise ScanstageError(f"{frame.image}: {error}") from None


def _with_shadows(folder: Path, capture: Capture, view: View, options: Mapping[str, Value]) -> View:
    """Return a view with its shadows, which are also written beside the captures."""
    if not view.lit:
        return view
    if len(view.lit) > MOST_LIGHTS:
        raise ScanstageError(f"{FILE_NAME}: frame {view.name}: has pictures under {len(view.lit)} single lights, more than {MOST_LIGHTS}; "
                             "leave some out of frames")
    masks = detect_shadows([picture.read_image() for picture in view.lit], view.read_image(), **options)
    for number, picture in enumerate(view.lit):
        _write_mask(folder, capture, f"{SHADOWS}/{picture.name}.png", masks.picture(number))
    return replace(view, shadows=masks)


def _write_mask(folder: Path, capture: Capture, relative: str, levels: np.ndarray) -> None:
    """Write a mask to be looked at, unless the set cannot be written to or has a file of its own of that name."""
    inputs = {path.casefold() for _, path, _ in files_of(capture)}
    if os.access(folder, os.W_OK) and relative.casefold() not in inputs:
        write_levels(inside(folder, relative, relative), levels)


def _reader(folder: Path, capture: Capture, frame: Frame) -> Callable[[], np.ndarray]:
    return partial(_read_image, folder / frame.image, capture.encoding, capture.cameras[frame.camera].size, frame.image)


def _read_image(path: Path, encoding: str, size: tuple[int, int], name: str) -> np.ndarray:
    return read_picture(path, encoding, size=size, name=name)[0]
