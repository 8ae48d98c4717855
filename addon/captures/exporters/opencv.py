# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenCV's FileStorage; see `importers.opencv`. It can say every camera that there is here."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from .views import ExportedView


def opencv_files(views: Sequence[ExportedView]) -> dict[str, bytes]:
    """Return ``cameras.yml``: a sequence ``frames`` of maps with ``image``, K, distortion, R and t."""
    def write(storage: cv2.FileStorage) -> None:
        storage.startWriteStruct("frames", cv2.FileNode_SEQ)
        for view in views:
            storage.startWriteStruct("", cv2.FileNode_MAP)
            storage.write("image", view.file)
            write_matrices(storage, K=view.camera.K, distortion=view.camera.distortion, R=view.camera.R, t=view.camera.t)
            storage.endWriteStruct()
        storage.endWriteStruct()

    return {"cameras.yml": storage_text(write)}


def storage_text(write: Callable[[cv2.FileStorage], None]) -> bytes:
    """Return the YAML of what ``write`` puts into a storage."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    write(storage)
    return storage.releaseAndGetString().encode()


def write_matrices(storage: cv2.FileStorage, **matrices: np.ndarray) -> None:
    """Write matrices, and vectors as columns, by their names."""
    for name, value in matrices.items():
        storage.write(name, np.array(value if value.ndim == 2 else value[:, None], np.float64))
