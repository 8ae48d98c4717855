# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Middlebury's ``*_par.txt``; see `importers.middlebury`. Pixels have their centres where they have them here."""

from __future__ import annotations

from collections.abc import Sequence

from ...errors import ScanstageError
from .views import ExportedView


def middlebury_files(views: Sequence[ExportedView]) -> dict[str, bytes]:
    """Return the file: name, K, R and t of each picture on one line."""
    lines = [str(len(views))]
    for view in views:
        if view.camera.distorted:
            raise ScanstageError(f"frame {view.name}: Middlebury's format has no words for its lens; undistort the pictures, or export "
                                 "opencv")
        values = (*view.camera.K.ravel(), *view.camera.R.ravel(), *view.camera.t)
        lines.append(" ".join((view.file, *(repr(float(value)) for value in values))))
    return {"scanstage_par.txt": "".join(f"{line}\n" for line in lines).encode()}
