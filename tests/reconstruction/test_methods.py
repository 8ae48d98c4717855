# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table agrees with the functions, and running a method reports what it did or says in one sentence why it cannot."""

import inspect
import json
from dataclasses import replace

import numpy as np
import pytest

from addon.errors import Cancelled, ScanstageError
from addon.options import Option
from addon.reconstruction.methods import METHODS, reconstruct
from addon.reconstruction.scan import Scan
from addon.reconstruction.silhouettes import SILHOUETTE_OPTIONS, extract
from tests.rigs import Ball, ring, views_of

BALL = Ball((0.1, -0.05, 0.2), 0.6)
BOUNDS = np.array([(-0.8, -0.9, -0.6), (0.9, 0.8, 1.0)])
EVERY_METHOD = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)


def grey_picture():
    return np.full((120, 160, 3), 0.4, np.float32)


@pytest.fixture(scope="module")
def scan():
    views = views_of(ring(6, elevation=15, focal=200, size=(160, 120)), [BALL])
    return Scan(tuple(replace(view, read_image=grey_picture) for view in views))


TOOLS = {"progress", "solids"}.union(*(method.spread for method in METHODS.values()))


def keywords(function) -> dict:
    """Return the keyword-only parameters of a function and their defaults, but for its progress and the functions that it may be given."""
    parameters = inspect.signature(function).parameters.values()
    return {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY and p.name not in TOOLS}


# --- the table ---------------------------------------------------------------------------------------------------------------

@EVERY_METHOD
def test_options_are_the_functions_keywords_with_the_same_defaults(method):
    options = {option.name: option.default for option in method.options}
    assert keywords(method.measure or method.function) == options
    own = keywords(method.function).items() if method.measure is None else keywords(method.function).items() - {("measured", inspect.Parameter.empty)}
    assert own <= options.items()
    assert keywords(method.bounds).keys() <= options.keys()


@EVERY_METHOD
def test_every_entry_can_be_shown(method):
    assert METHODS[method.name] is method
    for text in (method.label, method.description, *(option.description for option in method.options)):
        assert text.strip() and not text.endswith(".")
    assert method.needs and set(method.needs) <= {"silhouettes", "colour", "lights", "patterns"}


@EVERY_METHOD
def test_options_are_told_apart_from_those_of_the_silhouettes(method):
    """Both are given in one go, on the command line and by `workflow.reconstruct`."""
    assert not {option.name for option in method.options} & {option.name for option in SILHOUETTE_OPTIONS}


@pytest.mark.parametrize("option", [*SILHOUETTE_OPTIONS, *(option for method in METHODS.values() for option in method.options)],
                         ids=lambda option: option.name)
def test_defaults_are_allowed_and_every_choice_is_explained(option: Option):
    assert option.check(option.default) == option.default
    assert all(meaning and not meaning.endswith(".") for meaning in (option.choices or {}).values())
    assert option.description and not option.description.endswith(".")


def test_options_of_the_silhouettes_are_the_extractors_keywords():
    assert list(keywords(extract)) == [option.name for option in SILHOUETTE_OPTIONS]


# --- running one -------------------------------------------------------------------------------------------------------------

def test_the_report_says_what_was_done_in_plain_json(scan):
    found = reconstruct(scan, "visual-hull", voxels=34, bounds=BOUNDS, options={"tolerance": 1, "outside": "empty"})
    report, surface = found.report, found.surface
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert report["method"] == "visual-hull" and report["voxels"] == 34
    assert report["options"] == {"rule": "conservative", "tolerance": 1, "outside": "empty"}
    # 1.7 is the longest side: along y its 34 voxels of 0.05 end exactly at the bound, along z 1.6 takes 32.
    assert report["grid"]["origin"] == BOUNDS[0].tolist() and report["grid"]["shape"] == [34, 34, 32]
    assert report["grid"]["voxel_size"] == pytest.approx(0.05)
    counts = report["counts"]
    assert (counts["views"], counts["occupied"]) == (6, np.count_nonzero(found.volume.dense()))
    assert (counts["surface"], counts["quads"]) == (len(surface.voxels), len(surface.quads))
    assert counts["unseen"] == np.count_nonzero(found.colors.views == 0)
    assert counts["tests_dense"] == 34 * 34 * 32 * 6 and 0 < counts["tests"] < counts["tests_dense"]
    assert set(report["seconds"]) == {"bounds", "carve", "surface", "colour", "re-projection"}
    assert all(seconds >= 0 for seconds in report["seconds"].values())
    assert report["peak_memory"] is None or report["peak_memory"] > 1 << 20
    ious = report["silhouette_iou"]["views"]
    assert list(ious) == [view.name for view in scan.views]
    assert report["silhouette_iou"]["mean"] == pytest.approx(np.mean(list(ious.values())), abs=1e-4)
    assert isinstance(report["warnings"], list)


def test_the_hull_of_a_ball_fills_its_silhouettes(scan):
    """Conservative voxels reach a voxel's diagonal, 0.035 m or 1.8 px here, beyond an outline 31 px from its middle."""
    found = reconstruct(scan, "visual-hull", voxels=96)
    assert found.volume.grid.voxel_size < 0.02
    assert min(found.report["silhouette_iou"]["views"].values()) > (31 / (31 + 1.8 + 0.5)) ** 2
    np.testing.assert_allclose(found.colors.rgb[found.colors.views > 0], 0.4, atol=1e-6)


def test_without_bounds_the_working_volume_is_found(scan):
    found = reconstruct(scan, "visual-hull", voxels=40)
    grid = found.volume.grid
    assert (grid.origin < np.array(BALL.centre) - BALL.radius).all() and (grid.upper > np.array(BALL.centre) + BALL.radius).all()
    assert max(grid.shape) == 40 and found.report["warnings"] == []
    np.testing.assert_allclose(found.report["grid"]["origin"], grid.origin)


@pytest.mark.parametrize("given", ["call", "capture"])
def test_a_given_working_volume_that_clips_is_warned_about(scan, given):
    cut = BOUNDS.copy()
    cut[1, 2] = BALL.centre[2]
    found = reconstruct(replace(scan, bounds=cut), "visual-hull", voxels=24) if given == "capture" \
        else reconstruct(scan, "visual-hull", voxels=24, bounds=cut)
    assert len(found.report["warnings"]) == 1
    assert found.report["warnings"][0].startswith("the working volume clips the result at +z: give wider --bounds")
    assert reconstruct(scan, "visual-hull", voxels=24, bounds=BOUNDS).report["warnings"] == []


def test_the_calls_bounds_come_before_the_captures(scan):
    inner = reconstruct(replace(scan, bounds=BOUNDS * 3), "visual-hull", voxels=16, bounds=BOUNDS)
    assert inner.report["grid"]["origin"] == BOUNDS[0].tolist()
    assert reconstruct(replace(scan, bounds=BOUNDS), "visual-hull", voxels=16).report["grid"] == inner.report["grid"]


def test_progress_goes_from_start_to_end_and_can_cancel(scan):
    seen = []
    reconstruct(scan, "visual-hull", voxels=24, bounds=BOUNDS, progress=lambda fraction, message: seen.append((fraction, message)))
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions) and fractions[-1] == 1 and all(message for _, message in seen)
    for last in range(len(seen)):
        calls = iter(range(len(seen)))

        def stop(fraction, message, calls=calls, last=last):
            if next(calls) == last:
                raise Cancelled

        with pytest.raises(Cancelled):
            reconstruct(scan, "visual-hull", voxels=24, bounds=BOUNDS, progress=stop)


# --- refusals ----------------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize(("call", "message"), [
    ({"method": "visual-hulk"}, "^there is no method 'visual-hulk'; the methods are: visual-hull"),
    ({"options": {"tolerence": 1}}, "^method visual-hull has no option 'tolerence'; its options are: rule, tolerance, outside$"),
    ({"options": {"tolerance": "many"}}, "^option tolerance: 'many' is not a whole number"),
    ({"options": {"rule": "corners"}}, "^option rule: 'corners' is none of conservative, center"),
    ({"bounds": np.zeros((2, 3))}, "^--bounds: the box has no volume"),
    ({"bounds": BOUNDS[::-1]}, "^--bounds: the box has no volume"),
    ({"bounds": BOUNDS * np.nan}, "^--bounds: lower must be 3 finite numbers"),
    ({"bounds": BOUNDS * 1e10}, "^--bounds: must lie between"),
    ({"bounds": BOUNDS * 1e-12}, "^--bounds: voxels of 1.7e-13 are too small"),
    ({"voxels": 0}, "^--voxels: must be from 1 to 16384"), ({"voxels": -5}, "^--voxels: must be from 1 to 16384"),
    ({"voxels": 16385}, "^--voxels: must be from 1 to 16384"), ({"voxels": 10 ** 400}, "^--voxels: must be from 1 to 16384"),
])
def test_a_bad_call_is_one_sentence(scan, call, message):
    with pytest.raises(ScanstageError, match=message) as caught:
        reconstruct(scan, **{"method": "visual-hull", "voxels": 10, "bounds": BOUNDS, **call})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bounds", [None, BOUNDS])
def test_a_scan_without_views_is_refused(bounds):
    with pytest.raises(ScanstageError, match="the capture has no views"):
        reconstruct(Scan(()), "visual-hull", voxels=8, bounds=bounds)


@pytest.mark.parametrize(("mask", "message"), [
    (None, "frame 0002 has no silhouette"),
    (np.zeros((120, 160), bool), "the visual hull is empty: the views contradict each other; check masks and poses"),
])
def test_a_mask_that_cannot_be_used_is_refused(scan, mask, message):
    views = list(scan.views)
    views[2] = replace(views[2], mask=mask)
    with pytest.raises(ScanstageError, match=message):
        reconstruct(Scan(tuple(views)), "visual-hull", voxels=16, bounds=BOUNDS)


def test_a_working_volume_beside_the_object_is_empty(scan):
    with pytest.raises(ScanstageError, match="^the visual hull is empty"):
        reconstruct(scan, "visual-hull", voxels=16, bounds=BOUNDS * 0.1 + np.array([0, 0, 0.95]))
