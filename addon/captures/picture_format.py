# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture file's size, and whether all of it is there, from its bytes alone.

Decoders are no judges of either: they allocate what a header claims before they look at the data, and some fill up a
truncated picture with grey and call it decoded. So both questions are answered here, before a decoder runs.
PNG (ISO/IEC 15948), JPEG (ITU-T T.81), TIFF 6.0 and binary PNM (P5, P6).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm", ".pgm")


@dataclass(frozen=True)
class Header:
    """What a picture file says about itself.

    Parameters
    ----------
    width, height : int
        In pixels.
    whole : bool
        Whether every byte that the format announces is there; for PNG also whether every checksum is right.
    texts : mapping of str to str
        What a PNG file's plain texts say, by their keywords; Blender notes the frame's number there, among other things.
    """

    width: int
    height: int
    whole: bool
    texts: Mapping[str, str] = field(default_factory=dict)

    def fits(self, size: tuple[int, int]) -> bool:
        """Return whether the picture is of that width and height, with nothing cut off."""
        return self.whole and (self.width, self.height) == tuple(size)


def read_header(data: bytes) -> Header | None:
    """Return the header of a picture file's bytes, or None if they begin no picture of a known format."""
    readers = {b"\x89PNG\r\n\x1a\n": _png, b"\xff\xd8\xff": _jpeg, b"II*\0": _tiff, b"MM\0*": _tiff,
               b"P5": _pnm, b"P6": _pnm}
    for magic, reader in readers.items():
        if data.startswith(magic):
            try:
                return reader(data)
            except (struct.error, IndexError, KeyError):  # the header itself is cut off
                return None
    return None


def _png(data: bytes) -> Header | None:
    if data[12:16] != b"IHDR":
        return None
    width, height = struct.unpack_from(">II", data, 16)
    view, at, texts = memoryview(data), 8, {}
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data) or zlib.crc32(view[at + 4:end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            return Header(width, height, False, texts)
        if kind == b"IEND":
            return Header(width, height, True, texts)
        if kind == b"tEXt":
            keyword, _, text = data[at + 8:end - 4].decode("latin-1").partition("\0")
            texts[keyword] = text
        at = end
    return Header(width, height, False, texts)


def _jpeg(data: bytes) -> Header | None:
    size, at = None, 2
    while data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # padding
            at += 1
            continue
        length, = struct.unpack_from(">H", data, at + 2)
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):  # a start of frame
            height, width = struct.unpack_from(">HH", data, at + 5)
            size = width, height
        at += 2 + length
        if marker == 0xDA:  # the scan begins: in what follows FF D9 can only be the end of the image
            return size and Header(*size, data.find(b"\xff\xd9", at) >= 0)
    return None


_WIDTH, _HEIGHT, _STRIP_OFFSETS, _STRIP_BYTES, _TILE_OFFSETS, _TILE_BYTES = _TIFF_TAGS = 256, 257, 273, 279, 324, 325


_TIFF_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}  # of a value, by type


def _tiff(data: bytes) -> Header:
    order = "<" if data[:2] == b"II" else ">"
    directory, = struct.unpack_from(order + "I", data, 4)
    count, = struct.unpack_from(order + "H", data, directory)
    tags, ends = {}, [directory + 2 + 12 * count + 4]
    for entry in range(directory + 2, directory + 2 + 12 * count, 12):
        tag, kind, number = struct.unpack_from(order + "HHI", data, entry)
        place, size = entry + 8, number * _TIFF_BYTES.get(kind, 0)
        if size > 4:
            place, = struct.unpack_from(order + "I", data, place)
            ends.append(place + size)
        code = {3: "H", 4: "I"}.get(kind)
        if tag in _TIFF_TAGS and code is not None and number <= 1 << 20:
            tags[tag] = struct.unpack_from(f"{order}{number}{code}", data, place)
    tiled = _TILE_OFFSETS in tags
    offsets, lengths = tags[_TILE_OFFSETS if tiled else _STRIP_OFFSETS], tags[_TILE_BYTES if tiled else _STRIP_BYTES]
    ends += map(int.__add__, offsets, lengths)
    whole = len(offsets) == len(lengths) and max(ends) <= len(data)
    return Header(tags[_WIDTH][0], tags[_HEIGHT][0], whole)


_PNM_HEADER = re.compile(rb"P([56])" + 3 * rb"(?:\s+|#[^\n]*\n)+(\d{1,9})" + rb"\s")


def _pnm(data: bytes) -> Header | None:
    match = _PNM_HEADER.match(data[:4096])
    if match is None:
        return None
    kind, width, height, most = map(int, match.groups())
    samples = width * height * (3 if kind == 6 else 1) * (2 if most > 255 else 1)
    return Header(width, height, len(data) - match.end() >= samples)
