# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Small valid files of other formats with something broken in them: an importer takes them or says one sentence."""


import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon.captures.importers import IMPORTERS
from addon.captures.importers.sources import Import
from addon.captures.store import write_capture
from addon.errors import ScanstageError
from addon.options import resolve
from tests.sources import SOURCES, write_source

PIECES = ["", "nan", "-Infinity", "1e999", "-1", "0", "9" * 400, "1e-320", "../", "/", "\\", "\0", "\n", " ", "[", "]", "{", "}", "%", "#", ";",
          "=", ":", "é", "\ud800", "\u2028", "\ufeff", "view_1.png", "view_2.png", "x" * 5000, "<a>" * 200, "[" * 200, "- " * 200, "\"", "null",
          "true", "1e5", "..", "&lol;", "|", "'"]
ENDS = ("view_1.png", "view_2.png", "view_3.png")


@st.composite
def broken(draw, text):
    """Return the bytes of a text after a few pieces of it were replaced, doubled or cut out."""
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.integers(0, 12)))
        piece = draw(st.sampled_from(PIECES) | st.just(text[start:end] * 2) | st.text(max_size=3))
        text = text[:start] + piece + text[end:]
    data = text.encode("utf-8", "surrogatepass")
    return data[:draw(st.integers(0, len(data)))] if draw(st.integers(0, 9)) == 0 else data


def read(folder, case, content=None) -> Import:
    """Read a source as its importer does, without the copy that all importers share."""
    importer = IMPORTERS[case.split()[0]]
    return importer.function(write_source(folder, case, content), **resolve(importer.options, {}, "import"))


def taken_or_refused(tmp_path, case, content):
    try:
        found = read(tmp_path, case, content)
    except ScanstageError as error:
        assert str(error).isprintable() and len(str(error)) < 600
        return
    write_capture(tmp_path / "set", found.capture)  # raises a ValueError if the set could not be read back
    assert all(path.resolve().is_relative_to(tmp_path.resolve()) for path in found.pictures.values())


@pytest.mark.parametrize("case", SOURCES)
def test_the_whole_file_is_read(tmp_path, case):
    frames = read(tmp_path, case).capture.frames
    assert len(frames) == {"slstudio": 3, "desk": 4}.get(case, 2)


@pytest.mark.parametrize("case", SOURCES)
@settings(max_examples=100, deadline=1000, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(st.data())
def test_a_broken_file_is_refused_in_one_sentence(tmp_path, case, data):
    taken_or_refused(tmp_path, case, data.draw(broken(SOURCES[case][1])))
