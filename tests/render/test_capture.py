# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture set is what the plan says, resumable and honest about what it lacks; the scene comes out unharmed."""

import json
import shutil

import bpy

# isort: split
import cv2  # bpy first: both bring libraries of their own
import numpy as np
import pytest
from mathutils.bvhtree import BVHTree

from addon.captures.pictures import read_picture
from addon.captures.store import picture_is_whole, read_capture
from addon.errors import ScanstageError
from addon.render import settings
from addon.render.capture import capture_frames
from addon.results.ply import read_ply
from addon.stage import ownership, readback, scene_settings, staging

SMALL = {"views": 3, "resolution_x": 96, "resolution_y": 72}


def capture(scene, folder, **options):
    return list(capture_frames(scene, folder, **options))


def contents(folder):
    """Return the bytes and the time stamp of every picture."""
    return {path.relative_to(folder).as_posix(): (path.read_bytes(), path.stat().st_mtime_ns)
            for path in sorted(folder.rglob("*.png"))}


def scene_state(scene):
    paths = (*scene_settings.capture_settings(scene), *scene_settings.STAGE_SETTINGS)
    return (scene_settings.snapshot(scene, paths), scene.frame_current, scene.camera,
            {o.name: o.hide_render for o in scene.objects})


@pytest.fixture
def staged(empty_scene):
    staging.build(empty_scene, "turntable", "knot", SMALL)
    return empty_scene


def test_the_set_is_the_plan(staged, tmp_path):
    steps = capture(staged, tmp_path / "new" / "set")
    folder = tmp_path / "new" / "set"
    found, plan = read_capture(folder), readback.plan_of(staged)
    assert found.missing == () and found.encoding == "linear"
    assert [frame.id for frame in found.frames] == ["0001", "0002", "0003"]
    for frame, planned in zip(found.frames, plan.frames, strict=True):
        np.testing.assert_array_equal(frame.object_to_world, planned.object_to_world)
        np.testing.assert_array_equal(found.cameras[frame.camera].P, plan.cameras[planned.camera].P)
        picture = cv2.imread(str(folder / frame.image), cv2.IMREAD_UNCHANGED)
        assert picture.dtype == np.uint16 and picture.shape == (72, 96, 4)
    truth = read_ply(folder / found.truth_mesh)
    vertices, triangles = readback.truth_mesh(staged)
    np.testing.assert_array_equal(truth.vertices, vertices)
    np.testing.assert_array_equal(truth.triangles, triangles)
    fractions = [fraction for fraction, _ in steps]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0 and len(steps) >= 3
    assert sorted(p.name for p in folder.rglob("*")) == ["0001.png", "0002.png", "0003.png", "capture.json", "images",
                                                         "truth.ply"]


def test_a_rig_that_is_moved_while_it_is_captured_is_refused(staged, tmp_path):
    steps = capture_frames(staged, tmp_path)
    next(steps)
    staged.camera.location.x += 0.001
    with pytest.raises(ScanstageError, match="frame 2 .*: the rig was moved while it was captured"):
        list(steps)
    assert read_capture(tmp_path, require_pictures=False).missing == ("0002", "0003")
    staged.camera.location.x -= 0.001
    capture(staged, tmp_path)
    assert read_capture(tmp_path).missing == ()


@pytest.mark.parametrize("name", ["knot", "figure", "pot"])
def test_silhouettes_are_those_of_the_truth(empty_scene, tmp_path, name):
    staging.build(empty_scene, "turntable", name, {**SMALL, "views": 2, "elevations": "15,50"})
    capture(empty_scene, tmp_path)
    found, truth = read_capture(tmp_path), read_ply(tmp_path / "truth.ply")
    tree = BVHTree.FromPolygons(truth.vertices.tolist(), truth.triangles.tolist())
    for frame in found.frames:
        camera = found.camera_of(frame)
        alpha = read_picture(tmp_path / frame.image, "linear")[1]
        assert set(np.unique(alpha)) <= {0.0, 1.0}  # one sample: inside or outside
        centre = cast(tree, camera, 0.0, 0.0)
        # The renderer's filter moves the sample by up to 0.01 px: where that crosses the outline, either may be right.
        near = np.array([cast(tree, camera, du, dv) for du in (-0.02, 0.02) for dv in (-0.02, 0.02)])
        certain = (near == centre).all(axis=0)
        assert certain.mean() > 0.98
        np.testing.assert_array_equal(alpha[certain] > 0, centre[certain])


def cast(tree, camera, du, dv):
    """Return which of a camera's pixels, moved by a part of one, see the object."""
    rows, columns = np.mgrid[:camera.size[1], :camera.size[0]]
    directions = camera.rays(np.stack((columns + du, rows + dv), axis=-1)).reshape(-1, 3)
    origin = tuple(camera.centre)
    hits = [tree.ray_cast(origin, tuple(direction))[0] is not None for direction in directions.tolist()]
    return np.array(hits).reshape(rows.shape)


def test_one_sample_is_free_of_noise_and_nothing_is_saturated(staged, tmp_path):
    capture(staged, tmp_path / "a")
    staged.cycles.seed = 77
    capture(staged, tmp_path / "b")
    for image in ("images/0001.png", "images/0003.png"):
        first, alpha = read_picture(tmp_path / "a" / image, "linear")
        second, _ = read_picture(tmp_path / "b" / image, "linear")
        np.testing.assert_array_equal(first, second)
        lit = first[alpha > 0]
        assert lit.max() < 0.95 and np.median(lit.max(axis=1)) > 0.1
        assert (lit.max(axis=1) < 0.005).mean() < 0.01  # black only where the surface turns away


def test_resuming_renders_only_what_is_missing_or_damaged(staged, tmp_path):
    capture(staged, tmp_path)
    before = contents(tmp_path)
    assert capture(staged, tmp_path) and contents(tmp_path) == before  # all is there: nothing is rendered

    (tmp_path / "images" / "0001.png").unlink()
    data = bytearray(before["images/0002.png"][0])
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "images" / "0002.png").write_bytes(data)
    capture(staged, tmp_path)
    after = contents(tmp_path)
    assert after["images/0003.png"] == before["images/0003.png"]
    for name in ("images/0001.png", "images/0002.png"):
        assert after[name][1] != before[name][1]
        np.testing.assert_array_equal(*(cv2.imdecode(np.frombuffer(c[name][0], np.uint8), cv2.IMREAD_UNCHANGED)
                                        for c in (before, after)))


@pytest.mark.parametrize("damage", ["empty", "cut", "wrong size"])
def test_a_bad_picture_is_rendered_again(staged, tmp_path, damage):
    capture(staged, tmp_path)
    path = tmp_path / "images" / "0002.png"
    if damage == "wrong size":
        cv2.imwrite(str(path), np.zeros((72, 95, 4), np.uint16))
    else:
        path.write_bytes(path.read_bytes()[:0 if damage == "empty" else -30])
    capture(staged, tmp_path)
    assert picture_is_whole(path, (96, 72)) and read_capture(tmp_path).missing == ()


def test_without_resume_all_is_rendered(staged, tmp_path):
    capture(staged, tmp_path)
    before = contents(tmp_path)
    capture(staged, tmp_path, resume=False)
    after = contents(tmp_path)
    assert all(after[name][1] != before[name][1] for name in before)


def test_an_interrupted_capture_says_what_it_lacks(staged, tmp_path):
    before = scene_state(staged)
    job = capture_frames(staged, tmp_path)
    next(job)
    assert set(read_capture(tmp_path).missing) == {"0001", "0002", "0003"}  # from before the first picture on
    job.close()
    assert read_capture(tmp_path).missing == ("0002", "0003")
    assert scene_state(staged) == before

    job = capture_frames(staged, tmp_path)
    next(job)
    with pytest.raises(KeyboardInterrupt):
        job.throw(KeyboardInterrupt)
    assert read_capture(tmp_path).missing == ("0002", "0003")
    assert scene_state(staged) == before
    capture(staged, tmp_path)
    assert read_capture(tmp_path).missing == ()


def change_views(scene):
    staging.build(scene, "turntable", "knot", {**SMALL, "views": 4})


def change_resolution(scene):
    scene.render.resolution_x = 100


def change_camera(scene):
    scene.camera.location.x += 0.01


def change_object(scene):
    staging.build(scene, "turntable", "figure", {**SMALL, "distance": 1.0})


def change_pose(scene):
    readback.turntable_of(scene).animation_data_clear()


@pytest.mark.parametrize("change", [change_views, change_resolution, change_camera, change_object, change_pose])
def test_another_plan_is_refused_and_nothing_touched(empty_scene, tmp_path, change):
    staging.build(empty_scene, "turntable", "knot", {**SMALL, "distance": 1.0})
    capture(empty_scene, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    change(empty_scene)
    with pytest.raises(ScanstageError) as error:
        capture(empty_scene, tmp_path)
    assert str(tmp_path) in str(error.value) and "another plan" in str(error.value)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_settings_come_back_after_an_error(empty_scene):
    staging.build(empty_scene, "turntable", "knot", SMALL)
    # As a user may leave it: another engine, format and view, and a frame in the middle.
    scene_settings.apply(empty_scene, {"render.engine": "BLENDER_WORKBENCH",
                                       "render.image_settings.file_format": "JPEG",
                                       "render.image_settings.color_management": "FOLLOW_SCENE",
                                       "view_settings.view_transform": "AgX", "cycles.max_bounces": 7,
                                       "render.use_border": True})
    empty_scene.frame_set(2)
    before = scene_state(empty_scene)
    with pytest.raises(ZeroDivisionError), settings.capture_settings(empty_scene):
        assert empty_scene.render.engine == "CYCLES"
        assert empty_scene.render.image_settings.view_settings.view_transform == "Raw"
        empty_scene.frame_set(3)
        raise ZeroDivisionError
    assert scene_state(empty_scene) == before


@pytest.mark.parametrize("view_transform", ["AgX", "Standard"])
def test_pictures_do_not_depend_on_the_view_of_the_scene(empty_scene, tmp_path, view_transform):
    staging.build(empty_scene, "turntable", "knot", SMALL)
    empty_scene.view_settings.view_transform = "Raw"
    capture(empty_scene, tmp_path / "raw")
    empty_scene.view_settings.view_transform = view_transform
    empty_scene.view_settings.exposure = 1.5
    capture(empty_scene, tmp_path / "other")
    for picture in sorted((tmp_path / "raw" / "images").iterdir()):
        assert np.array_equal(*(cv2.imread(str(tmp_path / name / "images" / picture.name), cv2.IMREAD_UNCHANGED)
                                for name in ("raw", "other")))


def test_what_cannot_be_rendered_is_an_error_and_the_scene_is_as_it_was(staged, tmp_path):
    (tmp_path / "images").write_text("a file where the folder should be")
    before = scene_state(staged)
    with pytest.raises(ScanstageError, match=str(tmp_path)):
        capture(staged, tmp_path)
    assert scene_state(staged) == before


def test_blenders_own_animation_render_makes_the_same_pictures(empty_scene, tmp_path):
    staging.build(empty_scene, "turntable", "knot", {**SMALL, "views": 2, "elevations": "10,60"})
    capture(empty_scene, tmp_path / "ours")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "stage.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "stage.blend"))
    bpy.ops.render.render(animation=True)
    farm = tmp_path / "capture"
    for number in range(1, 5):
        ours, theirs = (cv2.imread(str(folder / "images" / f"{number:04d}.png"), cv2.IMREAD_UNCHANGED)
                        for folder in (tmp_path / "ours", farm))
        np.testing.assert_array_equal(ours, theirs)
    rendered = contents(farm)
    capture(bpy.context.scene, farm)  # adds the plan and the truth, and renders nothing again
    assert contents(farm) == rendered
    assert read_capture(farm).missing == ()


@pytest.mark.parametrize(("backdrop", "color"), [("blue", (0.02, 0.10, 0.80)), ("black", (0, 0, 0))])
def test_backdrop_and_platter_are_one_colour_and_have_clean_plates(empty_scene, tmp_path, backdrop, color):
    options = {**SMALL, "views": 2, "elevations": "0,50", "backdrop": backdrop}
    staging.build(empty_scene, "turntable", "knot", {**options, "backdrop": "none"})
    capture(empty_scene, tmp_path / "alpha")
    stage = staging.build(empty_scene, "turntable", "knot", options)
    assert not ownership.with_role(stage, "platter")[0].hide_render
    capture(empty_scene, tmp_path / "screen")
    found = read_capture(tmp_path / "screen")
    assert found.plates == {"camera-1": "plates/camera-1.png", "camera-2": "plates/camera-2.png"}
    for plate in found.plates.values():
        rgb, _ = read_picture(tmp_path / "screen" / plate, "linear")
        np.testing.assert_allclose(rgb, np.broadcast_to(color, rgb.shape), atol=2 / 65535)
    for frame in found.frames:
        rgb, _ = read_picture(tmp_path / "screen" / frame.image, "linear")
        free, alpha = read_picture(tmp_path / "alpha" / frame.image, "linear")
        background = rgb[alpha == 0]
        np.testing.assert_allclose(background, np.broadcast_to(color, background.shape), atol=2 / 65535)
        np.testing.assert_array_equal(rgb[alpha > 0], free[alpha > 0])  # neither lit nor shaded by the screen


def test_no_plate_unless_asked_for(empty_scene, tmp_path):
    staging.build(empty_scene, "turntable", "knot", {**SMALL, "views": 1, "backdrop": "black", "plate": False})
    capture(empty_scene, tmp_path)
    assert read_capture(tmp_path).plates == {} and not (tmp_path / "plates").exists()


def test_an_object_of_instances_is_hidden_from_its_plate(empty_scene, tmp_path):
    library = bpy.data.collections.new("library")
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    library.objects.link(cube)
    empty_scene.collection.objects.unlink(cube)
    group = bpy.data.objects.new("group", None)
    group.instance_type, group.instance_collection = "COLLECTION", library
    empty_scene.collection.objects.link(group)
    staging.build(empty_scene, "turntable", "group", {**SMALL, "views": 1, "backdrop": "blue"})
    capture(empty_scene, tmp_path)
    plate, _ = read_picture(tmp_path / "plates/camera-1.png", "linear")
    picture, _ = read_picture(tmp_path / "images/0001.png", "linear")
    assert np.ptp(plate, axis=(0, 1)).max() == 0 and np.ptp(picture, axis=(0, 1)).max() > 0.1


def test_a_folder_with_a_capture_that_cannot_be_read(staged, tmp_path):
    capture(staged, tmp_path)
    document = json.loads((tmp_path / "capture.json").read_text())
    document["version"] = 99
    (tmp_path / "capture.json").write_text(json.dumps(document))
    with pytest.raises(ScanstageError, match="version"):
        capture(staged, tmp_path)
    shutil.rmtree(tmp_path / "images")
    capture(staged, tmp_path, resume=False)
    assert read_capture(tmp_path).missing == ()
