# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow carving beside the hull alone, and its growth with views and lights."""

from dataclasses import replace

from .measuring import BALLS, SIZE, VIEWS, box, entry, median_seconds, scene

SHADOW_VOXELS, SHADOW_LIGHTS = 256, 4


def time_shadows(runs, table):
    """Print what carving by shadows takes after the hull of the same scan, and how that grows with views and lights."""
    from addon.reconstruction.scan import Scan
    from addon.reconstruction.volumetric.shadow_carving import shadow_carving
    from addon.reconstruction.volumetric.visual_hull import visual_hull

    views, grid, runs = shadowed_scene(), box(SHADOW_VOXELS), max(1, runs // 2)
    for count, lights in ((VIEWS, SHADOW_LIGHTS), (VIEWS // 2, SHADOW_LIGHTS), (VIEWS, SHADOW_LIGHTS // 2)):
        scan = Scan(tuple(replace(view, lit=view.lit[:lights]) for view in views[::VIEWS // count]))
        hull, _ = median_seconds(lambda scan=scan: visual_hull(scan, grid, rule="conservative"), runs)
        table.own(f"conservative hull {SHADOW_VOXELS}^3, {count} views", hull)
        for rounds, name in ((1, "first round"), (100, "all rounds")):
            both, found = median_seconds(lambda scan=scan, rounds=rounds: shadow_carving(scan, grid, rounds=rounds), runs)
            counts = found.report["counts"]
            after = both - hull
            table.own(f"carving it by shadows, {name} ({counts['rounds']}), {count} x {lights}", after,
                      unit=f"{1000 * after / count / lights:.1f} ms a view and light", ratio=f"{after / hull:.1f} times its hull")


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
