# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder of a capture set: what is not there, and what leads out of it."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from addon import files
from addon.captures.schema import capture_to_dict
from addon.captures.store import read_capture, write_capture
from addon.errors import ScanstageError


def test_a_set_is_written_and_read_back(capture_folder, tmp_path_factory):
    capture = read_capture(capture_folder)
    other = tmp_path_factory.mktemp("other") / "new"
    write_capture(other, capture)
    assert capture_to_dict(read_capture(other, require_pictures=False)) == capture_to_dict(capture)
    assert [item.name for item in other.iterdir()] == ["capture.json"]


def test_no_set_is_an_error(tmp_path):
    with pytest.raises(ScanstageError, match="^capture.json: is not in"):
        read_capture(tmp_path)


@pytest.mark.parametrize(("relative", "place"), [
    ("images/0002.png", r"frames\[1\].image: images/0002.png is missing; run capture again to render it"),
    ("given/0002.png", r"frames\[1\].mask: given/0002.png is missing"),
    ("plates/left.png", r"plate.left: plates/left.png is missing"),
    ("truth.ply", r"truth.mesh: truth.ply is missing")])
def test_a_file_that_is_not_there_is_named(capture_folder, relative, place):
    (capture_folder / relative).unlink()
    with pytest.raises(ScanstageError, match=f"^capture.json: {place}"):
        read_capture(capture_folder)
    read_capture(capture_folder, require_pictures=False)


def test_a_frame_that_the_set_calls_missing_need_not_be_there(capture_folder):
    write_capture(capture_folder, read_capture(capture_folder).with_missing(["0002"]))
    (capture_folder / "images/0002.png").unlink()
    assert read_capture(capture_folder).missing == ("0002",)


def link(at: Path, to: Path) -> None:
    try:
        at.symlink_to(to)
    except OSError:
        pytest.skip("this system does not let the test make symbolic links")


@pytest.mark.parametrize("relative", ["images/0002.png", "images", "given/0002.png", "plates", "truth.ply", "capture.json"])
def test_a_link_out_of_the_set_is_refused(capture_folder, tmp_path_factory, relative):
    outside = tmp_path_factory.mktemp("outside") / "moved"
    os.rename(capture_folder / relative, outside)
    link(capture_folder / relative, outside)
    with pytest.raises(ScanstageError, match="^capture.json: .*is a link out of the capture set"):
        read_capture(capture_folder)


def test_a_link_to_itself_is_refused(capture_folder):
    (capture_folder / "truth.ply").unlink()
    link(capture_folder / "truth.ply", capture_folder / "truth.ply")
    with pytest.raises(ScanstageError, match="^capture.json: truth.mesh: truth.ply is"):
        read_capture(capture_folder)


def test_a_link_inside_the_set_is_read(capture_folder):
    os.rename(capture_folder / "images/0002.png", capture_folder / "other.png")
    link(capture_folder / "images/0002.png", capture_folder / "other.png")
    read_capture(capture_folder)


def test_what_would_not_be_read_back_is_not_written(capture_folder):
    before = (capture_folder / "capture.json").read_bytes()
    capture = read_capture(capture_folder)
    broken = dataclasses.replace(capture.frames[0], object_to_world=np.full((4, 4), np.nan))
    for wrong in ({"frames": ()}, {"missing": ("9",)}, {"frames": (broken,)}, {"encoding": "log"}):
        with pytest.raises(ValueError):
            write_capture(capture_folder, dataclasses.replace(capture, **wrong))
    assert (capture_folder / "capture.json").read_bytes() == before


def test_a_write_that_fails_leaves_the_old_file_and_no_other(capture_folder, monkeypatch):
    before = (capture_folder / "capture.json").read_bytes()
    names = sorted(item.name for item in capture_folder.iterdir())

    def full(*_):
        raise OSError(28, "No space left on device")

    capture = read_capture(capture_folder)
    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(ScanstageError, match=r"capture.json: cannot be written \(No space left on device\)"):
        write_capture(capture_folder, capture)
    assert (capture_folder / "capture.json").read_bytes() == before
    assert sorted(item.name for item in capture_folder.iterdir()) == names
