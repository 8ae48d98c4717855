# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras and projectors from corners: exact from exact ones, and as good as the noise allows from others."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.calibration.board import Board
from addon.reconstruction.calibration.rig import calibrate_rig
from addon.reconstruction.geometry import rotation_about
from tests.boards import device, sighting, spread_poses

BOARD = Board("checkerboard", 11, 8, 0.025)  # 10 x 7 corners
CAMERA = device(1400, (1280, 960))
TILTED = rotation_about((0, 1, 0), 0.3) @ rotation_about((1, 0, 0), 0.05)
PROJECTOR = device(1600, (1280, 800), centre=(620, 790), R=TILTED, t=(-0.25, 0.02, 0.05))  # its lens is shifted by half a picture
NAMES = {"camera": CAMERA, "projector": PROJECTOR}


def sightings(devices, poses, noise=None, rng=None):
    return [sighting(name, one, BOARD, pose, number, 0.0 if noise is None else rng.normal(0, noise[name], (70, 2)))
            for number, pose in enumerate(poses) for name, one in devices.items()]


def poses_for(rng, count=12):
    return spread_poses(BOARD, rng, count, nearest=0.7, furthest=1.0)


def calibrated(devices, seen, lens="none"):
    return calibrate_rig(BOARD.corners, seen, {name: one.size for name, one in devices.items()}, dict.fromkeys(devices, lens))


def degrees_between(R, other):
    return np.degrees(np.linalg.norm(cv2.Rodrigues(R @ other.T)[0]))


LENSES = {"none": (0, 0, 0, 0, 0), "radial": (-0.1, 0.05, 0, 0, 0), "brown": (-0.2, 0.1, 0.002, -0.003, 0),
          "full": (-0.25, 0.12, 0.001, 0.002, -0.05)}


@pytest.mark.parametrize("lens", LENSES)
def test_perfect_corners_give_the_devices_to_a_millionth(lens):
    devices = {name: replace(one, distortion=LENSES[lens]) for name, one in NAMES.items()}
    poses = poses_for(np.random.default_rng(1))
    rig = calibrated(devices, sightings(devices, poses), lens)
    for name, one in devices.items():
        found = rig.devices[name]
        np.testing.assert_allclose(found.K, one.K, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.R, one.R, atol=1e-6)
        np.testing.assert_allclose(found.t, one.t, atol=1e-6 * np.linalg.norm(PROJECTOR.t))
        np.testing.assert_allclose(found.distortion, one.distortion, atol=1e-5)  # k3 moves these corners by less than a pixel
        assert rig.rms(name) < 1e-6
    for number, pose in enumerate(poses):
        np.testing.assert_allclose(rig.poses[str(number)], pose, atol=1e-6)


def test_noise_moves_the_devices_by_no_more_than_twice_what_it_does_in_19_of_20_calibrations():
    """Bounds: twice the 95 % column of a Monte-Carlo table made with OpenCV alone (10 x 7 corners, 12 poses, 0.1 and 0.15 px)."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        rig = calibrated(NAMES, sightings(NAMES, poses_for(rng), {"camera": 0.10, "projector": 0.15}, rng))
        camera, projector = rig.devices.values()
        assert 0.12 < rig.rms("camera") < 2 * 0.142 and 0.18 < rig.rms("projector") < 2 * 0.211  # noise * sqrt(2), point by point
        for found, true, focal, principal in ((camera, CAMERA, 0.22, 1.2), (projector, PROJECTOR, 0.17, 2.4)):
            assert 100 * np.abs(np.diag(found.K)[:2] / np.diag(true.K)[:2] - 1).max() < 2 * focal
            assert np.linalg.norm(found.K[:2, 2] - true.K[:2, 2]) < 2 * principal
        assert degrees_between(projector.R, PROJECTOR.R) < 2 * 0.10
        assert 1000 * np.linalg.norm(projector.t - PROJECTOR.t) < 2 * 2.2


def test_standard_deviations_are_those_of_the_errors():
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        rig = calibrated({"camera": CAMERA}, sightings({"camera": CAMERA}, poses_for(rng, 8), {"camera": 0.2}, rng))
        K = rig.devices["camera"].K
        errors.append(np.array([K[0, 0] - 1400, K[1, 1] - 1400, *(K[:2, 2] - CAMERA.K[:2, 2])]) / rig.deviations["camera"][:4])
        assert not rig.deviations["camera"][4:].any()
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.6  # 48 numbers, not all independent, of unit variance


def test_three_devices_of_which_no_pose_is_seen_by_all():
    left = replace(CAMERA, R=rotation_about((0, 1, 0), -0.2), t=np.array([0.15, 0.0, 0.02]))
    devices = {**NAMES, "left": left}
    seen = [one for one in sightings(devices, poses_for(np.random.default_rng(3), 16))
            if {"camera": int(one.pose) < 10, "projector": 4 <= int(one.pose), "left": int(one.pose) >= 10}[one.device]]
    rig = calibrated(devices, seen)
    for name, one in devices.items():
        np.testing.assert_allclose(rig.devices[name].R, one.R, atol=1e-6)
        np.testing.assert_allclose(rig.devices[name].t, one.t, atol=1e-6)


def test_corners_may_be_missing():
    rng = np.random.default_rng(4)
    seen = []
    for one in sightings(NAMES, poses_for(rng)):
        kept = np.sort(rng.permutation(70)[:25])
        seen.append(replace(one, ids=one.ids[kept], pixels=one.pixels[kept]))
    np.testing.assert_allclose(calibrated(NAMES, seen).devices["projector"].K, PROJECTOR.K, rtol=1e-6, atol=1e-9)


def test_residuals_are_seen_minus_predicted():
    rng = np.random.default_rng(5)
    seen = sightings({"camera": CAMERA}, poses_for(rng), {"camera": 0.3}, rng)
    rig = calibrated({"camera": CAMERA}, seen)
    for one, residual in zip(rig.sightings, rig.residuals, strict=True):
        pose, camera = rig.poses[one.pose], rig.devices["camera"]
        rvec, tvec = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]
        predicted = cv2.projectPoints(BOARD.corners[one.ids], rvec, tvec, camera.K, camera.distortion)[0].reshape(-1, 2)
        np.testing.assert_allclose(residual, one.pixels - predicted, atol=1e-9)


def test_what_bears_no_calibration_is_refused_in_one_sentence():
    poses = poses_for(np.random.default_rng(6))
    with pytest.raises(ScanstageError, match=r"^camera: the board is found in 2 pose\(s\) \(frames: 0000, 0001\); show it in at least 3"):
        calibrated({"camera": CAMERA}, sightings({"camera": CAMERA}, poses[:2]))
    apart = [one for one in sightings(NAMES, poses) if (one.device == "camera") == (int(one.pose) < 6)]
    with pytest.raises(ScanstageError, match="^projector: sees the board in no pose that camera sees"):
        calibrated(NAMES, apart)
