# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The verbs. Each reads its arguments, calls one function of the project, and says what came of it.

Modules that import Blender are imported where a verb needs them, so that the others answer at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..calibration import OPTIONS as CALIBRATION_OPTIONS
from ..calibration import calibrate
from ..captures.exporters import EXPORTERS, export_capture
from ..captures.exporters import OPTIONS as EXPORT_OPTIONS
from ..captures.importers import IMPORTERS as FORMATS
from ..captures.importers import import_capture
from ..captures.pattern_files import write_patterns
from ..captures.schema import ENCODINGS
from ..errors import ScanstageError
from ..options import Option, resolve
from ..progress import Progress
from ..reconstruction.active.patterns import PATTERN_SETS, make_patterns
from ..reconstruction.methods import DEFAULT_VOXELS, METHODS, check_spread
from ..workflow import evaluate_result, reconstruct, reconstruct_options
from .progress_bar import drain
from .text import calibration_lines, measure_lines, option_lines, reconstruction_lines

DEFAULT_OBJECT = "dented-sphere"
DEFAULT_PROJECTOR = (1280, 720)


@dataclass(frozen=True)
class Verb:
    """One verb: what it adds to its parser, what it does, and what its help ends with (a callable where that takes Blender).

    ``run(call, progress)`` returns the report; its ``lines`` go to stdout.
    """

    help: str
    arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Progress], dict]
    epilog: str | Callable[[], str] = ""


def _demo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", metavar="DIR", default="demo", type=Path, help="where to leave everything (default: demo)")


def _demo(call: argparse.Namespace, progress: Progress) -> dict:
    from .demo import run_demo

    return run_demo(call.out, dict(call.settings), progress)


def _stage_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("preset", metavar="PRESET", help="a rig; `presets` lists them")
    parser.add_argument("--out", metavar="FILE.blend", required=True, type=Path)
    parser.add_argument("--object", metavar="NAME or FILE", default=DEFAULT_OBJECT,
                        help=f"a built-in object (`presets` lists them) or a mesh file (default: {DEFAULT_OBJECT})")
    parser.add_argument("--coverage", action="store_true", help="also tell what share of the object's surface the rig misses")


def _stage(call: argparse.Namespace, progress: Progress) -> dict:
    import bpy

    from ..results.blend import frame_scene, new_file, save_blend
    from ..stage.fingerprint import stamp
    from ..stage.readback import plan_of
    from ..stage.staging import build
    from ..stage.survey import survey

    new_file()
    progress(0.1, "Building the stage")
    build(bpy.context.scene, call.preset, call.object, dict(call.settings))
    plan = plan_of(bpy.context.scene)
    missed = survey(bpy.context.scene).summary() if call.coverage else {}
    frame_scene(bpy.context.scene)
    stamp(bpy.context.scene)
    save_blend(call.out)
    return {"file": str(call.out), "frames": len(plan.frames), "cameras": len(plan.cameras), **({"coverage": missed} if missed else {}),
            "lines": [f"{call.out}: {call.preset}, {len(plan.frames)} frames, {len(plan.cameras)} camera(s)",
                      *(f"{name}: {value:.4g}" for name, value in missed.items() if value is not None)]}


def _capture_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE.blend", type=Path, help="a staged scene")
    parser.add_argument("--out", metavar="CAPTURE", required=True, type=Path, help="the capture set; what is there is kept")
    parser.add_argument("--frames-from", metavar="DIR", type=Path, help="take in the frames that a render farm has written there")
    _scheduler_argument(parser)


def _capture(call: argparse.Namespace, progress: Progress) -> dict:
    import bpy

    from ..captures.store import read_capture
    from ..render.capture import capture_frames
    from ..render.farm import FarmFrames
    from ..results.blend import open_blend
    from ..stage.ownership import find_stage

    _no_settings(call, "capture")
    farm = FarmFrames(call.frames_from) if call.frames_from else None
    open_blend(call.file)
    if find_stage(bpy.context.scene) is None:
        raise ScanstageError(f"{call.file}: scene {bpy.context.scene.name!r} has no stage; make a file with "
                             f"`scanstage stage PRESET --out {call.file}`")
    with _workers(call) as workers:
        renderer = workers.renderer(call.file) if workers else None
        drain(capture_frames(bpy.context.scene, call.out, farm=farm, renderer=renderer), progress)
    frames = len(read_capture(call.out).frames)
    return {"capture": str(call.out), "frames": frames, **(farm.report() if farm else {}),
            "lines": [f"{call.out}: {frames} frames, all whole", *(farm.lines() if farm else ())]}


def _import_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("format", metavar="FORMAT", help=", ".join(FORMATS))
    parser.add_argument("source", metavar="SOURCE", type=Path)
    parser.add_argument("--out", metavar="CAPTURE", required=True, type=Path)


def _import(call: argparse.Namespace, progress: Progress) -> dict:
    capture = import_capture(call.format, call.source, call.out, dict(call.settings), progress)
    return {"capture": str(call.out), "frames": len(capture.frames), "lines": [f"{call.out}: {len(capture.frames)} frames"]}


def _export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("format", metavar="FORMAT", help=", ".join(EXPORTERS))
    parser.add_argument("capture", metavar="CAPTURE", type=Path)
    parser.add_argument("--out", metavar="DIR", required=True, type=Path, help="a new or empty folder")


def _export(call: argparse.Namespace, progress: Progress) -> dict:
    count = export_capture(call.format, call.capture, call.out, dict(call.settings), progress)
    return {"folder": str(call.out), "pictures": count, "lines": [f"{call.out}: {count} pictures with their cameras"]}


def _calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", metavar="CAPTURE", type=Path, help="a capture set with frames of a calibration board")
    parser.add_argument("--out", metavar="CAPTURE", required=True, type=Path, help="the same set with calibrated devices")


def _calibrate(call: argparse.Namespace, progress: Progress) -> dict:
    report = calibrate(call.capture, call.out, options=dict(call.settings), progress=progress)
    return {**report, "lines": calibration_lines(call.out, report)}


def _patterns_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("set", metavar="SET", help=", ".join(PATTERN_SETS))
    parser.add_argument("--out", metavar="DIR", required=True, type=Path, help="for the pictures: a new or empty folder")
    parser.add_argument("--size", metavar=("WIDTH", "HEIGHT"), nargs=2, type=int, default=DEFAULT_PROJECTOR,
                        help="of the projector in pixels (default: {} {})".format(*DEFAULT_PROJECTOR))
    parser.add_argument("--encoding", choices=ENCODINGS, default="srgb",
                        help="how the projector turns values into light (default: srgb, as screens do)")


def _patterns(call: argparse.Namespace, progress: Progress) -> dict:
    made = make_patterns(call.set, tuple(call.size), dict(call.settings))
    write_patterns(call.out, made, encoding=call.encoding, progress=progress)
    return {"folder": str(call.out), "patterns": len(made), "lines": [f"{call.out}: {len(made)} patterns of {call.set}"]}


def _pattern_sets() -> str:
    """Return the pattern sets with their options, for the end of the help."""
    lines = ["pattern sets:"]
    for name, entry in PATTERN_SETS.items():
        lines += [f"  {name}: {entry.description}", *(f"  {line}" for line in option_lines(entry.options))]
    return "\n".join(lines).replace("%", "%%")


def _reconstruct_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", metavar="CAPTURE", type=Path)
    parser.add_argument("method", metavar="METHOD", help=", ".join(METHODS))
    parser.add_argument("--out", metavar="RESULT", required=True, type=Path)
    parser.add_argument("--voxels", metavar="N", type=int, default=DEFAULT_VOXELS,
                        help=f"along the longest side of the bounds (default: {DEFAULT_VOXELS})")
    parser.add_argument("--bounds", metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"), nargs=6, type=float,
                        help="the working volume in the object frame (default: found from the views)")
    _scheduler_argument(parser)


def _reconstruct(call: argparse.Namespace, progress: Progress) -> dict:
    bounds = None if call.bounds is None else np.reshape(call.bounds, (2, 3))
    if call.scheduler:
        check_spread(call.method)
    with _workers(call) as workers:
        report = reconstruct(call.capture, call.method, call.out, voxels=call.voxels, bounds=bounds, options=dict(call.settings),
                             workers=workers, progress=progress)
    return {**report, "lines": reconstruction_lines(call.out, report)}


def _evaluate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("result", metavar="RESULT", type=Path)
    parser.add_argument("--truth", metavar="MESH", type=Path, help="in the object frame (default: the capture set's)")
    parser.add_argument("--page", metavar="FILE.html", type=Path, help="also write all that the result says as one page for any browser")


def _evaluate(call: argparse.Namespace, progress: Progress) -> dict:
    from ..results.meshes import read_mesh
    from ..results.page import write_page

    truth = read_mesh(call.truth) if call.truth else None
    measures = evaluate_result(call.result, truth, options=dict(call.settings), progress=progress)
    if call.page:
        write_page(call.result, call.page)
    return {**measures, "lines": measure_lines(measures)}


def _mesh_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("result", metavar="RESULT", type=Path, help="a result's folder, or a volume as .npz or .vox")
    parser.add_argument("--out", metavar="FILE", required=True, type=Path, help="the ending chooses the format")


def _endings() -> str:
    """Return the files that `mesh` writes, with its options, for the end of the help."""
    from ..results.export import EXPORT_OPTIONS, FORMATS

    return "\n".join(["files, by their endings:", *(f"  {ending}: {entry.description}" for ending, entry in FORMATS.items()), "options:",
                      *option_lines(EXPORT_OPTIONS)])


def _mesh(call: argparse.Namespace, progress: Progress) -> dict:
    from ..results.export import EXPORT_OPTIONS, export_result

    settings = dict(call.settings)
    count = export_result(call.result, call.out, settings, progress)
    what = "points" if resolve(EXPORT_OPTIONS, settings, "mesh")["points"] else "faces"
    return {"file": str(call.out), what: count, "lines": [f"{call.out}: {count} {what}"]}


def _view_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", metavar="CAPTURE", type=Path)
    parser.add_argument("--out", metavar="FILE.blend", required=True, type=Path)
    parser.add_argument("--result", metavar="RESULT", type=Path, help="a result's folder, whose mesh is put among the cameras")


def _view(call: argparse.Namespace, progress: Progress) -> dict:
    import bpy

    from ..results.blend import frame_scene, new_file, save_blend
    from ..results.cameras import show_cameras
    from ..results.folder import read_result
    from ..results.present import show_result

    _no_settings(call, "view")
    result = None if call.result is None else read_result(call.result)
    new_file()
    progress(0.3, "Placing the cameras")
    warnings = show_cameras(bpy.context.scene, call.capture)
    if result is not None:
        show_result(bpy.context.scene, result)
    frame_scene(bpy.context.scene)
    save_blend(call.out)
    count = sum(member.type == 'CAMERA' for member in bpy.context.scene.objects)
    return {"file": str(call.out), "cameras": count, "warnings": warnings,
            "lines": [f"{call.out}: {count} camera(s), each with its picture", *(f"  warning: {warning}" for warning in warnings)]}


def _methods(call: argparse.Namespace, progress: Progress) -> dict:
    _no_settings(call, "methods")
    lines, report = [], {}
    for name, method in METHODS.items():
        options = reconstruct_options(name)
        lines += [f"{name}: {method.description} (needs {', '.join(method.needs)})", *option_lines(options), ""]
        report[name] = {"label": method.label, "description": method.description, "needs": method.needs,
                        "options": _option_report(options)}
    return {"methods": report, "lines": lines[:-1]}


def _presets(call: argparse.Namespace, progress: Progress) -> dict:
    from ..stage.objects import BUILTINS, IMPORTERS
    from ..stage.presets import PRESETS

    _no_settings(call, "presets")
    lines, report = [], {}
    for name, preset in PRESETS.items():
        lines += [f"{name}: {preset.description}", *option_lines(preset.options), ""]
        report[name] = {"label": preset.label, "description": preset.description, "options": _option_report(preset.options)}
    lines.append(f"objects (--object), or a file ({' '.join(IMPORTERS)}):")
    lines += [f"  {name}: {builtin.description}" for name, builtin in BUILTINS.items()]
    return {"presets": report, "objects": list(BUILTINS), "lines": lines}


def _scheduler_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scheduler", metavar="ADDRESS", help="let a scheduler's workers do it (docs/farms.md); from a clone only")


def _workers(call: argparse.Namespace) -> AbstractContextManager:
    """Return a context manager that gives the workers of a call's scheduler, or None."""
    if not call.scheduler:
        return nullcontext()
    if call.cluster is None:
        raise ScanstageError("--scheduler: needs dask, which the extension does not bring; use scripts/scanstage.py of a clone")
    return call.cluster.connect(call.scheduler)


def _no_arguments(parser: argparse.ArgumentParser) -> None:
    """Verbs that only list take no argument of their own."""


def _no_settings(call: argparse.Namespace, verb: str) -> None:
    if call.settings:
        raise ScanstageError(f"{verb} has no options, so --set {call.settings[0][0]} means nothing here")


def _option_report(options: Iterable[Option]) -> list[dict]:
    return [{"name": option.name, "default": option.show(option.default), "unit": option.unit.value,
             "choices": list(option.choices or ()), "description": option.description} for option in options]


VERBS = {
    "demo": Verb("the main job end to end: stage, captures, reconstruction, voxel mesh, comparison, a .blend and pictures",
                 _demo_arguments, _demo),
    "stage": Verb("build a rig round an object", _stage_arguments, _stage),
    "capture": Verb("render the plan of a staged scene into a capture set; resumes", _capture_arguments, _capture),
    "import": Verb("turn other people's captures into a capture set", _import_arguments, _import,
                   "formats:\n" + "\n".join(f"  {name}: {entry.description}" for name, entry in FORMATS.items())),
    "export": Verb("write a capture set's pictures and cameras for other programs", _export_arguments, _export,
                   "\n".join(["formats:", *(f"  {name}: {entry.description}" for name, entry in EXPORTERS.items()), "options:",
                              *option_lines(EXPORT_OPTIONS)])),
    "calibrate": Verb("calibrate cameras, projectors and turntable from a capture set's frames of a board", _calibrate_arguments,
                      _calibrate, "options:\n" + "\n".join(option_lines(CALIBRATION_OPTIONS))),
    "patterns": Verb("write a set of patterns as pictures for a real projector", _patterns_arguments, _patterns, _pattern_sets()),
    "reconstruct": Verb("run one method on a capture set", _reconstruct_arguments, _reconstruct),
    "evaluate": Verb("compare a result with the truth", _evaluate_arguments, _evaluate),
    "mesh": Verb("write a result's mesh, voxels or points as a file for other programs", _mesh_arguments, _mesh, _endings),
    "view": Verb("put a capture set's cameras into a .blend, each with its picture behind it", _view_arguments, _view),
    "methods": Verb("list the methods with their options, units and defaults", _no_arguments, _methods),
    "presets": Verb("list the rigs with their options, and the built-in objects", _no_arguments, _presets),
}
