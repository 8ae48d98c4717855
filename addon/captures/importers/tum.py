# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Trajectories of the TUM RGB-D benchmark (Sturm et al., 2012): ``timestamp tx ty tz qx qy qz qw`` on one line a pose.

The translation is the optical centre in the world, the quaternion turns the camera's axes (x right, y down, looking along +z)
into the world's. Lines that begin with # are comments. The format has no intrinsics: an OpenCV FileStorage file beside the
trajectory gives ``K`` and perhaps ``distortion``; its pixels have the centre of the top-left one at (0, 0), as here.

``rgb.txt`` beside the trajectory lists ``timestamp file`` of each picture; without it a picture's name is its timestamp, and
the pictures lie in the folder ``rgb`` or beside the trajectory. A picture has the pose that is nearest in time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import ScanstageError
from ...options import Option
from ...reconstruction.geometry import Camera
from .colmap import quaternion_to_rotation
from .opencv import calibration_file, open_storage
from .sources import Import, assemble, common_size, find_below, own_file, pictures_in, plain_numbers, read_text
from .turntable import single_camera

TUM_OPTIONS = (
    Option("tolerance", 0.02, "Seconds between a picture and its pose up to which they belong together; pictures without are left out",
           minimum=0.0, maximum=1e6),
)
TRAJECTORIES = ("groundtruth.txt", "trajectory.txt")
_PICTURES, _LISTED = "rgb", "rgb.txt"
_MAX_ROUNDING = 1e-2  # of a quaternion's length, written with few digits


def read_tum(source: Path, *, tolerance: float) -> Import:
    """Read a trajectory and find its pictures.

    Parameters
    ----------
    source : Path
        The trajectory, or the folder of ``groundtruth.txt`` or ``trajectory.txt``.
    tolerance : float
        Seconds.

    Raises
    ------
    ScanstageError
        A line cannot be used, there are no intrinsics, or no picture has a pose.
    """
    path = _trajectory(source)
    calibration = calibration_file(path.parent)
    poses = _poses(path)
    stamps, pictures = _pictures(path)
    found = poses[_nearest(poses[:, 0], stamps)]
    shots = [(picture, pose) for picture, pose, stamp in zip(pictures, found, stamps, strict=True) if abs(pose[0] - stamp) <= tolerance]
    if not shots:
        raise ScanstageError(f"{path.name}: no picture has a pose within {tolerance:g} s of it; check the timestamps, or raise tolerance")
    with open_storage(calibration) as storage:
        camera = single_camera(storage, calibration, common_size([picture for picture, _ in shots], path.name))
    return assemble([(picture, _posed(camera, pose[4:], pose[1:4])) for picture, pose in shots])


def _trajectory(source: Path) -> Path:
    if source.is_file():
        return source
    found = [own_file(source, name) for name in TRAJECTORIES if (source / name).is_file()]
    if not found:
        raise ScanstageError(f"{source}: holds no {' or '.join(TRAJECTORIES)}; give the file of the poses itself")
    return found[0]


def _rows(path: Path) -> list[tuple[str, list[str]]]:
    """Return the words of each line that is no comment, with its place for error messages."""
    lines = enumerate(read_text(path).splitlines(), start=1)
    return [(f"{path.name}: line {number}", line.split()) for number, line in lines if line.strip() and not line.lstrip().startswith("#")]


def _poses(path: Path) -> np.ndarray:
    """Return the lines (n, 8), sorted by time."""
    rows, places = [], []
    for place, words in _rows(path):
        if len(words) != 8:
            raise ScanstageError(f"{place}: has {len(words)} words where 8 are needed (timestamp tx ty tz qx qy qz qw); correct it")
        rows.append(plain_numbers(words, place))
        places.append(place)
    if not rows:
        raise ScanstageError(f"{path.name}: holds no pose; check that it is the right file")
    table = np.array(rows)
    order = np.argsort(table[:, 0], kind="stable")
    table = table[order]
    if len(again := np.flatnonzero(np.diff(table[:, 0]) == 0)):
        raise ScanstageError(f"{places[order[again[0] + 1]]}: the timestamp is given twice; leave one out")
    lengths = np.linalg.norm(table[:, 4:], axis=1)
    if len(wrong := np.flatnonzero(~(np.abs(lengths - 1) <= _MAX_ROUNDING))):
        raise ScanstageError(f"{places[order[wrong[0]]]}: the quaternion has the length {lengths[wrong[0]]:g}, not 1; correct it")
    return table


def _pictures(path: Path) -> tuple[np.ndarray, list[Path]]:
    """Return the time (n,) of each picture, and the n pictures."""
    folder = path.parent
    if (folder / _LISTED).is_file():
        found: dict[Path, float] = {}
        for place, words in _rows(own_file(folder, _LISTED)):
            time, picture = _listed(folder, place, words)
            if found.setdefault(picture, time) != time:
                raise ScanstageError(f"{place}: {picture.name} is listed with another timestamp above; leave one out")
        return np.array(list(found.values())), list(found)
    pictures = pictures_in(own_file(folder, _PICTURES) if (folder / _PICTURES).is_dir() else folder)
    times = [plain_numbers([picture.stem], f"{picture.name}: the name is not the picture's timestamp and {_LISTED} is not there")[0]
             for picture in pictures]
    return np.array(times), pictures


def _nearest(times: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Return for each of ``stamps`` (m,) the row of ``times`` (n,), which are sorted, that is nearest to it."""
    after = np.searchsorted(times, stamps).clip(1, max(len(times) - 1, 1))
    before = after - 1
    after = after.clip(0, len(times) - 1)
    return np.where(stamps - times[before] <= times[after] - stamps, before, after)


def _listed(folder: Path, place: str, words: list[str]) -> tuple[float, Path]:
    if len(words) != 2:
        raise ScanstageError(f"{place}: has {len(words)} words where 2 are needed (timestamp file); correct it")
    picture = find_below(folder, words[1], place)
    if picture is None:
        raise ScanstageError(f"{place}: the picture {words[1][:100]!r} is not in {folder}; put it there")
    return plain_numbers(words[:1], place)[0], picture


def _posed(camera: Camera, quaternion: np.ndarray, centre: np.ndarray) -> Camera:
    R = quaternion_to_rotation(np.roll(quaternion, 1)).T
    return replace(camera, R=R, t=-R @ centre)
