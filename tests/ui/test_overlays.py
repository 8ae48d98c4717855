# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the viewport draws of a rig: lines where the devices look, coverage and hull that follow, and nothing left in the file."""

from functools import partial

import bpy
import numpy as np
import pytest
from mathutils.bvhtree import BVHTree

import addon
from addon.errors import ScanstageError
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.planning.coverage import Coverage
from addon.stage import ownership, projector, readback, sketch, staging, survey
from addon.stage.units import length_text
from addon.ui import coverage, overlays, view_panels, watching


@pytest.fixture
def scene(empty_scene):
    """An empty scene with the extension registered."""
    addon.register()
    yield bpy.context.scene
    addon.unregister()


def staged(scene, preset, subject, **options):
    staging.build(scene, preset, subject, {"resolution_x": 160, "resolution_y": 120, **options})
    return scene


def of_kind(scene, kind):
    return [found for found in sketch.sketch_devices(scene) if found.kind == kind]


def test_a_cameras_frustum_ends_at_its_pictures_border(scene):
    staged(scene, "turntable", "knot", views=4)
    found, = of_kind(scene, sketch.CAMERA)
    camera = readback.camera_of(scene, scene.camera)
    rim = found.lines[:64, 0]
    pixels, depth = camera.project(rim)
    beyond = np.maximum(np.abs(pixels - [79.5, 59.5]) - [80, 60], -1e-3)
    assert np.abs(beyond).min(axis=1).max() < 0.01 and np.abs(beyond).max() < 200  # all on the border, none outside it
    assert (beyond < 0.01).all()
    assert np.ptp(depth) < 1e-6 * depth.mean()
    assert np.allclose(found.lines[64:, 0], camera.centre) and found.active and found.label == "Camera 1"


def test_a_projector_lights_its_picture_and_says_when_it_is_dark(scene):
    staged(scene, "gray-code", "knot", views=2, projector_x=64, projector_y=48, projector_k1=-0.1)
    light = next(o for o in scene.objects if projector.is_projector(o))
    for frame, shining in ((1, False), (3, True)):
        scene.frame_set(frame)
        found, = of_kind(scene, sketch.PROJECTOR)
        assert found.active is shining
    pixels, _ = readback.projector_of(scene, light).project(found.lines[:64, 0])
    across, down = np.abs(pixels - [31.5, 23.5]).T
    assert (np.isclose(across, 32, atol=0.01) | np.isclose(down, 24, atol=0.01)).all()
    assert np.isclose(found.faces.reshape(-1, 3).max(), found.lines[:64].max())


def test_the_sheet_of_a_laser_lies_in_its_plane_and_on_the_objects_side(scene):
    staged(scene, "laser-scanner", "knot", views=1)
    scene.frame_set(scene.frame_end // 2)
    found, = of_kind(scene, sketch.LASER)
    laser = next(o for o in scene.objects if o.name == "Scanstage Laser 1")
    from addon.stage.laser import plane_of
    normal, offset = plane_of(laser)
    assert np.abs(found.lines.reshape(-1, 3) @ normal - offset).max() < 1e-6
    middle = np.array(readback.turntable_of(scene).matrix_world.translation)
    assert all((end - found.anchor) @ (middle - found.anchor) > 0 for end in found.faces[0, 1:])


@pytest.mark.parametrize("kind", ["POINT", "SUN"])
def test_a_lights_arrows_point_the_way_it_shines(scene, kind):
    staged(scene, "turntable", "knot", views=1)
    data = bpy.data.lights.new("Lamp", kind)
    lamp = bpy.data.objects.new("Lamp", data)
    scene.collection.objects.link(lamp)
    lamp.location = (3, 0, 0.2)
    lamp.rotation_euler = (0, np.pi / 2, 0)  # shines along -x
    bpy.context.view_layer.update()
    found = next(each for each in of_kind(scene, sketch.LIGHT) if each.label == "Lamp")
    ways = found.lines[:, 1] - found.lines[:, 0]
    longest = ways[np.linalg.norm(ways, axis=1).argmax()]
    assert longest[0] < 0 and np.abs(longest[1:]).max() < 0.2 * -longest[0]
    data.energy = 0
    assert not next(each for each in of_kind(scene, sketch.LIGHT) if each.label == "Lamp").active


def test_a_sticks_shadow_lies_in_the_plane_of_light_and_stick(scene):
    staged(scene, "turntable", "knot", views=1)
    stage = ownership.find_stage(scene)
    mesh = bpy.data.meshes.new("Stick")
    mesh.from_pydata([(0, -0.5, 0), (0, 0.5, 0)], [(0, 1)], [])
    stick = ownership.add(stage, "Stick", mesh, "stick")
    stick.location = (0.2, 0.1, 0.3)
    bpy.context.view_layer.update()
    found, = of_kind(scene, sketch.SHADOW)
    light = np.array(next(o for o in scene.objects if o.type == "LIGHT").matrix_world.translation)
    normal = np.cross(np.array([0.2, -0.4, 0.3]) - light, np.array([0.2, 0.6, 0.3]) - light)
    assert np.abs((found.faces - light) @ normal).max() < 1e-6
    assert not [each for each in sketch.sketch_devices(staged(scene, "turntable", "knot", views=1)) if each.kind == sketch.SHADOW]


def test_views_stand_where_the_object_sees_the_cameras(scene):
    staged(scene, "turntable", "knot", views=4)
    shots = survey.shots_of(scene, readback.plan_of(scene))
    table = readback.turntable_of(scene)
    for frame in (1, 2):
        scene.frame_set(frame)
        tips = np.array([found.lines[-1, 0] for found in sketch.sketch_views(scene, shots)])
        camera = np.array(scene.camera.matrix_world.translation)
        assert np.isclose(np.linalg.norm(tips - camera, axis=1), 0, atol=1e-5).sum() == 1  # one of them is the present one
        assert np.allclose(np.linalg.norm((tips - np.array(table.location))[:, :2], axis=1), np.linalg.norm((camera - np.array(table.location))[:2]))


def test_the_working_volume_turns_with_the_object_and_shows_its_voxels(scene):
    staged(scene, "turntable", "knot", views=4)
    grid = VoxelGrid.from_bounds((-0.1, -0.2, 0.0), (0.1, 0.2, 0.3), 40)
    box, patch = sketch.sketch_volume(scene, grid)
    assert len(box.lines) == 12 and len(patch.lines) == 3 * 2 * 8
    assert np.allclose(np.linalg.norm(patch.lines[:, 1] - patch.lines[:, 0], axis=1), 8 * grid.voxel_size)
    first = box.lines
    assert np.allclose(first.reshape(-1, 3).min(0) - np.array(readback.turntable_of(scene).location), grid.origin)
    scene.frame_set(2)
    motion = readback.rigid_motion(readback.turntable_of(scene))
    assert np.allclose(next(sketch.sketch_volume(scene, grid)).lines, (first - motion[:3, 3]) @ motion[:3, :3].T + motion[:3, 3])


def test_the_turntable_has_a_mark_for_each_stop(scene):
    staged(scene, "turntable", "knot", views=5)
    watching.look(scene)
    marks = [found for found in overlays.sketches_of(scene, bpy.context.window_manager.scanstage_view) if found.kind == sketch.TURNTABLE]
    assert marks[0].label == "5 stops" and len(marks[0].lines) == 72 + 5 + 2


def test_each_switch_takes_its_lines_away(scene):
    staged(scene, "gray-code", "knot", views=1, projector_x=32, projector_y=24)
    settings = bpy.context.window_manager.scanstage_view
    watching.look(scene)
    kinds = {"cameras": sketch.CAMERA, "views": sketch.VIEW, "projectors": sketch.PROJECTOR, "lights": sketch.LIGHT, "volume": sketch.VOLUME,
             "turntable": sketch.TURNTABLE}
    assert {found.kind for found in overlays.sketches_of(scene, settings)} == set(kinds.values())
    for name, kind in kinds.items():
        setattr(settings, name, False)
        assert {found.kind for found in overlays.sketches_of(scene, settings)} == set(kinds.values()) - {kind}
        setattr(settings, name, True)
    settings.overlays = False
    assert not list(overlays.sketches_of(scene, settings))
    settings.overlays = True


def test_without_a_stage_or_a_turntable_nothing_is_drawn(scene):
    settings = bpy.context.window_manager.scanstage_view
    assert not list(overlays.sketches_of(scene, settings))
    staged(scene, "turntable", "knot", views=2)
    bpy.data.objects.remove(readback.turntable_of(scene))
    assert not list(overlays.sketches_of(scene, settings))
    assert "turntable" in watching.look(scene).problem


def test_the_survey_agrees_with_rays(scene):
    """Blender's own ray casts, one triangle and camera after the other."""
    staged(scene, "turntable", "pot", views=3)
    plan = readback.plan_of(scene)
    shots = survey.shots_of(scene, plan)
    surveyor = survey.surveyor_of(survey.viewport_mesh(scene))
    found = surveyor.coverage(shots)
    tree = BVHTree.FromPolygons(surveyor.mesh.vertices.tolist(), surveyor.mesh.triangles.tolist())
    chosen = np.random.default_rng(1).choice(len(surveyor.corners), 700, replace=False)
    points = surveyor.corners[chosen].mean(axis=1) + 1e-5 * surveyor.normals[chosen]
    true = np.zeros(len(chosen), int)
    for shot in shots:
        pixels, _ = shot.camera.project(points)
        for number, (point, normal) in enumerate(zip(points, surveyor.normals[chosen], strict=True)):
            way = shot.camera.centre - point
            inside = (pixels[number] > -0.5).all() and (pixels[number] < np.array(shot.camera.size) - 0.5).all()
            true[number] += bool(inside and way @ normal > 0 and tree.ray_cast(point.tolist(), way.tolist())[0] is None)
    assert (found.views[chosen] != true).mean() < 0.03
    summary = survey.survey(scene).summary()  # of the mesh that is rendered: the same here
    assert summary["seen_by_less_than_1"] == pytest.approx((true == 0).mean(), abs=0.06)
    assert summary["seen_by_less_than_1"] < summary["seen_by_less_than_2"] < summary["seen_by_less_than_3"] <= 1


def test_shots_hold_what_shines_in_their_frames(scene):
    staged(scene, "gray-code", "knot", views=2, projector_x=32, projector_y=24)
    shots = survey.shots_of(scene, readback.plan_of(scene))
    assert [(len(shot.lights), len(shot.projectors), len(shot.sheets)) for shot in shots] == [(1, 1, 0)] * 2
    found = survey.survey(scene)
    assert found.projector_pixels.any() and np.isfinite(found.depth_error).any()
    staged(scene, "laser-scanner", "knot", views=2)
    assert [(len(shot.projectors), len(shot.sheets)) for shot in survey.shots_of(scene, readback.plan_of(scene))] == [(0, 1)] * 2
    assert np.isfinite(survey.survey(scene).depth_error).any()


def test_a_moved_camera_is_followed_without_reading_the_plan_again(scene):
    staged(scene, "turntable", "knot", views=6)
    empty = watching.watched.version
    assert watching.look(scene).version > empty  # the plan is new: there are views and stops to draw
    before = watching.look(scene, hull=24, coverage=0.25)
    plan, hull, views = before.plan, before.hull, before.coverage.views
    version = before.version
    assert watching.look(scene, hull=24, coverage=0.25).version == version  # nothing has moved
    scene.camera.location.z += 0.3
    bpy.context.view_layer.update()
    after = watching.look(scene, hull=24, coverage=0.25)
    assert after.plan is plan and after.version > version
    assert after.hull is not hull and (after.coverage.views != views).any()
    fresh = survey.shots_of(scene, readback.plan_of(scene))
    for found, true in zip(after.shots, fresh, strict=True):
        assert np.allclose(found.camera.P, true.camera.P, atol=1e-6)


def test_more_views_are_seen_at_once_and_the_frame_stays(scene):
    for views in (3, 6):
        staged(scene, "turntable", "knot", views=views)
        scene.frame_set(2)
        found = watching.look(scene, hull=24)
        assert len(found.shots) == views and scene.frame_current == 2
    coarse = found.hull
    assert watching.look(scene, hull=48).hull is not coarse
    fine = found.hull
    assert watching.look(scene, hull=24).hull is fine  # nothing has moved: the finer one stays


def test_a_changed_object_is_read_again(scene):
    staged(scene, "turntable", "knot", views=2)
    first = watching.look(scene, hull=24).mesh
    member = next(o for o in readback.staged_objects(scene) if o.type == "MESH")
    member.scale *= 0.5
    bpy.context.view_layer.update()
    assert np.ptp(watching.look(scene, hull=24).mesh.bounds()) < np.ptp(first.bounds())
    second = watching.watched.mesh
    member.modifiers.new("Wire", 'WIREFRAME')
    bpy.context.view_layer.update()
    assert watching.look(scene, hull=24).mesh is not second
    member.hide_set(True)
    assert "show it in the viewport" in watching.look(scene, hull=24).problem
    member.hide_set(False)
    assert not watching.look(scene, hull=24).problem
    staged(scene, "turntable", "pot", views=2)
    assert len(watching.look(scene, hull=24).mesh.triangles) == len(survey.viewport_mesh(scene).triangles) != len(first.triangles)


def test_nothing_that_is_drawn_is_in_the_file(scene, tmp_path):
    staged(scene, "turntable", "knot", views=2)
    settings = bpy.context.window_manager.scanstage_view
    known = {datablock.session_uid for datablock in bpy.data.user_map()}
    settings.coverage, settings.live_hull = 'VIEWS', True
    watching.look(scene, hull=24, coverage=0.25)
    list(overlays.sketches_of(scene, settings))
    assert {datablock.session_uid for datablock in bpy.data.user_map()} == known
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert watching.watched.plan is None
    assert len(watching.look(bpy.context.scene, hull=24).shots) == 2


def test_hulls_grow_along_the_timeline_and_can_be_undone_away(scene):
    staged(scene, "turntable", "knot", views=6)
    assert bpy.ops.scanstage.show_growing_hull(voxels=24) == {'FINISHED'}
    hulls = [bpy.data.objects[f"Hull of {count} View{'s' * (count > 1)}"] for count in (1, 2, 4, 6)]
    seen = []
    for frame in range(1, 7):
        scene.frame_set(frame)
        seen.append([hull.hide_viewport for hull in hulls].index(False))
        assert sum(not hull.hide_viewport for hull in hulls) == 1
    assert seen == sorted(seen) and set(seen) == {0, 1, 2, 3}
    assert all(hull.users_collection[0].hide_render for hull in hulls)  # no capture ever shows them
    assert bpy.ops.scanstage.show_growing_hull(voxels=16) == {'FINISHED'}
    assert sum(o.name.startswith("Hull of") for o in bpy.data.objects) == 4
    staging.remove(scene)
    assert not bpy.ops.scanstage.show_growing_hull.poll()


def test_counts_have_colours_of_their_own_and_amounts_a_ramp():
    def made(**values):
        defaults = {"areas": np.ones(4), "views": np.zeros(4, int), "lights": np.zeros(4, int), "projector_pixels": np.zeros(4),
                    "depth_error": np.full(4, np.inf)}
        return Coverage(**{**defaults, **values})

    colors, legend = coverage.colors_of(made(views=np.array([0, 1, 2, 24])), 'VIEWS', str)
    assert (colors[0] == coverage.NEVER).all() and len(np.unique(colors, axis=0)) == 4
    assert [text for _, text in legend.entries][:3] == ["0", "1", "2"] and legend.entries[-1][1] == "24"
    for color, text in legend.entries[1:]:
        assert text not in ("1", "2", "24") or (colors[[1, 2, 24].index(int(text)) + 1] == pytest.approx(color))
    colors, legend = coverage.colors_of(made(depth_error=np.array([1e-4, 2e-4, 3e-4, np.inf])), 'ERROR', partial(length_text, bpy.context.scene))
    assert (colors[3] == coverage.NEVER).all() and legend.entries[0][1] == "no depth" and legend.entries[1][1] == "110 \u00b5m and less"
    assert colors[0].sum() > colors[1].sum() > colors[2].sum()  # the better, the brighter
    passive = coverage.colors_of(made(depth_error=np.ones(4), active=False), 'ERROR', str)[1]
    assert "light" in legend.note and "textured" in passive.note  # what each assumes
    assert len(coverage.colors_of(made(), 'PIXELS', str)[1].entries) == 1


def test_labels_do_not_cover_each_other():
    rng = np.random.default_rng(3)
    wanted = [(*place, 60.0, 18.0) for place in rng.uniform(0, 200, (40, 2))]
    placed = np.array(overlays.placed_labels(wanted))
    apart = np.abs(placed[:, None] - placed) - [60, 18]
    assert ((apart > -1e-9).any(axis=-1) | np.eye(len(placed), dtype=bool)).all()
    assert placed[0].tolist() == list(wanted[0][:2])


def test_the_panel_says_what_the_rig_misses(scene):
    staged(scene, "turntable", "knot", views=2)
    missed = watching.look(scene, coverage=0.25).missed
    lines = dict(view_panels.missed_lines(scene, missed))
    assert lines["Seen by no view"] == f"{100 * missed['seen_by_less_than_1']:.1f} %" and "Beyond projectors" not in lines


def test_a_survey_of_no_stage_says_so(scene):
    with pytest.raises(ScanstageError, match="build one first"):
        survey.survey(scene)
