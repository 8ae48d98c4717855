# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Prints the figures that the project promises, as tables: what the visual hull loses, adds and explains.

    python3 scripts/figures.py objects         every built-in object, rendered at 8, 24 and 72 views (minutes)
    python3 scripts/figures.py photographs     two sets of photographs: how well the hull fits their masks
    python3 scripts/figures.py structured-light  Gray code, phase and laser, simulated, and one real scan
    python3 scripts/figures.py calibration     camera, projector and turntable, rendered (minutes), and photographs of a board
    python3 scripts/figures.py                 the first two

    python3 scripts/figures.py held-back       methods of colour: what a camera that took no part sees (minutes)
    python3 scripts/figures.py losses          what they lose of the object
    python3 scripts/figures.py bowl            how much of a bowl's inside they recover (minutes)
    python3 scripts/figures.py consistency     how well each photo-consistency measure tells a surface from thin air
    python3 scripts/figures.py color-photographs    the photographs by space carving and generalized voxel coloring
    python3 scripts/figures.py colour          all five
    python3 scripts/figures.py noise           rendered pictures with noise: probabilities against every hard threshold (minutes)
    python3 scripts/figures.py textureless     an object of one colour: how far probabilities leave the prior
    python3 scripts/figures.py votes           space sweep: points among clutter, found and made up
    python3 scripts/figures.py probability     all three
    python3 scripts/figures.py dents           shadow carving: the dented sphere at 24 views and 4 lights (minutes)
    python3 scripts/figures.py lecture         4 to 72 views and 1 to 8 lights (minutes)
    python3 scripts/figures.py lecture-fine    72 views and 8 lights in large pictures and fine voxels (half an hour)
    python3 scripts/figures.py pit             how far the pot's pit is opened from 25, 45 and 60 degrees (minutes)
    python3 scripts/figures.py adversities     lost shadows, dark paint, a glaze, lights that are not where they are said to be
    python3 scripts/figures.py shadows         all five
    python3 scripts/figures.py stripes         coloured stripes, simulated: edges matched, a rod in front, seven pictures
    python3 scripts/figures.py dynamic-programming    how fast scanlines are matched
    python3 scripts/figures.py speckle         a depth sensor before walls at 0.5 to 5 m
    python3 scripts/figures.py stereo          two cameras beside projectors, with a texture and without (rendered)
    python3 scripts/figures.py desk-shadow     a lamp and a stick: simulated, and a photographed bowl
    python3 scripts/figures.py live-hull       how quickly the hull in the viewport follows a camera

Exit status 1 if a figure is missed. The photographs are not part of the project: they are looked for in the folder that
SCANSTAGE_DATA names, and a set that is not there is left out. It makes its own environment on first use.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

import color_figures
import depth_figures
import desk_figures
import live_hull_figures
import one_shot_figures
import probability_figures
import session
import shadow_figures
from session import told
from tables import print_head, print_line
from turntable_captures import rendered, thinned

ROOT = Path(__file__).resolve().parents[1]
VIEWS = (8, 24, 72)
OBJECT_VOXELS, PHOTOGRAPH_VOXELS = 128, 256
SETS = (  # name, folder, import format, least mean IoU
    ("squirrel", "turntable_squirrel", "opencv", 0.95),
    ("dinosaur", "dino_sparse_ring", "middlebury", 0.97),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = {"objects": [objects], "photographs": [photographs], "both": [objects, photographs],
              "structured-light": [active], "calibration": [calibration]}
    tables |= {name: [print_table] for name, print_table in {**color_figures.TABLES, **probability_figures.TABLES,
                                                              **shadow_figures.TABLES, **one_shot_figures.TABLES,
                                                              **desk_figures.TABLES, **depth_figures.TABLES,
                                                              **live_hull_figures.TABLES}.items()}
    tables |= {"colour": list(color_figures.TABLES.values()), "probability": list(probability_figures.TABLES.values()),
               "shadows": list(shadow_figures.TABLES.values())}
    parser.add_argument("table", nargs="?", choices=tables, default="both")
    call = parser.parse_args()
    return session.run(__file__, lambda bar: int(sum(print_table(bar) for print_table in tables[call.table]) > 0))


def objects(bar):
    """Print the table of the built-in objects, carved conservatively; return how many rows lost voxels of the truth."""
    from addon.reconstruction import methods
    from addon.reconstruction.evaluation.measures import volume_measures
    from addon.stage.objects import BUILTINS

    keys = "truth_voxels_removed", "excess", "loss", "iou"
    print_head("object", "views", *keys, "mean silhouette IoU")
    missed = 0
    for name in BUILTINS:
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            scan, truth = rendered(name, Path(folder), told(bar, name), max(VIEWS))
            for views in VIEWS:
                found = methods.reconstruct(thinned(scan, views), "visual-hull", voxels=OBJECT_VOXELS, progress=told(bar, name))
                measures, seen = volume_measures(found.volume, truth), found.report["silhouette_iou"]["mean"]
                missed += measures["truth_voxels_removed"] > 0
                bar.close()
                print_line(name, views, *(f"{measures[key]:.4g}" for key in keys), f"{seen:.4f}")
    return missed


def photographs(bar):
    """Print the table of the photographs, carved by the centre rule; return how many figures are missed."""
    from addon.captures.importers import import_capture
    from addon.workflow import reconstruct

    data = Path(os.environ.get("SCANSTAGE_DATA", ROOT.parent / "shared" / "data"))
    print_head("photographs", "mean silhouette IoU", "at least")
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
        print_line(name, f"{seen:.4f}", least)
    return missed


def active(bar):
    """Print the table of structured light and the laser; return how many figures are missed."""
    from structured_light_figures import structured_light

    return structured_light(bar, print_head, print_line)


def calibration(bar):
    """Print the table of calibrations; return how many figures are missed."""
    from calibration_figures import rows

    print_head("calibration", "figure", "unit", "target")
    missed = 0
    for what, figure, unit, target, met in rows(lambda name: told(bar, name)):
        missed += not met
        bar.close()
        print_line(what, f"{figure:.3g}", unit, target)
    return missed


if __name__ == "__main__":
    session.end(main())
