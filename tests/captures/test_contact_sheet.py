# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The contact sheet shows every picture, in order, as a screen should."""

import numpy as np
import pytest

from addon.captures.contact_sheet import write_contact_sheet
from addon.captures.pictures import read_picture, write_picture
from addon.captures.schema import Capture, Frame
from addon.errors import ScanstageError
from addon.reconstruction.geometry import Camera

PAPER = 0.72  # linear, what is between the pictures


def capture_of(folder, pictures, *, encoding="linear", alpha=None) -> Capture:
    """Write pictures, each a (height, width, 3) array, and return the capture set that they make."""
    cameras, frames = {}, []
    for number, picture in enumerate(pictures):
        name = f"{number:04d}"
        height, width = picture.shape[:2]
        cameras[name] = Camera(np.diag((9.0, 9.0, 1.0)), np.eye(3), (0, 0, 1), (width, height))
        frames.append(Frame(name, f"images/{name}.png", name))
        write_picture(folder / "images" / f"{name}.png", picture, alpha, encoding=encoding)
    return Capture(cameras, tuple(frames), encoding=encoding)


def plain(level, width=30, height=20):
    return np.full((height, width, 3), level, np.float32)


def read_sheet(path):
    return read_picture(path, "srgb")[0]


def shown(sheet) -> list[float]:
    """Return the levels of the pictures in reading order: rows of the sheet, then what lies in them from left to right."""
    ink = np.abs(sheet[..., 0] - PAPER) > 0.02
    rows = np.flatnonzero(np.diff(np.pad(ink.any(axis=1), 1).astype(int))).reshape(-1, 2)
    levels = []
    for top, bottom in rows:
        columns = np.flatnonzero(np.diff(np.pad(ink[top:bottom].any(axis=0), 1).astype(int))).reshape(-1, 2)
        levels += [float(np.median(sheet[top:bottom, left:right, 0])) for left, right in columns]
    return levels


@pytest.mark.parametrize("count", [1, 2, 7, 24])
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_every_picture_is_there_in_the_order_of_the_frames(tmp_path, count, encoding):
    levels = np.linspace(0.02, 0.6, count)
    capture = capture_of(tmp_path, [plain(level) for level in levels], encoding=encoding)
    write_contact_sheet(tmp_path, capture, tmp_path / "sheet.png")
    # 8 bits of sRGB hold linear light to half a step times the curve's greatest slope: 2.4 / 255 / 2.
    np.testing.assert_allclose(shown(read_sheet(tmp_path / "sheet.png")), levels, atol=0.005)


def test_pictures_keep_their_shape_and_the_sheet_is_wider_than_high(tmp_path):
    capture = capture_of(tmp_path, [plain(0.1, 300, 200)] * 24)
    write_contact_sheet(tmp_path, capture, tmp_path / "sheet.png")
    sheet = read_sheet(tmp_path / "sheet.png")
    ink = np.abs(sheet[..., 0] - PAPER) > 0.02
    height, width = (np.diff(np.flatnonzero(np.diff(np.pad(ink.any(axis=axis), 1).astype(int))).reshape(-1, 2)) for axis in (1, 0))
    assert np.ptp(height) == np.ptp(width) == 0 and width[0] / height[0] == pytest.approx(1.5, abs=0.02)  # whole pixels
    assert 1 < sheet.shape[1] / sheet.shape[0] < 2.5


def test_what_is_transparent_shows_the_paper(tmp_path):
    alpha = np.zeros((20, 30), np.float32)
    alpha[:, 15:] = 1
    capture = capture_of(tmp_path, [plain(0.1)], alpha=alpha)
    write_contact_sheet(tmp_path, capture, tmp_path / "sheet.png")
    row = read_sheet(tmp_path / "sheet.png")[60, :, 0]
    np.testing.assert_allclose(row[10:90], PAPER, atol=0.005)
    np.testing.assert_allclose(row[110:200], 0.1, atol=0.005)


@pytest.mark.parametrize(("count", "most"), [(200, 200), (201, 101), (1000, 200)])
def test_of_many_pictures_every_nth_is_shown(tmp_path, count, most):
    """One picture file serves all frames: it is the sheet that is looked at."""
    capture = capture_of(tmp_path, [plain(0.1, 3, 2)])
    frames = tuple(Frame(f"{number:04d}", "images/0000.png", "0000") for number in range(count))
    write_contact_sheet(tmp_path, Capture(capture.cameras, frames), tmp_path / "sheet.png")
    assert len(shown(read_sheet(tmp_path / "sheet.png"))) == most


@pytest.mark.parametrize(("width", "height"), [(1, 4000), (4000, 1)])
def test_a_picture_of_any_shape_fits_the_sheet(tmp_path, width, height):
    capture = capture_of(tmp_path, [plain(0.1, width, height), plain(0.3)])
    write_contact_sheet(tmp_path, capture, tmp_path / "sheet.png")
    assert max(read_sheet(tmp_path / "sheet.png").shape) < 1000


def test_pictures_of_different_shapes_do_not_overlap(tmp_path):
    levels = (0.05, 0.15, 0.3, 0.45)
    shapes = ((30, 20), (20, 30), (30, 30), (40, 10))
    capture = capture_of(tmp_path, [plain(level, *shape) for level, shape in zip(levels, shapes, strict=True)])
    write_contact_sheet(tmp_path, capture, tmp_path / "sheet.png")
    sheet = read_sheet(tmp_path / "sheet.png")
    areas = [np.count_nonzero(np.abs(sheet[..., 0] - level) < 0.01) for level in levels]
    np.testing.assert_allclose(areas, [200 * 200 * min(shape) / max(shape) for shape in shapes], rtol=0.02)  # whole pixels


@pytest.mark.parametrize("damage", ["gone", "cut"])
def test_a_picture_that_cannot_be_read_is_named_and_no_sheet_is_left(tmp_path, damage):
    capture = capture_of(tmp_path, [plain(0.1), plain(0.2)])
    picture = tmp_path / "images" / "0001.png"
    data = picture.read_bytes()
    picture.unlink()
    if damage == "cut":
        picture.write_bytes(data[:len(data) // 2])
    with pytest.raises(ScanstageError, match="^images/0001.png: "):
        write_contact_sheet(tmp_path, capture, tmp_path / "sheet.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["images"]


def test_a_sheet_that_cannot_be_written_is_named(tmp_path):
    capture = capture_of(tmp_path, [plain(0.1)])
    with pytest.raises(ScanstageError, match="sheet.png: cannot be written"):
        write_contact_sheet(tmp_path, capture, tmp_path / "images" / "0000.png" / "sheet.png")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["0000.png", "images"]
