# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Built-in objects for experiments, and what comes out for them, in millimetres."""

from turntable_captures import rendered

from addon.reconstruction.evaluation import evaluate

VIEWS = 72  # rendered once; fewer are taken out of them
MM = 1000.0  # in a metre, the scene's unit
MEASURES = {"truth_voxels_removed": "truth voxels removed", "excess": "excess", "loss": "loss", "accuracy_90": "accuracy 90 %, mm",
            "chamfer": "chamfer, mm", "hausdorff": "hausdorff, mm"}
"""What `errors` finds, and how tables call it."""


def captured(out, name, progress):
    """Return the scan of a built-in object in `VIEWS` poses, and the truth. See `turntable_captures.rendered`."""
    return rendered(name, out / "captures" / name, progress, VIEWS)


def errors(found, truth):
    """Compare a `methods.Reconstruction` with the truth; return a number for each of `MEASURES`, lengths in mm.

    See `evaluation.volume_measures` and `evaluation.surface_measures`.
    """
    measures = evaluate(found.volume, found.surface, truth)
    lengths = {name: measures["surface"][name] * MM for name in ("accuracy_90", "chamfer", "hausdorff")}
    return {name: value for name, value in {**measures["volume"], **lengths}.items() if name in MEASURES}
