# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""SLStudio's calibration of camera and projector with a Gray-code scan: made up with everything that can be wrong, and a real one."""

import re

import cv2
import numpy as np
import pytest

from addon.captures.importers import import_capture
from addon.captures.pictures import write_picture
from addon.captures.scan import load_scan
from addon.errors import ScanstageError
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.geometry import Camera, rotation_about
from addon.reconstruction.methods import METHODS
from tests import experiments
from tests.projection import Wall, projected_view

CAMERA = Camera([[120.0, 0, 39.5], [0, 120, 29.5], [0, 0, 1]], np.eye(3), np.zeros(3), (80, 60), (-0.05, 0.01, 0, 0, 0))
PROJECTOR = Camera([[90.0, 0, 31.5], [0, 90, 23.5], [0, 0, 1]], rotation_about((0, 1, 0), 0.3), (-30.0, 1.0, 4.0), (64, 48), (-0.03, 0, 0, 0, 0))
MATRICES = {"Kc": CAMERA.K, "kc": CAMERA.distortion[:, None], "Kp": PROJECTOR.K, "kp": PROJECTOR.distortion[:, None], "Rp": PROJECTOR.R,
            "Tp": PROJECTOR.t[:, None]}


def write_source(folder, *, inverses=False, skip=(), drop=(), **changes):
    """Write the scan of a wall 100 mm away."""
    storage = cv2.FileStorage(str(folder / "calibration.xml"), cv2.FILE_STORAGE_WRITE)
    for name, value in {**MATRICES, "screenResX": 64, "screenResY": 48, **changes}.items():
        if name not in drop:
            storage.write(name, value)
    storage.release()
    *code, white, black = make_patterns("gray-code", PROJECTOR.size, {"axes": "columns", "inverses": inverses})
    view = projected_view(CAMERA, PROJECTOR, [white, black, *code], [Wall((0.0, 0.0, -1.0), -100.0)])
    for number, picture in enumerate(view.projected):
        if number not in skip:
            write_picture(folder / f"frameSeq_{number:02d}.png", picture.read_image(), bits=8)
    return folder


@pytest.mark.parametrize(("inverses", "skip", "finest"), [(False, (), 0), (True, (), 0), (False, (7,), 1)])
def test_a_scan_is_read_with_its_devices_and_patterns(tmp_path, inverses, skip, finest):
    source, out = tmp_path / "source", tmp_path / "set"
    source.mkdir()
    capture = import_capture("slstudio", write_source(source, inverses=inverses, skip=skip), out, {"encoding": "linear"})
    np.testing.assert_allclose(capture.projectors["projector"].P, PROJECTOR.P)
    np.testing.assert_allclose(capture.cameras["camera"].distortion, CAMERA.distortion)
    assert [frame.pattern for frame in capture.frames][:3] == ["white", "black", "gray-column-00"]
    assert min(fields["bit"] for fields in capture.patterns.values() if "bit" in fields) == finest
    cloud = METHODS["gray-code"].measure(load_scan(out, silhouettes=False)).cloud
    assert len(cloud) > 1000 and np.median(np.abs(cloud.positions[:, 2] - 100)) < 2 * np.median(cloud.sigma)


@pytest.mark.parametrize(("fault", "words"), [
    ({"drop": ("Rp",)}, "calibration.xml: Rp: is missing; check that this is a calibration of camera and projector"),
    ({"Kp": np.eye(2)}, "calibration.xml: Kp: must be a 3x3 matrix"),
    ({"Rp": 2 * np.eye(3)}, "R is not a rotation"),
    ({"screenResX": 0}, "calibration.xml: screenResX: must be a whole number"),
    ({"drop": ("screenResY",)}, "calibration.xml: screenResY: must be a whole number"),
    ({"screenResX": 4}, "holds 8 pictures where white, black and a Gray code of 4 columns are 3 to 4"),
    ({"skip": range(2, 8)}, "holds 2 pictures where"),
])
def test_what_is_wrong_is_said_and_nothing_is_left(tmp_path, fault, words):
    source, out = tmp_path / "source", tmp_path / "set"
    source.mkdir()
    write_source(source, **fault)
    with pytest.raises(ScanstageError, match=re.escape(words)):
        import_capture("slstudio", source, out)
    assert [path.name for path in tmp_path.iterdir()] == ["source"]


def test_real_scan_agrees_with_the_scanners_own_cloud(tmp_path, real_captures):
    """Issue figure: median distance of at most 0.5 mm."""
    ours, theirs = experiments.scanner_distances(real_captures("gray_code_skull"), tmp_path / "set")
    assert ours <= 0.5 and theirs <= 0.5
