# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of calibrations for figures.py: rendered rigs against the truth that rendered them, and photographs of a board."""

import json
import math
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
K1 = -0.1
PROJECTOR_RIG = {"poses": 10, "turns": 0, "projector_k1": K1, "throw_ratio": 0.7}  # of wide throw: there the lens matters
TABLE_RIG = {"poses": 20, "turns": 12, "projector": False, "resolution_x": 1280, "resolution_y": 960, "elevation": math.radians(35)}


def rows(told):
    """Yield (what, figure, unit, target, whether the target is met) of each calibration."""
    yield from rendered_projector(told("projector"))
    yield from rendered_table(told("turntable"))
    yield from desk(told("desk"))


def rendered_projector(progress):
    from addon.calibration import calibrate
    from addon.captures.store import read_capture

    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        before, after = Path(folder, "before"), Path(folder, "after")
        render(PROJECTOR_RIG, before, progress)
        report = calibrate(before, after, progress=progress)
        truth, found = (next(iter(read_capture(path).projectors.values())) for path in (before, after))
        one_homography = global_rms(before, progress)
    camera, projector = (device["rms"] for device in report["devices"].values())
    yield "rendered: camera, RMS", camera, "px", "at most 0.2", camera <= 0.2
    yield "rendered: projector, RMS, local homographies", projector, "px", "at most 0.3", projector <= 0.3
    yield "the same, one homography a pose", one_homography, "px", f"at least {2 * projector:.3f}", one_homography >= 2 * projector
    apart = 1000 * np.linalg.norm(truth.centre - found.centre)
    yield f"projector's k1, where {K1:g} is true", found.distortion[0], "", f"{K1:g} +- 0.01", abs(found.distortion[0] - K1) <= 0.01
    yield "projector's centre, error", apart, "mm", "at most 2", apart <= 2


def global_rms(folder, progress):
    """Return the projector's RMS if each pose has one homography instead of local ones."""
    from addon.captures.scan import load_board_views
    from addon.captures.store import read_capture
    from addon.reconstruction.active.decoding import decode_view
    from addon.reconstruction.calibration.camera import Sighting
    from addon.reconstruction.calibration.rig import calibrate_rig

    capture = read_capture(folder)
    size = next(iter(capture.projectors.values())).size
    seen, views = [], load_board_views(folder, capture)
    for number, shown in enumerate(views):
        progress(number / len(views), "One homography a pose")
        ids, pixels = capture.board.find(shown.view.read_image())
        decoded = decode_view(shown.view.projected, size)
        row, column = np.nonzero(decoded["column"].valid & decoded["row"].valid)
        lit = np.column_stack([decoded[axis].position[row, column] for axis in ("column", "row")]).astype(float)
        H, _ = cv2.findHomography(np.column_stack((column, row)).astype(float), lit, cv2.RANSAC, 10.0)
        carried = cv2.perspectiveTransform(pixels[:, None], H)[:, 0]
        seen.append(Sighting("camera", shown.pose, shown.view.name, ids, pixels))
        seen.append(replace(seen[-1], device="projector", pixels=carried))
    sizes = {"camera": next(iter(capture.cameras.values())).size, "projector": size}
    return calibrate_rig(capture.board.corners, seen, sizes, dict.fromkeys(sizes, "radial")).rms("projector")


def rendered_table(progress):
    from addon.calibration import calibrate
    from addon.captures.store import read_capture

    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        before, after = Path(folder, "before"), Path(folder, "after")
        render(TABLE_RIG, before, progress)
        calibrate(before, after, progress=progress)
        truth, found = (next(iter(read_capture(path).cameras.values())) for path in (before, after))
    true, axis = truth.R[:, 2], found.R[:, 2]  # the world's z in the camera's frame; both pass through the world's origin
    angle = np.degrees(np.arcsin(np.linalg.norm(np.cross(true, axis))))
    offset = 1000 * np.linalg.norm(np.cross(truth.t - found.t, axis)) * 0.8 / np.linalg.norm(truth.t)
    yield "turntable, rendered, 12 views: axis, direction", angle, "degrees", "at most 0.02", angle <= 0.02
    yield "the same: offset at 0.8 m", offset, "mm", "at most 0.15", offset <= 0.15


def render(options, out, progress):
    import bpy

    from addon.cli.progress_bar import drain, muted_stdout
    from addon.render.capture import capture_frames
    from addon.results.blend import new_file
    from addon.stage.staging import build

    with muted_stdout():
        new_file()
        build(bpy.context.scene, "calibration", "dented-sphere", options)
        drain(capture_frames(bpy.context.scene, out), progress)


def desk(progress):
    """Yield the figures of 20 photographs of a checkerboard, and of a lamp from 12 pencils that somebody marked."""
    from addon.calibration import calibrate
    from addon.captures.importers import import_capture
    from addon.captures.store import read_capture
    from addon.reconstruction.calibration.light import light_from_pencils

    source = Path(os.environ.get("SCANSTAGE_DATA", ROOT.parent / "shared" / "data")) / "desk_shadow_bowl"
    if not source.is_dir():
        print(f"figures: desk: left out, {source} is not there; set SCANSTAGE_DATA", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        before, after = Path(folder, "before"), Path(folder, "after")
        import_capture("board", source / "calib", before, {"square": 28.0}, progress)
        report = calibrate(before, after, progress=progress)
        camera = read_capture(after).cameras["camera"]
    error, = (device["rms"] for device in report["devices"].values())
    noted = json.loads((source / "annotations.json").read_text())
    pose = next(pose for name, pose in report["board_poses"].items() if name.startswith("calib_1/"))
    found = light_from_pencils(camera.moved(pose), noted["pencil_base_px"], noted["shadow_tip_px"], noted["pencil_height_mm"])
    apart = float(np.linalg.norm(found.position - noted["light_source_world_mm"]))
    yield "20 photographs of a checkerboard: camera, RMS", error, "px", "0.60 +- 0.03", abs(error - 0.60) <= 0.03
    yield "lamp from 12 pencils, from where others found it", apart, "mm", "at most 16 (3 % of 0.55 m)", apart <= 16
