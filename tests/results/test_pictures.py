# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of a result become images, and are read again when the result changes."""

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.results.folder import write_result
from addon.results.pictures import picture_files, show_pictures
from tests.results.test_carved import GRID


def write(folder, pictures):
    volume = SparseVolume.from_dense(GRID, np.ones(GRID.shape, bool))
    write_result(folder, volume=volume, surface=extract_surface(volume), colors=None, report={"method": "shadow-carving"},
                 preview=np.zeros((4, 4, 3), np.uint8), pictures=pictures)


def picture(level):
    return np.full((6, 8, 3), level, np.uint8)


def red_of(image):
    return round(255 * image.pixels[0])


def test_pictures_are_loaded_by_name_and_read_again(empty_scene, tmp_path):
    write(tmp_path / "result", {"light-1": picture(51), "light-2": picture(102)})
    images = show_pictures(tmp_path / "result")
    assert [image.name for image in images] == ["light-1", "light-2"] and [red_of(image) for image in images] == [51, 102]
    assert tuple(images[0].size) == (8, 6)
    images[1].name = "mine"
    write(tmp_path / "result", {"light-1": picture(153), "light-2": picture(204)})
    again = show_pictures(tmp_path / "result")
    assert again == images and [red_of(image) for image in again] == [153, 204] and again[1].name == "mine"
    assert len(bpy.data.images) == 2


def test_a_result_without_or_a_damaged_picture_says_so(empty_scene, tmp_path):
    write(tmp_path / "result", {})
    assert picture_files(tmp_path / "result") == []
    with pytest.raises(ScanstageError, match="there are no pictures"):
        show_pictures(tmp_path / "result")
    write(tmp_path / "result", {"light-1": picture(51)})
    (tmp_path / "result" / "pictures" / "light-1.png").write_bytes(b"no picture")
    with pytest.raises(ScanstageError, match="light-1.png: cannot be read"):
        show_pictures(tmp_path / "result")
    assert len(bpy.data.images) == 0
