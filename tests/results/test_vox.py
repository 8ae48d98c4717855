# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""MagicaVoxel files, read back by a parser that shares nothing with the writer."""

import struct

import numpy as np
import pytest

from addon.errors import ScanstageError
from addon.reconstruction.color import srgb_to_linear
from addon.results.vox import quantize, write_vox


class Reader:
    """A .vox file as voxels in the scene's coordinates."""

    def __init__(self, data: bytes) -> None:
        magic, version, main, own, children = struct.unpack_from("<4si4sii", data)
        assert (magic, version, main, own, children) == (b"VOX ", 150, b"MAIN", 0, len(data) - 20)
        self.sizes, self.models, self.parent, self.translation, self.shapes = [], [], {}, {}, {}
        at = 20
        while at < len(data):
            name, length, children = struct.unpack_from("<4sii", data, at)
            assert children == 0
            getattr(self, name.decode().lower())(data[at + 12:at + 12 + length])
            at += 12 + length
        assert at == len(data)

    def size(self, chunk):
        self.sizes.append(struct.unpack("<3i", chunk))

    def xyzi(self, chunk):
        entries = np.frombuffer(chunk, np.uint8, offset=4).reshape(-1, 4).astype(int)
        assert struct.unpack_from("<i", chunk)[0] == len(entries)
        self.models.append(entries)

    def rgba(self, chunk):
        self.palette = np.frombuffer(chunk, np.uint8).reshape(256, 4)

    def ntrn(self, chunk):
        node, at = self._int(chunk, 0)
        _, at = self._dict(chunk, at)
        child, reserved, _, frames = struct.unpack_from("<4i", chunk, at)
        frame, at = self._dict(chunk, at + 16)
        assert (reserved, frames, at) == (-1, 1, len(chunk))
        self.parent[child] = node
        self.translation[node] = np.array(frame.get("_t", "0 0 0").split(), int)

    def ngrp(self, chunk):
        node, at = self._int(chunk, 0)
        _, at = self._dict(chunk, at)
        count, at = self._int(chunk, at)
        self.parent.update(dict.fromkeys(struct.unpack_from(f"<{count}i", chunk, at), node))

    def nshp(self, chunk):
        node, at = self._int(chunk, 0)
        _, at = self._dict(chunk, at)
        count, model = struct.unpack_from("<2i", chunk, at)
        _, at = self._dict(chunk, at + 8)
        assert (count, at) == (1, len(chunk))
        self.shapes[node] = model

    def voxels(self):
        """Return the positions (n, 3) and the colours (n, 3) of all models, in the order of the positions."""
        positions, colors = [], []
        assert sorted(self.shapes.values()) == list(range(len(self.models)))
        for node, model in self.shapes.items():
            place, entries = np.zeros(3, int), self.models[model]
            while node != 0:
                node = self.parent[node]
                place = place + self.translation.get(node, 0)
            assert (entries[:, :3] < self.sizes[model]).all()
            assert max(self.sizes[model]) <= 256
            assert entries[:, 3].min() >= 1
            positions.append(place + entries[:, :3] - np.array(self.sizes[model]) // 2)
            colors.append(self.palette[entries[:, 3] - 1, :3])
        positions, colors = np.concatenate(positions), np.concatenate(colors)
        order = np.lexsort(positions.T)
        return positions[order], colors[order]

    @staticmethod
    def _int(chunk, at):
        return struct.unpack_from("<i", chunk, at)[0], at + 4

    def _dict(self, chunk, at):
        count, at = self._int(chunk, at)
        words = []
        for _ in range(2 * count):
            length, at = self._int(chunk, at)
            words.append(chunk[at:at + length].decode())
            at += length
        return dict(zip(words[::2], words[1::2], strict=True)), at


def written(path, voxels, rgb):
    write_vox(path, voxels, rgb)
    return Reader(path.read_bytes())


@pytest.mark.parametrize("extent", [(5, 4, 3), (256, 2, 2), (257, 3, 1), (600, 10, 520)])
def test_positions_and_colors_come_back(tmp_path, extent):
    rng = np.random.default_rng(3)
    cells = np.unique(rng.integers(0, extent, (4000, 3)), axis=0)
    cells = np.unique(np.concatenate((cells, [(0, 0, 0), np.array(extent) - 1])), axis=0)
    table = rng.integers(0, 256, (200, 3), dtype=np.uint8)
    colors = table[rng.integers(0, 200, len(cells))]
    reader = written(tmp_path / "a.vox", cells + 17, srgb_to_linear(colors / 255))
    order = np.lexsort(cells.T)
    positions, found = reader.voxels()
    # The grid's own place is not kept: the scene stands centred on the ground.
    np.testing.assert_array_equal(positions, cells[order] - [extent[0] // 2, extent[1] // 2, 0])
    np.testing.assert_array_equal(found, colors[order])
    assert len(reader.models) == np.prod([-(-n // 256) for n in extent])


def test_empty_tiles_have_no_model(tmp_path):
    reader = written(tmp_path / "a.vox", np.array([(0, 0, 0), (700, 700, 700)]), np.zeros((2, 3)))
    assert len(reader.models) == 2


def test_many_colors_stay_near(tmp_path):
    rng = np.random.default_rng(5)
    # Shades of a few paints under light, as a captured object has them: far more than 255 colours.
    paints = rng.random((6, 3))[rng.integers(0, 6, 30_000)] * rng.uniform(0.2, 1, (30_000, 1))
    colors = np.rint(paints * 255).astype(np.uint8)
    palette, index = quantize(colors)
    assert len(palette) <= 255
    error = np.abs(palette[index].astype(int) - colors)
    # 255 entries on six lines of some 200 byte steps are 5 steps apart: no colour is much farther off than half of it.
    assert error.mean() < 2
    assert error.max() < 16
    again = quantize(colors)
    np.testing.assert_array_equal(palette, again[0])
    np.testing.assert_array_equal(index, again[1])


def test_few_colors_are_exact():
    colors = np.stack((np.arange(255), np.arange(255)[::-1], np.full(255, 9)), axis=1).astype(np.uint8)
    palette, index = quantize(colors)
    np.testing.assert_array_equal(palette[index], colors)


def test_bad_input_leaves_no_file(tmp_path):
    with pytest.raises(ValueError, match="voxels"):
        write_vox(tmp_path / "a.vox", np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="rgb"):
        write_vox(tmp_path / "a.vox", np.zeros((2, 3)), np.zeros((1, 3)))
    with pytest.raises(ScanstageError, match="cannot be written"):
        write_vox(tmp_path / "none" / "a.vox", np.zeros((1, 3)), np.zeros((1, 3)))
    assert not list(tmp_path.iterdir())
