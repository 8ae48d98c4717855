# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns on a projector: all of them in one image, and a Value node that says which one is shown.

The image is made once and never rewritten, so that the renderer may keep it with the geometry: from pattern to pattern
one number changes. Most patterns repeat one row or one column; a set of such patterns takes one line each, whatever the
projector's height. Patterns of black and white alone have sharp pixels. Where a set has shades in between, neighbouring pixels
are blended, as a real projector's lens blends them: sinusoids and profiles are continuous, and the borders of black and white
stay where they were. What each pattern is (`addon.reconstruction.active.patterns`) is kept beside the image for `pattern_of`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..errors import ScanstageError
from ..reconstruction.active.patterns import Pattern
from . import nodes, ownership, projector
from .nodes import Scalar
from .timeline import keyframe_value

_MOST_PIXELS = 1 << 26  # of an image of patterns: 1 GB as Blender holds it


@dataclass(frozen=True)
class _Atlas:
    """Where the patterns lie in their image.

    Parameters
    ----------
    image : (h, w) or (h, w, 3) array
        Row 0 at the top; float, or 8-bit.
    place : (n,) int array
        Where each pattern is, counted in tiles from the top.
    down : int or None
        Tiles from here on hold a column of the picture instead of a row; None where each holds the whole picture.
    """

    image: np.ndarray
    place: np.ndarray
    down: int | None


def show_patterns(light: bpy.types.Light, patterns: Sequence[Pattern], shown: Sequence[int | None], *, start: int = 1) -> None:
    """Let a projector show one pattern a frame.

    Parameters
    ----------
    light : bpy.types.Light
        Of a projector; its size is that of the patterns.
    patterns : sequence of Pattern
    shown : sequence of int or None
        For the frames ``start``, ``start + 1``, ...: which of the patterns, or None for darkness. In darkness the projector is
        no light of the scene at all, so that another one is free of noise at one sample.
    start : int

    Raises
    ------
    ScanstageError
        The patterns are of another size than the projector, or too many to be held in one image.
    """
    size = projector.optics_of(light).size
    for pattern in patterns:
        if pattern.image.shape[:2] != size[::-1]:
            raise ScanstageError(f"projector {light.name!r}: pattern {pattern.id} is {pattern.image.shape[1]}x{pattern.image.shape[0]}, "
                                 f"the projector {size[0]}x{size[1]}; make patterns of its size")
    if any(pattern.image.ndim == 3 for pattern in patterns):
        patterns = [replace(one, image=np.broadcast_to(one.image if one.image.ndim == 3 else one.image[..., None], (*size[::-1], 3)))
                    for one in patterns]
    atlas = _atlas_of_lines(patterns, size) or _atlas_of_pictures(patterns, size)
    projector.clear(light)
    tree = light.node_tree
    pattern = nodes.named_value(tree, projector.PATTERN, projector.OFF)
    texture = projector.image_node(tree, _new_image(light.name, atlas.image), _lookup(tree, atlas, pattern, len(patterns), size))
    texture.interpolation = "Closest" if _is_binary(atlas.image) else "Linear"
    projector.finish(tree, texture, pattern)
    order = np.argsort(atlas.place)
    light[projector.PATTERNS] = json.dumps({"size": size, "down": atlas.down,
                                            "patterns": [[patterns[i].id, dict(patterns[i].fields)] for i in order]})
    values = [projector.OFF if index is None else float(atlas.place[index]) for index in shown]
    keyframe_value(tree, projector.PATTERN, values, start=start)


def pattern_of(light: bpy.types.Light, frame: int) -> tuple[str, Mapping[str, object]] | None:
    """Return the id and the fields of what a projector shows at ``frame``, the scene's present one, or None while it is dark.

    An image that is no pattern has the fields ``kind``, which is ``image``, and ``image``, its name; a sequence, which has no
    evaluated state that could be asked for its picture, also has ``frame``, the number of its file.

    Raises
    ------
    ScanstageError
        The projector's size is no longer that of its patterns, or the Value node points at none of them.
    """
    value = light.node_tree.nodes.get(projector.PATTERN)
    number = 0.0 if value is None else value.outputs[0].default_value
    if number < -0.5 or light.energy <= 0:
        return None
    if projector.PATTERNS not in light:
        return _image_fields(light.node_tree, frame)
    known = json.loads(light[projector.PATTERNS])
    size = projector.optics_of(light).size
    if tuple(known["size"]) != size:
        raise ScanstageError(f"projector {light.name!r} is {size[0]}x{size[1]}, its patterns {known['size'][0]}x{known['size'][1]}: set "
                             "its width and height back, or build the stage again")
    if not round(number) < len(known["patterns"]):
        raise ScanstageError(f"projector {light.name!r} has {len(known['patterns'])} patterns and is to show number {number:g}: correct "
                             f"the keys of its {projector.PATTERN!r} node")
    id, fields = known["patterns"][round(number)]
    return id, fields


def picture_places(light: bpy.types.Light, share: np.ndarray) -> tuple[bpy.types.Image, np.ndarray] | None:
    """Return the image that a projector shows at the present frame, and where in it places of its picture are.

    Parameters
    ----------
    light : bpy.types.Light
    share : (..., 2) array
        Places in the projector's picture, from 0 at its left and its top to 1.

    Returns
    -------
    image, places : bpy.types.Image and (..., 2) array
        The places from 0 at the image's left and its foot to 1. None while the projector is dark, or all white.
    """
    node, value = light.node_tree.nodes.get(projector.IMAGE), light.node_tree.nodes.get(projector.PATTERN)
    number = 0.0 if value is None else value.outputs[0].default_value
    if node is None or node.image is None or number < -0.5 or light.energy <= 0:
        return None
    column, row = share[..., 0], share[..., 1]
    if projector.PATTERNS not in light:
        return node.image, np.stack((column, 1 - row), axis=-1)
    known = json.loads(light[projector.PATTERNS])
    count, down, size = len(known["patterns"]), known.get("down"), known["size"]
    if down is None:
        return node.image, np.stack((column, 1 - (round(number) + row) / count), axis=-1)
    along = row * size[1] / max(size) if round(number) >= down else column * size[0] / max(size)
    return node.image, np.stack((along, np.full_like(along, 1 - (round(number) + 0.5) / count)), axis=-1)


def _image_fields(tree: bpy.types.NodeTree, frame: int) -> tuple[str, Mapping[str, object]]:
    node = tree.nodes.get(projector.IMAGE)
    if node is None or node.image is None:
        return "white", {"kind": "white"}
    fields: dict[str, object] = {"kind": "image", "image": node.image.name}
    if node.image.source not in {"SEQUENCE", "MOVIE"}:
        return "image", fields
    user = node.image_user
    number = frame - user.frame_start
    number = number % user.frame_duration if user.use_cyclic else min(max(number, 0), user.frame_duration - 1)
    fields["frame"] = number + 1 + user.frame_offset
    return f"image-{fields['frame']:04d}", fields


def _atlas_of_lines(patterns: Sequence[Pattern], size: tuple[int, int]) -> _Atlas | None:
    """Return the patterns as one line each, those along columns first; None if one of them repeats neither."""
    across = np.array([bool((pattern.image == pattern.image[:1]).all()) for pattern in patterns])
    if not all(flat or (pattern.image == pattern.image[:, :1]).all() for flat, pattern in zip(across, patterns, strict=True)):
        return None
    order = np.argsort(~across, kind="stable")
    lines = [patterns[i].image[0] if across[i] else patterns[i].image[:, 0] for i in order]
    image = np.zeros((len(lines), max(size), *lines[0].shape[1:]), np.result_type(*lines))
    for row, line in zip(image, lines, strict=True):
        row[:len(line)] = line if line.dtype == image.dtype else line / np.iinfo(line.dtype).max
        row[len(line):] = row[len(line) - 1]  # no pixel at the picture's edge is blended with what lies beyond
    return _Atlas(image, np.argsort(order), int(across.sum()))


def _atlas_of_pictures(patterns: Sequence[Pattern], size: tuple[int, int]) -> _Atlas:
    if len(patterns) * size[0] * size[1] > _MOST_PIXELS:
        raise ScanstageError(f"{len(patterns)} patterns of {size[0]}x{size[1]} pixels are more than Blender can hold in one image; use a "
                             "smaller projector, or fewer patterns")
    kind = np.result_type(*(pattern.image for pattern in patterns))
    pictures = [p.image if p.image.dtype == kind else p.image / np.iinfo(p.image.dtype).max for p in patterns]
    return _Atlas(np.concatenate(pictures), np.arange(len(patterns)), None)


def _lookup(tree: bpy.types.NodeTree, atlas: _Atlas, pattern: Scalar, count: int, size: tuple[int, int]) -> bpy.types.NodeSocket:
    """Return where in the image a ray's pixel of the pattern that is shown lies."""
    column, row, _ = (Scalar(tree, socket) for socket in tree.nodes[projector.LENS].outputs)
    if atlas.down is None:
        inside = row.clamped(0.5 / size[1], 1 - 0.5 / size[1])  # never blended with the picture above or below
        return nodes.combined(tree, column, 1.0 - (pattern + inside) / count)
    width, height = (side / max(size) for side in size)
    is_column = pattern > atlas.down - 0.5
    along = column * width * (1.0 - is_column) + row * height * is_column
    return nodes.combined(tree, along, 1.0 - (pattern + 0.5) / count)


def _is_binary(values: np.ndarray) -> bool:
    return bool(((values == 0) | (values == (1 if values.dtype.kind == "f" else np.iinfo(values.dtype).max))).all())


def _new_image(name: str, values: np.ndarray) -> bpy.types.Image:
    """Return values as an image of Blender's, kept in the file, whose pixels are read as numbers and not as colours."""
    height, width = values.shape[:2]
    is_float = values.dtype.kind == "f"
    image = ownership.mark(bpy.data.images.new(f"{name} Patterns", width, height, is_data=True, float_buffer=is_float))
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = values[::-1].reshape(height, width, -1) / (1.0 if is_float else np.iinfo(values.dtype).max)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image
