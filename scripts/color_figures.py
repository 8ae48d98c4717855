# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of the methods that carve by colour, for scripts/figures.py: what a held-back camera sees, what is lost, how
deep a bowl becomes, and how well each photo-consistency measure tells a surface from thin air."""

import math
import os
import tempfile
from pathlib import Path

from session import told
from tables import print_head, print_line

ROOT = Path(__file__).resolve().parents[1]
METHODS = ("visual-hull", "voxel-coloring", "space-carving", "generalized-voxel-coloring")
OBJECTS = ("knot", "dented-sphere")
VOXELS, VIEWS = 200, 24
EQUAL = 0.1  # dB
LEAST_PSNR, MOST_LOST, LEAST_DEPTH, LEAST_AUC = 28.0, 1e-3, 0.7, 0.95
PHOTOGRAPH_THRESHOLD = 0.15  # the lamps of both sets keep still while the object turns: no surface looks the same in all views
SETS = (("squirrel", "turntable_squirrel", "opencv"), ("dinosaur", "dino_sparse_ring", "middlebury"))
GREY = 0.214  # linear, behind the object in both pictures
OFF = 3  # voxels


def held_back(bar):
    """Print what a camera half way between two of the ring sees of each result; return how many figures are missed."""
    from addon.captures.scan import load_scan
    from addon.reconstruction import methods
    from addon.reconstruction.scan import Scan

    print_head("object", "method", "PSNR in the box of the silhouette, dB", "PSNR inside the silhouette, dB", "excess", "seconds")
    missed = 0
    for name in OBJECTS:
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            truth = captured(name, Path(folder), told(bar, name), {"views": 2 * VIEWS})
            scan = load_scan(folder, {"conservative": False})  # silhouettes neither too large nor too small, on average
            held, seen = scan.views[VIEWS + 1], Scan(scan.views[::2], scan.bounds)
            boxed = {}
            for method in METHODS:
                options = {"rule": "center"} if method == "visual-hull" else {}
                found = methods.reconstruct(seen, method, voxels=VOXELS, options=options, progress=told(bar, f"{name}, {method}"))
                boxed[method], inside = picture_quality(found, held)
                bar.close()
                print_line(name, method, f"{boxed[method]:.2f}", f"{inside:.2f}", f"{against(found.volume, truth)[1]:.4f}",
                            round(sum(found.report["seconds"].values()), 1))
            hull, coloring, sweeps, exact = (boxed[method] for method in METHODS)
            missed += (coloring < LEAST_PSNR) + (exact < sweeps - EQUAL) + (min(sweeps, exact) <= hull)
    return missed


def losses(bar):
    """Print what each method loses of the object's surface, with silhouettes that cover it; return how many lose too much."""
    from addon.captures.scan import load_scan
    from addon.reconstruction import methods

    print_head("object", "method", "truth's surface lost", "at most", "excess")
    missed = 0
    for name in OBJECTS:
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            truth = captured(name, Path(folder), told(bar, name), {"views": VIEWS})
            scan = load_scan(folder)
            for method in METHODS[1:]:
                found = methods.reconstruct(scan, method, voxels=VOXELS // 2, progress=told(bar, f"{name}, {method}"))
                lost, excess = against(found.volume, truth)
                missed += lost > MOST_LOST
                bar.close()
                print_line(name, method, f"{lost:.3%}", f"{MOST_LOST:.1%}", f"{excess:.4f}")
    return missed


def picture_quality(found, view):
    """Return the peak signal-to-noise ratios of a result, as a view would show it, against the view's own picture.

    The result is rendered by its item buffer, one ray a pixel as in the picture. Both stand before grey and are compared as
    a screen shows them: in the box round the silhouette, and inside it, two pixels from the outline.
    """
    import cv2
    import numpy as np

    from addon.reconstruction.color import linear_to_srgb
    from addon.reconstruction.volumetric.item_buffer import item_buffer

    items = item_buffer(found.surface, found.volume.grid, view.camera)[0]
    shown = np.where((items >= 0)[..., None], found.colors.rgb[items], GREY)
    real = np.where(view.mask[..., None], view.read_image(), GREY)
    square = ((linear_to_srgb(np.clip(shown, 0, 1)) - linear_to_srgb(np.clip(real, 0, 1))) ** 2).mean(axis=2)
    rows, columns = np.nonzero(view.mask)
    box = square[rows.min():rows.max() + 1, columns.min():columns.max() + 1]
    inside = square[cv2.erode(view.mask.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0]
    return tuple(-10 * math.log10(part.mean()) for part in (box, inside))


def captured(name, folder, progress, options):
    """Capture a built-in object under the preset voxel-coloring; return the truth."""
    import bpy

    from addon.cli.progress_bar import drain, muted_stdout
    from addon.render.capture import TRUTH, capture_frames
    from addon.results.blend import new_file
    from addon.results.ply import read_ply
    from addon.stage.staging import build

    with muted_stdout():
        new_file()
        build(bpy.context.scene, "voxel-coloring", name, options)
        drain(capture_frames(bpy.context.scene, folder), progress)
    return read_ply(folder / TRUTH)


def against(volume, truth):
    """Return the share of the truth's surface voxels that a volume lost, and what it has too much as a share of the truth."""
    from addon.reconstruction.volumetric.surface import extract_surface

    real = solid(truth, volume.grid)
    surface = extract_surface(real).voxels
    extra = sum(int((a & ~b).sum()) for a, b in zip(volume.slabs(), real.slabs(), strict=True))
    return float((~volume.contains(surface)).mean()), extra / real.count()


def solid(truth, grid):
    """Return the voxels of a grid whose centres lie inside a mesh."""
    from addon.reconstruction.evaluation.voxelization import inside

    return inside(truth, grid)


def bowl(bar):
    """Print how much of the pot's inside, which no silhouette shows, each method recovers; return how many figures are missed."""
    import numpy as np

    from addon.captures.scan import load_scan
    from addon.reconstruction import methods

    print_head("pot", "depth of the inside that the hull misses and the method recovers", "at least")
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        truth = captured("pot", Path(folder), told(bar, "pot"), {"views": 36, "arrangement": "dome", "elevation": math.radians(20)})
        scan = load_scan(folder)
        tops = {}
        for method in METHODS:
            found = methods.reconstruct(scan, method, voxels=VOXELS // 2, progress=told(bar, method)).volume
            tops[method] = found
        hull = tops["visual-hull"]
        middle = np.array(hull.grid.shape[:2]) // 2
        real = column_tops(solid(truth, hull.grid), middle)
        filled = column_tops(hull, middle)
        shares = {method: float((filled - column_tops(tops[method], middle)).sum() / (filled - real).sum()) for method in METHODS[1:]}
    bar.close()
    for method, share in shares.items():
        print_line(method, f"{share:.1%}", f"{LEAST_DEPTH:.0%}" if method == METHODS[-1] else "-")
    return int(shares[METHODS[-1]] < LEAST_DEPTH)


def column_tops(volume, middle):
    """Return the number of the highest occupied voxel in the columns within a tenth of the grid about the middle."""
    import numpy as np

    reach = volume.grid.shape[0] // 10
    columns = volume.dense()[middle[0] - reach:middle[0] + reach, middle[1] - reach:middle[1] + reach]
    return (columns * np.arange(1, columns.shape[2] + 1)).max(axis=2)


def consistency(bar):
    """Print how well each measure tells the surface from three voxels off it; return how many are below the figure."""
    from addon.captures.scan import load_scan

    print_head("measure", "area under the curve", "monotone", "own threshold", "surface refused", "off it refused")
    missed = 0
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        truth = captured("dented-sphere", Path(folder), told(bar, "dented-sphere"), {"views": VIEWS})
        for measure, *scores in measure_scores(load_scan(folder), truth, VOXELS // 2):
            area = area_under_curve(*scores)
            missed += area < LEAST_AUC
            print_line(measure.name, f"{area:.4f}", measure.monotone.value, measure.threshold,
                        *(f"{(part > measure.threshold).mean():.2%}" for part in scores))
    return missed


def measure_scores(scan, truth, voxels):
    """Yield each measure of photo-consistency with its scores of the truth's surface, and of a surface `OFF` voxels off it."""
    import numpy as np

    from addon.reconstruction import methods
    from addon.reconstruction.geometry import VoxelGrid
    from addon.reconstruction.volumetric.carving import Carving
    from addon.reconstruction.volumetric.consistency import MEASURES, Judge
    from addon.reconstruction.volumetric.footprints import Pictures
    from addon.reconstruction.volumetric.generalized_voxel_coloring import samples_of
    from addon.reconstruction.volumetric.sight import Sight
    from addon.reconstruction.volumetric.volume import SparseVolume

    box = methods.METHODS["generalized-voxel-coloring"].bounds(scan)
    grid = VoxelGrid.from_bounds(box[0] - 0.1 * np.ptp(box), box[1] + 0.1 * np.ptp(box), voxels)
    pictures = Pictures.of(scan.views, grid, cells=True)
    real = solid(truth, grid).dense()
    sights = [Sight(pictures, Carving(SparseVolume.from_dense(grid, volume))) for volume in (real, grown(real, OFF))]
    for name, measure in MEASURES.items():
        judge = Judge.of(consistency=name, threshold=0.0, noise=0.01, min_views=2)
        scores = []
        for sight in sights:
            samples = samples_of(sight, sight.seen(), judge)
            scores.append(measure.scores(samples, judge.noise)[samples.views >= 3])
        yield measure, *scores


def grown(occupancy, steps):
    """Return a dense volume that is larger by so many voxels on all sides."""
    import numpy as np

    for _ in range(steps):
        padded = np.pad(occupancy, 1)
        for axis in range(3):
            padded = padded | np.roll(padded, 1, axis) | np.roll(padded, -1, axis)
        occupancy = padded[1:-1, 1:-1, 1:-1]
    return occupancy


def area_under_curve(good, bad):
    """Return the chance that one of the bad scores above one of the good, ties counted half (Mann & Whitney, 1947)."""
    import numpy as np

    good = np.sort(good)
    return float((np.searchsorted(good, bad) + np.searchsorted(good, bad, side="right")).mean() / (2 * len(good)))


def photographs(bar):
    """Print what the photographs give; the results, with their pictures, stay in the folder that SCANSTAGE_RESULTS names."""
    from addon.captures.importers import import_capture
    from addon.workflow import reconstruct

    data = Path(os.environ.get("SCANSTAGE_DATA", ROOT.parent / "shared" / "data"))
    print_head("photographs", "method", "coloured", "unseen", "removed", "mean silhouette IoU", "seconds")
    for name, source, layout in SETS:
        if not (data / source).is_dir():
            continue
        with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
            import_capture(layout, data / source, Path(folder, "capture"), progress=told(bar, name))
            for method in METHODS[2:]:
                result = Path(os.environ.get("SCANSTAGE_RESULTS", folder), f"{name}-{method}")
                report = reconstruct(Path(folder, "capture"), method, result, voxels=VOXELS // 2,
                                     options={"consistency_threshold": PHOTOGRAPH_THRESHOLD},
                                     progress=told(bar, f"{name}, {method}"))
                bar.close()
                counts = report["counts"]
                print_line(name, method, counts["coloured"], counts["unseen"], counts["removed"],
                            f"{report['silhouette_iou']['mean']:.4f}", round(sum(report["seconds"].values()), 1))
    return 0


TABLES = {"held-back": held_back, "losses": losses, "bowl": bowl, "consistency": consistency, "color-photographs": photographs}
