# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The shadow of a stick on a desk: edges in time and in space, planes with a lamp and without, and the points that come of them."""

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction import methods
from addon.reconstruction.active.shadow_edges import arrival_times, leading_edge, pixel_ranges
from addon.reconstruction.scan import Scan
from tests.desk import BALL, DESK, desk, lamp_by_pencils, strips
from tests.rigs import camera_at

SMALL = camera_at((0.0, -0.8, 0.65), (0.0, 0.08, 0.05), focal=150.0, size=(120, 90))
FRAMES = 240
BOX = 1.5 - np.sqrt(2) + 1e-3
"""Pixels: by how much the edge of what square pixels average may be off, found between two of them by a straight line."""


def measured(scene, *sweeps, **options):
    return methods.METHODS["desk-shadow"].measure(Scan((scene.view(*sweeps),)), **{"clearance": -1.0, **options})


def errors(scene, cloud):
    """Return how far points are from what their pixels show."""
    column, row = np.rint(scene.camera.project(cloud.positions)[0]).astype(int).T
    return np.linalg.norm(cloud.positions - scene.points[row, column], axis=1)


def rms(values):
    return float(np.sqrt(np.mean(values ** 2)))


def dome_error(cloud):
    """Return the RMS error on the dome as a share of its size."""
    from_centre = np.linalg.norm(cloud.positions - BALL.centre, axis=1)
    on = (np.abs(from_centre - BALL.radius) < 0.01) & (cloud.positions[:, 2] > 0.02)
    assert np.count_nonzero(on) > 200
    return rms(from_centre[on] - BALL.radius) / (2 * BALL.radius)


def moving_shadow(places, width=12.0, columns=80, rows=4):
    x = np.arange(columns)
    return [np.tile(1 - 0.8 * (np.clip(place + 0.5 - x, 0, 1) - np.clip(place - width + 0.5 - x, 0, 1)), (rows, 1)).astype(np.float32)
            for place in places]


@pytest.mark.parametrize("backwards", [False, True])
def test_both_edges_are_the_leading_one_whichever_way_the_shadow_moves(backwards):
    places = np.arange(-5, 100, 0.5) + 0.2
    images = [image[:, ::-1] if backwards else image for image in moving_shadow(places)]
    ranges = pixel_ranges(iter(images))
    time, drop = arrival_times(iter(images), ranges)
    columns = np.arange(80)[::-1] if backwards else np.arange(80)
    np.testing.assert_allclose(time[0], (columns - places[0]) / 0.5, atol=0.01)
    assert (drop > 0.3).all()
    for frame in (40, 77, 120):
        edge = leading_edge(images[frame] - ranges.middle, time, frame)
        assert len(edge) == 4
        np.testing.assert_allclose(edge[:, 0], 79 - places[frame] if backwards else places[frame], atol=BOX)


def test_pixels_that_are_never_lit_or_dark_from_the_start_have_no_time():
    images = moving_shadow(np.arange(20, 100, 0.5))
    for image in images:
        image[0] = 0.1
    time, _ = arrival_times(iter(images), pixel_ranges(iter(images)))
    assert np.isnan(time[0]).all() and np.isnan(time[1, 12:18]).all() and np.isfinite(time[1, 25:]).all()


def test_a_plane_under_a_point_light_comes_back():
    """methods.md T3a: at most 0.05 % of the distance."""
    scene = desk(ball=False, camera=SMALL)
    cloud = measured(scene, scene.sweep(frames=FRAMES, strips=strips(scene))).cloud
    on_desk = np.abs(cloud.positions[:, 1]) < 0.3
    away = np.linalg.norm(cloud.positions - scene.camera.centre, axis=1)
    assert np.count_nonzero(on_desk) > 3000
    assert rms((cloud.positions[:, 2] / away)[on_desk]) <= 5e-4


def test_a_lamp_with_a_size_that_pencils_found_and_two_planes_without_one():
    """methods.md T3b: at most 0.5 % of the object's size; T3d: the same to 30 % without the lamp."""
    scene = desk(camera=SMALL)
    lamp = lamp_by_pencils(scene.camera, 0.1)
    assert dome_error(measured(scene, scene.sweep(radius=0.01, frames=FRAMES, strips=strips(scene), light=lamp)).cloud) <= 5e-3
    scene = desk()
    exact = errors(scene, measured(scene, scene.sweep(radius=0.01, frames=FRAMES, strips=strips(scene))).cloud)
    planes = errors(scene, measured(scene, scene.sweep(radius=0.01, frames=FRAMES, strips=strips(scene, back=True), light=None)).cloud)
    assert rms(planes) <= 1.3 * rms(exact)


def test_expected_errors_are_those_of_noise_and_two_sweeps_are_better_than_one():
    scene, noise = desk(camera=SMALL), 0.004
    sweeps = [scene.sweep(radius=0.02, frames=FRAMES, strips=strips(scene), noise=noise, direction=angle, number=number)
              for number, angle in enumerate((-0.25, 0.25))]
    one, both = (measured(scene, *chosen, noise=noise).cloud for chosen in (sweeps[:1], sweeps))
    assert 0.5 < np.median(errors(scene, one)) / (0.67 * np.median(one.sigma)) < 2
    first, merged = (dict(zip(map(tuple, np.rint(scene.camera.project(cloud.positions)[0]).astype(int)), errors(scene, cloud), strict=True))
                     for cloud in (one, both))
    common = first.keys() & merged.keys()
    assert len(common) > 6000 and len(merged) > len(first)
    assert rms(np.array([merged[pixel] for pixel in common])) < rms(np.array([first[pixel] for pixel in common]))


def test_pixels_without_contrast_are_counted():
    scene = desk(camera=SMALL)
    counts = measured(scene, scene.sweep(frames=60, strips=strips(scene)), contrast=0.5).counts
    assert counts["unlit"] > 500 and sum(counts.values()) == 120 * 90


@pytest.mark.parametrize(("strip", "message"), [
    ([], "frame 0-000: its pattern has no strips"),
    ([{"rows": [80, 95], "plane": list(DESK)}], r"frame 0-000: its pattern's strip 0 must have rows"),
    ([{"rows": [70, 80], "plane": [0, 0, 0, 1]}], r"frame 0-000: its pattern's strip 0 must have a plane"),
])
def test_a_strip_that_cannot_be_used_is_named(strip, message):
    scene = desk(camera=SMALL)
    with pytest.raises(ScanstageError, match=message):
        measured(scene, scene.sweep(frames=4, strips=strip))


def test_without_a_lamp_one_plane_is_not_enough():
    scene = desk(camera=SMALL)
    with pytest.raises(ScanstageError, match="need a lamp whose position is known, or strips on two planes"):
        measured(scene, scene.sweep(frames=4, strips=strips(scene), light=None))


def test_points_of_the_desk_are_left_out_unless_they_are_asked_for():
    scene = desk(camera=SMALL)
    sweep = scene.sweep(radius=0.01, frames=60, strips=strips(scene))
    every, default = (measured(scene, sweep, clearance=clearance).cloud for clearance in (-1.0, 0.0))
    least = 0.01 * scene.camera.centre[2]
    assert (default.positions[:, 2] >= least).all()
    assert len(default) == np.count_nonzero(every.positions[:, 2] >= least) < len(every)
