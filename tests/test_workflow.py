# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From a capture set on disk to a result and its measures, on a ball whose exact hull can be told point by point."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from addon import workflow
from addon.captures.pictures import read_mask
from addon.captures.store import read_capture, write_capture
from addon.errors import Cancelled, ScanstageError
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.geometry import VoxelGrid
from addon.results.folder import read_result
from addon.results.ply import read_ply
from tests.projection import write_projected_capture
from tests.rigs import Ball, camera_at, ring, silhouette, sphere_mesh, write_ball_capture

BALL = Ball((0.1, -0.05, 0.2), 0.6)
CAMERAS = ring(8, focal=300, size=(240, 180))
VOXELS = 64
FILES = ["mesh.ply", "preview.png", "result.json", "volume.npz"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("set") / "capture"
    write_ball_capture(folder, BALL, CAMERAS)
    return folder


@pytest.fixture(scope="module")
def result(capture):
    out = capture.parent / "result"
    return out, workflow.reconstruct(capture, "visual-hull", out, voxels=VOXELS)


def hull_volume(ball: Ball, grid: VoxelGrid) -> float:
    """Return the volume of the points from which a ray through each camera's centre meets the ball: its exact hull."""
    points = grid.centres(np.indices(grid.shape).reshape(3, -1).T)
    inside = np.all([ball.hit_by(camera.centre, points - camera.centre) for camera in CAMERAS], axis=0)
    return float(np.count_nonzero(inside)) * grid.voxel_size ** 3


def listing(folder):
    """Return all that lies in a folder, but for the masks, which reconstructing leaves in the capture set."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if "masks" not in path.parts)


def stop_at(count: int):
    """Return a progress callable that cancels at its call of that number, from 0."""
    calls = iter(range(count + 1))

    def progress(fraction, message):
        if next(calls) == count:
            raise Cancelled

    return progress


def test_a_capture_becomes_a_result_folder(capture, result):
    out, report = result
    assert sorted(path.name for path in out.iterdir()) == FILES
    written = json.loads((out / "result.json").read_text())
    assert written == {**report, "format": "scanstage-result", "version": 1, "layers": {}}
    assert (out / written["capture"]).resolve() == capture.resolve() and written["method"] == "visual-hull" and written["voxels"] == VOXELS
    assert written["silhouette"] == {} and written["counts"]["views"] == len(CAMERAS)
    found = read_result(out)
    assert found.volume.count() == report["counts"]["occupied"]
    mesh = read_ply(out / "mesh.ply")
    assert mesh.is_watertight() and mesh.volume() == pytest.approx(found.volume.volume(), rel=1e-5)  # single precision
    assert cv2.imread(str(out / "preview.png")).std() > 5


def test_the_result_has_the_colour_of_the_pictures(result):
    found = read_result(result[0])
    seen = found.colors.rgb[found.colors.views > 0]
    # The outline's pixels mix with the black behind the ball; 16-bit pictures hold 0.6, 0.3, 0.1 to 1e-5.
    np.testing.assert_allclose(np.median(seen, axis=0), (0.6, 0.3, 0.1), atol=1e-4)


def test_the_hull_holds_the_object_and_no_more_than_geometry_allows(result):
    """A conservative mask reaches at most 1.5 pixels' diagonals beyond an outline, and a voxel its own diagonal beyond that."""
    out, report = result
    found = workflow.evaluate_result(out)
    assert found["volume"]["truth_voxels_removed"] == 0
    assert found["volume"]["loss"] == 0
    grid = read_result(out).volume.grid
    farthest = max(np.linalg.norm(camera.centre - BALL.centre) for camera in CAMERAS) + BALL.radius
    beyond = np.sqrt(2) * 1.5 * farthest / 300 + np.sqrt(3) * grid.voxel_size
    assert hull_volume(BALL, grid) <= found["volume"]["result"] <= hull_volume(replace(BALL, radius=BALL.radius + beyond), grid)
    assert found["volume"]["truth"] == pytest.approx(4 / 3 * np.pi * BALL.radius ** 3, rel=0.02)  # 32 rings, and voxels
    assert json.loads((out / "result.json").read_text())["evaluation"] == found


def test_a_given_truth_comes_before_the_captures(result):
    out, _ = result
    smaller = workflow.evaluate_result(out, sphere_mesh(Ball(BALL.centre, 0.3)), options={"samples": 200})
    assert smaller["volume"]["truth"] == pytest.approx(4 / 3 * np.pi * 0.3 ** 3, rel=0.03)
    assert smaller["volume"]["truth_voxels_removed"] == 0
    with pytest.raises(ScanstageError, match="^evaluate has no option 'sample'"):
        workflow.evaluate_result(out, options={"sample": 200})


@pytest.mark.parametrize(("options", "unbiased"), [({"rule": "center"}, True), ({"rule": "conservative"}, False),
                                                   ({"rule": "center", "conservative": "yes"}, False)])
def test_the_center_rule_takes_masks_that_are_not_grown(capture, tmp_path, options, unbiased):
    report = workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=24, options=options)
    seen = silhouette(CAMERAS[3], [BALL])
    grown = cv2.dilate(seen.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    np.testing.assert_array_equal(read_mask(capture / "masks/0004.png", size=CAMERAS[3].size), seen if unbiased else grown)
    assert report["options"]["rule"] == options["rule"]
    assert report["silhouette"] == {"center": {"conservative": not unbiased}, "conservative": {}}[options["rule"]]


def test_the_center_rules_hull_is_neither_too_large_nor_too_small(capture, tmp_path):
    """An outline sampled at pixel centres is right to half a pixel's diagonal, a voxel's centre to half of its own."""
    workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=VOXELS, options={"rule": "center"})
    volume = read_result(tmp_path / "r").volume
    margin = np.sqrt(0.5) * 5 / 300 + np.sqrt(3) / 2 * volume.grid.voxel_size
    least, most = (hull_volume(replace(BALL, radius=BALL.radius + offset), volume.grid) for offset in (-margin, margin))
    assert least < volume.volume() < most


def test_options_go_to_the_method_or_to_the_silhouettes_and_are_noted_as_values(capture, tmp_path):
    report = workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=16, options={
        "tolerance": "1", "dilate": "3", "chroma_angle": "30", "silhouette": "alpha", "conservative": False})
    assert report["options"] == {"rule": "conservative", "tolerance": 1, "outside": "unknown"}
    assert report["silhouette"] == {"dilate": 3, "chroma_angle": pytest.approx(np.radians(30)), "silhouette": "alpha", "conservative": False}
    mask, seen = read_mask(capture / "masks/0001.png", size=CAMERAS[0].size), silhouette(CAMERAS[0], [BALL])
    assert (mask & ~seen).any() and (mask | ~seen).all()


def test_bounds_are_kept_as_given(capture, tmp_path):
    bounds = np.array([(-0.6, -0.7, -0.5), (0.8, 0.6, 0.9)])
    report = workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=14, bounds=bounds)
    assert report["grid"]["origin"] == bounds[0].tolist() and report["grid"]["shape"] == [14, 13, 14]


def test_an_older_result_is_replaced_and_nothing_else(capture, tmp_path):
    workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=8)
    workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=9)
    assert json.loads((tmp_path / "r" / "result.json").read_text())["voxels"] == 9
    assert sorted(path.name for path in (tmp_path / "r").iterdir()) == FILES
    foreign = tmp_path / "mine"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("all of it")
    before = listing(tmp_path)
    with pytest.raises(ScanstageError, match="mine: is not empty and not a result, so it is not replaced"):
        workflow.reconstruct(capture, "visual-hull", foreign, voxels=8, progress=stop_at(0))
    assert listing(tmp_path) == before


def test_a_capture_inside_an_older_result_is_not_thrown_away(capture, tmp_path):
    out = tmp_path / "r"
    workflow.reconstruct(capture, "visual-hull", out, voxels=8)
    write_ball_capture(out / "capture", BALL, CAMERAS[:3])
    before = listing(tmp_path)
    with pytest.raises(ScanstageError, match="r: holds the capture set and would be replaced; name another folder"):
        workflow.reconstruct(out / "capture", "visual-hull", out, voxels=8)
    assert listing(tmp_path) == before


@pytest.mark.parametrize(("call", "message"), [
    ({"method": "carving"}, "^there is no method 'carving'"), ({"voxels": 0}, "^--voxels: "),
    ({"bounds": np.zeros((2, 3))}, "^--bounds: the box has no volume"), ({"options": {"rule": "edge"}}, "^option rule: 'edge'"),
    ({"options": {"dilate": "-1"}}, "^option dilate: -1 px is not from 0 px to 100 px"),
    ({"options": {"fillholes": 1}}, "^method visual-hull has no option 'fillholes'; its options are: rule, .*, fill_holes"),
])
def test_a_bad_call_is_refused_before_any_picture_is_read(capture, tmp_path, call, message):
    with pytest.raises(ScanstageError, match=message):
        workflow.reconstruct(capture, **{"method": "visual-hull", "out": tmp_path / "r", **call}, progress=stop_at(0))
    assert not list(tmp_path.iterdir())


def test_cancelling_at_any_step_leaves_no_folder(tmp_path):
    capture, messages = tmp_path / "capture", []
    write_ball_capture(capture, BALL, ring(3, focal=75, size=(60, 45)))
    workflow.reconstruct(capture, "visual-hull", tmp_path / "whole", voxels=8, progress=lambda _, message: messages.append(message))
    assert messages[-1] == "Result written"
    before = listing(tmp_path), (tmp_path / "whole" / "result.json").read_bytes()
    for count in range(len(messages) - 1):  # once it is written, it is written
        with pytest.raises(Cancelled):
            workflow.reconstruct(capture, "visual-hull", tmp_path / ("new", "whole")[count % 2], voxels=8, progress=stop_at(count))
    assert (listing(tmp_path), (tmp_path / "whole" / "result.json").read_bytes()) == before


def test_progress_never_goes_back(capture, tmp_path):
    seen = []
    workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=12, progress=lambda fraction, _: seen.append(fraction))
    assert seen == sorted(seen) and seen[0] >= 0 and seen[-1] == 1


def test_cancelling_an_evaluation_leaves_the_result_as_it_was(capture, tmp_path):
    workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=12)
    with pytest.raises(Cancelled):
        workflow.evaluate_result(tmp_path / "r", progress=stop_at(2))
    assert "evaluation" not in json.loads((tmp_path / "r" / "result.json").read_text())


def test_a_result_whose_truth_is_gone_says_what_to_do(capture, tmp_path):
    own = tmp_path / "capture"
    write_ball_capture(own, BALL, CAMERAS[:4])
    workflow.reconstruct(own, "visual-hull", tmp_path / "r", voxels=12)
    write_capture(own, replace(read_capture(own), truth_mesh=None))
    with pytest.raises(ScanstageError, match=r"capture.json: truth is null: photographs have none; name a mesh with --truth$"):
        workflow.evaluate_result(tmp_path / "r")
    own.rename(tmp_path / "elsewhere")
    with pytest.raises(ScanstageError, match=r"result.json: capture: there is no capture set at '.*capture'; name a mesh with --truth$"):
        workflow.evaluate_result(tmp_path / "r")


@pytest.mark.parametrize("older", [False, True])
def test_a_result_finds_its_capture_set_after_both_have_moved(tmp_path, older):
    """A result names its capture set as seen from itself; those of earlier versions name an absolute path."""
    write_ball_capture(tmp_path / "here" / "capture", BALL, CAMERAS[:4])
    report = workflow.reconstruct(tmp_path / "here" / "capture", "visual-hull", tmp_path / "here" / "r", voxels=12)
    assert report["capture"] == "../capture"
    (tmp_path / "here").rename(tmp_path / "there")
    path = tmp_path / "there" / "r" / "result.json"
    if older:
        path.write_text(json.dumps({**json.loads(path.read_text()), "capture": str(tmp_path / "there" / "capture")}))
    assert workflow.evaluate_result(path.parent)["volume"]["truth_voxels_removed"] == 0


@pytest.mark.parametrize("capture_field", [None, 7, ["a"], "", "a\nb", "x" * 5000], ids=range(6))
def test_a_result_that_lies_about_its_capture_is_refused(capture, tmp_path, capture_field):
    workflow.reconstruct(capture, "visual-hull", tmp_path / "r", voxels=8)
    report = json.loads((tmp_path / "r" / "result.json").read_text())
    (tmp_path / "r" / "result.json").write_text(json.dumps({**report, "capture": capture_field}))
    with pytest.raises(ScanstageError, match="result.json: capture: there is no capture set at") as caught:
        workflow.evaluate_result(tmp_path / "r")
    assert "\n" not in str(caught.value)


def test_structured_light_from_a_capture_set_to_measured_points(tmp_path):
    ball = Ball((0.0, 0.0, 0.0), 0.3)
    camera = camera_at((0.0, -2.0, 0.3), focal=230.0, size=(160, 120))
    projector = camera_at((0.7, -1.9, 0.35), focal=180.0, size=(128, 96))
    write_projected_capture(tmp_path / "set", camera, projector, make_patterns("gray-code", projector.size, {"axes": "columns"}), ball, poses=4)
    report = workflow.reconstruct(tmp_path / "set", "gray-code", tmp_path / "out", voxels=32)
    assert report["counts"]["points"] > 5000 and report["counts"]["views"] == 4
    assert not (tmp_path / "set" / "masks").exists()
    result = read_result(tmp_path / "out")
    assert len(result.points) == report["counts"]["points"]
    for name in ("mesh.ply", "preview.png", "points.ply", "pictures/decoded-00-white.png"):
        assert (tmp_path / "out" / name).is_file()
    measures = workflow.evaluate_result(tmp_path / "out")
    assert measures["points"]["accuracy_90"] < 3 * report["expected_sigma"]
    assert measures["points"]["completeness"] > 0.4  # from four sides, and hardly from above and below
    assert json.loads((tmp_path / "out" / "result.json").read_text())["evaluation"]["points"] == measures["points"]
