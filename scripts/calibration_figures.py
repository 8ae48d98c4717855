# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of calibrations for figures.py: simulated corners, rendered rigs against their truth, photographs of a board."""

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
RUNS = 20
NOISE_BOUNDS = (  # what, unit, 95 % of what OpenCV alone leaves; twice that is allowed
    ("RMS, camera", "px", 0.142), ("RMS, projector", "px", 0.211), ("focal length, camera", "%", 0.22),
    ("focal length, projector", "%", 0.17), ("principal point, camera", "px", 1.2), ("principal point, projector", "px", 2.4),
    ("relative rotation", "degrees", 0.10), ("translation", "mm", 2.2))
PROJECTOR_RIG = {"poses": 10, "turns": 0, "projector_k1": K1, "throw_ratio": 0.7}  # of wide throw: there the lens matters
TABLE_RIG = {"poses": 20, "turns": 12, "projector": False, "resolution_x": 1280, "resolution_y": 960, "elevation": math.radians(35)}


def rows(told):
    """Yield (what, figure, unit, target, whether the target is met) of each calibration."""
    yield from simulated(told("simulation"))
    yield from rendered_projector(told("projector"))
    yield from rendered_table(told("turntable"))
    yield from desk(told("desk"))


def simulated(progress):
    """Yield the figures of corners by formula: 10 x 7 of 25 mm in 12 poses, exact and with 0.10 and 0.15 px of noise."""
    from addon.reconstruction.calibration.board import Board
    from addon.reconstruction.geometry import Camera, rotation_about

    board = Board("checkerboard", 11, 8, 0.025)
    turned, aside = rotation_about((0, 1, 0), 0.3), (-0.25, 0.02, 0.05)
    true = {"camera": Camera([[1400, 0, 639.5], [0, 1400, 479.5], [0, 0, 1]], np.eye(3), np.zeros(3), (1280, 960)),
            "projector": Camera([[1600, 0, 620], [0, 1600, 790], [0, 0, 1]], turned, aside, (1280, 800))}
    exact = errors(true, board, np.random.default_rng(0), {"camera": 0.0, "projector": 0.0})
    yield "perfect corners: K, R, t, relative error", exact["relative"], "", "at most 1e-6", exact["relative"] <= 1e-6
    runs = []
    for number in range(RUNS):
        progress(number / RUNS, f"Simulation {number + 1} of {RUNS}")
        runs.append(errors(true, board, np.random.default_rng(1 + number), {"camera": 0.10, "projector": 0.15}))
    for name, unit, bound in NOISE_BOUNDS:
        figure = float(np.quantile([run[name] for run in runs], 0.95))
        yield f"noise, 95 % of {RUNS} runs: {name}", figure, unit, f"at most {2 * bound:g}", figure <= 2 * bound


def errors(true, board, rng, noise):
    """Return by how much a simulated calibration misses the truth."""
    from addon.reconstruction.calibration.camera import Sighting
    from addon.reconstruction.calibration.rig import calibrate_rig
    from addon.reconstruction.geometry import rotation_about

    seen = []
    for number in range(12):
        about, tilt = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(10, 35))
        R = rotation_about((np.cos(about), np.sin(about), 0), tilt) @ rotation_about((0, 0, 1), rng.uniform(-0.3, 0.3))
        points = (board.corners - board.corners.mean(axis=0)) @ R.T + (*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.7, 1.0))
        for name, device in true.items():
            pixels = device.project(points)[0] + rng.normal(0, noise[name], (len(points), 2))
            seen.append(Sighting(name, str(number), str(number), np.arange(len(points)), pixels))
    rig = calibrate_rig(board.corners, seen, {name: one.size for name, one in true.items()}, dict.fromkeys(true, "none"))
    (camera, true_camera), (projector, true_projector) = ((rig.devices[name], one) for name, one in true.items())
    turn, shift = cv2.Rodrigues(projector.R @ true_projector.R.T)[0], np.linalg.norm(projector.t - true_projector.t)
    focal, principal = ([measure(found.K - one.K) for found, one in ((camera, true_camera), (projector, true_projector))]
                        for measure in (lambda K: np.abs(np.diag(K)[:2]).max(), lambda K: np.linalg.norm(K[:2, 2])))
    return {"focal length, camera": 100 * focal[0] / 1400, "focal length, projector": 100 * focal[1] / 1600,
            "principal point, camera": principal[0], "principal point, projector": principal[1],
            "relative rotation": np.degrees(np.linalg.norm(turn)), "translation": 1000 * shift,
            "RMS, camera": rig.rms("camera"), "RMS, projector": rig.rms("projector"),
            "relative": max(focal[0] / 1400, focal[1] / 1600, principal[0] / 1400, principal[1] / 1600, float(np.linalg.norm(turn)),
                            shift / np.linalg.norm(true_projector.t))}


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
