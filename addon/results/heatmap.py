# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a result is from the truth, as colours on its surface.

The distances become the mesh's attribute ``error``; the colours are a live node tree, so that the limit can be turned
while looking. The heat map's material sits in the object's own slot: the mesh keeps its material, and another object
that shares the mesh still shows its colours.
"""

from __future__ import annotations

import bpy
import numpy as np

from .materials import heat_map_material, remove_if_unused
from .objects import set_attribute

ERROR = "error"


def add_heat_map(target: bpy.types.Object, distances: np.ndarray, limit: float, *,
                 signed: bool = False) -> bpy.types.Material:
    """Show distances on a mesh object. A second call replaces the first.

    Parameters
    ----------
    target : bpy.types.Object
        A mesh object.
    distances : (f,) or (v,) array
        Per face or per vertex of its mesh, in the scene's unit. Signed ones are positive outside the truth.
    limit : float
        Errors from here on have the last colour.
    signed : bool
        Blue for missing, white for right, red for too much; otherwise viridis from 0 to the limit.

    Returns
    -------
    bpy.types.Material
        Its Value node ``Limit`` holds the limit.

    Raises
    ------
    ValueError
        There is not one finite distance per face or vertex, or the limit is not positive.
    """
    mesh, distances = target.data, np.asarray(distances, np.float32)
    domain = {(len(mesh.polygons),): 'FACE', (len(mesh.vertices),): 'POINT'}.get(distances.shape)
    if domain is None:
        raise ValueError(f"distances must have the shape ({len(mesh.polygons)},) for faces or "
                         f"({len(mesh.vertices)},) for vertices, not {distances.shape}")
    if not np.isfinite(distances).all():
        raise ValueError("distances must be finite")
    if not (np.isfinite(limit) and limit > 0):
        raise ValueError(f"limit must be positive, not {limit}")
    set_attribute(mesh, ERROR, distances, domain)
    material = heat_map_material(f"{target.name} Heat Map", limit, signed=signed)
    if not mesh.materials:
        mesh.materials.append(None)  # a slot for the object to fill
    slot = target.material_slots[0]
    slot.link = 'OBJECT'
    slot.material = material
    return material


def remove_heat_map(target: bpy.types.Object) -> None:
    """Show the object in its mesh's own material again, and forget the distances."""
    if not target.material_slots:
        return
    slot = target.material_slots[0]
    material = slot.material
    if slot.link != 'OBJECT' or material is None:
        return
    slot.material = None
    slot.link = 'DATA'
    remove_if_unused(material)
    layer = target.data.attributes.get(ERROR)
    if layer is not None:
        target.data.attributes.remove(layer)
