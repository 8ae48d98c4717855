# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""MagicaVoxel's .vox format, read: what the scene graph shows, of any program's file. See `vox` for the format.

A file is untrusted: each chunk is checked against the file's length, and a graph of few nodes that shows a model more often than
any scene would is refused before it is followed.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..captures.files import read_bytes
from ..errors import ScanstageError
from ..reconstruction.color import srgb_to_linear

MAX_BYTES = 1 << 28
MAX_VOXELS = 1 << 26
MAX_PLACE = 1 << 20
_MAX_SHOWN, _MAX_DEPTH, _MAX_WORDS = 1 << 16, 64, 1000
_NODES = {b"nTRN": "transform", b"nGRP": "group", b"nSHP": "shape"}


def read_vox(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the voxels (n, 3) of a scene, each once, and their linear colours (n, 3) float32.

    Of a file without a scene graph it is the first model: others are an animation. Hidden nodes are left out.

    Raises
    ------
    ScanstageError
        The file cannot be read, is damaged, or shows nothing, or more than can be.
    """
    path = Path(path)
    data = read_bytes(path, MAX_BYTES, str(path))
    try:
        scene = _parse(data)
        parts = list(_shown(scene))
    except (_Malformed, struct.error) as problem:
        text = problem if isinstance(problem, _Malformed) else "it ends early"
        raise ScanstageError(f"{path}: {text}; save it again with MagicaVoxel") from None
    if not parts:
        raise ScanstageError(f"{path}: shows no voxels; check that it is the right file")
    voxels, index = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    _, rows = np.unique(voxels[::-1], axis=0, return_index=True)  # where models overlap the later one is seen
    rows = len(voxels) - 1 - rows
    colors = srgb_to_linear(scene.palette[:, :3] / 255).astype(np.float32)
    return voxels[rows], colors[index[rows].astype(np.int64) - 1]


class _Malformed(Exception):
    """What is wrong with the file, without its name."""


@dataclass
class _Scene:
    sizes: list[tuple[int, int, int]] = field(default_factory=list)
    models: list[np.ndarray] = field(default_factory=list)
    nodes: dict[int, tuple] = field(default_factory=dict)
    palette: np.ndarray = field(default_factory=lambda: default_palette())


def default_palette() -> np.ndarray:
    """Return the (255, 3) uint8 colours of a file that has none: a cube of 6 x 6 x 6 without black, and ramps."""
    cube = np.arange(0xFF, -1, -0x33)
    blue, green, red = cube, cube, cube
    r, g, b = (axis.ravel() for axis in np.meshgrid(red, green, blue, indexing="ij"))
    ramp = np.array([0xEE, 0xDD, 0xBB, 0xAA, 0x88, 0x77, 0x55, 0x44, 0x22, 0x11])
    ramps = [ramp[:, None] * np.array(color) for color in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1))]
    return np.concatenate((np.stack((r, g, b), axis=1)[:-1], *ramps)).astype(np.uint8)


def _parse(data: bytes) -> _Scene:
    if data[:4] != b"VOX ":
        raise _Malformed("it is not a MagicaVoxel file: it does not begin with 'VOX '")
    name, own, children = struct.unpack_from("<4s2i", data, 8)
    if name != b"MAIN" or own < 0 or children < 0 or 20 + own + children > len(data):
        raise _Malformed("it has no whole MAIN chunk")
    scene, at, stop = _Scene(), 20 + own, 20 + own + children
    while at + 12 <= stop:
        name, own, children = struct.unpack_from("<4s2i", data, at)
        if own < 0 or children < 0 or at + 12 + own + children > stop:
            raise _Malformed(f"its chunk {name.decode('ascii', 'replace')!r} is longer than the file")
        _read_chunk(scene, name, data[at + 12:at + 12 + own])
        at += 12 + own + children
    return scene


def _read_chunk(scene: _Scene, name: bytes, chunk: bytes) -> None:
    if name == b"SIZE":
        size = struct.unpack_from("<3i", chunk)
        if not all(0 < side <= 256 for side in size):
            raise _Malformed(f"a model's size is {size[0]} x {size[1]} x {size[2]}, not 1 to 256 a side")
        scene.sizes.append(size)
    elif name == b"XYZI":
        count, = struct.unpack_from("<i", chunk)
        if not 0 <= count * 4 <= len(chunk) - 4 or len(scene.models) >= len(scene.sizes):
            raise _Malformed(f"a model of {count} voxels is not as long as that, or has no size")
        entries = np.frombuffer(chunk, np.uint8, count * 4, 4).reshape(-1, 4)
        if not ((entries[:, :3] < scene.sizes[len(scene.models)]).all() and entries[:, 3].all()):
            raise _Malformed("a voxel lies outside of its model, or has no colour")
        scene.models.append(entries)
    elif name == b"RGBA":
        if len(chunk) < 1020:
            raise _Malformed("its palette is cut off")
        scene.palette = np.frombuffer(chunk, np.uint8, 1020).reshape(255, 4)
    elif name in _NODES:
        id, at = _int(chunk, 0)
        attributes, at = _dictionary(chunk, at)
        scene.nodes[id] = (_NODES[name], attributes, *_node(_NODES[name], chunk, at))


def _node(kind: str, chunk: bytes, at: int) -> tuple:
    """Return the children of a group, the models of a shape, or a transform's child, rotation and translation."""
    if kind == "transform":
        child, _, _, frames = struct.unpack_from("<4i", chunk, at)
        frame = _dictionary(chunk, at + 16)[0] if frames > 0 else {}
        return child, _rotation(frame.get("_r", "4")), _translation(frame.get("_t", "0 0 0"))
    count, at = _int(chunk, at)
    if not 0 <= count <= min((len(chunk) - at) // 4, _MAX_SHOWN):
        raise _Malformed(f"a {kind} counts {count} entries and is not as long as that")
    entries = []
    for _ in range(count):
        entry, at = _int(chunk, at)
        if kind == "shape":
            _, at = _dictionary(chunk, at)
        entries.append(entry)
    return (entries,)


def _int(chunk: bytes, at: int) -> tuple[int, int]:
    return struct.unpack_from("<i", chunk, at)[0], at + 4


def _dictionary(chunk: bytes, at: int) -> tuple[dict[str, str], int]:
    count, at = _int(chunk, at)
    words = []
    if not 0 <= count <= min((len(chunk) - at) // 8, _MAX_WORDS):
        raise _Malformed("a node's attributes are longer than the node")
    for _ in range(2 * count):
        length, at = _int(chunk, at)
        if not 0 <= length <= len(chunk) - at:
            raise _Malformed("a node's attributes are longer than the node")
        words.append(chunk[at:at + length].decode("utf-8", "replace"))
        at += length
    return dict(zip(words[::2], words[1::2], strict=True)), at


def _rotation(text: str) -> np.ndarray:
    """Return the (3, 3) signed permutation that a byte stands for: two columns' places, then three signs."""
    if not text.isascii() or not text.isdecimal() or len(text) > 3 or (bits := int(text)) > 127:
        raise _Malformed(f"a node's rotation {text[:20]!r} is none")
    first, second = bits & 3, bits >> 2 & 3
    if first == second or 3 in (first, second):
        raise _Malformed(f"a node's rotation {text[:20]!r} is none")
    matrix = np.zeros((3, 3), np.int64)
    for row, column in enumerate((first, second, 3 - first - second)):
        matrix[row, column] = -1 if bits >> (4 + row) & 1 else 1
    return matrix


def _translation(text: str) -> np.ndarray:
    words = text.split()
    if len(words) != 3 or not all(len(word) < 12 and word.removeprefix("-").isdecimal() and word.isascii() for word in words):
        raise _Malformed(f"a node's translation {text[:40]!r} is none")
    place = np.array(words, np.int64)
    if np.abs(place).max() > MAX_PLACE:
        raise _Malformed(f"a node's translation {text[:40]!r} is too large")
    return place


def _shown(scene: _Scene) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the voxels (n, 3) int64 and colour indices (n,) of each model where the graph shows it."""
    if not scene.nodes:
        if scene.models and len(scene.models[0]):
            yield scene.models[0][:, :3].astype(np.int64), scene.models[0][:, 3]
        return
    waiting, visited, total = [(0, np.eye(3, dtype=np.int64), np.zeros(3, np.int64), 0)], 0, 0
    while waiting:
        id, rotation, place, depth = waiting.pop()
        visited += 1
        if visited > _MAX_SHOWN or depth > _MAX_DEPTH:
            raise _Malformed("its scene graph has too many branches, or leads back to itself")
        if id not in scene.nodes:
            raise _Malformed(f"its scene graph has no node {id}")
        kind, attributes, *rest = scene.nodes[id]
        if attributes.get("_hidden") == "1":
            continue
        if kind == "transform":
            child, turn, step = rest
            waiting.append((child, rotation @ turn, place + rotation @ step, depth + 1))
        elif kind == "group":
            waiting += [(child, rotation, place, depth + 1) for child in reversed(rest[0])]
        else:
            for model in rest[0][:1]:  # the others are an animation's
                voxels, index = _placed(scene, model, rotation, place)
                total += len(voxels)
                if total > MAX_VOXELS:
                    raise _Malformed(f"it shows more than {MAX_VOXELS} voxels")
                if len(voxels):
                    yield voxels, index


def _placed(scene: _Scene, model: int, rotation: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not 0 <= model < len(scene.models):
        raise _Malformed(f"its scene graph shows model {model} of {len(scene.models)}")
    entries = scene.models[model]
    # Twice the voxels' centres about the model's middle voxel's corner: whole numbers, which a rotation keeps.
    doubled = 2 * entries[:, :3].astype(np.int64) + 1 - 2 * (np.array(scene.sizes[model]) // 2)
    return (doubled @ rotation.T - 1) // 2 + place, entries[:, 3]
