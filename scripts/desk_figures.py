# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of the shadow of a stick on a desk: simulated, and a bowl that somebody photographed."""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import scanstage
from session import told
from tables import print_head, print_line

ROOT = Path(__file__).resolve().parents[1]
FRAMES = 240
CONTRAST = 0.1  # of white: the photographs are dim


def desk_shadow(bar):
    """Print the table; return how many figures are missed."""
    print_head("desk shadow", "figure", "unit", "target")
    missed = 0
    for rows in (simulated, photographed):
        for what, figure, unit, target, met in rows(told(bar, "desk shadow")):
            missed += not met
            bar.close()
            print_line(what + ("" if met else " (missed)"), f"{figure:.3g}", unit, target)
    return missed


def simulated(progress):
    """Yield the figures of methods.md, T3a, T3b and T3d."""
    from addon.reconstruction.methods import METHODS
    from addon.reconstruction.scan import Scan

    for name in ("rigs", "desk"):
        scanstage.load(f"tests.{name}", ROOT / "tests" / f"{name}.py")
    simulation, camera_at = sys.modules["tests.desk"], sys.modules["tests.rigs"].camera_at
    ball, desk, lamp_by_pencils, strips = simulation.BALL, simulation.desk, simulation.lamp_by_pencils, simulation.strips

    def measured(scene, **sweep):
        scan = Scan((scene.view(scene.sweep(frames=FRAMES, **sweep)),))
        return METHODS["desk-shadow"].measure(scan, clearance=-1.0, progress=progress).cloud.positions

    def on_dome(points):
        away = np.linalg.norm(points - ball.centre, axis=1) - ball.radius
        return 100 * _rms(away[(np.abs(away) < ball.radius / 8) & (points[:, 2] > ball.radius / 4)]) / (2 * ball.radius)

    plain = desk(ball=False, camera=camera_at((0.0, -0.8, 0.65), (0.0, 0.08, 0.05), focal=150.0, size=(120, 90)))
    points = measured(plain, strips=strips(plain))
    points = points[np.abs(points[:, 1]) < 0.3]
    plane = 100 * _rms(points[:, 2] / np.linalg.norm(points - plain.camera.centre, axis=1))
    yield "point light, exact: plane", plane, "% of the distance", "at most 0.05", plane <= 0.05
    scene = desk()
    found = [lamp_by_pencils(scene.camera, 0.2, seed) for seed in range(5)]
    lamps = [on_dome(measured(scene, radius=0.01, strips=strips(scene), light=lamp)) for lamp in found]
    yield "lamp of 1 cm, by 8 pencils: dome, RMS, worst of 5", max(lamps), "% of its size", "at most 0.5", max(lamps) <= 0.5
    exact = on_dome(measured(scene, radius=0.01, strips=strips(scene)))
    planes = on_dome(measured(scene, radius=0.01, strips=strips(scene, back=True), light=None))
    yield "two planes, no lamp: RMS over that with the exact lamp", planes / exact, "", "0.7 to 1.3", planes <= 1.3 * exact


def photographed(progress):
    """Yield the figures of a bowl, upside down on a desk, in millimetres; its camera and lamp are calibrated from its own pictures."""
    from addon.calibration import calibrate
    from addon.captures.importers import import_capture
    from addon.captures.scan import load_scan
    from addon.reconstruction.methods import METHODS

    source = Path(os.environ.get("SCANSTAGE_DATA", ROOT.parent / "shared" / "data")) / "desk_shadow_bowl"
    if not source.is_dir():
        print(f"figures: desk-shadow: the bowl is left out, {source} is not there; set SCANSTAGE_DATA", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        before, after = Path(folder, "before"), Path(folder, "after")
        import_capture("desk", source, before, progress=progress)
        report = calibrate(before, after, progress=progress)
        scan = load_scan(after, silhouettes=False)
        points = METHODS["desk-shadow"].measure(scan, contrast=CONTRAST, clearance=-1.0, progress=progress).cloud.positions
    on_desk = np.array(next(pose for name, pose in report["board_poses"].items() if name.startswith("calib_1/")))
    camera = scan.views[0].camera.moved(on_desk)
    points = (points - on_desk[:3, 3]) @ on_desk[:3, :3]
    column, row = camera.project(points)[0].T
    height = points[:, 2] * np.sign(camera.centre[2])
    base = float(np.median(height[(np.abs(column - 860) < 60) & (np.abs(row - 590) < 60)]))  # the middle of its foot
    desk = np.abs(height[(row > 900) & (row < 1060)])  # below the bowl
    error, flat = report["devices"]["camera camera"]["rms"], float(np.percentile(desk, 95))
    yield "bowl: camera, RMS", error, "px", "at most 0.7", error <= 0.7
    yield "bowl: its base above the desk", base, "mm", "45 to 55", 45 <= base <= 55
    yield "bowl: the desk's points, 95 % within", flat, "mm", "at most 9", flat <= 9


def _rms(values):
    return float(np.sqrt(np.mean(values ** 2)))


TABLES = {"desk-shadow": desk_shadow}
