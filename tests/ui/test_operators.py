# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every button, called without a window, does what the function behind it does."""

import json
import threading

import bpy
import numpy as np
import pytest

import addon
from addon import workflow
from addon.captures.scan import load_scan
from addon.captures.store import read_capture, read_picture
from addon.errors import Cancelled, ScanstageError
from addon.reconstruction.evaluation import EXPLAINED
from addon.reconstruction.methods import METHODS
from addon.reconstruction.shadows import SHADOW_OPTIONS
from addon.reconstruction.silhouettes import SILHOUETTE_OPTIONS
from addon.results.folder import read_result
from addon.results.page import page_of
from addon.results.pictures import picture_files
from addon.results.ply import read_ply
from addon.stage.presets import PRESETS
from addon.ui import forecast, panels
from addon.ui.operators.requirements import is_older


@pytest.fixture
def scene(empty_scene, tmp_path):
    """A saved scene with the extension registered, and a small rig chosen."""
    addon.register()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    settings = bpy.context.scene.scanstage
    settings.builtin = "knot"
    rig = settings.preset_turntable
    rig.views, rig.resolution_x, rig.resolution_y = 6, 120, 90
    settings.voxels = 40
    yield bpy.context.scene
    addon.unregister()


@pytest.fixture
def captured(scene):
    """The scene, staged and captured."""
    assert bpy.ops.scanstage.stage() == {'FINISHED'}
    assert bpy.ops.scanstage.capture() == {'FINISHED'}
    return scene


def test_from_stage_to_evaluation(captured, tmp_path):
    settings = captured.scanstage
    capture, result = tmp_path / "scanstage" / "capture", tmp_path / "scanstage" / "result"
    assert len(read_capture(capture).frames) == captured.frame_end == 6
    assert settings.capture_state == "6 of 6 frames captured"

    assert bpy.ops.scanstage.reconstruct() == {'FINISHED'}
    assert "voxels" in settings.result_lines
    mesh = bpy.data.objects["Result"].data
    found = read_result(result)
    assert len(mesh.polygons) == len(found.surface.quads)
    by_hand = tmp_path / "by hand"
    workflow.reconstruct(capture, "visual-hull", by_hand, voxels=40)
    assert np.array_equal(read_result(by_hand).volume.dense(), found.volume.dense())

    assert bpy.ops.scanstage.evaluate() == {'FINISHED'}
    assert json.loads(settings.measures) == workflow.evaluate_result(by_hand)
    assert "Comparison" in bpy.data.collections

    assert bpy.ops.scanstage.show_masks() == {'FINISHED'}
    assert captured.camera.data.background_images[0].image.source == 'SEQUENCE'

    settings.smooth = True
    assert bpy.ops.scanstage.show_result() == {'FINISHED'}
    assert [modifier.type for modifier in bpy.data.objects["Result"].modifiers]

    out = tmp_path / "mesh.stl"
    assert bpy.ops.scanstage.export_mesh(filepath=str(out)) == {'FINISHED'}
    assert out.stat().st_size > 1000

    assert bpy.ops.scanstage.show_cameras() == {'FINISHED'}
    assert len(bpy.data.collections["Scanstage Cameras"].objects) == 6

    assert bpy.ops.scanstage.report_page(filepath=str(tmp_path / "page.html")) == {'FINISHED'}
    assert (tmp_path / "page.html").read_text() == page_of(result)
    assert bpy.ops.scanstage.export_capture(filepath=str(tmp_path / "colmap"), format='colmap') == {'FINISHED'}
    assert (tmp_path / "colmap/sparse/0/images.txt").is_file()
    with pytest.raises(RuntimeError, match="is there already and not an empty folder"):
        bpy.ops.scanstage.export_capture(filepath=str(tmp_path / "colmap"), format='colmap')

    assert bpy.ops.scanstage.remove_stage() == {'FINISHED'}
    assert "Scanstage" not in bpy.data.collections and "Result" in bpy.data.objects


def test_measures_are_shown_with_their_units(scene):
    scene.unit_settings.scale_length = 0.01
    texts = {"accuracy_90": (0.25, "2.5 mm"), "truth": (8.0, "8 cm\u00b3"), "completeness": (0.125, "12.5 %"), "count": (12345, "12,345"),
             "rms": (None, "-"), "unheard_of": (0.5, "0.5")}
    assert {name: panels.measure_text(scene, name, value) for name, (value, _) in texts.items()} == {
        name: text for name, (_, text) in texts.items()}


def test_every_measure_is_explained(captured, tmp_path):
    workflow.reconstruct(tmp_path / "scanstage" / "capture", "visual-hull", tmp_path / "out", voxels=24)
    measures = workflow.evaluate_result(tmp_path / "out", options={"samples": 1000})
    assert {name for group in measures.values() for name in group} <= set(EXPLAINED)


@pytest.fixture
def lit(scene):
    """The scene, staged and captured under all lights, under the first and under the second, in each of four views."""
    scene.scanstage.preset, scene.scanstage.builtin = "shadow-array", "dented-sphere"
    rig = scene.scanstage.preset_shadow_array
    rig.views, rig.lights, rig.resolution_x, rig.resolution_y = 4, 2, 160, 120
    assert bpy.ops.scanstage.stage() == {'FINISHED'}
    assert bpy.ops.scanstage.capture() == {'FINISHED'}
    return scene


def shown_frames(scene, name):
    """Return the frames of the timeline at which the scene's camera shows the image sequence of a name."""
    frames = []
    for number in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(number)
        frames += [number for b in scene.camera.data.background_images if b.image.name == name and b.show_background_image]
    return frames


def test_shadows_and_silhouettes_are_shown_where_there_are_some(lit, tmp_path):
    capture = tmp_path / "scanstage" / "capture"
    frames = read_capture(capture).frames
    single = [number for number, frame in enumerate(frames, 1) if len(frame.lights) == 1]
    assert len(single) == 8 and len(frames) == 12
    lit.scanstage.shadows.shadow_area = 1
    assert bpy.ops.scanstage.show_shadows() == {'FINISHED'}
    assert shown_frames(lit, "Shadows") == single
    scan = load_scan(capture, silhouettes=False, shadow_options={"shadow_area": 1})
    assert any(view.shadows.of(0).any() for view in scan.views)
    for view in scan.views:
        for number, picture in enumerate(view.lit):
            np.testing.assert_array_equal(read_picture(capture / "shadows" / f"{picture.name}.png", "linear")[0][..., 0] == 1,
                                          view.shadows.of(number))
    for _ in range(2):
        assert bpy.ops.scanstage.show_masks() == {'FINISHED'}
        assert shown_frames(lit, "Silhouettes") == [number for number in range(1, 13) if number not in single]
    assert len(lit.camera.data.background_images) == 2 and shown_frames(lit, "Shadows") == single
    bpy.ops.scanstage.remove_stage()
    assert not [action for action in bpy.data.actions if "scanstage_made" in action]


def test_shadows_need_single_lights(captured, tmp_path):
    path = tmp_path / "scanstage" / "capture" / "capture.json"
    fields = json.loads(path.read_text())
    path.write_text(json.dumps({**fields, "frames": [{**frame, "lights": []} for frame in fields["frames"]]}))
    with pytest.raises(RuntimeError, match="shadow-array"):
        bpy.ops.scanstage.show_shadows()


def test_options_of_shadows_reach_the_method_and_what_it_carved_is_shown(lit, tmp_path):
    settings, result = lit.scanstage, tmp_path / "scanstage" / "result"
    settings.method, settings.shadows.shadow_margin, settings.silhouettes.dilate = "shadow-carving", 0, 1
    assert bpy.ops.scanstage.reconstruct() == {'FINISHED'}
    report = read_result(result).report
    assert (report["shadows"], report["silhouette"]) == ({"shadow_margin": 0}, {"dilate": 1})
    by_hand = tmp_path / "by hand"
    workflow.reconstruct(tmp_path / "scanstage" / "capture", "shadow-carving", by_hand, voxels=40,
                         options={"shadow_margin": 0, "dilate": 1})
    mine, found = read_result(by_hand), read_result(result)
    np.testing.assert_array_equal(mine.volume.dense(), found.volume.dense())
    assert len(mine.layers["carved"].voxels) and "Carved by Shadows" in bpy.data.objects
    assert bpy.ops.scanstage.show_pictures() == {'FINISHED'}
    assert {path.stem for path in picture_files(result)} <= set(bpy.data.images.keys())
    settings.method = "visual-hull"
    assert bpy.ops.scanstage.reconstruct() == {'FINISHED'}
    with pytest.raises(RuntimeError, match="makes no pictures"):
        bpy.ops.scanstage.show_pictures()
    assert "shadows" not in read_result(result).report and "Carved by Shadows" not in bpy.data.objects


def test_options_of_the_panel_reach_the_method(captured, tmp_path):
    settings = captured.scanstage
    settings.method_visual_hull.rule, settings.silhouettes.dilate = "center", 2
    settings.use_bounds, settings.bounds_lower, settings.bounds_upper = True, (-0.1, -0.1, 0), (0.1, 0.1, 0.2)
    assert bpy.ops.scanstage.reconstruct() == {'FINISHED'}
    report = read_result(tmp_path / "scanstage" / "result").report
    assert report["options"]["rule"] == "center"
    assert report["silhouette"] == {"dilate": 2, "conservative": False}
    assert report["grid"]["shape"] == [40, 40, 40] and report["grid"]["voxel_size"] == pytest.approx(0.005)


def test_a_method_that_cuts_solids_has_them_cut_between_two_steps(captured, tmp_path):
    settings = captured.scanstage
    settings.method = "polyhedral-hull"
    before = {name: len(getattr(bpy.data, name)) for name in ("scenes", "meshes", "objects")}
    assert bpy.ops.scanstage.reconstruct() == {'FINISHED'}
    shown = bpy.data.objects["Result"]
    assert {name: len(getattr(bpy.data, name)) - count for name, count in before.items()} == {"scenes": 0, "meshes": 1, "objects": 1}
    by_hand = tmp_path / "by hand"
    report = workflow.reconstruct(tmp_path / "scanstage" / "capture", "polyhedral-hull", by_hand, voxels=40)
    assert report["polyhedron"]["watertight"] and report["silhouette"] == {"conservative": False}
    mine, theirs = read_result(by_hand).mesh, read_result(tmp_path / "scanstage" / "result").mesh
    np.testing.assert_array_equal(mine.vertices, theirs.vertices)
    np.testing.assert_array_equal(mine.triangles, theirs.triangles)
    assert len(shown.data.polygons) == len(mine.triangles) and f"Triangles: {len(mine.triangles):,}" in settings.result_lines
    assert bpy.ops.scanstage.evaluate() == {'FINISHED'}
    assert json.loads(settings.measures)["surface"]["completeness"] > 0.5
    assert bpy.ops.scanstage.export_mesh(filepath=str(tmp_path / "mesh.ply")) == {'FINISHED'}
    assert read_ply(tmp_path / "mesh.ply").volume() == pytest.approx(report["polyhedron"]["volume"], rel=1e-4)


def test_the_threshold_of_probabilities_is_live_and_can_be_undone(captured):
    settings = captured.scanstage
    settings.method, settings.method_probabilistic_carving.passes = "probabilistic-carving", 2
    assert bpy.ops.scanstage.reconstruct() == {'FINISHED'}
    assert settings.least_probability == pytest.approx(0.5)

    def faces():
        return len(bpy.context.scene.objects["Result"].data.polygons)

    def threshold():
        return bpy.context.scene.scanstage.least_probability

    bpy.ops.ed.undo_push(message="Reconstruct")
    first = faces()
    settings.least_probability = 0.9
    second = faces()
    assert second != first
    bpy.ops.ed.undo_push(message="Least Probability")
    bpy.ops.ed.undo()
    assert (faces(), threshold()) == (first, pytest.approx(0.5))
    bpy.ops.ed.redo()
    assert (faces(), threshold()) == (second, pytest.approx(0.9))
    bpy.context.scene.scanstage.probability_colors = False
    assert bpy.context.scene.objects["Result"].data.materials[0].name == "Scanstage Voxels"


@pytest.mark.parametrize("operator, reason", [
    ("capture", "Build a stage first"), ("remove_stage", "Build a stage first"), ("reconstruct", "Capture or import pictures first"),
    ("show_cameras", "Capture or import pictures first"), ("show_masks", "Capture or import pictures first"), ("show_shadows", "Capture or import pictures first"), ("evaluate", "Reconstruct first"), ("show_result", "Reconstruct first"), ("show_pictures", "Reconstruct first"),
    ("export_mesh", "Reconstruct first"), ("report_page", "Reconstruct first"), ("export_capture", "Capture or import pictures first")])
def test_a_button_that_cannot_work_yet_says_why(scene, operator, reason):
    with pytest.raises(RuntimeError, match=reason):
        getattr(bpy.ops.scanstage, operator)()


def test_a_second_job_is_refused(captured):
    bpy.context.window_manager.scanstage_job.running = True
    with pytest.raises(RuntimeError, match="Another Scanstage job is running"):
        bpy.ops.scanstage.reconstruct()
    assert bpy.ops.scanstage.stop() == {'FINISHED'} and bpy.context.window_manager.scanstage_job.stop
    bpy.context.window_manager.scanstage_job.running = False
    assert not bpy.ops.scanstage.stop.poll()


def test_bad_input_is_an_error_report(captured, tmp_path):
    picture = tmp_path / "scanstage" / "capture" / "images" / "0003.png"
    picture.write_bytes(picture.read_bytes()[:100])
    with pytest.raises(RuntimeError, match="0003.png"):
        bpy.ops.scanstage.reconstruct()
    assert "Result" not in bpy.data.objects


def test_an_object_of_the_scene_is_staged_as_it_is(scene):
    bpy.ops.mesh.primitive_cube_add(size=0.1, location=(1, 2, 3))
    cube = bpy.context.object
    scene.scanstage.source, scene.scanstage.subject = 'SCENE', cube
    assert bpy.ops.scanstage.stage() == {'FINISHED'}
    assert np.allclose(cube.matrix_world.translation, (1, 2, 3))


def test_photographs_are_imported(scene, tmp_path, monkeypatch):
    from addon.ui.operators import capture

    with pytest.raises(RuntimeError, match="nothing.xml"):
        bpy.ops.scanstage.import_captures(filepath=str(tmp_path / "nothing.xml"), format="opencv")
    assert capture.capture_state(tmp_path) == "no captures"


def test_every_option_of_every_table_is_a_property(scene):
    settings = scene.scanstage
    tables = [(settings.silhouettes, SILHOUETTE_OPTIONS), (settings.shadows, SHADOW_OPTIONS)]
    tables += [(getattr(settings, f"method_{name.replace('-', '_')}"), method.options) for name, method in METHODS.items()]
    tables += [(getattr(settings, f"preset_{name.replace('-', '_')}"), preset.options) for name, preset in PRESETS.items()]
    for group, options in tables:
        for option in options:
            field = group.bl_rna.properties[option.name]
            assert field.description == option.description
            assert getattr(group, option.name) == (pytest.approx(option.default) if isinstance(option.default, float) else option.default) \
                or option.name in ("views", "resolution_x", "resolution_y")


def test_registering_three_times_leaves_nothing(empty_scene):
    def state():
        return {name for name in dir(bpy.types) if "scanstage" in name.lower()}, hasattr(bpy.types.Scene, "scanstage"), \
            hasattr(bpy.types.WindowManager, "scanstage_job"), dir(bpy.ops.scanstage)

    before = state()
    for _ in range(3):
        addon.register()
        addon.unregister()
    assert state() == before


def test_a_thread_reports_returns_raises_and_stops(scene):
    from addon.ui.jobs import in_thread

    seen = []

    def work(limit, *, progress):
        for step in range(limit):
            seen.append(step)
            progress(step / limit, f"step {step}")
        if limit == 3:
            raise ScanstageError("three is bad")
        return limit

    def outcome(generator):
        while True:
            try:
                next(generator)
            except StopIteration as end:
                return end.value

    assert outcome(in_thread(work, 5)) == 5
    with pytest.raises(ScanstageError, match="three is bad"):
        outcome(in_thread(work, 3))

    def endless(*, progress):
        try:
            while True:
                progress(0.5, "on and on")
        except Cancelled:
            seen.append("stopped")
            raise

    generator = in_thread(endless)
    next(generator)
    generator.close()
    assert seen[-1] == "stopped"


def test_a_thread_has_calls_made_by_who_runs_the_generator_and_is_refused_when_it_closes(scene):
    from addon.ui.jobs import MainThread, in_thread

    here, seen = threading.current_thread(), []

    def twice(value):
        assert threading.current_thread() is here
        if value < 0:
            raise ValueError("negative")
        return 2 * value

    def work(call, *, progress):
        assert threading.current_thread() is not here
        with pytest.raises(ValueError, match="negative"):
            call(-1)
        return call(call(3))

    main = MainThread()
    generator = in_thread(work, main.calling(twice), main=main)
    with pytest.raises(StopIteration) as end:
        while True:
            next(generator)
    assert end.value.value == 12

    def endless(call, *, progress):
        try:
            while True:
                call(1)
        except Cancelled:
            seen.append("refused")
            raise

    main = MainThread()
    generator = in_thread(endless, main.calling(twice), main=main)
    next(generator)
    generator.close()
    assert seen == ["refused"]


def test_one_frame_tells_what_the_others_take_and_is_kept(scene, tmp_path):
    assert bpy.ops.scanstage.stage() == {'FINISHED'}
    assert forecast.capture_cost(scene) == "6 frames: capture one to know the time"
    assert bpy.ops.scanstage.test_frame() == {'FINISHED'}
    settings, pictures = scene.scanstage, tmp_path / "scanstage" / "capture" / "images"
    assert settings.capture_state == "1 of 6 frames captured" and settings.capture_pixels == 120 * 90
    assert settings.frame_seconds > 0 and "about" in forecast.capture_cost(scene)
    first, = pictures.iterdir()
    written = first.stat().st_mtime_ns
    assert bpy.ops.scanstage.test_frame() == {'FINISHED'}
    assert settings.capture_state == "2 of 6 frames captured"
    assert bpy.ops.scanstage.capture() == {'FINISHED'}
    assert settings.capture_state == "6 of 6 frames captured" and settings.capture_pixels == 6 * 120 * 90 and settings.capture_frames == 6
    assert first.stat().st_mtime_ns == written


def test_a_result_is_older_once_a_picture_is_captured_again(captured, tmp_path):
    assert not is_older(captured)  # there is none
    assert bpy.ops.scanstage.reconstruct() == {'FINISHED'}
    assert not is_older(captured)
    assert bpy.ops.scanstage.capture() == {'FINISHED'}
    assert not is_older(captured)  # nothing was missing
    (tmp_path / "scanstage" / "capture" / "images" / "0003.png").unlink()
    assert bpy.ops.scanstage.capture() == {'FINISHED'}
    assert is_older(captured)


def test_the_forecast_of_a_reconstruction_follows_the_working_volume(scene):
    settings = scene.scanstage
    assert forecast.reconstruction_cost(settings)[0] == "40 x 40 x 40 voxels at most"
    for settings.method in METHODS:  # also before anything is captured
        assert "of memory" in forecast.reconstruction_cost(settings)[1]
    settings.method = "visual-hull"
    settings.use_bounds, settings.bounds_lower, settings.bounds_upper = True, (0, 0, 0), (0.2, 0.1, 0.05)
    assert forecast.reconstruction_cost(settings)[0] == "40 x 20 x 10 voxels at most"
    settings.bounds_upper = (-1, -1, -1)
    assert forecast.reconstruction_cost(settings)[0].startswith("! ")
    settings.use_bounds, settings.voxels = False, 16384
    assert forecast.reconstruction_cost(settings)[1].startswith("! ")
    assert [forecast.duration(s) for s in (0.2, 89, 600, 36000)] == ["1 s", "89 s", "10 min", "10.0 h"]
