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
from .captures.store import read_capture
from .errors import ScanstageError
from .options import Option, Value, resolve
from .progress import Progress, part_of, silent
from .reconstruction import methods
from .reconstruction.evaluation import OPTIONS as EVALUATION_OPTIONS
from .reconstruction.evaluation import evaluate
from .reconstruction.mesh import TriangleMesh
from .reconstruction.preview import render_preview
from .reconstruction.silhouettes import SILHOUETTE_OPTIONS
from .results.folder import Result, check_replaceable, read_result, report_section, write_result
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
        The report, as in ``result.json``.
    """
    check_replaceable(out)
    entry, options = methods.find_method(method), dict(options or {})
    known = {option.name for option in reconstruct_options(method)}
    if unknown := options.keys() - known:
        raise ScanstageError(f"method {method} has no option {min(unknown)!r}; its options are: {', '.join(sorted(known))}")
    own = {option.name for option in entry.options}
    silhouette = {name: value for name, value in options.items() if name not in own}
    if options.get("rule") == "center":
        silhouette.setdefault("conservative", False)  # the rule is unbiased only with masks that are
    scan = load_scan(capture, silhouette, part_of(progress, 0.0, 0.2))
    found = methods.reconstruct(scan, method, voxels=voxels, bounds=bounds, progress=part_of(progress, 0.2, 0.9),
                                options={name: value for name, value in options.items() if name in own})
    progress(0.92, "Writing the result")
    report = {**found.report, "capture": str(Path(capture).resolve()), "silhouette": silhouette}
    preview = render_preview(found.surface, found.volume.grid, found.colors.rgb)
    write_result(out, volume=found.volume, surface=found.surface, colors=found.colors, report=report, preview=preview)
    progress(1.0, "Done")
    return report


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
        ``volume`` and ``surface``, as the design names them.
    """
    result = read_result(folder)
    truth = truth or truth_of(result)
    values = resolve(EVALUATION_OPTIONS, options or {}, "evaluate")
    measures = evaluate(result.volume, result.surface, truth, progress=progress, **values)
    report_section(folder, "evaluation", measures)
    return measures


def truth_of(result: Result) -> TriangleMesh:
    """Return the true object that the result's capture set holds.

    Raises
    ------
    ScanstageError
        The capture set is gone, or holds no truth (photographs do not).
    """
    folder = Path(result.report["capture"])
    capture = read_capture(folder, require_pictures=False)
    if capture.truth_mesh is None:
        raise ScanstageError(f"{folder / FILE_NAME}: truth is null: photographs have none; name a mesh with --truth")
    return read_ply(folder / capture.truth_mesh)
