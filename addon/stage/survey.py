# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the rig in a scene will see of its object: the plan and the object, as `addon.reconstruction.planning` takes them."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ..reconstruction.mesh import TriangleMesh
from ..reconstruction.planning.coverage import PIXEL_ERROR, Coverage, Sheet, Shot, Surveyor
from ..reconstruction.planning.tessellation import divided, simplified
from . import ownership
from .evaluated import joined, mesh_triangles
from .laser import is_laser
from .projector import is_projector
from .readback import CapturePlan, camera_of, light_of, plan_of, projector_of, rigid_motion, staged_objects, truth_mesh, turntable_of

_MOST_TRIANGLES = 30_000  # of an object that is surveyed as it is; a finer one is simplified
_CELLS = 100  # along the longest side of a simplified object
_PATCHES = 40.0  # along the longest side: no triangle that is coloured is longer than such a part of it
_MOST_PATCHES = 60_000


def survey(scene: bpy.types.Scene, *, pixel_error: float = PIXEL_ERROR) -> Coverage:
    """Return what the stage's plan covers of the staged object, as renders see it.

    Parameters
    ----------
    scene : bpy.types.Scene
    pixel_error : float
        Standard deviation of a position in a picture, in pixels.

    Raises
    ------
    ScanstageError
        The scene has no stage, or its plan or its object cannot be read.
    """
    return surveyor_of(TriangleMesh(*truth_mesh(scene))).coverage(shots_of(scene, plan_of(scene)), pixel_error=pixel_error)


def surveyor_of(mesh: TriangleMesh) -> Surveyor:
    """Return the surveyor of an object, its triangles simplified where they are too many and cut where they are too large."""
    mesh = workable(mesh)
    return Surveyor(mesh, divided(mesh.corners(), float(np.ptp(mesh.bounds(), axis=0).max()) / _PATCHES, _MOST_PATCHES))


def workable(mesh: TriangleMesh) -> TriangleMesh:
    """Return an object in no more triangles than can be worked on while a mouse moves."""
    return mesh if len(mesh.triangles) <= _MOST_TRIANGLES else simplified(mesh, _CELLS)


def shots_of(scene: bpy.types.Scene, plan: CapturePlan) -> list[Shot]:
    """Return the plan's shots: its frames put together by camera and pose, in the object frame."""
    sheets = [_sheet_of(source) for source in scene.objects if is_laser(source) and not source.hide_render]
    found: dict[tuple[str, bytes], dict] = {}
    for frame in plan.frames:
        motion = frame.object_to_world
        shot = found.setdefault((frame.camera, motion.tobytes()), {"motion": motion, "lights": {}, "projectors": {}, "laser": False})
        shot["lights"] |= dict.fromkeys(frame.lights)
        pattern = plan.patterns.get(frame.pattern, {})
        if "projector" in pattern:
            shot["projectors"][pattern["projector"]] = None
        shot["laser"] |= pattern.get("kind") == "laser"
    return [_moved(Shot(plan.cameras[camera], tuple(plan.lights[id] for id in shot["lights"]),
                        tuple(plan.projectors[id] for id in shot["projectors"]), tuple(sheets) if shot["laser"] else ()), shot["motion"])
            for (camera, _), shot in found.items()]


def with_present_devices(scene: bpy.types.Scene, plan: CapturePlan) -> CapturePlan:
    """Return the plan with its cameras, lights and projectors where they stand now: what a user has moved since it was read.

    Devices that move during the plan are left as they were: their places are the timeline's.

    Raises
    ------
    ScanstageError
        A device cannot be described any more.
    """
    found = {"cameras": dict(plan.cameras), "lights": dict(plan.lights), "projectors": dict(plan.projectors)}
    for device in scene.objects:
        if device.type not in ("CAMERA", "LIGHT"):
            continue
        kind = "cameras" if device.type == "CAMERA" else "projectors" if is_projector(device) else "lights"
        id = ownership.device_id(device)
        if id in found[kind] and f"{id}-2" not in found[kind]:
            found[kind][id] = light_of(device) if kind == "lights" else (camera_of if kind == "cameras" else projector_of)(scene, device)
    return replace(plan, **found)


def viewport_mesh(scene: bpy.types.Scene) -> TriangleMesh | None:
    """Return the staged object as the viewport shows it, in the object frame; None where nothing is there.

    Unlike `truth_mesh` it costs no render and may be asked for at any frame. Modifiers are at their viewport levels.
    """
    wanted = {member.session_uid for member in staged_objects(scene)}
    parts = []
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        owner = instance.parent if instance.is_instance else instance.object
        if instance.object.type == "MESH" and instance.show_self and owner.original.session_uid in wanted:
            parts.append(mesh_triangles(instance.object.data, np.array(instance.matrix_world)))
    vertices, triangles = joined(parts)
    if not len(triangles):
        return None
    motion = rigid_motion(turntable_of(scene))
    return TriangleMesh((vertices - motion[:3, 3]) @ motion[:3, :3], triangles)


def _sheet_of(source: bpy.types.Object) -> Sheet:
    world = np.array(source.matrix_world)
    return Sheet(world[:3, 3], world[:3, 1] / np.linalg.norm(world[:3, 1]))


def _moved(shot: Shot, motion: np.ndarray) -> Shot:
    rotation, offset = motion[:3, :3], motion[:3, 3]

    def all_moved(devices: tuple) -> tuple:
        return tuple(device.moved(motion) for device in devices)

    sheets = tuple(Sheet((sheet.centre - offset) @ rotation, sheet.axis @ rotation) for sheet in shot.sheets)
    return Shot(shot.camera.moved(motion), all_moved(shot.lights), all_moved(shot.projectors), sheets)
