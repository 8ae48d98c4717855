# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures under patterns: what `capture.json` says of them, and pictures that do not depend on what the renderer keeps."""

import numpy as np
import pytest

from addon.captures.pictures import read_picture
from addon.captures.store import read_capture
from addon.errors import ScanstageError
from addon.render.capture import capture_frames
from addon.stage import ownership, projector, readback, staging

SMALL = {"resolution_x": 48, "resolution_y": 36, "views": 2}
RIGS = {"gray-code": {**SMALL, "projector_x": 32, "projector_y": 24}, "laser-scanner": {**SMALL, "lines": 5},
        "depth-sensor": {**SMALL, "projector_x": 32, "projector_y": 24},
        "desk-shadow": {"resolution_x": 48, "resolution_y": 36, "steps": 8, "lamp_size": 0.0}}


@pytest.mark.parametrize("name", RIGS)
def test_the_set_says_what_was_shown_by_which_device(empty_scene, tmp_path, name):
    staging.build(empty_scene, name, "knot", RIGS[name])
    plan = readback.plan_of(empty_scene)
    list(capture_frames(empty_scene, tmp_path))
    found = read_capture(tmp_path)
    assert [frame.pattern for frame in found.frames] == [frame.pattern for frame in plan.frames]
    assert found.patterns == {id: dict(fields) for id, fields in plan.patterns.items()}
    assert set(found.projectors) == set(plan.projectors)
    for id, device in plan.projectors.items():
        np.testing.assert_array_equal(found.projectors[id].P, device.P)


@pytest.mark.parametrize("name", RIGS)
def test_pictures_are_the_same_whether_or_not_the_renderer_keeps_the_geometry(empty_scene, tmp_path, name):
    staging.build(empty_scene, name, "knot", RIGS[name])
    assert empty_scene.render.use_persistent_data
    list(capture_frames(empty_scene, tmp_path / "kept"))
    empty_scene.render.use_persistent_data = False
    list(capture_frames(empty_scene, tmp_path / "anew"))
    for picture in sorted((tmp_path / "kept" / "images").iterdir()):
        kept, anew = (read_picture(tmp_path / folder / "images" / picture.name, "linear") for folder in ("kept", "anew"))
        np.testing.assert_array_equal(kept[0], anew[0])
        np.testing.assert_array_equal(kept[1], anew[1])


def test_a_pattern_and_its_inverse_are_white_together_and_the_alpha_is_the_objects(empty_scene, tmp_path):
    staging.build(empty_scene, "gray-code", "knot", {**RIGS["gray-code"], "views": 1})
    list(capture_frames(empty_scene, tmp_path))
    pictures = {frame.pattern: read_picture(tmp_path / frame.image, "linear") for frame in read_capture(tmp_path).frames}
    alpha = pictures[None][1]
    assert 0.1 < alpha.mean() < 0.6 and not pictures["black"][0].any()
    for id, (rgb, mask) in pictures.items():
        np.testing.assert_array_equal(mask, alpha)
        if id and id.endswith("-inverse"):
            # The borders of bright and dark move by rounding alone: a hundredth of a pixel.
            both = rgb + pictures[id.removesuffix("-inverse")][0]
            assert (np.abs(both - pictures["white"][0]) > 1e-4).any(axis=-1).mean() < 0.002


def test_each_channel_of_coloured_stripes_is_dark_or_what_it_is_under_its_own_primary(empty_scene, tmp_path):
    staging.build(empty_scene, "color-stripes", "knot", {**SMALL, "views": 1, "projector_x": 64, "projector_y": 48, "primaries": True})
    list(capture_frames(empty_scene, tmp_path))
    pictures = {frame.pattern: read_picture(tmp_path / frame.image, "linear")[0] for frame in read_capture(tmp_path).frames}
    assert not pictures["black"].any()
    for channel, name in enumerate(("red", "green", "blue")):
        own, stripes = (pictures[id][..., channel] for id in (f"primary-{name}", "color-stripes-column-00"))
        assert not np.delete(pictures[f"primary-{name}"], channel, axis=-1).any()
        lit = own > 0.01
        on = np.abs(stripes - own) < 1e-3
        assert 0.1 < on[lit].mean() < 0.9 and (on | (stripes < 1e-3))[lit].all()


def change_pattern(scene, made):
    value = made.data.node_tree.animation_data.action.layers[0].strips[0].channelbags[0].fcurves[0].keyframe_points[1]
    value.co[1] += 1


def change_lens(scene, made):
    projector.lens_of(made.data).inputs["K1"].default_value = 0.1


def change_place(scene, made):
    made.location.x += 0.01


@pytest.mark.parametrize("change", [change_pattern, change_lens, change_place])
def test_another_plan_is_refused(empty_scene, tmp_path, change):
    stage = staging.build(empty_scene, "gray-code", "knot", {**RIGS["gray-code"], "views": 1, "axes": "columns", "inverses": False})
    list(capture_frames(empty_scene, tmp_path))
    change(empty_scene, ownership.with_role(stage, "projector")[0])
    with pytest.raises(ScanstageError, match="another plan"):
        list(capture_frames(empty_scene, tmp_path))
