# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other people's captures as capture sets. A new format is one file here and one line in `IMPORTERS`.

An importer reads cameras and says which picture belongs to which; what all formats share is done here: the options,
the copy of the pictures, and that the set appears whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import ScanstageError
from ...options import Option, Value, resolve
from ...progress import Progress, silent
from ...reconstruction.silhouettes import SILHOUETTE_OPTIONS
from ..placing import check_place, put_in_place
from ..schema import Capture
from .board import BOARD_OPTIONS, read_board
from .bouguet import read_bouguet
from .colmap import read_colmap
from .desk import read_desk
from .middlebury import MIDDLEBURY_OPTIONS, read_middlebury
from .opencv import read_opencv
from .silhouettes import with_masks
from .slstudio import read_slstudio
from .sources import Import
from .transforms import read_transforms
from .tum import TUM_OPTIONS, read_tum
from .turntable import TURNTABLE_OPTIONS, read_turntable
from .undistorting import undistorted


@dataclass(frozen=True)
class Importer:
    """One format.

    Parameters
    ----------
    name : str
        On the command line.
    label : str
        In panels.
    description : str
        What the source must hold, without a full stop.
    options : tuple of Option
        Its own, beside `COMMON_OPTIONS` and the silhouette's.
    function : callable
        ``function(source: Path, **options) -> Import``.
    """

    name: str
    label: str
    description: str
    options: tuple[Option, ...]
    function: Callable[..., Import]


COMMON_OPTIONS = (
    Option("encoding", "srgb", "How the pictures' values stand for light", choices={
        "srgb": "As screens and cameras' JPEGs have it", "linear": "In proportion to the light"}),
    Option("masks", "", "Folder with the silhouette of each picture under the picture's name, as a mask or, ending in .txt, as outlines; "
           "from the source's folder on"),
    Option("undistort", False, "Free the pictures and masks of the lens's distortion once and for all, and crop what is then not known; "
           "otherwise the lens is kept, and every method allows for it"),
)

IMPORTERS = {importer.name: importer for importer in (
    Importer("middlebury", "Middlebury Multi-View",
             "The folder of a Middlebury multi-view stereo set, or its *_par.txt", MIDDLEBURY_OPTIONS, read_middlebury),
    Importer("opencv", "OpenCV FileStorage",
             "An XML, YAML or JSON file of OpenCV's with a P, or K R t, for each picture beside it", (), read_opencv),
    Importer("colmap", "COLMAP", "A text model (cameras.txt, images.txt) with its pictures in a folder images near it", (), read_colmap),
    Importer("transforms", "NeRF transforms.json", "The file of NeRF, instant-ngp or nerfstudio with its pictures below it", (),
             read_transforms),
    Importer("turntable", "Turntable pictures", "A folder of one camera's pictures of a turning object, with an OpenCV file of K and the "
             "table's axis", TURNTABLE_OPTIONS, read_turntable),
    Importer("tum", "TUM trajectory", "A trajectory (timestamp tx ty tz qx qy qz qw) with its pictures and an OpenCV file of their K",
             TUM_OPTIONS, read_tum),
    Importer("bouguet", "Bouguet's toolbox", "Calib_Results.m with the pictures of its numbers beside it, and outlines as .txt", (),
             read_bouguet),
    Importer("board", "Calibration board", "A folder of pictures of a calibration board before one camera, to be calibrated",
             BOARD_OPTIONS, read_board),
    Importer("slstudio", "SLStudio", "The calibration of a camera and a projector (Kc kc Kp kp Rp Tp) with the frames of a Gray-code scan",
             (), read_slstudio),
    Importer("desk", "Desk and stick", "A folder of calib/, the frames of a stick's shadow and annotations.json, to be calibrated",
             (), read_desk),
)}


def import_capture(format: str, source: Path, out: Path, options: Mapping[str, Value] | None = None,
                   progress: Progress = silent) -> Capture:
    """Turn other people's captures into a capture set.

    Parameters
    ----------
    format : str
        A key of `IMPORTERS`.
    source : Path
        File or folder, as the format has it.
    out : Path
        Folder to make. A capture set that is there is replaced, once the new one is complete.
    options : mapping of str to value, optional
        Of the importer, of `COMMON_OPTIONS`, and of `SILHOUETTE_OPTIONS`; the latter are stored in the set.
    progress : Progress

    Returns
    -------
    Capture

    Raises
    ------
    ScanstageError
        The format or an option is not known, the source cannot be used, or ``out`` holds something else.
    """
    if format not in IMPORTERS:
        raise ScanstageError(f"there is no import format {format!r}; known are: {', '.join(IMPORTERS)}")
    importer, source, out = IMPORTERS[format], Path(source), Path(out)
    given = dict(options or {})
    silhouette_names = {option.name for option in SILHOUETTE_OPTIONS}
    resolved = resolve(importer.options + COMMON_OPTIONS + SILHOUETTE_OPTIONS, given, f"import {format}")
    if not source.exists():
        raise ScanstageError(f"{source}: is not there; give the {format} source's path")
    check_place(source, out)
    found = importer.function(source, **{option.name: resolved[option.name] for option in importer.options})
    if resolved["masks"]:
        found = with_masks(found, (source if source.is_dir() else source.parent) / resolved["masks"])
    found, made = undistorted(found, resolved["encoding"]) if resolved["undistort"] else (found, {})
    capture = replace(found.capture, encoding=resolved["encoding"], generator=f"scanstage import {format}", silhouette={
        **found.capture.silhouette, **{name: resolved[name] for name in given if name in silhouette_names}})
    put_in_place(capture, found.pictures, out, progress, made=made)
    return capture
