# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow carving: the visual hull, less what the shadows of an array of lights prove to be empty.

Silhouettes never show a concavity; the shadows that fall into it do (Savarese, Andreetto, Rushmeier, Bernardini & Perona,
"3D Reconstruction by Shadow Carving: Theory and Practical Evaluation", IJCV 71(3), 2007). `light_image` has the rule and
its proof.

Each round judges every view and light on the same volume and removes afterwards, so that their order plays no part. Rounds
repeat until nothing changes, since what one light has opened another may shine into; a later round follows the rays that
enter where the last one has removed something. A voxel goes only if all rays through it are free to beyond it: what is left
holds the object whole, which the next round relies on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import cv2
import numpy as np

from ...errors import ScanstageError
from ...options import Option, Value
from ...progress import Progress, part_of, silent
from ..arrays import grown, sorted_unique
from ..geometry import Camera, Light, VoxelGrid
from ..outcome import Outcome, VoxelLayer
from ..scan import LitPicture, Scan, View
from . import visual_hull as hull
from .light_image import free_depth, freed_points, wholly_free
from .octree import Counts
from .surface import Surface, extract_surface
from .virtual_light import SeenSurface, VirtualLight, distant
from .volume import SparseVolume

OPTIONS = (
    Option("shadow_rule", "strict", "When a ray of light is free behind its first hit", choices={
        "strict": "as long as its pixels lie in shadow and nothing but free rays is before it: proven to keep the object whole",
        "safe": "as long as its pixels lie in shadow, from a point that the camera sees: may cut an object with gaps that light "
                "shines through"}),
    Option("rounds", 8, "The most rounds over all views and lights; they end before when nothing more can be carved",
           minimum=1, maximum=100),
    *(option for option in hull.OPTIONS if option.name != "rule"),
)


_MOST_PICTURES = 8  # of virtual light images
_BESIDE = np.concatenate((np.eye(3, dtype=np.int32), -np.eye(3, dtype=np.int32)))
_AROUND = 2  # pixels about a shadow's in which an entry is looked for
_KERNEL = np.ones((2 * _AROUND + 1,) * 2, np.uint8)
_STEPS = 2
_PIXELS_PER_VOXEL = 3.0  # of a view: finer pictures are reduced, to save time
_SPACING = 0.75  # voxels between the points at which a ray looks for voxels to remove


def working_bounds(scan: Scan, *, tolerance: int, outside: str, **_: Value) -> np.ndarray:
    """Return the (2, 3) working volume: that of the hull."""
    return hull.working_bounds(scan, rule="conservative", tolerance=tolerance, outside=outside)


Removals = Iterator[tuple[int, str, np.ndarray]]
"""The number of a view, a light's id and the (n, 3) voxels that these two remove and no earlier ones did."""


def judge_views(volume: SparseVolume, views: Sequence[View], *, strict: bool, removed: np.ndarray | None, progress: Progress) -> Removals:
    """Yield what one round removes from a volume; ``removed`` (n, 3) is what the last round did."""
    yield from Sight.of(volume, strict=strict, removed=removed).removals(views, progress)


def shadow_carving(scan: Scan, grid: VoxelGrid, *, shadow_rule: str = "strict", rounds: int = 8, tolerance: int = 0,
                   outside: str = "unknown", carver: Callable[..., tuple[SparseVolume, Counts]] = hull.carve_silhouettes,
                   judge: Callable[..., Removals] = judge_views, progress: Progress = silent) -> Outcome:
    """Carve the visual hull of a scan, then what its shadows prove to be empty.

    Parameters
    ----------
    scan : Scan
        Every view with a mask; those with pictures under single lights also with their shadows.
    grid : VoxelGrid
    shadow_rule : {'strict', 'safe'}
    rounds : int
        The most rounds over all views and lights.
    tolerance, outside
        Of the hull, see `visual_hull.visual_hull`.
    carver, judge : callable
        Do what `visual_hull.carve_silhouettes` and `judge_views` do, elsewhere.

    Returns
    -------
    Outcome
        Its layer ``carved`` holds the voxels that shadows removed: the ``view`` and the ``light`` whose shadow was the
        first to (numbers in the report's lists ``carved_by``), and in which ``round``. Its pictures are the virtual light
        images of the first view.

    Raises
    ------
    ScanstageError
        The capture has no frames under single lights, a light is never on, stands in or too near the hull or is of a kind
        that cannot be used, or no shadow is seen.
    """
    check_lights(scan)
    found = hull.visual_hull(scan, grid, rule="conservative", tolerance=tolerance, outside=outside, carver=carver,
                            progress=part_of(progress, 0, 0.1))
    lights = list(dict.fromkeys(lit.light_id for view in scan.views for lit in view.lit))
    volume, done, pictures = found.volume, [], {}
    for number in range(rounds):
        share = 0.1 + 0.9 * (1 - 0.5 ** number)  # most is done in the first rounds, and how many there will be is not known
        what = {"strict": shadow_rule == "strict", "removed": done[-1].voxels if done else None}
        removals = list(judge(volume, scan.views, **what, progress=part_of(progress, share, (share + 1) / 2)))
        done.append(_layer(removals, number, lights))
        pictures = pictures or Sight.of(volume, **what).pictures(scan.views)
        volume = volume.without(done[-1].voxels)
        if not len(done[-1].voxels):
            break
    carved = VoxelLayer(np.concatenate([part.voxels for part in done]),
                        {name: np.concatenate([part.values[name] for part in done]) for name in done[0].values})
    counts = {**found.report["counts"], "hull": found.volume.count(), "carved": len(carved.voxels), "rounds": len(done)}
    progress(1.0, "Carved by shadows")
    return Outcome(volume, {"counts": counts, "carved_by": {"views": [view.name for view in scan.views], "lights": lights},
                            "warnings": found.report["warnings"] + _warnings(scan)}, layers={"carved": carved}, pictures=pictures)


def check_lights(scan: Scan) -> None:
    """Refuse a scan whose lights cannot be used, in one sentence.

    Raises
    ------
    ScanstageError
        See `shadow_carving`.
    """
    lit = [(view, picture) for view in scan.views for picture in view.lit]
    if scan.unused_lights:
        raise ScanstageError(f"{scan.unused_lights[0]}: is on in no frame; capture frames under it alone, or remove it from devices.lights")
    if not lit:
        raise ScanstageError("the capture has no frame that a single light lights alone: shadow carving needs, for each pose, one under "
                             "each light of an array and one under all, as the rig shadow-array takes them")
    for view, picture in lit:
        if picture.light.kind not in ("point", "sun"):
            raise ScanstageError(f"{picture.light_id}: is a {picture.light.kind} light, and the edge of its cone would be taken for a "
                                 "shadow; use a point light")
        if view.shadows is None:
            raise ScanstageError(f"frame {view.name} has no shadow masks: find them with detect_shadows first")
    if not any(view.shadows.bits.any() for view, _ in lit):
        raise ScanstageError("no shadow is seen in any frame: the lights stand behind the camera or too near its axis, or --set "
                             "shadow_ratio or lit_level leaves none; spread the lights 20 to 45 degrees about the camera")


def _warnings(scan: Scan) -> list[str]:
    """Return what a user should know about the lights, one sentence each."""
    lit = [view for view in scan.views if view.lit]
    warnings = []
    if len(lit) < len(scan.views):
        without = next(view.name for view in scan.views if not view.lit)
        warnings.append(f"{len(scan.views) - len(lit)} of {len(scan.views)} views have no frame under a single light (first: {without}): "
                        "they give a silhouette only")
    seen = {picture.light_id: False for view in lit for picture in view.lit}
    for view in lit:
        for number, picture in enumerate(view.lit):
            seen[picture.light_id] |= bool(view.shadows.of(number).any())
    if dark := [light for light, some in seen.items() if not some]:
        warnings.append(f"{', '.join(dark)}: no frame shows a shadow of it; it stands too near the camera's axis, or other light reaches "
                        "its shadows")
    return warnings


@dataclass(frozen=True)
class Sight:
    """A volume as cameras and lights see it for one round.

    Parameters
    ----------
    volume : SparseVolume
    surface : Surface
        Of the volume.
    centres : (s, 3) array
        Of the surface voxels.
    entries : (e,) int array
        The surface voxels at which rays of light are looked at: all at first, later those that the last round has exposed.
    box : (2, 3) array
        Round the volume, in the object frame.
    strict : bool
    """

    volume: SparseVolume
    surface: Surface
    centres: np.ndarray
    entries: np.ndarray
    box: np.ndarray
    strict: bool

    @classmethod
    def of(cls, volume: SparseVolume, *, strict: bool, removed: np.ndarray | None = None) -> Sight:
        """Look at a volume, from which the voxels ``removed`` (n, 3) are gone since the last round."""
        grid = volume.grid
        surface = extract_surface(volume)
        entries = np.arange(len(surface.voxels))
        if removed is not None:
            beside = np.concatenate([_flat(removed + step, grid) for step in _BESIDE])
            entries = np.flatnonzero(np.isin(_flat(surface.voxels, grid), beside))
        return cls(volume, surface, grid.centres(surface.voxels), entries, _box(volume), strict)

    def removals(self, views: Sequence[View], progress: Progress) -> Removals:
        """Yield what each view and light removes that no earlier ones did."""
        remaining = self.volume
        for number, view in enumerate(views):
            progress(number / len(views), f"Carving by the shadows of frame {view.name}")
            for light_id, light, lit, free in self.free_depths(view):
                voxels = _free_voxels(remaining, free, light, lit)
                remaining = remaining.without(voxels)
                yield number, light_id, voxels

    def free_depths(self, view: View) -> Iterator[tuple[str, VirtualLight, SeenSurface, np.ndarray]]:
        """Yield each light of a view whose rays enter where the camera sees its shadow, what it sees, and how far its rays are free."""
        if not view.lit:
            return
        grid, step = self.volume.grid, self._coarseness(view)
        camera, shadows = view.camera.scaled(1 / step), view.shadows.reduced(step)
        entries, pixels, depth = self._entries_in(camera)
        if not grown(shadows.bits != 0, _AROUND).take(pixels).any():
            return  # before the surface is rendered: in later rounds most views end here
        seen = SeenSurface.of(self.surface, grid, camera)
        # A light may meet a step of the voxels' stairs that the camera does not see.
        farthest = cv2.dilate(np.where(np.isfinite(seen.depth), seen.depth, 0), _KERNEL).take(pixels)
        near = depth <= farthest + _STEPS * grid.voxel_size
        for number, picture in enumerate(view.lit):
            shadow = shadows.of(number) & (seen.items >= 0)
            here = entries[near & grown(shadow, _AROUND).take(pixels)]
            if len(here):
                centres = self.centres.take(here, axis=0)
                light = self.virtual(picture).at(centres)
                lit = SeenSurface.about(self.surface, grid, light, centres)
                yield picture.light_id, light, lit, free_depth(seen, lit, shadow, here, grid.voxel_size, strict=self.strict)

    def virtual(self, picture: LitPicture) -> VirtualLight:
        """Return the light of a picture as it looks at all of the volume."""
        position = _position(picture.light, self.box)
        return _virtual_light(tuple(position), tuple(self.box.ravel()), self.volume.grid.voxel_size, picture.light_id)

    def _entries_in(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the entries that lie in a camera's picture, rows of the surface's voxels, their flat pixels and their depths."""
        width, height = camera.size
        pixels, depth = camera.project(self.centres.take(self.entries, axis=0))
        column, row = np.rint(np.nan_to_num(pixels, nan=-1.0)).T
        inside = np.flatnonzero((depth > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height))
        return self.entries[inside], (row * width + column)[inside].astype(np.intp), depth[inside]

    def _coarseness(self, view: View) -> int:
        """Return how many pixels of a view's picture, along a side, are taken as one that keeps about `_PIXELS_PER_VOXEL`."""
        depth = float((self.box.mean(axis=0) - view.camera.centre) @ view.camera.forward)
        if depth <= 0:
            return 1
        return max(1, int(min(view.camera.K[0, 0], view.camera.K[1, 1]) * self.volume.grid.voxel_size / depth / _PIXELS_PER_VOXEL))

    def pictures(self, views: Sequence[View]) -> dict[str, np.ndarray]:
        """Return the virtual light images of the first view with lights, to be looked at."""
        view = next(view for view in views if view.lit)
        lights = {picture.light_id: self.virtual(picture).camera for picture in view.lit}
        found = {}
        for light_id, light, lit, free in islice(self.free_depths(view), _MOST_PICTURES):
            seen = SeenSurface.of(self.surface, self.volume.grid, lights[light_id])
            freed, (column, row) = np.zeros(seen.depth.shape, bool), np.rint((lights[light_id].K - light.camera.K)[:2, 2]).astype(int)
            freed[row:, column:][:free.shape[0], :free.shape[1]] = free > lit.depth
            found[f"light-image-{light_id}"] = _picture(seen.depth, freed)
        return found


def _flat(voxels: np.ndarray, grid: VoxelGrid) -> np.ndarray:
    """Return flat indices of (n, 3) voxels, which may lie one voxel beyond the grid."""
    _, ny, nz = grid.shape
    x, y, z = voxels.astype(np.int64).T
    return ((x + 1) * (ny + 2) + y + 1) * (nz + 2) + z + 1


def _box(volume: SparseVolume) -> np.ndarray:
    """Return the (2, 3) corners of the least box round a volume, in the object frame."""
    lower, upper = volume.bounds()
    return volume.grid.origin + volume.grid.voxel_size * np.stack((lower, upper + 1))


@lru_cache(maxsize=4096)
def _virtual_light(position: tuple[float, ...], box: tuple[float, ...], voxel_size: float, name: str) -> VirtualLight:
    """Return `VirtualLight.of` the same: from round to round the box hardly ever changes."""
    return VirtualLight.of(np.array(position), np.reshape(box, (2, 3)), voxel_size, name)


def _position(light: Light, box: np.ndarray) -> np.ndarray:
    return distant(light.direction, box) if light.kind == "sun" else light.position


def _free_voxels(volume: SparseVolume, free: np.ndarray, light: VirtualLight, lit: SeenSurface) -> np.ndarray:
    """Return the (n, 3) voxels of a volume that lie in the part of a light's rays that is free, whole."""
    grid = volume.grid
    points = freed_points(free, lit, _SPACING * grid.voxel_size)
    voxels = np.floor((points - grid.origin[:, None]) / grid.voxel_size).astype(np.int64)
    voxels = voxels[:, ((voxels >= 0) & (voxels < np.array(grid.shape)[:, None])).all(axis=0)]
    flat = sorted_unique(np.ravel_multi_index(tuple(voxels), grid.shape))
    voxels = np.column_stack(np.unravel_index(flat, grid.shape))
    voxels = voxels[volume.contains(voxels)]
    return voxels[wholly_free(free, light, grid.centres(voxels))]


def _layer(removals: Sequence[tuple[int, str, np.ndarray]], number: int, lights: Sequence[str]) -> VoxelLayer:
    """Return what one round removed, and who did."""
    count = [len(voxels) for _, _, voxels in removals]
    voxels = np.concatenate([np.zeros((0, 3), np.int32), *(voxels.astype(np.int32) for _, _, voxels in removals)])
    return VoxelLayer(voxels, {"view": np.repeat([view for view, _, _ in removals], count).astype(np.uint16),
                               "light": np.repeat([lights.index(light) for _, light, _ in removals], count).astype(np.uint16),
                               "round": np.full(len(voxels), number, np.uint16)})


def _picture(depth: np.ndarray, freed: np.ndarray) -> np.ndarray:
    """Return a virtual light image to be looked at: near is bright, and orange where the shadow shows rays to be free."""
    seen = np.isfinite(depth)
    near, far = (float(depth[seen].min()), float(depth[seen].max())) if seen.any() else (0.0, 1.0)
    grey = np.where(seen, 230 - 170 * (np.where(seen, depth, near) - near) / max(far - near, 1e-12), 20)
    picture = np.repeat(grey[..., None], 3, axis=2)
    picture[seen & freed] *= (1.0, 0.55, 0.15)
    return picture.astype(np.uint8)
