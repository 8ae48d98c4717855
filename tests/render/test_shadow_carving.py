# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The promise of shadow carving, from the renderer to the measure: no voxel of an object is ever removed."""

import math
from dataclasses import replace

import bpy  # before OpenCV, which the captures bring: both have libraries of their own

# isort: split
import bmesh
import numpy as np
import pytest
from mathutils import Euler, Matrix
from turntable_captures import paint_a_patch

from addon.captures.scan import load_scan
from addon.reconstruction import methods
from addon.reconstruction.evaluation.measures import volume_measures
from addon.reconstruction.evaluation.voxelization import wholly_inside
from addon.reconstruction.scan import Scan
from addon.reconstruction.shadows import ShadowMasks
from addon.reconstruction.volumetric.volume import SparseVolume
from addon.render.capture import TRUTH, capture_frames
from addon.results.ply import read_ply
from addon.stage import staging
from addon.stage.shadow_array import SHAPES
from tests.naive_shadows import naive

SEEDS = range(20)
VOXELS = 64
SIZE = {"resolution_x": 240, "resolution_y": 180}  # some 2.5 pixels a voxel


def random_object(random):
    """Add a random object to the scene: three to six balls, boxes and cones, their union closed by a remesh; 10 to 25 cm."""
    cage, mesh = bmesh.new(), bpy.data.meshes.new("random")
    for _ in range(random.integers(3, 7)):
        matrix = Matrix.LocRotScale(random.uniform(-0.08, 0.08, 3), Euler(random.uniform(0, 2 * math.pi, 3)), random.uniform(0.3, 1.2, 3))
        kind = random.integers(3)
        if kind == 0:
            bmesh.ops.create_icosphere(cage, subdivisions=3, radius=0.06, matrix=matrix)
        elif kind == 1:
            bmesh.ops.create_cube(cage, size=0.09, matrix=matrix)
        else:
            bmesh.ops.create_cone(cage, cap_ends=True, segments=24, radius1=0.06, radius2=random.uniform(0.01, 0.06), depth=0.12, matrix=matrix)
    cage.to_mesh(mesh)
    cage.free()
    made = bpy.data.objects.new("random", mesh)
    bpy.context.scene.collection.objects.link(made)
    union = made.modifiers.new("Union", "REMESH")
    union.mode, union.voxel_size = "VOXEL", 0.004
    return made


def random_rig(random):
    """Return options of the preset."""
    return {"views": int(random.integers(4, 6)), "lights": int(random.integers(2, 5)), "array": str(random.choice(list(SHAPES))),
            "elevations": f"{random.uniform(5, 60):.3f}"}


def captured(subject, options, folder, change=None):
    """Return the scan of an object on the stage, with its shadows, and the truth."""
    staging.build(bpy.context.scene, "shadow-array", subject, {**SIZE, **options})
    if change:
        change(bpy.context.scene)
    list(capture_frames(bpy.context.scene, folder))
    return load_scan(folder, shadow_options={}), read_ply(folder / TRUTH)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Return a function that gives the scan, the truth and the carving of the random object and rig of a seed, made once."""
    known = {}

    def run(seed):
        if seed not in known:
            bpy.ops.wm.read_factory_settings(use_empty=True)
            random = np.random.default_rng(seed)
            scan, truth = captured(random_object(random), random_rig(random), tmp_path_factory.mktemp("random"))
            known[seed] = scan, truth, carved(scan)
        return known[seed]

    return run


def carved(scan, **options):
    return methods.reconstruct(scan, "shadow-carving", voxels=VOXELS, options=options)


def holds_all_of(volume, truth):
    """Return whether a volume lacks no voxel that lies wholly inside the truth, of which there are some."""
    return wholly_inside(truth, volume.grid).count() > 0 and volume_measures(volume, truth)["truth_voxels_removed"] == 0


@pytest.mark.parametrize("seed", SEEDS)
def test_no_voxel_of_a_random_object_is_removed(runs, seed):
    _, truth, found = runs(seed)
    # A volume only shrinks from one view, light and round to the next: the last one lacks what any step before has removed.
    assert holds_all_of(found.volume, truth)


def test_the_random_objects_put_the_promise_to_the_test(runs):
    """Most of them have hollows that are carved."""
    assert sum(runs(seed)[2].report["counts"]["carved"] > 0 for seed in SEEDS) > len(SEEDS) / 2


def test_the_naive_rule_would_be_found_out(runs):
    """Of the same objects and rigs."""
    assert any(loses_by_the_naive_rule(*runs(seed)[:2]) for seed in SEEDS)


def loses_by_the_naive_rule(scan, truth):
    hull = methods.reconstruct(scan, "visual-hull", voxels=VOXELS).volume
    left = SparseVolume.from_dense(hull.grid, hull.dense() & ~naive(scan, hull))
    return not holds_all_of(left, truth)


# --- dark paint ----------------------------------------------------------------------------------------------------------------

@pytest.fixture(scope="module")
def painted(tmp_path_factory):
    """The scans of the dented sphere as it is and with a dark patch, and the truth."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rig = {"views": 6, "lights": 3}
    plain, truth = captured("dented-sphere", rig, tmp_path_factory.mktemp("plain"))
    return plain, captured("dented-sphere", rig, tmp_path_factory.mktemp("painted"), paint_a_patch)[0], truth


def test_dark_paint_carves_nothing(painted):
    plain, patched, truth = painted
    with_paint, without = carved(patched).volume, carved(plain).volume
    assert holds_all_of(with_paint, truth)
    # Of a patch nothing is decided: it hides shadows, and adds none.
    assert sum(view.shadows.decidable.sum() for view in patched.views) < sum(view.shadows.decidable.sum() for view in plain.views)
    assert not (without.dense() & ~with_paint.dense()).any()


def test_paint_that_is_taken_for_shadow_would_be_found_out(painted):
    """By one threshold for each picture, as shadows are found where there is one light only."""
    _, patched, truth = painted
    views = []
    for view in patched.views:
        dark = [(picture.read_image().mean(axis=2) < 0.03) & view.mask for picture in view.lit]
        bits = np.bitwise_or.reduce([mask.astype(np.uint8) << np.uint8(number) for number, mask in enumerate(dark)])
        views.append(replace(view, shadows=ShadowMasks(bits, view.mask)))
    assert not holds_all_of(carved(Scan(tuple(views))).volume, truth)
