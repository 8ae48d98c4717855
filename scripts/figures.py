# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Prints the figures that the project promises, as tables: what the visual hull loses, adds and explains.

    python3 scripts/figures.py objects         every built-in object, rendered at 8, 24 and 72 views (minutes)
    python3 scripts/figures.py photographs     two sets of photographs: how well the hull fits their masks
    python3 scripts/figures.py                 both

    python3 scripts/figures.py held-back       methods of colour: what a camera that took no part sees (minutes)
    python3 scripts/figures.py losses          what they lose of the object
    python3 scripts/figures.py bowl            how much of a bowl's inside they recover (minutes)
    python3 scripts/figures.py consistency     how well each photo-consistency measure tells a surface from thin air
    python3 scripts/figures.py color-photographs    the photographs by space carving and generalized voxel coloring
    python3 scripts/figures.py colour          all five

Exit status 1 if a figure is missed. The photographs are not part of the project: they are looked for in the folder that
SCANSTAGE_DATA names, and a set that is not there is left out. It makes its own environment on first use.
"""

import argparse
import importlib.util
import os
import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path

import color_figures
import environment
import scanstage

ROOT = Path(__file__).resolve().parents[1]
VIEWS = (8, 24, 72)
OBJECT_VOXELS, PHOTOGRAPH_VOXELS = 128, 256
SETS = (  # name, folder, import format, least mean IoU
    ("squirrel", "turntable_squirrel", "opencv", 0.95),
    ("dinosaur", "dino_sparse_ring", "middlebury", 0.97),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = {"objects": [objects], "photographs": [photographs], "both": [objects, photographs]}
    colour = {name: partial(function, sys.modules[__name__]) for name, function in color_figures.TABLES.items()}
    tables |= {name: [print_table] for name, print_table in colour.items()} | {"colour": list(colour.values())}
    parser.add_argument("table", nargs="?", choices=tables, default="both")
    call = parser.parse_args()
    if importlib.util.find_spec("bpy") is None:
        return run_in_environment()
    scanstage.load("addon", ROOT / "addon" / "__init__.py")
    import bpy  # before OpenCV: both bring libraries of their own

    from addon.cli.progress_bar import ProgressBar
    from addon.errors import ScanstageError

    print(f"Blender {bpy.app.version_string}", file=sys.stderr)
    bar = ProgressBar()
    try:
        return int(sum(print_table(bar) for print_table in tables[call.table]) > 0)
    except ScanstageError as error:
        bar.close()
        print(f"figures: error: {error}", file=sys.stderr)
        return 1
    finally:
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)  # Blender's own, which the end below would leave behind


def run_in_environment():
    try:
        command = [str(environment.prepare()), str(Path(__file__).resolve()), *sys.argv[1:]]
    except environment.SetupError as error:
        print(f"figures: error: {error}", file=sys.stderr)
        return 1
    os.execv(command[0], command)


def objects(bar):
    """Print the table of the built-in objects, carved conservatively; return how many rows lost voxels of the truth."""
    from addon.reconstruction import methods
    from addon.reconstruction.evaluation.measures import volume_measures
    from addon.reconstruction.scan import Scan
    from addon.stage.objects import BUILTINS

    keys = "truth_voxels_removed", "excess", "loss", "iou"
    table("object", "views", *keys, "mean silhouette IoU")
    missed = 0
    for name in BUILTINS:
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            scan, truth = rendered(name, Path(folder), told(bar, name))
            for views in VIEWS:  # the poses of a turn in 72 steps hold those of one in 24 and in 8
                part = Scan(scan.views[::len(scan.views) // views])
                found = methods.reconstruct(part, "visual-hull", voxels=OBJECT_VOXELS, progress=told(bar, name))
                measures, seen = volume_measures(found.volume, truth), found.report["silhouette_iou"]["mean"]
                missed += measures["truth_voxels_removed"] > 0
                bar.close()
                row(name, views, *(f"{measures[key]:.4g}" for key in keys), f"{seen:.4f}")
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
        build(bpy.context.scene, "turntable", name, {"views": max(VIEWS)})
        drain(capture_frames(bpy.context.scene, folder), progress)
    return load_scan(folder, progress=progress), read_ply(folder / TRUTH)


def photographs(bar):
    """Print the table of the photographs, carved by the centre rule; return how many figures are missed."""
    from addon.captures.importers import import_capture
    from addon.workflow import reconstruct

    data = Path(os.environ.get("SCANSTAGE_DATA", ROOT.parent / "shared" / "data"))
    table("photographs", "mean silhouette IoU", "at least")
    missed = 0
    for name, source, layout, least in SETS:
        if not (data / source).is_dir():
            print(f"figures: {name}: left out, {data / source} is not there; set SCANSTAGE_DATA", file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            capture, result = Path(folder, "capture"), Path(folder, "result")
            import_capture(layout, data / source, capture, progress=told(bar, name))
            report = reconstruct(capture, "visual-hull", result, voxels=PHOTOGRAPH_VOXELS, options={"rule": "center"},
                                 progress=told(bar, name))
        missed += (seen := report["silhouette_iou"]["mean"]) < least
        bar.close()
        row(name, f"{seen:.4f}", least)
    return missed


def table(*titles):
    print()
    row(*titles)
    row(*["---"] * len(titles))


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def told(bar, name):
    return lambda fraction, message: bar(fraction, f"{name}: {message}")


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # Blender's own shutdown may print to stdout
