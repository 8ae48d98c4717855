# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What workers do with volumes. Each keeps what it has unpacked for its next task: masks of one hull, a volume of one round."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from addon.progress import silent
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.volumetric.octree import Counts, carve
from addon.reconstruction.volumetric.shadow_carving import Sight
from addon.reconstruction.volumetric.silhouette_test import SilhouetteTest
from addon.reconstruction.volumetric.visual_hull import silhouette_tests

from .packing import Packed, PackedSilhouettes, PackedView, PackedVolume

_kept: dict[str, tuple[str, object]] = {}  # by kind, what the last task of that kind has made, under the name of its job


@dataclass(frozen=True)
class HullJob:
    """All that the bricks of one hull have in common.

    Parameters
    ----------
    name : str
        No other job has it.
    silhouettes : PackedSilhouettes
    grid : VoxelGrid
        Of the whole.
    rule, outside : str
    tolerance : int
        As `visual_hull` takes them.
    """

    name: str
    silhouettes: PackedSilhouettes
    grid: VoxelGrid
    rule: str
    outside: str
    tolerance: int

    def tests(self) -> list[SilhouetteTest]:
        """Return what classifies cells of the whole grid."""
        return silhouette_tests(self.silhouettes.silhouettes(), self.grid, rule=self.rule, outside=self.outside)


@dataclass(frozen=True)
class Round:
    """One round of shadow carving.

    Parameters
    ----------
    name : str
        No other round has it.
    volume : PackedVolume
    removed : Packed, optional
        What the last round has removed.
    strict : bool
    """

    name: str
    volume: PackedVolume
    removed: Packed | None
    strict: bool

    def sight(self) -> Sight:
        """Return the volume as cameras and lights see it."""
        return Sight.of(self.volume.volume(), strict=self.strict, removed=None if self.removed is None else self.removed.array())


def carve_brick(job: HullJob, brick: np.ndarray) -> tuple[PackedVolume, Counts]:
    """Carve one brick of a hull."""
    volume, counts = carve(_keep("tests", job.name, job.tests), job.grid, tolerance=job.tolerance, brick=brick)
    return PackedVolume.of(volume), counts


def judge_view(job: Round, view: PackedView) -> list[tuple[str, Packed]]:
    """Return for each light of a view the voxels of the round's volume that its shadows remove, less those of the lights before it."""
    sight = _keep("sight", job.name, job.sight)
    return [(light, Packed.of(voxels.astype(np.int32))) for _, light, voxels in sight.removals([view.unpacked()], silent)]


def forget() -> None:
    """Let go of what is kept."""
    _kept.clear()


def _keep(kind: str, name: str, make: Callable[[], object]) -> object:
    if _kept.get(kind, ("",))[0] != name:
        _kept.pop(kind, None)  # before the next is made: a worker has room for one
        _kept[kind] = name, make()
    return _kept[kind][1]
