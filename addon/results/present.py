# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A result in the scene of its stage: the voxel mesh beside the object, and truth, result and error in a row.

Everything lies in one collection that renders skip, so that capturing again shows the object alone.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..errors import ScanstageError
from ..reconstruction.evaluation import vertex_distances
from ..reconstruction.mesh import TriangleMesh
from ..stage.ownership import find_stage
from ..stage.readback import frame_kept, staged_objects, truth_mesh, turntable_of
from .cameras import cameras_are_shown
from .carved import add_carved
from .comparison import add_comparison
from .folder import Result
from .materials import OWNER, probability_material, voxel_material
from .objects import add_polygon_mesh, add_voxel_mesh, remove_result, replace_mesh, voxel_mesh
from .point_objects import add_points
from .probability import cut, has_probabilities, threshold_of

COLLECTION_NAME = "Scanstage Results"
RESULT_NAME, POINTS_NAME = "Result", "Result Points"
FOLDER = "result_folder"  # the custom property that says where a result with probabilities is
_GAP = 0.6  # between the object and the result beside it, in widths of the result
_SAME = 1e-5  # of the object's size: what single precision may move
_SHARE_IN_RANGE = 98.0  # percent of the surface whose distance the colour ramp tells apart


def results_collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    """Return the scene's collection of results; made if there is none."""
    for found in scene.collection.children_recursive:
        if found.get(OWNER) == "results":
            return found
    made = bpy.data.collections.new(COLLECTION_NAME)
    made[OWNER] = "results"
    made.hide_render = True
    scene.collection.children.link(made)
    return made


def show_result(scene: bpy.types.Scene, result: Result, *, smooth: bool = False) -> bpy.types.Object:
    """Put a result's mesh, or its voxels', into the scene, beside the object; earlier ones are replaced.

    Where the cameras of a capture set are shown (see `cameras`) it stands among them, in its own place.

    Beside that stand the points, of a method that measures some, and the voxels that shadows carved.

    Parameters
    ----------
    scene : bpy.types.Scene
    result : Result
    smooth : bool
        Take off the voxels' steps with a live modifier; a mesh of the method's own has none.

    Raises
    ------
    ScanstageError
        The result has no voxels.
    """
    _refuse_empty(result)
    home = results_collection(scene)
    for earlier in [member.name for member in home.objects if member.get(OWNER) == "result"]:
        remove_result(earlier)  # here and not by name: "Result" may be the user's, or another scene's
    with frame_kept(scene):
        beside = _staged(scene)[0]
    step = [(1 + _GAP) * float(np.ptp(result.surface.vertices[:, 0])), 0, 0]
    if not cameras_are_shown(scene):
        beside[:3, 3] += step
    farther = beside.copy()
    farther[:3, 3] += step
    if result.points is not None:
        add_points(POINTS_NAME, result.points, collection=home, frame=farther, method=_method(result))
        farther[:3, 3] += step
    add_carved(result, collection=home, frame=farther)
    if result.mesh is not None:
        return add_polygon_mesh(RESULT_NAME, result.mesh.vertices, result.mesh.triangles, collection=home, frame=beside,
                                method=_method(result), replace=False)
    attributes = {} if result.colors is None else {"views": result.colors.views.astype(np.int32)}
    shown = add_voxel_mesh(RESULT_NAME, result.surface, result.colors and result.colors.rgb, collection=home,
                           grid=result.volume.grid, frame=beside, method=_method(result), attributes=attributes,
                           smooth=smooth, replace=False)
    if has_probabilities(result):
        shown[FOLDER] = str(result.folder)
        show_above(shown, result, threshold_of(result))
    return shown


def shown_beside(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return what `show_result` put into the scene, and the object beside which it stands."""
    staged = staged_objects(scene) if find_stage(scene) is not None else []
    return [*(member for member in staged if member.type != 'EMPTY'), *results_collection(scene).objects]


def show_above(shown: bpy.types.Object, result: Result, threshold: float, *, ramp: bool = True) -> None:
    """Let a result with probabilities show its voxels above another threshold; the object stays, its mesh is a new one.

    Parameters
    ----------
    shown : bpy.types.Object
        From `show_result`.
    result : Result
    threshold : float
    ramp : bool
        Colour the voxels by their probability, and not as the pictures show them.
    """
    part = cut(result, threshold)
    mesh = voxel_mesh(shown.data.name, part.surface, part.rgb, {"probability": part.probability})
    if shown.modifiers:
        mesh.shade_smooth()
    replace_mesh(shown, mesh, probability_material() if ramp else voxel_material())


def shown_probabilities(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the object that shows a result with probabilities, if there is one."""
    return next((member for member in scene.objects if FOLDER in member), None)


def face_errors(result: Result, truth: TriangleMesh) -> np.ndarray:
    """Return the signed distance of the centre of every face that is shown from the truth: positive where there is too much."""
    corners = result.surface.vertices[result.surface.quads] if result.mesh is None else result.mesh.corners()
    return vertex_distances(corners.mean(axis=1), truth)


def show_comparison(scene: bpy.types.Scene, result: Result, truth: TriangleMesh, errors: np.ndarray) -> bpy.types.Collection:
    """Lay truth, result and the result's errors side by side behind the stage; an earlier row is replaced.

    Parameters
    ----------
    scene : bpy.types.Scene
    result : Result
    truth : TriangleMesh
        In the object frame.
    errors : (q,) array
        From `face_errors`; computed apart, since that takes seconds and needs no Blender.

    Raises
    ------
    ScanstageError
        The result has no voxels.
    """
    _refuse_empty(result)
    with frame_kept(scene):
        row = _compared(scene, result, truth, errors)
    home = results_collection(scene)
    scene.collection.children.unlink(row)
    home.children.link(row)
    size = max(max(member.dimensions) for member in row.objects)
    for member in row.objects:
        member.matrix_world = Matrix.Translation((0, 3 * size, 0)) @ member.matrix_world
    return row


def _compared(scene: bpy.types.Scene, result: Result, truth: TriangleMesh, errors: np.ndarray) -> bpy.types.Collection:
    """Return the row, linked to the scene and in its middle; leaves the scene at the first frame."""
    home, made = results_collection(scene), []
    table, staged = _staged(scene)
    if staged is None or not _is_truth(scene, truth):
        staged = add_polygon_mesh("Compared Truth", truth.vertices, truth.triangles, collection=home, frame=table)
        made.append(staged)
    if result.mesh is not None:
        made.append(add_polygon_mesh("Compared Result", result.mesh.vertices, result.mesh.triangles, collection=home, frame=table,
                                     method=_method(result)))
    else:
        made.append(add_voxel_mesh("Compared Result", result.surface, result.colors and result.colors.rgb, collection=home,
                                   grid=result.volume.grid, frame=table, method=_method(result)))
    bpy.context.view_layer.update()
    limit = max(float(np.percentile(np.abs(errors), _SHARE_IN_RANGE)), result.volume.grid.voxel_size)
    try:
        return add_comparison(staged, made[-1], errors, _rounded(limit), scene=scene, signed=True)
    finally:
        for model in made:
            remove_result(model.name)


def _staged(scene: bpy.types.Scene) -> tuple[np.ndarray, bpy.types.Object | None]:
    """Return where the turntable stands at angle 0, and the object on it where that is a single mesh.

    Leaves the scene at the first frame.
    """
    if find_stage(scene) is None:
        return np.eye(4), None
    scene.frame_set(scene.frame_start)
    meshes = [member for member in staged_objects(scene) if member.type == 'MESH']
    return np.array(turntable_of(scene).matrix_world), meshes[0] if len(meshes) == 1 else None


def _is_truth(scene: bpy.types.Scene, truth: TriangleMesh) -> bool:
    """Return whether what stands on the turntable is the true object, and not what was staged after it."""
    try:
        vertices = truth_mesh(scene)[0]
    except ScanstageError:  # it is no longer rendered
        return False
    return vertices.shape == truth.vertices.shape and np.allclose(vertices, truth.vertices, atol=_SAME * np.ptp(vertices))


def _method(result: Result) -> str:
    return str(result.report.get("method", ""))


def _refuse_empty(result: Result) -> None:
    if not len(result.surface.quads):
        raise ScanstageError(f"{result.folder}: the result has no voxels to show; check its bounds and the silhouettes")


def _rounded(value: float) -> float:
    """Return the next number above with one digit, for a legend that can be read."""
    unit = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / unit - 1e-9) * unit)
