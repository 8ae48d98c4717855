# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What all benchmarks share: the scene, medians, lines of a table, the compiled peers."""

import ctypes
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from tables import head, line

ROOT = Path(__file__).resolve().parents[2]
VIEWS, SIZE = 24, (640, 480)
BALLS = (((0.0, 0.0, -0.1), 0.55), ((0.45, 0.2, 0.3), 0.3), ((-0.4, -0.3, 0.35), 0.35))


def median_seconds(function, runs):
    """Return the median wall time of several calls after one that does not count, and the last result."""
    result, seconds = function(), []
    for _ in range(runs):
        del result
        start = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), result


class Comparison:
    """The table that a run prints, line by line, and that the README shows.

    Attributes
    ----------
    lines : list of str
        Markdown.
    """

    def __init__(self):
        self.lines = []
        self._add(*head("", "seconds", "a unit", "ratio", "peak memory"))

    def own(self, name, seconds, *, unit="", memory="", ratio=""):
        """Add a line of ours."""
        self._add(line(f"**{name}**", f"{seconds:.3g}", unit, ratio, memory))

    def peer(self, name, seconds, ours, *, unit=""):
        """Add what a user would pick instead; ``seconds`` is None where that is not on this machine."""
        if seconds is None:
            self._add(line(name, "not on this machine", "", "", ""))
        else:
            self._add(line(name, f"{seconds:.3g}", unit, f"{seconds / ours:.1f} times longer", ""))

    def _add(self, *lines):
        print(*lines, sep="\n", flush=True)
        self.lines += lines


def scene():
    """Return 24 cameras on a ring and their masks of three overlapping balls (562,000 quads at 512^3)."""
    import numpy as np

    from addon.reconstruction.geometry import Camera, look_at

    cameras, masks = [], []
    rows, columns = np.mgrid[:SIZE[1], :SIZE[0]]
    for angle in 2 * np.pi * np.arange(VIEWS) / VIEWS:
        R, t = look_at(4 * np.array([np.cos(angle) * 0.94, np.sin(angle) * 0.94, 0.342]), (0, 0, 0))
        camera = Camera([[900, 0, (SIZE[0] - 1) / 2], [0, 900, (SIZE[1] - 1) / 2], [0, 0, 1]], R, t, SIZE)
        rays = camera.rays(np.stack((columns, rows), -1))
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        mask = np.zeros(SIZE[::-1], bool)
        for centre, radius in BALLS:
            offset = np.array(centre) - camera.centre
            mask |= offset @ offset - (rays @ offset) ** 2 < radius ** 2
        cameras.append(camera)
        masks.append(mask)
    return cameras, masks


def entry(origin, directions, centre, radius):
    """Return where rays along (n, 3) directions enter a ball, in lengths of the direction; infinite where they miss it."""
    import numpy as np

    offset = np.array(centre) - origin
    along, length = directions @ offset, (directions ** 2).sum(axis=-1)
    inner = along ** 2 - length * (offset @ offset - radius ** 2)
    return np.where(inner > 0, (along - np.sqrt(np.maximum(inner, 0))) / length, np.inf)


def box(voxels):
    from addon.reconstruction.geometry import VoxelGrid

    return VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), voxels)


def carve_ours(cameras, masks, grid, rule, *, dense=False):
    from addon.reconstruction.volumetric.bounds import spread_order
    from addon.reconstruction.volumetric.octree import carve, extent_of
    from addon.reconstruction.volumetric.silhouette_test import SilhouetteTest

    tests = [SilhouetteTest(cameras[i], masks[i], grid, extent_of(grid), rule=rule, unknown_outside=True) for i in spread_order(cameras)]
    volume = carve(tests, grid)[0]
    return volume.dense() if dense else volume


def compiler():
    return shutil.which("g++") or shutil.which("clang++")


def compiled():
    """Return the library of scripts/brute_force.cpp, compiled for this machine."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "brute_force.so"
        subprocess.check_call([compiler(), "-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC", "-pthread",
                               ROOT / "scripts" / "brute_force.cpp", "-o", library])
        return ctypes.CDLL(str(library))
