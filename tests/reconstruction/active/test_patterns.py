# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns are what their fields say, and those of OpenCV where OpenCV has them."""

import json

import cv2
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.active.patterns import PATTERN_SETS, make_patterns

SIZES = [(64, 32), (100, 37), (2, 2), (33, 17)]


@pytest.mark.parametrize("name", PATTERN_SETS)
def test_every_set_has_unique_ids_json_fields_and_images_of_the_projectors_size(name):
    patterns = make_patterns(name, (96, 64))
    assert len({pattern.id for pattern in patterns}) == len(patterns) > 0
    for pattern in patterns:
        assert json.loads(json.dumps(pattern.fields)) == pattern.fields
        assert pattern.image.shape[:2] == (64, 96) and pattern.image.shape[2:] in ((), (3,))
        assert pattern.image.dtype in (np.uint8, np.float32)
        assert pattern.image.min() >= 0 and pattern.image.max() <= (255 if pattern.image.dtype == np.uint8 else 1)


@pytest.mark.parametrize("size", SIZES)
def test_gray_patterns_are_those_of_opencv(size):
    if not hasattr(cv2, "structured_light"):
        pytest.skip("OpenCV has no structured_light module here: it comes with opencv-contrib")
    oracle = cv2.structured_light.GrayCodePattern.create(*size)
    images = oracle.generate()[1]
    black, white = oracle.getImagesForShadowMasks(np.empty(0), np.empty(0))
    ours = make_patterns("gray-code", size)
    assert len(ours) == len(images) + 2
    for pattern, image in zip(ours, (*images, white, black), strict=True):
        assert (pattern.image == image).all(), pattern.id


@pytest.mark.parametrize("size", SIZES)
def test_gray_bits_say_the_column_and_neighbours_differ_in_one(size):
    patterns = [p for p in make_patterns("gray-code", size, {"axes": "columns", "inverses": False}) if p.fields["kind"] == "gray-code"]
    bits = np.array([pattern.image[0] > 0 for pattern in patterns])
    assert [pattern.fields["bit"] for pattern in patterns] == list(range(len(patterns)))[::-1]
    assert (np.count_nonzero(bits[:, 1:] != bits[:, :-1], axis=0) == 1).all()
    binary = np.logical_xor.accumulate(bits, axis=0)
    assert (2 ** np.arange(len(patterns))[::-1] @ binary == np.arange(size[0])).all()


def test_inverses_are_complements_and_rows_are_the_columns_turned():
    patterns = {pattern.id: pattern for pattern in make_patterns("gray-code", (32, 32))}
    for name in (name for name in patterns if name.endswith("-inverse")):
        assert (patterns[name].image == 255 - patterns[name.removesuffix("-inverse")].image).all()
    for name in (name for name in patterns if "row" in name):
        assert (patterns[name].image == patterns[name.replace("row", "column")].image.T).all()


@pytest.mark.parametrize("steps", [3, 4, 8])
def test_the_steps_of_a_sinusoid_sum_to_a_constant_and_repeat_after_a_period(steps):
    images = [p.image for p in make_patterns("phase-shift", (96, 8), {"steps": steps, "period": 12}) if p.fields["kind"] == "phase-shift"]
    assert len(images) == steps
    assert np.allclose(np.sum(images, axis=0), steps / 2, atol=1e-5)
    assert np.allclose(images[0][:, 12:], images[0][:, :-12], atol=1e-5)
    assert images[0][0, 0] == 1  # its crest is on the first column


def test_frequencies_begin_with_a_period_beyond_the_projector_and_end_with_the_finest():
    periods = sorted({p.fields["period"] for p in make_patterns("phase-shift", (1000, 8), {"unwrap": "frequencies", "period": 10})
                      if "period" in p.fields})
    assert periods[0] == pytest.approx(10) and 1000 < periods[-1] < 1200
    assert (np.array(periods[1:]) / periods[:-1] <= 6 + 1e-9).all()


def test_gray_code_that_unwraps_a_phase_has_cells_of_at_most_half_a_period():
    patterns = make_patterns("phase-shift", (512, 8), {"period": 20})
    finest = min(p.fields["bit"] for p in patterns if p.fields["kind"] == "gray-code")
    assert 2 ** finest <= 10 < 2 ** (finest + 1)


def test_stripes_and_points_lie_where_their_fields_say():
    columns, rows = np.arange(64), np.arange(32)
    for pattern in make_patterns("stripe-sweep", (64, 32), {"spacing": 2.5})[2:-2]:
        profile = pattern.image[5].astype(float)
        assert (profile @ columns) / profile.sum() == pytest.approx(pattern.fields["position"], abs=0.01)
    for pattern in make_patterns("points", (64, 32), {"columns": 4, "rows": 2}):
        image = pattern.image.astype(float)
        assert (image.sum(0) @ columns) / image.sum() == pytest.approx(pattern.fields["column"], abs=0.01)
        assert (image.sum(1) @ rows) / image.sum() == pytest.approx(pattern.fields["row"], abs=0.01)


def test_every_pixel_is_lit_and_dark_under_the_shifted_checkers_and_half_of_each_is_lit():
    images = np.array([pattern.image for pattern in make_patterns("checker", (64, 48))])
    assert len(images) == 25
    assert (images.max(0) == 255).all() and (images.min(0) == 0).all()
    assert np.abs((images > 0).mean(axis=(1, 2)) - 0.5).max() < 0.05


def test_many_stripes_take_no_memory_of_their_own():
    patterns = make_patterns("stripe-sweep", (1280, 720))
    assert len(patterns) == 1280
    assert all(pattern.image.strides[0] == 0 for pattern in patterns)


@pytest.mark.parametrize(("name", "size", "options", "words"), [
    ("grey", (8, 8), {}, "there is no pattern set 'grey'"),
    ("gray-code", (0, 8), {}, "0x8 pixels cannot show"),
    ("gray-code", (1, 8), {}, "single column"),
    ("gray-code", (70000, 8), {}, "from 1 to 65536"),
    ("phase-shift", (8, 8), {"period": 16}, "longer than the projector's 8 columns"),
    ("phase-shift", (64, 8), {"steps": 2}, "steps"),
])
def test_what_a_projector_cannot_show_is_said_in_a_sentence(name, size, options, words):
    with pytest.raises(ScanstageError, match=words):
        make_patterns(name, size, options)
