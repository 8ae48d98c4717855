# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures of points, against brute force and on a ball whose distances are a formula."""

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.evaluation import point_measures
from addon.reconstruction.evaluation.distances import nearest_distances
from addon.reconstruction.mesh import TriangleMesh
from addon.reconstruction.points import PointCloud
from tests.rigs import Ball, sphere_mesh

RANDOM = np.random.default_rng(8)
TRUTH = sphere_mesh(Ball((5.0, -3.0, 2.0), 0.5), 96)


def cloud_at(positions):
    count = len(positions)
    return PointCloud(positions, np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count), np.zeros(count))


def shell(count, radius, half=False):
    directions = RANDOM.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    if half:
        directions[:, 2] = np.abs(directions[:, 2])
    return np.array([5.0, -3.0, 2.0]) + radius * directions


@pytest.mark.parametrize("centre", [0.0, 1000.0])
def test_nearest_distances_are_those_of_brute_force(centre):
    points, others = RANDOM.normal(centre, 1, (200, 3)), RANDOM.normal(centre, 1, (300, 3))
    np.testing.assert_allclose(nearest_distances(points, others), np.linalg.norm(points[:, None] - others, axis=2).min(axis=1), rtol=1e-5)


def test_distances_are_those_from_the_ball():
    found = point_measures(cloud_at(shell(20_000, 0.52)), TRUTH, samples=20_000, tolerance=0.03)
    # The mesh's faces lie up to half a thousandth of the radius inside the ball.
    for measure in ("accuracy_90", "median", "rms"):
        assert found[measure] == pytest.approx(0.02, abs=4e-4)
    assert found["completeness"] == 1.0 and found["count"] == 20_000


def test_half_of_the_truth_is_half_complete():
    found = point_measures(cloud_at(shell(20_000, 0.5, half=True)), TRUTH, samples=20_000, tolerance=0.01)
    assert found["completeness"] == pytest.approx(0.5, abs=0.02)


def test_no_points_and_no_truth():
    assert point_measures(cloud_at(np.zeros((0, 3))), TRUTH) == {"count": 0, "accuracy_90": None, "median": None, "rms": None, "completeness": 0.0}
    with pytest.raises(ScanstageError, match="truth: the mesh has no faces"):
        point_measures(cloud_at(np.zeros((1, 3))), TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), int)))


@pytest.mark.parametrize(("change", "words"), [
    ({"positions": np.full((2, 3), np.nan)}, "positions must be"), ({"normals": np.zeros((3, 3))}, "normals must be"),
    ({"sigma": np.array([1.0, np.inf])}, "sigma must be"),
])
def test_a_cloud_that_cannot_be_is_refused(change, words):
    fields = {"positions": np.zeros((2, 3)), "normals": np.zeros((2, 3)), "colors": np.zeros((2, 3)), "sigma": np.zeros(2), "view": np.zeros(2)}
    with pytest.raises(ValueError, match=words):
        PointCloud(**{**fields, **change})
