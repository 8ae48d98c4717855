# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of shadow carving, for scripts/figures.py: what the shadows of an array of lights take off the visual hull.

Excess and loss are volumes as shares of the truth's. A conservative volume has an excess even where it is perfect, see
`addon.reconstruction.evaluation.measures.volume_measures`.
"""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

from session import told
from tables import print_head, print_line
from turntable_captures import paint_a_patch, rendered, thinned, under_fewer_lights

OBJECT, PIT = "dented-sphere", "pot"
ELEVATION = "25"  # degrees
MOST = {"strict": 0.65, "safe": 0.60}  # of the hull's excess, at 24 x 4
MOST_OF_ALL = 0.40  # at 72 x 8
VOXELS, LECTURE_VOXELS, PIT_VOXELS, SMALL_VOXELS = 256, 192, 128, 96
LECTURE = ((4, 4), (8, 4), (16, 4), (24, 1), (24, 4), (24, 8), (72, 8))  # views, lights
VIEWS, LIGHTS = 72, 8  # rendered once; fewer are taken out of them
FINE_VOXELS, FINE_RADIUS = 640, 0.3922  # a voxel goes only whole, and wide lights throw longer shadows: metres, 42 degrees off the axis
FINE_SHADOWS = {"shadow_margin": 0}  # rendered pixels are not blurred
PIT_ELEVATIONS = ("25", "45", "60", "25,60")
PIT_VIEWS, PIT_LIGHTS = 16, 4
SMALL = {"views": 12, "lights": 4, "elevations": ELEVATION, "resolution_x": 320, "resolution_y": 240}
MISPLACED = 0.01  # of a light's distance
LAMP = 0.01  # metres


@dataclass(frozen=True)
class Carved:
    """A hull and what shadows left of it, measured.

    Parameters
    ----------
    hull, volume : SparseVolume
    hull_excess, excess, loss : float
    removed : int
        Voxels that lie wholly inside the truth and are gone.
    seconds : float
        Hull and carving.
    """

    hull: object
    volume: object
    hull_excess: float
    excess: float
    loss: float
    removed: int
    seconds: float

    @property
    def ratio(self):
        """The excess that is left, as a share of the hull's."""
        return self.excess / self.hull_excess

    @classmethod
    def of(cls, scan, truth, voxels, progress, **options):
        """Carve a scan, whose shadows are found, and compare hull and result with the truth."""
        from addon.reconstruction.evaluation.measures import volume_measures
        from addon.reconstruction.geometry import VoxelGrid
        from addon.reconstruction.volumetric.shadow_carving import shadow_carving, working_bounds
        from addon.reconstruction.volumetric.visual_hull import visual_hull

        grid = VoxelGrid.from_bounds(*working_bounds(scan, tolerance=0, outside="unknown"), voxels)
        hull = visual_hull(scan, grid, rule="conservative").volume
        start = time.perf_counter()
        volume = shadow_carving(scan, grid, progress=progress, **options).volume
        seconds, measures = time.perf_counter() - start, volume_measures(volume, truth)
        return cls(hull, volume, volume_measures(hull, truth)["excess"], measures["excess"], measures["loss"],
                   measures["truth_voxels_removed"], seconds)


def dents(bar):
    """Print what is left of the dented sphere's excess at 24 views and 4 lights, by both rules; return what is missed."""
    print_head("picture", "rule", "hull excess", "carved excess", "ratio", "at most", "truth_voxels_removed", "loss", "seconds")
    missed = 0
    for width, height in ((640, 480), (1280, 960)):
        scan, truth = in_passing(OBJECT, told(bar, "dents"), {"views": 24, "lights": 4, "elevations": ELEVATION,
                                                              "resolution_x": width, "resolution_y": height})
        for rule, most in MOST.items():
            found = Carved.of(scan, truth, VOXELS, told(bar, "dents"), shadow_rule=rule)
            bar.close()
            print_line(f"{width}x{height}", rule, found.hull_excess, found.excess, found.ratio, most, found.removed, found.loss,
                       found.seconds)
            missed += (found.ratio > most) + (found.removed > 0)
    return missed


def lecture(bar):
    """Print the lecture's table; return what is missed."""
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        found = dict(lecture_rows(Path(folder), told(bar, "lecture"), LECTURE))
    bar.close()
    print_head("views x lights", "hull excess", "carved excess", "ratio", "truth_voxels_removed", "loss", "seconds")
    for (views, lights), row in found.items():
        print_line(f"{views} x {lights}", row.hull_excess, row.excess, row.ratio, row.removed, row.loss, row.seconds)
    falling = all(found[many].excess < found[few].excess for few, many in zip(LECTURE, LECTURE[1:], strict=False) if few != (16, 4))
    missed = sum(row.removed > 0 for row in found.values()) + (not falling)
    print(f"\nfalling with views and with lights: {'yes' if falling else 'no'}; {VIEWS} x {LIGHTS}: {found[VIEWS, LIGHTS].ratio:.3f} "
          f"of the hull's excess (at most {MOST_OF_ALL} in finer voxels: the table lecture-fine)")
    return missed


def finest(bar):
    """Print what is left at 72 views and 8 lights of large pictures and fine voxels: half an hour; return what is missed."""
    scan, truth = in_passing(OBJECT, told(bar, "lecture-fine"), {
        "views": VIEWS, "lights": LIGHTS, "elevations": ELEVATION, "resolution_x": 1280, "resolution_y": 960, "array_radius": FINE_RADIUS},
        shadow_options=FINE_SHADOWS)
    found = Carved.of(scan, truth, FINE_VOXELS, told(bar, "lecture-fine"), rounds=20)
    bar.close()
    print_head("views x lights", "hull excess", "carved excess", "ratio", "at most", "truth_voxels_removed", "loss", "seconds")
    print_line(f"{VIEWS} x {LIGHTS}", found.hull_excess, found.excess, found.ratio, MOST_OF_ALL, found.removed, found.loss, found.seconds)
    return (found.ratio > MOST_OF_ALL) + (found.removed > 0)


def lecture_rows(folder, progress, pairs, voxels=LECTURE_VOXELS):
    """Yield each pair of numbers, of views and lights, and what they carve of the dented sphere.

    Views and lights are taken out of one capture, kept in ``folder``; 16 views, which are not among its 72, have their own.
    """
    captures = {}
    for views, lights in pairs:
        poses, lamps = (VIEWS, LIGHTS) if VIEWS % views == 0 else (views, lights)
        if poses not in captures:
            captures[poses] = rendered(OBJECT, folder / f"{OBJECT}-{poses}-{lamps}", progress, poses, "shadow-array",
                                       {"lights": lamps, "elevations": ELEVATION}, shadow_options={})
        scan, truth = captures[poses]
        yield (views, lights), Carved.of(under_fewer_lights(thinned(scan, views), lights), truth, voxels, progress)


def pit(bar):
    """Print how far the pot's pit is opened from several heights; return how often it lost voxels of the truth."""
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        found = dict(pit_rows(Path(folder), told(bar, "pit")))
    bar.close()
    print_head("camera elevation", "views x lights", "hull excess", "carved excess", "ratio", "pit, mm", "open in the hull, mm",
               "open after carving, mm", "truth_voxels_removed", "loss")
    for elevations, (truth, row) in found.items():
        views = PIT_VIEWS * len(elevations.split(","))
        print_line(elevations, f"{views} x {PIT_LIGHTS}", row.hull_excess, row.excess, row.ratio, *pit_depths(truth, row), row.removed,
                   row.loss)
    return sum(row.removed > 0 for _, row in found.values())


def pit_rows(folder, progress, voxels=PIT_VOXELS):
    """Yield the elevations of the cameras, and the truth and what is carved of the pot from there; captures stay in ``folder``."""
    for elevations in PIT_ELEVATIONS:
        scan, truth = rendered(PIT, folder / f"{PIT}-{elevations.replace(',', '-')}", progress, PIT_VIEWS, "shadow-array",
                               {"lights": PIT_LIGHTS, "elevations": elevations}, shadow_options={})
        yield elevations, (truth, Carved.of(scan, truth, voxels, progress))


def pit_depths(truth, row):
    """Return how deep the pot's pit is on its axis, how deep the hull is there, and the carved volume, in mm below the mouth.

    What floats above the pit, cut off from its floor, does not close it.
    """
    import numpy as np

    from addon.reconstruction.evaluation.voxelization import inside

    grid, depths = row.hull.grid, []
    heights = np.arange(grid.shape[2])
    axis = np.column_stack((*np.repeat(np.floor(-grid.origin[:2] / grid.voxel_size).astype(int)[:, None], len(heights), axis=1), heights))
    floor = heights[inside(truth, grid).contains(axis)].max()
    for volume in (inside(truth, grid), row.hull, row.volume):
        top = floor + np.append(volume.contains(axis[floor:]), False).argmin()  # of the run that begins on the floor
        depths.append(1000 * max(0.0, truth.bounds()[1, 2] - float(grid.origin[2] + grid.voxel_size * top)))
    return depths


def adversities(bar):
    """Print what becomes of a small scan whose shadows, paint or lights are not as they should be; return what is missed."""
    progress = told(bar, "adversities")
    plain, truth = in_passing(OBJECT, progress, SMALL)
    scans = {"none": plain, "half of the shadow pixels dropped": half_dropped(plain),
             "dark patch, albedo 0.02": in_passing(OBJECT, progress, SMALL, paint_a_patch)[0],
             "shiny": in_passing(OBJECT, progress, SMALL, glaze)[0],
             f"lights wrong by {MISPLACED:.0%} of their distance": with_lights_moved(plain),
             f"lamps of radius {100 * LAMP:g} cm": in_passing(OBJECT, progress, {**SMALL, "light_size": LAMP})[0]}
    print_head("adversity", "rule", "hull excess", "carved excess", "ratio", "truth_voxels_removed", "loss")
    missed, full = 0, {}
    for name, scan in scans.items():
        for rule in MOST:
            found = Carved.of(scan, truth, SMALL_VOXELS, progress, shadow_rule=rule)
            bar.close()
            print_line(name, rule, found.hull_excess, found.excess, found.ratio, found.removed, found.loss)
            full.setdefault(rule, found.excess)
            promised = name.startswith(("none", "half", "dark"))
            missed += promised and not (found.removed == 0 and full[rule] <= found.excess <= found.hull_excess)
    return missed


def half_dropped(scan):
    """Return a scan whose pixels of shadow are each dropped by a coin."""
    import numpy as np

    random = np.random.default_rng(1)
    every = np.iinfo(scan.views[0].shadows.bits.dtype).max
    return replace(scan, views=tuple(replace(view, shadows=replace(view.shadows, bits=view.shadows.bits & random.integers(
        0, every, view.shadows.bits.shape, view.shadows.bits.dtype, endpoint=True))) for view in scan.views))


def with_lights_moved(scan):
    """Return a scan whose lights are each said to be some way off where they are, always in the same direction from the camera."""
    import numpy as np

    random, offsets = np.random.default_rng(1), {}

    def moved(view, picture):
        light = picture.light
        if picture.light_id not in offsets:
            way = random.standard_normal(3)
            offsets[picture.light_id] = MISPLACED * np.linalg.norm(light.position) * way / np.linalg.norm(way)
        return replace(picture, light=replace(light, position=light.position + view.camera.R.T @ offsets[picture.light_id]))

    return replace(scan, views=tuple(replace(view, lit=tuple(moved(view, picture) for picture in view.lit)) for view in scan.views))


def glaze(scene):
    """Give what is staged a shiny material."""
    from addon.stage.materials import textured
    from addon.stage.objects import BUILTINS

    for layer in scene.view_layers:
        layer.material_override = textured("shiny", BUILTINS[OBJECT].texture, shiny=True)


def in_passing(name, progress, options, change=None, shadow_options=None):
    """Return the scan of a capture that is not kept, with its shadows, and the truth. Pictures can be read no more."""
    with tempfile.TemporaryDirectory(prefix="scanstage-") as folder:
        scan, truth = rendered(name, Path(folder), progress, options["views"], "shadow-array", options, shadow_options=shadow_options or {},
                               change=change)
    return scan, truth


TABLES = {"dents": dents, "lecture": lecture, "lecture-fine": finest, "pit": pit, "adversities": adversities}
