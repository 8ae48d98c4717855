# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A rig round several objects of the user's, of any kind and in any unit, which touches nothing else."""

import bpy
import numpy as np
import pytest

from addon.reconstruction.geometry import VoxelGrid
from addon.stage import extents, ownership, readback, sketch, staging, survey
from addon.stage.units import length_text

KINDS = ("objects", "meshes", "curves", "cameras", "lights", "materials", "node_groups", "actions", "worlds", "collections", "armatures",
         "images")


def values_of(owner, depth=2):
    """Return every plain value of a data-block or of a part of one, by path, as Python prints it."""
    found = {}
    for prop in owner.bl_rna.properties:
        value = getattr(owner, prop.identifier, None)
        if prop.identifier in ("rna_type", "is_evaluated", "original", "users", "session_uid", "is_runtime_data", "tag"):
            continue
        if prop.type == 'POINTER':
            found[prop.identifier] = value.name if isinstance(value, bpy.types.ID) else None if value is None else str(type(value))
        elif prop.type == 'COLLECTION':
            names = [getattr(each, "name", "") for each in value][:200]
            found[prop.identifier] = names
            if depth and prop.identifier in ("modifiers", "constraints", "material_slots"):
                found |= {f"{prop.identifier}.{i}.{name}": v for i, each in enumerate(value) for name, v in values_of(each, 0).items()}
        else:
            found[prop.identifier] = repr(list(value) if getattr(prop, "is_array", False) else value)
    return found


def state_of_users():
    """Return the state of every data-block that staging did not make."""
    state = {}
    for kind in KINDS:
        for block in getattr(bpy.data, kind):
            if not ownership.is_marked(block) and block.name != "Render Result":
                state[kind, block.name] = values_of(block) | {"custom": sorted(block.keys())}
    return state


def changes(before, after):
    """Return (data-block, property) of all that differs, but for what is evaluated and settles with single precision."""
    assert before.keys() == after.keys()
    return {(block, name) for block, values in before.items() for name in values | after[block] if values.get(name) != after[block].get(name)
            and not name.startswith("matrix") and name not in ("dimensions", "bound_box")}


def mesh_object(name, at=(0, 0, 0), size=1.0, mesh=None):
    """Return a new cube in the scene."""
    if mesh is None:
        bpy.ops.mesh.primitive_cube_add(size=1.0)
        made = bpy.context.object
        made.name = made.data.name = name
    else:
        made = bpy.data.objects.new(name, mesh)
        bpy.context.scene.collection.objects.link(made)
    made.location, made.scale = at, (size,) * 3
    bpy.context.view_layer.update()
    return made


@pytest.fixture
def furnished(empty_scene):
    """Return a scene with two cubes of one mesh, a floor, a curve, a lamp and a camera."""
    first = mesh_object("First", (1, 2, 0.5))
    mesh_object("Second", (2.5, 2, 0.5), 0.5, first.data)
    mesh_object("Floor", (0, 0, -1), 20, first.data)
    bpy.ops.curve.primitive_bezier_circle_add(location=(1, 3, 0))
    bpy.context.object.name, bpy.context.object.data.bevel_depth = "Ring", 0.1
    bpy.ops.object.light_add(location=(3, 3, 3))
    bpy.ops.object.camera_add(location=(9, 9, 9))
    return empty_scene


def test_a_rig_round_several_objects_touches_nothing_else(furnished):
    scene = furnished
    chosen = [scene.objects["First"], scene.objects["Second"], scene.objects["Ring"]]
    before = state_of_users()
    staging.build(scene, "turntable", chosen, {"views": 4})
    while_staged = changes(before, state_of_users())
    names = {member.name for member in chosen}
    for (kind, name), prop in while_staged:
        assert kind in ("objects", "collections")
        if name in names:
            assert prop == "constraints" or prop.startswith("constraints."), (name, prop)
        else:  # kept out of the pictures, and marked so that it can come back
            assert prop in ("hide_render", "custom"), (name, prop)
    staging.remove(scene)
    assert changes(before, state_of_users()) == set()


def test_several_objects_turn_as_one(furnished):
    scene = furnished
    chosen = [scene.objects["First"], scene.objects["Second"]]
    places = [np.array(member.matrix_world) for member in chosen]
    staging.build(scene, "turntable", chosen, {"views": 4})
    vertices, triangles = readback.truth_mesh(scene)
    assert len(triangles) == 24
    corners = np.concatenate([np.array([vertex.co for vertex in member.data.vertices]) @ place[:3, :3].T + place[:3, 3]
                              for member, place in zip(chosen, places, strict=True)])
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    np.testing.assert_allclose(np.sort(vertices, axis=0), np.sort(corners - [*(lower + upper)[:2] / 2, lower[2]], axis=0), atol=1e-6)
    table = readback.turntable_of(scene)
    start = np.linalg.inv(readback.rigid_motion(table))
    for frame in (2, 3, 4):
        scene.frame_set(frame)
        for member, place in zip(chosen, places, strict=True):
            np.testing.assert_allclose(np.array(member.matrix_world), readback.rigid_motion(table) @ start @ place, atol=1e-5)


def test_undo_takes_the_rig_away_as_if_it_had_not_been(furnished):
    bpy.ops.ed.undo_push(message="before")
    before = state_of_users()
    staging.build(furnished, "shadow-array", [furnished.objects["First"], furnished.objects["Second"]], {"views": 2})
    bpy.ops.ed.undo_push(message="staged")
    assert bpy.ops.ed.undo() == {'FINISHED'}
    assert ownership.find_stage(bpy.context.scene) is None and changes(before, state_of_users()) == set()


def shape_at(scene, frame):
    """Return the vertices of what stands on the table, in its own frame."""
    scene.frame_set(frame)
    return survey.viewport_mesh(scene).vertices


def mirrored(member):
    plane = mesh_object("Plane of Mirror", (-0.5, 0.3, 0))
    member.modifiers.new("Mirror", 'MIRROR').mirror_object = plane
    return plane


def cut(member):
    cutter = mesh_object("Cutter", (0.4, 0.3, 0.2), 0.7)
    modifier = member.modifiers.new("Cut", 'BOOLEAN')
    modifier.object, modifier.solver = cutter, 'EXACT'
    return cutter


def cut_by_a_mirrored_one(member):
    mirrored(cut(member))
    return bpy.data.objects["Plane of Mirror"]


def posed(member):
    bpy.ops.object.armature_add(location=(0.3, 0, 0))
    armature = bpy.context.object
    member.parent = armature  # selected without it
    member.vertex_groups.new(name="Bone").add(range(4), 1.0, 'REPLACE')
    member.modifiers.new("Armature", 'ARMATURE').object = armature
    armature.pose.bones[0].location = (0.5, 0, 0)  # a bone's y is along it, which here is the turntable's axis
    return armature


def placed_by_nodes(member):
    other = mesh_object("Instance", (0, 0, 3), 0.3)
    tree = bpy.data.node_groups.new("Join", 'GeometryNodeTree')
    tree.interface.new_socket("Geometry", in_out='INPUT', socket_type='NodeSocketGeometry')
    tree.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    tree.interface.new_socket("Object", in_out='INPUT', socket_type='NodeSocketObject')
    start, end = tree.nodes.new('NodeGroupInput'), tree.nodes.new('NodeGroupOutput')
    info, join = tree.nodes.new('GeometryNodeObjectInfo'), tree.nodes.new('GeometryNodeJoinGeometry')
    info.transform_space = 'RELATIVE'
    tree.links.new(start.outputs["Object"], info.inputs["Object"])
    for source in (start.outputs["Geometry"], info.outputs["Geometry"]):
        tree.links.new(source, join.inputs["Geometry"])
    tree.links.new(join.outputs["Geometry"], end.inputs["Geometry"])
    modifier = member.modifiers.new("Nodes", 'NODES')
    modifier.node_group = tree
    socket = next(item.identifier for item in tree.interface.items_tree if item.name == "Object")
    if hasattr(modifier, "properties"):  # 5.x
        getattr(modifier.properties.inputs, socket).value = other
    else:
        modifier[socket] = other
    return other


@pytest.mark.parametrize("shape", [mirrored, cut, cut_by_a_mirrored_one, posed, placed_by_nodes])
def test_what_modifiers_refer_to_turns_along_and_is_no_part_of_the_scan(empty_scene, shape):
    member = mesh_object("Body")
    other = shape(member)
    before = state_of_users()
    staging.build(empty_scene, "turntable", [member], {"views": 4})
    first = shape_at(empty_scene, 1)
    assert len(first) >= 8
    for frame in (2, 3, 4):
        np.testing.assert_allclose(shape_at(empty_scene, frame), first, atol=1e-5)
    assert readback.staged_objects(empty_scene) == [member] and other.hide_render
    staging.remove(empty_scene)
    assert changes(before, state_of_users()) == set()


def test_a_child_that_is_selected_with_its_parent_turns_once(empty_scene):
    parent, child = mesh_object("Parent"), mesh_object("Child", (0, 0, 2), 0.5)
    child.parent = parent
    staging.build(empty_scene, "turntable", [child, parent], {"views": 4})
    np.testing.assert_allclose(shape_at(empty_scene, 2), shape_at(empty_scene, 1), atol=1e-5)
    assert not child.constraints


def test_modifiers_count_as_they_are_rendered(empty_scene):
    member = mesh_object("Body", (5, 5, 5))
    array = member.modifiers.new("Array", 'ARRAY')
    array.count, array.relative_offset_displace = 3, (2, 0, 0)
    staging.build(empty_scene, "turntable", [member], {"views": 2})
    np.testing.assert_allclose(np.ptp(readback.truth_mesh(empty_scene)[0], axis=0), (5, 1, 1), atol=1e-5)


@pytest.mark.parametrize("linked", [False, True])
def test_an_instance_of_a_collection_is_scanned_with_all_that_is_in_it(empty_scene, tmp_path, linked):
    scene = empty_scene
    inner, outer = bpy.data.collections.new("Inner"), bpy.data.collections.new("Outer")
    cube = mesh_object("Cube", (0, 0, 1))
    scene.collection.objects.unlink(cube)
    inner.objects.link(cube)
    inner.instance_offset = (0, 0, 0.5)
    nested = bpy.data.objects.new("Nested", None)
    nested.instance_type, nested.instance_collection, nested.location = 'COLLECTION', inner, (2, 0, 0)
    outer.objects.link(nested)
    if linked:
        bpy.data.libraries.write(str(tmp_path / "set.blend"), {outer})
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene = bpy.context.scene
        with bpy.data.libraries.load(str(tmp_path / "set.blend"), link=True) as (_, target):
            target.collections = ["Outer"]
        outer = target.collections[0]
    shown = bpy.data.objects.new("Shown", None)
    shown.instance_type, shown.instance_collection, shown.scale, shown.location = 'COLLECTION', outer, (1, 2, 3), (7, 7, 7)
    scene.collection.objects.link(shown)
    bpy.context.view_layer.update()
    before = state_of_users()
    lower, upper = extents.box_of([shown])
    np.testing.assert_allclose((lower, upper), ((8.5, 6, 7), (9.5, 8, 10)), atol=1e-5)
    staging.build(scene, "turntable", [shown], {"views": 4})
    vertices, triangles = readback.truth_mesh(scene)
    assert len(triangles) == 12
    np.testing.assert_allclose(np.ptp(vertices, axis=0), (1, 2, 3), atol=1e-5)
    np.testing.assert_allclose(shape_at(scene, 2), shape_at(scene, 1), atol=1e-5)
    camera = next(each for each in sketch.sketch_devices(scene) if each.kind == sketch.CAMERA)
    assert len(camera.lines)
    staging.remove(scene)
    assert changes(before, state_of_users()) == set()


@pytest.mark.parametrize(("scale", "system", "text"), [(0.001, 'METRIC', "mm"), (0.0254, 'IMPERIAL', "thou")])
def test_a_built_in_object_has_its_size_in_the_scenes_units(empty_scene, scale, system, text):
    units = empty_scene.unit_settings
    units.scale_length, units.system = scale, system
    staging.build(empty_scene, "turntable", "knot", {"views": 3})
    vertices, _ = readback.truth_mesh(empty_scene)
    assert np.ptp(vertices, axis=0).max() * scale == pytest.approx(0.2, rel=1e-5)
    camera = readback.plan_of(empty_scene).cameras["camera-1"]
    pixels, _ = camera.project(vertices)
    assert (pixels > -0.5).all() and (pixels < [639.5, 479.5]).all()
    assert np.ptp(pixels, axis=0).max() > 240  # and it fills the picture as it does in metres
    grid = survey.surveyor_of(survey.viewport_mesh(empty_scene)).mesh.bounds()
    label = [each.label for each in sketch.sketch_volume(empty_scene, VoxelGrid.from_bounds(*grid, 128)) if each.label]
    assert label[0].endswith(text) and length_text(empty_scene, 0.2 / scale) in ("200 mm", '7.87"')
