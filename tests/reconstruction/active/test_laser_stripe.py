# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Stripes and points of light: where they are between samples, and why time tells it better than space."""

import dataclasses
import re

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction import methods
from addon.reconstruction.active.correspondence import Reason
from addon.reconstruction.active.laser_stripe import passing_times, stripe_peaks
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.peaks import ESTIMATORS, centroid_deviations, peak_offsets
from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.scan import ProjectedPicture, Scan, View
from tests.projection import Wall, picture_rays, projected_view
from tests.rigs import camera_at

RANDOM = np.random.default_rng(2)
WALL = Wall((0.0, -1.0, 0.0), 0.0)


def measured(view, **options):
    return methods.METHODS["laser-stripe"].measure(Scan((view,)), **options)


def laser_view(camera, *, frames=60, width=0.02, albedo=lambda points: np.full(points.shape[:-1], 0.8), reach=0.35, shift=0.0, noise=0.0):
    """Return a view of the wall y = 0 under a laser that turns about an axis to the camera's right."""
    light = np.array([0.8, -2.0, 0.0])
    targets = np.linspace(-reach, reach, frames) + shift
    normals = np.cross(np.stack((targets, np.zeros(frames), np.zeros(frames)), -1) - light, (0.0, 0.0, 1.0))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rays = picture_rays(camera)
    points = camera.centre + WALL.distances(camera.centre, rays)[..., None] * rays
    colors = albedo(points)

    def reader(number):
        def read():
            beside = (points - light) @ normals[number]
            grey = colors * np.exp(-8 * (beside / width) ** 2) + np.random.default_rng(number).normal(0, noise, colors.shape)
            return np.repeat(np.clip(grey, 0, 1).astype(np.float32)[..., None], 3, axis=2)
        return read

    shots = tuple(ProjectedPicture(f"{n:04d}", {"kind": "laser", "plane": [*normals[n], float(normals[n] @ light)], "width": width}, None, None,
                                   reader(n)) for n in range(frames))
    return View("laser", camera, None, reader(frames // 2), projected=shots)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_every_estimator_finds_a_beams_middle(estimator):
    true = RANDOM.uniform(-0.5, 0.5, 500)
    windows = 0.1 + 0.7 * np.exp(-0.5 * ((np.arange(-8, 9)[:, None] - true) / 1.8) ** 2)
    assert np.abs(peak_offsets(windows, estimator) - true).max() < 0.02


@pytest.mark.parametrize("estimator", ["gaussian", "parabola", "zero-crossing"])
def test_a_flat_window_has_no_peak(estimator):
    assert not np.isfinite(peak_offsets(np.full((9, 3), 0.5), estimator)).any() or estimator == "gaussian"


def test_noise_of_the_centroid_is_the_predicted_one():
    clean = np.exp(-0.5 * ((np.arange(-6, 7)[:, None] - RANDOM.uniform(-0.5, 0.5, 20_000)) / 1.5) ** 2)
    offsets = peak_offsets(clean + RANDOM.normal(0, 0.01, clean.shape), "centroid") - peak_offsets(clean, "centroid")
    assert offsets.std() == pytest.approx(np.sqrt(np.mean(centroid_deviations(clean, 0.01) ** 2)), rel=0.1)


@pytest.mark.parametrize("half", [3, 6])
def test_passing_times_are_those_of_the_beam_and_ends_of_the_sweep_are_not_trusted(half):
    true = RANDOM.uniform(0, 39, (20, 30))
    images = [np.exp(-0.5 * ((frame - true) / 1.2) ** 2).astype(np.float32) for frame in range(40)]
    images[10][0] = images[30][0] = 0  # frames in which something else happens
    index, deviation, reason = passing_times(iter(images), 40, half, estimator="centroid" if half == 6 else "gaussian")
    inner = (true > half + 1) & (true < 38 - half) & (np.arange(20) > 0)[:, None]
    assert (reason[inner] == Reason.VALID).all() and np.abs(index - true)[inner].max() < 0.02
    assert (reason[(true < half - 1) | (true > 40 - half)] == Reason.UNCERTAIN).all()


def test_dark_and_saturated_pixels_say_so():
    profile = np.exp(-0.5 * ((np.arange(40) - 20.3) / 1.2) ** 2)
    images = [np.array([[0.9 * value, 0.01 * value, min(3 * value, 1.0)]], np.float32) for value in profile]
    reason = passing_times(iter(images), 40, 5)[2]
    assert reason.tolist() == [[Reason.VALID, Reason.UNLIT, Reason.SATURATED]]


def test_rms_of_a_stripe_in_a_noisy_picture_is_a_tenth_of_a_pixel():
    """methods.md T1b: 8 bits, noise of 2 / 255."""
    true = RANDOM.uniform(30, 70, 400)
    image = 0.6 * np.exp(-0.5 * ((np.arange(100) - true[:, None]) / 1.5) ** 2) + RANDOM.normal(0, 2 / 255, (400, 100))
    lines, places, _, reason = stripe_peaks((np.rint(np.clip(image, 0, 1) * 255) / 255).astype(np.float32), 5, estimator="centroid", contrast=0.05,
                                            noise=2 / 255)
    assert len(lines) == 400 and (reason == Reason.VALID).all()
    assert np.sqrt(np.mean((places - true[lines]) ** 2)) < 0.1


@pytest.mark.parametrize("analysis", ["temporal", "spatial"])
@pytest.mark.parametrize("light", ["column", "row", "laser"])
def test_a_plane_comes_back_without_noise(camera, projector, bent, analysis, light):
    if light == "laser":
        view = laser_view(bent(camera), frames=140)
    else:
        above = camera_at((0.0, -1.9, 0.9), focal=180.0, size=(128, 96)) if light == "row" else projector
        patterns = make_patterns("stripe-sweep", above.size, {"axis": light})
        view = projected_view(bent(camera), bent(above), patterns, [WALL])
    cloud = measured(view, analysis=analysis).cloud
    assert len(cloud) > 3000
    # A stripe is seen under perspective, so that its profile in a picture is not quite symmetric; in time it is.
    assert np.sqrt(np.mean(cloud.positions[:, 1] ** 2)) < (2e-4 if analysis == "temporal" else 2e-3)


def test_a_reflectance_step_hardly_moves_the_peak_in_time():
    """Issue figure: a step of 10 to 1, whose error in the picture the analysis in time cuts by 80 %."""
    camera = camera_at((0.0, -2.0, 0.0), focal=460.0, size=(160, 40))

    def albedo(points):
        return np.where(points[..., 0] > 0.013, 0.08, 0.8)

    view = laser_view(camera, frames=120, width=0.03, albedo=albedo, reach=0.2)
    worst = {}
    for analysis in ("temporal", "spatial"):
        cloud = measured(view, analysis=analysis, contrast=0.01).cloud
        near = np.abs(cloud.positions[:, 0] - 0.013) < 0.03
        assert np.count_nonzero(near) > 100
        worst[analysis] = np.abs(cloud.positions[near, 1]).max()
    assert worst["spatial"] > 2e-3  # or there is nothing to cut
    assert worst["temporal"] <= 0.2 * worst["spatial"]


def test_fourteen_centimetres_and_560_samples_are_a_quarter_of_a_millimetre_apart():
    """Issue figure, of the Digital Michelangelo project's scanner: 14 cm wide field from 1.12 m away."""
    focal = 560 * 1.12 / 0.14
    camera = Camera([[focal, 0, 279.5], [0, focal, 9.5], [0, 0, 1]], *look_at((0.0, -1.12, 0.0), (0.0, 0.0, 0.0)), (560, 20))
    cloud = measured(laser_view(camera, frames=160, width=0.004, reach=0.075)).cloud
    x, z = cloud.positions[:, 0], cloud.positions[:, 2]
    row = np.argsort(np.round(z / 0.00025) * 10 + x)
    gaps = np.diff(x[row])
    assert np.median(gaps[gaps > 0]) == pytest.approx(0.25e-3, abs=0.02e-3)


def test_single_points_are_triangulated_one_by_one(camera, projector):
    patterns = make_patterns("points", projector.size, {"columns": 5, "rows": 4, "width": 6.0})
    cloud = measured(projected_view(camera, projector, patterns, [WALL])).cloud
    assert 10 <= len(cloud) <= 20
    assert np.abs(cloud.positions[:, 1]).max() < 5e-3


def refused(view, words):
    with pytest.raises(ScanstageError, match=re.escape(words)) as caught:
        measured(view)
    assert "\n" not in str(caught.value)


def with_pictures(view, pictures):
    return dataclasses.replace(view, projected=tuple(pictures))


def test_sweeps_that_cannot_be_are_refused_by_frame(camera, projector):
    laser = laser_view(camera, frames=12)
    shots = list(laser.projected)
    refused(with_pictures(laser, []), "no frame of the capture was taken under a stripe")
    refused(with_pictures(laser, shots[:2]), "the view of frame laser: its sweep has 2 frames (first: 0000); capture at least 3")
    refused(with_pictures(laser, [*shots[:5], shots[6], shots[5], *shots[7:]]), "frame 0005: its laser moves back against the sweep; check the order")
    refused(with_pictures(laser, [dataclasses.replace(shots[0], pattern={"kind": "laser"}), *shots[1:]]), "frame 0000: its laser has no plane")
    stripes = projected_view(camera, projector, make_patterns("stripe-sweep", projector.size, {"spacing": 16.0}), [WALL])
    shots = list(stripes.projected)
    refused(with_pictures(stripes, [*shots, dataclasses.replace(shots[3], name="twin")]), "frame twin: its stripe is where that of frame")
    bad = dataclasses.replace(shots[0], pattern={**shots[0].pattern, "position": "left"})
    refused(with_pictures(stripes, [bad, *shots[1:]]), "its pattern's position must be a number")
    here = [dataclasses.replace(shot, projector=camera) for shot in shots]
    refused(with_pictures(stripes, here), "its projector stands where the camera does")
