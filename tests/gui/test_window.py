# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""In a real window: from the stage to the comparison by the buttons, with every panel drawn in every state.

Run with ``SCANSTAGE_BLENDER``, as `scripts/photograph_window.py` says.
"""

import itertools

import numpy as np
import pytest

from addon.captures.pictures import read_picture
from scripts.photograph_window import WALK


@pytest.fixture(scope="module")
def walked(walk_through):
    """What was found on the way, Blender's log, and the folder of the pictures."""
    return walk_through(WALK)


def test_no_panel_fails_in_any_state(walked):
    found, log, _ = walked
    assert found and "error" not in found, log
    assert "Traceback" not in log and "rna_uiItem" not in log, log


def test_each_step_leaves_in_the_scene_what_it_should(walked):
    found, log, _ = walked
    assert "Scanstage Camera 1" in found["stage"]["objects"], log
    assert found["test_frame"]["captures"] == "1 of 6 frames captured"
    assert found["capture"]["captures"] == "6 of 6 frames captured"
    assert found["capture refuses a second start"] and found["reconstruct refuses a second start"]
    assert "Result" in found["reconstruct"]["objects"] and "voxels" in found["reconstruct"]["result"]
    assert not found["reconstruct"]["measured"] and found["evaluate"]["measured"]
    left = found["removed"]["objects"]
    assert "Result" in left and {"Cube", "Camera", "Light"} <= set(left) and not [name for name in left if name.startswith("Scanstage")]


def test_the_window_is_photographed_at_each_step(walked):
    pictures = sorted(walked[2].glob("*.png"))
    assert [path.name[0] for path in pictures] == list("01234567")
    shown = [read_picture(path, "srgb")[0] for path in pictures]
    assert all(picture.std() > 0.02 for picture in shown)  # not one of a single colour
    assert all(not np.array_equal(before, after) for before, after in itertools.pairwise(shown))
