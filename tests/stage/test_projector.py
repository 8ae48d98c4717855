# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A projector's light falls where K [R | t] and its distortion say, and is read back as the camera it is."""

import math
from dataclasses import replace

import bpy

# isort: split
import cv2  # bpy first: both bring libraries of their own
import numpy as np
import pytest

from addon.captures.pictures import read_picture
from addon.errors import ScanstageError
from addon.reconstruction.active.patterns import make_patterns
from addon.reconstruction.geometry import Camera, look_at
from addon.reconstruction.undistortion import injective_radius
from addon.stage import devices, projection, projector, readback, scene_settings
from addon.stage.materials import matte

SIZE = (48, 36)
DISTORTIONS = {"none": np.zeros(5), "barrel": np.array([-0.25, 0.05, 0.01, -0.02, 0.01]), "pincushion": np.array([0.3, 0.1, -0.02, 0.01, 0.0])}
TILTED = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])  # normal of the plane through the origin


def lens(distortion=None, size=SIZE):
    """Return a projector off its axis and with oblong pixels, above the plane and beside the camera."""
    R, t = look_at((0.5, -0.3, 1.4), (0.05, 0.0, 0.0), up=(0.1, 1.0, 0.0))
    K = [[1.3 * size[0], 0, 0.42 * size[0]], [0, 1.25 * size[0], 0.61 * size[1]], [0, 0, 1]]
    return Camera(K, R, t, size, np.zeros(5) if distortion is None else distortion)


@pytest.fixture
def plane_scene(empty_scene):
    """Return a scene with a white tilted plane and a camera of 128x96 pixels before it."""
    scene = empty_scene
    scene_settings.apply(scene, {**scene_settings.capture_settings(scene), "cycles.samples": 1, "cycles.max_bounces": 0, "render.resolution_x": 128,
                                 "render.resolution_y": 96, "render.film_transparent": True})
    scene.world = devices.dark_world()
    x = np.cross(TILTED, (0, 1, 0))
    x /= np.linalg.norm(x)
    y = np.cross(TILTED, x)
    mesh = bpy.data.meshes.new("plane")
    mesh.from_pydata([(5 * (i * x + j * y)).tolist() for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))], [], [(0, 1, 2, 3)])
    mesh.materials.append(matte("white", (1.0, 1.0, 1.0)))
    scene.collection.objects.link(bpy.data.objects.new("plane", mesh))
    camera = devices.add_camera(scene.collection, 1, focal_length=35.0, sensor_width=36.0)
    devices.aim(camera, np.array((-0.3, -0.4, 1.6)), np.zeros(3))
    scene.camera = camera
    return scene


def add(scene, optics, number=1):
    made = projector.add_projector(scene.collection, number)
    projector.set_optics(made.data, optics)
    devices.stand(made, optics.R, optics.t)
    bpy.context.view_layer.update()
    return made


def render(scene, folder, frame=1):
    scene.frame_set(frame)
    scene.render.filepath = str(folder / "picture.png")
    bpy.ops.render.render(write_still=True)
    return read_picture(folder / "picture.png", "linear")[0]


def points_seen(scene):
    """Return the (height, width, 3) points of the plane that the camera's pixels see."""
    camera = readback.camera_of(scene, scene.camera)
    rays = camera.rays(np.stack(np.meshgrid(np.arange(camera.size[0]), np.arange(camera.size[1])), -1))
    return camera.centre - rays * (camera.centre @ TILTED / (rays @ TILTED))[..., None]


def pixels_lit(scene, optics):
    """Return the projector pixel of each camera pixel, and which of them are certain to be inside the picture or outside."""
    pixels, _ = optics.project(points_seen(scene))
    local = points_seen(scene) @ optics.R.T + optics.t
    unique = np.linalg.norm(local[..., :2] / local[..., 2:], axis=-1) < injective_radius(optics)
    from_border = np.abs((pixels + 0.5) - np.rint(pixels + 0.5)).min(-1)
    inside = ((pixels > -0.5) & (pixels < np.array(optics.size) - 0.5)).all(-1) & unique
    return pixels, inside, (from_border > 0.01) & unique


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_every_code_is_where_the_projection_matrix_says(plane_scene, tmp_path, distortion):
    optics = lens(DISTORTIONS[distortion])
    made = add(plane_scene, optics)
    patterns = make_patterns("gray-code", SIZE, {"inverses": False})
    projection.show_patterns(made.data, patterns, range(len(patterns)))
    codes = {"column": np.zeros((96, 128), int), "row": np.zeros((96, 128), int)}
    for frame, pattern in enumerate(patterns, start=1):
        lit = render(plane_scene, tmp_path, frame)[..., 0] > 0.1
        if pattern.fields["kind"] == "gray-code":
            codes[pattern.fields["axis"]] |= lit << pattern.fields["bit"]
        elif pattern.fields["kind"] == "white":
            white = lit
        else:
            assert not lit.any()
    pixels, inside, certain = pixels_lit(plane_scene, optics)
    assert inside.mean() > 0.3 and certain[inside].mean() > 0.9
    np.testing.assert_array_equal(white[certain], inside[certain])
    for axis, code in codes.items():
        for shift in (1, 2, 4):
            code ^= code >> shift
        expected = np.rint(pixels[..., 0 if axis == "column" else 1]).astype(int)
        np.testing.assert_array_equal(code[certain & inside], expected[certain & inside])


def blended(image, pixels):
    """Return an image's levels (0 to 1) at (n, 2) places between its pixels, by bilinear interpolation."""
    level = image / (255 if image.dtype == np.uint8 else 1)
    last = np.array(image.shape[::-1]) - 1
    lower = np.clip(np.floor(pixels).astype(int), 0, last)
    upper, share = np.clip(np.floor(pixels).astype(int) + 1, 0, last), pixels - np.floor(pixels)
    top, bottom = (level[y, lower[:, 0]] * (1 - share[:, 0]) + level[y, upper[:, 0]] * share[:, 0] for y in (lower[:, 1], upper[:, 1]))
    return top * (1 - share[:, 1]) + bottom * share[:, 1]


@pytest.mark.parametrize(("name", "chosen", "is_sharp"), [("checker", (3, 0, 2), True), ("points", (1, 0, 4), False),
                                                       ("phase-shift", (-6, -3, -2), False), ("stripe-sweep", (0, 20, 47), False)])
def test_levels_are_kept_sharp_in_black_and_white_and_blended_in_shades(plane_scene, tmp_path, name, chosen, is_sharp):
    optics = lens()
    options = {"checker": {"cell": 5, "shifts": 2}, "points": {"columns": 3, "rows": 2, "width": 12.0}, "phase-shift": {"axes": "both"}}
    patterns = make_patterns(name, SIZE, options.get(name, {}))
    made = add(plane_scene, optics)
    projection.show_patterns(made.data, patterns, [index % len(patterns) for index in chosen])
    pixels, inside, certain = pixels_lit(plane_scene, optics)
    points = points_seen(plane_scene)[certain & inside]
    to_light = optics.centre - points
    facing = to_light @ TILTED / np.linalg.norm(to_light, axis=-1)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))  # the image of the patterns is kept in the file
    for frame, index in enumerate(chosen, start=1):
        lit = pixels[certain & inside]
        level = blended(patterns[index].image, np.rint(lit) if is_sharp else lit)
        picture = render(bpy.context.scene, tmp_path, frame)[..., 0][certain & inside]
        # A white surface that faces a white pixel is white. The filter's 0.01 px of the camera blurs the steepest slope by less.
        np.testing.assert_allclose(picture, level * facing, atol=3e-4 if is_sharp else 2e-3)


def test_phase_is_continuous_from_pixel_to_pixel(plane_scene, tmp_path):
    optics = lens()
    made = add(plane_scene, optics)
    patterns = [pattern for pattern in make_patterns("phase-shift", SIZE, {"period": 12.0}) if pattern.fields["kind"] == "phase-shift"]
    projection.show_patterns(made.data, patterns, range(len(patterns)))
    pictures = np.array([render(plane_scene, tmp_path, frame)[..., 0] for frame in range(1, len(patterns) + 1)])
    phase = np.angle(np.tensordot(np.exp(2j * np.pi * np.arange(4) / 4), pictures, 1))
    pixels, inside, certain = pixels_lit(plane_scene, optics)
    error = (phase * 12 / (2 * np.pi) - pixels[..., 0] + 6) % 12 - 6
    well = certain & inside & (pixels[..., 0] > 0) & (pixels[..., 0] < SIZE[0] - 1)  # half a pixel at the edges has no neighbour to be blended with
    assert np.abs(error[well]).max() < 0.02 and np.sqrt((error[well] ** 2).mean()) < 0.005


def test_it_is_read_back_as_it_was_set(plane_scene):
    optics = lens(DISTORTIONS["barrel"])
    found = readback.projector_of(plane_scene, add(plane_scene, optics))
    assert found.size == optics.size
    for name in ("K", "R", "t", "distortion"):
        np.testing.assert_allclose(getattr(found, name), getattr(optics, name), rtol=1e-6, atol=1e-6)


def test_a_throw_ratio_of_1_is_twice_the_arc_tangent_of_a_half(plane_scene):
    found = readback.projector_of(plane_scene, projector.add_projector(plane_scene.collection, 1, throw_ratio=1.0))
    left, right = found.rays(np.array([(-0.5, 383.5), (1023.5, 383.5)]))
    angle = math.acos(left @ right / np.linalg.norm(left) / np.linalg.norm(right))
    assert angle == pytest.approx(0.9272952, abs=1e-6)


def test_lens_shift_is_a_cameras(plane_scene):
    made = projector.add_projector(plane_scene.collection, 1, size=(128, 96))
    camera = plane_scene.camera.data
    camera.shift_x, camera.shift_y = 0.2, -0.1
    camera.lens = camera.sensor_width  # a throw ratio of 1
    for name, value in (("Shift X", camera.shift_x), ("Shift Y", camera.shift_y)):
        projector.lens_of(made.data).inputs[name].default_value = value
    np.testing.assert_allclose(readback.projector_of(plane_scene, made).K, readback.camera_of(plane_scene, plane_scene.camera).K, atol=1e-4)


# The first turns back at a radius of 0.61; the second at 0.65, and forward again at 1.26: it would show three pictures.
@pytest.mark.parametrize(("distortion", "fold"), [((-0.9, 0, 0, 0, 0), 1 / 2.7), ((-1, 0.3, 0, 0, 0), 1 - math.sqrt(1 / 3))])
def test_light_that_a_lens_folds_back_is_not_shown_twice(plane_scene, tmp_path, distortion, fold):
    optics = lens(np.array(distortion))
    add(plane_scene, optics)
    plane_scene.camera.data.lens = 8.0  # of a wide angle, to see all of the plane
    lit = render(plane_scene, tmp_path)[..., 0] > 0
    local = points_seen(plane_scene) @ optics.R.T + optics.t
    square = ((local[..., :2] / local[..., 2:]) ** 2).sum(-1)
    pixels, _ = optics.project(points_seen(plane_scene))
    shown = ((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(-1) & (local[..., 2] > 0)
    again = shown & (square > fold + 1e-3)
    assert again.any() and not lit[again].any()
    assert lit[shown & (square < fold - 1e-3)].all()


def test_many_projectors_each_show_their_own(plane_scene, tmp_path):
    first, second = lens(), replace(lens(), R=look_at((-0.5, 0.4, 1.2), (0, 0, 0))[0], t=look_at((-0.5, 0.4, 1.2), (0, 0, 0))[1])
    patterns = make_patterns("gray-code", SIZE)
    for number, (optics, shown) in enumerate(((first, [-1, None]), (second, [None, -2])), start=1):
        chosen = [None if i is None else len(patterns) - 2 for i in shown]  # white, then nothing; and the other way round
        projection.show_patterns(add(plane_scene, optics, number).data, patterns, chosen)
    for frame, optics in ((1, first), (2, second)):
        lit = render(plane_scene, tmp_path, frame)[..., 0] > 0
        _, inside, certain = pixels_lit(plane_scene, optics)
        np.testing.assert_array_equal(lit[certain], inside[certain])  # one sample: the dark one takes none away


@pytest.mark.parametrize("kind", ["still", "sequence"])
def test_images_and_sequences(plane_scene, tmp_path, kind):
    optics = lens()
    made = add(plane_scene, optics)
    frames = [np.zeros((SIZE[1], SIZE[0], 3), np.uint8) for _ in range(2)]
    frames[0][:, :10, 2], frames[1][20:, :, 2] = 255, 255  # red: columns, then rows
    for number, picture in enumerate(frames, start=1):
        cv2.imwrite(str(tmp_path / f"shown{number:04d}.png"), picture)
    image = bpy.data.images.load(str(tmp_path / "shown0001.png"))
    image.colorspace_settings.name = "Non-Color"
    if kind == "sequence":
        image.source = "SEQUENCE"
    projector.set_image(made.data, image, frames=2)
    pixels, inside, certain = pixels_lit(plane_scene, optics)
    for frame in (1, 2):
        shown = frames[frame - 1 if kind == "sequence" else 0][..., 2] > 0
        lit = render(plane_scene, tmp_path, frame)[..., 0] > 0
        column, row = np.moveaxis(np.rint(pixels).astype(int), -1, 0)
        np.testing.assert_array_equal(lit[certain & inside], shown[row[certain & inside], column[certain & inside]])
        id, fields = projection.pattern_of(made.data, frame)
        assert fields == {"kind": "image", "image": image.name, **({"frame": frame} if kind == "sequence" else {})}


def test_bad_input(plane_scene):
    made = add(plane_scene, lens())
    with pytest.raises(ScanstageError, match="pattern gray-column-00 is 32x36, the projector 48x36"):
        projection.show_patterns(made.data, make_patterns("gray-code", (32, 36)), [0])
    with pytest.raises(ScanstageError, match="skew"):
        projector.set_optics(made.data, replace(lens(), K=[[50, 1, 24], [0, 50, 18], [0, 0, 1]]))
    with pytest.raises(ScanstageError, match="'plane' in scene 'Scene' is not a projector"):
        readback.projector_of(plane_scene, plane_scene.objects["plane"])
    projection.show_patterns(made.data, make_patterns("gray-code", SIZE), [0])
    projector.lens_of(made.data).inputs["Width"].default_value = 64
    with pytest.raises(ScanstageError, match="64x36, its patterns 48x36"):
        projection.pattern_of(made.data, 1)
