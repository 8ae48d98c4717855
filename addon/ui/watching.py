# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the viewport knows of the rig while it is moved: read at once where that is quick, and the rest when the mouse rests.

Everything lives here, in memory: nothing of it is saved in a file, and nothing in the file is changed. The timeline's plan is read
by stepping through its frames, which is done only when keys, markers or settings have changed; a device that is merely moved is
read where it stands.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..errors import ScanstageError
from ..reconstruction.geometry import VoxelGrid
from ..reconstruction.mesh import TriangleMesh
from ..reconstruction.planning.coverage import Coverage, Shot, Surveyor
from ..reconstruction.planning.outlines import Outliner
from ..reconstruction.planning.preview_hull import preview_grid, preview_hull
from ..reconstruction.volumetric.surface import Surface, extract_surface
from ..stage import ownership, readback, survey

QUICK, FINE = 64, 128  # voxels of the live hull while the rig moves, and at rest
_SOON, _REST, _WAIT = 0.03, 0.35, 1.0  # seconds: to the first answer, to the fine one, and between looks while something else works


@dataclass
class Watched:
    """What is known of the scene that is watched.

    Attributes
    ----------
    plan : CapturePlan or None
    shots : list of Shot
    mesh : TriangleMesh or None
        The staged object, in the object frame.
    hull : Surface or None
    coverage : Coverage or None
    missed : dict
        Of `Coverage.summary`.
    problem : str
        Why there is nothing to show.
    version : int
        Counts what was found: whoever draws has something new when it has grown.
    """

    plan: readback.CapturePlan | None = None
    shots: list[Shot] = field(default_factory=list)
    mesh: TriangleMesh | None = None
    surveyor: Surveyor | None = None
    outliner: Outliner | None = None
    hull: Surface | None = None
    coverage: Coverage | None = None
    missed: dict = field(default_factory=dict)
    problem: str = ""
    version: int = 0
    plan_key: tuple = ()
    mesh_key: tuple = ()
    read_key: tuple = ()
    hull_key: tuple = ()
    hull_voxels: int = 0
    coverage_key: tuple = ()
    staged: frozenset = frozenset()  # session_uid of the objects that the mesh is made of
    plan_is_old: bool = True
    mesh_is_old: bool = True
    reading: bool = False  # the plan, which moves the scene through its frames


watched = Watched()


def look(scene: bpy.types.Scene, *, hull: int = 0, coverage: float = 0.0) -> Watched:
    """Bring what is known up to date, as far as it is asked for.

    Parameters
    ----------
    scene : bpy.types.Scene
        The context's.
    hull : int
        Voxels along the longest side of the live hull; 0 for none.
    coverage : float
        The pixel error with which coverage is measured; 0 for none.
    """
    before = watched.problem
    try:
        _read(scene)
        key = _key_of(watched.shots), watched.mesh_key
        watched.version += key != watched.read_key
        watched.read_key = key
        if hull and (watched.hull_key != key or watched.hull_voxels < hull):
            cameras, grid = [shot.camera for shot in watched.shots], preview_grid(watched.mesh, hull)
            watched.hull, watched.hull_key, watched.hull_voxels = extract_surface(preview_hull(watched.outliner, cameras, grid)), key, hull
            watched.version += 1
        if coverage and watched.coverage_key != (*key, coverage):
            watched.coverage, watched.coverage_key = watched.surveyor.coverage(watched.shots, pixel_error=coverage), (*key, coverage)
            watched.missed = watched.coverage.summary()
            watched.version += 1
        watched.problem = ""
    except ScanstageError as error:
        watched.hull, watched.coverage, watched.hull_key, watched.coverage_key = None, None, (), ()
        watched.problem = str(error)
    watched.version += watched.problem != before
    return watched


def forget() -> None:
    """Forget everything: another file, or another stage."""
    watched.__init__(version=watched.version + 1)


def working_grid(scene: bpy.types.Scene) -> VoxelGrid | None:
    """Return the voxels that a reconstruction will have: of the working volume that is set, or of a box about the object."""
    settings = scene.scanstage
    try:
        if settings.use_bounds:
            return VoxelGrid.from_bounds(settings.bounds_lower, settings.bounds_upper, settings.voxels)
        return None if watched.mesh is None else VoxelGrid.from_bounds(*watched.mesh.bounds(), settings.voxels)
    except ValueError:  # a volume that is flat, or inside out, while it is typed
        return None


def _read(scene: bpy.types.Scene) -> None:
    """Read the plan, the devices and the object, each only if it may have changed."""
    stage = ownership.require_stage(scene)
    table = readback.turntable_of(scene)
    key = (stage.session_uid, scene.frame_start, scene.frame_end, scene.frame_step, tuple(table.location), tuple(table.delta_location),
           tuple((marker.frame, marker.camera and marker.camera.session_uid) for marker in scene.timeline_markers))
    if watched.plan_is_old or key != watched.plan_key or watched.plan is None:
        watched.reading = True
        try:
            watched.plan, watched.plan_key = readback.plan_of(scene), key
        finally:
            watched.reading = False
        watched.plan_is_old = False
    watched.shots = survey.shots_of(scene, survey.with_present_devices(scene, watched.plan))
    to_table = np.linalg.inv(np.array(table.matrix_world))
    key = tuple((member.session_uid, member.visible_get(), np.round(to_table @ np.array(member.matrix_world), 5).tobytes())
                for member in readback.staged_objects(scene))
    if watched.mesh_is_old or key != watched.mesh_key:
        mesh = survey.viewport_mesh(scene)
        if mesh is None:
            raise ScanstageError("the staged object is hidden or has no faces: show it in the viewport")
        watched.mesh, watched.mesh_key = survey.workable(mesh), key
        watched.outliner, watched.surveyor = Outliner(watched.mesh), survey.surveyor_of(watched.mesh)
        watched.read_key, watched.hull_key, watched.coverage_key = (), (), ()
        watched.staged = frozenset(uid for uid, _, _ in key)
        watched.mesh_is_old = False


def _key_of(shots: list[Shot]) -> bytes:
    """Return what tells one set of shots from another; rounded, so that nothing seems to move by itself."""
    devices = [device for shot in shots for device in (shot.camera, *shot.projectors, *shot.lights, *shot.sheets)]
    return b"".join(np.round(np.asarray(value, np.float64), 6).tobytes() for device in devices for value in vars(device).values()
                    if value is not None and not isinstance(value, str))


@persistent
def on_change(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Note what has changed, and look as soon as Blender has time."""
    if watched.reading or not wanted() or ownership.find_stage(scene) is None:
        return
    for update in depsgraph.updates:
        kind = update.id.bl_rna.identifier
        watched.plan_is_old |= kind == "Action"
        watched.mesh_is_old |= update.is_updated_geometry and update.id.original.session_uid in watched.staged
    soon()


@persistent
def on_load(*_) -> None:
    """Forget the file that was open."""
    forget()
    if wanted():
        soon()


@persistent
def on_undo(*_) -> None:
    """Read everything again."""
    watched.plan_is_old = watched.mesh_is_old = True
    if wanted():
        soon()


def soon() -> None:
    """Look quickly as soon as Blender has time, and closely when nothing has moved for a while."""
    if bpy.app.background:
        return
    if not bpy.app.timers.is_registered(_look_quickly):
        bpy.app.timers.register(_look_quickly, first_interval=_SOON)
    if bpy.app.timers.is_registered(_look_closely):
        bpy.app.timers.unregister(_look_closely)
    bpy.app.timers.register(_look_closely, first_interval=_REST)


def wanted() -> bool:
    """Return whether anything is switched on that must be kept up to date."""
    settings = getattr(bpy.context.window_manager, "scanstage_view", None)
    return settings is not None and (settings.overlays or settings.live_hull or settings.coverage != 'NONE')


def _look_quickly() -> float | None:
    settings = bpy.context.window_manager.scanstage_view
    return _look(hull=QUICK * settings.live_hull)


def _look_closely() -> float | None:
    settings = bpy.context.window_manager.scanstage_view
    return _look(hull=FINE * settings.live_hull, coverage=settings.pixel_error * (settings.coverage != 'NONE'))


def _look(**closely) -> float | None:
    """Look from a timer, if nothing else is at work; return when to try again otherwise."""
    manager = bpy.context.window_manager
    if not wanted() or ownership.find_stage(bpy.context.scene) is None:
        return None
    if manager.scanstage_job.running or bpy.app.is_job_running('RENDER') or any(w.screen.is_animation_playing for w in manager.windows):
        return _WAIT
    version = watched.version
    look(bpy.context.scene, **closely)
    if watched.version != version:
        redraw()
    return None


def redraw() -> None:
    """Have all 3-D views drawn again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == 'VIEW_3D':
                area.tag_redraw()


def register() -> None:
    """Follow the changes of every scene."""
    forget()
    bpy.app.handlers.depsgraph_update_post.append(on_change)
    bpy.app.handlers.load_post.append(on_load)
    for handlers in (bpy.app.handlers.undo_post, bpy.app.handlers.redo_post):
        handlers.append(on_undo)


def unregister() -> None:
    """Stop following."""
    for timer in (_look_quickly, _look_closely):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    for handlers in (bpy.app.handlers.redo_post, bpy.app.handlers.undo_post):
        handlers.remove(on_undo)
    bpy.app.handlers.load_post.remove(on_load)
    bpy.app.handlers.depsgraph_update_post.remove(on_change)
    forget()
