# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Typed options: what a user types, what a program gives, and what is said about the rest."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from addon.errors import ScanstageError
from addon.options import Option, Unit, resolve

ANGLE = Option("opening", math.radians(30), "", unit=Unit.ANGLE, minimum=0.0, maximum=math.pi)
COUNT = Option("views", 12, "", minimum=1, maximum=360)
LENGTH = Option("radius", 0.5, "", unit=Unit.LENGTH, minimum=0.0)
FLAG = Option("smooth", False, "")
RULE = Option("rule", "center", "", choices={"center": "", "corners": ""})
TEXT = Option("name", "cup", "")
TABLE = (ANGLE, COUNT, LENGTH, FLAG, RULE, TEXT)


@pytest.mark.parametrize(("option", "text", "value"), [
    (ANGLE, "90", math.pi / 2), (COUNT, "36", 36), (LENGTH, "2", 2.0), (LENGTH, " 1e-3 ", 0.001), (FLAG, "true", True),
    (FLAG, " No ", False), (FLAG, "1", True), (FLAG, "off", False), (RULE, "corners", "corners"), (TEXT, "a b", "a b")])
def test_what_a_user_types_becomes_a_value(option, text, value):
    found = option.parse(text)
    assert found == pytest.approx(value) and type(found) is type(option.default)


@pytest.mark.parametrize(("option", "text", "message"), [
    (ANGLE, "190", "option opening: 190 degrees is not from 0 degrees to 180 degrees"),
    (COUNT, "0", "option views: 0 is not from 1 to 360"), (COUNT, "3.5", "option views: '3.5' is not a whole number"),
    (COUNT, "", "option views: '' is not a whole number"), (LENGTH, "-1", "option radius: -1 m is not at least 0 m"),
    (LENGTH, "nan", "option radius: nan m is not at least"), (LENGTH, "inf", "option radius: inf m is not at least"),
    (LENGTH, "wide", "option radius: 'wide' is not a number"), (FLAG, "maybe", "option smooth: 'maybe' is not true or false"),
    (RULE, "edge", "option rule: 'edge' is none of center, corners")])
def test_what_is_no_value_is_named(option, text, message):
    with pytest.raises(ScanstageError, match=message):
        option.parse(text)


@pytest.mark.parametrize(("option", "value"), [
    (COUNT, 3.0), (COUNT, True), (COUNT, "3"), (FLAG, 1), (FLAG, "true"), (LENGTH, True), (LENGTH, None), (RULE, 3),
    (LENGTH, math.nan)])
def test_a_program_must_give_the_right_type(option, value):
    with pytest.raises(ScanstageError, match=f"option {option.name}: "):
        option.check(value)


@pytest.mark.parametrize("option", [COUNT, LENGTH])
def test_a_number_beyond_all_floats_is_refused(option):
    for value in (10 ** 400, "1" + 400 * "0"):
        with pytest.raises(ScanstageError, match=f"option {option.name}: "):
            resolve((option,), {option.name: value}, "a test")


def test_a_whole_number_is_a_number():
    assert LENGTH.check(2) == 2.0 and type(LENGTH.check(2)) is float


def test_values_are_shown_with_their_units():
    assert ANGLE.show(math.pi) == "180 degrees" and LENGTH.show(0.25) == "0.25 m"
    assert FLAG.show(True) == "true" and COUNT.show(5) == "5" and Option("fill_holes", 0, "").label == "Fill Holes"


def test_resolve_fills_in_checks_and_parses():
    values = resolve(TABLE, {"opening": "45", "views": 7, "name": "12"}, "a test")
    assert list(values) == [option.name for option in TABLE]
    assert values["opening"] == pytest.approx(math.pi / 4)  # text is a user's: degrees
    assert values["views"] == 7 and values["name"] == "12" and values["rule"] == "center"
    assert resolve(TABLE, {"opening": 0.5}, "a test")["opening"] == 0.5  # a number is a program's: radians


def test_resolve_names_what_it_does_not_know():
    with pytest.raises(ScanstageError, match="visual-hull has no option 'veiws'; its options are: opening, views, radius"):
        resolve(TABLE, {"veiws": 3}, "visual-hull")
    with pytest.raises(ScanstageError, match="x has no option 'a'; its options are: none"):
        resolve((), {"a": 1}, "x")


@given(st.text(max_size=10))
def test_no_text_crashes_an_option(text):
    for option in TABLE:
        try:
            value = option.parse(text)
        except ScanstageError:
            continue
        assert option.check(value) == value


@given(st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5)))
def test_no_value_crashes_a_check(value):
    for option in TABLE:
        try:
            found = option.check(value)
        except ScanstageError:
            continue
        assert found == (float(value) if type(found) is float else value)
