# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws the gallery's picture of every rig: what stands there, cameras in blue, lights in yellow, what is projected in orange.

Run from the root of a clone, in Blender or in a Python that has its ``bpy``::

    python -m scripts.make_gallery [FOLDER]

What is drawn is read back from the stage that each preset builds, so that the pictures follow the rigs.
"""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

# isort: split
import cv2
import numpy as np

from addon.reconstruction.geometry import Camera, look_at
from addon.stage import staging
from addon.stage.presets import PRESETS
from addon.stage.readback import plan_of

FOLDER = Path(__file__).resolve().parent.parent / "assets" / "rigs"
SIDE, FINER = 160, 4  # pixels of the picture, and how many times finer it is drawn
BLUE, YELLOW, ORANGE, GREY = (235, 150, 70), (90, 215, 255), (60, 130, 245), (205, 205, 205)  # as OpenCV has them: BGR
LARGEST = 1.0  # metres; a desk that fills the picture says nothing


def draw_rig(preset: str) -> np.ndarray:
    """Return the picture (SIDE, SIDE, 4) of a preset's stage, uint8 BGR with alpha."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    stage = staging.build(scene, preset, "knot", {})
    plan = plan_of(scene)
    solids, outlines = _meshes(stage)
    frusta = [_frustum(camera) for camera in plan.cameras.values()]
    lamps = np.array([light.position for light in plan.lights.values() if light.position is not None]).reshape(-1, 3)
    eye = _framed(np.concatenate([*frusta, *solids, *outlines, lamps], axis=None).reshape(-1, 3))
    picture = np.zeros((SIDE * FINER, SIDE * FINER, 4), np.uint8)
    for lines in outlines:
        _draw_lines(picture, eye, lines, ORANGE)
    for solid in sorted(solids, key=lambda triangles: triangles[..., 2].mean()):  # seen from above: the lowest first
        _draw_solid(picture, eye, solid)
    for frustum in frusta:
        _draw_lines(picture, eye, frustum, BLUE)
    for centre in eye.project(lamps)[0]:
        cv2.circle(picture, tuple(np.rint(centre).astype(int)), 4 * FINER, (*YELLOW, 255), cv2.FILLED, cv2.LINE_AA)
    return cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def _meshes(stage: bpy.types.Collection) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return in the world the triangles (n, 3, 3) of what is rendered, and the edges (n, 2, 3) of what only shows a beam."""
    solids, outlines = [], []
    for member in stage.all_objects:
        if member.type != "MESH" or max(member.dimensions) > LARGEST:
            continue
        mesh = member.data
        mesh.calc_loop_triangles()
        points = np.array([member.matrix_world @ vertex.co for vertex in mesh.vertices])
        if member.name.endswith(("Fan", "Frustum")):
            outlines.append(points[np.array([edge.vertices[:] for edge in mesh.edges])])
        else:
            solids.append(points[np.array([triangle.vertices[:] for triangle in mesh.loop_triangles])])
    return solids, outlines


def _frustum(camera: Camera, depth: float = 0.12) -> np.ndarray:
    """Return the edges (8, 2, 3) of a camera's pyramid, ``depth`` metres long."""
    width, height = camera.size
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], float)
    centre = camera.centre
    ends = centre + depth * camera.rays(corners)
    return np.stack([np.stack([np.broadcast_to(centre, ends.shape), ends], 1), np.stack([ends, np.roll(ends, 1, 0)], 1)]).reshape(-1, 2, 3)


def _framed(points: np.ndarray) -> Camera:
    """Return a distant camera, above and aside, whose picture the points fill."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    R, t = look_at(middle + 20 * np.array((0.62, -0.62, 0.48)), middle)
    flat = points @ R.T + t
    plane = flat[:, :2] / flat[:, 2:]
    low, high = plane.min(axis=0), plane.max(axis=0)
    side = SIDE * FINER
    scale = 0.88 * side / (high - low).max()
    c = side / 2 - scale * (low + high) / 2
    return Camera(np.array([[scale, 0, c[0]], [0, scale, c[1]], [0, 0, 1]]), R, t, (side, side))


def _draw_solid(picture: np.ndarray, eye: Camera, triangles: np.ndarray) -> None:
    """Paint triangles from the farthest to the nearest, lit from beside the eye."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    toward = -eye.forward + np.array((-0.3, -0.3, 0.9))
    shade = 0.25 + 0.75 * np.clip(normals @ (toward / np.linalg.norm(toward)), 0, 1)
    pixels, depths = eye.project(triangles.reshape(-1, 3))
    corners = np.rint(pixels).astype(np.int32).reshape(-1, 3, 2)
    farthest_first = np.argsort(-depths.reshape(-1, 3).mean(axis=1))
    for number in farthest_first[(normals @ eye.forward < 0)[farthest_first]]:
        cv2.fillConvexPoly(picture, corners[number], (*(shade[number] * np.array(GREY)).tolist(), 255), cv2.LINE_AA)


def _draw_lines(picture: np.ndarray, eye: Camera, edges: np.ndarray, color: tuple[int, int, int]) -> None:
    ends = np.rint(eye.project(edges.reshape(-1, 3))[0]).astype(np.int32).reshape(-1, 2, 2)
    cv2.polylines(picture, list(ends), False, (*color, 255), int(1.4 * FINER), cv2.LINE_AA)


def main(folder: Path = FOLDER) -> None:
    """Write ``NAME.png`` for every preset."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in PRESETS:
        cv2.imwrite(str(folder / f"{name}.png"), draw_rig(name), (cv2.IMWRITE_PNG_COMPRESSION, 9))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
