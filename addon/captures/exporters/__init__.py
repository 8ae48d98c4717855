# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture sets as other programs read them. A new format is one file here and one line in `EXPORTERS`.

What is exported are the views of the object: of each camera and pose the picture with the most light, none under a pattern
and none of the calibration board. Their cameras are those in the object frame, so that a turntable has become cameras that go round.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ...errors import ScanstageError
from ...files import making
from ...options import Option, Value, resolve
from ...progress import Progress, silent
from ..files import write_bytes
from ..pictures import read_picture, write_picture
from ..scan import MASKS, views_of_object
from ..schema import FILE_NAME, Capture, Frame
from ..store import read_capture
from .colmap import colmap_files
from .middlebury import middlebury_files
from .opencv import opencv_files
from .transforms import transforms_files
from .tum import tum_files
from .views import ExportedView


@dataclass(frozen=True)
class Exporter:
    """One format.

    Parameters
    ----------
    name, label, description : str
        On the command line, in panels, and what it writes, without a full stop.
    folder : str
        Where in the exported folder the pictures are: empty for beside the calibration.
    function : callable
        ``function(views) -> mapping of str to bytes``: the text files, by their paths.
    """

    name: str
    label: str
    description: str
    folder: str
    function: Callable[[list[ExportedView]], Mapping[str, bytes]]


EXPORTERS = {exporter.name: exporter for exporter in (
    Exporter("colmap", "COLMAP", "A text model (sparse/0) with the pictures in images", "images", colmap_files),
    Exporter("transforms", "NeRF transforms.json", "The file of NeRF, instant-ngp and nerfstudio, with the pictures in images", "images",
             transforms_files),
    Exporter("middlebury", "Middlebury Multi-View", "A *_par.txt with the pictures beside it; no lens distortion", "", middlebury_files),
    Exporter("opencv", "OpenCV FileStorage", "A cameras.yml with K, R, t and distortion of each picture beside it", "", opencv_files),
    Exporter("tum", "TUM trajectory", "A groundtruth.txt and rgb.txt with one camera's K in camera.yml and the pictures in rgb", "rgb",
             tum_files),
)}
OPTIONS = (
    Option("pictures", "srgb", "How the pictures are written", choices={
        "srgb": "as 8-bit PNG, as screens and other programs expect", "as-is": "copied as they are, also if their values are linear"}),
    Option("masks", True, "Write the silhouettes that lie in the set, too, where the format has a place for them"),
)


def export_capture(format: str, folder: Path, out: Path, options: Mapping[str, Value] | None = None,
                   progress: Progress = silent) -> int:
    """Write a capture set's views for other programs; return how many there are.

    Parameters
    ----------
    format : str
        A key of `EXPORTERS`.
    folder : Path
        A capture set.
    out : Path
        Folder to make, or an empty one.
    options : mapping of str to value, optional
        Of `OPTIONS`.
    progress : Progress

    Raises
    ------
    ScanstageError
        The format or an option is not known, the set cannot be used or expressed in the format, or ``out`` is taken.
    """
    if format not in EXPORTERS:
        raise ScanstageError(f"there is no export format {format!r}; known are: {', '.join(EXPORTERS)}")
    exporter, folder, out = EXPORTERS[format], Path(folder), Path(out)
    values = resolve(OPTIONS, options or {}, f"export {format}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ScanstageError(f"{out}: is there already and not an empty folder; name another one")
    capture = read_capture(folder)
    views = _views(folder, capture, exporter.folder, values)
    files = exporter.function(views)
    with making(out) as staged:
        for step, view in enumerate(views):
            progress(step / len(views), f"Writing {view.file}")
            _write_pictures(folder, capture, view, staged, values)
        for name, data in files.items():
            write_bytes(staged / name, data)
    progress(1.0, f"{len(views)} pictures written")
    return len(views)


def _views(folder: Path, capture: Capture, pictures: str, values: Mapping[str, Value]) -> list[ExportedView]:
    frames = [frame for frame in views_of_object(capture) if frame.pattern is None]
    missing = set(capture.missing)
    if late := [frame.id for frame in frames if frame.id in missing]:
        raise ScanstageError(f"{FILE_NAME}: missing: {len(late)} of {len(frames)} frames are not rendered yet (first: {late[0]}); run "
                             "capture again to render them")
    if not frames:
        raise ScanstageError(f"{FILE_NAME}: frames: a pattern is projected in every frame, or a board shown; there is no view to export")
    views = []
    for frame in frames:
        suffix = ".png" if values["pictures"] == "srgb" else Path(frame.image).suffix
        mask = _mask_of(folder, frame) if values["masks"] else None
        views.append(ExportedView(frame.id, f"{pictures}/{frame.id}{suffix}".lstrip("/"), capture.camera_of(frame), frame,
                                  None if mask is None else f"masks/{frame.id}{mask.suffix}", mask))
    return views


def _mask_of(folder: Path, frame: Frame) -> Path | None:
    """Return the silhouette's picture in a set: its own, or the one that a reconstruction has left there."""
    found = folder / (frame.mask or f"{MASKS}/{frame.id}.png")
    return found if found.is_file() else None


def _write_pictures(folder: Path, capture: Capture, view: ExportedView, staged: Path, values: Mapping[str, Value]) -> None:
    source, target = folder / view.frame.image, staged / view.file
    target.parent.mkdir(parents=True, exist_ok=True)
    if values["pictures"] == "srgb":
        rgb, alpha = read_picture(source, capture.encoding)
        write_picture(target, rgb, alpha, encoding="srgb", bits=8)
    else:
        shutil.copyfile(source, target)
    if view.mask is not None:
        (staged / view.mask).parent.mkdir(exist_ok=True)
        shutil.copyfile(view.mask_source, staged / view.mask)
