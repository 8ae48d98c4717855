# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Two scenes of a few blocks that give the same two pictures, and what methods that carve by colour make of these.

The blocks form a floor with stripes of two colours. Two distant cameras look down at it from both sides, at 45 degrees. A block at
(x, z) is seen by the left one at x + z and by the right one at x - z; raised by two, a block moves by two in opposite
directions, and finds the same colours again, for four blocks are one period: the wallpaper illusion.

What carving keeps is the union of all that the pictures allow, at the size of its voxels: it holds both scenes, and cusps before them.
"""

import numpy as np
from tables import Table

from addon.reconstruction import methods
from addon.reconstruction.color import linear_to_srgb
from addon.reconstruction.geometry import Camera, VoxelGrid, look_at
from addon.reconstruction.scan import Scan, View
from addon.reconstruction.volumetric.item_buffer import item_buffer
from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.volume import SparseVolume

from . import drawing
from .experiment import Experiment

BLOCKS, RAISED = (12, 4, 4), 2  # along x, y and z; layers by which the middle of the second scene stands higher
FINE = 4  # voxels along a block
BEYOND = 4  # blocks of the second scene's floor that are left at either end: twice what the middle is raised by
COLORS = np.array([[0.70, 0.22, 0.02], [0.02, 0.18, 0.45]])  # linear
PIXELS = 16  # to which x grows by one block
SIZE = (320, 240)
FAR = 1e5  # blocks: there a block's displacement by perspective is a hundredth of a pixel
GRID = VoxelGrid((0.0, 0.0, 0.0), 1 / FINE, tuple(FINE * n for n in BLOCKS))
METHODS = ("voxel-coloring", "space-carving")
OPTIONS = {"start": "hull", "consistency": "pairwise"}
"""A monotone measure: what carving leaves then holds every scene that gives the pictures."""


def scenes():
    """Return the two scenes by name, each as the (x, y, z) bool array of its blocks."""
    floor = np.zeros(BLOCKS, bool)
    floor[:, :, 0] = True
    platform = np.zeros(BLOCKS, bool)
    platform[:BEYOND, :, 0] = platform[-BEYOND:, :, 0] = True
    platform[RAISED:-RAISED, :, RAISED] = True
    return {"floor": floor, "platform": platform}


def stripe_of(x, z):
    """Return the number of the colour of blocks: stripes are two blocks wide, and raised blocks have the other colour."""
    return (np.asarray(x) + 1 + np.asarray(z)) // 2 % 2


def fine(blocks):
    """Return an array of blocks as one of voxels."""
    return np.kron(blocks, np.ones((FINE,) * 3, blocks.dtype))


def cameras():
    """Return the left and the right camera, with x along their pictures' rows. Where a block begins or ends lies between two pixels."""
    middle, focal = np.array([BLOCKS[0] / 2, BLOCKS[1] / 2, 0.0]), PIXELS * np.sqrt(2) * FAR
    K = [[focal, 0, (SIZE[0] - 1) / 2], [0, focal, (SIZE[1] - 1) / 2], [0, 0, 1]]
    found = []
    for side in (-1, 1):
        R, t = look_at(middle + FAR * np.array([side, 0, 1]) / np.sqrt(2), middle)
        roll = np.array([[0, side, 0], [-side, 0, 0], [0, 0, 1]])
        found.append(Camera(K, roll @ R, roll @ t, SIZE))
    return found


def shown(surface, rgb, camera):
    """Return the picture (h, w, 3) of a surface whose voxels have these colours (s, 3), and where it shows any, (h, w) bool."""
    items = item_buffer(surface, GRID, camera)[0]
    return np.where((items >= 0)[..., None], rgb[items], 0).astype(np.float32), items >= 0


def pictures_of(blocks):
    """Return the two pictures of a scene and their masks."""
    surface = extract_surface(SparseVolume.from_dense(GRID, fine(blocks)))
    x, _, z = (surface.voxels // FINE).T
    return [shown(surface, COLORS[stripe_of(x, z)], camera) for camera in cameras()]


def scan_of(blocks):
    """Return the scan that the two cameras take of a scene."""
    views = tuple(View(side, camera, mask, lambda picture=picture: picture)
                  for side, camera, (picture, mask) in zip(("left", "right"), cameras(), pictures_of(blocks), strict=True))
    return Scan(views, np.array([(0.0, 0.0, 0.0), BLOCKS], float))


def reconstructed(progress):
    """Return what each of `METHODS` makes of the pictures, by its name."""
    scan = scan_of(scenes()["floor"])
    return {method: methods.reconstruct(scan, method, voxels=max(GRID.shape), options=OPTIONS, progress=progress) for method in METHODS}


def differing(found):
    """Return the share of the pixels in which the cameras see a coloured voxel of a result where the pictures have another colour."""
    wrong = total = 0
    told = np.repeat(found.colors.views[:, None] > 0, 3, axis=1)
    for camera, (picture, mask) in zip(cameras(), pictures_of(scenes()["floor"]), strict=True):
        again, colored = (shown(found.surface, values, camera)[0] for values in (found.colors.rgb, told))
        judged = mask & (colored[..., 0] > 0)
        other = np.abs(again - picture).max(axis=2) > np.ptp(COLORS, axis=0).max() / 2
        wrong, total = wrong + np.count_nonzero(judged & other), total + np.count_nonzero(judged)
    return wrong / total


def tabulate(found):
    solid = {name: fine(blocks) for name, blocks in scenes().items()}
    volumes = {**solid, **{method: each.volume.dense() for method, each in found.items()}}
    rows = []
    for name, volume in volumes.items():
        own = (found[name].report["counts"]["coloured"], differing(found[name])) if name in found else (None, None)
        rows.append((name, int(volume.sum()), *(float((volume & scene).sum() / scene.sum()) for scene in solid.values()), *own))
    note = (f"{' and '.join(str(np.count_nonzero(blocks)) for blocks in scenes().values())} blocks of {FINE} x {FINE} x {FINE} voxels, "
            "whose pictures agree in every pixel. Carving is by the greatest pairwise distance of colours, a monotone measure, and keeps "
            "what only one camera sees, without a colour.")
    return Table(("scene or result", "voxels", "share of the floor that it holds", "share of the platform that it holds",
                  "coloured voxels", "their pixels of another colour"), tuple(rows), note)


def section(occupied, colors):
    """Return the middle section across y as a (z, x, 3) picture; ``colors`` (x, y, z, 3) are linear, NaN where there is none."""
    y = occupied.shape[1] // 2
    cut = np.where(np.isnan(colors[:, y]), 0.6, linear_to_srgb(np.clip(np.nan_to_num(colors[:, y]), 0, 1)))
    return np.where(occupied[:, y, :, None], cut, 1.0).transpose(1, 0, 2)


def draw(found, out):
    figure, axes = drawing.panels(900, 700, 3, 2)
    for panel, camera, (picture, mask) in zip(axes[0], ("left", "right"), pictures_of(scenes()["floor"]), strict=True):
        panel.imshow(np.where(mask[..., None], linear_to_srgb(picture), 1.0)[60:-60, 20:-20])
        panel.set_title(f"picture of the {camera} camera, of both scenes")
        drawing.bare(panel)
    cuts = {}
    for name, blocks in scenes().items():
        x, _, z = np.indices(BLOCKS)
        colors = np.stack([fine(channel) for channel in np.moveaxis(COLORS[stripe_of(x, z)], -1, 0)], -1)
        cuts[f"scene: {name}"] = section(fine(blocks), colors)
    for name, result in found.items():
        colors = np.full((*GRID.shape, 3), np.nan)
        told = result.colors.views > 0
        colors[tuple(result.surface.voxels[told].T)] = result.colors.rgb[told]
        cuts[f"result: {name}"] = section(result.volume.dense(), colors)
    for panel, (title, cut) in zip(axes[1:].ravel(), cuts.items(), strict=True):
        panel.imshow(cut, origin="lower", extent=(0, BLOCKS[0], 0, BLOCKS[2]), interpolation="nearest")
        panel.set(title=title, xlabel="x, blocks", ylabel="z")
    drawing.save(figure, out, EXPERIMENT.name)


def run(out, progress):
    found = reconstructed(progress)
    draw(found, out)
    return tabulate(found)


EXPERIMENT = Experiment("uniqueness", "Two scenes that give the same two pictures, and what carving by colour makes of them: a third.", run)
