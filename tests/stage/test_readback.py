# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is read back is what Blender renders: cameras to hundredths of a pixel, poses to single precision."""

import math

import bpy

# isort: split
import bmesh  # exists once bpy is imported
import cv2
import numpy as np
import pytest
from mathutils import Matrix

from addon.errors import ScanstageError
from addon.reconstruction.geometry import look_at, rotation_about
from addon.stage import readback, scene_settings, staging

MARKERS = np.array([(x, y, z) for x in (-0.5, 0.1, 0.5) for y in (-0.4, 0.5) for z in (-0.32, 0.0, 0.3)])
RADIUS = 0.035

LENSES = {
    "landscape": {},
    "portrait": {"resolution_x": 120, "resolution_y": 160},
    "shift": {"shift_x": 0.07, "shift_y": -0.05},
    "portrait with shift": {"resolution_x": 120, "resolution_y": 160, "shift_x": -0.06, "shift_y": 0.04},
    "vertical sensor": {"sensor_fit": "VERTICAL", "sensor_height": 30.0},
    "horizontal sensor in portrait": {"resolution_x": 120, "resolution_y": 160, "sensor_fit": "HORIZONTAL",
                                      "lens": 35.0},
    "percentage that truncates": {"resolution_x": 333, "resolution_y": 251, "resolution_percentage": 49},
    "wide pixels": {"pixel_aspect_x": 1.5, "shift_x": 0.03, "shift_y": 0.05},
    "tall pixels": {"pixel_aspect_y": 1.3, "resolution_y": 140, "shift_y": 0.05},
    "scaled camera": {"scale": 2.5},
}


def add_cube(scene, name="cube", size=0.2, location=(0, 0, 0)):
    mesh = bpy.data.meshes.new(name)
    shape = bmesh.new()
    bmesh.ops.create_cube(shape, size=size)
    shape.to_mesh(mesh)
    shape.free()
    cube = bpy.data.objects.new(name, mesh)
    cube.location = location
    scene.collection.objects.link(cube)
    return cube


def add_markers(scene):
    mesh = bpy.data.meshes.new("markers")
    shape = bmesh.new()
    for position in MARKERS:
        bmesh.ops.create_icosphere(shape, subdivisions=3, radius=RADIUS, matrix=Matrix.Translation(position))
    shape.to_mesh(mesh)
    shape.free()
    scene.collection.objects.link(bpy.data.objects.new("markers", mesh))


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_markers_are_rendered_where_the_camera_projects_them(empty_scene, tmp_path, lens):
    scene = empty_scene
    add_markers(scene)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    centre = np.array((0.9, -3.0, 0.8))
    R, _ = look_at(centre, (0.03, 0.02, -0.01))
    scale = (lens.get("scale", 1.0),) * 3
    camera.matrix_basis = Matrix.LocRotScale(centre, Matrix((R.T @ np.diag((1, -1, -1))).tolist()), scale)
    scene_settings.apply(scene, scene_settings.capture_settings(scene))
    settings = {"resolution_x": 160, "resolution_y": 120, "film_transparent": True,
                "filepath": str(tmp_path / "picture")}
    for name, value in {**settings, **lens}.items():
        if name != "scale":
            setattr(scene.render if hasattr(scene.render, name) else camera.data, name, value)
    # Coverage, not centres: many samples, each over its whole pixel.
    scene.cycles.samples, scene.cycles.pixel_filter_type = 256, "BOX"
    bpy.context.view_layer.update()

    found = readback.camera_of(scene, camera)
    bpy.ops.render.render(write_still=True)
    picture = cv2.imread(str(tmp_path / "picture.png"), cv2.IMREAD_UNCHANGED)

    assert picture.shape[1::-1] == found.size
    pixels, depth = found.project(MARKERS)
    alpha = picture[..., 3] / 65535
    reach = np.ceil(found.K[[0, 1], [0, 1]] * RADIUS / depth.min()).astype(int) + 1
    inside = ((pixels > reach + 1) & (pixels < np.array(found.size) - reach - 2)).all(axis=1)
    assert inside.sum() >= 6  # most of the picture is tested, not its middle alone
    # A ball's outline is centred within (radius / distance)^2 * 80 px = 0.01 px of its centre; 256 samples of an edge
    # pixel leave another 0.01 px.
    errors = [np.linalg.norm(centroid(alpha, pixel, reach) - pixel)
              for pixel, others in zip(pixels[inside], np.flatnonzero(inside), strict=True)
              if (np.abs(np.delete(pixels, others, 0) - pixel) > 2 * reach + 2).any(axis=1).all()]
    assert len(errors) >= 4
    assert max(errors) < 0.05


def centroid(alpha, near, reach):
    u, v = np.round(near).astype(int)
    rows, columns = np.mgrid[v - reach[1]:v + reach[1] + 1, u - reach[0]:u + reach[0] + 1]
    weight = alpha[rows, columns]
    return np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()


def test_orthographic_camera_is_refused(empty_scene):
    camera = bpy.data.objects.new("Flat", bpy.data.cameras.new("Flat"))
    camera.data.type = "ORTHO"
    with pytest.raises(ScanstageError, match="'Flat' is not a perspective camera"):
        readback.camera_of(empty_scene, camera)


def test_no_stage_is_said(empty_scene):
    for read in (readback.plan_of, readback.truth_mesh):
        with pytest.raises(ScanstageError, match="no stage: build one first"):
            read(empty_scene)


def test_poses_are_equal_steps(empty_scene):
    staging.build(empty_scene, "turntable", "knot", {"views": 24})
    plan = readback.plan_of(empty_scene)
    assert [frame.number for frame in plan.frames] == list(range(1, 25))
    for i, frame in enumerate(plan.frames):
        expected = np.eye(4)
        expected[:3, :3] = rotation_about((0, 0, 1), 2 * math.pi * i / 24)
        np.testing.assert_allclose(frame.object_to_world, expected, atol=1e-6)  # Blender's are of single precision


def test_cameras_and_lights_alternate_within_a_pose(empty_scene):
    staging.build(empty_scene, "turntable", "knot", {"views": 3, "elevations": "10,40,-20"})
    plan = readback.plan_of(empty_scene)
    assert [frame.camera for frame in plan.frames] == ["camera-1", "camera-2", "camera-3"] * 3
    assert [frame.lights for frame in plan.frames] == [("light-1",), ("light-2",), ("light-3",)] * 3
    for number, elevation in (("1", 10), ("2", 40), ("3", -20)):
        camera, light = plan.cameras[f"camera-{number}"], plan.lights[f"light-{number}"]
        assert math.degrees(math.asin(-camera.forward[2])) == pytest.approx(elevation, abs=1e-4)
        np.testing.assert_allclose(light.position, camera.centre, atol=1e-6)
        assert light.kind == "point" and light.radius == 0


def test_reading_leaves_frame_and_camera(empty_scene):
    staging.build(empty_scene, "turntable", "knot", {"views": 3, "elevations": "10,40"})
    empty_scene.frame_set(4)
    camera = empty_scene.camera
    readback.plan_of(empty_scene)
    readback.truth_mesh(empty_scene)
    assert (empty_scene.frame_current, empty_scene.camera) == (4, camera)


def test_a_camera_that_moves_is_one_device_for_each_pose(empty_scene):
    staging.build(empty_scene, "turntable", "knot", {"views": 4})
    camera = empty_scene.camera
    for frame, x in ((1, 0.0), (3, 0.1)):
        camera.location.x = x
        camera.keyframe_insert("location", index=0, frame=frame)
    plan = readback.plan_of(empty_scene)
    assert [frame.camera for frame in plan.frames] == ["camera-1", "camera-1-2", "camera-1-3", "camera-1-3"]
    assert plan.cameras["camera-1-3"].centre[0] == pytest.approx(0.1, abs=1e-6)


def test_truth_is_in_the_object_frame_at_every_angle(empty_scene):
    cube = add_cube(empty_scene, location=(1.0, -2.0, 0.5))
    staging.build(empty_scene, "turntable", cube, {"views": 5})
    at_start, _ = readback.truth_mesh(empty_scene)
    empty_scene.frame_start = 3  # the table has turned by 144 degrees
    turned, triangles = readback.truth_mesh(empty_scene)
    corners = np.array([(x, y, z) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.2)])
    for vertices in (at_start, turned):
        rows = vertices[np.lexsort(vertices.round(3).T[::-1])]
        np.testing.assert_allclose(rows, corners, atol=1e-6)
    assert signed_volume(turned, triangles) == pytest.approx(0.2 ** 3, rel=1e-5)


def test_truth_has_render_levels_instances_and_children(empty_scene):
    cube = add_cube(empty_scene)
    modifier = cube.modifiers.new("Array", "ARRAY")
    modifier.count, modifier.use_relative_offset, modifier.use_constant_offset = 3, False, True
    modifier.constant_offset_displace = (0.5, 0, 0)
    modifier.show_viewport = False  # what only renders have counts
    hidden = cube.modifiers.new("Subdivision", "SUBSURF")
    hidden.show_render = False  # and what only the viewport has does not
    child = add_cube(empty_scene, "child", location=(0, 1, 0))
    child.parent, child.scale = cube, (-1, 1, 1)  # mirrored: its faces must still look outward
    library = bpy.data.collections.new("library")
    library.objects.link(bpy.data.objects.new("part", cube.data))
    group = bpy.data.objects.new("instance", None)
    group.instance_type, group.instance_collection, group.parent = "COLLECTION", library, cube
    group.location = (0, 2, 0)
    empty_scene.collection.objects.link(group)
    staging.build(empty_scene, "turntable", cube, {"views": 2})
    vertices, triangles = readback.truth_mesh(empty_scene)
    assert signed_volume(vertices, triangles) == pytest.approx(5 * 0.2 ** 3, rel=1e-4)


@pytest.mark.parametrize("kind", ["CURVE", "FONT", "META"])
def test_truth_of_what_is_no_mesh(empty_scene, kind):
    if kind == "META":
        data = bpy.data.metaballs.new("ball")
        data.elements.new().radius = 1.0
        data.resolution = data.render_resolution  # so that the viewport's evaluation, below, may stand for the render's
    else:
        data = bpy.data.curves.new("curve", kind)
        if kind == "FONT":
            data.body, data.extrude = "O", 0.1
        else:
            data.dimensions, data.bevel_depth = "3D", 0.1
            spline = data.splines.new("POLY")
            spline.points.add(2)
            spline.points.foreach_set("co", [0, 0, 0, 1, 1, 0, 0, 1, 1, 1, 0, 1])
            spline.use_cyclic_u = True
    subject = bpy.data.objects.new("subject", data)
    empty_scene.collection.objects.link(subject)
    staging.build(empty_scene, "turntable", subject, {"views": 2})
    vertices, triangles = readback.truth_mesh(empty_scene)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    expected = subject.evaluated_get(depsgraph).to_mesh()
    assert len(triangles) == sum(len(polygon.vertices) - 2 for polygon in expected.polygons)


def test_area_light_is_refused(empty_scene):
    staging.build(empty_scene, "turntable", "knot", {"views": 2})
    empty_scene.collection.objects.link(bpy.data.objects.new("Softbox", bpy.data.lights.new("Softbox", "AREA")))
    with pytest.raises(ScanstageError, match="'Softbox' is an area light"):
        readback.plan_of(empty_scene)


def signed_volume(vertices, triangles):
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)
