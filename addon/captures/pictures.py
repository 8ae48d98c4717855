# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture files as linear light, and back."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from ..errors import ScanstageError
from ..reconstruction.color import linear_to_srgb, srgb_to_linear
from .files import read_bytes, write_bytes
from .picture_format import Header, read_header
from .schema import ENCODINGS, MAX_PIXELS

MAX_FILE_BYTES = 1 << 31


@lru_cache(maxsize=4)
def _decoding(most: int, encoding: str) -> np.ndarray:
    levels = np.arange(most + 1) / most
    table = (srgb_to_linear(levels) if encoding == "srgb" else levels).astype(np.float32)
    table.flags.writeable = False
    return table


def read_picture(path: Path, encoding: str, *, size: tuple[int, int] | None = None,
                 name: str | None = None) -> tuple[np.ndarray, np.ndarray | None]:
    """Read a PNG, JPEG, TIFF or binary PNM picture.

    Parameters
    ----------
    path : Path
    encoding : str
        How its values stand for light: ``linear`` or ``srgb``. Floating-point TIFF always holds linear light, alpha
        always a share of the pixel.
    size : (int, int), optional
        The width and height it must have.
    name : str, optional
        What error messages call the file; its last component if not given.

    Returns
    -------
    rgb : (height, width, 3) float32 array
        Linear; a grey picture has three equal channels.
    alpha : (height, width) float32 array or None
        From 0 to 1; None if the picture has none.

    Raises
    ------
    ScanstageError
        The file is not there, is cut off, cannot be decoded, or has another size.
    """
    if encoding not in ENCODINGS:
        raise ValueError(f"encoding must be one of {ENCODINGS}, not {encoding!r}")
    name = name or path.name
    pixels = _decode(read_bytes(path, MAX_FILE_BYTES, name), size, name)
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.dtype in (np.uint8, np.uint16):
        most = np.iinfo(pixels.dtype).max
        light, share = _decoding(most, encoding), _decoding(most, "linear")
    elif pixels.dtype in (np.float32, np.float64) and np.isfinite(pixels).all():
        light = share = None
    else:
        raise ScanstageError(f"{name}: holds {pixels.dtype} values that are no picture; save it with 8 or 16 bit")
    order = {1: [0, 0, 0], 2: [0, 0, 0], 3: [2, 1, 0], 4: [2, 1, 0]}.get(pixels.shape[2])  # OpenCV has B first
    if order is None:
        raise ScanstageError(f"{name}: has {pixels.shape[2]} channels; save it as grey, RGB or RGBA")
    rgb, alpha = pixels[..., order], pixels[..., -1] if pixels.shape[2] in (2, 4) else None
    if light is None:
        return rgb.astype(np.float32), None if alpha is None else alpha.astype(np.float32)
    return np.take(light, rgb), None if alpha is None else np.take(share, alpha)


def _decode(data: bytes, size: tuple[int, int] | None, name: str) -> np.ndarray:
    header = read_header(data)
    if header is None:
        raise ScanstageError(f"{name}: is not a PNG, JPEG, TIFF or binary PNM picture; save it as PNG")
    if size is not None and (header.width, header.height) != tuple(size):
        raise ScanstageError(f"{name}: is {header.width}x{header.height} pixels, its camera {size[0]}x{size[1]}; "
                             "put the right picture in place or capture again")
    if not 0 < header.width * header.height <= MAX_PIXELS:
        raise ScanstageError(f"{name}: claims {header.width}x{header.height} pixels; use a picture of "
                             f"1 to {MAX_PIXELS} pixels")
    pixels = None
    if header.whole:
        try:
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            pixels = None  # says no more than an empty answer does: the data are damaged
    if pixels is None or pixels.shape[:2] != (header.height, header.width):
        raise ScanstageError(f"{name}: is cut off or damaged; copy or capture it again")
    return pixels


def picture_size(path: Path, name: str | None = None) -> tuple[int, int]:
    """Return a picture's width and height from its header.

    Raises
    ------
    ScanstageError
        The file is not there or no picture.
    """
    header = read_header(read_bytes(path, MAX_FILE_BYTES, name))
    if header is None:
        raise ScanstageError(f"{name or path.name}: is not a PNG, JPEG, TIFF or binary PNM picture; save it as PNG")
    return header.width, header.height


def picture_is_whole(path: Path, size: tuple[int, int]) -> bool:
    """Return whether ``path`` is a picture of that size with nothing cut off, without decoding it."""
    header = picture_header(path)
    return header is not None and header.fits(size)


def picture_header(path: Path) -> Header | None:
    """Return what a picture file says about itself; None if it is not there or no picture."""
    try:
        return read_header(read_bytes(path, MAX_FILE_BYTES))
    except ScanstageError:
        return None


def write_picture(path: Path, rgb: np.ndarray, alpha: np.ndarray | None = None, *, encoding: str = "linear",
                  bits: int = 16) -> None:
    """Write a PNG, whole or not at all.

    Parameters
    ----------
    path : Path
        Ends with ``.png``.
    rgb : (height, width, 3) array
        Linear, clipped to 0 .. 1.
    alpha : (height, width) array, optional
        From 0 to 1.
    encoding : str
        ``linear`` or ``srgb``.
    bits : int
        8 or 16.

    Raises
    ------
    ScanstageError
        The disk refuses.
    """
    if bits not in (8, 16) or encoding not in ENCODINGS or rgb.ndim != 3 or rgb.shape[2] != 3:
        raise ValueError("write_picture takes (height, width, 3), 8 or 16 bits and a known encoding")
    light = np.clip(rgb, 0, 1)
    channels = [(linear_to_srgb(light) if encoding == "srgb" else light)[..., ::-1]]
    if alpha is not None:
        channels.append(np.clip(alpha, 0, 1)[..., None])
    levels = np.round(np.concatenate(channels, axis=-1) * float((1 << bits) - 1))
    write_levels(path, levels.astype(np.uint8 if bits == 8 else np.uint16))


def read_mask(path: Path, *, size: tuple[int, int], name: str | None = None) -> np.ndarray:
    """Read a silhouette: True where the alpha (of a picture without: the grey value) is at least half.

    Raises
    ------
    ScanstageError
        As for `read_picture`.
    """
    rgb, alpha = read_picture(path, "linear", size=size, name=name)
    return (rgb.mean(axis=-1) if alpha is None else alpha) >= 0.5


def write_mask(path: Path, mask: np.ndarray) -> None:
    """Write a (height, width) bool silhouette as a PNG of black and white, whole or not at all."""
    write_levels(path, np.where(mask, np.uint8(255), np.uint8(0)))


def write_levels(path: Path, levels: np.ndarray) -> None:
    """Write an array of 8- or 16-bit grey levels or BGR(A) colours as a PNG, whole or not at all."""
    write_bytes(path, cv2.imencode(".png", levels)[1].tobytes())
