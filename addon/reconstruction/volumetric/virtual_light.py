# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights as cameras, and what a camera or a light sees of a volume (Savarese et al., 2007)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import ScanstageError
from ..arrays import grown
from ..geometry import Camera, VoxelGrid, look_at
from .item_buffer import item_buffer
from .surface import Surface

PIXELS_PER_VOXEL = 1.5
_LARGEST_SIDE = 4096  # pixels of a virtual light image
_WIDEST = 4.0  # tangent of the widest angle off a virtual light image's axis
_FARTHEST = 1e4  # a sun stands so many diagonals of the volume away


@dataclass(frozen=True)
class SeenSurface:
    """What one camera, or light, sees of a volume's surface.

    Parameters
    ----------
    camera : Camera
        In the object frame.
    items : (height, width) int32 array
        The surface voxel that each pixel sees, -1 for none.
    depth : (height, width) float32 array
        How far it is along the camera's axis, infinite for none.
    """

    camera: Camera
    items: np.ndarray
    depth: np.ndarray

    @classmethod
    def of(cls, surface: Surface, grid: VoxelGrid, camera: Camera) -> SeenSurface:
        """Look at a surface."""
        return cls(camera, *item_buffer(surface, grid, camera))

    @classmethod
    def about(cls, surface: Surface, grid: VoxelGrid, light: VirtualLight, entries: np.ndarray) -> SeenSurface:
        """Let a light look at a surface where rays may meet voxels with their centres at ``entries`` (e, 3), and nowhere else.

        Elsewhere it sees nothing, at a depth of minus infinity: of those rays nothing is known to be free.
        """
        camera, wanted = light.camera, np.zeros(light.camera.size[::-1], bool)
        column, row = np.rint(camera.project(entries)[0]).astype(np.intp).T
        wanted[row, column] = True
        wanted = grown(wanted, light.radius)
        items, depth = item_buffer(surface, grid, camera, grown(wanted, 2 * light.radius))
        return cls(camera, np.where(wanted, items, -1), np.where(wanted, depth, np.float32(-np.inf)))


@dataclass(frozen=True)
class VirtualLight:
    """A light as the centre of a camera.

    Parameters
    ----------
    camera : Camera
        Without distortion, in the object frame.
    radius : int
        Pixels from a voxel's centre to the farthest pixel whose ray can meet the voxel.
    half_edge, half_depth : float
        Half of a voxel's edge, and of its extent along the camera's axis.
    """

    camera: Camera
    radius: int
    half_edge: float
    half_depth: float

    @classmethod
    def of(cls, position: np.ndarray, box: np.ndarray, voxel_size: float, name: str) -> VirtualLight:
        """Let a light look at a box with about `PIXELS_PER_VOXEL`.

        Parameters
        ----------
        position : (3,) array
            The light's, in the object frame.
        box : (2, 3) array
            What the image must hold.
        voxel_size : float
        name : str
            The light's, for error messages.

        Raises
        ------
        ScanstageError
            The light is inside the box, or so near that no image holds all of it.
        """
        if ((position >= box[0]) & (position <= box[1])).all():
            raise ScanstageError(f"{name}: stands inside the volume that may hold the object; correct its position, or give tighter "
                                 "--bounds")
        middle = box.mean(axis=0)
        towards = middle - position
        R, t = look_at(position, middle, np.eye(3)[np.abs(towards).argmin()])
        corners = np.array(np.meshgrid(*box.T)).reshape(3, -1).T @ R.T + t
        slopes = corners[:, :2] / np.maximum(corners[:, 2:], 1e-12)
        if corners[:, 2].min() <= voxel_size or np.abs(slopes).max() > _WIDEST:
            raise ScanstageError(f"{name}: stands too near the volume that may hold the object for its shadows to be used; check its "
                                 "position, or give tighter --bounds")
        low, high = slopes.min(axis=0), slopes.max(axis=0)
        focal = min(PIXELS_PER_VOXEL * np.linalg.norm(towards) / voxel_size, _LARGEST_SIDE / (high - low).max())
        first = np.floor(low * focal) - 1
        camera = Camera([[focal, 0, -first[0]], [0, focal, -first[1]], [0, 0, 1]], R, t, np.ceil(high * focal) + 2 - first)
        # A cube's corner moves a pixel coordinate x / z by |dx - (x / z) dz| / z at most.
        axes, half_depth = np.abs(R), voxel_size / 2 * np.abs(R[2]).sum()
        spread = (axes[:2] + np.abs(slopes).max(axis=0)[:, None] * axes[2]).sum(axis=1).max() * voxel_size / 2
        radius = int(np.ceil(focal * spread / (corners[:, 2].min() - half_depth) + 0.5))
        return cls(camera, radius, voxel_size / 2, half_depth)

    def at(self, centres: np.ndarray) -> VirtualLight:
        """Return the light with its image cut to rays that meet voxels at ``centres`` (n, 3), and to what voxels such rays meet."""
        pixels, margin = np.rint(self.camera.project(centres)[0]), 2 * self.radius + 1
        first = np.maximum(pixels.min(axis=0) - margin, 0)
        last = np.minimum(pixels.max(axis=0) + margin, np.array(self.camera.size) - 1)
        K = self.camera.K - np.column_stack((np.zeros((3, 2)), (*first, 0)))
        return replace(self, camera=replace(self.camera, K=K, size=tuple((last - first + 1).astype(int))))


def distant(direction: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return a (3,) position from which a sun's parallel rays all but come; ``direction`` is that in which it shines."""
    return box.mean(axis=0) - _FARTHEST * np.linalg.norm(box[1] - box[0]) * np.asarray(direction) / np.linalg.norm(direction)
