# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A small valid capture set, as a document and on disk."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest

from addon.captures.pictures import write_picture
from addon.reconstruction.geometry import look_at

SIZE = (8, 6)
R, T = look_at((2.0, 1.0, 0.5), (0.0, 0.0, 0.0))
CAMERA = {"size": list(SIZE), "K": [[9.0, 0.1, 3.5], [0, 9.5, 2.5], [0, 0, 1]], "distortion": [-0.1, 0.01, 0.001, 0.002, 0],
          "R": R.tolist(), "t": T.tolist(), "mirrored": False}
QUARTER_TURN = [[0.0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
DOCUMENT = {
    "format": "scanstage-capture", "version": 1, "generator": "a test",
    "devices": {"cameras": {"left": CAMERA}, "projectors": {"beam": copy.deepcopy(CAMERA)},
                "lights": {"lamp": {"kind": "spot", "position": [1, 2, 3], "direction": [0, 0, -1], "radius": 0.01},
                           "sun": {"kind": "sun", "position": None, "direction": [0, 0, -1], "radius": 0}}},
    "frames": [{"id": "0001", "image": "images/0001.png", "camera": "left", "object_to_world": np.eye(4).tolist(),
                "lights": ["lamp"], "pattern": None, "mask": None, "board_pose": None, "contours": None},
               {"id": "0002", "image": "images/0002.png", "camera": "left", "object_to_world": QUARTER_TURN,
                "lights": ["lamp", "sun"], "pattern": "stripes", "mask": "given/0002.png", "board_pose": "by hand 1",
                "contours": "given/0002.txt"}],
    "patterns": {"stripes": {"kind": "gray-code", "bit": 3}},
    "encoding": "srgb", "silhouette": {"silhouette": "threshold", "threshold": 0.3}, "plate": {"left": "plates/left.png"},
    "bounds": [[-1, -1, 0], [1, 1, 2]], "truth": {"mesh": "truth.ply"}, "missing": ["0002"],
    "board": {"kind": "charuco", "columns": 10, "rows": 7, "square": 0.03, "marker": 0.022, "dictionary": "4X4_50"},
    "pencils": {"light": "lamp", "camera": "left", "board_pose": "by hand 1", "height": 0.13, "bases": [[1.0, 2.5], [3.0, 4.0]],
                "shadow_tips": [[5.0, 2.0], [6.5, 3.0]]},
}


@pytest.fixture
def document() -> dict:
    """A valid capture.json that uses every field."""
    return copy.deepcopy(DOCUMENT)


@pytest.fixture
def capture_folder(tmp_path, document) -> Path:
    """A whole capture set of two frames: a bright square on black, with a mask, a plate and a truth."""
    document["missing"], document["frames"][1]["board_pose"], document["frames"][1]["contours"], document["pencils"] = [], None, None, None
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.float32)
    picture[2:4, 3:6] = 0.8
    for name in ("images/0001.png", "images/0002.png", "given/0002.png"):
        write_picture(tmp_path / name, picture, encoding="srgb", bits=8)
    write_picture(tmp_path / "plates/left.png", np.zeros_like(picture), encoding="srgb", bits=8)
    (tmp_path / "truth.ply").write_bytes(b"ply\n")
    (tmp_path / "capture.json").write_text(json.dumps(document))
    return tmp_path
