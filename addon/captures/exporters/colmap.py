# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's text model; see `importers.colmap` for its conventions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..importers.colmap import HALF_PIXEL
from .views import ExportedView, refuse_unsayable

_TERMS = 4  # of the lens: k1 k2 p1 p2


def colmap_files(views: Sequence[ExportedView]) -> dict[str, bytes]:
    """Return ``cameras.txt``, ``images.txt`` and an empty ``points3D.txt``; equal lenses are one camera."""
    lenses: dict[str, int] = {}
    images = []
    for number, view in enumerate(views, start=1):
        refuse_unsayable(view, "COLMAP", distortion=_TERMS)
        lens = lenses.setdefault(_lens(view), len(lenses) + 1)
        pose = (*rotation_to_quaternion(view.camera.R), *view.camera.t)
        images += [f"{number} {_numbers(pose)} {lens} {view.file.removeprefix('images/')}", ""]
    cameras = [f"{number} {lens}" for lens, number in lenses.items()]
    return {"sparse/0/cameras.txt": _text("Camera list: CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", cameras),
            "sparse/0/images.txt": _text("Image list, two lines each: IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; POINTS2D[]",
                                         images),
            "sparse/0/points3D.txt": _text("3D point list: empty", [])}


def rotation_to_quaternion(R: np.ndarray) -> np.ndarray:
    """Return the unit quaternion ``w x y z``, w not negative, of a rotation (Shepperd, 1978: by the largest of its four parts)."""
    trace = np.trace(R)
    parts = np.array([trace, *np.diag(R)])
    largest = int(parts.argmax())
    scale = np.sqrt(1 + (trace if largest == 0 else 2 * parts[largest] - trace)) * 2  # four times the largest part
    off = np.array([[R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]])[0]
    quaternion = np.empty(4)
    if largest == 0:
        quaternion[0], quaternion[1:] = scale / 4, off / scale
    else:
        i, j, k = (largest - 1, largest % 3, (largest + 1) % 3)
        quaternion[0], quaternion[1 + i] = off[i] / scale, scale / 4
        quaternion[1 + j], quaternion[1 + k] = (R[i, j] + R[j, i]) / scale, (R[i, k] + R[k, i]) / scale
    return quaternion if quaternion[0] >= 0 else -quaternion


def _lens(view: ExportedView) -> str:
    K, (width, height), distortion = view.camera.K, view.camera.size, view.camera.distortion
    values = [K[0, 0], K[1, 1], K[0, 2] + HALF_PIXEL, K[1, 2] + HALF_PIXEL]
    if not view.camera.distorted:
        return f"PINHOLE {width} {height} {_numbers(values)}"
    return f"OPENCV {width} {height} {_numbers((*values, *distortion[:_TERMS]))}"


def _numbers(values) -> str:
    return " ".join(repr(float(value)) for value in values)


def _text(head: str, lines: Sequence[str]) -> bytes:
    return "".join(f"{line}\n" for line in (f"# {head}", *lines)).encode()
