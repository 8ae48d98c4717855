# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Experiments whose outcome the project promises: tests judge their numbers, and `scripts/figures.py` prints them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from addon.captures.importers import import_capture
from addon.captures.scan import load_scan
from addon.reconstruction.active.decoding import decode_view
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.active.phase_shift import fit_phase
from addon.reconstruction.evaluation.distances import nearest_distances
from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.methods import METHODS
from addon.reconstruction.scan import Scan
from tests.interreflection import groove_view
from tests.projection import Round, Wall, laser_view, projected_view, sight
from tests.rigs import Ball, camera_at

EIGHT_BITS = {"noise": 2 / 255, "levels": 255}
CAMERA = camera_at((0.0, -2.0, 0.1), focal=230.0, size=(160, 120))
PROJECTOR = camera_at((0.7, -1.9, 0.15), focal=180.0, size=(128, 96))
BALL_AND_WALL = (Round(Ball((0.0, 0.0, 0.0), 0.3)), Wall((0.0, -1.0, 0.0), -0.6))


def gray_code_on_a_matte_scene() -> float:
    """Return the least share, of columns and rows, of directly lit pixels that are decoded to within one; pixels average 9 rays."""
    view = projected_view(CAMERA, PROJECTOR, make_patterns("gray-code", PROJECTOR.size), BALL_AND_WALL, samples=3, ambient=0.03, **EIGHT_BITS)
    truth = sight(CAMERA, PROJECTOR, BALL_AND_WALL)
    lit = truth.light > 0.05
    decoded = decode_view(view.projected, PROJECTOR.size)
    right = [decoded[axis].valid & (np.abs(decoded[axis].position - truth.pixels[..., index]) <= 1) for index, axis in enumerate(("column", "row"))]
    return min(np.count_nonzero(mask & lit) / np.count_nonzero(lit) for mask in right)


@dataclass(frozen=True)
class Groove:
    """Shares of the directly lit pixels of a 60 degree groove, albedo 0.9, all bounces: decoded, and decoded to a wrong column."""

    covered: float
    wrong: float
    simply_covered: float
    simply_wrong: float


def gray_code_in_a_groove() -> Groove:
    """Decode a deep groove with robust classification and with simple thresholding."""
    camera = camera_at((-0.1, -2.2, 0.1), (0, -0.25, 0), focal=225.0, size=(120, 90))
    projector = camera_at((0.5, -2.1, 0.15), (0, -0.25, 0), focal=500.0, size=(384, 288))
    view, truth, share = groove_view(camera, projector, make_patterns("gray-code", projector.size, {"axes": "columns"}), patches=16)
    lit, found = share > 0, []
    for robust in (True, False):
        decoded = decode_view(view.projected, projector.size, robust=robust)["column"]
        wrong = decoded.valid & (np.abs(decoded.position - truth.pixels[..., 0]) > 1)
        found += [np.count_nonzero(mask & lit) / np.count_nonzero(lit) for mask in (decoded.valid, wrong)]
    return Groove(*found)


def phase_against_gray_code() -> tuple[float, float]:
    """Return the RMS error in projector pixels of 4 steps with Gray code, and of the Gray code alone."""
    truth = sight(CAMERA, PROJECTOR, BALL_AND_WALL, 0.95)
    lit, found = truth.light > 0.45, []
    for name in ("phase-shift", "gray-code"):
        patterns = make_patterns(name, PROJECTOR.size, {"axes": "columns"})
        view = projected_view(CAMERA, PROJECTOR, patterns, BALL_AND_WALL, albedo=0.95, **EIGHT_BITS)
        decoded = decode_view(view.projected, PROJECTOR.size)["column"]
        found.append(float(np.sqrt(np.mean((decoded.position - truth.pixels[..., 0])[decoded.valid & lit] ** 2))))
    return found[0], found[1]


def phase_noise(steps: int) -> float:
    """Return the measured noise of a phase as a share of ``sigma_I / B sqrt(2 / N)``, over 50,000 pixels."""
    random = np.random.default_rng(steps)
    phase = random.uniform(0, 2 * np.pi, (200, 250))
    noise, amplitude = 2 / 255, 80 / 255
    images = [0.5 + amplitude * np.cos(phase - 2 * np.pi * step / steps) + random.normal(0, noise, phase.shape) for step in range(steps)]
    error = (fit_phase(images, steps).phase - phase + np.pi) % (2 * np.pi) - np.pi
    return float(np.sqrt(np.mean(error ** 2)) / (noise / amplitude * np.sqrt(2 / steps)))


def plane_deviation(code: str) -> float:
    """Return the measured deviation from an oblique plane, along the camera's rays, as a share of the predicted one."""
    camera = camera_at((0.0, -2.0, 0.1), focal=460.0, size=(160, 120))
    projector = camera_at((0.7, -1.9, 0.15), focal=360.0, size=(256, 192))
    normal = np.array([0.3, -1.0, 0.1]) / np.linalg.norm([0.3, -1.0, 0.1])
    how = EIGHT_BITS if code == "phase-shift" else {}  # a Gray code's error is that of its columns' width
    view = projected_view(camera, projector, make_patterns(code, projector.size, {"axes": "columns"}), [Wall(tuple(normal), 0.0)], **how)
    cloud = METHODS[code].measure(Scan((view,))).cloud
    rays = (cloud.positions - camera.centre) / np.linalg.norm(cloud.positions - camera.centre, axis=1, keepdims=True)
    along = (cloud.positions @ normal) / (rays @ normal)
    return float(np.sqrt(np.mean(along ** 2)) / np.sqrt(np.mean(cloud.sigma.astype(float) ** 2)))


def reflectance_step() -> tuple[float, float]:
    """Return the greatest error next to a reflectance step of 10 to 1 under a laser: by the peak in time, and in space."""
    camera = camera_at((0.0, -2.0, 0.0), focal=460.0, size=(160, 40))
    edge = 0.013
    view = laser_view(camera, frames=120, width=0.03, reach=0.2, albedo=lambda points: np.where(points[..., 0] > edge, 0.08, 0.8))
    found = []
    for analysis in ("temporal", "spatial"):
        cloud = METHODS["laser-stripe"].measure(Scan((view,)), analysis=analysis, contrast=0.01).cloud
        near = np.abs(cloud.positions[:, 0] - edge) < 0.03
        found.append(float(np.abs(cloud.positions[near, 1]).max()))
    return found[0], found[1]


def laser_spacing() -> float:
    """Return the median distance of neighbouring points, for a field of 14 cm and 560 pixels 1.12 m away."""
    focal = 560 * 1.12 / 0.14
    camera = Camera([[focal, 0, 279.5], [0, focal, 9.5], [0, 0, 1]], *look_at((0.0, -1.12, 0.0), (0.0, 0.0, 0.0)), (560, 20))
    cloud = METHODS["laser-stripe"].measure(Scan((laser_view(camera, frames=160, width=0.004, reach=0.075),))).cloud
    x, z = cloud.positions[:, 0], cloud.positions[:, 2]
    gaps = np.diff(x[np.lexsort((x, np.round(z / 1e-4)))])  # along the rows of pixels
    return float(np.median(gaps[gaps > 0]))


def scanner_distances(source: Path, folder: Path) -> tuple[float, float]:
    """Return the median distances, in millimetres, of a real scan's points from the scanner's own cloud, and of those from ours.

    Parameters
    ----------
    source : Path
        The folder ``gray_code_skull``.
    folder : Path
        For the capture set, to make.
    """
    import_capture("slstudio", source / "calibration.xml", folder, {"encoding": "linear"})
    cloud = METHODS["gray-code"].measure(load_scan(folder, silhouettes=False)).cloud
    theirs = matlab_points(source / "pointCloud.mat")
    ours = cloud.within(np.stack((theirs.min(axis=0), theirs.max(axis=0)))).positions
    return float(np.median(nearest_distances(ours, theirs))), float(np.median(nearest_distances(theirs, ours)))


def matlab_points(path: Path) -> np.ndarray:
    """Return the points (n, 3) of a MATLAB 5 file: of its compressed array ``xyz``, (h, w, 3) doubles, where they are finite."""
    def element(data: bytes, at: int) -> tuple[bytes, int]:
        kind, size = map(int, np.frombuffer(data, "<u4", 2, at))
        if kind >> 16:  # a small one, all in eight bytes
            return data[at + 4:at + 4 + (kind >> 16)], at + 8
        return data[at + 8:at + 8 + size], at + 8 + size + (-size % 8 if kind != 15 else 0)

    data, at = path.read_bytes(), 128
    while at < len(data):
        packed, at = element(data, at)
        array = element(zlib.decompress(packed), 0)[0]
        parts, place = [], 0
        while place < len(array):
            part, place = element(array, place)
            parts.append(part)
        if bytes(parts[2]) == b"xyz":
            points = np.frombuffer(parts[3], "<f8").reshape(3, -1).T
            return points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
    raise AssertionError("the file holds no array xyz")
