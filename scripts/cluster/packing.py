# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks, shadows and volumes as few bytes: a bit a pixel or voxel, and compressed."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from addon.reconstruction.geometry import Camera, VoxelGrid
from addon.reconstruction.scan import View
from addon.reconstruction.shadows import ShadowMasks
from addon.reconstruction.volumetric.bounds import Silhouette
from addon.reconstruction.volumetric.volume import BRICK, SparseVolume

_LEVEL = 1  # zlib's fastest: what is packed is almost all of one value


@dataclass(frozen=True)
class Packed:
    """An array as compressed bytes; bool arrays take a bit an element before."""

    data: bytes
    dtype: str
    shape: tuple[int, ...]

    @classmethod
    def of(cls, array: np.ndarray) -> Packed:
        """Pack an array."""
        flat = np.ascontiguousarray(array).ravel()
        return cls(zlib.compress(np.packbits(flat) if array.dtype == bool else flat, _LEVEL), array.dtype.str, array.shape)

    def array(self) -> np.ndarray:
        """Return the array."""
        data = zlib.decompress(self.data)
        if self.dtype != np.dtype(bool).str:
            return np.frombuffer(data, self.dtype).reshape(self.shape)
        return np.unpackbits(np.frombuffer(data, np.uint8), count=int(np.prod(self.shape))).astype(bool).reshape(self.shape)


@dataclass(frozen=True)
class PackedVolume:
    """A `SparseVolume`."""

    grid: VoxelGrid
    brick_map: Packed
    bricks: Packed

    @classmethod
    def of(cls, volume: SparseVolume) -> PackedVolume:
        """Pack a volume."""
        return cls(volume.grid, Packed.of(volume.brick_map), Packed.of(volume.bricks))

    def volume(self) -> SparseVolume:
        """Return the volume."""
        return SparseVolume(self.grid, self.brick_map.array(), self.bricks.array().reshape(-1, BRICK, BRICK, BRICK))


@dataclass(frozen=True)
class PackedSilhouettes:
    """Silhouettes in their order."""

    cameras: tuple[Camera, ...]
    masks: tuple[Packed, ...]
    known: tuple[Packed, ...]

    @classmethod
    def of(cls, silhouettes: Sequence[Silhouette]) -> PackedSilhouettes:
        """Pack silhouettes."""
        return cls(tuple(entry.camera for entry in silhouettes), tuple(Packed.of(entry.mask) for entry in silhouettes),
                   tuple(Packed.of(entry.known) for entry in silhouettes))

    def silhouettes(self) -> list[Silhouette]:
        """Return the silhouettes."""
        return [Silhouette(camera, mask.array(), known.array())
                for camera, mask, known in zip(self.cameras, self.masks, self.known, strict=True)]


@dataclass(frozen=True)
class PackedView:
    """A view with its lights and shadows, and without its pictures."""

    view: View
    bits: Packed | None

    @classmethod
    def of(cls, view: View) -> PackedView:
        """Pack a view."""
        lit = tuple(replace(picture, read_image=None) for picture in view.lit)
        bare = View(view.name, view.camera, None, None, lit)
        return cls(bare, None if view.shadows is None else Packed.of(view.shadows.bits))

    def unpacked(self) -> View:
        """Return the view; all of its pixels count as decidable, which carving does not ask."""
        if self.bits is None:
            return self.view
        bits = self.bits.array()
        return replace(self.view, shadows=ShadowMasks(bits, np.ones(bits.shape, bool)))
