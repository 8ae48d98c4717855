# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes over workers: what `visual_hull.carve_silhouettes` and `shadow_carving.judge_views` do, with the same results to the bit.

A hull is carved by bricks: cells of the octree know nothing of each other, and their indices are those of the whole grid. In a round of
shadow carving every view is judged on the same volume; what an earlier view has removed is taken from a later one's afterwards, in
the order of home. Shadows look through the whole volume, so that here every worker holds all of its surface.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing

import numpy as np

from addon.progress import Progress, silent
from addon.reconstruction.geometry import VoxelGrid
from addon.reconstruction.scan import View
from addon.reconstruction.volumetric.bounds import Silhouette
from addon.reconstruction.volumetric.octree import Counts, bricks_of
from addon.reconstruction.volumetric.volume import SparseVolume

from .connection import Connection
from .packing import Packed, PackedSilhouettes, PackedView, PackedVolume
from .tasks import HullJob, Round, carve_brick, judge_view

BRICK_EDGE = 512  # voxels; less, and the masks' preparation is not worth it


class Volumes:
    """Carves on workers.

    Parameters
    ----------
    connection : Connection
    edge : int
        Voxels along a brick.
    """

    def __init__(self, connection: Connection, edge: int = BRICK_EDGE) -> None:
        self._connection, self._edge = connection, edge
        self._views: tuple[Sequence[View], list] = ((), [])

    def carver(self, silhouettes: Sequence[Silhouette], grid: VoxelGrid, *, rule: str, tolerance: int, outside: str,
               progress: Progress = silent) -> tuple[SparseVolume, Counts]:
        """Carve a grid by silhouettes, brick by brick. See `visual_hull.carve_silhouettes`."""
        progress(0.0, "Sending the silhouettes to the workers")
        job, = self._connection.send([HullJob(uuid.uuid4().hex, PackedSilhouettes.of(silhouettes), grid, rule, outside, tolerance)])
        bricks, counts = bricks_of(grid, self._edge), Counts(alone=np.zeros(len(silhouettes), int))
        parts = {}
        for number, (packed, found) in self._gathered(carve_brick, [(job, brick) for brick in bricks], "Carving bricks", progress):
            parts[number] = packed
            counts.add(found)
        return SparseVolume.joined(grid, ((brick[0], parts.pop(number).volume()) for number, brick in enumerate(bricks))), counts

    def judge(self, volume: SparseVolume, views: Sequence[View], *, strict: bool, removed: np.ndarray | None,
              progress: Progress) -> Iterator[tuple[int, str, np.ndarray]]:
        """Yield what one round removes. See `shadow_carving.judge_views`."""
        if self._views[0] is not views:
            self._views = views, self._connection.send([PackedView.of(view) for view in views if view.lit])
        numbers, sent = [number for number, view in enumerate(views) if view.lit], self._views[1]
        gone = None if removed is None else Packed.of(removed)
        job, = self._connection.send([Round(uuid.uuid4().hex, PackedVolume.of(volume), gone, strict)])
        answers = dict(self._gathered(judge_view, [(job, view) for view in sent], "Carving by shadows", progress))
        for task, number in enumerate(numbers):
            for light, packed in answers.pop(task):
                voxels = packed.array()
                voxels = voxels[volume.contains(voxels)]
                volume = volume.without(voxels)
                yield number, light, voxels

    def _gathered(self, function: Callable, tasks: list[tuple], message: str, progress: Progress) -> Iterator[tuple[int, object]]:
        done = 0
        with closing(self._connection.results(function, tasks)) as answers:
            for answer in answers:
                progress(done / len(tasks), message)  # may raise Cancelled
                if answer is not None:
                    done += 1
                    yield answer
