# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""capture.json: round trip, and one clear sentence for each thing that can be wrong with it."""

import copy
import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from addon.captures.fields import MAX_BYTES, Field, parse_json
from addon.captures.schema import capture_from_field, capture_to_dict
from addon.errors import ScanstageError

DELETE = object()


def read(document):
    return capture_from_field(parse_json(json.dumps(document).encode(), "capture.json"))


def changed(document, path, value):
    *parents, last = path
    for step in parents:
        document = document[step]
    if value is DELETE:
        del document[last]
    else:
        document[last] = value


def test_a_document_with_every_field_survives_the_round_trip(document):
    assert capture_to_dict(read(document)) == document


def test_what_may_be_absent_has_its_default(document):
    for name in ("generator", "patterns", "silhouette", "plate", "bounds", "truth", "missing", "board", "pencils"):
        del document[name]
    del document["devices"]["projectors"], document["devices"]["lights"]
    document["frames"] = [{"id": "a", "image": "a.png", "camera": "left"}]
    del document["devices"]["cameras"]["left"]["distortion"], document["devices"]["cameras"]["left"]["mirrored"]
    capture = read(document)
    assert capture.bounds is None and capture.truth_mesh is None and not capture.missing and not capture.plates
    assert not capture.cameras["left"].distorted
    np.testing.assert_array_equal(capture.frames[0].object_to_world, np.eye(4))


def test_camera_of_is_the_rig_camera_seen_from_the_turned_object(document):
    capture = read(document)
    frame = capture.frames[1]
    point = np.array([0.1, -0.2, 0.05, 1.0])
    expected, _ = capture.cameras["left"].project((frame.object_to_world @ point)[:3])
    found, _ = capture.camera_of(frame).project(point[:3])
    np.testing.assert_allclose(found, expected, atol=1e-10)  # the same product in another order


def test_a_mirrored_camera_is_accepted_only_where_it_says_so(document):
    camera = document["devices"]["cameras"]["left"]
    camera["R"] = (np.array(camera["R"]) * [[-1], [1], [1]]).tolist()
    with pytest.raises(ScanstageError, match=r"^capture.json: devices.cameras.left.R: is not a rotation.*mirrored"):
        read(document)
    camera["mirrored"] = True
    assert read(document).cameras["left"].mirrored


CAMERA_PATH = ("devices", "cameras", "left")
FRAME = ("frames", 1)
BAD = {
    "no format": (("format",), DELETE, "format: is missing"),
    "other format": (("format",), "colmap", "format: must be 'scanstage-capture'"),
    "no version": (("version",), DELETE, "version: is missing"),
    "other version": (("version",), 2, "version: must be 1"),
    "version true": (("version",), True, "version: must be 1"),
    "version text": (("version",), "1", "version: must be 1"),
    "unknown field": (("fps",), 24, "fps: is not a known field"),
    "no devices": (("devices",), DELETE, "devices: is missing"),
    "devices a list": (("devices",), [], "devices: must be a JSON object"),
    "no cameras": (("devices", "cameras"), DELETE, "devices.cameras: is missing"),
    "no K": ((*CAMERA_PATH, "K"), DELETE, "devices.cameras.left.K: is missing"),
    "K of text": ((*CAMERA_PATH, "K"), "abc", "devices.cameras.left.K: must be a list of 3"),
    "K too short": ((*CAMERA_PATH, "K"), [[1, 0, 0], [0, 1, 0]], "devices.cameras.left.K: must have 3 entries, not 2"),
    "NaN in K": ((*CAMERA_PATH, "K", 0, 0), float("nan"), r"devices.cameras.left.K\[0\]\[0\]: must be a number"),
    "infinity in t": ((*CAMERA_PATH, "t", 1), float("inf"), r"devices.cameras.left.t\[1\]: must be a number"),
    "huge number": ((*CAMERA_PATH, "t", 1), 1e300, r"devices.cameras.left.t\[1\]: must be a number"),
    "huge integer": ((*CAMERA_PATH, "t", 1), 10 ** 400, r"devices.cameras.left.t\[1\]: must be a number"),
    "true as number": ((*CAMERA_PATH, "t", 1), True, r"devices.cameras.left.t\[1\]: must be a number"),
    "negative focal": ((*CAMERA_PATH, "K", 0, 0), -9, "devices.cameras.left.K: must be upper triangular"),
    "non-rotation": ((*CAMERA_PATH, "R", 0), [1, 1, 1], "devices.cameras.left.R: must be a rotation"),
    "mirrored in vain": ((*CAMERA_PATH, "mirrored"), True, "devices.cameras.left.R: is a rotation although"),
    "mirrored text": ((*CAMERA_PATH, "mirrored"), "yes", "devices.cameras.left.mirrored: must be true or false"),
    "four distortions": ((*CAMERA_PATH, "distortion"), [0] * 4, "devices.cameras.left.distortion: must have 5"),
    "width 0": ((*CAMERA_PATH, "size"), [0, 6], r"devices.cameras.left.size\[0\]: must be a whole number from 1"),
    "negative height": ((*CAMERA_PATH, "size"), [8, -6], r"devices.cameras.left.size\[1\]: must be a whole number"),
    "fractional size": ((*CAMERA_PATH, "size"), [8.5, 6], r"devices.cameras.left.size\[0\]: must be a whole number"),
    "huge size": ((*CAMERA_PATH, "size"), [60000, 60000], "devices.cameras.left.size: 60000x60000 is more than"),
    "three sizes": ((*CAMERA_PATH, "size"), [8, 6, 3], "devices.cameras.left.size: has 3 entries"),
    "one size": ((*CAMERA_PATH, "size"), [8], r"devices.cameras.left.size: must be \[width, height\]"),
    "bad projector": (("devices", "projectors", "beam", "K"), 3, "devices.projectors.beam.K: must be a list"),
    "light kind": (("devices", "lights", "lamp", "kind"), "laser", "devices.lights.lamp.kind: 'laser' is not"),
    "light nowhere": (("devices", "lights", "lamp", "position"), None, "devices.lights.lamp.position: is missing"),
    "light direction": (("devices", "lights", "sun", "direction"), [0, 0, 0], "devices.lights.sun.direction: must be a unit"),
    "light radius": (("devices", "lights", "sun", "radius"), -1, "devices.lights.sun.radius: must be a number from 0"),
    "no frames": (("frames",), DELETE, "frames: is missing"),
    "zero frames": (("frames",), [], "frames: is empty"),
    "frames an object": (("frames",), {}, "frames: must be a list"),
    "frame a number": (("frames", 0), 7, r"frames\[0\]: must be a JSON object"),
    "duplicate id": ((*FRAME, "id"), "0001", r"frames\[1\].id: '0001' is also the id of frames\[0\]"),
    "id with a slash": ((*FRAME, "id"), "../x", r"frames\[1\].id: '../x' cannot be a file's name"),
    "id a number": ((*FRAME, "id"), 2, r"frames\[1\].id: must be a text"),
    "unknown camera": ((*FRAME, "camera"), "right", r"frames\[1\].camera: 'right' is not a camera of this set"),
    "unknown light": ((*FRAME, "lights"), ["moon"], r"frames\[1\].lights\[0\]: 'moon' is not a light"),
    "unknown pattern": ((*FRAME, "pattern"), "dots", r"frames\[1\].pattern: 'dots' is not a pattern"),
    "scaled motion": ((*FRAME, "object_to_world", 0, 0), 2, r"frames\[1\].object_to_world: is not a rigid motion"),
    "mirroring motion": ((*FRAME, "object_to_world", 2, 2), -1, r"frames\[1\].object_to_world: is not a rigid motion"),
    "projective motion": ((*FRAME, "object_to_world", 3, 0), 0.1, r"frames\[1\].object_to_world: .* last row"),
    "absolute path": ((*FRAME, "image"), "/etc/passwd", r"frames\[1\].image: '/etc/passwd' leaves the capture set"),
    "path upwards": ((*FRAME, "image"), "images/../../x.png", r"frames\[1\].image: .* leaves the capture set"),
    "drive": ((*FRAME, "image"), "C:x.png", r"frames\[1\].image: .* leaves the capture set"),
    "backslashes": ((*FRAME, "mask"), "..\\x.png", r"frames\[1\].mask: .* leaves the capture set"),
    "dot": ((*FRAME, "image"), ".", r"frames\[1\].image: .* leaves the capture set"),
    "empty path": ((*FRAME, "image"), "", r"frames\[1\].image: must be 1 to"),
    "nul in path": ((*FRAME, "image"), "a\0.png", r"frames\[1\].image: must be 1 to"),
    "long path": ((*FRAME, "image"), "a" * 5000, r"frames\[1\].image: must be 1 to"),
    "pattern of NaN": (("patterns", "stripes", "bit"), float("nan"), "patterns.stripes: holds a number that is not finite"),
    "pattern a list": (("patterns", "stripes"), [], "patterns.stripes: must be a JSON object"),
    "no encoding": (("encoding",), DELETE, "encoding: is missing"),
    "other encoding": (("encoding",), "log", "encoding: 'log' is not an encoding"),
    "silhouette a list": (("silhouette",), [1], "silhouette: must be a JSON object"),
    "silhouette of lists": (("silhouette", "threshold"), [1], "silhouette.threshold: must be a number"),
    "plate of nobody": (("plate", "right"), "x.png", "plate.right: 'right' is not a camera"),
    "plate outside": (("plate", "left"), "../x.png", "plate.left: .* leaves the capture set"),
    "flat bounds": (("bounds", 1, 2), 0, "bounds: has no volume"),
    "bounds of text": (("bounds", 1, 2), "x", r"bounds\[1\]\[2\]: must be a number"),
    "board of another kind": (("board", "kind"), "circles", "board.kind: 'circles' is not a kind of board"),
    "board without size": (("board", "rows"), DELETE, "board.rows: is missing"),
    "board too narrow": (("board", "columns"), 3, "board.columns: must be from 4 to 50 squares"),
    "board without markers": (("board", "marker"), DELETE, "board.marker: must be a length less than the square's"),
    "board of unknown markers": (("board", "dictionary"), "3X3_10", "board.dictionary: '3X3_10' is not a dictionary"),
    "board of too few markers": (("board", "rows"), 11, "board.dictionary: 4X4_50 has 50 markers, and the board needs 55"),
    "pose of no board": (("board",), DELETE, r"frames\[1\].board_pose: names a place of the board, but the set has none"),
    "pose a number": ((*FRAME, "board_pose"), 3, r"frames\[1\].board_pose: must be a text"),
    "pencils of a sun": (("pencils", "light"), "sun", "pencils.light: 'sun' is not a point or spot light of this set"),
    "pencils at no pose": (("pencils", "board_pose"), "2", "pencils.board_pose: '2' is not a board_pose of a frame"),
    "pencils without shadow": (("pencils", "shadow_tips"), [[1.0, 2.0]], "pencils.shadow_tips: has 1 marks and bases 2"),
    "pencils below ground": (("pencils", "height"), -1, "pencils.height: must be a number from 0"),
    "pencils in space": (("pencils", "bases", 0), [1, 2, 3], r"pencils.bases\[0\]: must have 2 entries"),
    "truth outside": (("truth", "mesh"), "/truth.ply", "truth.mesh: .* leaves the capture set"),
    "missing unknown": (("missing",), ["0009"], r"missing\[0\]: '0009' is not a frame"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_named_with_file_and_field(document, case):
    path, value, message = BAD[case]
    changed(document, path, value)
    with pytest.raises(ScanstageError, match=f"^capture.json: {message}") as caught:
        read(document)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500


@pytest.mark.parametrize(("data", "message"), [
    (b"", "is not valid JSON at line 1"),
    (b"{\"a\": 1,}", "is not valid JSON at line 1"),
    (b"\xff\xfe", "is not valid JSON"),
    (b"[" * 200_000, "is nested too deeply"),
    (b"{\"a\":" * 200_000, "is nested too deeply"),
    (b"{\"a\": 1, \"a\": 2}", "'a' is given twice"),
    (b"{\"a\": " + b"9" * 5000 + b"}", "is not valid JSON"),
    (b" " * (MAX_BYTES + 1), "is larger than 64 MiB"),
], ids=["empty", "comma", "binary", "lists", "objects", "twice", "digits", "size"])
def test_what_is_no_sound_json_is_refused_in_one_sentence(data, message):
    with pytest.raises(ScanstageError, match=f"^capture.json: .*{message}"):
        parse_json(data, "capture.json")


@pytest.mark.parametrize("value", [None, [], "x", 3, float("nan")])
def test_a_document_that_is_no_object_is_refused(value):
    with pytest.raises(ScanstageError, match="^capture.json: must be a JSON object"):
        capture_from_field(Field(value, "capture.json"))


def _places(value, path=()):
    yield path
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in children:
        yield from _places(child, (*path, key))


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
    | st.sampled_from(["left", "0001", "/", "..", 1e308]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4), max_leaves=6)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_change_to_a_valid_document_is_read_or_refused_but_never_crashes(document, data):
    document = {"top": copy.deepcopy(document)}  # the fixture's value is shared by all examples
    for _ in range(data.draw(st.integers(1, 3))):
        places = [place for place in _places(document) if place]
        place = data.draw(st.sampled_from(places))
        delete = len(place) > 1 and data.draw(st.integers(0, 4)) == 0
        changed(document, place, DELETE if delete else data.draw(JUNK))
    try:
        capture = capture_from_field(Field(document["top"], "capture.json"))
    except ScanstageError as error:
        assert str(error).startswith("capture.json: ")
    else:  # what is accepted must be usable: it can be written and read again
        assert capture_to_dict(read(capture_to_dict(capture))) == capture_to_dict(capture)
