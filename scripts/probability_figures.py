# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of probabilities and votes, for scripts/figures.py: what they are worth."""

import tempfile
from dataclasses import replace
from pathlib import Path

from session import told
from tables import print_head, print_line

VOXELS = 64
NOISE = 10 / 255
HARD = (0.04, 0.05, 0.06, 0.07, 0.08, 0.1)
PRIOR = 0.65
RIG = {"arrangement": "dome", "views": 24, "elevation": 0.3, "resolution_x": 320, "resolution_y": 240}


def noise(bar):
    """Print IoU with the truth of probability > 0.5 and of hard carving, and how often 0.8 to 0.9 is right; return what is missed."""
    import numpy as np

    from addon.reconstruction import methods
    from addon.reconstruction.evaluation.voxelization import inside

    print_head("object", "method", "threshold", "IoU")
    missed = 0
    for name in ("dented-sphere", "monkey"):
        scan, truth, bounds = captured(name, "own", told(bar, name))
        scan = noisy(scan)
        soft = methods.reconstruct(scan, "probabilistic-carving", voxels=VOXELS, bounds=bounds, options={"noise": NOISE},
                                   progress=told(bar, name))
        true = inside(truth, soft.volume.grid).dense()
        start = hull(scan, bounds)
        ious = {threshold: overlap(carved(start, scan, threshold, told(bar, name)), true) for threshold in HARD}
        bar.close()
        own = overlap(soft.volume.dense(), true)
        print_line(name, "visual hull", "", f"{overlap(start.dense(), true):.4f}")
        for threshold, iou in ious.items():
            print_line(name, "generalized voxel coloring, deviation", threshold, f"{iou:.4f}")
        print_line(name, "probabilistic carving", "probability > 0.5", f"{own:.4f}")
        layer = soft.layers["probability"]
        probability, occupied = layer.values["probability"], true[tuple(layer.voxels.T)]
        chosen = (probability >= 0.8) & (probability < 0.9)
        share = float(np.mean(occupied[chosen]))
        print_line(name, f"{np.count_nonzero(chosen)} voxels of probability 0.8 to 0.9", "truly occupied", f"{share:.3f}")
        missed += (own <= max(ious.values())) + (not 0.70 <= share <= 0.95)
    return missed


def textureless(bar):
    """Print how far the probabilities of an object of one colour leave the prior; return whether that is too far."""
    missed = 0
    print_head("light", "voxels", "how many", "within 0.1 of the prior")
    for sun in (False, True):
        missed += unmoved(bar, sun) < 0.95 and not sun  # shading is texture
    return missed


def unmoved(bar, sun):
    """Print both rows for one light; return the share of voxels away from silhouettes that stay near the prior."""
    import numpy as np

    from addon.reconstruction import methods

    scan, _, bounds = captured("dented-sphere", "textureless", told(bar, "textureless"), sun=sun)
    found = methods.reconstruct(scan, "probabilistic-carving", voxels=VOXELS, bounds=bounds, progress=told(bar, "textureless"))
    bar.close()
    layer, grid = found.layers["probability"], found.volume.grid
    off = np.abs(layer.values["probability"] - PRIOR)
    edge = near_outlines(layer.voxels, grid, scan)
    light = "with a sun" if sun else "the same from all sides"
    print_line(light, "at silhouettes", np.count_nonzero(edge), f"{np.mean(off[edge] <= 0.1):.3f}")
    print_line(light, "elsewhere", np.count_nonzero(~edge), f"{np.mean(off[~edge] <= 0.1):.3f}")
    return np.mean(off[~edge] <= 0.1)


def near_outlines(voxels, grid, scan, reach=3.0):
    """Return which voxels some view sees within so many voxels of the silhouette's outline."""
    import cv2
    import numpy as np

    near = np.zeros(len(voxels), bool)
    for view in scan.views:
        (u, v), depth = np.moveaxis(view.camera.project(grid.centres(voxels))[0], -1, 0), view.camera.project(grid.centres(voxels))[1]
        inward = cv2.distanceTransform(view.mask.astype(np.uint8), cv2.DIST_L2, 5)
        size = view.camera.K[0, 0] * grid.voxel_size / depth
        width, height = view.camera.size
        pixel = np.clip(np.rint(v).astype(int), 0, height - 1), np.clip(np.rint(u).astype(int), 0, width - 1)
        near |= inward[pixel] < reach * size
    return near


def votes(bar):
    """Print what a space sweep finds of 500 points among 20 % clutter, with 0.5 px of noise; return what is missed."""
    import numpy as np

    from addon.reconstruction.geometry import Camera, VoxelGrid, look_at
    from addon.reconstruction.volumetric.edge_features import Features
    from addon.reconstruction.volumetric.space_sweep import chance_of_a_vote, sweep_planes, votes_needed

    grid = VoxelGrid.from_bounds((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8), 160)
    print_head("run", "votes needed", "recall", "precision", "of them within one plane")
    missed = 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        points, features = rng.uniform(-0.7, 0.7, (500, 3)), []
        for angle in 2 * np.pi * np.arange(7) / 7:
            R, t = look_at(4 * np.array([0.7 * np.cos(angle), 0.7 * np.sin(angle), 0.7]), (0, 0, 0))
            camera = Camera([[900, 0, 319.5], [0, 900, 239.5], [0, 0, 1]], R, t, (640, 480))
            seen = camera.project(points)[0] + 0.5 * rng.standard_normal((500, 2))
            features.append(Features.of(camera, np.vstack((seen, rng.uniform(-0.5, (639.5, 479.5), (100, 2))))))
        needed = votes_needed([chance_of_a_vote(each, grid, 1.0) for each in features], grid.count, 1.0)
        swept = sweep_planes(features, grid, reach=1.0, needed=needed, progress=told(bar, f"run {seed}"))
        bar.close()
        off = np.abs(points[:, None] - grid.centres(swept.cells[swept.peak])) / grid.voxel_size
        nearest = off.max(axis=2).argmin(axis=1)
        hit = off[np.arange(500), nearest]
        recall, precision = (hit.max(axis=1) <= 2).mean(), (off.max(axis=2).min(axis=0) <= 2).mean()
        plane = (hit[hit.max(axis=1) <= 2, 2] <= 1).mean()
        print_line(seed, needed, f"{recall:.3f}", f"{precision:.3f}", f"{plane:.3f}")
        missed += (recall < 0.95) + (precision < 0.95) + (plane < 0.95)
    return missed


def captured(name, material, progress, *, sun=True):
    """Capture a built-in object on the preset for voxel coloring; return its scan, the truth and a box round that.

    Without the sun the light is the same from all sides, and an object of one colour has one in the pictures, too.
    """
    import bpy
    import numpy as np

    from addon.captures.scan import load_scan
    from addon.cli.progress_bar import drain, muted_stdout
    from addon.render.capture import TRUTH, capture_frames
    from addon.results.blend import new_file
    from addon.results.ply import read_ply
    from addon.stage.staging import build

    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        folder = Path(folder)
        with muted_stdout():
            new_file()
            build(bpy.context.scene, "voxel-coloring", name, {**RIG, "material": material})
            if not sun:
                next(o for o in bpy.context.scene.objects if o.type == "LIGHT").data.energy = 0.0
            drain(capture_frames(bpy.context.scene, folder), progress)
        scan, truth = load_scan(folder, {"conservative": False}, progress), read_ply(folder / TRUTH)
        images = [view.read_image() for view in scan.views]
    views = tuple(replace(view, read_image=lambda image=image: image) for view, image in zip(scan.views, images, strict=True))
    return replace(scan, views=views), truth, truth.bounds() + np.array([[-0.01], [0.01]])


def noisy(scan):
    """Return the scan with noise in its pictures."""
    import numpy as np

    rng = np.random.default_rng(1)
    images = [np.clip(view.read_image() + NOISE * rng.standard_normal((*view.mask.shape, 3)), 0, 1).astype(np.float32)
              for view in scan.views]
    return replace(scan, views=tuple(replace(view, read_image=lambda image=image: image)
                                     for view, image in zip(scan.views, images, strict=True)))


def hull(scan, bounds):
    """Return the visual hull, unbiased."""
    from addon.reconstruction import methods

    return methods.reconstruct(scan, "visual-hull", voxels=VOXELS, bounds=bounds, options={"rule": "center"}).volume


def carved(start, scan, threshold, progress):
    """Return what generalized voxel coloring leaves of the same hull that probabilities begin with: dense bool."""
    from addon.reconstruction.volumetric.carving import Carving
    from addon.reconstruction.volumetric.consistency import Judge
    from addon.reconstruction.volumetric.footprints import Pictures
    from addon.reconstruction.volumetric.generalized_voxel_coloring import carve_by_sight
    from addon.reconstruction.volumetric.sight import Sight

    carving, pictures = Carving(start), Pictures.of(scan.views, start.grid)
    judge = Judge.of(consistency="deviation", threshold=threshold, noise=NOISE, min_views=2)
    carve_by_sight(carving, Sight(pictures, carving), judge, progress)
    return carving.frozen().dense()


def overlap(a, b):
    return (a & b).sum() / (a | b).sum()


TABLES = {"noise": noise, "textureless": textureless, "votes": votes}
