# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What belongs to the stage and what to the user, and how the stage is taken away without a trace.

Every data-block that staging makes carries a mark; only marked ones are ever deleted. What staging changes in the
user's own scene (settings, world, camera, material overrides, marker cameras, what is rendered) is remembered in the
stage's collection and put back. Roles, not names, tell the stage's objects apart, so the user may rename them.
"""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import bpy

from ..errors import ScanstageError
from . import scene_settings
from .extents import box_of, has_surface

COLLECTION_NAME = "Scanstage"
_MARK = "scanstage_made"
_PRESET = "scanstage_preset"
_OPTIONS = "scanstage_options"
_SETTINGS = "scanstage_settings_before"
_WORLD = "scanstage_world_before"
_CAMERA = "scanstage_camera_before"
_OVERRIDES = "scanstage_material_overrides_before"
_MARKERS = "scanstage_marker_cameras_before"
_ACTION = "scanstage_action_before"
_HIDDEN = "scanstage_hidden"
_IN_THE_WAY = "scanstage_in_the_way"
_ROLE = "scanstage_role"
_DEVICE = "scanstage_device"
_CONSTRAINT, _CARRIED = "Scanstage Turntable", "Scanstage Turntable, Carried Along"
_TOUCH = 1e-3  # of the object's size
# What staging and Blender's importers make. Shape keys go with their mesh and cannot be removed by themselves.
_KINDS = ("objects", "meshes", "curves", "metaballs", "armatures", "cameras", "lights", "materials", "textures",
          "images", "node_groups", "actions", "worlds", "collections", "texts", "fonts", "particles", "speakers")


def find_stage(scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """Return the collection of the scene's stage, or None."""
    return next((c for c in scene.collection.children_recursive if _PRESET in c), None)


def require_stage(scene: bpy.types.Scene) -> bpy.types.Collection:
    """Return the collection of the scene's stage.

    Raises
    ------
    ScanstageError
        The scene has none.
    """
    stage = find_stage(scene)
    if stage is None:
        raise ScanstageError(f"scene {scene.name!r} has no stage: build one first, in the Stage panel or with "
                             "`scanstage stage PRESET --out FILE.blend`")
    return stage


def create_stage(scene: bpy.types.Scene, preset: str, options: dict[str, object]) -> bpy.types.Collection:
    """Make the stage's collection and remember in it what the scene was like."""
    _show_hidden(None)  # by a stage whose collection the user has deleted
    stage = mark(bpy.data.collections.new(COLLECTION_NAME))
    scene.collection.children.link(stage)
    stage[_PRESET] = preset
    stage[_OPTIONS] = json.dumps(options)
    paths = (*scene_settings.capture_settings(scene), *scene_settings.STAGE_SETTINGS)
    stage[_SETTINGS] = json.dumps(scene_settings.snapshot(scene, paths))
    stage[_WORLD], stage[_CAMERA] = scene.world, scene.camera
    stage[_ACTION] = scene.animation_data.action if scene.animation_data else None
    stage[_OVERRIDES] = {layer.name: layer.material_override for layer in scene.view_layers if layer.material_override}
    # A marker's camera overrides the scene's in every render.
    bound = [marker for marker in scene.timeline_markers if marker.camera is not None]
    stage[_MARKERS] = {f"{marker.frame} {marker.name}": marker.camera for marker in bound}
    for marker in bound:
        marker.camera = None
    return stage


def staged_preset(stage: bpy.types.Collection) -> str:
    """Return the name of the preset the stage was built from."""
    return stage[_PRESET]


def staged_options(stage: bpy.types.Collection) -> dict[str, object]:
    """Return the options the stage was built with."""
    return json.loads(stage[_OPTIONS])


def add(stage: bpy.types.Collection, name: str, data: bpy.types.ID | None, role: str, *,
        device: str | None = None) -> bpy.types.Object:
    """Make an object of the stage. ``device`` is the id of a camera, light or projector in the captures."""
    made = mark(bpy.data.objects.new(name, data))
    if data is not None:
        mark(data)
    stage.objects.link(made)
    made[_ROLE] = role
    if device is not None:
        made[_DEVICE] = device
    return made


def mark(datablock: bpy.types.ID) -> bpy.types.ID:
    """Mark a data-block as made by staging and return it."""
    datablock[_MARK] = True
    return datablock


def release(member: bpy.types.Object) -> None:
    """Make an object, its data and its children the user's own: no stage that goes takes them along."""
    for owned in (member, *member.children_recursive):
        for datablock in (owned, owned.data):
            if datablock is not None and _MARK in datablock:
                del datablock[_MARK]


def is_marked(datablock: bpy.types.ID) -> bool:
    """Return whether staging made the data-block."""
    return _MARK in datablock


@contextmanager
def marking_new() -> Iterator[None]:
    """Mark every data-block that is made meanwhile: an importer's meshes, materials, pictures and so on."""
    before = {datablock.session_uid for datablock in _all_datablocks()}
    try:
        yield
    finally:
        for datablock in _all_datablocks():
            if datablock.session_uid not in before and datablock.library is None:
                mark(datablock)


def with_role(stage: bpy.types.Collection, role: str) -> list[bpy.types.Object]:
    """Return the stage's objects of one role, in the order of their names."""
    return sorted((o for o in stage.all_objects if o.get(_ROLE) == role), key=lambda o: o.name)


def role_of(member: bpy.types.Object) -> str | None:
    """Return the role of an object of the stage, or None of what is the user's."""
    return member.get(_ROLE)


def device_id(device: bpy.types.Object) -> str:
    """Return the id under which a camera or light is known in captures; a user's own is known by its name."""
    return device.get(_DEVICE) or "".join(c if c.isalnum() and c.isascii() else "-" for c in device.name).lower()


def attach(member: bpy.types.Object, turntable: bpy.types.Object, *, staged: bool = True, moved: bool = True) -> None:
    """Let the turntable carry an object of the user's, which keeps its place, parent, scale and animation.

    Parameters
    ----------
    staged : bool
        Whether it is scanned, and does not merely turn along.
    moved : bool
        False where a parent carries it already.

    Raises
    ------
    ScanstageError
        The object is linked from another file and cannot be given a constraint.
    """
    if not member.is_editable:
        raise ScanstageError(f"object {member.name!r} is linked from another file: make it local, or override it")
    constraint = member.constraints.new("CHILD_OF")
    constraint.name = _CONSTRAINT if staged else _CARRIED
    constraint.target = turntable
    constraint.mute = not moved
    constraint.inverse_matrix = turntable.matrix_basis.inverted()


def attached(turntable: bpy.types.Object) -> list[bpy.types.Object]:
    """Return the user's objects that are scanned on the turntable."""
    return [o for o in bpy.data.objects if any(c.name == _CONSTRAINT for c in _ties(o, turntable))]


def _ties(member: bpy.types.Object, turntable: bpy.types.Object) -> list[bpy.types.Constraint]:
    return [c for c in member.constraints if c.type == "CHILD_OF" and c.name in (_CONSTRAINT, _CARRIED) and c.target == turntable]


def hide_from_render(scene: bpy.types.Scene, stage: bpy.types.Collection, keep: Iterable[bpy.types.Object]) -> None:
    """Keep everything but the stage and ``keep`` out of the pictures, and remember what was hidden."""
    kept = {*stage.all_objects, *keep}
    for other in scene.objects:
        if other not in kept and not other.hide_render and other.is_editable:
            other.hide_render = True
            other[_HIDDEN] = stage


def hide_in_the_way(stage: bpy.types.Collection, staged: Iterable[bpy.types.Object]) -> None:
    """Hide from the viewport what stands where the staged objects do, as Blender's first cube would swallow a built-in object."""
    box = box_of(staged)
    if box is None:
        return
    lower, upper = box
    lower = lower + _TOUCH * (upper - lower)  # the floor on which it stands is not in its way
    ours = set(stage.all_objects)
    for other in bpy.context.view_layer.objects:
        if other not in ours and has_surface(other) and other.visible_get():
            low, high = box_of([other]) or (upper, lower)
            if (high > lower).all() and (low < upper).all():
                other[_IN_THE_WAY] = {"stage": stage, "selected": other.select_get()}
                other.hide_set(True)  # which also deselects it


def remove_stage(scene: bpy.types.Scene) -> None:
    """Take the scene's stage away, if it has one: everything is as it was before, and nothing is left over."""
    stage = find_stage(scene)
    if stage is None:
        return
    for turntable in with_role(stage, "turntable"):
        for member in bpy.data.objects:
            for constraint in _ties(member, turntable):
                member.constraints.remove(constraint)
    _show_hidden(stage)
    _restore_scene(scene, stage)
    for member in list(stage.all_objects):
        if is_marked(member):
            bpy.data.objects.remove(member)
        elif member.users_collection == (stage,):
            scene.collection.objects.link(member)  # the user put it here; it stays
    bpy.data.collections.remove(stage)
    _remove_orphans()


def _show_hidden(stage: bpy.types.Collection | None) -> None:
    for other in bpy.data.objects:
        if _HIDDEN in other and other[_HIDDEN] == stage:
            other.hide_render = False
            del other[_HIDDEN]
        if _IN_THE_WAY in other and other[_IN_THE_WAY]["stage"] == stage:
            selected = bool(other[_IN_THE_WAY]["selected"])
            del other[_IN_THE_WAY]
            if other.name in bpy.context.view_layer.objects:
                other.hide_set(False)
                other.select_set(selected)


def _restore_scene(scene: bpy.types.Scene, stage: bpy.types.Collection) -> None:
    ours = set(stage.all_objects)
    for marker in [m for m in scene.timeline_markers if m.camera in ours]:
        scene.timeline_markers.remove(marker)
    before = stage[_MARKERS]
    for marker in scene.timeline_markers:
        if marker.camera is None:
            marker.camera = before.get(f"{marker.frame} {marker.name}")
    if scene.camera is None or scene.camera in ours:
        scene.camera = stage.get(_CAMERA)
    if scene.world is None or is_marked(scene.world):
        scene.world = stage.get(_WORLD)
    for layer in scene.view_layers:
        if layer.material_override is not None and is_marked(layer.material_override):
            layer.material_override = stage[_OVERRIDES].get(layer.name)
    animation = scene.animation_data
    if animation and (animation.action is None or is_marked(animation.action)):
        animation.action = stage.get(_ACTION)
    scene_settings.apply(scene, json.loads(stage[_SETTINGS]))  # last: a setting may have been animated


def _remove_orphans() -> None:
    # Removing one (a mesh) can free others (its materials), and those others still (their pictures).
    while orphans := [d for d in _all_datablocks() if is_marked(d) and d.users == int(d.use_fake_user)]:
        bpy.data.batch_remove(orphans)


def _all_datablocks() -> Iterator[bpy.types.ID]:
    for kind in _KINDS:
        yield from getattr(bpy.data, kind)
