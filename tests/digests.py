# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstructs small synthetic scans by every method, and prints digests of what it was given and of the files it wrote.

    python -m tests.digests FOLDER THREADS [METHOD ...]

The pictures are rounded to 16 bits as in a file, so that two Pythons whose numpy computes a sine differently in the last bit are
given the same.
"""

import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

BOUNDS = np.array([[-1.0, -1, -1], [1, 1, 1]])
FILES = ("volume.npz", "mesh.ply", "points.ply", "preview.png", "result.json")
TIMES = ("seconds", "memory", "peak_memory")


def scan_for(method):
    """Return a scan that a method can use."""
    from addon.reconstruction.active.patterns import make_patterns
    from addon.reconstruction.scan import ProjectedPicture, Scan, View
    from tests.depth_sensors import box_about, wall_view
    from tests.desk import desk, strips
    from tests.projection import Round, laser_view, projected_view, sight
    from tests.reconstruction.active.test_stereo import pair_of_views
    from tests.reconstruction.volumetric.test_shadow_carving import TRAY, scan_of
    from tests.rigs import Ball, camera_at, marbled, painted_views, ring

    ball = Ball((0.1, 0.0, -0.1), 0.7)
    if method == "shadow-carving":
        shadows = scan_of(ring(4, elevation=30, focal=90, size=(80, 60)), TRAY)
        return Scan(tuple(replace(view, read_image=lambda mask=view.mask: np.repeat(np.float32(0.5) * mask[..., None], 3, axis=2))
                          for view in shadows.views), BOUNDS)
    if method == "stereo":
        return pair_of_views(plain=False)
    if method == "laser-stripe":
        return Scan((laser_view(camera_at((0.0, -2.0, 0.1), focal=230.0, size=(120, 90)), frames=40),), BOUNDS)
    if method == "speckle":
        return Scan((wall_view(1.0),), box_about(1.0))
    if method == "desk-shadow":
        scene = desk(camera=camera_at((0.0, -0.8, 0.65), (0.0, 0.08, 0.05), focal=150.0, size=(120, 90)))
        return Scan((scene.view(scene.sweep(frames=40, strips=strips(scene))),), np.array([[-0.4, -0.4, -0.1], [0.4, 0.5, 0.4]]))
    if method == "color-stripes":
        from tests.stripes import BALL, CAMERA, PROJECTOR, SAMPLES, WALL, colored_picture

        seen, patterns = sight(CAMERA.scaled(SAMPLES), PROJECTOR, [BALL, WALL], 1.0), make_patterns("color-stripes", PROJECTOR.size)
        paint = np.full(seen.points.shape, 0.8)
        shots = tuple(ProjectedPicture(p.id, p.fields, "projector", PROJECTOR, lambda image=image: image) for p, image in (
            (p, colored_picture(seen, paint, p, crosstalk=np.eye(3), seed=n)) for n, p in enumerate(patterns)))
        return Scan((View("0001", CAMERA, None, shots[0].read_image, projected=shots),), BOUNDS)
    if method in ("gray-code", "phase-shift"):
        camera, projector = (camera_at(place, focal=100, size=(100, 75)) for place in ((0, -4, 0.2), (0.7, -3.9, 0.3)))
        return Scan((projected_view(camera, projector, make_patterns(method, projector.size), [Round(ball)], ambient=0.02),), BOUNDS)
    above = [camera_at((2 * np.cos(a), 2 * np.sin(a), 4.0), focal=110, size=(80, 60)) for a in np.pi * np.arange(6) / 3]
    if method == "space-sweep":  # with few edges, so that they do not agree by chance
        return Scan(tuple(painted_views(ring(8, focal=180, size=(160, 120)), [ball], lambda points: np.repeat(
            np.where(np.sin(9 * points[:, 2:]) > 0, 0.7, 0.3), 3, axis=1))), BOUNDS)
    views = painted_views(above if method == "voxel-coloring" else ring(8, focal=90, size=(80, 60)), [ball], marbled)
    return Scan(tuple(views), BOUNDS)


def rounded(scan):
    """Return a scan whose pictures have 16 bits."""
    def like_a_file(read):
        return lambda: (np.rint(np.clip(read(), 0, 1) * 65535) / 65535).astype(np.float32)

    return replace(scan, views=tuple(
        replace(view, read_image=like_a_file(view.read_image),
                projected=tuple(replace(shot, read_image=like_a_file(shot.read_image)) for shot in view.projected)) for view in scan.views))


def given(scan):
    """Return a digest of all that a scan holds."""
    found = hashlib.sha256()
    for view in scan.views:
        for array in (view.camera.K, view.camera.R, view.camera.t, np.zeros(0) if view.mask is None else view.mask, view.read_image(),
                      *(shot.read_image() for shot in view.projected)):
            found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def written(path):
    if path.name != "result.json":
        return hashlib.sha256(path.read_bytes()).hexdigest()
    report = {key: value for key, value in json.loads(path.read_text()).items() if key not in TIMES}
    return hashlib.sha256(json.dumps(report, sort_keys=True).encode()).hexdigest()


def main():
    folder, threads, chosen = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
    import cv2

    cv2.setNumThreads(threads)
    from addon.reconstruction import methods
    from addon.reconstruction.preview import render_preview, upward
    from addon.results.folder import write_result

    for method in chosen or [name for name, entry in methods.METHODS.items() if not entry.cuts_solids]:
        scan = rounded(scan_for(method))
        found = methods.reconstruct(scan, method, voxels=32)
        preview = render_preview(found.surface, found.volume.grid, found.colors.rgb, up=upward([view.camera for view in scan.views]))
        write_result(folder / method, volume=found.volume, surface=found.surface, colors=found.colors, report=found.report, preview=preview,
                     layers=found.layers, pictures=found.pictures, mesh=found.mesh, points=found.points)
        files = {name: written(folder / method / name) for name in FILES if (folder / method / name).exists()}
        print(json.dumps([method, given(scan), files]), flush=True)


if __name__ == "__main__":
    main()
