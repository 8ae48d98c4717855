# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture set as methods take it: views in the object frame, with their silhouettes.

The one place where a rig's poses and the turntable's become cameras in the object frame, and pictures become masks.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..options import Value, resolve
from ..progress import Progress, silent
from ..reconstruction.geometry import MAX_SKEW_OF_ROTATION
from ..reconstruction.scan import LitPicture, ProjectedPicture, Scan, View
from ..reconstruction.silhouettes import SILHOUETTE_OPTIONS, extract
from .fields import Field
from .files import inside
from .pictures import read_mask, read_picture, write_mask
from .schema import FILE_NAME, Capture, Frame
from .store import files_of, read_capture

MASKS = "masks"


def load_scan(folder: Path, silhouette_options: Mapping[str, Value] | None = None, progress: Progress = silent, *,
              silhouettes: bool = True) -> Scan:
    """Read a capture set's views and take their silhouettes.

    Each silhouette is also written to ``masks/<frame id>.png`` in the set, to be looked at, unless the set cannot be
    written to or already names a file of its own so. Frames under a projected pattern are no views of their own, since what
    is projected changes the silhouette's look: they are `View.projected` of the frame that shares their camera and pose.
    Frames of one camera and pose under different lights are one view (see `lighting_groups`).

    Parameters
    ----------
    folder : Path
    silhouette_options : mapping of str to value, optional
        By the names of `SILHOUETTE_OPTIONS`; they override those that the set itself gives.
    progress : Progress
    silhouettes : bool
        False for a method that needs none: no mask is taken or written, and a set with a pattern in every frame will do.

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
    projected = _projected(folder, capture)
    frames = [frame for frame in capture.frames if frame.pattern is None]
    if silhouettes and not frames:
        raise ScanstageError(f"{FILE_NAME}: frames: a pattern is projected in every frame; "
                             "capture at least one frame without a pattern")
    options = resolve(SILHOUETTE_OPTIONS, {**capture.silhouette, **(silhouette_options or {})}, "silhouette")
    views, groups = [], lighting_groups(frames)
    for index, group in enumerate(groups):
        progress(index / len(groups), f"Silhouette {index + 1} of {len(groups)}")
        views.append(_view(folder, capture, group, options if silhouettes else None, projected.pop(_place(group[0]), ())))
    if not silhouettes:
        views += [_projected_view(capture, pictures) for pictures in projected.values()]
    progress(1.0, f"{len(views)} views")
    return Scan(tuple(views), None if capture.bounds is None else np.array(capture.bounds))


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
        id = _projector_of(capture, frame, fields)
        projector = None if id is None else capture.projectors[id].moved(motion)
        found.setdefault(_place(frame), []).append(ProjectedPicture(frame.id, fields, id, projector, _reader(folder, capture, frame)))
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
    mask = None if options is None else _checked_silhouette(folder, capture, frame, options)
    return View(frame.id, camera, mask, _reader(folder, capture, frame), tuple(
        LitPicture(lit.id, lit.lights[0], capture.lights[lit.lights[0]].moved(lit.object_to_world), _reader(folder, capture, lit))
        for lit in group if len(lit.lights) == 1), projected)


def _checked_silhouette(folder: Path, capture: Capture, frame: Frame, options: Mapping[str, Value]) -> np.ndarray:
    mask = _silhouette(folder, capture, frame, options)
    if not mask.any():
        raise ScanstageError(f"{frame.image}: the silhouette of frame {frame.id} is empty; check the picture, or take "
                             "the silhouette in another way with the silhouette options")
    if os.access(folder, os.W_OK):
        _write_mask(folder, capture, frame, mask)
    return mask


def _silhouette(folder: Path, capture: Capture, frame: Frame, options: Mapping[str, Value]) -> np.ndarray:
    size = capture.cameras[frame.camera].size
    rgb, alpha = read_picture(folder / frame.image, capture.encoding, size=size, name=frame.image)
    chosen = options["silhouette"]
    given = plate = None
    if frame.mask is not None and chosen in ("auto", "mask"):
        given = read_mask(folder / frame.mask, size=size, name=frame.mask)
    if frame.camera in capture.plates and chosen in ("auto", "plate"):
        name = capture.plates[frame.camera]
        plate = read_picture(folder / name, capture.encoding, size=size, name=name)[0]
    try:
        return extract(rgb, alpha, given, plate, **options)
    except ScanstageError as error:
        raise ScanstageError(f"{frame.image}: {error}") from None


def _write_mask(folder: Path, capture: Capture, frame: Frame, mask: np.ndarray) -> None:
    relative = f"{MASKS}/{frame.id}.png"
    inputs = {path.casefold() for _, path, _ in files_of(capture)}
    if relative.casefold() not in inputs:
        write_mask(inside(folder, relative, relative), mask)


def _reader(folder: Path, capture: Capture, frame: Frame) -> Callable[[], np.ndarray]:
    return partial(_read_image, folder / frame.image, capture.encoding, capture.cameras[frame.camera].size, frame.image)


def _read_image(path: Path, encoding: str, size: tuple[int, int], name: str) -> np.ndarray:
    return read_picture(path, encoding, size=size, name=name)[0]
