# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The visual hull beside Open3D and a compiled brute force, and voxels to a mesh beside scikit-image's marching cubes."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

from .measuring import SIZE, VIEWS, box, carve_ours, compiled, compiler, median_seconds, row, scene

COMMAND = Path(__file__).resolve().parents[1] / "benchmark.py"


def compare_carving(runs):
    cameras, masks = scene()
    print(f"Visual hull, {VIEWS} views of {SIZE[0]}x{SIZE[1]}, {os.cpu_count()} processors; medians of {runs}\n")
    print(f"{'':58} seconds    ratio")
    ours = {}
    for rule in ("center", "conservative"):
        for voxels in (256, 512):
            ours[rule, voxels], volume = median_seconds(lambda v=voxels, r=rule: carve_ours(cameras, masks, box(v), r, dense=True), runs)
            print(f"{f'Scanstage, {rule}, {voxels}^3, dense result':58} {ours[rule, voxels]:7.3f}")
    seconds = open3d_seconds(cameras, masks, box(256), max(1, runs // 2))
    for rule in ("center", "conservative"):
        row(f"Open3D carve_silhouette, 256^3, to {rule}", seconds, ours[rule, 256])
    for voxels in (256, 512):
        brute = brute_force_seconds(cameras, masks, box(voxels), max(1, runs // 2))
        row(f"compiled brute force with early exit, {voxels}^3, to center", brute, ours["center", voxels])
    print("\nTime and memory of a process of its own")
    for arguments in (["512", "--dense"], ["512"], ["1024"], ["2048"]):
        subprocess.call([sys.executable, COMMAND, "--alone", *arguments])
    print()


def print_alone(voxels, *, dense):
    """Carve once to warm up at a small size, then at full size: time and the process's peak memory."""
    cameras, masks = scene()
    carve_ours(cameras, masks, box(64), "center")
    seconds, _ = median_seconds(lambda: carve_ours(cameras, masks, box(voxels), "center", dense=dense), 2)
    kind = "dense" if dense else "sparse"
    print(f"{f'Scanstage, center, {voxels}^3, {kind} result':58} {seconds:7.3f}    {own_peak()}", flush=True)
    return 0


def own_peak():
    """Return the most memory that this process has held (getrusage would count the parent's, too)."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return "peak not known on this system"
    return f"peak {int(next(line for line in lines if line.startswith('VmHWM')).split()[1]) / 2 ** 20:.2f} GiB"


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


def compare_meshing(runs):
    from skimage.measure import marching_cubes

    from addon.reconstruction.volumetric.surface import extract_surface

    cameras, masks = scene()
    print(f"Voxels to a mesh with shared vertices; medians of {runs}\n")
    for voxels in (256, 512):
        volume = carve_ours(cameras, masks, box(voxels), "center")
        ours, surface = median_seconds(lambda v=volume: extract_surface(v), runs)
        print(f"{f'Scanstage, {voxels}^3, {len(surface.quads):,} quads':58} {ours:7.3f}")
        dense = volume.dense()
        row(f"scikit-image marching_cubes, {voxels}^3", median_seconds(lambda d=dense: marching_cubes(d, 0.5), max(1, runs // 2))[0], ours)
