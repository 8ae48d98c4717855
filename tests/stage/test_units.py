# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lengths are written as the scene's units say."""

import pytest

from addon.stage.units import length_text, volume_text


@pytest.mark.parametrize(("value", "digits", "text"), [
    (0.0, 3, "0 \u00b5m"), (2.5e-5, 3, "25 \u00b5m"), (0.00123, 3, "1.23 mm"), (2.0, 3, "2 m"), (0.0005, 2, "500 \u00b5m"),
    (0.01234, 2, "12 mm"), (0.25, 2, "250 mm"), (1.5, 2, "1.5 m"), (0.999, 2, "1000 mm"), (25.0, 2, "25 m"), (-0.002, 3, "-2 mm")])
def test_lengths_are_written_in_a_unit_that_suits_them(empty_scene, value, digits, text):
    assert length_text(empty_scene, value, digits=digits) == text


def test_the_scenes_scale_and_system_count(empty_scene):
    units = empty_scene.unit_settings
    units.scale_length = 0.01
    assert length_text(empty_scene, 20.0) == "200 mm"
    assert volume_text(empty_scene, 10.0) == "10 cm\u00b3"
    units.system = 'IMPERIAL'
    assert length_text(empty_scene, 25.4) == '10"'
    units.system = 'NONE'  # then there is no scale either
    assert length_text(empty_scene, 0.125) == "0.125"
