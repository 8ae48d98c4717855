# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of the work that need no Blender, from folder to folder: operators and command-line verbs call these.

(The steps that do need Blender are `addon.stage`, `addon.render` and `addon.results`.)
"""

from __future__ import annotations

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
from .reconstruction.silhouettes import SILHOUETTE_OPTIONS
from .results.folder import REPORT, Result, check_replaceable, read_result, report_section, write_result
from .results.ply import read_ply


def reconstruct_options(method: str) -> tuple[Option, ...]:
    """Return every option that `reconstruct` takes with a method: the method's and those of the silhouettes."""
    entry = methods.find_method(method)
    return entry.options + (SILHOUETTE_OPTIONS if "silhouettes" in entry.needs else ())


def reconstruct(capture: Path, method: str, out: Path, *, voxels: int = methods.DEFAULT_VOXELS, bounds: np.ndarray | None = None,
                options: Mapping[str, Value] | None = None, progress: Progress = silent) -> dict:
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

    Returns
    -------
    dict
        The report, as in ``result.json``: that of `methods.reconstruct`, with ``capture``, and with the silhouette's options
        that were not left to the capture set.

    Raises
    ------
    ScanstageError
        An option, the capture set or the place for the result cannot be used: no folder is then written.
    """
    _check_place(out, capture)
    own, silhouette = _divided(method, options or {})
    own = methods.check_call(method, voxels=voxels, bounds=bounds, options=own)
    if own.get("rule") == "center":
        silhouette.setdefault("conservative", False)  # the rule is unbiased only with masks that are
    scan = load_scan(capture, silhouette, part_of(progress, 0.0, 0.2), silhouettes="silhouettes" in methods.METHODS[method].needs)
    found = methods.reconstruct(scan, method, voxels=voxels, bounds=bounds, options=own, progress=part_of(progress, 0.2, 0.9))
    progress(0.92, "Writing the result")
    report = {**found.report, "capture": str(Path(capture).resolve()), "silhouette": silhouette}
    up = upward([view.camera for view in scan.views])
    preview = render_preview(found.surface, found.volume.grid, found.colors.rgb, up=up)
    write_result(out, volume=found.volume, surface=found.surface, colors=found.colors, report=report, preview=preview,
                 layers=found.layers, pictures=found.pictures, points=found.points)
    progress(1.0, "Result written")
    return report


def _check_place(out: Path, capture: Path) -> None:
    check_replaceable(out)
    if Path(capture).resolve().is_relative_to(Path(out).resolve()):  # an older result there goes, with all that is in it
        raise ScanstageError(f"{out}: holds the capture set and would be replaced; name another folder for the result")


def _divided(method: str, options: Mapping[str, Value]) -> tuple[dict[str, Value], dict[str, Value]]:
    """Return the options that are the method's, as given, and those of the silhouettes, checked."""
    entry = methods.find_method(method)
    known = {option.name: option for option in reconstruct_options(method)}
    if unknown := options.keys() - known.keys():
        raise ScanstageError(f"method {method} has no option {min(unknown)!r}; its options are: {', '.join(known)}")
    own = {option.name for option in entry.options}
    others = [known[name] for name in options if name not in own]
    return ({name: value for name, value in options.items() if name in own},
            resolve(others, {option.name: options[option.name] for option in others}, "silhouette"))


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
    measures = evaluate(result.volume, result.surface, truth, points=result.points, progress=progress, **values)
    report_section(folder, "evaluation", measures)
    return measures


def truth_of(result: Result) -> TriangleMesh:
    """Return the true object that the result's capture set holds.

    Raises
    ------
    ScanstageError
        The capture set is gone, or holds no truth (photographs do not).
    """
    folder = result.report.get("capture")
    if not isinstance(folder, str) or not is_capture(Path(folder)):
        raise ScanstageError(f"{result.folder / REPORT}: capture: there is no capture set at {str(folder)[:200]!r}; name a mesh "
                             "with --truth")
    folder = Path(folder)
    capture = read_capture(folder, require_pictures=False)
    if capture.truth_mesh is None:
        raise ScanstageError(f"{folder / FILE_NAME}: truth is null: photographs have none; name a mesh with --truth")
    return read_ply(folder / capture.truth_mesh)
