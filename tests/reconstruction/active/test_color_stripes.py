# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Coloured stripes are told by their edges, one by one and in order or not, and only where they fit."""

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.rectification import rectified_camera
from addon.reconstruction.active.scanline_matching import match_in_passes, match_scanlines
from addon.reconstruction.active.stripe_code import EDGES, WINDOW, de_bruijn, edge_scores, stripe_colors, stripe_edges
from addon.reconstruction.active.stripe_edges import Channels
from addon.reconstruction.methods import reconstruct
from addon.reconstruction.scan import ProjectedPicture, Scan, View
from tests.projection import sight
from tests.rigs import camera_at
from tests.stripes import BALL, CAMERA, PROJECTOR, ROD, SAMPLES, WALL, colored_picture, plain_matching, trial


@pytest.mark.parametrize(("symbols", "window"), [(5, 3), (2, 4), (3, 2)])
def test_a_de_bruijn_sequence_holds_each_word_once(symbols, window):
    sequence = de_bruijn(symbols, window)
    words = {tuple(np.roll(sequence, -i)[:window]) for i in range(len(sequence))}
    assert len(words) == len(sequence) == symbols ** window


def test_neighbouring_stripes_differ_and_three_edges_in_a_row_are_found_once():
    colors, edges = stripe_colors(), stripe_edges()
    assert len(edges) == EDGES == 125 and (np.diff(colors, axis=0) == edges).all() and np.abs(edges).max(axis=1).min() == 1
    assert len({edges[i:i + WINDOW].tobytes() for i in range(EDGES - WINDOW + 1)}) == EDGES - WINDOW + 1


def test_an_edge_fits_itself_and_a_dead_channel_is_no_veto():
    edges = stripe_edges()
    alive = np.ones(edges.shape, bool)
    scores = edge_scores(edges, edges, alive)
    same = (edges[:, None] == edges).all(-1)
    assert (scores[same] == 1).all() and (scores[~same] < 0).all()
    wrong = edges * np.array([0, 1, 1])
    dead = alive & np.array([False, True, True])
    assert (edge_scores(wrong, edges, dead).diagonal() == 1).all()
    assert (edge_scores(wrong, edges, alive & np.array([False, False, True])) == -1).all()


def test_matching_has_the_best_total_and_forces_nothing():
    scores = np.random.default_rng(2).uniform(-1, 1, (6, 15, 12)).astype(np.float32)
    match, total = match_scanlines(scores)
    for line in range(len(scores)):
        edges = np.flatnonzero(match[line] >= 0)
        codes = match[line, edges]
        assert (np.diff(codes) > 0).all() and (scores[line, edges, codes] > 0).all()
        # Sums of at most 12 numbers in single precision.
        np.testing.assert_allclose((scores[line, edges, codes].sum(), total[line]), plain_matching(scores[line]), rtol=1e-5)
    assert (match_scanlines(-np.abs(scores))[0] == -1).all()
    assert match_scanlines(np.zeros((3, 0, 5), np.float32))[0].shape == (3, 0)


def test_passes_find_what_is_out_of_order():
    code = stripe_edges()
    order = np.concatenate((np.arange(10, 30), np.arange(40, 45), np.arange(30, 38), np.arange(50, 60)))
    scores = edge_scores(code[order], code, np.ones((len(order), 3), bool))[None]
    np.testing.assert_array_equal(match_in_passes(scores)[0], order)
    assert np.count_nonzero(match_in_passes(scores, 1)[0] == order) < len(order)


def test_crosstalk_is_found_whatever_the_surfaces_colour():
    random = np.random.default_rng(3)
    albedo, mixing = random.uniform(0.2, 0.9, (8, 9, 3)), np.array([[1, 0.3, 0.1], [0.2, 1, 0.25], [0.05, 0.3, 1]])
    black = np.full((8, 9, 3), 0.02)
    primaries = black + albedo * mixing.T[:, None, None]
    channels = Channels.measured(primaries, black, 0.05)
    np.testing.assert_allclose(channels.crosstalk, mixing, atol=1e-12)
    light = random.uniform(0, 1, (8, 9, 3))
    np.testing.assert_allclose(channels.corrected(black + albedo * (light @ mixing.T), 0.05), light, atol=1e-5)


@pytest.mark.parametrize("surface", [WALL, BALL])
def test_no_edge_inside_a_silhouette_is_wrong(surface):
    found, code = trial([surface])
    share, wrong, count = found.recall(code)
    assert count > 1000 and wrong == 0 and share >= 0.95  # figures.py judges the last per cent


def test_a_rod_in_front_is_found_by_passes_alone():
    several, one = (trial([ROD, WALL], passes=passes) for passes in (8, 1))
    assert min(several[0].recall(several[1], surface=surface)[0] for surface in (0, 1)) >= 0.9
    assert min(one[0].recall(one[1], surface=surface)[0] for surface in (0, 1)) < 0.9


def test_rows_of_the_rectified_picture_are_epipolar_lines():
    camera, projector = camera_at((0.1, -2.0, 0.3)), camera_at((0.8, -1.7, 0.1))
    rectified = rectified_camera("0001", camera, projector, "column")
    ray = np.array([0.02, 0.01, 1.0]) @ projector.R
    rows = rectified.project(projector.centre + np.linspace(1, 3, 9)[:, None] * ray)[0]
    np.testing.assert_allclose(rows[:, 1], rows[0, 1], atol=1e-8)
    with pytest.raises(ScanstageError, match="number the other axis"):
        rectified_camera("0001", camera, projector, "row")


def test_the_method_places_points_on_the_ball():
    patterns = make_patterns("color-stripes", PROJECTOR.size)
    seen = sight(CAMERA.scaled(SAMPLES), PROJECTOR, [BALL], 1.0)
    image = colored_picture(seen, np.full((*seen.light.shape, 3), 0.8), patterns[0], crosstalk=np.eye(3), seed=0)
    shot = ProjectedPicture("0001", patterns[0].fields, "projector", PROJECTOR, lambda: image)
    scan = Scan((View("0001", CAMERA, None, shot.read_image, projected=(shot,)),))
    points = reconstruct(scan, "color-stripes", voxels=32).points.positions
    # A camera pixel is 1.25 mm on the ball and depth four times as uncertain at this baseline.
    assert len(points) > 1000 and np.median(np.abs(np.linalg.norm(points, axis=1) - BALL.ball.radius)) < 0.005


def test_patterns_that_are_none_are_refused():
    bad = ProjectedPicture("0007", {"kind": "color-stripes", "axis": "diagonal"}, "projector", PROJECTOR, lambda: None)
    with pytest.raises(ScanstageError, match="frame 0007.*axis"):
        reconstruct(Scan((View("0007", CAMERA, None, bad.read_image, projected=(bad,)),)), "color-stripes")
    with pytest.raises(ScanstageError, match="too few"):
        make_patterns("color-stripes", (16, 16))
