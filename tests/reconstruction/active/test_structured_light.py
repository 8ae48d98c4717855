# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""From pictures under patterns to points and voxels: errors as predicted, poses merged, nothing of the object carved."""

import dataclasses
import re

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction import methods
from addon.reconstruction.active.measurement import view_normals
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.evaluation import point_measures, volume_measures
from addon.reconstruction.geometry import rotation_about
from addon.reconstruction.scan import Scan
from tests.projection import Round, Wall, projected_view
from tests.rigs import Ball, camera_at, sphere_mesh

BALL = Ball((0.0, 0.0, 0.0), 0.3)
BOX = np.array([[-0.4, -0.4, -0.4], [0.4, 0.4, 0.4]])


def turned(device, angle):
    motion = np.eye(4)
    motion[:3, :3] = rotation_about((0, 0, 1), angle)
    return device.moved(motion)


def ball_scan(camera, projector, *, poses, code="gray-code", bounds=BOX, wall=False, **how):
    """Return a scan of a ball on a turntable, in the object frame."""
    patterns = make_patterns(code, projector.size)
    views = []
    for number in range(poses):
        angle = 2 * np.pi * number / poses
        seen, lit = (turned(device, angle) for device in (camera, projector))
        backdrop = tuple(rotation_about((0, 0, 1), angle).T @ (0.0, -1.0, 0.0))  # stands still, while the object turns
        surfaces = [Round(BALL)] + ([Wall(backdrop, -0.6)] if wall else [])
        views.append(projected_view(seen, lit, patterns, surfaces, name=f"{number:04d}", **how))
    return Scan(tuple(views), bounds)


@pytest.mark.parametrize("lens", ["plain", "distorted"])
@pytest.mark.parametrize("axes", ["columns", "both"])
def test_points_lie_on_the_surface(camera, projector, scene, bent, lens, axes):
    camera, projector = (camera, projector) if lens == "plain" else (bent(camera), bent(projector))
    view = projected_view(camera, projector, make_patterns("phase-shift", projector.size, {"axes": axes}), scene)
    found = methods.reconstruct(Scan((view,), np.array([[-0.8, -0.8, -0.8], [0.8, 0.8, 0.8]])), "phase-shift", voxels=32)
    points = found.points.positions
    error = np.minimum(np.abs(np.linalg.norm(points, axis=1) - 0.3), np.abs(points[:, 1] - 0.6))
    assert len(points) > 10_000
    assert np.sqrt(np.mean(error ** 2)) <= 1e-4 * 2  # of the distance: the accuracy of the arc tangent, 1e-4 rad


@pytest.mark.parametrize(("code", "how"), [("phase-shift", {"noise": 2 / 255, "levels": 255}), ("gray-code", {})])
def test_measured_deviation_is_the_predicted_one(code, how):
    """Issue figure: within 20 %, on an oblique plane at a known depth."""
    camera = camera_at((0.0, -2.0, 0.1), focal=460.0, size=(160, 120))
    projector = camera_at((0.7, -1.9, 0.15), focal=360.0, size=(256, 192))
    normal = np.array([0.3, -1.0, 0.1]) / np.linalg.norm([0.3, -1.0, 0.1])
    view = projected_view(camera, projector, make_patterns(code, projector.size, {"axes": "columns"}), [Wall(tuple(normal), 0.0)], **how)
    cloud = methods.METHODS[code].measure(Scan((view,))).cloud
    rays = (cloud.positions - camera.centre) / np.linalg.norm(cloud.positions - camera.centre, axis=1, keepdims=True)
    along = (cloud.positions @ normal) / (rays @ normal)  # the error in the direction in which it is predicted
    assert len(cloud) > 10_000
    assert np.sqrt(np.mean(along ** 2)) == pytest.approx(np.sqrt(np.mean(cloud.sigma.astype(float) ** 2)), rel=0.2)


def test_normals_are_the_surfaces_and_point_to_the_camera(camera, projector, scene):
    view = projected_view(camera, projector, make_patterns("phase-shift", projector.size), scene, noise=1 / 255)
    cloud = methods.METHODS["phase-shift"].measure(Scan((view,))).cloud
    on_ball = np.abs(np.linalg.norm(cloud.positions, axis=1) - 0.3) < 0.02
    true = np.where(on_ball[:, None], cloud.positions / np.linalg.norm(cloud.positions, axis=1, keepdims=True), (0.0, -1.0, 0.0))
    cosine = (true * cloud.normals).sum(axis=1)
    assert np.median(cosine) > np.cos(np.radians(3))
    towards = camera.centre - cloud.positions
    assert ((cloud.normals * towards).sum(axis=1) > 0).mean() > 0.999
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-5)


def test_the_normals_of_a_plane_are_exact_and_lone_points_face_the_camera(camera):
    rows, columns = np.mgrid[:30, :40]
    rays = camera.rays(np.stack((columns, rows), -1)) @ camera.R.T
    normal = np.array([0.2, -0.3, -1.0]) / np.linalg.norm([0.2, -0.3, -1.0])
    points = rays * (-2.0 / (rays @ normal))[..., None]
    np.testing.assert_allclose(view_normals(points), np.broadcast_to(normal, points.shape), atol=1e-6)
    alone = np.zeros_like(points)
    alone[10, 10] = points[10, 10]
    np.testing.assert_allclose(view_normals(alone)[10, 10], -points[10, 10] / np.linalg.norm(points[10, 10]))


def test_poses_of_a_turntable_meet_in_one_surface(camera, projector):
    found = methods.reconstruct(ball_scan(camera, projector, poses=6, code="phase-shift"), "phase-shift", voxels=48)
    measures = point_measures(found.points, sphere_mesh(BALL, 64), samples=20_000, tolerance=0.03)
    assert set(found.points.view) == set(range(6))
    assert measures["accuracy_90"] < 1e-3 and measures["completeness"] > 0.9 and measures["count"] == len(found.points)
    assert found.report["counts"]["stray_points"] == 0
    assert len(found.colors.rgb) == len(found.surface.voxels)


@pytest.mark.parametrize("code", ["gray-code", "phase-shift"])
def test_free_space_takes_nothing_of_the_object_and_reaches_its_surface(camera, projector, code):
    scan = ball_scan(camera, projector, poses=6, code=code, wall=True)
    found = methods.reconstruct(scan, code, voxels=40, options={"fill": "solid"})
    measures = volume_measures(found.volume, sphere_mesh(BALL, 64))
    assert measures["truth_voxels_removed"] == 0
    # What lies farther out than the margin, 1.5 voxels, and half a voxel, is free wherever a camera saw the ball or the wall behind.
    centres = found.volume.grid.centres(np.argwhere(found.volume.dense()))
    near = np.abs(centres[:, 2]) < 0.1  # the belt that all devices see
    outside = np.linalg.norm(centres[near], axis=1) - 0.3
    assert np.quantile(outside, 0.99) < 3 * found.volume.grid.voxel_size


def test_points_that_another_view_sees_through_are_dropped(camera, projector):
    scan = ball_scan(camera, projector, poses=4, code="phase-shift", wall=True)
    clean = methods.reconstruct(scan, "phase-shift", voxels=40)
    measured = methods.METHODS["phase-shift"].measure(scan)
    ghost = dataclasses.replace(measured.cloud.chosen(slice(0, 1)), positions=np.array([[0.0, -0.38, 0.0]]))
    spoilt = dataclasses.replace(measured, cloud=type(ghost).joined([measured.cloud, ghost]))
    outcome = methods.METHODS["phase-shift"].function(scan, clean.volume.grid, measured=spoilt)
    assert outcome.report["counts"]["stray_points"] == clean.report["counts"]["stray_points"] + 1
    assert not (outcome.points.positions == ghost.positions).all(axis=1).any()
    assert (outcome.volume.dense() == clean.volume.dense()).all()


def test_bounds_hold_the_points_where_none_are_given(camera, projector):
    found = methods.reconstruct(ball_scan(camera, projector, poses=6, bounds=None), "gray-code", voxels=32)
    assert (found.volume.grid.origin < -0.3).all() and (found.volume.grid.upper > 0.3).all()
    assert (found.volume.grid.upper - found.volume.grid.origin < 0.9).all()


def refused(scan, method, words):
    with pytest.raises(ScanstageError, match=re.escape(words)) as caught:
        methods.reconstruct(scan, method, voxels=16)
    assert "\n" not in str(caught.value)


def test_what_cannot_be_measured_is_said_in_a_sentence(camera, projector, scene):
    plain = projected_view(camera, projector, make_patterns("gray-code", projector.size), scene)
    refused(Scan((dataclasses.replace(plain, projected=()),)), "gray-code", "no frame of the capture was taken under a pattern")
    refused(Scan((plain,), np.array([[5.0, 5, 5], [6, 6, 6]])), "gray-code", "lies in the working volume")
    behind = projected_view(camera, camera, make_patterns("gray-code", camera.size), scene)
    refused(Scan((behind,)), "gray-code", "frame 0001: its projector stands where the camera does")
    lost = [dataclasses.replace(picture, projector=None) for picture in plain.projected]
    refused(Scan((dataclasses.replace(plain, projected=tuple(lost)),)), "gray-code", "its pattern has no projector")
