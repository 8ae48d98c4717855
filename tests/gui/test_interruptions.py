# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever ends a job in a real window, what is whole on disk stays, nothing half-made is left, and Blender goes on.

Run with ``SCANSTAGE_BLENDER``, as `scripts/photograph_window.py` says.
"""

from pathlib import Path

import pytest

from addon.captures.store import read_capture


@pytest.fixture(scope="module")
def walked(walk_through):
    """What was found on the way, Blender's log, and the folder of the captures."""
    found, log, out = walk_through(Path(__file__).with_name("interruptions.py"))
    assert found and "error" not in found and "Traceback" not in log, log
    return found, log, out


@pytest.fixture
def views(walked):
    """How many frames a capture has."""
    return walked[0]["views"]


def test_a_second_start_is_refused_with_the_reason(walked):
    assert "Another Scanstage job is running: wait for it, or press Esc" in walked[0]["second start"]


def test_esc_and_the_cross_keep_what_is_captured_and_it_goes_on_from_there(walked, views):
    found = walked[0]
    stopped = found["esc in capture"]
    assert 3 <= stopped["captured"] < found["cross in capture"] < views == found["capture goes on"]
    assert stopped["state"] == f"{stopped['captured']} of {views} frames captured" and stopped["scene as before"]


def test_esc_during_a_reconstruction_leaves_nothing_behind(walked):
    found = walked[0]
    assert found["reconstruct runs"] and found["esc in reconstruction"] == ["capture"] and found["reconstruction after it"]


@pytest.mark.parametrize("way", ["load", "new"])
def test_another_file_ends_the_job_and_the_work_goes_on(walked, views, way):
    found = walked[0]
    assert found[f"{way} in capture"] == {"running": False, "stage": way == "load"}
    assert found[f"{way}: saved at work"] == {"running": False, "can go on": True}
    assert found[f"{way}: went on"] == views
    assert found[f"{way} in reconstruction"] == {"running": False, "left": ["capture"]}


def test_undo_and_a_moved_rig_end_a_capture(walked, views):
    found = walked[0]
    assert not found["undo in capture"]["running"] and 2 <= found["undo in capture"]["captured"] < views
    assert 2 <= found["rig moved in capture"] < views


@pytest.mark.parametrize("folder", ["undo", "moving", "quit"])
def test_the_set_says_what_it_lacks(walked, views, folder):
    capture = walked[2] / folder / "capture"
    there = {path.stem for path in (capture / "images").iterdir()}
    assert 2 <= len(there) < views
    planned = read_capture(capture, require_pictures=False)
    assert {frame.id for frame in planned.frames} - set(planned.missing) == there  # and no part of a picture is among them
