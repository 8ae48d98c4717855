# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where objects are, roughly and at once: the corners of their boxes in the world."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

SOLID = ("MESH", "CURVE", "SURFACE", "FONT", "META")


def has_surface(member: bpy.types.Object) -> bool:
    """Return whether an object may have a surface: its own, or that of the collection of which it is an instance."""
    return member.type in SOLID or (member.instance_type == "COLLECTION" and member.instance_collection is not None)


def corners_of(members: Iterable[bpy.types.Object]) -> np.ndarray:
    """Return the corners (n, 3) of objects' boxes in the world, of an instance those of what it shows; of a device, its place."""
    return np.concatenate([np.zeros((0, 3)), *(_corners(member, np.array(member.matrix_world)) for member in members)])


def box_of(members: Iterable[bpy.types.Object]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the lower and the upper corner (3,) of the surfaces of objects in the world; None if there are none."""
    corners = corners_of(member for member in members if has_surface(member))
    return (corners.min(axis=0), corners.max(axis=0)) if len(corners) else None


def _corners(member: bpy.types.Object, world: np.ndarray) -> np.ndarray:
    if member.type in SOLID:
        return np.array(member.bound_box) @ world[:3, :3].T + world[:3, 3]
    if has_surface(member):
        offset = np.eye(4)
        offset[:3, 3] = -np.array(member.instance_collection.instance_offset)
        inner = [_corners(each, world @ offset @ np.array(each.matrix_world)) for each in member.instance_collection.all_objects
                 if has_surface(each)]
        return np.concatenate([np.zeros((0, 3)), *inner])
    return world[None, :3, 3]
