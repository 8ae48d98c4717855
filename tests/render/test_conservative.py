# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The promise of the conservative rule, from the renderer to the measure: no part of an object is ever carved."""

import bpy  # before OpenCV, which the captures bring: both have libraries of their own
import pytest

from addon.captures.scan import load_scan
from addon.reconstruction import methods
from addon.reconstruction.evaluation.measures import volume_measures
from addon.reconstruction.evaluation.voxelization import wholly_inside
from addon.render.capture import TRUTH, capture_frames
from addon.results.ply import read_ply
from addon.stage import staging

NAIVE = {"conservative": False}


@pytest.fixture(scope="module", params=["figure", "knot"])
def capture(request, tmp_path_factory):
    """The capture set of an object with thin parts, or of one whose parts hide each other; pixels of about 2 mm."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, folder = bpy.context.scene, tmp_path_factory.mktemp(request.param)
    staging.build(scene, "turntable", request.param, {"views": 8, "resolution_x": 160, "resolution_y": 120})
    list(capture_frames(scene, folder))
    return folder


def carve(folder, voxels, rule, silhouette):
    """Return the measures of a hull, and how many voxels lie wholly inside the truth."""
    scan = load_scan(folder, silhouette)
    volume = methods.reconstruct(scan, "visual-hull", voxels=voxels, options={"rule": rule}).volume
    truth = read_ply(folder / TRUTH)
    return volume_measures(volume, truth), wholly_inside(truth, volume.grid).count()


@pytest.mark.parametrize("voxels", [40, 96])
def test_the_conservative_rule_removes_nothing_of_the_object(capture, voxels):
    measures, inside = carve(capture, voxels, "conservative", {})
    assert inside > 0 and measures["truth_voxels_removed"] == 0
    assert measures["loss"] == 0  # not even voxels that the object fills by half, which the count above leaves out


def test_the_naive_rule_would_be_found_out(capture):
    # Half of the outline's pixels and voxels have their centres outside what they hold a part of.
    assert carve(capture, 40, "center", NAIVE)[0]["loss"] > 0
    # A voxel wholly inside is lost only where more than half a voxel, here half a pixel, is missing from a mask.
    assert carve(capture, 96, "center", {**NAIVE, "erode": 1})[0]["truth_voxels_removed"] > 0


def test_an_eroded_mask_is_found_out_even_under_the_conservative_rule(capture):
    assert carve(capture, 96, "conservative", {**NAIVE, "erode": 2})[0]["truth_voxels_removed"] > 0
