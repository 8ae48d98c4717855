# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's own objects on the turntable: several at once, and with them all that gives them their shape.

A modifier that refers to another object (a mirror's plane, a boolean's cutter, an armature) deforms anew when only one of the two
turns. So what it refers to turns as well, though it is no part of what is scanned.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import bpy

from .. import compat
from . import ownership
from .extents import has_surface


def scannable(candidates: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return those of a user's objects that may have a surface; what staging made goes with the rig that is replaced."""
    return [each for each in candidates if has_surface(each) and not ownership.is_marked(each)]


def carry(objects: Iterable[bpy.types.Object], turntable: bpy.types.Object) -> None:
    """Let the turntable carry objects of the user's, which keep their places, parents, scales and animations.

    Raises
    ------
    ScanstageError
        One of them is linked from another file and cannot be given a constraint.
    """
    roots = topmost(objects)
    carried = set(topmost([*roots, *shapers_of(roots)]))
    for member in [*roots, *sorted(carried.difference(roots), key=lambda o: o.name)]:
        ownership.attach(member, turntable, staged=member in roots, moved=member in carried)


def topmost(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return those objects that none of the others has among its children: the others follow by themselves."""
    objects = dict.fromkeys(objects)
    return [each for each in objects if not any(parent in objects for parent in _parents(each))]


def shapers_of(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Return the objects to which the modifiers of objects, and of their children, refer, and those that shape these."""
    waiting, found = [member for each in objects for member in (each, *each.children_recursive)], {}
    seen = set(waiting)
    while waiting:
        for other in _referred(waiting.pop()):
            if other not in seen:
                seen.add(other)
                waiting.append(other)
                found[other] = None
    return list(found)


def _parents(member: bpy.types.Object) -> Iterator[bpy.types.Object]:
    while member.parent is not None:
        member = member.parent
        yield member


def _referred(member: bpy.types.Object) -> Iterator[bpy.types.Object]:
    for modifier in member.modifiers:
        values = [getattr(modifier, prop.identifier) for prop in modifier.bl_rna.properties if prop.type == 'POINTER']
        values += compat.node_inputs(modifier) if modifier.type == 'NODES' else []
        for value in values:
            if isinstance(value, bpy.types.Object):
                yield value
            elif isinstance(value, bpy.types.Collection):
                yield from value.all_objects
