# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of a sparse volume: the exposed faces of its voxels, as one closed mesh of quads.

A face is exposed where an occupied voxel meets an empty one or the end of the grid. Vertices are shared, so that the
mesh has no cracks: every edge is run through as often in one direction as in the other. Where two voxels touch along
an edge only, four faces share that edge.

Everything is read from the bricks. A brick is held as eight 64-bit words, one a layer in x, with y in the bytes and z
in the bits of each byte, so that 64 voxels are compared with their neighbours at once. Time and memory follow the
surface, never the volume.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from .volume import BRICK, EMPTY, FULL, SparseVolume

CHUNK = 512  # bricks worked on together: their tables (1.5 MB) stay in the cache
FACES_AT_ONCE = 1 << 16
LATTICE = BRICK + 1  # lattice points along the edge of a brick, both ends counted

_BITS = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little").astype(np.int32)
_COUNT = _BITS.sum(axis=1, dtype=np.int64)
_RANK = np.ascontiguousarray(np.cumsum(_BITS, axis=1, dtype=np.int32) - _BITS)  # set bits below each bit
_PLACES = np.indices((BRICK,) * 3, np.int32).reshape(3, -1).T.copy()  # of a brick's 512 voxels
_NORMALS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]], np.float64)


@dataclass(frozen=True)
class Surface:
    """The exposed faces of a volume.

    Parameters
    ----------
    vertices : (v, 3) float64 array
        In the object frame, each corner once.
    quads : (q, 4) int32 array
        Rows of ``vertices``, counter-clockwise seen from outside.
    voxels : (s, 3) int32 array
        Indices of the voxels with at least one exposed face.
    face_voxel : (q,) int32 array
        The row in ``voxels`` of each face's voxel.
    face_axis : (q,) int8 array
        The outward normal: 0 to 5 are -x, +x, -y, +y, -z, +z.
    """

    vertices: np.ndarray
    quads: np.ndarray
    voxels: np.ndarray
    face_voxel: np.ndarray
    face_axis: np.ndarray

    @cached_property
    def sides(self) -> tuple[Side, ...]:
        """The faces by the way that they look, in arrays that are quick to take from."""
        cells = np.ascontiguousarray(self.voxels.T)
        return tuple(Side.of(self, cells, way) for way in range(len(_NORMALS)))

    def triangles(self) -> np.ndarray:
        """Return the (2q, 3) int32 triangles: faces cut along their first diagonal, two after each other."""
        return self.quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)

    def face_normals(self) -> np.ndarray:
        """Return the (q, 3) float64 outward unit normals of the faces."""
        return _NORMALS[self.face_axis]

    def on_faces(self, values: np.ndarray) -> np.ndarray:
        """Return per face (q, ...) what ``values`` (s, ...) holds per surface voxel, such as colours."""
        return np.asarray(values)[self.face_voxel]

    def exposure(self) -> np.ndarray:
        """Return the (s, 3) float64 sums of the normals of each surface voxel's exposed faces."""
        total = np.zeros((len(self.voxels), 3))
        for axis, normal in enumerate(_NORMALS):
            # A voxel has at most one face a direction, so that no row is added to twice.
            total[self.face_voxel[self.face_axis == axis], axis // 2] += normal[axis // 2]
        return total

    def normals(self, *, smoothing: int = 0) -> np.ndarray:
        """Return the (s, 3) float64 outward unit normals of the surface voxels.

        Parameters
        ----------
        smoothing : int
            How often normals are averaged over the voxels that share a vertex. Without it a normal is the sum of the
            voxel's exposed faces and has one of 26 directions.

        Returns
        -------
        (s, 3) array
            Zero where opposite faces cancel out, as in a sheet of one voxel: such a voxel faces no way.
        """
        total = self.exposure()
        for _ in range(smoothing):
            total = self.spread(total)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.divide(total, length, out=np.zeros_like(total), where=length > 1e-9)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Return the (s, c) sums of per-voxel ``values`` (s, c) over faces that share a vertex, faces counted singly.

        The neighbourhood is that of the surface, not of space: the other side of a thin wall has no part in it.
        """
        out = np.zeros(values.shape)
        parts = [slice(start, start + FACES_AT_ONCE) for start in range(0, len(self.quads), FACES_AT_ONCE)]
        for channel in range(values.shape[1]):
            of_voxels, at_vertices = values[:, channel].astype(np.float64), np.zeros(len(self.vertices))
            for part in parts:
                np.add.at(at_vertices, self.quads[part].ravel(), np.repeat(of_voxels.take(self.face_voxel[part]), 4))
            for part in parts:
                np.add.at(out[:, channel], self.face_voxel[part], at_vertices.take(self.quads[part]).sum(axis=1))
        return out


@dataclass(frozen=True)
class Side:
    """The faces of a surface that look one way.

    Parameters
    ----------
    axis : int
        That they lie across.
    upper : bool
        Whether they look along it, not against it.
    faces : (f,) intp array
        Rows of the surface's quads.
    cells : (3, f) int32 array
        Their voxels; in the row ``axis`` the planes that they lie in, in voxels from the grid's lower corner.
    quads : (4, f) int32 array
        Rows of the surface's vertices.
    """

    axis: int
    upper: bool
    faces: np.ndarray
    cells: np.ndarray
    quads: np.ndarray

    @classmethod
    def of(cls, surface: Surface, voxels: np.ndarray, way: int) -> Side:
        """Gather the faces that look along one of the six normals; ``voxels`` (3, s) are the surface's."""
        axis, upper = divmod(way, 2)
        faces = np.flatnonzero(surface.face_axis == way)
        cells = voxels.take(surface.face_voxel.take(faces), axis=1)
        cells[axis] += upper
        return cls(axis, bool(upper), faces, cells, np.ascontiguousarray(surface.quads.take(faces, axis=0).T))


def extract_surface(volume: SparseVolume) -> Surface:
    """Return the exposed faces of a volume, in a fixed order (brick by brick, in each brick direction by direction).

    Parameters
    ----------
    volume : SparseVolume

    Returns
    -------
    Surface
        With no rows at all for an empty volume.
    """
    bricks = _Bricks.of(volume)
    chunks = [slice(start, start + CHUNK) for start in range(0, max(1, len(bricks.at)), CHUNK)]
    vertices = _Numbering.of(np.concatenate([bricks.vertices(rows) for rows in chunks]))
    voxels = _Numbering.of(np.concatenate([np.bitwise_or.reduce(bricks.exposed(rows), axis=1) for rows in chunks]))
    quads, face_voxel, face_axis = [], [], []
    for rows in chunks:
        brick, axis, local = _faces(bricks.exposed(rows))
        quads.append(_corners(bricks.lattice(vertices, rows), brick, axis, local))
        face_voxel.append(voxels.number(rows, brick, local))
        face_axis.append(axis.astype(np.int8))
    grid = volume.grid
    return Surface(vertices=grid.origin + grid.voxel_size * vertices.positions(bricks.at),
                   quads=np.concatenate(quads), voxels=voxels.positions(bricks.at),
                   face_voxel=np.concatenate(face_voxel), face_axis=np.concatenate(face_axis))


@dataclass(frozen=True)
class _Bricks:
    """The bricks that hold a vertex or an exposed face.

    A lattice point belongs to the brick of the voxel above it along all axes.

    Parameters
    ----------
    at : (c, 3) int32 array
        Brick indices, one beyond the map where the grid ends.
    flat : (c,) int array
        The same as flat indices into ``padded``.
    padded, row : (bx + 3, by + 3, bz + 3) int32 arrays
        The brick map with one layer of empty bricks below and two above; of the same shape, the rows of ``at`` (0
        where there is none).
    words : (m + 2, 8) uint64 array
        The mixed bricks, then a full and an empty one.
    """

    at: np.ndarray
    flat: np.ndarray
    padded: np.ndarray
    row: np.ndarray
    words: np.ndarray

    @classmethod
    def of(cls, volume: SparseVolume) -> _Bricks:
        padded = np.pad(volume.brick_map, (1, 2), constant_values=EMPTY)
        some, not_all = padded != EMPTY, padded != FULL
        # A vertex needs both kinds of voxel among the bricks below and beside it; a face of an occupied brick needs an
        # empty voxel in the brick or its neighbours, of which those below have been looked at already.
        vertex = _any_below(some) & _any_below(not_all)
        face = some[1:-1, 1:-1, 1:-1] & (not_all[2:, 1:-1, 1:-1] | not_all[1:-1, 2:, 1:-1] | not_all[1:-1, 1:-1, 2:])
        at = np.argwhere(vertex | face).astype(np.int32)
        flat = np.ravel_multi_index(tuple(at.T + 1), padded.shape)
        row = np.zeros(padded.shape, np.int32)
        row.flat[flat] = np.arange(len(flat))
        words = np.zeros((len(volume.bricks) + 2, BRICK), "<u8")
        words[FULL] = ~np.uint64(0)  # EMPTY and FULL are -1 and -2: as indices, the last row and the one before it
        words[:-2] = np.packbits(volume.bricks.reshape(-1), bitorder="little").view("<u8").reshape(-1, BRICK)
        return cls(at, flat, padded, row, words)

    def _beside(self, table: np.ndarray, flat: np.ndarray, offset: tuple[int, int, int]) -> np.ndarray:
        """Look up, in a table shaped like ``padded``, the bricks at ``offset`` from the bricks ``flat``."""
        _, ny, nz = table.shape
        return table.ravel().take(flat + (offset[0] * ny + offset[1]) * nz + offset[2])

    def exposed(self, rows: slice) -> np.ndarray:
        """Return (k, 6, 8, 8) uint8: per outward direction the occupied voxels with no neighbour there."""
        flat = self.flat[rows]
        here = self._words(flat, (0, 0, 0))
        out = np.zeros((len(here), 6, BRICK), "<u8")
        for axis in range(3):
            step = np.eye(3, dtype=int)[axis]
            out[:, 2 * axis] = here & ~_lower(here, self._words(flat, -step), axis)
            out[:, 2 * axis + 1] = here & ~_upper(here, self._words(flat, step), axis)
        return out.view(np.uint8).reshape(-1, 6, BRICK, BRICK)

    def vertices(self, rows: slice) -> np.ndarray:
        """Return (k, 8, 8) uint8: the lattice points whose 8 voxels are neither all empty nor all occupied."""
        flat = self.flat[rows]
        some = {below: self._words(flat, below) for below in product((0, -1), repeat=3)}
        every = dict(some)
        for axis in (2, 1, 0):
            for below in product((0, -1), repeat=axis):
                # Here every key has lost the axes done so far: (x, y, z), then (x, y), then (x,).
                own, beside = (*below, 0), (*below, -1)
                some[below] = some[own] | _lower(some[own], some[beside], axis)
                every[below] = every[own] & _lower(every[own], every[beside], axis)
        return (some[()] & ~every[()]).view(np.uint8).reshape(-1, BRICK, BRICK)

    def _words(self, flat: np.ndarray, offset: tuple[int, int, int]) -> np.ndarray:
        return self.words.take(self._beside(self.padded, flat, offset), axis=0)

    def lattice(self, numbering: _Numbering, rows: slice) -> np.ndarray:
        """Return (k, 9, 9, 9) int32: the number of each lattice point of the bricks; of a point not numbered, any."""
        flat = self.flat[rows]
        out = np.zeros((len(flat), LATTICE, LATTICE, LATTICE), np.int32)
        for x, y in product((0, 1), repeat=2):
            to = (slice(None), slice(BRICK, LATTICE) if x else slice(0, BRICK),
                  slice(BRICK, LATTICE) if y else slice(0, BRICK))
            of = (slice(None), slice(0, 1 if x else BRICK), slice(0, 1 if y else BRICK))
            here = self._beside(self.row, flat, (x, y, 0))
            above = self._beside(self.row, flat, (x, y, 1))
            first = numbering.first.take(here, axis=0)[of]
            rank = _RANK.take(numbering.bits.take(here, axis=0)[of], axis=0)
            np.add(first[..., None], rank, out=out[(*to, slice(0, BRICK))])
            out[(*to, BRICK)] = numbering.first.take(above, axis=0)[of]  # the lowest bit of a column comes first
        return out


def _any_below(mask: np.ndarray) -> np.ndarray:
    """Return whether ``mask`` holds for a brick or one of the 7 below it: for all bricks and one layer above them."""
    for axis in range(3):
        lower, upper = (np.moveaxis(mask, axis, 0)[rows] for rows in (slice(0, -2), slice(1, -1)))
        mask = np.moveaxis(lower | upper, 0, axis)
    return mask


_BIT_0, _BITS_1_TO_7 = np.uint64(0x0101010101010101), np.uint64(0xFEFEFEFEFEFEFEFE)


def _lower(words: np.ndarray, beside: np.ndarray, axis: int) -> np.ndarray:
    """Return, at each voxel of the bricks ``words`` (k, 8), its neighbour below; ``beside`` are the bricks below."""
    if axis == 0:
        return np.concatenate((beside[:, -1:], words[:, :-1]), axis=1)
    if axis == 1:
        return words << np.uint64(8) | beside >> np.uint64(56)
    return words << np.uint64(1) & _BITS_1_TO_7 | beside >> np.uint64(7) & _BIT_0


def _upper(words: np.ndarray, beside: np.ndarray, axis: int) -> np.ndarray:
    """Return, at each voxel of the bricks ``words`` (k, 8), its neighbour above; ``beside`` are the bricks above."""
    if axis == 0:
        return np.concatenate((words[:, 1:], beside[:, :1]), axis=1)
    if axis == 1:
        return words >> np.uint64(8) | beside << np.uint64(56)
    return words >> np.uint64(1) & ~(_BIT_0 << np.uint64(7)) | (beside & _BIT_0) << np.uint64(7)


@dataclass(frozen=True)
class _Numbering:
    """Consecutive numbers for the set bits of ``bits`` (c, 8, 8) uint8; ``first`` (c, 8, 8) is each column's first."""

    bits: np.ndarray
    first: np.ndarray

    @classmethod
    def of(cls, bits: np.ndarray) -> _Numbering:
        count = _COUNT.take(bits).ravel()
        return cls(bits, (np.cumsum(count) - count).astype(np.int32).reshape(bits.shape))

    def positions(self, bricks: np.ndarray) -> np.ndarray:
        """Return the (n, 3) int32 lattice positions of the set bits, in the order of their numbers."""
        where = _set_bits(self.bits)
        return np.take(bricks * BRICK, where >> 9, axis=0) + _PLACES.take(where & 511, axis=0)

    def number(self, rows: slice, brick: np.ndarray, local: np.ndarray) -> np.ndarray:
        """Return the numbers of set bits, given by brick (counted from ``rows.start``) and place in the brick."""
        column = (brick << 6) + (local >> 3)
        bits = self.bits[rows].ravel().take(column).astype(np.intp)
        return self.first[rows].ravel().take(column) + _RANK.ravel().take((bits << 3) + (local & 7))


def _set_bits(columns: np.ndarray) -> np.ndarray:
    """Return the flat indices of the set bits of an array of bytes, lowest bit first."""
    columns = columns.ravel()
    where = np.flatnonzero(columns != 0)  # numpy searches bools several times faster than bytes
    hit = np.flatnonzero(np.unpackbits(columns.take(where), bitorder="little").view(bool))
    return (where * BRICK).take(hit >> 3) + (hit & 7)


def _faces(exposed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return brick, direction and place in the brick of each set bit of ``exposed`` (k, 6, 8, 8)."""
    face = _set_bits(exposed)
    brick, axis = np.divmod(np.arange(len(exposed) * 6), 6)
    layer = face >> 9
    return brick.take(layer), axis.take(layer), face & 511


def _corner_offsets() -> np.ndarray:
    """Return (6, 4): the flat lattice steps from a voxel's lower corner to the corners of its face, outward."""
    steps = np.array([LATTICE ** 2, LATTICE, 1])
    out = np.zeros((6, 4), np.int64)
    for axis in range(3):
        u, v = steps[(axis + 1) % 3], steps[(axis + 2) % 3]  # u x v points along the axis
        out[2 * axis] = [0, v, u + v, u]
        out[2 * axis + 1] = steps[axis] + np.array([0, u, u + v, v])
    return out


_OFFSETS = _corner_offsets()
_LOWER_CORNER = np.ravel_multi_index(np.unravel_index(np.arange(BRICK ** 3), (BRICK,) * 3), (LATTICE,) * 3)


def _corners(lattice: np.ndarray, brick: np.ndarray, axis: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Return the (n, 4) numbers of the faces' corners from the bricks' (k, 9, 9, 9) tables."""
    corner = brick * LATTICE ** 3 + _LOWER_CORNER.take(local)
    return lattice.ravel().take(corner[:, None] + _OFFSETS.take(axis, axis=0))
