# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenCV's FileStorage; see `importers.opencv`. It can say every camera that there is here."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from .views import ExportedView


def opencv_files(views: Sequence[ExportedView]) -> dict[str, bytes]:
    """Return ``cameras.yml``: a sequence ``frames`` of maps with ``image``, K, distortion, R and t."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    storage.startWriteStruct("frames", cv2.FileNode_SEQ)
    for view in views:
        storage.startWriteStruct("", cv2.FileNode_MAP)
        storage.write("image", view.file)
        for name, value in (("K", view.camera.K), ("distortion", view.camera.distortion[:, None]), ("R", view.camera.R),
                            ("t", view.camera.t[:, None])):
            storage.write(name, np.array(value, np.float64))
        storage.endWriteStruct()
    storage.endWriteStruct()
    return {"cameras.yml": storage.releaseAndGetString().encode()}
