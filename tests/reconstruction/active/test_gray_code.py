# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Gray code back to columns: exact, as OpenCV's, and right or silent where surfaces light each other."""

import cv2
import numpy as np
import pytest

from addon.reconstruction.active.correspondence import Reason
from addon.reconstruction.active.decoding import decode_view
from addon.reconstruction.active.gray_code import decode_gray, separated
from addon.reconstruction.active.patterns import make_patterns
from tests.interreflection import groove_view
from tests.projection import projected_view, sight
from tests.rigs import camera_at

SIZE = (100, 70)  # of the projector: no power of two
RANDOM = np.random.default_rng(3)
COLUMN, ROW = RANDOM.integers(0, SIZE[0], (40, 60)), RANDOM.integers(0, SIZE[1], (40, 60))


def seen(dtype, albedo=0.7, ambient=0.08, noise=0.0):
    """Return a picture of each pattern on pixels at random places of the projector, by the pattern's id."""
    full = np.iinfo(dtype).max if np.dtype(dtype).kind == "u" else 1.0
    pictures = {}
    for pattern in make_patterns("gray-code", SIZE):
        light = ambient + albedo * pattern.image[ROW, COLUMN] / 255.0 + RANDOM.normal(0, noise, COLUMN.shape)
        pictures[pattern.id] = (np.clip(light, 0, 1) * full).astype(dtype)
    return pictures


def pairs(pictures, axis, inverses=True):
    names = [name for name in pictures if axis in name and not name.endswith("-inverse")]
    return [(pictures[name], pictures[name + "-inverse"] if inverses else None) for name in names]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("inverses", [True, False])
@pytest.mark.parametrize(("axis", "true", "length"), [("column", COLUMN, SIZE[0]), ("row", ROW, SIZE[1])])
def test_every_code_comes_back_whatever_the_type(dtype, inverses, axis, true, length):
    pictures = seen(dtype)
    decoded = decode_gray(pairs(pictures, axis, inverses), pictures["white"], pictures["black"], length=length)
    assert decoded.valid.all()
    np.testing.assert_array_equal(decoded.position, true)


def test_bands_and_one_picture_after_the_other_give_the_same(monkeypatch):
    pictures = seen(np.uint8, albedo=0.2, noise=0.1)
    whole = decode_gray(iter(pairs(pictures, "column")), pictures["white"], pictures["black"], length=SIZE[0])
    monkeypatch.setattr("addon.reconstruction.active.gray_code._BAND", 60 * 7)
    banded = decode_gray(pairs(pictures, "column"), pictures["white"], pictures["black"], length=SIZE[0])
    np.testing.assert_array_equal(whole.position, banded.position)
    np.testing.assert_array_equal(whole.reason, banded.reason)
    assert len(np.unique(whole.reason)) > 1


def test_a_code_without_its_finest_bits_gives_the_middle_of_its_cell():
    pictures = seen(np.uint8)
    decoded = decode_gray(pairs(pictures, "column")[:-2], pictures["white"], pictures["black"], length=SIZE[0], finest=2)
    np.testing.assert_array_equal(decoded.position, COLUMN // 4 * 4 + 1.5)
    assert decoded.sigma == pytest.approx(4 / np.sqrt(12))


def test_accepted_pixels_are_those_of_opencv():
    if not hasattr(cv2, "structured_light"):
        pytest.skip("OpenCV has no structured_light module here: it comes with opencv-contrib")
    pictures = seen(np.uint8, albedo=0.3, noise=0.05)
    oracle = cv2.structured_light.GrayCodePattern.create(*SIZE)
    order = [pictures[pattern.id] for pattern in make_patterns("gray-code", SIZE)[:-2]]
    ours = [decode_gray(pairs(pictures, axis), pictures["white"], pictures["black"], length=length)
            for axis, length in zip(("column", "row"), SIZE, strict=True)]
    both = ours[0].valid & ours[1].valid
    compared = 0
    for y, x in np.argwhere(both):
        refused, place = oracle.getProjPixel(order, int(x), int(y))
        if not refused:
            assert place == (ours[0].position[y, x], ours[1].position[y, x])
            compared += 1
    assert compared > 200


def test_each_pixel_without_a_position_says_why():
    pictures = seen(np.uint8)
    for name, picture in pictures.items():
        picture[0] = 10  # a shadow
        picture[1] = 255 if name != "black" else 0  # the same light under every pattern: all of it indirect
        if "column" in name:
            picture[2] = 200 if ("inverse" not in name) == (name.startswith("gray-column-00")) else 20  # 1000000 is 127
    decoded = decode_gray(pairs(pictures, "column"), pictures["white"], pictures["black"], length=SIZE[0])
    assert (decoded.reason[0] == Reason.UNLIT).all() and (decoded.reason[1] == Reason.UNLIT).all()
    assert (decoded.reason[2] == Reason.OUTSIDE).all() and decoded.valid[3:].all()


def test_direct_and_indirect_light_are_parted():
    direct, indirect, black = (RANDOM.uniform(0.05, low, (20, 20)).astype(np.float32) for low in (0.4, 0.4, 0.1))
    on, off = black + direct + indirect / 2, black + indirect / 2
    found = separated([on, off, off, on], black)
    np.testing.assert_allclose(found[0], direct, atol=1e-6)
    np.testing.assert_allclose(found[1], indirect, atol=1e-6)


def test_a_matte_scene_is_decoded_to_a_column(camera, projector, scene):
    """Issue figure: 99.5 % of the directly lit pixels. Pixels are the mean of 9 rays, so that borders mix."""
    view = projected_view(camera, projector, make_patterns("gray-code", projector.size), scene, samples=3, noise=2 / 255, levels=255, ambient=0.03)
    truth = sight(camera, projector, scene)
    lit = truth.light > 0.05
    for axis, decoded in decode_view(view.projected, projector.size).items():
        right = decoded.valid & (np.abs(decoded.position - truth.pixels[..., ["column", "row"].index(axis)]) <= 1)
        assert np.count_nonzero(right & lit) >= 0.995 * np.count_nonzero(lit), axis


def test_in_a_groove_wrong_codes_are_few_and_few_pixels_are_lost():
    """Issue figures: at most a fifth of simple thresholding's wrong codes, at most 10 % of the pixels lost."""
    camera = camera_at((-0.1, -2.2, 0.1), (0, -0.25, 0), focal=225.0, size=(120, 90))
    projector = camera_at((0.5, -2.1, 0.15), (0, -0.25, 0), focal=500.0, size=(384, 288))
    patterns = make_patterns("gray-code", projector.size, {"axes": "columns"})
    view, truth, share = groove_view(camera, projector, patterns, patches=16)
    lit = share > 0
    wrong, covered = {}, {}
    for robust in (False, True):
        decoded = decode_view(view.projected, projector.size, robust=robust)["column"]
        covered[robust] = np.count_nonzero(decoded.valid & lit)
        wrong[robust] = np.count_nonzero(decoded.valid & lit & (np.abs(decoded.position - truth.pixels[..., 0]) > 1))
    assert wrong[False] > 0.02 * np.count_nonzero(lit)  # or the scene would prove nothing
    assert wrong[True] <= 0.2 * wrong[False]
    assert covered[True] >= 0.9 * covered[False]
