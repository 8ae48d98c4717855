# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Silhouettes: no pixel that the object touches is lost, and each extractor tells the object from its own background."""

import math

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.options import resolve
from addon.reconstruction.silhouettes import (
    EXTRACTORS,
    SILHOUETTE_OPTIONS,
    border_color,
    clean,
    cover_partial_pixels,
    disc,
    extract,
    from_alpha,
    from_chroma,
    from_plate,
    from_threshold,
    parse_color,
)

RADIUS = math.sqrt(0.5)  # of the discs that the proof of cover_partial_pixels is about
SIZE = (48, 40)
ROWS, COLUMNS = np.mgrid[:SIZE[1], :SIZE[0]].astype(float)


def taken(rgb, alpha=None, given=None, plate=None, **options):
    return extract(rgb, alpha, given, plate, **resolve(SILHOUETTE_OPTIONS, options, "a test"))


# --- conservative masks: exact coverage of unions of discs ------------------------------------------------------------

def sampled(discs):
    """Return which pixels' centres lie in the union of discs (x, y, r)."""
    return np.any([(COLUMNS - x) ** 2 + (ROWS - y) ** 2 <= r ** 2 for x, y, r in discs], axis=0)


def touched(discs):
    """Return which pixels' squares the union of discs meets: exactly, by the distance from a disc's centre to a square."""
    return np.any([np.maximum(np.abs(COLUMNS - x) - 0.5, 0) ** 2 + np.maximum(np.abs(ROWS - y) - 0.5, 0) ** 2 <= r ** 2
                   for x, y, r in discs], axis=0)


def scattered(rng):
    """Separate discs, most of them of the least radius."""
    return [(*rng.uniform(2, 37, 2), RADIUS * rng.choice([1, 1, 1, 2, 5])) for _ in range(25)]


def strokes(rng):
    """Thin strokes: discs of the least radius, 0.05 px apart along segments."""
    discs = []
    for _ in range(4):
        start, end = rng.uniform(2, 37, (2, 2))
        steps = np.linspace(0, 1, int(np.linalg.norm(end - start) / 0.05))[:, None]
        discs += [(x, y, RADIUS) for x, y in start + steps * (end - start)]
    return discs


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("shape", [scattered, strokes])
def test_conservative_masks_cover_every_pixel_that_thick_shapes_touch(shape, seed):
    discs = shape(np.random.default_rng(seed))
    mask, truth = sampled(discs), touched(discs)
    assert not (truth & ~cover_partial_pixels(mask)).any()
    assert (truth & ~mask).any()  # the plain samples do not: the growth is what does it


@pytest.mark.parametrize("seed", range(6))
def test_conservative_masks_cover_rounded_polygons_supersampled(seed):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 7))
    corners = 20 + rng.uniform(5, 15) * np.stack((np.cos(angles), np.sin(angles)), axis=1)

    def covered(x, y):  # within RADIUS of the convex polygon
        point = np.stack((x, y), axis=-1)
        inside, nearest = np.ones(x.shape, bool), np.full(x.shape, np.inf)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            along = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(point - a - along[..., None] * (b - a), axis=-1))
            inside &= (b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0]) >= 0
        return inside | (nearest <= RADIUS)

    offsets = np.linspace(-0.5, 0.5, 17)  # corners and edges of the pixel included
    truth = np.any([covered(COLUMNS + dx, ROWS + dy) for dx in offsets for dy in offsets], axis=0)
    mask = covered(COLUMNS, ROWS)
    assert not (truth & ~cover_partial_pixels(mask)).any()
    assert (truth & ~mask).any()


def test_the_least_radius_of_the_proof_is_the_least_there_is():
    thin, enough = [(10.5, 10.5, RADIUS - 1e-6)], [(10.5, 10.5, RADIUS + 1e-6)]
    assert touched(thin).any() and not cover_partial_pixels(sampled(thin)).any()
    assert not (touched(enough) & ~cover_partial_pixels(sampled(enough))).any()


def test_a_conservative_mask_grows_by_no_more_than_one_pixel():
    mask = np.zeros((9, 9), bool)
    mask[4, 4] = True
    assert cover_partial_pixels(mask).sum() == 9


# --- extractors -------------------------------------------------------------------------------------------------------

DISC = (COLUMNS - 24) ** 2 + (ROWS - 20) ** 2 <= 144


def picture(inside, outside):
    colors = (np.broadcast_to(np.float32(color), 3) for color in (inside, outside))
    return np.where(DISC[..., None], *colors)


def test_alpha_keeps_any_coverage_only_where_it_is_conservative():
    alpha = np.array([[0, 1 / 65535, 0.49, 0.5, 1]], np.float32)
    np.testing.assert_array_equal(from_alpha(alpha, conservative=True), [[False, True, True, True, True]])
    np.testing.assert_array_equal(from_alpha(alpha, conservative=False), [[False, False, False, True, True]])


@pytest.mark.parametrize("level", [30, 49, 200])
def test_threshold_is_a_grey_value_as_stored_in_srgb(level):
    grey = np.arange(256) / 255
    linear = np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4).astype(np.float32)
    rgb = np.repeat(linear[None, :, None], 3, axis=2)
    np.testing.assert_array_equal(from_threshold(rgb, threshold=(level + 0.5) / 255)[0], np.arange(256) > level)


def test_the_middlebury_recipe_closes_gaps_and_grows_by_three_pixels():
    rgb = picture(0.5, 0.0)
    rgb[:, 24] = 0.0  # a dark crease
    mask = taken(rgb, silhouette="threshold", threshold=0.19, dilate=10, erode=7, conservative=False)
    distance = np.hypot(COLUMNS - 24, ROWS - 20)
    assert mask[distance <= 14].all() and not mask[distance >= 17].any()  # 12 + 3, to a pixel on each side


@pytest.mark.parametrize("seed", range(3))
def test_chroma_tolerates_shadows_on_the_backdrop(seed):
    rng = np.random.default_rng(seed)
    green = np.array([0.02, 0.4, 0.05])
    shade = np.linspace(0.15, 1.3, SIZE[0])[None, :, None] * np.ones((SIZE[1], 1, 1))  # deep shadow to highlight
    objects = rng.uniform(0.05, 0.9) * np.array([[1, 1, 1], [1, 0.2, 0.1], [0.1, 0.2, 1]])[seed]
    rgb = np.where(DISC[..., None], objects, green * shade).astype(np.float32)
    rgb = np.clip(rgb + rng.normal(0, 0.002, rgb.shape), 0, 1).astype(np.float32)  # sensor noise
    mask = taken(rgb, silhouette="chroma", conservative=False)
    np.testing.assert_array_equal(mask, DISC)
    # The same picture by brightness alone is hopeless: some backdrop is brighter than the object, some darker.
    np.testing.assert_array_equal(from_chroma(rgb, green, angle=math.radians(12), floor=0.01), DISC)


def test_chroma_keeps_what_is_too_dark_to_tell():
    rgb = picture((0.001, 0.004, 0.001), (0.0, 0.5, 0.0))
    np.testing.assert_array_equal(taken(rgb, silhouette="chroma", conservative=False), DISC)


def test_the_backdrop_can_be_named():
    rgb = np.zeros((4, 4, 3), np.float32)
    rgb[...] = parse_color("#00b140")
    rgb[0] = (0.9, 0.1, 0.1)  # an object that covers the border
    mask = taken(rgb, silhouette="chroma", backdrop="#00b140", conservative=False)
    assert mask[0].all() and not mask[1:].any()


def test_the_border_gives_the_backdrop_though_a_quarter_is_in_shadow():
    rgb = np.zeros((20, 20, 3), np.float32)
    rgb[...] = (0.1, 0.2, 0.6)
    rgb[:, :5] *= 0.1
    np.testing.assert_allclose(border_color(rgb), (0.1, 0.2, 0.6), rtol=1e-6)


def test_a_black_border_and_a_bad_colour_are_errors():
    with pytest.raises(ScanstageError, match="border is black; give the option backdrop"):
        taken(np.zeros((4, 4, 3), np.float32), silhouette="chroma")
    for text in ("green", "#12345", "#000000", "", "#-12345"):
        with pytest.raises(ScanstageError, match="option backdrop: "):
            parse_color(text)


def test_a_clean_plate_tolerates_shadows_but_not_objects():
    rng = np.random.default_rng(0)
    plate = rng.uniform(0.2, 0.6, (SIZE[1], SIZE[0], 3)).astype(np.float32)
    shadow = np.where(COLUMNS[..., None] < 30, np.float32(0.5), np.float32(1))
    rgb = np.where(DISC[..., None], plate[..., ::-1] * np.float32([1.5, 0.3, 0.2]), plate * shadow).astype(np.float32)
    np.testing.assert_array_equal(taken(rgb, plate=plate, silhouette="plate", conservative=False), DISC)
    strict = from_plate(rgb, plate, difference=0.02, shadow=1.0)
    assert strict[(COLUMNS < 30) & ~DISC].all()  # without tolerance the shadow is an object


def test_an_object_of_the_backgrounds_hue_is_told_by_brightness():
    plate = np.full((SIZE[1], SIZE[0], 3), 0.3, np.float32)
    for grey in (0.05, 0.6):  # darker than the deepest shadow, brighter than the plate
        np.testing.assert_array_equal(from_plate(picture(grey, 0.3), plate, difference=0.02, shadow=0.4), DISC)


def test_a_plate_of_black_is_a_threshold():
    np.testing.assert_array_equal(from_plate(picture(0.1, 0), np.zeros_like(picture(0, 0)), difference=0.02, shadow=0.4), DISC)


def test_auto_takes_what_rests_on_most_knowledge():
    rgb = picture(0.5, 0.0)
    left, top, nothing = COLUMNS < 10, ROWS < 10, np.zeros(DISC.shape, bool)
    sources = {"given": left, "alpha": top.astype(np.float32), "plate": rgb.copy()}
    for name, expected in (("given", left), ("alpha", top), ("plate", nothing)):
        np.testing.assert_array_equal(taken(rgb, **sources, conservative=False), expected)
        sources[name] = None
    np.testing.assert_array_equal(taken(rgb, **sources, conservative=False), DISC)  # the threshold


@pytest.mark.parametrize("chosen", ["mask", "alpha", "plate"])
def test_what_a_picture_lacks_is_named(chosen):
    with pytest.raises(ScanstageError, match=f"which silhouette={chosen} needs"):
        taken(picture(1, 0), silhouette=chosen)


def test_the_option_table_offers_every_extractor():
    assert set(EXTRACTORS) == {"auto", "mask", "alpha", "chroma", "plate", "threshold"}
    assert SILHOUETTE_OPTIONS[0].choices is EXTRACTORS


# --- cleaning ---------------------------------------------------------------------------------------------------------

def cleaned(mask, **options):
    return clean(mask, **{"remove_specks": 0, "fill_holes": 0, "dilate": 0, "erode": 0, **options})


def test_specks_below_the_size_go_and_others_stay():
    mask = np.zeros((10, 10), bool)
    mask[0, 0] = mask[1, 1] = True  # two pixels that meet at a corner are one part
    mask[5:8, 5:8] = True
    np.testing.assert_array_equal(cleaned(mask, remove_specks=2), mask)
    assert cleaned(mask, remove_specks=3).sum() == 9


def test_holes_below_the_size_are_filled_and_the_background_never():
    mask = np.zeros((12, 12), bool)
    mask[1:11, 1:11] = True
    mask[3, 3] = mask[6:8, 6:8] = False
    assert cleaned(mask, fill_holes=4).sum() == 100 - 4
    assert cleaned(mask, fill_holes=5).sum() == 100
    corner = np.ones((5, 5), bool)
    corner[0, 0] = False  # cut off from the rest of the background, but at the border: not a hole
    np.testing.assert_array_equal(cleaned(corner, fill_holes=3), corner)


def test_an_object_that_leaves_the_picture_is_not_eroded_at_the_border():
    mask = np.zeros((10, 10), bool)
    mask[:, :6] = True
    found = cleaned(mask, erode=2)
    assert found[:, :4].all() and not found[:, 4:].any()


def test_the_structuring_element_is_a_disc():
    assert disc(1).sum() == 9 and disc(0).sum() == 1
    rows, columns = np.nonzero(disc(6))
    assert disc(6).shape == (13, 13) and np.hypot(rows - 6, columns - 6).max() <= 6.5 and disc(6)[0, 6] and not disc(6)[0, 0]
