# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Outlines as text: exact there and back, and each thing that can be wrong named with its line."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon.captures.contour_file import contours_text, read_contours
from addon.errors import ScanstageError

number = st.floats(-60_000, 60_000)
loops = st.lists(st.lists(st.tuples(number, number), min_size=3, max_size=6), min_size=1, max_size=4)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(loops)
def test_outlines_come_back_as_they_went(tmp_path, loops):
    (tmp_path / "a.txt").write_bytes(contours_text([np.array(loop) for loop in loops]))
    back = read_contours(tmp_path / "a.txt")
    assert [loop.tolist() for loop in back] == [[list(map(float, point)) for point in loop] for loop in loops]


def test_files_by_other_hands(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\xef\xbb\xbf# mine\r\n\r\n1 2\r\n3.5\t4\r\n 5e0 -6 \r\n\r\n\r\n# a hole\r\n1 1\r\n2 1\r\n2 2")
    assert [loop.tolist() for loop in read_contours(tmp_path / "a.txt")] == [[[1, 2], [3.5, 4], [5, -6]], [[1, 1], [2, 1], [2, 2]]]


@pytest.mark.parametrize(("data", "problem"), [
    (b"", "a.txt: holds no outline"), (b"# nothing\n\n", "a.txt: holds no outline"), (b"\xff\xfe1", "a.txt: is not a text file"),
    (b"1 2\n3 4\n", "a.txt: outline 1 has 2 points"), (b"1 2\n3 4\n5 6\n\n1 1\n", "a.txt: outline 2 has 1 points"),
    (b"1 2\n3\n", "a.txt: line 2: must be the two numbers"), (b"1 2 3\n", "a.txt: line 1: must be the two numbers"),
    (b"1 2\n3 nan\n", "a.txt: line 2: a number is not finite"), (b"1e9 2\n", "a.txt: line 1: a number is not finite or lies far outside")])
def test_what_is_no_outline_is_named(tmp_path, data, problem):
    (tmp_path / "a.txt").write_bytes(data)
    with pytest.raises(ScanstageError, match=f"^{problem}"):
        read_contours(tmp_path / "a.txt")


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(st.binary(max_size=40) | st.text("0123456789.-+eEnaif# \n\t", max_size=60).map(str.encode))
def test_anything_is_outlines_or_one_sentence(tmp_path, data):
    (tmp_path / "a.txt").write_bytes(data)
    try:
        assert all(np.isfinite(loop).all() and len(loop) >= 3 for loop in read_contours(tmp_path / "a.txt"))
    except ScanstageError as error:
        assert str(error).startswith("a.txt: ") and str(error).isprintable()
