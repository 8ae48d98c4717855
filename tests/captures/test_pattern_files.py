# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns on disk: in order, as light, and with what they are."""

import json

import numpy as np
import pytest

from addon.captures.pattern_files import write_patterns
from addon.captures.pictures import read_picture
from addon.errors import ScanstageError
from addon.reconstruction.active.patterns import make_patterns


@pytest.mark.parametrize("encoding", ["srgb", "linear"])
@pytest.mark.parametrize("name", ["gray-code", "phase-shift"])
def test_files_sort_in_the_order_of_the_patterns_and_hold_their_light(tmp_path, name, encoding):
    patterns = make_patterns(name, (40, 24))
    write_patterns(tmp_path / "out", patterns, encoding=encoding)
    files = sorted(tmp_path.glob("out/*.png"))
    listed = json.loads((tmp_path / "out" / "patterns.json").read_text())
    assert listed["size"] == [40, 24] and listed["encoding"] == encoding
    assert [entry["file"] for entry in listed["patterns"]] == [file.name for file in files]
    for pattern, file, entry in zip(patterns, files, listed["patterns"], strict=True):
        assert entry["id"] == pattern.id and entry["fields"] == pattern.fields
        light = pattern.image / (255 if pattern.image.dtype == np.uint8 else 1)
        # A level of sRGB is up to 0.009 of linear light, at its bright end.
        np.testing.assert_allclose(read_picture(file, encoding)[0][..., 0], light, atol=0.0046 if encoding == "srgb" else 0.002)


def test_a_folder_that_holds_something_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(ScanstageError, match="is there already and not an empty folder"):
        write_patterns(tmp_path, make_patterns("gray-code", (8, 8)))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
