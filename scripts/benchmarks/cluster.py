# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Workers beside one process, on one machine: the same bytes, and what spreading costs where nothing can be won."""

import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from .measuring import ROOT, SIZE, VIEWS, box, median_seconds, scene
from .shadows import shadowed_scene

WORKERS, MEMORY = 3, "2GiB"
PLAN = {"views": 8, "lights": 3, "resolution_x": 640, "resolution_y": 480}


@contextmanager
def workers(*options):
    """Start a scheduler and its workers as users do; yield a connection and the workers' processes."""
    from cluster.connection import connected

    def start(*arguments):
        process = subprocess.Popen([sys.executable, ROOT / "scripts" / "scanstage.py", *arguments], stdout=subprocess.PIPE,
                                   stderr=subprocess.DEVNULL, text=True)
        stack.callback(process.wait)
        stack.callback(process.kill)
        return process, process.stdout.readline().split()[2]

    with ExitStack() as stack:
        address = start("scheduler", "tcp://127.0.0.1:0")[1]
        processes = [start("worker", address, *options)[0] for _ in range(WORKERS)]
        yield stack.enter_context(connected(address)), processes


def killing(process, message):
    """Return a progress callable that kills a worker after the first piece of a kind of work is done."""
    def report(fraction, said):
        if said.startswith(message) and fraction > 0.3:
            process.kill()
    return report


def check_same(found, expected):
    if any(getattr(found.volume, name).tobytes() != getattr(expected.volume, name).tobytes() for name in ("brick_map", "bricks")):
        raise SystemExit("benchmark: workers and one process differ")
    if found.report != expected.report:
        raise SystemExit("benchmark: the reports of workers and one process differ")


def time_cluster(runs):
    """Print what hulls, shadow carving and captures take by workers, and check that all of it is what one process gives."""
    print(f"{WORKERS} workers on one machine, {VIEWS} views of {SIZE[0]}x{SIZE[1]}, three balls; medians of {runs}, start-up apart\n")
    time_hulls(runs)
    carve_within_memory()
    time_captures()


def time_hulls(runs):
    from cluster.volumes import Volumes

    from addon.reconstruction.scan import Scan, View
    from addon.reconstruction.volumetric.shadow_carving import shadow_carving
    from addon.reconstruction.volumetric.visual_hull import visual_hull

    scan = Scan(tuple(View(f"{number:04d}", camera, mask, None) for number, (camera, mask) in enumerate(zip(*scene(), strict=True))))
    shadows = Scan(tuple(replace(view, lit=view.lit) for view in shadowed_scene()))
    with workers() as (connection, processes):
        volumes = Volumes(connection)
        for voxels in (512, 1024):
            home, expected = median_seconds(lambda n=voxels: visual_hull(scan, box(n)), runs)
            away, found = median_seconds(lambda n=voxels: visual_hull(scan, box(n), carver=volumes.carver), runs)
            check_same(found, expected)
            line(f"hull {voxels}^3, identical bytes", home, away)
        home, expected = median_seconds(lambda: shadow_carving(shadows, box(256)), 1)
        away, found = median_seconds(lambda: shadow_carving(shadows, box(256), carver=volumes.carver, judge=volumes.judge), 1)
        check_same(found, expected)
        line(f"shadow carving 256^3, {len(shadows.views)} x {len(shadows.views[0].lit)}, identical bytes", home, away)
        start = time.perf_counter()
        check_same(shadow_carving(shadows, box(256), carver=volumes.carver, judge=volumes.judge,
                                  progress=killing(processes[2], "Carving by shadows")), expected)
        line("the same, one worker killed in the middle", home, time.perf_counter() - start)
    with workers() as (connection, processes):
        home, expected = median_seconds(lambda: visual_hull(scan, box(1024)), 1)
        start = time.perf_counter()
        found = visual_hull(scan, box(1024), carver=Volumes(connection).carver, progress=killing(processes[2], "Carving bricks"))
        check_same(found, expected)
        line("hull 1024^3, one worker killed in the middle", home, time.perf_counter() - start)
        print(f"  bytes to each worker {bytes_of_masks(scan, box(1024)):,}; back {bytes_of_bricks(expected.volume):,} for "
              f"{expected.volume.count():,} voxels, {len(expected.volume.bricks):,} mixed bricks of 8^3")


def carve_within_memory():
    """Carve 2048^3 by workers that may not take more than MEMORY each."""
    from cluster.volumes import Volumes

    from addon.memory import peak_memory
    from addon.reconstruction.scan import Scan, View
    from addon.reconstruction.volumetric.visual_hull import visual_hull

    scan = Scan(tuple(View(f"{number:04d}", camera, mask, None) for number, (camera, mask) in enumerate(zip(*scene(), strict=True))))
    with workers("--memory", MEMORY) as (connection, _):
        start = time.perf_counter()
        found = visual_hull(scan, box(2048), carver=Volumes(connection).carver)
        seconds = time.perf_counter() - start
        peaks = [peak / 2 ** 20 for peak in connection.everywhere(peak_memory).values()]
    start = time.perf_counter()
    check_same(found, visual_hull(scan, box(2048)))
    line(f"hull 2048^3, workers held to {MEMORY}, identical bytes", time.perf_counter() - start, seconds)
    print(f"  peak memory of a worker {max(peaks):.0f} MiB, of this process {peak_memory() / 2 ** 20:.0f} MiB")


def time_captures():
    """Capture a plan here, by workers, and by workers of which one is killed."""
    import bpy
    import cv2
    import numpy as np
    from cluster.frames import Frames

    from addon.cli.progress_bar import muted_stdout
    from addon.render.capture import capture_frames
    from addon.results.blend import new_file, save_blend
    from addon.stage import staging

    def capture(name, renderer=None, killed=None):
        start = time.perf_counter()
        with muted_stdout():
            for fraction, _ in capture_frames(bpy.context.scene, folder / name, renderer=renderer):
                if killed and fraction > 0.1:
                    killed.kill()
        pictures = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((folder / name / "images").glob("*.png"))]
        return time.perf_counter() - start, pictures

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        new_file()
        staging.build(bpy.context.scene, "shadow-array", "pot", PLAN)
        save_blend(folder / "pot.blend")
        home, expected = capture("home")
        sizes = [path.stat().st_size for path in (folder / "home" / "images").glob("*.png")]
        with workers() as (connection, processes):
            renderer = Frames(connection, folder / "pot.blend", [])
            for name, killed in (("capture", None), ("capture, one worker killed in the middle", processes[2])):
                away, pictures = capture(name, renderer, killed)
                if not all(np.array_equal(*pair) for pair in zip(pictures, expected, strict=True)):
                    raise SystemExit("benchmark: the pixels of workers and one process differ")
                line(f"{name}, {len(expected)} frames, identical pixels", home, away)
        print(f"  {PLAN['resolution_x']}x{PLAN['resolution_y']}: {home / len(expected):.3f} s and {np.mean(sizes):,.0f} bytes a frame, "
              f"the .blend {(folder / 'pot.blend').stat().st_size:,}")
        bpy.context.scene.render.resolution_x, bpy.context.scene.render.resolution_y = 3840, 2160
        start = time.perf_counter()
        with muted_stdout():
            list(capture_frames(bpy.context.scene, folder / "large", most=4))
        sizes = [path.stat().st_size for path in (folder / "large" / "images").glob("*.png")]
        print(f"  3840x2160: {(time.perf_counter() - start) / 4:.2f} s and {np.mean(sizes):,.0f} bytes a frame")


def line(name, home, away):
    print(f"{name:64} one process {home:7.2f} s   workers {away:7.2f} s   {away / home:5.2f} x", flush=True)


def bytes_of_masks(scan, grid):
    from cluster.packing import PackedSilhouettes

    from addon.reconstruction.volumetric.visual_hull import silhouettes_of

    packed = PackedSilhouettes.of(silhouettes_of(scan.views, rule="conservative", outside="unknown"))
    return sum(len(part.data) for part in (*packed.masks, *packed.known))


def bytes_of_bricks(volume):
    from cluster.packing import PackedVolume

    packed = PackedVolume.of(volume)
    return len(packed.brick_map.data) + len(packed.bricks.data)
