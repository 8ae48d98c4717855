# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Prints the figures that the project promises, as tables, from renders and photographs made into captures on the spot.

    python3 scripts/figures.py objects         every built-in object at 8, 24 and 72 views: what is lost, what is too much
    python3 scripts/figures.py photographs     two sets of photographs: how well the hull fits the masks
    python3 scripts/figures.py                 both

Exit status 1 if a figure is missed. The photographs, which are not part of the project, are looked for in the folder that
SCANSTAGE_DATA names; without them that table is left out. It makes its own environment on first use.
"""

import argparse
import importlib.util
import os
import sys
import tempfile
from pathlib import Path

import environment
import scanstage

ROOT = Path(__file__).resolve().parents[1]
MOST_VIEWS, OBJECT_VOXELS = 72, 128
VIEWS = (8, 24, MOST_VIEWS)
SETS = (  # name, folder, format, options, the least mean IoU
    ("squirrel", "turntable_squirrel", "opencv", {}, 0.95),
    ("dinosaur", "dino_sparse_ring", "middlebury", {}, 0.97),
)
PHOTOGRAPH_VOXELS = 256


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="?", choices=["objects", "photographs", "all"], default="all")
    call = parser.parse_args()
    if importlib.util.find_spec("bpy") is None:
        return run_in_environment()
    scanstage.load("addon", ROOT / "addon" / "__init__.py")
    import bpy  # before OpenCV: both bring libraries of their own

    from addon.errors import ScanstageError

    print(f"Blender {bpy.app.version_string}", file=sys.stderr)
    try:
        missed = objects() if call.table in ("objects", "all") else 0
        missed += photographs() if call.table in ("photographs", "all") else 0
    except ScanstageError as error:
        print(f"figures: error: {error}", file=sys.stderr)
        return 1
    return int(missed > 0)


def run_in_environment():
    try:
        python = environment.prepare()
    except environment.SetupError as error:
        print(f"figures: error: {error}", file=sys.stderr)
        return 1
    sys.stderr.flush()
    os.execv(python, [str(python), __file__, *sys.argv[1:]])


def objects():
    """Print the table of the built-in objects, rendered and carved conservatively; return how many rows lost a voxel."""
    from addon.reconstruction import methods
    from addon.reconstruction.evaluation.measures import volume_measures
    from addon.reconstruction.scan import Scan
    from addon.stage.objects import BUILTINS

    row("object", "views", "truth_voxels_removed", "excess", "loss", "IoU", "mean silhouette IoU")
    row(*["---"] * 7)
    missed = 0
    for name in BUILTINS:
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            scan, truth = rendered(name, Path(folder), told(name))
            for count in VIEWS:  # the poses of a table in 72 steps are also those of 24 and 8
                part = Scan(scan.views[::MOST_VIEWS // count])
                found = methods.reconstruct(part, "visual-hull", voxels=OBJECT_VOXELS, progress=told(name))
                measures = volume_measures(found.volume, truth)
                missed += measures["truth_voxels_removed"] > 0
                row(name, count, measures["truth_voxels_removed"], f"{measures['excess']:.4f}", f"{measures['loss']:.2g}",
                    f"{measures['iou']:.4f}", f"{found.report['silhouette_iou']['mean']:.4f}")
    return missed


def rendered(name, folder, progress):
    """Capture a built-in object on the turntable; return its scan and the truth."""
    import bpy

    from addon.captures.scan import load_scan
    from addon.cli.progress_bar import drain, muted_stdout
    from addon.render.capture import TRUTH, capture_frames
    from addon.results.blend import new_file
    from addon.results.ply import read_ply
    from addon.stage.staging import build

    with muted_stdout():
        new_file()
        build(bpy.context.scene, "turntable", name, {"views": MOST_VIEWS})
        drain(capture_frames(bpy.context.scene, folder), progress)
    return load_scan(folder, progress=progress), read_ply(folder / TRUTH)


def photographs():
    """Print the table of the photographs, carved by the centre rule; return how many figures are missed."""
    from addon.captures.importers import import_capture
    from addon.workflow import reconstruct

    data = Path(os.environ.get("SCANSTAGE_DATA", ROOT.parent / "shared" / "data"))
    there = [entry for entry in SETS if (data / entry[1]).is_dir()]
    for entry in SETS:
        if entry not in there:
            print(f"figures: {entry[0]}: not run, {data / entry[1]} is not there; set SCANSTAGE_DATA", file=sys.stderr)
    if not there:
        return 0
    row("photographs", "mean silhouette IoU", "at least", "")
    row(*["---"] * 4)
    missed = 0
    for name, source, format, options, least in there:
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            capture, result = Path(folder) / "capture", Path(folder) / "result"
            import_capture(format, data / source, capture, options, told(name))
            report = reconstruct(capture, "visual-hull", result, voxels=PHOTOGRAPH_VOXELS, options={"rule": "center"},
                                 progress=told(name))
        found = report["silhouette_iou"]["mean"]
        missed += found < least
        row(name, f"{found:.4f}", least, "missed" if found < least else "reached")
    return missed


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def told(name):
    """Return a progress callback that says on stderr what is being worked on."""
    from addon.cli.progress_bar import ProgressBar

    bar = ProgressBar()

    def progress(fraction, message):
        bar(fraction, f"{name}: {message}")
        if fraction >= 1:
            bar.close()

    return progress


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # Blender's own shutdown may print to stdout
