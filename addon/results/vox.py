# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""MagicaVoxel's .vox format: occupied voxels with a palette of 255 colours (format version 150 with the scene graph).

A model of the format is at most 256 voxels long on each side. A larger volume becomes several models, which the scene
graph (nTRN, nGRP, nSHP chunks) puts side by side without a seam. MagicaVoxel's axes are ours: right-handed, z up; it
knows no length, so that one voxel is one of its units.

Formats: https://github.com/ephtracy/voxel-model/blob/master/MagicaVoxel-file-format-vox.txt and
MagicaVoxel-file-format-vox-extension.txt beside it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import cv2
import numpy as np

from ..files import replacing
from ..reconstruction.color import linear_to_srgb

VERSION = 150
TILE = 256
COLORS = 255  # index 0 means empty

_SAMPLES = 20_000  # colours that k-means looks at: 80 a palette entry, and a second of work
_SEED = 1
_CHUNK = 1 << 16


def write_vox(path, voxels: np.ndarray, rgb: np.ndarray) -> None:
    """Write coloured voxels, whole or not at all.

    The scene stands centred on the origin's vertical axis with its lowest voxel on the ground, wherever the grid lies.

    Parameters
    ----------
    path : path-like
        Replaced if it exists.
    voxels : (n, 3) int array
        Indices x, y, z, each voxel once.
    rgb : (n, 3) array
        Linear colours. Exact to a byte of sRGB where there are 255 or fewer, otherwise the nearest palette entry.

    Raises
    ------
    ValueError
        There are no voxels, or not one colour for each.
    ScanstageError
        The file cannot be written.
    """
    voxels = np.asarray(voxels, np.int64)
    if voxels.ndim != 2 or voxels.shape[1] != 3 or not len(voxels):
        raise ValueError(f"voxels must have the shape (n, 3) with n > 0, not {voxels.shape}")
    if np.shape(rgb) != voxels.shape:
        raise ValueError(f"rgb must have the shape {voxels.shape}, not {np.shape(rgb)}")
    palette, index = quantize(np.rint(linear_to_srgb(np.clip(rgb, 0.0, 1.0)) * 255).astype(np.uint8))
    voxels = voxels - voxels.min(axis=0)
    extent = voxels.max(axis=0) + 1
    shift = -np.array([extent[0] // 2, extent[1] // 2, 0])
    models, places = [], []
    for corner, rows in _tiles(voxels):
        tile = voxels[rows] - corner
        size = tile.max(axis=0) + 1
        models.append(_model(tile, size, index[rows]))
        places.append(corner + shift + size // 2)  # a node's translation is where its model's middle voxel lies
    content = b"".join((*models, *_scene_graph(places), _chunk(b"RGBA", _palette_bytes(palette))))
    with replacing(path) as file:
        file.write(b"VOX " + struct.pack("<i", VERSION) + _chunk(b"MAIN", b"", content))


def quantize(colors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a palette of at most 255 colours and each colour's index in it; the same for the same input.

    Colours are clustered by k-means in CIELAB, where distances are those a viewer sees.

    Parameters
    ----------
    colors : (n, 3) uint8 array
        sRGB.

    Returns
    -------
    palette : (p, 3) uint8 array
    index : (n,) uint8 array
        From 0 to ``p - 1``.
    """
    packed = colors.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    unique, index = np.unique(packed, return_inverse=True)
    palette = np.stack((unique >> 16, unique >> 8 & 255, unique & 255), axis=1).astype(np.uint8)
    if len(palette) <= COLORS:
        return palette, index.astype(np.uint8)
    rng = np.random.default_rng(_SEED)
    samples = _lab(colors[rng.choice(len(colors), min(len(colors), _SAMPLES), replace=False)])
    cv2.setRNGSeed(_SEED)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 12, 0.05)
    _, _, centres = cv2.kmeans(samples, min(COLORS, len(samples)), None, stop, 1, cv2.KMEANS_PP_CENTERS)
    chosen = cv2.cvtColor(centres[None], cv2.COLOR_Lab2RGB)[0]
    chosen = np.rint(np.clip(chosen, 0, 1) * 255).astype(np.uint8)
    return chosen, _nearest(_lab(palette), _lab(chosen))[index]


def _lab(colors: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(colors[None].astype(np.float32) / 255, cv2.COLOR_RGB2Lab)[0]


def _nearest(points: np.ndarray, centres: np.ndarray) -> np.ndarray:
    nearest = np.zeros(len(points), np.uint8)
    squares = (centres ** 2).sum(axis=1)
    for start in range(0, len(points), _CHUNK):  # bounded memory: 65536 x 255 distances are 64 MiB
        part = points[start:start + _CHUNK]
        nearest[start:start + _CHUNK] = (squares - 2 * part @ centres.T).argmin(axis=1)
    return nearest


def _tiles(voxels: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the lower corner (3,) of every tile that is not empty, and which (n,) voxels lie in it."""
    tile_of = voxels // TILE
    for tile in np.unique(tile_of, axis=0):
        yield tile * TILE, (tile_of == tile).all(axis=1)


def _model(tile: np.ndarray, size: np.ndarray, index: np.ndarray) -> bytes:
    entries = np.concatenate((tile, index[:, None].astype(np.int64) + 1), axis=1).astype(np.uint8)
    return (_chunk(b"SIZE", struct.pack("<3i", *size.tolist()))
            + _chunk(b"XYZI", struct.pack("<i", len(entries)) + entries.tobytes()))


def _scene_graph(places: list[np.ndarray]) -> Iterator[bytes]:
    """Yield a root transform, a group, and for every model a transform with a shape; node ids count up from 0."""
    transforms = [2 + 2 * model for model in range(len(places))]
    yield _transform(0, 1, -1, {})
    yield _chunk(b"nGRP", struct.pack("<i", 1) + _dictionary({})
                 + struct.pack(f"<{len(places) + 1}i", len(places), *transforms))
    for model, (node, place) in enumerate(zip(transforms, places, strict=True)):
        yield _transform(node, node + 1, 0, {"_t": " ".join(map(str, place.tolist()))})
        yield _chunk(b"nSHP", struct.pack("<i", node + 1) + _dictionary({}) + struct.pack("<2i", 1, model)
                     + _dictionary({}))


def _transform(node: int, child: int, layer: int, frame: dict[str, str]) -> bytes:
    reserved, frames = -1, 1
    return _chunk(b"nTRN", struct.pack("<i", node) + _dictionary({})
                  + struct.pack("<4i", child, reserved, layer, frames) + _dictionary(frame))


def _dictionary(entries: dict[str, str]) -> bytes:
    words = [word.encode() for entry in entries.items() for word in entry]
    return struct.pack("<i", len(entries)) + b"".join(struct.pack("<i", len(word)) + word for word in words)


def _palette_bytes(palette: np.ndarray) -> bytes:
    rgba = np.zeros((256, 4), np.uint8)  # entry i of the chunk is colour i + 1 of the voxels; the last is never used
    rgba[:len(palette), :3] = palette
    rgba[:, 3] = 255
    return rgba.tobytes()


def _chunk(name: bytes, content: bytes, children: bytes = b"") -> bytes:
    return name + struct.pack("<2i", len(content), len(children)) + content + children
