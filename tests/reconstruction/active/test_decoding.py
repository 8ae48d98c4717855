# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequences that somebody captured: found by their fields in any order, and refused with the frame's name when they cannot be right."""

import dataclasses
import re

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.active.decoding import decode_view
from addon.reconstruction.active.patterns import make_patterns
from tests.projection import projected_view

SIZE = (128, 96)


@pytest.fixture
def gray(camera, projector, scene):
    view = projected_view(camera, projector, make_patterns("gray-code", SIZE, {"axes": "columns"}), scene)
    return {picture.name: picture for picture in view.projected}


@pytest.fixture
def waves(camera, projector, scene):
    def shown(**options):
        view = projected_view(camera, projector, make_patterns("phase-shift", SIZE, options), scene)
        return {picture.name: picture for picture in view.projected}
    return shown


def refused(pictures, words, **options):
    with pytest.raises(ScanstageError, match=re.escape(words)) as caught:
        decode_view(list(pictures.values()), SIZE, where="the view of frame 0001", **options)
    assert "\n" not in str(caught.value)


def swapped(pictures, first, second):
    """Exchange what two frames show, as if they had been captured in the wrong order."""
    shots = {name: picture.read_image for name, picture in pictures.items()}
    shots[first], shots[second] = shots[second], shots[first]
    return {name: dataclasses.replace(picture, read_image=shots[name]) for name, picture in pictures.items()}


def changed(pictures, name, **fields):
    return {**pictures, name: dataclasses.replace(pictures[name], pattern={**pictures[name].pattern, **fields})}


def without(pictures, *names):
    return {name: picture for name, picture in pictures.items() if name not in names}


def test_the_order_of_the_frames_does_not_matter(gray):
    ordered = decode_view(list(gray.values()), SIZE)["column"]
    names = list(gray)
    np.random.default_rng(0).shuffle(names)
    mixed = decode_view([gray[name] for name in names], SIZE)["column"]
    np.testing.assert_array_equal(ordered.position, mixed.position)


def test_inverses_do_without_white_and_black(gray):
    whole, bare = (decode_view(list(shots.values()), SIZE)["column"] for shots in (gray, without(gray, "white", "black")))
    np.testing.assert_array_equal(whole.position[whole.valid], bare.position[whole.valid])
    assert np.count_nonzero(bare.valid) >= 0.99 * np.count_nonzero(whole.valid)


def test_too_few_frames(gray, waves):
    refused(without(gray, "gray-column-02"), "the view of frame 0001: the Gray code of the columns has no frame for bit 4")
    refused({"white": gray["white"]}, "the view of frame 0001: has no frames with Gray code")
    refused(gray, "the view of frame 0001: has no frames with sinusoids", code="phase-shift")
    sinusoid = next(name for name in waves() if name.startswith("phase") and name.endswith("-01"))
    refused(without(waves(), sinusoid), "the sinusoid of 16 pixels has 3 of its 4 frames; capture step 1, too")
    only_fine = {name: picture for name, picture in waves().items() if "gray" not in name}
    refused(only_fine, "tells the periods apart")
    refused(without(gray, "white", *(name for name in gray if name.endswith("inverse"))), "frame gray-column-00: has neither an inverse nor")


def test_wrong_order(gray, waves):
    refused(swapped(gray, "white", "black"), "frame white: is darker under white than frame black under black; check the order of the frames")
    refused(swapped(gray, "gray-column-01", "gray-column-03"), "frame gray-column-01: does not add up to white with its inverse, "
            "frame gray-column-01-inverse; check the order of the frames")
    for steps in (3, 5):
        shots = waves(steps=steps)
        first, second = [name for name in shots if name.startswith("phase")][:2]
        refused(swapped(shots, first, second), "check the order of the frames")


def test_a_code_that_cannot_number_the_projectors_columns(gray):
    pictures = gray
    for name in [name for name in gray if "column" in name]:
        pictures = changed(pictures, name, bits=6) if gray[name].pattern["bit"] < 6 else without(pictures, name)
    refused(pictures, "frame gray-column-01: a Gray code of 6 bits cannot number the projector's 128 columns, which take 7")


def test_saturated_captures(camera, projector, scene):
    for name, frame in (("gray-code", "frame white: "), ("phase-shift", "is saturated")):
        view = projected_view(camera, projector, make_patterns(name, SIZE), scene, albedo=3.0)
        refused({picture.name: picture for picture in view.projected}, frame)
        refused({picture.name: picture for picture in view.projected}, "capture with less exposure or a weaker projector")


def test_a_projector_that_lights_nothing(camera, projector, scene):
    view = projected_view(camera, projector, make_patterns("gray-code", SIZE), scene, albedo=0.001)
    refused({picture.name: picture for picture in view.projected}, "frame white: the projector lights nothing in it")


@pytest.mark.parametrize(("fields", "words"), [
    ({"axis": "diagonal"}, "its pattern's axis must be column or row, not 'diagonal'"),
    ({"bit": 7}, "its pattern's bit must be a whole number from 0 to 6, not '7'"),
    ({"bit": True}, "its pattern's bit must be a whole number"),
    ({"bits": 40}, "its pattern's bits must be a whole number from 1 to 16"),
    ({"bit": 6}, "shows the same pattern as frame gray-column-00"),
])
def test_fields_that_cannot_be(gray, fields, words):
    refused(changed(gray, "gray-column-01", **fields), "frame gray-column-01: " + words)


def test_two_frames_under_white(gray):
    refused({**gray, "twin": dataclasses.replace(gray["white"], name="twin")}, "frame twin: shows the same pattern as frame white")
