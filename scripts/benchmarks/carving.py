# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull beside Open3D and a compiled brute force, and voxels to a mesh beside scikit-image's marching cubes."""

import ctypes
import subprocess
import sys
from pathlib import Path

from .measuring import SIZE, VIEWS, box, carve_ours, compiled, compiler, median_seconds, scene

COMMAND = Path(__file__).resolve().parents[1] / "benchmark.py"


def compare_carving(runs, table):
    """Carve by every program, then at growing sizes in processes of their own."""
    cameras, masks = scene()
    ours = {}
    for voxels in (256, 512):
        for rule in ("center", "conservative"):
            ours[rule, voxels], volume = median_seconds(lambda v=voxels, r=rule: carve_ours(cameras, masks, box(v), r, dense=True), runs)
            table.own(f"visual hull {voxels}^3, {rule}, dense", ours[rule, voxels], unit=a_pair(ours[rule, voxels], voxels))
        peers = {"plain numpy, all voxels in all views": numpy_seconds,
                 "compiled brute force with early exit, two threads, the same bits": brute_force_seconds}
        if voxels == 256:  # one run at 512^3 takes minutes
            peers["Open3D `carve_silhouette`"] = open3d_seconds
        for name, seconds_of in peers.items():
            seconds = seconds_of(cameras, masks, box(voxels), max(1, runs // 2))
            table.peer(f"{name}, {voxels}^3, to center", seconds, ours["center", voxels], unit=seconds and a_pair(seconds, voxels))
    before = None
    for arguments in (["512", "--dense"], ["512"], ["1024"], ["2048"]):
        answer = subprocess.run([sys.executable, COMMAND, "--alone", *arguments], stdout=subprocess.PIPE, text=True, check=True).stdout
        seconds, peak = float(answer.split()[0]), answer.split(maxsplit=1)[1].strip()
        grown = f"{seconds / before:.1f} times that of half the size" if before and len(arguments) == 1 else ""
        table.own(f"visual hull {arguments[0]}^3, center, {'dense' if len(arguments) > 1 else 'sparse'}, a process of its own", seconds,
                  unit=a_pair(seconds, int(arguments[0])), memory=peak, ratio=grown)
        before = seconds if len(arguments) == 1 else None


def a_pair(seconds, voxels):
    """Return in words what a voxel in a view takes."""
    return f"{1e9 * seconds / (voxels ** 3 * VIEWS):.2g} ns a voxel and view"


def print_alone(voxels, *, dense):
    """Carve once to warm up at a small size, then at full size: time and the process's peak memory."""
    cameras, masks = scene()
    carve_ours(cameras, masks, box(64), "center")
    seconds, _ = median_seconds(lambda: carve_ours(cameras, masks, box(voxels), "center", dense=dense), 2)
    print(seconds, own_peak(), flush=True)
    return 0


def numpy_seconds(cameras, masks, grid, runs):
    """Return the time of what the textbooks sketch: every voxel's centre looked up in every mask, a layer at a time."""
    import numpy as np

    y, z = np.meshgrid(*((np.arange(n) + 0.5) * grid.voxel_size + low for n, low in zip(grid.shape[1:], grid.origin[1:], strict=True)),
                       indexing="ij")

    def carve():
        occupancy, (width, height) = np.ones(grid.shape, bool), SIZE
        padded = [np.pad(mask, 1, constant_values=True) for mask in masks]  # beyond the picture nothing is known
        for number, layer in enumerate(occupancy):
            x = grid.origin[0] + (number + 0.5) * grid.voxel_size
            for camera, mask in zip(cameras, padded, strict=True):
                u, v, w = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in camera.P)
                column, line = (np.clip(np.rint(value / w).astype(int), -1, side) + 1 for value, side in ((u, width), (v, height)))
                layer &= mask[line, column]
        return occupancy

    seconds, occupancy = median_seconds(carve, 1 if grid.shape[0] > 256 else runs)
    differing = np.count_nonzero(occupancy != carve_ours(cameras, masks, grid, "center", dense=True))
    if differing > 1e-6 * grid.count:  # a centre on the border of two pixels may go to either
        raise SystemExit(f"benchmark: plain numpy and the octree differ in {differing} voxels")
    return seconds


def own_peak():
    """Return the most memory that this process has held (getrusage would count the parent's, too)."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return "not known on this system"
    return f"{int(next(line for line in lines if line.startswith('VmHWM')).split()[1]) / 2 ** 20:.2f} GiB"


def open3d_seconds(cameras, masks, grid, runs):
    """Return the time for a dense grid carved by all masks with Open3D, or None without it."""
    import numpy as np

    try:
        import open3d
    except ImportError as error:  # not installed, or a system library of its own is not (libusb-1.0-0 and libgomp1 on Debian)
        print(f"  ({error})")
        return None

    parameters = []
    for camera in cameras:
        entry = open3d.camera.PinholeCameraParameters()
        entry.intrinsic = open3d.camera.PinholeCameraIntrinsic(*SIZE, camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2])
        entry.extrinsic = np.vstack((np.column_stack((camera.R, camera.t)), [0, 0, 0, 1]))
        parameters.append(entry)
    images = [open3d.geometry.Image(mask.astype(np.float32)) for mask in masks]

    def carve():
        side = grid.voxel_size * grid.shape[0]
        volume = open3d.geometry.VoxelGrid.create_dense(origin=grid.origin, color=[0.5, 0.5, 0.5], voxel_size=grid.voxel_size,
                                                        width=side, height=side, depth=side)
        for image, entry in zip(images, parameters, strict=True):
            volume.carve_silhouette(image, entry)
        return volume

    return median_seconds(carve, runs)[0]


def brute_force_seconds(cameras, masks, grid, runs):
    """Return the time of the compiled brute force, or None without a compiler; check that it finds the same volume."""
    import numpy as np

    from addon.reconstruction.volumetric.octree import extent_of
    from addon.reconstruction.volumetric.silhouette_test import SilhouetteTest

    if compiler() is None:
        return None
    tests = [SilhouetteTest(camera, mask, grid, extent_of(grid), rule="center", unknown_outside=True)
             for camera, mask in zip(cameras, masks, strict=True)]
    matrices, corners = np.array([test.matrix for test in tests]), np.array([test.corner for test in tests], np.intc)
    pictures = np.array(masks, np.uint8)
    occupancy = np.zeros(grid.shape, np.uint8)
    pointer = np.ctypeslib.ndpointer
    function = compiled().carve
    function.restype = ctypes.c_int64
    function.argtypes = [pointer(float), pointer(np.intc), pointer(np.uint8), *[ctypes.c_int] * 6, pointer(np.uint8)]
    seconds, kept = median_seconds(lambda: function(matrices, corners, pictures, len(cameras), *SIZE, *grid.shape, occupancy), runs)
    if not np.array_equal(occupancy.astype(bool), carve_ours(cameras, masks, grid, "center", dense=True)):
        raise SystemExit("benchmark: the compiled brute force and the octree differ")
    return seconds


def compare_meshing(runs, table):
    """Make a mesh with shared vertices of voxels."""
    from skimage.measure import marching_cubes

    from addon.reconstruction.volumetric.surface import extract_surface

    cameras, masks = scene()
    for voxels in (256, 512):
        volume = carve_ours(cameras, masks, box(voxels), "center")
        ours, surface = median_seconds(lambda v=volume: extract_surface(v), runs)
        quads, dense = len(surface.quads), volume.dense()
        table.own(f"voxels to mesh, {voxels}^3, {quads:,} quads", ours, unit=f"{1e9 * ours / quads:.0f} ns a quad")
        theirs = median_seconds(lambda d=dense: marching_cubes(d, 0.5), max(1, runs // 2))[0]
        table.peer(f"scikit-image `marching_cubes`, {voxels}^3", theirs, ours)
