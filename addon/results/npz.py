# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""``volume.npz``: a standard numpy archive that is written and read in slabs.

`numpy.load(..., allow_pickle=False)` reads it, but holds the whole dense array in doing so; here no more than a slab
of 8 layers is ever dense. A file that is read is untrusted: what an array may be is stated by the caller and compared
with the header, and the header with the size of the data, before anything is allocated.
"""

from __future__ import annotations

import io
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import ScanstageError
from ..files import replacing
from ..reconstruction.geometry import VoxelGrid
from ..reconstruction.volumetric.volume import BRICK, SparseVolume

MAX_SIDE = 1 << 14
MAX_LAYER = 1 << 24  # voxels with the same x: a slab of 8 such layers is 128 MiB
MAX_ENTRIES = 1 << 26  # rows of any other array
MAX_HEADER = 1 << 12
COMPRESSION = 1  # zlib's fastest: occupancy is almost all zeros, and higher levels gain little
AGAIN = "reconstruct again"
# What numpy's parser raises; MemoryError is Python's word for brackets nested too deeply.
_BAD_HEADER = (ValueError, TypeError, SyntaxError, tokenize.TokenError, RecursionError, MemoryError)


def write_volume(path: Path, volume: SparseVolume, arrays: Mapping[str, np.ndarray]) -> None:
    """Write the occupancy, its grid, and further arrays by name.

    Raises
    ------
    ScanstageError
        The file cannot be written.
    """
    grid = volume.grid
    deflate = {"compression": zipfile.ZIP_DEFLATED, "compresslevel": COMPRESSION}
    with replacing(path) as file, zipfile.ZipFile(file, "w", **deflate) as archive:
        with archive.open("occupancy.npy", "w", force_zip64=True) as entry:
            header = {"descr": "|b1", "fortran_order": False, "shape": grid.shape}
            np.lib.format.write_array_header_1_0(entry, header)
            for slab in volume.slabs():
                entry.write(np.ascontiguousarray(slab).data.cast("B"))
        for name, array in {"origin": grid.origin, "voxel_size": np.float64(grid.voxel_size), **arrays}.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)


class VolumeFile:
    """An open ``volume.npz``; get one from `open_volume`. Its methods raise ScanstageError for what cannot be."""

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self._archive = archive
        self._path = path

    def __contains__(self, name: str) -> bool:
        return f"{name}.npy" in self._archive.namelist()

    def array(self, name: str, dtype: str, shape: tuple[int | None, ...], *, most: int = MAX_ENTRIES) -> np.ndarray:
        """Read a whole array of that type and shape, where None is any length, and of at most so many rows."""
        with self._entry(name) as entry:
            found = self._header(entry, name, dtype, shape)
            if found and found[0] > min(most, MAX_ENTRIES):
                raise ScanstageError(f"{self._path}: {name} has {found[0]} rows, more than {min(most, MAX_ENTRIES)}; {AGAIN}")
            return np.frombuffer(self._read(entry, name, _bytes(found, dtype)), dtype).reshape(found)

    def shape(self, name: str, dtype: str, dimensions: int) -> tuple[int, ...]:
        """Read what shape an array of that type and number of dimensions has."""
        with self._entry(name) as entry:
            return self._header(entry, name, dtype, (None,) * dimensions)

    def volume(self, grid: VoxelGrid) -> SparseVolume:
        """Read ``occupancy``, whose shape must be the grid's, slab by slab."""
        check_size(grid, self._path)
        with self._entry("occupancy") as entry:
            self._header(entry, "occupancy", "|b1", grid.shape)
            return SparseVolume.from_slabs(grid, self._slabs(entry, grid))

    def _slabs(self, entry: BinaryIO, grid: VoxelGrid) -> Iterator[np.ndarray]:
        nx, ny, nz = grid.shape
        for x in range(0, nx, BRICK):
            layers = min(BRICK, nx - x)
            values = np.frombuffer(self._read(entry, "occupancy", layers * ny * nz), np.uint8)
            if values.max() > 1:
                raise ScanstageError(f"{self._path}: occupancy holds something other than 0 and 1; {AGAIN}")
            yield values.view(bool).reshape(layers, ny, nz)

    @contextmanager
    def _entry(self, name: str) -> Iterator[BinaryIO]:
        if name not in self:
            raise ScanstageError(f"{self._path}: has no array {name}; {AGAIN}")
        with self._archive.open(f"{name}.npy") as entry:
            yield entry

    def _header(self, entry: BinaryIO, name: str, dtype: str, shape: tuple[int | None, ...]) -> tuple[int, ...]:
        try:
            if np.lib.format.read_magic(entry) != (1, 0):
                raise ValueError("its version is not 1.0")
            size = int.from_bytes(self._read(entry, name, 2), "little")
            if size > MAX_HEADER:
                raise ValueError(f"its header is longer than {MAX_HEADER} bytes")
            header = io.BytesIO(size.to_bytes(2, "little") + self._read(entry, name, size))
            found, fortran_order, kind = np.lib.format.read_array_header_1_0(header, max_header_size=MAX_HEADER)
        except _BAD_HEADER as error:
            raise ScanstageError(f"{self._path}: {name} is no numpy array ({_line(error)}); {AGAIN}") from None
        fits = len(found) == len(shape) and all(want in (None, have) for want, have in zip(shape, found, strict=True))
        if kind != np.dtype(dtype) or not fits or min(found, default=0) < 0 or (fortran_order and len(found) > 1):
            want = ", ".join("n" if n is None else str(n) for n in shape)
            raise ScanstageError(f"{self._path}: {name} is {kind} {found}, not {np.dtype(dtype)} ({want}); {AGAIN}")
        stated = self._archive.getinfo(f"{name}.npy").file_size
        if stated != entry.tell() + _bytes(found, dtype):
            raise ScanstageError(f"{self._path}: {name} has {stated} bytes, not what its header says; {AGAIN}")
        return found

    def _read(self, entry: BinaryIO, name: str, count: int) -> bytes:
        data = entry.read(count)
        if len(data) != count:
            raise ScanstageError(f"{self._path}: {name} ends early; {AGAIN}")
        return data


def check_size(grid: VoxelGrid, path: Path) -> None:
    """Raise a ScanstageError that names ``path`` if a grid is too large for any file of ours."""
    if max(grid.shape) > MAX_SIDE or grid.shape[1] * grid.shape[2] > MAX_LAYER:
        size = " x ".join(map(str, grid.shape))
        raise ScanstageError(f"{path}: the grid of {size} voxels has more than {MAX_SIDE} a side "
                             f"or {MAX_LAYER} a layer; {AGAIN} with fewer")


def _bytes(shape: tuple[int, ...], dtype: str) -> int:
    count = np.dtype(dtype).itemsize
    for n in shape:  # in Python's integers, which do not overflow
        count *= n
    return count


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:100] or type(error).__name__


@contextmanager
def open_volume(path: Path) -> Iterator[VolumeFile]:
    """Open a ``volume.npz`` for reading.

    Raises
    ------
    ScanstageError
        The file is not there, is no archive, or (from within the block too) is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            yield VolumeFile(archive, path)
    except OSError as error:
        raise ScanstageError(f"{path}: cannot be read ({error.strerror or _line(error)}); {AGAIN}") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:  # as zipfile raises
        raise ScanstageError(f"{path}: is damaged ({_line(error)}); {AGAIN}") from None
