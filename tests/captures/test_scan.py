# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture set as views in the object frame."""

import dataclasses

import numpy as np
import pytest

from addon.captures.pictures import read_mask, write_mask, write_picture
from addon.captures.scan import lighting_groups, load_scan
from addon.captures.schema import Frame
from addon.captures.store import read_capture, write_capture
from addon.errors import Cancelled, ScanstageError
from addon.reconstruction.geometry import Light

SIZE = (8, 6)
SQUARE = np.zeros((6, 8), bool)
SQUARE[2:4, 3:6] = True
GROWN = np.zeros((6, 8), bool)
GROWN[1:5, 2:7] = True  # by one pixel on every side


def without_patterns(folder, **changes):
    capture = read_capture(folder)
    frames = tuple(dataclasses.replace(frame, pattern=None) for frame in capture.frames)
    write_capture(folder, dataclasses.replace(capture, frames=frames, **changes))


def test_frames_without_a_pattern_become_views(capture_folder):
    scan = load_scan(capture_folder)
    assert [view.name for view in scan.views] == ["0001"]
    np.testing.assert_array_equal(scan.views[0].mask, GROWN)
    np.testing.assert_array_equal(scan.bounds, [[-1, -1, 0], [1, 1, 2]])
    image = scan.views[0].read_image()
    assert image.dtype == np.float32 and image.shape == (6, 8, 3)
    np.testing.assert_allclose(image[2, 3], 0.8, atol=0.005)  # half a step of 8-bit sRGB up there


def test_cameras_are_those_of_the_turned_object(capture_folder):
    without_patterns(capture_folder)
    capture = read_capture(capture_folder)
    for view, frame in zip(load_scan(capture_folder).views, capture.frames, strict=True):
        np.testing.assert_array_equal(view.camera.P, capture.camera_of(frame).P)


def test_the_users_options_override_the_sets(capture_folder):
    np.testing.assert_array_equal(load_scan(capture_folder, {"conservative": False}).views[0].mask, SQUARE)
    with pytest.raises(ScanstageError, match="^images/0001.png: the silhouette of frame 0001 is empty"):
        load_scan(capture_folder, {"threshold": 0.99})
    with pytest.raises(ScanstageError, match="no option 'treshold'"):
        load_scan(capture_folder, {"treshold": 0.5})


def test_masks_are_written_beside_the_captures(capture_folder):
    load_scan(capture_folder)
    np.testing.assert_array_equal(read_mask(capture_folder / "masks/0001.png", size=SIZE), GROWN)


@pytest.mark.parametrize(("chosen", "files"), [("auto", "mask"), ("alpha", "alpha"), ("plate", "plate")])
def test_each_source_of_a_silhouette_is_used(capture_folder, chosen, files):
    without_patterns(capture_folder, silhouette={})
    grey = np.full((6, 8, 3), 0.05, np.float32)
    write_picture(capture_folder / "images/0001.png", np.where(SQUARE[..., None], 0.5, grey), SQUARE * 1.0, encoding="srgb")
    write_picture(capture_folder / "images/0002.png", np.where(SQUARE[..., None], 0.5, grey), SQUARE * 1.0, encoding="srgb")
    write_picture(capture_folder / "plates/left.png", grey, encoding="srgb")
    corner = np.zeros((6, 8), bool)
    corner[0, 0] = True
    write_mask(capture_folder / "given/0002.png", corner)
    first, second = load_scan(capture_folder, {"silhouette": chosen, "conservative": False}).views
    np.testing.assert_array_equal(first.mask, SQUARE)
    np.testing.assert_array_equal(second.mask, corner if files == "mask" else SQUARE)


def test_a_mask_that_came_with_the_set_is_not_overwritten(capture_folder):
    given = np.eye(6, 8, dtype=bool)
    write_mask(capture_folder / "masks/0001.png", given)
    frames = tuple(dataclasses.replace(frame, mask="masks/0001.png") for frame in read_capture(capture_folder).frames)
    write_capture(capture_folder, dataclasses.replace(read_capture(capture_folder), frames=frames))
    load_scan(capture_folder, {"silhouette": "threshold"})
    np.testing.assert_array_equal(read_mask(capture_folder / "masks/0001.png", size=SIZE), given)


def test_masks_are_not_written_through_a_link_out_of_the_set(capture_folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    try:
        (capture_folder / "masks").symlink_to(outside)
    except OSError:
        pytest.skip("this system does not let the test make symbolic links")
    with pytest.raises(ScanstageError, match="^masks/0001.png: .* is a link out of the capture set"):
        load_scan(capture_folder)
    assert not list(outside.iterdir())


def test_a_set_with_frames_to_render_is_refused(capture_folder):
    write_capture(capture_folder, read_capture(capture_folder).with_missing(["0002"]))
    with pytest.raises(ScanstageError, match=r"^capture.json: missing: 1 of 2 frames .*\(first: 0002\); run capture again"):
        load_scan(capture_folder)


def test_a_set_with_a_pattern_in_every_frame_is_refused(capture_folder):
    capture = read_capture(capture_folder)
    frames = tuple(dataclasses.replace(frame, pattern="stripes") for frame in capture.frames)
    write_capture(capture_folder, dataclasses.replace(capture, frames=frames))
    with pytest.raises(ScanstageError, match="^capture.json: frames: a pattern is projected in every frame"):
        load_scan(capture_folder)


def test_a_picture_of_another_size_is_named(capture_folder):
    write_picture(capture_folder / "images/0001.png", np.zeros((3, 3, 3)))
    with pytest.raises(ScanstageError, match="^images/0001.png: is 3x3 pixels, its camera 8x6"):
        load_scan(capture_folder)


def test_progress_reaches_the_end_and_stops_the_work(capture_folder):
    seen = []
    load_scan(capture_folder, progress=lambda fraction, message: seen.append(fraction))
    assert seen == sorted(seen) and seen[-1] == 1

    def stop(fraction, message):
        raise Cancelled

    with pytest.raises(Cancelled):
        load_scan(capture_folder, progress=stop)


# --- frames under different lights -------------------------------------------------------------------------------------------

TURNED = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0], [0, 0, 0, 1]])


def frame(id, lights=(), motion=None, camera="left"):
    return Frame(id, "images/0001.png", camera, np.eye(4) if motion is None else motion, lights)


@pytest.mark.parametrize("frames, expected", [
    ([frame("a"), frame("b")], ["a", "b"]),  # nothing says that they differ by their light
    ([frame("a", ("1",)), frame("b", ("1", "2")), frame("c", ("2",))], ["bac"]),
    ([frame("a", ("1",)), frame("b", ("1",), TURNED)], ["a", "b"]),
    ([frame("a", ("1",)), frame("b", ("2",), camera="right")], ["a", "b"]),
    ([frame("a", ("1", "2")), frame("b", ("2", "1"))], ["a", "b"]),  # the same lights: two views, of which one may be wrong
    ([frame("a", ("1",), TURNED), frame("b", ("1",)), frame("c", ("2",), TURNED), frame("d", ("2",))], ["ac", "bd"]),
])
def test_frames_of_a_view_are_those_that_differ_by_their_lights_only(frames, expected):
    assert ["".join(member.id for member in group) for group in lighting_groups(frames)] == expected


def test_single_lights_belong_to_a_view_and_stand_in_the_object_frame(capture_folder):
    lights = {name: Light("point", np.array([1.0, n, 3.0]), radius=0.1) for n, name in enumerate("xy")}
    frames = (frame("both", ("x", "y"), TURNED), frame("one", ("x",), TURNED), frame("two", ("y",), TURNED))
    write_capture(capture_folder, dataclasses.replace(read_capture(capture_folder), lights=lights, frames=frames))
    view, = load_scan(capture_folder).views
    assert view.name == "both" and [(lit.name, lit.light_id, lit.light.radius) for lit in view.lit] == [("one", "x", 0.1), ("two", "y", 0.1)]
    for n, lit in enumerate(view.lit):
        # The table turned the object; where the light stands for the object, turned back into the world, is where it stands.
        np.testing.assert_allclose(TURNED[:3, :3] @ lit.light.position + TURNED[:3, 3], [1.0, n, 3.0], atol=1e-12)
        assert lit.read_image().shape == (6, 8, 3)


def test_lights_turn_with_their_direction():
    sun = Light("sun", None, np.array([0.0, 0.6, -0.8])).moved(TURNED)
    np.testing.assert_allclose(TURNED[:3, :3] @ sun.direction, [0.0, 0.6, -0.8], atol=1e-12)
    assert sun.position is None


def rewrite(folder, **changes):
    capture = read_capture(folder)
    write_capture(folder, dataclasses.replace(capture, **changes))
    return read_capture(folder)


def test_frames_under_patterns_belong_to_the_view_of_their_camera_and_pose(capture_folder):
    capture = read_capture(capture_folder)
    plain, patterned = capture.frames
    capture = rewrite(capture_folder, frames=(plain, dataclasses.replace(patterned, object_to_world=plain.object_to_world)))
    view, = load_scan(capture_folder).views
    assert view.mask is not None
    picture, = view.projected
    assert picture.name == "0002" and picture.pattern == {"kind": "gray-code", "bit": 3} and picture.projector_id == "beam"
    np.testing.assert_array_equal(picture.projector.P, capture.projectors["beam"].P)
    np.testing.assert_allclose(picture.read_image()[2, 3], 0.8, atol=0.005)


def test_without_silhouettes_a_pose_that_has_only_patterns_is_a_view_too(capture_folder):
    plain, patterned = load_scan(capture_folder, silhouettes=False).views
    assert plain.projected == () and plain.mask is None and patterned.mask is None
    capture = read_capture(capture_folder)
    np.testing.assert_array_equal(patterned.camera.P, capture.camera_of(capture.frames[1]).P)
    turned = capture.projectors["beam"].moved(capture.frames[1].object_to_world)
    np.testing.assert_array_equal(patterned.projected[0].projector.P, turned.P)
    assert not (capture_folder / "masks").exists()


def test_a_lasers_plane_turns_with_the_object(capture_folder):
    capture = rewrite(capture_folder, projectors={}, patterns={"stripes": {"kind": "laser", "plane": [0.6, 0.0, 0.8, 0.25]}})
    picture, = load_scan(capture_folder, silhouettes=False).views[1].projected
    assert picture.projector is None
    *normal, offset = picture.pattern["plane"]
    points = np.random.default_rng(1).normal(size=(20, 3))
    motion = np.asarray(capture.frames[1].object_to_world)
    world = points @ motion[:3, :3].T + motion[:3, 3]
    np.testing.assert_allclose(points @ normal - offset, world @ [0.6, 0, 0.8] - 0.25, atol=1e-12)


@pytest.mark.parametrize(("changes", "words"), [
    ({"patterns": {"stripes": {"kind": "laser", "plane": [0.6, 0.0, 0.8]}}}, r"patterns.stripes.plane: must have 4 entries"),
    ({"patterns": {"stripes": {"kind": "laser", "plane": [2.0, 0.0, 0.0, 1.0]}}}, "patterns.stripes.plane: must begin with a unit normal"),
    ({"patterns": {"stripes": {"kind": "white", "projector": "lamp"}}}, "patterns.stripes.projector: 'lamp' is not a projector"),
])
def test_a_pattern_that_names_no_light_is_refused(capture_folder, changes, words):
    rewrite(capture_folder, **changes)
    with pytest.raises(ScanstageError, match=f"^capture.json: {words}"):
        load_scan(capture_folder)


def test_with_several_projectors_a_pattern_must_name_its_own(capture_folder):
    capture = read_capture(capture_folder)
    rewrite(capture_folder, projectors={**capture.projectors, "second": capture.projectors["beam"]})
    with pytest.raises(ScanstageError, match="^capture.json: patterns.stripes: must name its projector, one of beam, second"):
        load_scan(capture_folder)
