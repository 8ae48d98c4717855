# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Times the kernels beside what a user would pick instead, in one run, on this machine.

    python3 scripts/benchmark.py carve        visual hull: Open3D, a compiled brute force
    python3 scripts/benchmark.py mesh         voxels to a mesh: scikit-image's marching cubes
    python3 scripts/benchmark.py decode       Gray code: OpenCV's structured_light module
    python3 scripts/benchmark.py coloring     voxel coloring at the size of the paper of 1997: a compiled projection and gather
    python3 scripts/benchmark.py shadows      shadow carving: the hull alone, and its growth with views and lights
    python3 scripts/benchmark.py              all of them

Medians of several runs after a warm-up. Only the ratios mean anything on another machine. It makes an environment of its
own (without Blender) for the peers, and says which of them were not there.
"""

import argparse
import ctypes
import importlib.util
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VIEWS, SIZE = 24, (640, 480)
BALLS = (((0.0, 0.0, -0.1), 0.55), ((0.45, 0.2, 0.3), 0.3), ((-0.4, -0.3, 0.35), 0.35))
SHADOW_VOXELS, SHADOW_LIGHTS = 256, 4
PAPER_VOXELS, PAPER_VIEWS = 197, 21  # 7.6 million voxels: Seitz and Dyer, 1997


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kernel", nargs="?", choices=["carve", "mesh", "decode", "coloring", "shadows", "all"], default="all")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--alone", metavar="N", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--dense", action="store_true", help=argparse.SUPPRESS)
    call = parser.parse_args()
    if importlib.util.find_spec("cv2") is None or importlib.util.find_spec("skimage") is None:
        return run_in_environment()
    load_addon()
    if call.alone:
        return print_alone(call.alone, dense=call.dense)
    if call.kernel in ("carve", "all"):
        compare_carving(call.runs)
    if call.kernel in ("mesh", "all"):
        compare_meshing(call.runs)
    if call.kernel in ("decode", "all"):
        compare_decoding(call.runs)
    if call.kernel in ("coloring", "all"):
        compare_coloring(call.runs)
    if call.kernel in ("shadows", "all"):
        time_shadows(call.runs)
    return 0


def run_in_environment():
    import environment

    try:
        python = environment.prepare_benchmark()
    except environment.SetupError as error:
        print(f"benchmark: error: {error}", file=sys.stderr)
        return 1
    return subprocess.call([python, Path(__file__).resolve(), *sys.argv[1:]])


def load_addon():
    """Import the clone's `addon` by its file."""
    spec = importlib.util.spec_from_file_location("addon", ROOT / "addon" / "__init__.py", submodule_search_locations=[str(ROOT / "addon")])
    sys.modules["addon"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules["addon"])


def median_seconds(function, runs):
    """Return the median wall time of several calls after one that does not count, and the last result."""
    result, seconds = function(), []
    for _ in range(runs):
        del result
        start = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), result


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


def carve_ours(cameras, masks, grid, rule, *, dense=False):
    from addon.reconstruction.volumetric.bounds import spread_order
    from addon.reconstruction.volumetric.octree import carve, extent_of
    from addon.reconstruction.volumetric.silhouette_test import SilhouetteTest

    tests = [SilhouetteTest(cameras[i], masks[i], grid, extent_of(grid), rule=rule, unknown_outside=True) for i in spread_order(cameras)]
    volume = carve(tests, grid)[0]
    return volume.dense() if dense else volume


def box(voxels):
    from addon.reconstruction.geometry import VoxelGrid

    return VoxelGrid.from_bounds((-1, -1, -1), (1, 1, 1), voxels)


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
        subprocess.call([sys.executable, __file__, "--alone", *arguments])
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


def row(name, seconds, reference):
    if seconds is None:
        print(f"{name:58} not run: it is not on this machine")
    else:
        print(f"{name:58} {seconds:7.3f} {seconds / reference:7.1f} x")


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


def compiler():
    return shutil.which("g++") or shutil.which("clang++")


def compiled():
    """Return the library of scripts/brute_force.cpp, compiled for this machine."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "brute_force.so"
        subprocess.check_call([compiler(), "-O3", "-march=native", "-ffp-contract=off", "-shared", "-fPIC", "-pthread",
                               ROOT / "scripts" / "brute_force.cpp", "-o", library])
        return ctypes.CDLL(str(library))


def compare_coloring(runs):
    """Print what voxel coloring tests and colours at the size of Seitz and Dyer's dinosaur, and how long it takes."""
    import numpy as np

    from addon.reconstruction.scan import Scan
    from addon.reconstruction.volumetric.voxel_coloring import voxel_coloring

    views = painted_scene()
    grid = box(PAPER_VOXELS)
    print(f"Voxel coloring, {grid.count:,} voxels, {len(views)} views of {SIZE[0]}x{SIZE[1]}, from the box; medians of {runs}\n")
    seconds, found = median_seconds(lambda: voxel_coloring(Scan(views), grid, start="box", consistency="chi-square", noise=0.03), runs)
    counts = found.report["counts"]
    pairs = counts["tested"] * len(views)
    print(f"tested {counts['tested']:,}, coloured {counts['coloured']:,} in {seconds:.2f} s: {1e9 * seconds / pairs:.1f} ns a voxel "
          "and view")
    if compiler() is None:
        print("compiled projection and gather: not run, there is no compiler")
        return
    pointer, function = np.ctypeslib.ndpointer, compiled().project_and_gather
    function.restype = ctypes.c_double
    function.argtypes = [pointer(float), pointer(np.float32), *[ctypes.c_int] * 6]
    to_world = np.diag([grid.voxel_size] * 3 + [1.0])
    to_world[:3, 3] = grid.origin
    matrices = np.array([view.camera.P @ to_world for view in views])
    pictures = np.array([np.dstack((view.read_image(), view.mask)) for view in views], np.float32)
    reference, _ = median_seconds(lambda: function(matrices, pictures, len(views), *SIZE, *grid.shape), runs)
    unit = 1e9 * reference / (grid.count * len(views))
    print(f"compiled projection and gather, one thread: {unit:.1f} ns a voxel and view; voxel coloring takes "
          f"{1e9 * seconds / pairs / unit:.1f} x (at most 5)")


def painted_scene():
    """Return 21 views from above of the balls of `scene`, in colours that change with the place."""
    import numpy as np

    from addon.reconstruction.geometry import Camera, look_at
    from addon.reconstruction.scan import View

    rows, columns = np.mgrid[:SIZE[1], :SIZE[0]]
    views = []
    for number, angle in enumerate(2 * np.pi * np.arange(PAPER_VIEWS) / PAPER_VIEWS):
        R, t = look_at(4 * np.array([np.cos(angle) * 0.8, np.sin(angle) * 0.8, 0.6]), (0, 0, 0))
        camera = Camera([[900, 0, (SIZE[0] - 1) / 2], [0, 900, (SIZE[1] - 1) / 2], [0, 0, 1]], R, t, SIZE)
        rays = camera.rays(np.stack((columns, rows), -1))
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        nearest = np.full(SIZE[::-1], np.inf)
        for centre, radius in BALLS:
            offset = np.array(centre) - camera.centre
            along = rays @ offset
            half = radius ** 2 - (offset @ offset - along ** 2)
            nearest = np.where(half > 0, np.minimum(nearest, along - np.sqrt(np.maximum(half, 0))), nearest)
        mask = np.isfinite(nearest)
        points = camera.centre + rays * np.where(mask, nearest, 0)[..., None]
        image = (0.5 + 0.2 * np.sin(points * (9, 11, 13)) + 0.2 * np.sin(points[..., ::-1] * (21, 17, 19))) * mask[..., None]
        views.append(View(f"{number:04d}", camera, mask, lambda image=image.astype(np.float32): image))
    return tuple(views)


def time_shadows(runs):
    """Print what carving by shadows takes after the hull of the same scan, and how that grows with views and lights."""
    from addon.reconstruction.scan import Scan
    from addon.reconstruction.volumetric.shadow_carving import shadow_carving
    from addon.reconstruction.volumetric.visual_hull import visual_hull

    views, grid, runs = shadowed_scene(), box(SHADOW_VOXELS), max(1, runs // 2)
    print(f"Shadow carving, {SHADOW_VOXELS}^3, views of {SIZE[0]}x{SIZE[1]}, three balls; medians of {runs}\n")
    print(f"{'':58} seconds    ratio   per view and light")
    for count, lights in ((VIEWS, SHADOW_LIGHTS), (VIEWS // 2, SHADOW_LIGHTS), (VIEWS, SHADOW_LIGHTS // 2)):
        scan = Scan(tuple(replace(view, lit=view.lit[:lights]) for view in views[::VIEWS // count]))
        hull, _ = median_seconds(lambda scan=scan: visual_hull(scan, grid, rule="conservative"), runs)
        print(f"{f'Scanstage, hull, {count} views':58} {hull:7.3f}")
        for rounds, name in ((1, "first round"), (100, "all rounds")):
            both, found = median_seconds(lambda scan=scan, rounds=rounds: shadow_carving(scan, grid, rounds=rounds), runs)
            counts = found.report["counts"]
            name = f"after it, {name} ({counts['rounds']}), {count} x {lights}: {counts['carved']:,} of {counts['hull']:,} voxels"
            print(f"{name:58} {both - hull:7.3f} {(both - hull) / hull:7.1f} x {1000 * (both - hull) / count / lights:8.1f} ms")
    print()


def shadowed_scene():
    """Return the views of `scene` with lights 30 degrees off the camera's axis, and the shadows of the balls on each other."""
    import cv2
    import numpy as np

    from addon.reconstruction.geometry import Light
    from addon.reconstruction.scan import LitPicture, View
    from addon.reconstruction.shadows import ShadowMasks

    rows, columns = np.mgrid[:SIZE[1], :SIZE[0]]
    margin, views = np.ones((3, 3), np.uint8), []
    for number, (camera, mask) in enumerate(zip(*scene(), strict=True)):
        rays = camera.rays(np.stack((columns[mask], rows[mask]), -1))
        points = camera.centre + rays * np.min([entry(camera.centre, rays, *ball) for ball in BALLS], axis=0)[:, None]
        lit, bits = [], np.zeros(mask.shape, np.uint8)
        for light in range(SHADOW_LIGHTS):
            angle = 2 * np.pi * (light + 0.5) / SHADOW_LIGHTS
            position = camera.centre + 4 * np.tan(np.pi / 6) * (np.cos(angle) * camera.R[0] + np.sin(angle) * camera.R[1])
            shadow = np.zeros(mask.shape, np.uint8)
            shadow[mask] = np.min([entry(position, points - position, *ball) for ball in BALLS], axis=0) < 1 - 1e-6
            bits |= cv2.erode(shadow, margin) << np.uint8(light)
            lit.append(LitPicture(f"{number:04d}-{light}", f"light-{light}", Light("point", position), lambda: None))
        seen = cv2.dilate(mask.astype(np.uint8), margin) > 0
        views.append(View(f"{number:04d}", camera, seen, lambda: None, tuple(lit), ShadowMasks(bits, seen)))
    return tuple(views)


def entry(origin, directions, centre, radius):
    """Return where rays along (n, 3) directions enter a ball, in lengths of the direction; infinite where they miss it."""
    import numpy as np

    offset = np.array(centre) - origin
    along, length = directions @ offset, (directions ** 2).sum(axis=-1)
    inner = along ** 2 - length * (offset @ offset - radius ** 2)
    return np.where(inner > 0, (along - np.sqrt(np.maximum(inner, 0))) / length, np.inf)


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


def compare_decoding(runs):
    """Decode columns and rows of two cameras from the same pictures, by both programs, and compare every pixel both accept."""
    import cv2
    import numpy as np

    from addon.reconstruction.active.gray_code import decode_gray

    size, (width, height) = (1024, 1024), (1280, 720)
    pictures = gray_pictures(size, width, height)
    coded, (white, black) = list(pictures.values())[:-2], (pictures["white"], pictures["black"])
    half = len(coded) // 2
    pairs = [list(zip(part[::2], part[1::2], strict=True)) for part in (coded[:half], coded[half:])]

    def ours(robust=True):
        return [decode_gray(axis, white, black, length=size[0], robust=robust) for axis in pairs * 2]

    oracle = cv2.structured_light.GrayCodePattern.create(*size)
    seconds, decoded = median_seconds(ours, runs)
    simple = median_seconds(lambda: ours(robust=False), runs)[0]
    started = time.perf_counter()
    oracle.decode([coded, coded], None, [black, black], [white, white])
    theirs = time.perf_counter() - started
    print(f"Gray code, {len(coded)} pictures of {width}x{height}, two cameras\n")
    print(f"{'':58} seconds    ratio")
    for name, own in (("robust classification", seconds), ("simple thresholding", simple)):
        print(f"{f'Scanstage, {name}, {1e9 * own / (2 * width * height):.1f} ns a pixel':58} {own:7.3f}")
    row("OpenCV contrib, GrayCodePattern.decode, one run, to robust", theirs, seconds)
    row("the same, to simple", theirs, simple)
    compared = same = 0
    for y, x in np.argwhere(decoded[0].valid & decoded[1].valid)[::37]:
        refused, place = oracle.getProjPixel(coded, int(x), int(y))
        compared += not refused
        same += not refused and place == (decoded[0].position[y, x], decoded[1].position[y, x])
    print(f"\n{same} of {compared} pixels that both accept are the same\n")


def gray_pictures(size, width, height):
    """Return 8-bit pictures of a rough surface under a Gray code, with noise, by the patterns' ids."""
    import numpy as np

    from addon.reconstruction.active.patterns import make_patterns

    random = np.random.default_rng(0)
    column = np.clip(np.linspace(0, size[0] - 1, width) + random.normal(0, 2, (height, width)), 0, size[0] - 1).astype(int)
    row = np.clip(np.linspace(0, size[1] - 1, height)[:, None] + random.normal(0, 2, (height, width)), 0, size[1] - 1).astype(int)
    albedo = random.uniform(0.05, 0.8, (height, width))
    return {pattern.id: np.clip(15 + albedo * pattern.image[row, column] + random.normal(0, 3, (height, width)), 0, 255).astype(np.uint8)
            for pattern in make_patterns("gray-code", size)}


if __name__ == "__main__":
    sys.exit(main())
