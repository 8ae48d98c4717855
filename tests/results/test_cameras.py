# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture set's cameras in Blender: where they stood, with the lens they had and the picture that they took."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from addon.captures.pictures import write_picture
from addon.captures.schema import Capture, Frame
from addon.captures.store import read_capture, write_capture
from addon.cli import main
from addon.errors import ScanstageError
from addon.reconstruction.calibration.board import Board
from addon.reconstruction.geometry import Camera, look_at
from addon.results.cameras import COLLECTION_NAME, show_cameras
from addon.results.present import show_result
from addon.stage import staging
from addon.stage.readback import camera_of
from tests.results.test_present import inventory, result_of
from tests.rigs import Ball, sphere_mesh

SIZE = (64, 48)
POINTS = np.random.default_rng(3).uniform(-0.4, 0.4, (30, 3))


def camera_from(angle, *, size=SIZE, K=((70.0, 0, 30.2), (0, 70.0, 25.1), (0, 0, 1)), distortion=(0, 0, 0, 0, 0), mirrored=False):
    R, t = look_at((3 * np.cos(angle), 3 * np.sin(angle), 0.8), (0, 0, 0))
    mirror = np.diag((1, 1, -1)) if mirrored else np.eye(3)
    return Camera(np.array(K), R @ mirror, t, size, np.array(distortion, float))


def write_set(folder, cameras, encoding="srgb"):
    frames = []
    for number, camera in enumerate(cameras):
        write_picture(folder / "images" / f"{number}.png", np.full((*camera.size[::-1], 3), 0.3), encoding=encoding, bits=8)
        frames.append(Frame(f"view-{number}", f"images/{number}.png", f"c{number}"))
    write_capture(folder, Capture({f"c{number}": camera for number, camera in enumerate(cameras)}, tuple(frames), encoding))
    return folder


def shown(scene):
    return sorted((member for member in scene.objects if member.type == 'CAMERA'), key=lambda member: member.name)


def drawn(scene, member, camera, points):
    """Return where points (n, 3) lie in a camera's picture as Blender lays it into the camera's frame, by what `stage.readback` reads."""
    background, = member.data.background_images
    pixels, depth = camera_of(scene, member).project(points)
    assert (depth > 0).all()
    frame = np.array((scene.render.resolution_x, scene.render.resolution_y * scene.render.pixel_aspect_y / scene.render.pixel_aspect_x))
    size = np.array(camera.size, float)
    place = (pixels + 0.5) / (scene.render.resolution_x, scene.render.resolution_y) * frame  # from the corner, in units that are square
    if background.frame_method == 'STRETCH':
        place *= size / frame
    else:
        scale = (frame / size).min()
        place = (place - (frame - scale * size) / 2) / scale
    place -= 0.5
    return np.column_stack((size[0] - 1 - place[:, 0], place[:, 1])) if background.use_flip_x else place


@pytest.mark.parametrize("K", [((70.0, 0, 30.2), (0, 70.0, 25.1), (0, 0, 1)), ((70.0, 0, 35.2), (0, 84.0, 20.1), (0, 0, 1)),
                               ((90.0, 0, 30.2), (0, 70.0, 25.1), (0, 0, 1))])
def test_a_point_is_drawn_where_the_picture_shows_it(empty_scene, tmp_path, K):
    cameras = [camera_from(angle, K=K) for angle in (0, 1.2, 4.0)]
    assert show_cameras(empty_scene, write_set(tmp_path, cameras)) == []
    bpy.context.view_layer.update()
    assert [member.name for member in shown(empty_scene)] == ["view-0", "view-1", "view-2"]
    for member, camera in zip(shown(empty_scene), cameras, strict=True):
        np.testing.assert_allclose(drawn(empty_scene, member, camera, POINTS), camera.project(POINTS)[0], atol=2e-3)  # single precision
        assert Path(bpy.path.abspath(member.data.background_images[0].image.filepath)).parent == tmp_path / "images"
        np.testing.assert_allclose(member.matrix_world.translation, camera.centre, atol=1e-6)


def test_pictures_of_other_sizes_fit_into_the_frame_of_the_first(empty_scene, tmp_path):
    cameras = [camera_from(0), camera_from(1, size=(128, 96), K=((150.0, 0, 61), (0, 150, 50), (0, 0, 1))),
               camera_from(2, size=(48, 64), K=((70.0, 0, 23), (0, 70, 30), (0, 0, 1)))]
    assert show_cameras(empty_scene, write_set(tmp_path, cameras)) == []
    assert (empty_scene.render.resolution_x, empty_scene.render.resolution_y) == SIZE
    bpy.context.view_layer.update()
    for member, camera in zip(shown(empty_scene), cameras, strict=True):
        np.testing.assert_allclose(drawn(empty_scene, member, camera, POINTS), camera.project(POINTS)[0], atol=4e-3)
    assert [member.data.background_images[0].frame_method for member in shown(empty_scene)] == ['STRETCH', 'STRETCH', 'FIT']


def test_a_mirrored_calibration_is_shown_by_a_flipped_picture(empty_scene, tmp_path):
    cameras = [camera_from(angle, mirrored=True) for angle in (0, 1.2)]
    told, = show_cameras(empty_scene, write_set(tmp_path, cameras))
    assert told.startswith("2 views are calibrated in a mirrored world (first: view-0)")
    bpy.context.view_layer.update()
    for member, camera in zip(shown(empty_scene), cameras, strict=True):
        assert member.data.background_images[0].use_flip_x and np.linalg.det(np.array(member.matrix_world)[:3, :3]) > 0
        np.testing.assert_allclose(drawn(empty_scene, member, camera, POINTS), camera.project(POINTS)[0], atol=2e-3)


def test_what_a_camera_of_blenders_cannot_be_is_told(empty_scene, tmp_path):
    bent, skewed = camera_from(0, distortion=(-0.2, 0, 0, 0.002, 0)), camera_from(1, K=((70.0, 45.0, 30), (0, 70, 25), (0, 0, 1)))
    told = show_cameras(empty_scene, write_set(tmp_path, [bent, skewed]))
    assert len(told) == 2 and told[0].startswith("1 of 2 views are not shown (first: view-1)") and "up to" in told[1]
    member, = shown(empty_scene)
    bpy.context.view_layer.update()
    grid = np.stack(np.meshgrid(np.arange(64), np.arange(48)), axis=-1).reshape(-1, 2)
    points = bent.centre + replace(bent, distortion=np.zeros(5)).rays(grid)
    error = np.linalg.norm(drawn(empty_scene, member, bent, points) - bent.project(points)[0], axis=1).max()
    assert f"up to {error:.1f} px" in told[1] and "undistort=true" in told[1]


def test_showing_again_leaves_nothing_twice_and_a_stage_keeps_its_own_camera(empty_scene, tmp_path):
    folder = write_set(tmp_path, [camera_from(angle) for angle in (0, 1, 2)], encoding="linear")
    show_cameras(empty_scene, folder)
    first, images = inventory(), sorted(bpy.data.images.keys())
    markers = [(marker.name, marker.frame, marker.camera.name) for marker in empty_scene.timeline_markers]
    show_cameras(empty_scene, folder)
    assert inventory() == first and sorted(bpy.data.images.keys()) == images
    assert [(marker.name, marker.frame, marker.camera.name) for marker in empty_scene.timeline_markers] == markers
    assert markers == [("view-0", 1, "view-0"), ("view-1", 2, "view-1"), ("view-2", 3, "view-2")]
    assert {image.colorspace_settings.name for image in bpy.data.images} == {'Linear Rec.709'}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    staging.build(scene, "turntable", "knot", {"views": 4, "resolution_x": 80, "resolution_y": 60})
    before = scene.camera.name, scene.frame_end, scene.render.resolution_x, len(scene.timeline_markers)
    show_cameras(scene, folder)
    assert (scene.camera.name, scene.frame_end, scene.render.resolution_x, len(scene.timeline_markers)) == before
    assert len(bpy.data.collections[COLLECTION_NAME].objects) == 3


def test_a_result_stands_among_its_cameras(empty_scene, tmp_path):
    found = result_of(sphere_mesh(Ball((0, 0, 1), 0.5)), tmp_path)
    beside = np.array(show_result(empty_scene, found).matrix_world.translation)
    show_cameras(empty_scene, write_set(tmp_path, [camera_from(0), camera_from(1)]))
    among = show_result(empty_scene, found)
    bpy.context.view_layer.update()
    assert beside[0] > 0.5 and not np.array(among.matrix_world.translation).any()


def test_a_set_of_boards_has_nothing_to_show(empty_scene, tmp_path):
    folder = write_set(tmp_path, [camera_from(0)])
    capture = read_capture(folder)
    board = Board("checkerboard", 5, 4, 0.03)
    write_capture(folder, replace(capture, board=board, frames=tuple(replace(frame, board_pose="a") for frame in capture.frames)))
    before = inventory()
    with pytest.raises(ScanstageError, match="frames: none shows the object"):
        show_cameras(empty_scene, folder)
    assert inventory() == before


def test_the_verb_view_writes_a_file_to_open(tmp_path, capfd):
    write_set(tmp_path / "set", [camera_from(angle, mirrored=True) for angle in (0, 1, 2)])
    assert main(["view", str(tmp_path / "set"), "--out", str(tmp_path / "set.blend"), "--quiet"]) == 0
    out = capfd.readouterr().out
    assert "3 camera(s), each with its picture" in out and "warning: 3 views are calibrated in a mirrored world" in out
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "set.blend"))
    assert len(shown(bpy.context.scene)) == 3 and bpy.context.scene.camera.name == "view-0"
    assert Path(bpy.path.abspath(shown(bpy.context.scene)[1].data.background_images[0].image.filepath)).resolve() == tmp_path / "set/images/1.png"
