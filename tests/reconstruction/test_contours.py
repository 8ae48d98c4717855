# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines enclose exactly the mask's pixels, hold the area of what was sampled, and stay apart when they are simplified."""

import itertools

import numpy as np
import pytest

from addon.reconstruction.contours import centres_within, crossing, fill, simplify, trace_outlines


def disc_mask(radius, centre=(40.3, 31.8), size=(80, 64)):
    y, x = np.mgrid[:size[1], :size[0]]
    return np.hypot(x - centre[0], y - centre[1]) < radius


def area(loop):
    x, y = loop.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def enclosed(loops, size):
    """Return where pixel centres lie inside an odd number of loops: a ray along x counts the sides that it crosses."""
    y, x = np.mgrid[:size[1], :size[0]].astype(float)
    odd = np.zeros(x.shape, bool)
    for loop in loops:
        for (ax, ay), (bx, by) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            if ay != by:
                odd ^= ((ay <= y) != (by <= y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
    return odd


@pytest.mark.parametrize("seed", range(3))
def test_any_masks_outlines_enclose_its_pixels_and_no_others(seed):
    mask = np.random.default_rng(seed).random((12, 17)) < (0.3, 0.5, 0.8)[seed]
    loops = trace_outlines(mask)
    np.testing.assert_array_equal(enclosed(loops, (17, 12)), mask)
    assert not crossing(loops).any()


def test_outlines_and_holes_turn_opposite_ways():
    mask = disc_mask(25) & ~disc_mask(10) | disc_mask(4)
    areas = sorted(area(loop) for loop in trace_outlines(mask))
    assert len(areas) == 3 and (areas[0] < 0) == (areas[1] < 0) != (areas[2] < 0)


def test_nothing_has_no_outline_and_everything_ends_where_the_picture_does():
    assert trace_outlines(np.zeros((5, 7), bool)) == []
    loop, = trace_outlines(np.ones((5, 7), bool))
    assert (loop.min(axis=0) == -0.5).all() and (loop.max(axis=0) == (6.5, 4.5)).all()


@pytest.mark.parametrize("tolerance", [0.0, 0.25, 0.5])
def test_the_outline_of_a_sampled_disc_is_unbiased(tolerance):
    """Over many discs the area's mean error is far below what half a pixel's bias would be: 1 / 25 of the radius, 2 / 25 of the area."""
    errors = [abs(area(simplify(trace_outlines(disc_mask(25, centre=(40 + a, 31 + b))), tolerance)[0])) / (np.pi * 25 ** 2) - 1
              for a, b in itertools.product((0.0, 0.2, 0.4, 0.6, 0.8), repeat=2)]
    assert abs(np.mean(errors)) < 0.002


@pytest.mark.parametrize("tolerance", [0.25, 1.0, 3.0])
def test_simplifying_moves_no_point_farther_than_the_tolerance_and_makes_nothing_cross(tolerance):
    loops = trace_outlines(np.random.default_rng(5).random((20, 30)) < 0.6) + [
        loop + 40 for loop in trace_outlines(disc_mask(25) & ~disc_mask(23))]
    simple = simplify(loops, tolerance)
    assert not crossing(simple).any() and sum(map(len, simple)) < sum(map(len, loops))
    for before, after in zip(loops, simple, strict=True):
        a, b = after, np.roll(after, -1, axis=0)
        along = np.clip(((before[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0, 1)
        assert np.linalg.norm(before[:, None] - a - along[..., None] * (b - a), axis=-1).min(axis=1).max() <= tolerance + 1e-5


def test_crossing_finds_what_brute_force_finds():
    def proper(p, q, r, s):
        def turn(a, b, c):
            return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        return turn(p, q, r) * turn(p, q, s) < 0 and turn(r, s, p) * turn(r, s, q) < 0

    rng = np.random.default_rng(2)
    loops = [rng.random((3, 2)) * 0.3 + rng.random(2) * 2 for _ in range(30)]  # triangles: none crosses itself
    loops.append(np.array([(5, 5), (6, 6), (6, 5), (5, 6.0)]))
    sides = [(i, a, b) for i, loop in enumerate(loops) for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True)]
    expected = {i for (i, a, b), (j, c, d) in itertools.permutations(sides, 2) if proper(a, b, c, d)}
    assert set(np.flatnonzero(crossing(loops))) == expected and 30 in expected and 3 < len(expected) < 31


def test_filled_outlines_are_the_mask_within_a_pixel():
    mask = disc_mask(25) & ~disc_mask(10)
    filled = fill(trace_outlines(mask), (80, 64))
    assert filled[mask].all() and not filled[disc_mask(8)].any() and not filled[~disc_mask(27)].any()


@pytest.mark.parametrize("seed", range(3))
def test_the_centres_within_traced_outlines_are_the_mask(seed):
    mask = np.random.default_rng(seed).random((23, 31)) < 0.55
    np.testing.assert_array_equal(centres_within(trace_outlines(mask), (31, 23)), mask)


def test_centres_within_an_ellipse_and_its_hole_that_leave_the_picture():
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    loops = [np.column_stack((10.3 + radius * np.cos(angle), 4.2 + 0.7 * radius * np.sin(angle))) for radius in (14.05, 6.1)]
    y, x = np.mgrid[:17, :20]
    distance = np.hypot(x - 10.3, (y - 4.2) / 0.7)
    np.testing.assert_array_equal(centres_within(loops, (20, 17)), (distance < 14.05) & (distance > 6.1))
