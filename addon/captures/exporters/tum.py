# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A trajectory as the TUM benchmark writes it; see `importers.tum` for its conventions. The n-th picture is taken at n seconds."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ...errors import ScanstageError
from .colmap import rotation_to_quaternion
from .opencv import storage_text, write_matrices
from .views import ExportedView


def tum_files(views: Sequence[ExportedView]) -> dict[str, bytes]:
    """Return ``groundtruth.txt``, ``rgb.txt`` and ``camera.yml`` with K and distortion, which the format itself has no place for."""
    first = views[0].camera
    poses, listing = ["# timestamp tx ty tz qx qy qz qw"], ["# timestamp filename"]
    for number, view in enumerate(views, start=1):
        camera = view.camera
        if camera.mirrored:
            raise ScanstageError(f"frame {view.name}: its camera is mirrored, which a trajectory cannot say; export opencv")
        if (camera.K != first.K).any() or (camera.distortion != first.distortion).any() or camera.size != first.size:
            raise ScanstageError(f"frame {view.name}: was taken by another camera than frame {views[0].name}, and a trajectory has one; "
                                 "export transforms or colmap")
        pose = (*camera.centre, *np.roll(rotation_to_quaternion(camera.R.T), -1))
        poses.append(f"{number} {' '.join(repr(float(value)) for value in pose)}")
        listing.append(f"{number} {view.file}")
    return {"groundtruth.txt": "".join(f"{line}\n" for line in poses).encode(),
            "rgb.txt": "".join(f"{line}\n" for line in listing).encode(),
            "camera.yml": storage_text(partial(write_matrices, K=first.K, distortion=first.distortion))}
