# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of depth sensors and of two cameras without a projector, for `figures.py`."""

import math
import sys
import tempfile
from pathlib import Path

import scanstage
from session import told
from tables import print_head, print_line

ROOT = Path(__file__).resolve().parents[1]
DEPTHS = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
STEP, SIGMA, SLOPE, FILLED, SHADOW = 0.05, 1.2, 0.15, 0.97, 2.0
"""Of methods.md, section 5: how far steps may be off, sigma's share of the table's, the slope's distance from 2, the share of a
matte wall that is filled, and by how many pixels the projector's shadow may differ from the formula."""
OBJECT, VIEWS, VOXELS = "dented-sphere", 8, 128
RIGS = {"stereo": ("stereo-pair", {}), "color-stripes": ("color-stripes", {"resolution_x": 1280, "resolution_y": 960}),
        "speckle": ("depth-sensor", {})}
PLAIN = "matte, without texture"


def speckle(bar):
    """Print what a depth sensor tells of a wall at several depths; return how many figures are missed."""
    import numpy as np

    for name in ("rigs", "projection", "depth_sensors"):
        scanstage.load(f"tests.{name}", ROOT / "tests" / f"{name}.py")
    sensors = sys.modules["tests.depth_sensors"]
    print_head("depth, m", "step, mm", "of the table's", "sigma, mm", "of the table's, at most 1.2", "filled, at least 0.97")
    missed, sigmas = 0, []
    for depth in DEPTHS:
        bar(0.0, f"speckle at {depth:g} m")
        found, quantum = sensors.depth_sensor(depth), sensors.QUANTUM * depth ** 2
        bar.close()
        step, sigma = found.step / quantum, found.sigma / (quantum / 2)
        sigmas.append(found.sigma)
        missed += (abs(step - 1) > STEP) + (sigma > SIGMA) + (found.filled < FILLED)
        print_line(depth, 1000 * found.step, f"{step:.3f}", 1000 * found.sigma, f"{sigma:.2f}", f"{found.filled:.4f}")
    slope = float(np.polyfit(np.log(DEPTHS), np.log(sigmas), 1)[0])
    measured, formula = sensors.sensor_shadow()
    print(f"\nslope of log sigma over log depth: {slope:.2f} (2 +- {SLOPE}); shadow of the projector: {measured:.1f} px, by the formula "
          f"{formula:.1f} (+- {SHADOW:g})")
    return missed + (abs(slope - 2) > SLOPE) + (abs(measured - formula) > SHADOW)


def stereo(bar):
    """Print what two cameras tell of the dented sphere with its texture and without, beside projectors; return how many fail."""
    print_head("surface", "method", "frames", "silhouette measured", "median error, mm", "90 % within, mm", "completeness",
               "what the report says")
    missed, shares = 0, {}
    for surface in ("textured", PLAIN):
        for method, (preset, options) in RIGS.items():
            row, said = _measured(method, preset, options, surface == PLAIN, told(bar, f"{method}, {surface}"))
            bar.close()
            shares[method, surface] = row[1]
            print_line(surface, method, *row, said)
    missed += shares["stereo", PLAIN] > 0.5 * shares["stereo", "textured"]  # little to match but shading
    missed += shares["stereo", "textured"] < 0.5
    missed += shares["speckle", PLAIN] < 0.5 or math.isnan(shares["color-stripes", PLAIN])
    return missed


def _measured(method, preset, options, plain, progress):
    """Return frames, share of the silhouettes' pixels with a point, errors in mm and completeness; and a sentence of the report."""
    import numpy as np
    from turntable_captures import rendered, without_texture

    from addon.captures.store import read_capture
    from addon.errors import ScanstageError
    from addon.reconstruction import methods
    from addon.reconstruction.evaluation.measures import point_measures

    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        scan, truth = rendered(OBJECT, Path(folder), progress, VIEWS, preset, options, change=without_texture if plain else None)
        frames = len(read_capture(Path(folder)).frames)
        area = sum(int(np.count_nonzero(view.mask)) for view in scan.views)
        try:
            found = methods.reconstruct(scan, method, voxels=VOXELS, progress=progress)
        except ScanstageError as error:
            return (frames, 0.0, None, None, None), str(error)
        measures = point_measures(found.points, truth)
    warnings = found.report["warnings"]
    return (frames, len(found.points) / area, 1000 * measures["median"], 1000 * measures["accuracy_90"],
            measures["completeness"]), warnings[0] if warnings else ""


TABLES = {"speckle": speckle, "stereo": stereo}
