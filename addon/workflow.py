# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of the work that need no Blender, from folder to folder: operators and command-line verbs call these.

(The steps that do need Blender are `addon.stage`, `addon.render` and `addon.results`.)
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .captures.scan import load_scan
from .captures.schema import FILE_NAME
from .captures.store import is_capture, read_capture
from .errors import ScanstageError
from .options import Option, Value, resolve
from .progress import Progress, part_of, silent
from .reconstruction import methods
from .reconstruction.evaluation import OPTIONS as EVALUATION_OPTIONS
from .reconstruction.evaluation import evaluate
from .reconstruction.mesh import TriangleMesh
from .reconstruction.preview import render_preview, upward
from .reconstruction.shadows import SHADOW_OPTIONS
from .reconstruction.silhouettes import SILHOUETTE_OPTIONS
from .reconstruction.volumetric.polyhedral_hull import Solids
from .results.folder import REPORT, Result, check_replaceable, read_result, report_section, write_result
from .results.ply import read_ply

INPUT_OPTIONS = {"silhouettes": SILHOUETTE_OPTIONS, "lights": SHADOW_OPTIONS}
"""By what a method needs of a capture: the options, where there are any, of how that is taken from the pictures."""


def reconstruct_options(method: str) -> tuple[Option, ...]:
    """Return every option that `reconstruct` takes with a method: the method's and those of what it needs."""
    entry = methods.find_method(method)
    return sum((INPUT_OPTIONS.get(need, ()) for need in entry.needs), entry.options)


def reconstruct(capture: Path, method: str, out: Path, *, voxels: int = methods.DEFAULT_VOXELS, bounds: np.ndarray | None = None,
                options: Mapping[str, Value] | None = None, solids: Solids | None = None, workers: object | None = None,
                progress: Progress = silent) -> dict:
    """Reconstruct a capture set into a result folder.

    Parameters
    ----------
    capture, out : Path
    method : str
    voxels : int
        Along the longest side of the working volume.
    bounds : (2, 3) array, optional
        The working volume in the object frame.
    options : mapping, optional
        See `reconstruct_options`.
    solids : Solids, optional
        For a method that cuts solids, where this is not Blender's main thread; otherwise Blender is asked here.
    workers : object, optional
        See `methods.reconstruct`.

    Returns
    -------
    dict
        The report, as in ``result.json``: that of `methods.reconstruct`, with ``capture``, and with those options of the
        silhouettes and shadows that were given.

    Raises
    ------
    ScanstageError
        An option, the capture set or the place for the result cannot be used: no folder is then written.
    """
    _check_place(out, capture)
    own, inputs = _divided(method, options or {})
    own = methods.check_call(method, voxels=voxels, bounds=bounds, options=own)
    if own.get("rule") == "center":
        inputs["silhouettes"].setdefault("conservative", False)  # the rule is unbiased only with masks that are
    if solids is None and methods.find_method(method).cuts_solids:
        solids = _blender_solids(method)
    scan = load_scan(capture, inputs.get("silhouettes"), part_of(progress, 0.0, 0.2), silhouettes="silhouettes" in inputs,
                     shadow_options=inputs.get("lights"))
    found = methods.reconstruct(scan, method, voxels=voxels, bounds=bounds, options=own, solids=solids, workers=workers,
                                progress=part_of(progress, 0.2, 0.9))
    progress(0.92, "Writing the result")
    report = {**found.report, "capture": _seen_from(out, capture), "silhouette": inputs.get("silhouettes", {}),
              **({"shadows": inputs["lights"]} if "lights" in inputs else {})}
    up = upward([view.camera for view in scan.views])
    preview = render_preview(found.surface, found.volume.grid, found.colors.rgb, up=up)
    write_result(out, volume=found.volume, surface=found.surface, colors=found.colors, report=report, preview=preview,
                 layers=found.layers, pictures=found.pictures, mesh=found.mesh, points=found.points)
    progress(1.0, "Result written")
    return report


def _seen_from(folder: Path, path: Path) -> str:
    """Return a path relative to a folder, so that both can be moved together, with slashes; absolute where there is none."""
    path = Path(path).resolve()
    try:
        return Path(os.path.relpath(path, Path(folder).resolve())).as_posix()
    except ValueError:  # another drive of Windows
        return str(path)


def _blender_solids(method: str) -> Solids:
    try:
        from .results.booleans import solver
    except ModuleNotFoundError as error:
        raise ScanstageError(f"method {method} cuts solids with Blender's solver, and there is no {error.name} in this Python; run it in "
                             "Blender, or by scripts/scanstage.py") from None
    return solver()


def _check_place(out: Path, capture: Path) -> None:
    check_replaceable(out)
    if Path(capture).resolve().is_relative_to(Path(out).resolve()):  # an older result there goes, with all that is in it
        raise ScanstageError(f"{out}: holds the capture set and would be replaced; name another folder for the result")


def _divided(method: str, options: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, dict[str, Value]]]:
    """Return the options that are the method's, as given, and for each of its needs those that are given, checked."""
    entry = methods.find_method(method)
    known = {option.name: option for option in reconstruct_options(method)}
    if unknown := options.keys() - known.keys():
        raise ScanstageError(f"method {method} has no option {min(unknown)!r}; its options are: {', '.join(known)}")
    inputs = {}
    for need in entry.needs:
        chosen = [option for option in INPUT_OPTIONS.get(need, ()) if option.name in options]
        inputs[need] = resolve(chosen, {option.name: options[option.name] for option in chosen}, need)
    taken = {name for values in inputs.values() for name in values}
    return {name: value for name, value in options.items() if name not in taken}, inputs


def evaluate_result(folder: Path, truth: TriangleMesh | None = None, *, options: Mapping[str, Value] | None = None,
                    progress: Progress = silent) -> dict:
    """Compare a result with the truth and note the measures in its ``result.json``.

    Parameters
    ----------
    folder : Path
        A result folder.
    truth : TriangleMesh, optional
        In the object frame; otherwise the one that the result's capture set holds.
    options : mapping, optional
        See `addon.reconstruction.evaluation.OPTIONS`.

    Returns
    -------
    dict
        ``volume`` and ``surface``, as the design names them, and ``points`` where the result has points.

    Raises
    ------
    ScanstageError
        The result, the truth or an option cannot be used.
    """
    values = resolve(EVALUATION_OPTIONS, options or {}, "evaluate")
    result = read_result(folder)
    truth = truth_of(result) if truth is None else truth
    measures = evaluate(result.volume, result.mesh or result.surface, truth, points=result.points, progress=progress, **values)
    report_section(folder, "evaluation", measures)
    return measures


def truth_of(result: Result) -> TriangleMesh:
    """Return the true object that the result's capture set holds.

    Raises
    ------
    ScanstageError
        The capture set is gone, or holds no truth (photographs do not).
    """
    named = result.report.get("capture")
    folder = Path(result.folder).resolve() / named if isinstance(named, str) else None  # an absolute path stays what it is
    if folder is None or not is_capture(folder):
        raise ScanstageError(f"{result.folder / REPORT}: capture: there is no capture set at {str(named)[:200]!r}; name a mesh "
                             "with --truth")
    capture = read_capture(folder, require_pictures=False)
    if capture.truth_mesh is None:
        raise ScanstageError(f"{folder / FILE_NAME}: truth is null: photographs have none; name a mesh with --truth")
    return read_ply(folder / capture.truth_mesh)
