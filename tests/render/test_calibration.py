# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A rendered rig calibrates to the devices that rendered it: one convention from the stage to the report."""

import numpy as np

from addon.calibration import calibrate
from addon.captures.store import read_capture
from addon.render.capture import capture_frames
from addon.stage import staging

OPTIONS = {"poses": 4, "turns": 3, "columns": 7, "rows": 5, "resolution_x": 320, "resolution_y": 240, "projector_x": 128, "projector_y": 96,
           "throw_ratio": 0.9, "projector_k1": -0.1}


def test_camera_projector_and_table_are_found_as_they_were_rendered(empty_scene, tmp_path):
    staging.build(empty_scene, "calibration", "monkey", OPTIONS)
    list(capture_frames(empty_scene, tmp_path / "before"))
    report = calibrate(tmp_path / "before", tmp_path / "after", options={"camera_lens": "none"})
    camera, projector = report["devices"].values()
    assert camera["rms"] < 0.2 and projector["rms"] < 0.3 and not report["not_found"]
    before, after = read_capture(tmp_path / "before"), read_capture(tmp_path / "after")
    # Twenty-four corners to a tenth of a pixel in 7 poses of 5 tilts: some parts in 1000 of focal length and distance
    for true, found in zip((*before.cameras.values(), *before.projectors.values()), (*after.cameras.values(), *after.projectors.values()), strict=True):
        distance = np.linalg.norm(true.t)
        np.testing.assert_allclose(found.K, true.K, rtol=0.02, atol=0.01 * true.size[0])
        np.testing.assert_allclose(found.centre, true.centre, atol=0.02 * distance)
    assert np.degrees(np.arccos(after.cameras["camera-1"].R[:, 2] @ before.cameras["camera-1"].R[:, 2])) < 0.5
    assert max(map(abs, report["turntable"]["angle_errors"].values())) < 0.3  # a tenth of a pixel at 40 pixels from the middle is 0.14
