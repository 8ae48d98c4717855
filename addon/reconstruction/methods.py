# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of methods, and the one way to run them.

Panels, the command line, the tests and the manual all read `METHODS`. A new method is one file and one line here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from ..errors import ScanstageError
from ..memory import MemoryUse, amount, peak_memory
from ..options import Option, Value, resolve
from ..progress import Progress, part_of, silent
from .active import color_stripes, desk_shadow, laser_stripe, speckle, stereo, structured_light
from .active.measurement import measured_bounds, points_to_voxels
from .forecast import (
    Forecast,
    MemoryOf,
    hull_memory,
    measuring_memory,
    probability_memory,
    sight_memory,
    sweep_memory,
)
from .geometry import VoxelGrid
from .mesh import TriangleMesh
from .outcome import Outcome, VoxelLayer
from .points import PointCloud
from .scan import Scan
from .volumetric import (
    generalized_voxel_coloring,
    photo_hull,
    polyhedral_hull,
    probabilistic_carving,
    shadow_carving,
    space_carving,
    space_sweep,
    visual_hull,
    voxel_coloring,
)
from .volumetric.coloring import SurfaceColors, color_surface
from .volumetric.item_buffer import reprojection_iou
from .volumetric.polyhedral_hull import Solids
from .volumetric.surface import Surface, extract_surface
from .volumetric.suspects import suspicion
from .volumetric.volume import SparseVolume

DEFAULT_VOXELS = 128
COMMON_COUNTS = ("views", "occupied", "surface", "quads", "unseen")
"""What the report of every method counts; a method adds counts of its own."""
_CUBE = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
_LARGEST_GRID = 1 << 14  # voxels a side: half-voxel coordinates stay exact in the octree's sums
_LARGEST_NUMBER = 1e9  # of a bound, and one over the least size of a voxel: beyond, squares and products lose their meaning


@dataclass(frozen=True)
class Method:
    """One reconstruction method.

    Parameters
    ----------
    name, label, description : str
    needs : tuple of {'silhouettes', 'colour', 'lights', 'patterns'}
        What a capture must hold: silhouettes; colours; pictures under single lights; pictures under projected patterns.
    options : tuple of Option
    function : callable
        ``function(scan, grid, *, progress, **options) -> Outcome``.
    bounds : callable
        ``bounds(scan, **options) -> (2, 3) array``: the working volume where the user gives none.
    memory : callable
        See `forecast.MemoryOf`.
    cuts_solids : bool
        Whether the function takes ``solids``, a solver that only Blender has.
    measure : callable, optional
        ``measure(scan, *, progress, **options)``: what the method finds before there is a working volume. ``function`` and
        ``bounds`` then take it as ``measured``.
    spread : tuple of str
        The arguments of ``function`` that are functions which other machines can take over. See `reconstruct`.
    """

    name: str
    label: str
    description: str
    needs: tuple[str, ...]
    options: tuple[Option, ...]
    function: Callable[..., Outcome]
    bounds: Callable[..., np.ndarray]
    memory: MemoryOf
    cuts_solids: bool = False
    measure: Callable[..., object] | None = None
    spread: tuple[str, ...] = ()


METHODS = {method.name: method for method in (
    Method("visual-hull", "Visual Hull", "The largest shape with the captured silhouettes, carved by an octree",
           ("silhouettes",), visual_hull.OPTIONS, visual_hull.visual_hull, visual_hull.working_bounds, hull_memory, spread=("carver",)),
    Method("shadow-carving", "Shadow Carving", "The visual hull, less the hollows that the shadows of an array of lights show to be empty",
           ("silhouettes", "lights"), shadow_carving.OPTIONS, shadow_carving.shadow_carving, shadow_carving.working_bounds,
           hull_memory, spread=("carver", "judge")),
    Method("polyhedral-hull", "Polyhedral Hull", "The visual hull as a polyhedron, exact for the silhouettes' outlines",
           ("silhouettes",), polyhedral_hull.OPTIONS, polyhedral_hull.polyhedral_hull, polyhedral_hull.working_bounds,
           hull_memory, cuts_solids=True),
    Method("voxel-coloring", "Voxel Coloring", "What the views agree on, in one pass from near to far; all cameras on one side",
           ("silhouettes", "colour"), voxel_coloring.OPTIONS, voxel_coloring.voxel_coloring, photo_hull.photo_bounds,
           sweep_memory),
    Method("space-carving", "Space Carving", "What the views agree on, by planes that sweep in six directions until nothing changes",
           ("silhouettes", "colour"), space_carving.OPTIONS, space_carving.space_carving, photo_hull.photo_bounds,
           sight_memory),
    Method("generalized-voxel-coloring", "Generalized Voxel Coloring", "What the views agree on, with exact visibility for any cameras",
           ("silhouettes", "colour"), generalized_voxel_coloring.OPTIONS, generalized_voxel_coloring.generalized_voxel_coloring,
           photo_hull.photo_bounds, sight_memory),
    Method("probabilistic-carving", "Probabilistic Carving", "How probable each voxel is, given what all pictures show and what hides what",
           ("silhouettes", "colour"), probabilistic_carving.OPTIONS, probabilistic_carving.probabilistic_carving,
           probabilistic_carving.probabilistic_bounds, probability_memory),
    Method("space-sweep", "Space Sweep", "Points that edges of many pictures vote for, as a plane sweeps through the working volume",
           ("silhouettes", "colour"), space_sweep.OPTIONS, space_sweep.space_sweep, photo_hull.photo_bounds, sweep_memory),
    Method("gray-code", "Gray Code", "Points where the camera sees a projector's Gray code, to a column",
           ("patterns",), structured_light.GRAY_OPTIONS, points_to_voxels, measured_bounds, measuring_memory,
           measure=structured_light.measure_gray_code),
    Method("phase-shift", "Phase Shift", "Points where the camera sees a projector's sinusoids, to a small part of a column",
           ("patterns",), structured_light.PHASE_OPTIONS, points_to_voxels, measured_bounds, measuring_memory,
           measure=structured_light.measure_phase_shift),
    Method("color-stripes", "Color Stripes", "Points where the camera sees edges of coloured stripes, all projected at once",
           ("patterns",), color_stripes.OPTIONS, points_to_voxels, measured_bounds, measuring_memory,
           measure=color_stripes.measure_color_stripes),
    Method("laser-stripe", "Laser Stripe", "Points where the camera sees a stripe, or a point, of light that sweeps over the object",
           ("patterns",), laser_stripe.OPTIONS, points_to_voxels, measured_bounds, measuring_memory,
           measure=laser_stripe.measure_laser_stripe),
    Method("stereo", "Stereo", "Points whose texture two neighbouring views show alike, without a projector",
           ("silhouettes", "colour"), stereo.OPTIONS, points_to_voxels, measured_bounds, measuring_memory,
           measure=stereo.measure_stereo),
    Method("speckle", "Speckle", "Depth maps from one picture of a projector's pseudo-random dots each, as a depth sensor takes them",
           ("patterns",), speckle.OPTIONS, points_to_voxels, measured_bounds, measuring_memory,
           measure=speckle.measure_speckle),
    Method("desk-shadow", "Desk Shadow", "Points where the shadow of a stick, swept over an object on a desk, is seen to arrive",
           ("patterns",), desk_shadow.OPTIONS, points_to_voxels, measured_bounds, measuring_memory,
           measure=desk_shadow.measure_desk_shadow),
)}


@dataclass(frozen=True)
class Reconstruction:
    """What running a method gives.

    Parameters
    ----------
    volume : SparseVolume
    surface : Surface
        The volume's exposed faces.
    colors : SurfaceColors
        One colour a surface voxel.
    report : dict
        Plain JSON values: method, options, grid, counts, seconds, peak memory, warnings.
    layers, pictures : mapping
    mesh : TriangleMesh, optional
        As in `Outcome`.
    points : PointCloud, optional
        As in `Outcome`.
    """

    volume: SparseVolume
    surface: Surface
    colors: SurfaceColors
    report: dict
    layers: Mapping[str, VoxelLayer] = field(default_factory=dict)
    pictures: Mapping[str, np.ndarray] = field(default_factory=dict)
    mesh: TriangleMesh | None = None
    points: PointCloud | None = None


@dataclass
class Stopwatch:
    """Seconds spent in named steps."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = round(time.perf_counter() - start, 4)


def find_method(name: str) -> Method:
    """Return the method of that name, or raise a ScanstageError that lists them."""
    if name not in METHODS:
        raise ScanstageError(f"there is no method {name!r}; the methods are: {', '.join(METHODS)}")
    return METHODS[name]


def reconstruct(scan: Scan, method: str, *, voxels: int = DEFAULT_VOXELS, bounds: np.ndarray | None = None,
                options: Mapping[str, Value] | None = None, solids: Solids | None = None, workers: object | None = None,
                progress: Progress = silent) -> Reconstruction:
    """Run a method on a scan: carve, extract the surface, colour it, and compare it with the silhouettes.

    Parameters
    ----------
    scan : Scan
    method : str
        A name in `METHODS`.
    voxels : int
        Number of voxels along the longest side of the working volume.
    bounds : (2, 3) array, optional
        The working volume in the object frame; otherwise the scan's, or one found from the views.
    options : mapping, optional
        The method's options.
    solids : Solids, optional
        For methods that cut solids.
    workers : object, optional
        Its attributes, by the names in the method's ``spread``, take the places of those functions: with the same results.

    Raises
    ------
    ScanstageError
        An option, the bounds or the views cannot be used, or the work would need more memory than there is.
    """
    entry = find_method(method)
    values = check_call(method, voxels=voxels, bounds=bounds, options=options)
    if entry.cuts_solids and solids is None:
        raise ScanstageError(f"method {method} cuts solids with Blender's solver; run it where Blender is, or give `solids`")
    tools = {"solids": solids} if entry.cuts_solids else {}
    if workers is not None:
        check_spread(method)
        tools |= {name: getattr(workers, name) for name in entry.spread}
    watch, use, measured = Stopwatch(), MemoryUse(), {}
    if entry.measure is not None:
        expected = _expected_memory(entry, scan, scan.bounds if bounds is None else bounds, voxels, values, progress)
        with watch.step("measure"):
            measured["measured"] = entry.measure(scan, progress=part_of(progress, 0.0, 0.4), **values)
        progress = part_of(progress, 0.4, 1.0)
    with watch.step("bounds"):
        box = bounds if bounds is not None else entry.bounds(scan, **measured, **values)
        grid = _grid(box, voxels)
        if entry.measure is None:
            expected = _expected_memory(entry, scan, box, voxels, values, progress)
    with watch.step("carve"):
        outcome = entry.function(scan, grid, progress=part_of(progress, 0.02, 0.5), **measured, **tools, **values)
    volume, found = outcome.volume, dict(outcome.report)
    with watch.step("surface"):
        surface = outcome.surface or extract_surface(volume)
    with watch.step("colour"):
        colors = outcome.colors or color_surface(surface, grid, scan.views, part_of(progress, 0.55, 0.85))
    with watch.step("re-projection"):
        ious = _silhouette_ious(surface, grid, scan, part_of(progress, 0.85, 1.0))
    warnings = list(found.pop("warnings"))
    if bounds is not None or scan.bounds is not None:
        warnings += _clipped(volume)
    if "silhouettes" in entry.needs:
        warnings += suspicion(scan, grid, ious, forgiving="tolerance" in values)
    counts = {"views": len(scan.views), "occupied": volume.count(), "surface": len(surface.voxels), "quads": len(surface.quads),
              "unseen": int(np.count_nonzero(colors.views == 0)), **found.pop("counts", {})}
    report = {
        "method": method, "options": values, "voxels": voxels, "counts": counts,
        "grid": {"origin": grid.origin.tolist(), "voxel_size": grid.voxel_size, "shape": list(grid.shape)},
        "silhouette_iou": {"mean": round(float(np.mean(list(ious.values()))), 4) if ious else None, "views": ious},
        "seconds": watch.seconds, "memory": {"predicted": expected, "used": use.peak()}, "peak_memory": peak_memory(),
        "warnings": warnings, **found,
    }
    return Reconstruction(volume, surface, colors, report, outcome.layers, outcome.pictures, outcome.mesh, outcome.points)


def _expected_memory(entry: Method, scan: Scan, bounds: np.ndarray | None, voxels: int, values: Mapping[str, Value],
                     progress: Progress) -> int:
    """Return and report the memory that the work will take, or refuse it where there is not as much.

    Where there are no ``bounds`` before there are points, the working volume is taken for a cube.
    """
    forecast = Forecast.of(entry.memory, scan, lambda count: _grid(_CUBE if bounds is None else bounds, count), values,
                           measures=entry.measure is not None)
    forecast.refuse_too_large(voxels)
    expected = forecast.bytes(voxels)
    progress(0.0, f"Memory needed: about {amount(expected)}")
    return expected


def _silhouette_ious(surface: Surface, grid: VoxelGrid, scan: Scan, progress: Progress) -> dict[str, float]:
    """Return how well the result, projected back, covers each view's silhouette."""
    ious = {}
    for index, view in enumerate(scan.views):
        progress(index / len(scan.views), "Comparing with the silhouettes")
        if view.mask is not None:
            ious[view.name] = round(reprojection_iou(surface, grid, view), 4)
    progress(1.0, "Reconstructed")
    return ious


def check_call(method: str, *, voxels: int = DEFAULT_VOXELS, bounds: np.ndarray | None = None,
               options: Mapping[str, Value] | None = None) -> dict[str, Value]:
    """Return a value for each of the method's options, or refuse the call: before any picture is read.

    Raises
    ------
    ScanstageError
        The method, an option, the number of voxels or the bounds cannot be used.
    """
    values = resolve(find_method(method).options, options or {}, f"method {method}")
    if not 1 <= voxels <= _LARGEST_GRID:
        raise ScanstageError(f"--voxels: must be from 1 to {_LARGEST_GRID} along the longest side of the bounds")
    if bounds is not None:
        _grid(bounds, voxels)
    return values


def check_spread(method: str) -> None:
    """Refuse a method that cannot be spread over workers.

    Raises
    ------
    ScanstageError
        There is no such method, or it works on one machine only.
    """
    if not find_method(method).spread:
        able = ", ".join(entry.name for entry in METHODS.values() if entry.spread)
        raise ScanstageError(f"--scheduler: method {method} runs on one machine only; those that workers can share are: {able}")


def _grid(bounds: np.ndarray, voxels: int) -> VoxelGrid:
    if (np.abs(bounds) > _LARGEST_NUMBER).any():
        raise ScanstageError(f"--bounds: must lie between -{_LARGEST_NUMBER:g} and {_LARGEST_NUMBER:g}; use a larger unit")
    try:
        grid = VoxelGrid.from_bounds(bounds[0], bounds[1], voxels)
    except ValueError as error:
        raise ScanstageError(f"--bounds: {error}") from None
    if grid.voxel_size < 1 / _LARGEST_NUMBER:
        raise ScanstageError(f"--bounds: voxels of {grid.voxel_size:g} are too small to compute with; use a smaller unit")
    return grid


def _clipped(volume: SparseVolume) -> list[str]:
    """Return a warning if the result reaches the end of a working volume that somebody gave."""
    lower, upper = volume.bounds()
    sides = [f"{sign}{axis}" for i, axis in enumerate("xyz") for sign, clipped in
             (("-", lower[i] == 0), ("+", upper[i] == volume.grid.shape[i] - 1)) if clipped]
    return [f"the working volume clips the result at {' '.join(sides)}: give wider --bounds, or accept it if that is where the "
            "object stands"] if sides else []
