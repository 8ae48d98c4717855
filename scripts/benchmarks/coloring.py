# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxel coloring at the size of Seitz and Dyer's paper, beside a compiled projection and gather."""

import ctypes

from .measuring import BALLS, SIZE, box, compiled, compiler, median_seconds

PAPER_VOXELS, PAPER_VIEWS = 197, 21  # 7.6 million voxels: Seitz and Dyer, 1997


def compare_coloring(runs, table):
    """Print what voxel coloring tests and colours at the size of Seitz and Dyer's dinosaur, and how long it takes."""
    import numpy as np

    from addon.reconstruction.scan import Scan
    from addon.reconstruction.volumetric.voxel_coloring import voxel_coloring

    views = painted_scene()
    grid = box(PAPER_VOXELS)
    seconds, found = median_seconds(lambda: voxel_coloring(Scan(views), grid, start="box", consistency="chi-square", noise=0.03), runs)
    counts = found.report["counts"]
    pairs = counts["tested"] * len(views)
    table.own(f"voxel coloring, {counts['tested']:,} voxels tested in {len(views)} views, {counts['coloured']:,} coloured", seconds,
              unit=f"{1e9 * seconds / pairs:.1f} ns a voxel and view")
    name = "compiled projection and gather alone, one thread"
    if compiler() is None:
        table.peer(name, None, seconds)
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
    table.own(name, reference, unit=f"{unit:.1f} ns a voxel and view",
              ratio=f"voxel coloring takes {1e9 * seconds / pairs / unit:.1f} times it")


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
