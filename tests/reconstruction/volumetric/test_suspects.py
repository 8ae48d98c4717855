# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A view whose mask or pose is wrong is named; views that are only noisy are not."""

from dataclasses import replace

import numpy as np
import pytest

from addon.reconstruction.geometry import rotation_about
from addon.reconstruction.methods import reconstruct
from addon.reconstruction.scan import Scan
from tests.rigs import Ball, Box, ring, views_of

SHAPES = [Ball((0.0, 0.0, -0.2), 0.45), Box((0.55, 0.0, 0.2), (0.35, 0.12, 0.2), np.eye(3)), Ball((-0.3, 0.3, 0.5), 0.25)]
BOUNDS = np.array([[-1.1] * 3, [1.1] * 3])


@pytest.fixture(scope="module")
def views():
    found = views_of(ring(36, elevation=25, focal=240, size=(200, 160)), SHAPES)
    return tuple(replace(view, read_image=lambda: np.full((160, 200, 3), 0.5, np.float32)) for view in found)


def warnings_of(views, method="visual-hull", **options):
    report = reconstruct(Scan(tuple(views), BOUNDS), method, voxels=48, options=options).report
    return [warning for warning in report["warnings"] if "do not fit the others" in warning]


def test_nobody_is_suspected_where_all_is_well(views):
    assert warnings_of(views) == []


@pytest.mark.parametrize("wrong", [5, 20])
def test_another_views_mask_is_named(views, wrong):
    changed = list(views)
    changed[wrong] = replace(views[wrong], mask=views[(wrong + 13) % 36].mask)
    warning, = warnings_of(changed)
    assert f"1 of 36 views do not fit the others' (share in common): frame {views[wrong].name} (" in warning
    assert "tolerance=1" in warning


def test_methods_of_colour_name_it_too_and_offer_no_tolerance(views):
    changed = list(views)
    changed[5] = replace(views[5], mask=views[18].mask)
    warning, = warnings_of(changed, "generalized-voxel-coloring")
    assert f"frame {views[5].name} (" in warning and "tolerance" not in warning


def test_a_wrong_pose_is_named(views):
    turned = np.eye(4)
    turned[:3, :3] = rotation_about((0, 0, 1), np.radians(30))
    changed = list(views)
    changed[9] = replace(views[9], camera=views[9].camera.moved(turned))
    warning, = warnings_of(changed)
    assert f"frame {views[9].name} (" in warning and "1 of 36" in warning


def test_salt_and_pepper_in_all_masks_suspects_nobody_and_tolerance_keeps_the_object(views):
    random = np.random.default_rng(4)
    changed = [replace(view, mask=view.mask ^ (random.random(view.mask.shape) < 0.01)) for view in views]
    assert warnings_of(changed, tolerance=3, rule="center") == []
    clean, noisy = (reconstruct(Scan(tuple(chosen), BOUNDS), "visual-hull", voxels=48, options={"tolerance": 3, "rule": "center"}).volume
                    for chosen in (views, changed))
    both = (clean.dense() & noisy.dense()).sum()
    assert both / clean.count() > 0.97  # of 36 views, four must be wrong in one place
