# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What every exporter is given, and what a format may not be able to say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...reconstruction.geometry import Camera
from ..schema import Frame


@dataclass(frozen=True)
class ExportedView:
    """One picture of the object.

    Parameters
    ----------
    name : str
        The frame's id.
    file : str
        The picture's path in the exported folder.
    camera : Camera
        In the object frame.
    frame : Frame
    mask : str or None
        The silhouette's path in the exported folder.
    mask_source : Path or None
        Where it is now.
    """

    name: str
    file: str
    camera: Camera
    frame: Frame
    mask: str | None = None
    mask_source: Path | None = None


def refuse_unsayable(view: ExportedView, format: str, *, distortion: int = 5) -> None:
    """Refuse a camera that a format has no words for.

    Parameters
    ----------
    view : ExportedView
    format : str
    distortion : int
        How many of ``k1 k2 p1 p2 k3`` the format has.

    Raises
    ------
    ScanstageError
        The camera is mirrored, its pixels are skewed, or its lens has more terms.
    """
    camera = view.camera
    if camera.mirrored:
        raise ScanstageError(f"frame {view.name}: its camera is mirrored, which {format} cannot say; export opencv")
    if abs(camera.K[0, 1]) > 1e-9 * camera.K[0, 0]:
        raise ScanstageError(f"frame {view.name}: its pixels are skewed, which {format} cannot say; export opencv or middlebury")
    if np.any(camera.distortion[distortion:]):
        kept = f"{distortion} of its lens's 5 terms" if distortion else "no distortion of its lens"
        raise ScanstageError(f"frame {view.name}: {format} can say {kept}; undistort the pictures, or export opencv")
