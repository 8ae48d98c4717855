# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of a part is progress of the whole, and whoever is told may stop the work."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from addon.errors import Cancelled
from addon.progress import part_of, silent

SHARES = st.floats(0, 1)


def fractions_of(start: float, stop: float, *reported: float) -> list[float]:
    seen = []
    part = part_of(lambda fraction, message: seen.append(fraction), start, stop)
    for fraction in reported:
        part(fraction, "")
    return seen


def test_a_part_lies_between_its_start_and_stop():
    assert fractions_of(0.2, 0.6, 0.0, 0.25, 0.5, 1.0) == pytest.approx([0.2, 0.3, 0.4, 0.6])


def test_parts_of_parts_lie_in_them():
    seen = []
    part_of(part_of(lambda fraction, message: seen.append((fraction, message)), 0.5, 1.0), 0.5, 1.0)(0.5, "Carving")
    assert seen == [(0.875, "Carving")]


@given(SHARES, SHARES, st.floats(allow_nan=False))
def test_no_report_leaves_the_part(one, other, reported):
    start, stop = sorted((one, other))
    (seen,) = fractions_of(start, stop, reported)
    assert start - 1e-15 <= seen <= stop + 1e-15  # the sum is rounded once


def test_cancelling_passes_through():
    def stop(fraction, message):
        raise Cancelled

    with pytest.raises(Cancelled):
        part_of(part_of(stop, 0.1, 0.9), 0.0, 0.5)(0.3, "")


def test_silence_is_the_default():
    assert silent(0.5, "Carving") is None
