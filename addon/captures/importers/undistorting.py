# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures freed of their lens's distortion while they are imported: once, instead of in every method."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from ...errors import ScanstageError
from ...reconstruction.geometry import Camera
from ...reconstruction.undistortion import resample, undistort_pixels, undistorted_camera
from ..contour_file import contours_text, read_contours
from ..files import write_bytes
from ..pictures import read_mask, read_picture, write_mask, write_picture
from ..schema import Frame
from .sources import Import

_MAX_SIDE = 32766  # OpenCV's, of what it resamples
_8_BIT = (".jpg", ".jpeg")

Writer = Callable[[Path], None]


def undistorted(found: Import, encoding: str) -> tuple[Import, dict[str, Writer]]:
    """Return the set with cameras without distortion, and what writes those of its files that are no longer copies.

    Projectors keep their distortion: what they show is not ours to resample.

    Parameters
    ----------
    found : Import
    encoding : str
        How the pictures' values stand for light.

    Raises
    ------
    ScanstageError
        A lens's distortion cannot be inverted, or its pictures are too large to be resampled.
    """
    capture, pictures, made, frames = found.capture, dict(found.pictures), {}, []
    ideals = {id: _ideal(id, camera) for id, camera in capture.cameras.items() if camera.distorted}
    for frame in capture.frames:
        if frame.camera in ideals:
            changes = {}
            for field, relative, write in _files(frame, capture.cameras[frame.camera], ideals[frame.camera], encoding):
                changes[field] = relative
                made[relative] = partial(write, pictures.pop(getattr(frame, field)))
            frame = replace(frame, **changes)
        frames.append(frame)
    return Import(replace(capture, cameras={**capture.cameras, **ideals}, frames=tuple(frames)), pictures), made


def _ideal(id: str, camera: Camera) -> Camera:
    if max(camera.size) > _MAX_SIDE:
        raise ScanstageError(f"camera {id}: its pictures are more than {_MAX_SIDE} pixels long, too many to undistort; leave undistort "
                             "out")
    try:
        return undistorted_camera(camera)
    except ValueError as error:
        raise ScanstageError(f"camera {id}: {error}; check its coefficients, or leave undistort out") from None


def _files(frame: Frame, camera: Camera, ideal: Camera, encoding: str) -> Iterator[tuple[str, str, Callable[[Path, Path], None]]]:
    """Yield the field, the new path and the writer, from source to target, of each file of a frame."""
    yield "image", f"images/{frame.id}.png", partial(_write_picture, camera, ideal, encoding)
    if frame.mask is not None:
        yield "mask", f"given/{frame.id}.png", partial(_write_mask, camera, ideal)
    if frame.contours is not None:
        yield "contours", f"given/{frame.id}.txt", partial(_write_contours, camera, ideal)


def _write_picture(camera: Camera, ideal: Camera, encoding: str, source: Path, target: Path) -> None:
    rgb, alpha = read_picture(source, encoding, size=camera.size)
    write_picture(target, resample(rgb, camera, ideal), None if alpha is None else resample(alpha, camera, ideal), encoding=encoding,
                  bits=8 if source.suffix.lower() in _8_BIT else 16)


def _write_mask(camera: Camera, ideal: Camera, source: Path, target: Path) -> None:
    write_mask(target, resample(read_mask(source, size=camera.size), camera, ideal))


def _write_contours(camera: Camera, ideal: Camera, source: Path, target: Path) -> None:
    loops = []
    for loop in read_contours(source):
        pixels, inverted = undistort_pixels(loop, camera)
        if not inverted.all():
            x, y = loop[inverted.argmin()]
            raise ScanstageError(f"{source.name}: the lens distortion cannot be inverted at pixel ({x:.1f}, {y:.1f}); check its "
                                 "coefficients")
        loops.append(pixels + ideal.K[:2, 2] - camera.K[:2, 2])
    write_bytes(target, contours_text(loops))
