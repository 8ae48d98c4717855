# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras keep the ordinal visibility constraint; matte surfaces look the same from all of them, shiny ones do not."""

import math

import bpy

# isort: split
import numpy as np
import pytest
from mathutils.bvhtree import BVHTree

from addon.captures.pictures import read_picture
from addon.captures.store import read_capture
from addon.errors import ScanstageError
from addon.render.capture import capture_frames
from addon.results.ply import read_ply
from addon.stage import devices, readback, staging, voxel_coloring
from addon.stage.objects import BUILTINS

SMALL = {"views": 3, "resolution_x": 160, "resolution_y": 120}


def capture(scene, folder):
    list(capture_frames(scene, folder))
    return read_capture(folder)


@pytest.mark.parametrize("arrangement", ["above", "arc", "dome"])
@pytest.mark.parametrize("name", BUILTINS)
def test_all_cameras_stand_above_the_object_and_see_it_whole(empty_scene, arrangement, name):
    staging.build(empty_scene, "voxel-coloring", name, {"arrangement": arrangement, "views": 5, "elevation": math.radians(15)})
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    assert len(plan.frames) == len(plan.cameras) == 5
    for camera in plan.cameras.values():
        assert camera.centre[2] > vertices[:, 2].max()
        pixels, depth = camera.project(vertices)
        assert (depth > 0).all() and (pixels > 0).all() and (pixels < np.array(camera.size) - 1).all()
    assert all(np.array_equal(frame.object_to_world, np.eye(4)) and frame.lights == ("sun",) for frame in plan.frames)


def test_directions_cover_what_the_arrangement_says():
    ring, arc, dome = (voxel_coloring.directions(name, 200, math.radians(30)) for name in ("above", "arc", "dome"))
    for found in (ring, arc, dome):
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-12)
    np.testing.assert_allclose(ring[:, 2], 0.5)
    np.testing.assert_allclose(ring.sum(axis=0)[:2], 0, atol=1e-12)  # all round
    np.testing.assert_allclose(arc[:, 2], 0.5)
    assert (arc[:, 1] < 1e-12).all() and np.ptp(arc[:, 0]) == pytest.approx(2 * math.cos(math.radians(30)))
    assert dome[:, 2].min() == pytest.approx(0.5) and dome[:, 2].max() == pytest.approx(math.sin(math.radians(85)))
    # Evenly: the mean direction of a cap between two heights is straight up, at the mean of the heights.
    np.testing.assert_allclose(dome.mean(axis=0), (0, 0, (0.5 + math.sin(math.radians(85))) / 2), atol=0.01)


def test_a_distance_that_breaks_the_constraint_is_refused(empty_scene):
    with pytest.raises(ScanstageError, match=r"option distance: at 0\.12 m and 30 degrees a camera is no higher"):
        staging.build(empty_scene, "voxel-coloring", "figure", {"distance": 0.12})


def test_a_matte_surface_has_the_radiance_of_the_formula(empty_scene, tmp_path):
    staging.build(empty_scene, "voxel-coloring", "dented-sphere", {**SMALL, "material": "textureless"})
    sun, = (o for o in empty_scene.objects if o.type == "LIGHT")
    to_sun = np.array(sun.matrix_world.col[2])[:3]
    empty_scene.objects["dented-sphere"].data.shade_flat()  # the triangles' normals are then the shading's
    found = capture(empty_scene, tmp_path)
    truth = read_ply(tmp_path / "truth.ply")
    tree = BVHTree.FromPolygons(truth.vertices.tolist(), truth.triangles.tolist())
    for frame in found.frames:
        camera = found.camera_of(frame)
        rgb, alpha = read_picture(tmp_path / frame.image, "linear")
        rows, columns = np.nonzero(alpha == 1)
        rays = camera.rays(np.stack((columns, rows), axis=-1).astype(float))
        normals = np.array([tree.ray_cast(tuple(camera.centre), tuple(ray))[1] or (0, 0, 0) for ray in rays.tolist()])
        expected = devices.AMBIENT + (1 - devices.AMBIENT) * np.maximum(normals @ to_sun, 0)
        error = np.abs(rgb[rows, columns] / voxel_coloring._PLAIN - expected[:, None]).max(axis=1)
        # A ray next to an edge may meet the neighbour, since the sample is up to 0.01 px off the centre.
        assert (error < 1e-3).mean() > 0.98


@pytest.mark.parametrize("material", ["own", "shiny"])
def test_one_sample_is_free_of_noise(empty_scene, tmp_path, material):
    staging.build(empty_scene, "voxel-coloring", "pot", {**SMALL, "views": 2, "material": material})
    capture(empty_scene, tmp_path / "a")
    empty_scene.cycles.seed = 77
    empty_scene.render.use_persistent_data = False  # nor does keeping the geometry change a picture
    found = capture(empty_scene, tmp_path / "b")
    for frame in found.frames:
        first, second = (read_picture(tmp_path / folder / frame.image, "linear")[0] for folder in "ab")
        np.testing.assert_array_equal(first, second)


def spread_between_views(folder):
    """Return, for random points of the true surface, the largest difference between the views that see it."""
    found, truth = read_capture(folder), read_ply(folder / "truth.ply")
    tree = BVHTree.FromPolygons(truth.vertices.tolist(), truth.triangles.tolist())
    corners = truth.vertices[truth.triangles]
    corners = corners[np.random.default_rng(3).choice(len(corners), 400)]
    points, normals = corners.mean(axis=1), np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    low, high = np.full((len(points), 3), np.inf), np.full((len(points), 3), -np.inf)
    for frame in found.frames:
        camera = found.camera_of(frame)
        rgb, _ = read_picture(folder / frame.image, "linear")
        pixels = np.rint(camera.project(points)[0]).astype(int)
        hits = [tree.ray_cast(tuple(camera.centre), tuple(point - camera.centre))[0] for point in points]
        distances = [np.linalg.norm(np.array(hit) - point) if hit else np.inf for hit, point in zip(hits, points, strict=True)]
        toward = (camera.centre - points) / np.linalg.norm(camera.centre - points, axis=1, keepdims=True)
        # Not at grazing angles, where the pixel's centre lies several pixels' worth of surface away, or beside the object.
        seen = (np.array(distances) < 1e-4) & ((toward * normals).sum(axis=1) > 0.4)
        colors = rgb[pixels[seen, 1], pixels[seen, 0]]
        low[seen], high[seen] = np.minimum(low[seen], colors), np.maximum(high[seen], colors)
    spread = (high - low).max(axis=1)
    return spread[np.isfinite(spread)]


def test_shiny_breaks_the_lambertian_assumption_and_matte_keeps_it(empty_scene, tmp_path):
    # One scene for both: an override that was rendered before must not be seen again.
    spreads = {}
    for material in ("shiny", "matte", "textureless"):
        options = {"views": 8, "resolution_x": 320, "resolution_y": 240, "material": material}
        staging.build(empty_scene, "voxel-coloring", "dented-sphere", options)
        capture(empty_scene, tmp_path / material)
        spreads[material] = spread_between_views(tmp_path / material)
    # A point's pixel is half a pixel off at most: on a plain surface only smooth shading can change over that.
    assert np.percentile(spreads["textureless"], 95) < 0.02
    assert np.percentile(spreads["shiny"], 95) > 2 * np.percentile(spreads["matte"], 95)
    assert np.percentile(spreads["shiny"], 98) > 0.3


def test_a_users_override_comes_back(empty_scene):
    override = bpy.data.materials.new("Clay")
    layer, = empty_scene.view_layers
    layer.material_override = override
    staging.build(empty_scene, "voxel-coloring", "knot", {**SMALL, "material": "own"})
    assert layer.material_override == override
    for material in ("shiny", "textureless"):  # the second must not take the first's for the user's
        staging.build(empty_scene, "voxel-coloring", "knot", {**SMALL, "material": material})
        assert layer.material_override != override
    staging.remove(empty_scene)
    assert layer.material_override == override
    assert [material.name for material in bpy.data.materials] == ["Clay"]
