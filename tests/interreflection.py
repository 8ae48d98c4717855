# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A deep V-groove whose walls light each other: pictures under patterns by radiosity, with all bounces.

Each wall is cut into patches; their radiosities under a pattern solve ``B = albedo (E + F B)`` (Goral et al., 1984), and a pixel
gathers what the patches send it besides what the projector does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from addon.reconstruction.active.patterns import Pattern
from addon.reconstruction.geometry import Camera
from addon.reconstruction.scan import ProjectedPicture, View
from tests.projection import Sight, Wall, shown, sight

_FINE = 4  # parts of a patch along each side, over which a pattern's light is averaged


def walls(opening: float) -> list[Wall]:
    """Return the two walls of a groove along z that opens by an angle, in degrees, towards -y; its crease is the z axis."""
    half = np.radians(opening / 2)
    return [Wall((-np.cos(half), -np.sin(half), 0.0), 0.0), Wall((np.cos(half), -np.sin(half), 0.0), 0.0)]


def groove_view(camera: Camera, projector: Camera, patterns: Sequence[Pattern], *, opening: float = 60.0, albedo: float = 0.9,
                depth: float = 0.5, height: float = 0.8, patches: int = 24, noise: float = 2 / 255, levels: int = 255,
                seed: int = 0) -> tuple[View, Sight, np.ndarray]:
    """Return a view of a groove, what the camera sees of it, and how much of each pixel's light under white is direct.

    Pixels off the groove are dark. The exposure is such that the brightest pixel under white has 0.85.
    """
    faces = walls(opening)
    seen = sight(camera, projector, faces, 1.0)
    on = np.isfinite(seen.points).all(-1) & (np.abs(seen.points[..., 2]) < height / 2) & (np.hypot(*np.moveaxis(seen.points[..., :2], -1, 0)) < depth)
    centres, normals, area = _patches(faces, opening, depth, height, patches)
    fine, fine_normals, _ = _patches(faces, opening, depth, height, patches * _FINE)
    beams = fine - projector.centre
    length = np.linalg.norm(beams, axis=1)
    beams /= length[:, None]
    across = np.stack([face.distances(projector.centre, beams) for face in faces])
    opposite = np.where(np.arange(len(fine)) < len(fine) // 2, across[1], across[0])
    cosine = np.where(opposite < length * (1 - 1e-9), 0, np.maximum(-(fine_normals * beams).sum(1), 0))
    fine_pixels = projector.project(fine)[0]
    rows, columns = np.nonzero(on)
    points = seen.points[rows, columns]
    facing = np.where((points[:, 0] > 0)[:, None], np.array(faces[0].normal), np.array(faces[1].normal))
    bounced = np.linalg.inv(np.eye(len(centres)) - albedo * _form_factors(centres, normals, centres, normals, area))
    gathered = _form_factors(points, facing, centres, normals, area) @ bounced

    def light(pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
        """Return a pixel's direct and indirect light."""
        sent = (cosine * shown(pattern, fine_pixels)).reshape(2, patches, _FINE, patches, _FINE).mean(axis=(2, 4)).ravel()
        indirect = np.zeros(on.shape)
        indirect[rows, columns] = albedo * (gathered @ (albedo * sent))
        return np.where(on, albedo * seen.light * shown(pattern, seen.pixels), 0), indirect

    white = next(pattern for pattern in patterns if pattern.fields["kind"] == "white")
    direct, indirect = light(white)
    exposure = 0.85 / (direct + indirect).max()

    def reader(number: int, pattern: Pattern):
        def read() -> np.ndarray:
            values = exposure * sum(light(pattern)) + np.random.default_rng((seed, number)).normal(0, noise, on.shape)
            return np.repeat((np.rint(np.clip(values, 0, 1) * levels) / levels).astype(np.float32)[..., None], 3, axis=2)
        return read

    shots = tuple(ProjectedPicture(pattern.id, pattern.fields, "projector", projector, reader(number, pattern))
                  for number, pattern in enumerate(patterns))
    own = next(shot for shot in shots if shot.pattern["kind"] == "white")
    share = np.divide(direct, direct + indirect, out=np.zeros(on.shape), where=direct > 0.02)
    return View("groove", camera, None, own.read_image, projected=shots), seen, share


def _patches(faces: Sequence[Wall], opening: float, depth: float, height: float, count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return centres and normals of count x count patches a wall, the wall towards +x first, and their area."""
    half = np.radians(opening / 2)
    along, up = np.meshgrid((np.arange(count) + 0.5) * depth / count, ((np.arange(count) + 0.5) / count - 0.5) * height, indexing="ij")
    centres = [np.stack((side * along * np.sin(half), -along * np.cos(half), up), -1).reshape(-1, 3) for side in (1, -1)]
    normals = [np.broadcast_to(np.array(face.normal), centres[0].shape) for face in faces]
    return np.concatenate(centres), np.concatenate(normals), depth * height / count ** 2


def _form_factors(points: np.ndarray, normals: np.ndarray, patches: np.ndarray, patch_normals: np.ndarray, area: float) -> np.ndarray:
    """Return the share (n, m) of a point's hemisphere that each patch fills, as a disc: finite also in the crease."""
    distance = (patches ** 2).sum(1) + (points ** 2).sum(1)[:, None] - 2 * points @ patches.T
    here = np.maximum(normals @ patches.T - (normals * points).sum(1)[:, None], 0)
    there = np.maximum(points @ patch_normals.T - (patches * patch_normals).sum(1), 0)
    return here * there / np.maximum(distance, 1e-12) * area / (np.pi * distance + area)
