# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A laser's sheet of light lies in the plane that is read back, as wide as it says, however it is swept."""

import math

import bpy
import numpy as np
import pytest

from addon.captures.pictures import read_picture
from addon.stage import devices, laser, ownership, readback, scene_settings
from addon.stage.materials import matte

NORMAL = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])  # of the plane through the origin that is lit
WIDTH = 0.12


@pytest.fixture
def lit_scene(empty_scene):
    """Return a scene with a white tilted plane, a camera and a laser that is turned, beside the camera."""
    scene = empty_scene
    scene_settings.apply(scene, {**scene_settings.capture_settings(scene), "cycles.samples": 1, "cycles.max_bounces": 0, "render.resolution_x": 96,
                                 "render.resolution_y": 72, "render.use_persistent_data": True})
    scene.world = devices.dark_world()
    x = np.cross(NORMAL, (0, 1, 0))
    mesh = bpy.data.meshes.new("plane")
    mesh.from_pydata([(5 * (i * x + j * np.cross(NORMAL, x))).tolist() for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))], [], [(0, 1, 2, 3)])
    mesh.materials.append(matte("white", (1.0, 1.0, 1.0)))
    scene.collection.objects.link(bpy.data.objects.new("plane", mesh))
    scene.camera = devices.add_camera(scene.collection, 1, focal_length=35.0, sensor_width=36.0)
    devices.aim(scene.camera, np.array((0.0, -0.5, 1.5)), np.zeros(3))
    made = laser.add_laser(scene.collection, 1, width=WIDTH, fan=math.radians(40))
    made.data.color = (1.0, 1.0, 1.0)
    made.location, made.rotation_euler = (0.5, 0.1, 1.3), (0.1, 0.3, 0.2)
    bpy.context.view_layer.update()
    return scene


def light_on_plane(scene, folder, frame):
    """Return the picture of a frame, without the surface's cosine, and the points that its pixels see."""
    scene.frame_set(frame)
    scene.render.filepath = str(folder / "picture.png")
    bpy.ops.render.render(write_still=True)
    camera = readback.camera_of(scene, scene.camera)
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1])), -1))
    points = camera.centre - rays * (camera.centre @ NORMAL / (rays @ NORMAL))[..., None]
    source = np.array(scene.objects["Scanstage Laser 1"].matrix_world)[:3, 3]
    facing = (source - points) @ NORMAL / np.linalg.norm(source - points, axis=-1)
    return read_picture(folder / "picture.png", "linear")[0][..., 0] / facing, points


def turn(made):
    laser.sweep(made.data, [-0.2, 0.0, 0.15], [True] * 3)


def turn_the_object(made):
    for frame, angle in enumerate((0.3, 0.5, 0.4), start=1):
        made.rotation_euler.y = angle
        made.keyframe_insert("rotation_euler", index=1, frame=frame)


def move(made):
    for frame, x in enumerate((0.5, 0.3, 0.4), start=1):
        made.location.x = x
        made.keyframe_insert("location", index=0, frame=frame)


@pytest.mark.parametrize("drive", [turn, turn_the_object, move])
def test_the_light_is_a_gaussian_about_the_plane_that_is_read_back(lit_scene, tmp_path, drive):
    made = lit_scene.objects["Scanstage Laser 1"]
    drive(made)
    planes = []
    for frame in (1, 2, 3):
        light, points = light_on_plane(lit_scene, tmp_path, frame)
        fields = laser.laser_fields(made)
        *normal, offset = fields["plane"]
        planes.append(fields["plane"])
        assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-9) and fields["width"] == pytest.approx(WIDTH)
        beside = points @ normal - offset
        expected = np.exp(-0.5 * (beside / (WIDTH / 4)) ** 2)
        from_source = (points - np.array(made.matrix_world)[:3, 3]) @ np.array(made.matrix_world)[:3, :3]
        ahead = np.linalg.norm(np.delete(from_source, 1, axis=-1), axis=-1)
        inside = np.abs(from_source[..., 1]) < np.tan(math.radians(20)) * ahead
        edge = np.abs(np.abs(from_source[..., 1]) - np.tan(math.radians(20)) * ahead) < 0.01 * ahead + np.abs(beside)
        assert (expected[inside] > 0.9).sum() > 20
        np.testing.assert_allclose(light[~edge], (expected * inside)[~edge], atol=1e-3)  # single precision, over a hundredth of a width
    assert np.ptp(planes, axis=0).max() > 0.05


def test_positive_angles_are_to_its_right(lit_scene):
    made = lit_scene.objects["Scanstage Laser 1"]
    made.location, made.rotation_euler = (0, 0, 0), (0, 0, 0)
    bpy.context.view_layer.update()
    made.data.node_tree.nodes[laser.LASER].inputs["Angle"].default_value = 0.3
    normal, offset = laser.plane_of(made)
    assert normal @ (math.sin(0.3), 0, -math.cos(0.3)) == pytest.approx(0, abs=1e-7) and offset == 0


def test_a_laser_that_is_off_takes_no_light_from_another(lit_scene, tmp_path):
    made = lit_scene.objects["Scanstage Laser 1"]
    laser.sweep(made.data, [0.0, 0.0], [True, False])
    devices.add_light(lit_scene.collection, lit_scene.camera, 1, 1.0)
    made.hide_render = True
    alone, _ = light_on_plane(lit_scene, tmp_path, 2)
    made.hide_render = False
    both, _ = light_on_plane(lit_scene, tmp_path, 2)
    np.testing.assert_array_equal(alone, both)
    assert alone.min() > 0.1 and ownership.role_of(made) == "laser"
