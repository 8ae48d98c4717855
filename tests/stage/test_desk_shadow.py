# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The rig of the desk lamp: what is planned, what the strips show, and where the stick's shadow falls."""

import bpy
import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.stage import ownership, readback, staging

SMALL = {"resolution_x": 160, "resolution_y": 120, "steps": 12}


def shadow_on(plane, lamp, point):
    """Return where the ray of a lamp through a point meets a plane."""
    normal, offset = np.array(plane[:3]), plane[3]
    way = point - lamp
    return lamp + (offset - normal @ lamp) / (normal @ way) * way


@pytest.mark.parametrize("options", [{}, {"sweeps": 2}, {"wall": True}])
def test_each_sweep_has_its_own_lamp_and_pattern_and_the_strips_show_their_planes_alone(empty_scene, options):
    staging.build(empty_scene, "desk-shadow", "dented-sphere", {**SMALL, **options})
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    sweeps = options.get("sweeps", 1)
    assert [frame.pattern for frame in plan.frames] == [f"shadow-{sweep}" for sweep in range(sweeps) for _ in range(12)]
    assert [frame.lights for frame in plan.frames] == [(f"light-{sweep + 1}",) for sweep in range(sweeps) for _ in range(12)]
    assert len({frame.object_to_world.tobytes() for frame in plan.frames}) == 1  # nothing turns
    camera, = plan.cameras.values()
    pixels, _ = camera.project(vertices)
    for strip in plan.patterns["shadow-0"]["strips"]:
        first, end = strip["rows"]
        assert 0 <= first < end <= 120
        assert not ((pixels[:, 1] > first - 0.5) & (pixels[:, 1] < end - 0.5)).any()  # of the object
        rays = camera.rays(np.array([(column, row) for column in (0, 159) for row in (first, end - 1)], float))
        along = (strip["plane"][3] - camera.centre @ strip["plane"][:3]) / (rays @ strip["plane"][:3])
        assert (along > 0).all()
        points = camera.centre + along[:, None] * rays
        assert (points[:, 2] >= -1e-6).all()  # of a wall, what stands above the desk
    planes = [tuple(strip["plane"]) for strip in plan.patterns["shadow-0"]["strips"]]
    assert len(set(planes)) == (2 if options.get("wall") else 1)


def test_the_shadow_passes_over_the_object_and_the_stick_does_not_touch_it(empty_scene):
    staging.build(empty_scene, "desk-shadow", "dented-sphere", SMALL)
    plan, (vertices, _) = readback.plan_of(empty_scene), readback.truth_mesh(empty_scene)
    rod, = ownership.with_role(ownership.require_stage(empty_scene), "stick")
    lamp = next(iter(plan.lights.values())).position
    ground = next(strip["plane"] for strip in plan.patterns["shadow-0"]["strips"])
    cast = np.array([shadow_on(ground, lamp, vertex) for vertex in vertices])
    places = []
    for frame in plan.frames:
        empty_scene.frame_set(frame.number)
        middle = np.array(rod.matrix_world)[:3, 3]
        places.append(shadow_on(ground, lamp, middle)[0])
        assert np.linalg.norm(vertices - middle, axis=1).min() > rod.dimensions.x
    assert min(places) < cast[:, 0].min() and max(places) > cast[:, 0].max()
    assert not rod.visible_camera and not rod.hide_render


def test_a_lamp_too_near_is_refused_and_nothing_is_left(empty_scene):
    before = len(bpy.data.objects)
    with pytest.raises(ScanstageError, match="option lamp_distance"):
        staging.build(empty_scene, "desk-shadow", "knot", {**SMALL, "lamp_distance": 0.05})
    assert len(bpy.data.objects) == before and ownership.find_stage(empty_scene) is None
