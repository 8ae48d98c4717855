# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow carving as the lecture's sentence is coded at first: wrong, so that tests can show that they would find it out."""

import cv2
import numpy as np

from addon.reconstruction.volumetric.surface import extract_surface
from addon.reconstruction.volumetric.virtual_light import SeenSurface, VirtualLight


def naive(scan, volume):
    """Return (nx, ny, nz) bool: which of a volume's voxels lie in a shadow of the camera's and in the virtual shadow of its light."""
    grid = volume.grid
    surface = extract_surface(volume)
    voxels = np.argwhere(volume.dense())
    centres, gone = grid.centres(voxels), np.zeros(len(voxels), bool)
    box = np.stack((grid.origin, grid.upper))
    for view in scan.views:
        seen = SeenSurface.of(surface, grid, view.camera)
        column, row = np.clip(np.rint(view.camera.project(centres)[0]), 0, np.array(view.camera.size) - 1).astype(int).T
        for number, picture in enumerate(view.lit):
            shadow = view.shadows.of(number)
            v, u = np.nonzero(shadow & (seen.items >= 0))
            points = view.camera.centre + seen.depth[v, u][:, None] * view.camera.rays(np.column_stack((u, v)))
            light = VirtualLight.of(picture.light.position, box, grid.voxel_size, "light").camera
            virtual = np.zeros(light.size[::-1], np.uint8)
            c, r = np.rint(light.project(points)[0]).astype(int).T
            virtual[r, c] = 1
            virtual = cv2.morphologyEx(virtual, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
            c, r = np.rint(light.project(centres)[0]).astype(int).T
            gone |= shadow[row, column] & (virtual[r, c] > 0)
    out = np.zeros(grid.shape, bool)
    out[tuple(voxels[gone].T)] = True
    return out
