# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of a reconstructed volume, in numpy alone: what a result's ``preview.png`` shows.

The voxels are seen from above and from the side, on a floor that takes their shadow. Light comes from the upper left
(a lamp and the sky), hollows are darkened after the depth buffer (Luft, Colditz & Deussen, 2006, "Image enhancement
by unsharp masking the depth buffer"), and the normals keep a share of the faces' own, so that voxels stay visible.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from .geometry import Camera, VoxelGrid, look_at
from .volumetric.bounds import meeting_point
from .volumetric.item_buffer import face_buffer
from .volumetric.surface import Surface

AZIMUTH, ELEVATION = np.radians(-55.0), np.radians(24.0)  # of the camera, seen from the object
DISTANCE = 4.5  # in radii: a long lens
FILL = 0.74  # share of the picture's width or height that the object takes up
SUPERSAMPLING = 2
CLAY = np.array([0.47, 0.43, 0.39], np.float32)
FACE_SHARE = 0.3  # of the face's own normal in the shading
BACKGROUND = np.array([[0.86, 0.88, 0.91], [0.56, 0.57, 0.60]], np.float32)  # linear, at the top and at the bottom
KEY, KEY_LIGHT = np.array([-0.55, 0.75, 0.45]), np.array([0.92, 0.88, 0.80])  # right, up, towards the camera
SKY_LIGHT, FLOOR_LIGHT = np.array([0.46, 0.50, 0.56]), np.array([0.18, 0.17, 0.16])
SHADOW_CELLS = 256
UP = np.array([0.0, 0.0, 1.0])
_FLAT = 0.1


def render_preview(surface: Surface, grid: VoxelGrid, rgb: np.ndarray | None = None, *,
                   size: tuple[int, int] = (960, 720), up: np.ndarray = UP) -> np.ndarray:
    """Draw a volume's surface.

    Parameters
    ----------
    surface : Surface
    grid : VoxelGrid
        The grid that the surface was extracted on.
    rgb : (s, 3) array, optional
        Linear colour of each surface voxel; without it the object is of clay.
    size : (int, int)
        Width and height in pixels.
    up : (3,) array
        Unit vector that points upward in the picture; photographed objects need not stand along z. See `upward`.

    Returns
    -------
    (height, width, 3) uint8 array
        sRGB.
    """
    fine = SUPERSAMPLING * size[0], SUPERSAMPLING * size[1]
    picture = _background(fine)
    if len(surface.quads):
        frame = _frame(np.asarray(up, float))
        camera = _framed(surface.vertices, fine, frame)
        picture *= (1 - _shadow(surface, grid, camera, frame))[..., None]
        faces, depth = face_buffer(surface, grid, camera)
        seen = faces >= 0
        voxel = surface.face_voxel[faces[seen]]
        light = _light(surface, camera, frame)
        color = np.broadcast_to(CLAY, (len(surface.voxels), 3)) if rgb is None else np.asarray(rgb, np.float32)
        radius = 0.5 * np.linalg.norm(np.ptp(surface.vertices, axis=0))
        hollow = cv2.resize(_hollows(depth[::2, ::2], seen[::2, ::2], radius), fine)[seen]
        picture[seen] = color[voxel] * light[faces[seen]] * (1 - hollow)[:, None]
    picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    steps = np.clip(picture * (len(_SRGB) - 1) + 0.5, 0, len(_SRGB) - 1)
    return _SRGB.take(steps.astype(np.intp))


def _srgb_table(steps: int = 4096) -> np.ndarray:
    """Return the sRGB code (IEC 61966-2-1) of each step from linear 0 to 1: less than a code apart from each other."""
    linear = np.linspace(0, 1, steps)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


_SRGB = _srgb_table()


def _background(size: tuple[int, int]) -> np.ndarray:
    """Return a (height, width, 3) float32 backdrop: light above, darker towards the bottom and the corners."""
    width, height = size
    # Smooth, so a fourth of the rows and columns says it all.
    y = np.linspace(-1, 1, -(-height // 4), dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, -(-width // 4), dtype=np.float32)
    down = (0.5 + 0.5 * y)[..., None]
    vignette = 1 - 0.12 * (x * x + y * y)
    return cv2.resize((BACKGROUND[0] * (1 - down) + BACKGROUND[1] * down) * vignette[..., None], size)


def upward(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the axis of the object frame, with its sign, that most likely points upward.

    That is the one about which the cameras stand in a ring, on the side from which they look down; a camera may itself be
    turned on its side. Where they do not stand in a ring, it is the axis that points upward in most pictures.
    """
    in_pictures = -np.sum([camera.R[1] for camera in cameras], axis=0)
    offsets = np.array([camera.centre for camera in cameras]) - meeting_point(cameras)
    mean = offsets.mean(axis=0)
    spread = np.linalg.svd(offsets - mean)
    flat = len(cameras) > 3 and spread[1][2] < _FLAT * spread[1][1]
    found = spread[2][2] if flat else in_pictures
    axis = int(np.abs(found).argmax())
    looks_down = abs(mean[axis]) > _FLAT * np.linalg.norm(offsets, axis=1).mean()
    sign = np.sign(mean[axis] if flat and looks_down else in_pictures[axis])
    return np.eye(3)[axis] * (sign or 1.0)


def _frame(up: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation from the object frame to one whose z points upward."""
    if np.array_equal(up, UP):
        return np.eye(3)
    right = np.cross(np.eye(3)[np.abs(up).argmin()], up)
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(up, right), up))


def _framed(vertices: np.ndarray, size: tuple[int, int], frame: np.ndarray) -> Camera:
    """Return the camera whose picture the vertices fill."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, radius = (low + high) / 2, 0.5 * np.linalg.norm(high - low)
    direction = np.array([np.cos(ELEVATION) * np.cos(AZIMUTH), np.cos(ELEVATION) * np.sin(AZIMUTH), np.sin(ELEVATION)])
    R, t = look_at(centre + DISTANCE * radius * direction @ frame, centre, frame[2])
    seen, _ = Camera(np.eye(3), R, t, size).project(vertices)
    low, high = seen.min(axis=0), seen.max(axis=0)
    focal = (FILL * np.array(size) / (high - low)).min()
    cx, cy = (np.array(size) - 1) / 2 - focal * (low + high) / 2
    return Camera([[focal, 0, cx], [0, focal, cy], [0, 0, 1]], R, t, size)


def _light(surface: Surface, camera: Camera, frame: np.ndarray) -> np.ndarray:
    """Return the (q, 3) float32 light that reaches each face."""
    normals = (1 - FACE_SHARE) * surface.normals(smoothing=2)[surface.face_voxel] + FACE_SHARE * surface.face_normals()
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    key = KEY / np.linalg.norm(KEY) @ (camera.R * [[1], [-1], [-1]])  # the camera's y is down and its z away from us
    lamp = np.maximum(0.15 + 0.85 * normals @ key, 0)  # a lamp of some size: its light reaches round the edge
    sky = (0.5 + 0.5 * normals @ frame[2])[:, None]
    return (lamp[:, None] * KEY_LIGHT + sky * SKY_LIGHT + (1 - sky) * FLOOR_LIGHT).astype(np.float32)


def _hollows(depth: np.ndarray, seen: np.ndarray, radius: float) -> np.ndarray:
    """Return (height, width) from 0 to 0.55: how much each pixel lies behind its surroundings."""
    weight = seen.astype(np.float32)
    filled = np.where(seen, depth, 0).astype(np.float32)
    total = np.zeros(depth.shape, np.float32)
    for share in (0.012, 0.04):
        cells = max(3, int(share * depth.shape[1]) | 1)
        # Twice a box is nearly a Gaussian, at a cost that does not grow with its size.
        near, count = filled, weight
        for _ in range(2):
            near, count = cv2.blur(near, (cells, cells)), cv2.blur(count, (cells, cells))
        behind = filled - near / np.maximum(count, 1e-6)
        total += np.clip(behind / (4 * share * radius), 0, 1)
    return np.clip(0.4 * total, 0, 0.55)


def _shadow(surface: Surface, grid: VoxelGrid, camera: Camera, frame: np.ndarray) -> np.ndarray:
    """Return (height, width) from 0 to 1: how much of the light the object keeps from the floor it stands on."""
    points = grid.centres(surface.voxels) @ frame.T
    low, high = points.min(axis=0), points.max(axis=0)
    reach = 1.6 * max(np.ptp(points[:, :2], axis=0).max(), grid.voxel_size)
    origin = (low[:2] + high[:2]) / 2 - reach
    cell = 2 * reach / SHADOW_CELLS
    x, y = ((points[:, :2] - origin) / cell).astype(np.intp).T
    above = (points[:, 2] - low[2]) / max(high[2] - low[2], grid.voxel_size)
    shade = np.zeros((SHADOW_CELLS, SHADOW_CELLS), np.float32)
    for ceiling, blur, strength in ((0.04, 3, 0.5), (0.3, 9, 0.35), (1.0, 26, 0.45)):
        layer = np.zeros_like(shade)
        layer[y[above <= ceiling], x[above <= ceiling]] = 1
        layer = cv2.morphologyEx(layer, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
        shade = 1 - (1 - shade) * (1 - strength * cv2.GaussianBlur(layer, (0, 0), blur))
    # The floor is a plane, so that its picture is a homography away.
    floor = (surface.vertices @ frame[2]).min()
    map_to_floor = np.array([[cell, 0, origin[0] + cell / 2], [0, cell, origin[1] + cell / 2], [0, 0, floor],
                             [0, 0, 1]])
    to_object = np.block([[frame.T, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
    return cv2.warpPerspective(shade, camera.P @ to_object @ map_to_floor, camera.size, flags=cv2.INTER_LINEAR)
