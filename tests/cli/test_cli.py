# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as scripts rely on it: exit status, results on stdout, everything else on stderr, and the whole chain."""

import importlib
import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from addon.cli import main
from addon.cli.progress_bar import ProgressBar, drain
from addon.cli.verbs import VERBS
from addon.errors import Cancelled, ScanstageError
from addon.reconstruction.calibration.board import Board
from addon.reconstruction.methods import METHODS
from addon.results.folder import read_result
from addon.results.meshes import read_mesh
from tests.boards import device, spread_poses, write_board_capture
from tests.rigs import Ball, ring, write_ball_capture

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "scanstage.py"
BALL = Ball((0.1, -0.05, 0.2), 0.6)
POSIX = pytest.mark.skipif(os.name != "posix", reason="signals and pipes as POSIX has them")


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("set") / "capture"
    write_ball_capture(folder, BALL, ring(6, focal=150, size=(120, 90)))
    return folder


@pytest.fixture
def run(capsys):
    """Return a function that runs a verb in this process and gives its exit status, stdout and stderr."""
    def run(*arguments) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def reconstruct(run, capture, tmp_path):
    """Return a function that reconstructs the ball into ``tmp_path / "result"``."""
    return lambda *more: run("reconstruct", capture, "visual-hull", "--out", tmp_path / "result", "--voxels", "16", *more)


# --- exit status -------------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("arguments", [
    (), ("fly",), ("methods", "--fast"), ("reconstruct", "here", "visual-hull"), ("reconstruct", "here", "visual-hull", "--out"),
    ("reconstruct", "a", "visual-hull", "--out", "b", "--voxels", "many"),
    ("reconstruct", "a", "visual-hull", "--out", "b", "--bounds", "0", "0", "0", "1", "1"),
    ("methods", "--set", "tolerance"), ("methods", "--set", "=3"), ("capture",), ("stage", "turntable"), ("mesh", "result"),
])
def test_a_wrong_call_is_2_and_says_how_to_call(run, arguments):
    status, out, error = run(*arguments)
    assert (status, out) == (2, "") and error.startswith("usage: scanstage") and ": error: " in error


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_help_is_0_and_goes_to_stdout(run, verb):
    status, out, error = run(*filter(None, [verb]), "--help")
    assert (status, error) == (0, "") and out.startswith(f"usage: scanstage {verb}".rstrip())


@pytest.mark.parametrize("stop", [KeyboardInterrupt, Cancelled])
def test_an_interruption_is_130(reconstruct, monkeypatch, stop):
    def interrupted(*args, **kwargs):
        raise stop

    monkeypatch.setattr("addon.cli.verbs.reconstruct", interrupted)
    status, out, error = reconstruct()
    assert (status, out) == (130, "") and error.startswith("scanstage: interrupted; ") and error.count("\n") == 1


@pytest.mark.parametrize(("raised", "line"), [
    (ScanstageError("capture.json: frames: is empty"), "capture.json: frames: is empty"),
    (ScanstageError("a\nb.json: is\r\nodd"), "a?b.json: is??odd"),
    (OSError(28, "No space left on device", "/mnt/result.json"),
     "/mnt/result.json: No space left on device; check the disk space and the rights"),
    (OSError("strange"), "the system: strange; check the disk space and the rights"),
    (MemoryError(), "there is not enough memory; use fewer voxels or smaller pictures"),
])
def test_bad_input_and_what_the_system_refuses_is_1_and_one_line(reconstruct, monkeypatch, raised, line):
    def failing(*args, **kwargs):
        raise raised

    monkeypatch.setattr("addon.cli.verbs.reconstruct", failing)
    assert reconstruct() == (1, "", f"scanstage: error: {line}\n")


def test_a_mistake_of_ours_is_not_dressed_up_as_the_users(reconstruct, monkeypatch):
    monkeypatch.setattr("addon.cli.verbs.reconstruct", lambda *args, **kwargs: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        reconstruct()


def test_a_calibration_says_how_good_each_device_is_and_what_is_weak(run, tmp_path):
    board, camera = Board("checkerboard", 8, 5, 0.03), device(430, (400, 300))
    poses = spread_poses(board, np.random.default_rng(4), 4, nearest=0.45, furthest=0.55)
    write_board_capture(tmp_path / "before", board, camera, None, poses)
    status, out, _ = run("calibrate", tmp_path / "before", "--out", tmp_path / "after", "--quiet", "--report", tmp_path / "report.json")
    first, of_camera, *warnings = out.splitlines()
    assert status == 0 and first == f"{tmp_path / 'after'}: 1 device(s) calibrated"
    assert of_camera.startswith("  camera cam          RMS 0.") and "in 4 poses" in of_camera
    assert warnings[0] == "  warning: camera cam: only 4 poses of the board; take 10 to 20"
    kept = json.loads((tmp_path / "report.json").read_text())
    assert kept["devices"] == json.loads((tmp_path / "after/calibration/report.json").read_text())["devices"]


# --- what goes where ---------------------------------------------------------------------------------------------------------

def test_results_go_to_stdout_and_progress_to_stderr(reconstruct, tmp_path):
    status, out, error = reconstruct()
    assert status == 0
    assert out.splitlines()[0].startswith(f"{tmp_path / 'result'}: visual-hull, ") and "occupied voxels" in out and "silhouette IoU" in out
    lines = error.splitlines()
    assert "Carving" in lines and lines[-1] == "Result written"
    assert sum(line.startswith("Silhouette ") for line in lines) == 1  # a line a step, not one a picture


def test_quiet_leaves_the_results_alone(reconstruct):
    status, out, error = reconstruct("--quiet")
    assert (status, error) == (0, "") and "occupied voxels" in out


def test_the_report_is_what_the_verb_found(reconstruct, run, tmp_path):
    reconstruct("--report", tmp_path / "report.json")
    report = json.loads((tmp_path / "report.json").read_text())
    written = json.loads((tmp_path / "result" / "result.json").read_text())
    assert "lines" not in report and {**report, "format": "scanstage-result", "version": 1, "layers": {}} == written
    assert run("evaluate", tmp_path / "result", "--set", "samples=500", "--report", tmp_path / "report.json")[0] == 0
    assert json.loads((tmp_path / "report.json").read_text()) == json.loads((tmp_path / "result" / "result.json").read_text())["evaluation"]


@pytest.mark.parametrize("place", ["none/report.json", "."])
def test_a_report_that_cannot_be_written_is_refused_before_the_work(reconstruct, tmp_path, place):
    status, out, error = reconstruct("--report", tmp_path / place)
    assert (status, out) == (1, "") and "--report" in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_evaluate_prints_every_measure(reconstruct, run, tmp_path):
    reconstruct()
    status, out, _ = run("evaluate", tmp_path / "result", "--set", "samples=500")
    names = [line.split()[0] for line in out.splitlines()]
    assert status == 0 and names == [f"volume.{n}" for n in ("result", "truth", "excess", "loss", "iou", "truth_voxels_removed")] + [
        f"surface.{n}" for n in ("accuracy_90", "completeness", "chamfer", "hausdorff", "f_score", "rms")]
    assert out.splitlines()[5].split()[1] == "0"


def test_a_bar_is_drawn_on_a_terminal_and_cleared(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    bar = ProgressBar()
    for step in range(101):
        bar(step / 100, "Carving")
    drawn = sys.stderr.getvalue()
    assert "\n" not in drawn and drawn.count("\r") < 20  # not for each of a hundred steps in no time
    assert drawn.endswith(f"{'█' * 30} 100 % {'Carving':<40}")
    bar.close()
    last = sys.stderr.getvalue().rsplit("\r", 2)
    assert last[1].isspace() and len(last[1]) >= len(drawn.rsplit("\r", 1)[1]) and last[2] == ""
    bar.close()
    assert sys.stderr.getvalue().rsplit("\r", 2) == last  # closed is closed


def test_a_generator_of_steps_is_closed_where_the_work_is_stopped():
    cleaned = []

    def steps():
        try:
            yield 0.5, "half"
            yield 1.0, "all"
        finally:
            cleaned.append(True)

    def stop(fraction, message):
        raise Cancelled

    running = steps()
    with pytest.raises(Cancelled):
        drain(running, stop)
    assert cleaned == [True]


# --- options -----------------------------------------------------------------------------------------------------------------

def test_methods_lists_every_option_with_default_unit_and_choices(run, tmp_path):
    status, out, error = run("methods", "--report", tmp_path / "methods.json")
    assert (status, error) == (0, "")
    report = json.loads((tmp_path / "methods.json").read_text())["methods"]
    assert list(report) == list(METHODS)
    for name, method in METHODS.items():
        listed = {option["name"]: option for option in report[name]["options"]}
        assert f"{name}: {method.description} (needs {', '.join(method.needs)})" in out
        for option in method.options:
            assert f"  {option.name} = {option.show(option.default)}: {option.description}\n" in out
            assert listed[option.name]["choices"] == list(option.choices or ())
            assert all(f"      {choice}: {meaning}\n" in out for choice, meaning in (option.choices or {}).items())
    assert "  chroma_angle = 12 degrees: " in out  # 0.209 in the code
    listed = {option["name"]: option for option in report["visual-hull"]["options"]}
    assert listed["chroma_angle"]["default"] == "12 degrees" and listed["chroma_angle"]["unit"] == "degrees"


def test_presets_lists_rigs_and_objects(run, tmp_path):
    status, out, error = run("presets", "--report", tmp_path / "presets.json")
    report = json.loads((tmp_path / "presets.json").read_text())
    assert (status, error) == (0, "") and "turntable: " in out and "  views = 24: " in out and "  dented-sphere: " in out
    assert "dented-sphere" in report["objects"]
    assert {"views", "elevations", "distance"} <= {option["name"] for option in report["presets"]["turntable"]["options"]}


def test_angles_are_typed_in_degrees_and_kept_in_radians(reconstruct, tmp_path):
    assert reconstruct("--set", "chroma_angle=30", "--set", "tolerance = 1", "--set", "tolerance=0")[0] == 0
    report = json.loads((tmp_path / "result" / "result.json").read_text())
    assert report["silhouette"] == {"chroma_angle": pytest.approx(np.pi / 6)}
    assert report["options"]["tolerance"] == 0  # what is said last counts


@pytest.mark.parametrize("numbers", ["-0.75 -0.8 -0.5 0.95 0.7 0.9", "-75e-2 -8E-1 -.5e+0 9.5e-1 .7 0.9"])
def test_bounds_may_be_negative_and_have_exponents(reconstruct, tmp_path, numbers):
    """argparse by itself takes -75e-2 for an option."""
    assert reconstruct("--bounds", *numbers.split())[0] == 0
    grid = read_result(tmp_path / "result").volume.grid
    assert grid.origin.tolist() == [-0.75, -0.8, -0.5] and grid.shape == (16, 15, 14)  # 1.7 x 1.5 x 1.4 in voxels of 0.10625


# --- the whole chain ---------------------------------------------------------------------------------------------------------

def test_stage_capture_reconstruct_evaluate_and_every_ending(run, tmp_path):
    stage, capture, result = tmp_path / "stage.blend", tmp_path / "capture", tmp_path / "result"
    small = [f"--set={setting}" for setting in ("views=8", "resolution_x=160", "resolution_y=120", "elevations=25")]
    status, out, _ = run("stage", "turntable", "--object", "pot", "--out", stage, *small)
    assert (status, out) == (0, f"{stage}: turntable, 8 frames, 1 camera(s)\n")

    status, out, error = run("capture", stage, "--out", capture, "--report", tmp_path / "report.json")
    assert (status, out) == (0, f"{capture}: 8 frames, all whole\n") and "frame 0001, 1 of 8" in error
    assert json.loads((tmp_path / "report.json").read_text())["frames"] == 8
    pictures = {path: path.stat().st_mtime_ns for path in (capture / "images").iterdir()}
    status, out, error = run("capture", stage, "--out", capture)
    assert status == 0 and "8 of 8 frames are there already" in error and "frame 0001" not in error
    assert {path: path.stat().st_mtime_ns for path in (capture / "images").iterdir()} == pictures and len(pictures) == 8

    assert run("reconstruct", capture, "visual-hull", "--out", result, "--voxels", "48")[0] == 0
    status, out, _ = run("evaluate", result, "--report", tmp_path / "report.json", "--set", "samples=2000")
    found = json.loads((tmp_path / "report.json").read_text())
    assert status == 0 and found["volume"]["truth_voxels_removed"] == 0 and found["volume"]["loss"] == 0
    assert found["volume"]["iou"] == pytest.approx(1 / (1 + found["volume"]["excess"]))  # where nothing is lost

    volume = read_result(result).volume.volume()
    for ending in ("ply", "obj", "stl", "glb", "blend", "vox"):
        status, out, _ = run("mesh", result, "--out", tmp_path / f"pot.{ending}")
        assert (status, out) == (0, f"{tmp_path / f'pot.{ending}'}: {len(read_result(result).surface.quads)} faces\n")
        if ending != "vox":  # Blender reads no voxels
            assert read_mesh(tmp_path / f"pot.{ending}").volume() == pytest.approx(volume, rel=1e-4)  # .obj has six decimals of 0.2 m
    status, out, _ = run("mesh", result, "--out", tmp_path / "cloud.ply", "--set", "points=true")
    assert (status, out) == (0, f"{tmp_path / 'cloud.ply'}: {len(read_result(result).surface.voxels)} points\n")
    (tmp_path / "cloud.ply").unlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["capture", "report.json", "result", "stage.blend", "pot.mtl", *(f"pot.{ending}" for ending in ("ply", "obj", "stl", "glb", "blend", "vox"))])

    exact = run("evaluate", result, "--truth", tmp_path / "pot.obj", "--report", tmp_path / "report.json", "--set", "samples=2000")
    found = json.loads((tmp_path / "report.json").read_text())
    assert exact[0] == 0 and exact[1].startswith("  volume.result ") and found["volume"]["iou"] == 1.0
    assert found["surface"]["hausdorff"] < 1e-6  # its own faces, to six decimals


def test_a_stage_tells_what_its_rig_misses(run, tmp_path):
    found = []
    for views in (2, 8):
        status, out, _ = run("stage", "turntable", "--object", "knot", "--coverage", "--out", tmp_path / "stage.blend", "--set", f"views={views}",
                             "--report", tmp_path / "report.json")
        found.append(json.loads((tmp_path / "report.json").read_text())["coverage"])
        assert status == 0 and f"seen_by_less_than_1: {found[-1]['seen_by_less_than_1']:.4g}\n" in out
    assert found[0]["seen_by_less_than_3"] == 1 > found[1]["seen_by_less_than_3"]
    assert found[0]["seen_by_less_than_1"] > found[1]["seen_by_less_than_1"]


def test_an_interrupted_capture_lists_what_it_lacks_and_goes_on(run, tmp_path, monkeypatch):
    """Ctrl-C comes while a step is reported."""
    stage, capture = tmp_path / "stage.blend", tmp_path / "capture"
    run("stage", "turntable", "--object", "knot", "--out", stage, "--set", "views=3", "--set", "resolution_x=32", "--set", "resolution_y=24")
    progress_bar = importlib.import_module("addon.cli.progress_bar").ProgressBar

    def interrupt(self, fraction, message):
        if message.startswith("frame 0002"):
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(progress_bar, "__call__", interrupt)
        assert run("capture", stage, "--out", capture)[0] == 130
    assert json.loads((capture / "capture.json").read_text())["missing"] == ["0003"]
    status, out, error = run("reconstruct", capture, "visual-hull", "--out", tmp_path / "result", "--quiet")
    assert status == 1 and "capture.json: missing: 1 of 3 frames are not rendered yet (first: 0003)" in error
    assert run("capture", stage, "--out", capture)[:2] == (0, f"{capture}: 3 frames, all whole\n")


def test_the_demo_leaves_everything_to_look_at_and_a_file_to_open(run, tmp_path):
    import bpy

    out = tmp_path / "demo"
    status, printed, _ = run("demo", "--out", out, "--set", "views=8", "--set", "voxels=48", "--report", tmp_path / "report.json")
    assert status == 0 and str(out / "scanstage.blend") in printed and "volume.truth_voxels_removed    0" in printed
    assert sorted(path.name for path in out.iterdir()) == ["capture", "contact_sheet.png", "preview.png", "result", "scanstage.blend"]
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["result"]["counts"]["views"] == 8 and report["evaluation"]["volume"]["truth_voxels_removed"] == 0

    from addon.results.blend import open_blend
    from addon.results.present import results_collection
    from addon.stage.ownership import find_stage, staged_options
    from addon.stage.readback import plan_of

    open_blend(out / "scanstage.blend")
    scene = bpy.context.scene
    assert staged_options(find_stage(scene))["views"] == 8 and len(plan_of(scene).frames) == 8 and scene.frame_current == 1
    home = results_collection(scene)
    assert home.hide_render and [shown.name for shown in home.objects] == ["Result"]
    assert {"Comparison Truth", "Comparison Result", "Comparison Error"} <= set(home.children["Comparison"].objects.keys())
    assert len(home.objects[0].data.polygons) == report["result"]["counts"]["quads"]
    # Run again it keeps the pictures; another object in the same folder is not mixed with this one.
    status, _, error = run("demo", "--out", out, "--set", "views=8", "--set", "voxels=48", "--set", "object=knot", "--quiet")
    assert status == 1 and "capture: holds a capture of another plan" in error


# --- in a process of its own -------------------------------------------------------------------------------------------------

def started(*arguments, **options) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, str(SCRIPT), *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            text=True, encoding="utf-8", **options)


def finished(process: subprocess.Popen) -> tuple[int, str, str]:
    out, error = process.communicate(timeout=120)
    return process.returncode, out, error


def test_the_script_answers_from_any_folder(tmp_path):
    status, out, error = finished(started("methods", cwd=tmp_path))
    assert (status, error) == (0, "") and out.startswith("visual-hull: ")


@pytest.mark.parametrize(("arguments", "status", "line"), [(("evaluate", "nothing"), 1, "scanstage: error: nothing/result.json: "),
                                                           (("fly",), 2, "usage: scanstage ")])
def test_the_script_ends_with_the_status(tmp_path, arguments, status, line):
    found, out, error = finished(started(*arguments, cwd=tmp_path))
    assert (found, out) == (status, "") and error.startswith(line)


@POSIX
def test_a_reader_that_has_seen_enough_is_no_error(tmp_path):
    with started("methods", cwd=tmp_path) as process:
        process.stdout.close()
        assert (process.stderr.read(), process.wait(120)) == ("", 0)


def test_nothing_that_blender_prints_reaches_stdout(capture, tmp_path, monkeypatch):
    """Into a pipe C's own printing is buffered, and could come out long after the verb; with OCIO set, Blender prints at once.

    What Blender itself says on stderr (that a bare system has no list of file systems, say) is its own affair.
    """
    import bpy

    monkeypatch.setenv("OCIO", str(Path(bpy.utils.resource_path('LOCAL')) / "datafiles" / "colormanagement" / "config.ocio"))
    result, truth = tmp_path / "result", tmp_path / "truth.obj"
    truth.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    assert finished(started("reconstruct", capture, "visual-hull", "--out", result, "--voxels", 12, "--quiet"))[::2] == (0, "")
    status, out, error = finished(started("evaluate", result, "--truth", truth, "--set", "samples=200", "--quiet"))
    assert status == 0 and "scanstage" not in error and all(line.startswith(("  volume.", "  surface.")) for line in out.splitlines())
    status, out, error = finished(started("mesh", result, "--out", tmp_path / "ball.obj", "--quiet"))
    assert status == 0 and "scanstage" not in error and out.startswith(f"{tmp_path / 'ball.obj'}: ") and out.count("\n") == 1


@POSIX
def test_ctrl_c_is_130_and_leaves_no_result(capture, tmp_path):
    def listening():  # a shell that starts this in the background may have turned the signal off
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    process = started("reconstruct", capture, "visual-hull", "--out", tmp_path / "result", "--voxels", 512, preexec_fn=listening)
    assert process.stderr.readline().startswith("Silhouette ")
    process.send_signal(signal.SIGINT)
    status, out, error = finished(process)
    assert (status, out) == (130, "") and error.splitlines()[-1].startswith("scanstage: interrupted")
    assert not list(tmp_path.iterdir())


def test_patterns_writes_pictures_for_a_real_projector(run, tmp_path):
    status, out, _ = run("patterns", "gray-code", "--out", tmp_path / "shown", "--size", 32, 16, "--set", "axes=columns", "--quiet")
    assert status == 0 and out == f"{tmp_path / 'shown'}: 12 patterns of gray-code\n"
    assert len(list((tmp_path / "shown").glob("pattern-*.png"))) == 12
    status, _, err = run("patterns", "grey-code", "--out", tmp_path / "other", "--quiet")
    assert status == 1 and "there is no pattern set 'grey-code'" in err and not (tmp_path / "other").exists()
