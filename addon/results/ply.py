# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The PLY format (Turk, 1994): writes binary little-endian meshes and points, reads any mesh there is.

A file that is read is untrusted: its header is checked against the file's real size before anything is allocated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import ScanstageError
from ..files import replacing
from ..reconstruction.mesh import TriangleMesh

MAX_HEADER = 64 * 1024
BLOCK = 1 << 16
_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
          "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
          "float32": "f4", "float64": "f8"}
_NAMES = {"<f4": "float", "<f8": "double", "|u1": "uchar", "<u2": "ushort"}


def write_ply(path, vertices, faces=None, *, vertex_colors=None, face_colors=None, normals=None,
              attributes: Mapping[str, np.ndarray] | None = None, double: bool = False, comments: Iterable[str] = ()) -> None:
    """Write a mesh or a point cloud, whole or not at all.

    Parameters
    ----------
    path : path-like
        Replaced if it exists.
    vertices : (v, 3) array
    faces : (f, 3) or (f, 4) integer array, optional
        Triangles or quads. Without them the file is a point cloud.
    vertex_colors, face_colors : (v, 3) and (f, 3) uint8 arrays, optional
        sRGB encoded, which is what viewers expect. Blender shows those of the vertices and ignores those of the faces.
    normals : (v, 3) array, optional
    attributes : mapping of str to (v,) array, optional
        More of every vertex, by the names of their properties: uint16, or anything else as float32.
    double : bool
        Store coordinates as float64 instead of float32.
    comments : iterable of str
        One header line each.

    Raises
    ------
    ValueError
        An array has the wrong shape or type.
    """
    vertices = _table("vertices", vertices, 3)
    columns = [("<f8" if double else "<f4", "xyz", vertices)]
    if normals is not None:
        columns.append(("<f4", ("nx", "ny", "nz"), _table("normals", normals, 3, len(vertices))))
    if vertex_colors is not None:
        columns.append(("|u1", ("red", "green", "blue"), _colors("vertex_colors", vertex_colors, len(vertices))))
    for name, values in (attributes or {}).items():
        values = np.asarray(values)
        columns.append(("<u2" if values.dtype == np.uint16 else "<f4", (name,), _table(name, values[..., None], 1, len(vertices))))
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {' '.join(comment.split())}" for comment in comments]
    header += [f"element vertex {len(vertices)}"]
    header += [f"property {_NAMES[kind]} {name}" for kind, names, _ in columns for name in names]
    body = [_records(columns, len(vertices))]
    if faces is not None:
        lines, records = _faces(faces, face_colors, len(vertices))
        header += lines
        body.append(records)
    with replacing(path) as file:
        file.write(("\n".join([*header, "end_header"]) + "\n").encode("ascii", "replace"))
        for records in body:
            file.write(records.data)


def _faces(faces, face_colors, vertices: int) -> tuple[list[str], np.ndarray]:
    """Return the header's lines and the records of the faces."""
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] not in (3, 4) or faces.dtype.kind not in "iu":
        raise ValueError(f"faces must be (f, 3) or (f, 4) integers, not {faces.shape} {faces.dtype}")
    if faces.size and not (faces.min() >= 0 and faces.max() < vertices):
        raise ValueError(f"faces must name vertices from 0 to {vertices - 1}")
    columns = [("|u1", ("count",), np.full((len(faces), 1), faces.shape[1])),
               ("<i4", tuple(f"corner{i}" for i in range(faces.shape[1])), faces)]
    header = [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    if face_colors is not None:
        columns.append(("|u1", ("red", "green", "blue"), _colors("face_colors", face_colors, len(faces))))
        header += [f"property uchar {name}" for name in columns[-1][1]]
    return header, _records(columns, len(faces))


def _table(name: str, value, width: int, rows: int | None = None) -> np.ndarray:
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] != width or rows not in (None, len(array)):
        raise ValueError(f"{name} must be ({'n' if rows is None else rows}, {width}), not {array.shape}")
    return array


def _colors(name: str, value, rows: int) -> np.ndarray:
    array = _table(name, value, 3, rows)
    if array.dtype != np.uint8:
        raise ValueError(f"{name} must be uint8, not {array.dtype}")
    return array


def _records(columns, rows: int) -> np.ndarray:
    """Interleave tables into one array of packed records, as bytes."""
    records = np.zeros(rows, [(name, kind) for kind, names, _ in columns for name in names])
    for _, names, table in columns:
        for name, column in zip(names, np.asarray(table).T, strict=True):
            records[name] = column
    return records.view(np.uint8)


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    count_kind: str | None  # None for a scalar


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


class _Body:
    """The data after the header as one sequence: of bytes when binary, of numbers when ascii.

    Both are then read in the same way: a value of some kind *starts* at a position and is `size` positions long.
    """

    def __init__(self, data: np.ndarray, byte_order: str | None) -> None:
        self.data = data
        self.byte_order = byte_order

    def size(self, kind: str) -> int:
        """Return how many positions a value of a kind takes."""
        return 1 if self.byte_order is None else np.dtype(kind).itemsize

    def values(self, kind: str) -> np.ndarray:
        """Return a view whose row ``i`` is the value that starts at position ``i``: no copy, alignment ignored."""
        if self.byte_order is None:
            return self.data
        dtype = np.dtype(self.byte_order + kind)
        return np.ndarray(max(len(self.data) - dtype.itemsize + 1, 0), dtype, self.data, strides=(1,))


def read_ply(path) -> TriangleMesh:
    """Read the surface of a PLY file, ascii or binary of either byte order.

    Faces of more than three corners are cut into the fan of their first corner, which is right for convex ones. Faces
    of fewer corners, and everything else in the file (colours, normals, edges), are ignored.

    Raises
    ------
    ScanstageError
        The file cannot be read, is not a PLY file, ends early, or holds a value that cannot be.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScanstageError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        return _parse(data)
    except _Malformed as problem:
        raise ScanstageError(f"{path}: {problem}; export the mesh again as PLY") from None


class _Malformed(Exception):
    """What is wrong with the file, without its name."""


def _parse(data: bytes) -> TriangleMesh:
    byte_order, elements, start = _header(data)
    raw = np.frombuffer(data, np.uint8, offset=start)
    body = _Body(_numbers(data[start:]) if byte_order is None else raw, byte_order)
    vertices, triangles, position = None, np.zeros((0, 3), np.int64), 0
    for element in elements:
        _refuse_impossible(element, body, position)
        starts, stop = _starts(element, body, position)
        if element.name == "vertex":
            vertices = _vertices(element, body, starts)
        elif element.name == "face":
            triangles = _triangles(element, body, starts)
        position = stop
    if vertices is None:
        raise _Malformed("it has no element named vertex")
    if not np.isfinite(vertices).all():
        raise _Malformed(f"vertex {int(np.argmin(np.isfinite(vertices).all(axis=1)))} is not finite")
    if triangles.size and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise _Malformed(f"a face names a vertex that is not one of the {len(vertices)} there are")
    return TriangleMesh(vertices, triangles)


def _header(data: bytes) -> tuple[str | None, list[_Element], int]:
    head = data[:MAX_HEADER]
    if head[:4] not in (b"ply\n", b"ply\r"):
        raise _Malformed("it is not a PLY file: its first line is not 'ply'")
    at = head.find(b"end_header")
    stop = head.find(b"\n", at)
    if at < 0 or stop < 0:
        raise _Malformed(f"its header does not end within {MAX_HEADER} bytes")
    orders = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
    order, elements = "", []
    for line in head[:at].decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in orders:
                order = orders[name]
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 16:
                elements.append(_Element(name, int(count), ()))
            case ["property", "list", count, kind, name] if elements and {count, kind} <= _TYPES.keys():
                if _TYPES[count][0] == "f":
                    raise _Malformed(f"its header counts a list in fractions: {line.strip()!r}")
                elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind], _TYPES[count]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind], None))
            case _:
                raise _Malformed(f"its header has the line {line.strip()[:80]!r}, which is not PLY 1.0")
    if order == "":
        raise _Malformed("its header does not state the format")
    return order, elements, stop + 1


def _with(element: _Element, prop: _Property) -> _Element:
    return _Element(element.name, element.count, (*element.properties, prop))


def _numbers(text: bytes) -> np.ndarray:
    """Return all numbers of the body as float64, parsed in pieces that end at white space."""
    pieces, at = [np.zeros(0)], 0
    while at < len(text):
        stop = min(at + 16 * BLOCK, len(text))
        while stop < len(text) and text[stop:stop + 1].split():
            stop += 1
        words = text[at:stop].split()
        try:
            pieces.append(np.array(words, "S").astype(np.float64) if words else np.zeros(0))
        except ValueError:
            raise _Malformed("its data holds something that is not a number") from None
        at = stop
    return np.concatenate(pieces)


def _refuse_impossible(element: _Element, body: _Body, position: int) -> None:
    smallest = sum(body.size(prop.count_kind or prop.kind) for prop in element.properties)
    if element.count * max(smallest, 1) > len(body.data) - position:
        raise _Malformed(f"it ends early: its header promises {element.count} of {element.name}")


def _starts(element: _Element, body: _Body, position: int) -> tuple[np.ndarray, int]:
    """Return the position of each of the element's records, and where the element ends."""
    if not element.count:
        return np.zeros(0, np.int64), position
    lengths = _record_lengths(element, body, np.array([position]))
    guess = position + lengths[0] * np.arange(element.count, dtype=np.int64)
    if guess[-1] < len(body.data):
        lengths = _record_lengths(element, body, guess)
        if (lengths == lengths[0]).all():  # all triangles, all quads, or no list at all: by far the most files
            starts, stop = guess, int(guess[-1] + lengths[0])
        else:
            starts, stop = _chain(element, body, position)
    else:
        starts, stop = _chain(element, body, position)
    if len(starts) < element.count or stop > len(body.data):
        raise _Malformed(f"it ends early: its header promises {element.count} of {element.name}")
    return starts, stop


def _record_lengths(element: _Element, body: _Body, starts: np.ndarray) -> np.ndarray:
    """Return how long the record at each of the starts is, and a length beyond the data where it does not fit."""
    at, beyond = starts.astype(np.int64), len(body.data) + 1
    for prop in element.properties:
        if prop.count_kind is None:
            at = at + body.size(prop.kind)
            continue
        counts, count = body.values(prop.count_kind), np.full(len(at), -1.0)
        fits = at < len(counts)
        count[fits] = counts[at[fits]]
        good = (count >= 0) & (count < beyond) & (count == np.floor(count))
        entries = np.where(good, count, 0).astype(np.int64)
        at = np.where(good, at + body.size(prop.count_kind) + entries * body.size(prop.kind), beyond)
        at = np.minimum(at, beyond)
    return np.where(at >= beyond, beyond, at - starts)


def _chain(element: _Element, body: _Body, position: int) -> tuple[np.ndarray, int]:
    """Follow records of varying length, each of which starts where the last one ends, without a loop over them.

    Within a block, ``jumps[n][i]`` is where 2^n records lead from position ``i``; the starts are then filled in from
    the longest jump to the shortest (pointer doubling).
    """
    chunks, total = [], 0
    while total < element.count and position < len(body.data):
        size = min(BLOCK, len(body.data) - position)
        here = np.arange(size + 1)
        lengths = _record_lengths(element, body, position + here[:-1])
        jumps = [np.append(np.minimum(here[:-1] + np.maximum(lengths, 1), size), size)]
        while jumps[-1][0] < size:
            jumps.append(jumps[-1][jumps[-1]])
        starts = np.zeros(1, np.int64)
        for jump in reversed(jumps[:-1]):
            starts = np.stack((starts, jump[starts]), axis=1).ravel()
        starts = starts[starts < size][:element.count - total]
        chunks.append(position + starts)
        total += len(starts)
        position += int(starts[-1] + lengths[starts[-1]])
    return np.concatenate(chunks), position


def _property(element: _Element, *names: str) -> tuple[int, _Property]:
    for index, prop in enumerate(element.properties):
        if prop.name in names:
            return index, prop
    raise _Malformed(f"its element {element.name} has no property {names[0]}")


def _positions(element: _Element, body: _Body, starts: np.ndarray, index: int) -> np.ndarray:
    """Return where the property at an index of the element begins in each record."""
    before = _Element(element.name, element.count, element.properties[:index])
    return starts + _record_lengths(before, body, starts)


def _vertices(element: _Element, body: _Body, starts: np.ndarray) -> np.ndarray:
    out = np.zeros((len(starts), 3))
    for axis, name in enumerate("xyz"):
        index, prop = _property(element, name)
        if prop.count_kind is not None:
            raise _Malformed(f"its vertices have a list named {name}")
        if len(starts):
            out[:, axis] = body.values(prop.kind)[_positions(element, body, starts, index)]
    return out


def _triangles(element: _Element, body: _Body, starts: np.ndarray) -> np.ndarray:
    index, prop = _property(element, "vertex_indices", "vertex_index")
    if prop.count_kind is None or prop.kind[0] == "f":
        raise _Malformed(f"its faces' {prop.name} is not a list of whole numbers")
    if not len(starts):
        return np.zeros((0, 3), np.int64)
    at = _positions(element, body, starts, index)
    counts = body.values(prop.count_kind)[at].astype(np.int64)
    first = at + body.size(prop.count_kind)
    fans = np.maximum(counts - 2, 0)
    step = np.arange(fans.sum()) - np.repeat(np.cumsum(fans) - fans, fans)  # 0, 1, 2, ... within each face
    first, size, values = np.repeat(first, fans), body.size(prop.kind), body.values(prop.kind)
    starts = np.stack((first, first + (step + 1) * size, first + (step + 2) * size), axis=1)
    corners = values[starts]
    if corners.dtype.kind == "f" and not (corners == np.floor(corners)).all():  # also what is not finite
        raise _Malformed("a face names a vertex by something that is not a whole number")
    return corners.astype(np.int64)
