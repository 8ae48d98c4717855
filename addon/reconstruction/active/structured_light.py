# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The methods `gray-code` and `phase-shift`: a projector that numbers its columns and rows."""

from __future__ import annotations

from collections.abc import Iterator

from ...errors import ScanstageError
from ...options import Option, Unit
from ...progress import Progress, silent
from ..geometry import Camera
from ..scan import ProjectedPicture, Scan, View
from .correspondence import CONTRAST
from .decoding import decode_view
from .free_space import FILLS
from .measurement import MAX_GAP, Measurement, measure_view

FILL = Option("fill", "shell", "Which voxels are occupied", choices=FILLS)
_CONTRAST = Option("contrast", CONTRAST, "Least light from the projector, as a share of white, by which a pixel is decoded", minimum=0.0,
                   maximum=1.0)
_GAP = Option("max_gap", MAX_GAP, "How far the rays of camera and projector may miss each other, in pixels of the projector, where "
              "columns and rows are encoded", unit=Unit.PIXELS, minimum=0.0, maximum=1000.0)
_ROBUST = Option("robust", True, "Believe only bits that indirect light cannot have turned")
GRAY_OPTIONS = (_CONTRAST, _ROBUST, _GAP, FILL)
PHASE_OPTIONS = (_CONTRAST, _ROBUST, Option(
    "noise", 0.0, "Noise of the pictures, as a share of white, for the expected error of the points; 0 to take it from the pictures "
    "themselves", minimum=0.0, maximum=1.0), _GAP, FILL)


def measure_gray_code(scan: Scan, *, contrast: float = CONTRAST, robust: bool = True, max_gap: float = MAX_GAP, fill: str = "shell",
                      progress: Progress = silent) -> Measurement:
    """Measure points by Gray code; see `decoding.decode_view` and `measurement.measure_view`."""
    return _measured(scan, "gray-code", max_gap, progress, contrast=contrast, robust=robust)


def measure_phase_shift(scan: Scan, *, contrast: float = CONTRAST, robust: bool = True, noise: float = 0.0, max_gap: float = MAX_GAP,
                        fill: str = "shell", progress: Progress = silent) -> Measurement:
    """Measure points by phase shifting; see `decoding.decode_view` and `measurement.measure_view`."""
    return _measured(scan, "phase-shift", max_gap, progress, contrast=contrast, robust=robust, noise=noise)


def _measured(scan: Scan, code: str, max_gap: float, progress: Progress, **decoding) -> Measurement:
    views = list(projections(scan))
    if not views:
        raise ScanstageError(f"no frame of the capture was taken under a pattern, and {code} needs them; capture with a projector")
    parts = []
    for step, (number, view, projector, pictures) in enumerate(views):
        progress(step / len(views), f"Decoding view {view.name}")
        decoded = decode_view(pictures, projector.size, code=code, where=f"the view of frame {view.name}", **decoding)
        parts.append(measure_view(view, number, projector, decoded, max_gap=max_gap))
    progress(1.0, "Decoded")
    return Measurement.joined(parts)


def projections(scan: Scan) -> Iterator[tuple[int, View, Camera, list[ProjectedPicture]]]:
    """Yield each view with each projector that shows patterns in it: number, view, projector and its pictures.

    Raises
    ------
    ScanstageError
        A pattern has no projector.
    """
    for number, view in enumerate(scan.views):
        groups: dict[str, list[ProjectedPicture]] = {}
        for picture in view.projected:
            if picture.projector is None:
                raise ScanstageError(f"frame {picture.name}: its pattern has no projector; calibrate one and add it to the capture set")
            groups.setdefault(str(picture.projector_id), []).append(picture)
        for pictures in groups.values():
            yield number, view, pictures[0].projector, pictures
