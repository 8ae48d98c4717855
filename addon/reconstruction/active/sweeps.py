# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A stripe of light that sweeps over the scene: in which frame it is where, and where a camera's ray meets it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import ScanstageError
from ..geometry import Camera
from ..scan import ProjectedPicture
from .patterns import AXES
from .sequences import AGAIN, number_of, of_kind
from .triangulation import light_planes, meet_lines, meet_planes, pixel_width

LEAST_FRAMES = 3
_ASSUMED_WIDTH = 4.0  # of a stripe, in frames and in the camera's pixels, where nothing tells it


@dataclass(frozen=True)
class Sweep:
    """The frames of one sweep, in the order of the light.

    Parameters
    ----------
    pictures : tuple of ProjectedPicture
    positions : (k,) array
        Of the stripe: in projector pixels, or for a laser the frame's number.
    width : float or None
        Of the stripe, four standard deviations: in projector pixels, or for a laser in the scene's unit, where that is known.
    axis : str or None
        Along which a projector's stripe moves.
    planes : (k, 4) array
        Of light, in the object frame; a distorted projector's only nearly.
    """

    pictures: tuple[ProjectedPicture, ...]
    positions: np.ndarray
    width: float | None
    axis: str | None
    planes: np.ndarray

    @property
    def projector(self) -> Camera | None:
        """The projector; None for a laser."""
        return self.pictures[0].projector if self.axis is not None else None

    @property
    def spacing(self) -> float:
        """The step from frame to frame."""
        return float(np.median(np.diff(self.positions)))

    def extent(self, camera: Camera) -> tuple[float, float]:
        """Return about how wide the stripe is in frames, and in the camera's pixels: where it crosses the camera's axis."""
        middle = len(self.positions) // 2
        position = self.positions[middle:middle + 1]
        distance, _ = self.meet(camera.centre, camera.forward[None], position)
        if self.width is None or not (np.isfinite(distance[0]) and distance[0] > 0):
            return _ASSUMED_WIDTH, _ASSUMED_WIDTH
        step = float(self.step_at(camera.centre + distance[0] * camera.forward[None], position)[0])
        width = self.width * step if self.projector is not None else self.width
        return width / (step * self.spacing), width * camera.K[0, 0] / float(distance[0])

    def at(self, index: np.ndarray) -> np.ndarray:
        """Return the stripe's positions (n,) at fractional frame numbers (n,)."""
        return np.interp(index, np.arange(len(self.positions)), self.positions)

    def meet(self, origin: np.ndarray, rays: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances (n,) at which rays (n, 3) meet the light, and the sines of the angles between them."""
        if self.projector is not None:
            return meet_lines(self.projector, self.axis, positions, origin, rays)
        return meet_planes(origin, rays, self._planes_at(positions))

    def step_at(self, points: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Return by how much the light moves at points (n, 3) when its position grows by one."""
        if self.projector is not None:
            return pixel_width(self.projector, self.axis, points)
        lower = np.clip(np.floor(positions).astype(int), 0, len(self.planes) - 2)
        change = self.planes[lower + 1] - self.planes[lower]
        return np.abs((change[:, :3] * points).sum(axis=1) - change[:, 3])

    def _planes_at(self, positions: np.ndarray) -> np.ndarray:
        lower = np.clip(np.floor(positions).astype(int), 0, len(self.planes) - 2)
        share = (positions - lower)[:, None]
        return (1 - share) * self.planes[lower] + share * self.planes[lower + 1]


def find_sweeps(pictures: Sequence[ProjectedPicture], where: str) -> list[Sweep]:
    """Return the sweeps among a view's pictures: one for each projector and axis, and one of a laser.

    Raises
    ------
    ScanstageError
        A sweep has too few frames, two at the same place, or a field is not what it must be.
    """
    groups: dict[tuple[str | None, str | None], list[ProjectedPicture]] = {}
    for picture in of_kind(pictures, "stripe"):
        axis = picture.pattern.get("axis")
        if axis not in AXES:
            raise ScanstageError(f"frame {picture.name}: its pattern's axis must be column or row, not {str(axis)[:40]!r}")
        if picture.projector is None:
            raise ScanstageError(f"frame {picture.name}: its stripe has no projector; calibrate one, or give the stripe a plane")
        groups.setdefault((picture.projector_id, axis), []).append(picture)
    sweeps = [_projected(group, axis) for (_, axis), group in groups.items()]
    if lasers := of_kind(pictures, "laser"):
        sweeps.append(_laser(lasers))
    for sweep in sweeps:
        if len(sweep.pictures) < LEAST_FRAMES:
            raise ScanstageError(f"{where}: its sweep has {len(sweep.pictures)} frames (first: {sweep.pictures[0].name}); capture at "
                                 f"least {LEAST_FRAMES}")
    return sweeps


def _projected(group: Sequence[ProjectedPicture], axis: str) -> Sweep:
    group = sorted(group, key=lambda picture: number_of(picture, "position", -1e6, 1e6))
    positions = np.array([number_of(picture, "position", -1e6, 1e6) for picture in group])
    same = np.flatnonzero(np.diff(positions) <= 0)
    if len(same):
        raise ScanstageError(f"frame {group[same[0] + 1].name}: its stripe is where that of frame {group[same[0]].name} is; leave one out")
    width = number_of(group[0], "width", 1e-3, 1e6)
    return Sweep(tuple(group), positions, width, axis, light_planes(group[0].projector, axis, positions))


def _laser(group: Sequence[ProjectedPicture]) -> Sweep:
    planes = np.array([picture.pattern["plane"] if "plane" in picture.pattern else _no_plane(picture) for picture in group], np.float64)
    # A plane and its reverse are the same; neighbours must not be, or a plane between the two would be nonsense.
    signs = np.cumprod(np.append(1, np.sign((planes[1:, :3] * planes[:-1, :3]).sum(axis=1)) + 0.0))
    if not signs.all():
        raise ScanstageError(f"frame {group[int(np.flatnonzero(signs == 0)[0])].name}: its laser turns by a right angle from one frame to "
                             f"the next; {AGAIN}")
    planes = planes * signs[:, None]
    steps = np.diff(planes, axis=0)
    back = (steps[1:] * steps[:-1]).sum(axis=1) < 0
    if back.any():
        raise ScanstageError(f"frame {group[int(np.argmax(back)) + 2].name}: its laser moves back against the sweep; {AGAIN}")
    width = number_of(group[0], "width", 1e-9, 1e9) if "width" in group[0].pattern else None
    return Sweep(tuple(group), np.arange(len(group), dtype=np.float64), width, None, planes)


def _no_plane(picture: ProjectedPicture) -> None:
    raise ScanstageError(f"frame {picture.name}: its laser has no plane; calibrate it and add the plane to the pattern")
