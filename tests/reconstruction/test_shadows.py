# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow detection: what is called shadow is shadow."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon.reconstruction.shadows import MOST_LIGHTS, SHADOW_OPTIONS, detect_shadows

DEFAULTS = {option.name: option.default for option in SHADOW_OPTIONS}
HEIGHT, WIDTH = 40, 60


def lit_pictures(albedo, shading, shadows):
    """Return (height, width, 3) pictures: a surface under lights of given shading (k, h, w), 0 where in shadow."""
    light = np.where(shadows, 0.0, shading)
    return [np.repeat((albedo * one)[..., None], 3, axis=2).astype(np.float32) for one in light]


def scene(seed=0, lights=3, darkest=0.01):
    """Return pictures, their shadows as they are, and the albedo: blocks of shadow on a surface of many shades."""
    random = np.random.default_rng(seed)
    albedo = np.kron(random.uniform(darkest, 0.9, (8, 12)), np.ones((5, 5)))
    shading = random.uniform(0.3, 1.0, (lights, 1, 1)) * np.ones((lights, HEIGHT, WIDTH))
    shadows = np.zeros((lights, HEIGHT, WIDTH), bool)
    for light in range(lights):
        top, left = random.integers(2, 15), random.integers(2, 30)
        shadows[light, top:top + 18, left:left + 22] = True
    return lit_pictures(albedo, shading, shadows), shadows, albedo


def detect(pictures, reference=None, **options):
    reference = np.mean(pictures, axis=0) if reference is None else reference
    return detect_shadows(pictures, reference, **{**DEFAULTS, **options})


def test_shadows_are_found_but_for_their_margin():
    pictures, shadows, _ = scene(darkest=0.2)  # all of it bright enough to be decided
    masks = detect(pictures)
    for light, shadow in enumerate(shadows):
        found = masks.of(light)
        assert not (found & ~shadow).any()
        brightest = np.max([picture.mean(axis=2) for picture in pictures], axis=0)
        decided = shadow & (brightest >= DEFAULTS["lit_level"])
        inner = np.lib.stride_tricks.sliding_window_view(decided, (3, 3)).all(axis=(2, 3))  # a pixel in on every side
        assert inner.sum() > 30 and found[1:-1, 1:-1][inner].all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 5), st.floats(0, 0.05), st.floats(0, 0.01))
def test_lit_pixels_are_never_called_shadow(seed, lights, ambient, noise):
    """Whatever the paint, with light from elsewhere, and with noise of which half a level in a hundred may look dark."""
    pictures, shadows, albedo = scene(seed, lights)
    random = np.random.default_rng(seed)
    pictures = [np.clip(p + ambient * albedo[..., None] + noise * random.uniform(0, 1, p.shape), 0, 1).astype(np.float32) for p in pictures]
    masks = detect(pictures, shadow_area=1)
    for light, shadow in enumerate(shadows):
        assert not (masks.of(light) & ~shadow).any()


def test_dark_paint_is_undecided():
    albedo = np.full((HEIGHT, WIDTH), 0.5)
    albedo[10:30, 20:40] = 0.02
    pictures = lit_pictures(albedo, np.ones((2, HEIGHT, WIDTH)), np.zeros((2, HEIGHT, WIDTH), bool))
    masks = detect(pictures)
    assert not masks.bits.any()
    np.testing.assert_array_equal(masks.decidable, albedo > 0.02)


def test_a_pixel_in_the_shadow_of_every_light_is_undecided_unless_the_reference_shows_it():
    shadows = np.zeros((2, HEIGHT, WIDTH), bool)
    shadows[:, 10:30, 20:40] = True
    pictures = lit_pictures(np.full((HEIGHT, WIDTH), 0.5), np.ones(shadows.shape), shadows)
    assert not detect(pictures).bits.any()
    assert detect(pictures, np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)).of(0)[12:28, 22:38].all()


def test_the_surroundings_of_highlights_are_undecided():
    pictures, _, _ = scene()
    pictures[0][20, 30] = 1.0
    masks = detect(pictures)
    assert not masks.decidable[17:24, 27:34].any() and not masks.bits[17:24, 27:34].any()


def test_margin_and_specks():
    shadows = np.zeros((2, HEIGHT, WIDTH), bool)
    shadows[0, 5:15, 5:15] = shadows[0, 30:34, 30:34] = True
    pictures = lit_pictures(np.full((HEIGHT, WIDTH), 0.5), np.ones(shadows.shape), shadows)
    for margin in (0, 1, 3):
        found = detect(pictures, shadow_margin=margin, shadow_area=1).of(0)
        assert found[5:15, 5:15].sum() == (10 - 2 * margin) ** 2 and found[30:34, 30:34].sum() == max(0, 4 - 2 * margin) ** 2
    assert not detect(pictures, shadow_margin=0, shadow_area=17).of(0)[30:34, 30:34].any()
    assert detect(pictures, shadow_margin=0, shadow_area=16).of(0)[30:34, 30:34].all()


def test_a_shadow_that_the_picture_cuts_is_narrowed_there_too():
    shadows = np.zeros((2, HEIGHT, WIDTH), bool)
    shadows[0, :10] = True
    pictures = lit_pictures(np.full((HEIGHT, WIDTH), 0.5), np.ones(shadows.shape), shadows)
    found = detect(pictures, shadow_margin=2).of(0)
    assert found[2:8, 2:-2].all() and found.sum() == 6 * (WIDTH - 4)


@pytest.mark.parametrize("lights, bits", [(1, 8), (8, 8), (9, 16), (17, 32), (MOST_LIGHTS, 32)])
def test_each_light_has_a_bit(lights, bits):
    shadows = np.zeros((lights, HEIGHT, WIDTH), bool)
    shadows[-1, 5:25, 5:25] = True
    pictures = lit_pictures(np.full((HEIGHT, WIDTH), 0.5), np.ones(shadows.shape), shadows)
    masks = detect(pictures, np.full((HEIGHT, WIDTH, 3), 0.5))
    assert masks.bits.dtype.itemsize * 8 == bits
    assert [masks.of(light).any() for light in range(lights)] == [False] * (lights - 1) + [True]


def test_the_picture_of_a_mask_has_three_levels():
    pictures, _, _ = scene()
    masks = detect(pictures)
    picture = masks.picture(1)
    assert set(np.unique(picture)) == {0, 128, 255}
    np.testing.assert_array_equal(picture == 255, masks.of(1))
    np.testing.assert_array_equal(picture == 128, ~masks.decidable)


@pytest.mark.parametrize("count", [0, MOST_LIGHTS + 1])
def test_too_few_or_too_many_lights_are_refused(count):
    picture = np.zeros((4, 4, 3), np.float32)
    with pytest.raises(ValueError, match=f"1 to {MOST_LIGHTS} lights, not {count}"):
        detect_shadows([picture] * count, picture, **DEFAULTS)
