# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The patterns that a projector shows: points, stripes, Gray code, shifted phases, checkers.

Every pattern says what it is in plain JSON values, its *fields*, which a capture set keeps beside the frames that were
taken under it. Decoders read the fields alone: they do not care who showed the pattern, nor in which order.

| kind | fields |
|---|---|
| ``white``, ``black`` | none: everything on, everything off |
| ``gray-code`` | ``axis``, ``bit`` (0 is the finest), ``bits``, ``inverse`` |
| ``phase-shift`` | ``axis``, ``period`` in pixels, ``step``, ``steps`` |
| ``stripe`` | ``axis``, ``position`` of its middle and ``width`` (four standard deviations) in pixels |
| ``laser`` | ``plane``, ``[nx, ny, nz, d]`` with ``n . X = d`` in the world, and ``width`` in its unit: a stripe of no projector |
| ``point`` | ``column``, ``row``, ``width`` |
| ``point-grid`` | ``spacing``, ``width`` |
| ``checker`` | ``cell``, ``step``, ``steps`` |
| ``speckle`` | ``dot``, the side of a dot in pixels, ``density``, ``seed`` |
| ``color-stripes`` | ``axis``, ``stripes``, their ``width``, the ``start`` of the first and the ``shift`` of the frame, in pixels |
| ``primary`` | ``channel``: 0, 1 or 2 for red, green or blue, everything on |

``axis`` is what the code counts: ``column`` or ``row``. ``projector`` may name the projector's id, which a capture set with
several needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ...errors import ScanstageError
from ...options import Option, Unit, Value, resolve
from .speckle_code import speckle_image
from .stripe_code import EDGES, WINDOW, stripe_colors

AXES = ("column", "row")
LARGEST_SIDE = 1 << 16  # codes are 16-bit numbers
_GUARD = 1.125  # the coarsest sinusoid is so much longer than the projector's side that noise does not wrap the first column


@dataclass(frozen=True)
class Pattern:
    """One image for a projector.

    Parameters
    ----------
    id : str
        Unique in its set; letters, digits, ``-`` and ``.``.
    fields : mapping
        What it is, in JSON values: see above.
    image : (height, width) or (height, width, 3) uint8 or float32 array
        White, or colours. Linear light; 255, or 1.0, is the projector's full power. Read-only where it repeats one row or column.
    """

    id: str
    fields: Mapping[str, object]
    image: np.ndarray


@dataclass(frozen=True)
class PatternSet:
    """A sequence of patterns that belong together.

    Parameters
    ----------
    name, label, description : str
    options : tuple of Option
    function : callable
        ``function(size, **options) -> tuple of Pattern``, for a projector of ``size`` (width, height).
    """

    name: str
    label: str
    description: str
    options: tuple[Option, ...]
    function: Callable[..., tuple[Pattern, ...]]


def make_patterns(name: str, size: tuple[int, int], options: Mapping[str, Value] | None = None) -> tuple[Pattern, ...]:
    """Return a set of patterns by its name in `PATTERN_SETS`.

    Raises
    ------
    ScanstageError
        There is no such set, an option is not allowed, or a projector of that size cannot show it.
    """
    if name not in PATTERN_SETS:
        raise ScanstageError(f"there is no pattern set {name!r}; the pattern sets are: {', '.join(PATTERN_SETS)}")
    if not (1 <= size[0] <= LARGEST_SIDE and 1 <= size[1] <= LARGEST_SIDE):
        raise ScanstageError(f"a projector of {size[0]}x{size[1]} pixels cannot show a pattern; "
                             f"each side must be from 1 to {LARGEST_SIDE}")
    chosen = PATTERN_SETS[name]
    return chosen.function(size, **resolve(chosen.options, options or {}, f"pattern set {name}"))


def code_bits(count: int) -> int:
    """Return how many bits tell ``count`` columns or rows apart."""
    return (count - 1).bit_length()


def gray_code(size: tuple[int, int], *, axes: str = "both", inverses: bool = True) -> tuple[Pattern, ...]:
    """Return a binary-reflected Gray code (Gray, 1953), in the order of OpenCV's structured_light module.

    First the columns, then the rows, each from the coarsest bit to the finest and every pattern before its inverse; then
    white, then black. With both axes and inverses these are OpenCV's images, bit for bit.

    Parameters
    ----------
    size : (int, int)
        Width and height of the projector.
    axes : {'both', 'columns', 'rows'}
    inverses : bool
        Whether each pattern is followed by its inverse, so that a bit is the sign of a difference, whatever the surface.

    Raises
    ------
    ScanstageError
        The projector has only one column, or row: there is nothing to encode.
    """
    patterns = []
    for axis in _chosen(axes):
        patterns += _gray_patterns(size, axis, 0, inverses)
    return (*patterns, *_white_and_black(size))


def phase_shift(size: tuple[int, int], *, axes: str = "columns", period: float = 16.0, steps: int = 4, unwrap: str = "gray",
                ratio: float = 6.0) -> tuple[Pattern, ...]:
    """Return sinusoids ``(1 + cos(2 pi u / period - 2 pi step / steps)) / 2`` and what tells their periods apart.

    Parameters
    ----------
    size : (int, int)
    axes : {'columns', 'rows', 'both'}
    period : float
        Of the finest sinusoid, in projector pixels.
    steps : int
        At least 3. From 4 on the second harmonic, which a projector's or camera's gamma adds, does not leak into the phase.
    unwrap : {'gray', 'frequencies'}
        By a Gray code as coarse as half a period allows, with inverses, white and black; or by sinusoids each ``ratio`` times
        coarser than the one before, up to a period a little longer than the projector's side.
    ratio : float

    Raises
    ------
    ScanstageError
        The projector is smaller than a period.
    """
    patterns: list[Pattern] = []
    for axis in _chosen(axes):
        length = size[AXES.index(axis)]
        if length < period:
            raise ScanstageError(f"a period of {period:g} pixels is longer than the projector's {length} {axis}s; "
                                 "use a shorter period")
        if unwrap == "gray":
            finest = max(int(np.floor(np.log2(period))) - 1, 0)  # cells of half a period, or less: see `unwrap_phase`
            patterns += _gray_patterns(size, axis, finest, True)
            periods = [period]
        else:
            periods = _coarser_periods(period, length, ratio)
        patterns += [_sinusoid(size, axis, length, step, steps) for length in periods for step in range(steps)]
    return (*patterns, *_white_and_black(size))


def stripe_sweep(size: tuple[int, int], *, axis: str = "column", width: float = 4.0, spacing: float = 1.0) -> tuple[Pattern, ...]:
    """Return one stripe of light with a Gaussian profile at every ``spacing`` pixels, from side to side.

    Parameters
    ----------
    size : (int, int)
    axis : {'column', 'row'}
        Across which the stripe moves.
    width : float
        Of the stripe: four standard deviations.
    spacing : float
    """
    length = size[AXES.index(axis)]
    positions = np.arange(0.0, length, spacing)
    digits = len(str(len(positions) - 1))
    return tuple(Pattern(f"stripe-{axis}-{index:0{digits}d}",
                         {"kind": "stripe", "axis": axis, "position": float(position), "width": width},
                         _along(size, axis, _profile(np.arange(length), position, width)))
                 for index, position in enumerate(positions))


def single_points(size: tuple[int, int], *, columns: int = 8, rows: int = 6, width: float = 4.0) -> tuple[Pattern, ...]:
    """Return one point of light at each place of a grid, one place a pattern: the simplest active stereo there is."""
    places = [(column, row) for row in _spread(size[1], rows) for column in _spread(size[0], columns)]
    digits = len(str(len(places) - 1))
    return tuple(Pattern(f"point-{index:0{digits}d}", {"kind": "point", "column": column, "row": row, "width": width},
                         _outer(_profile(np.arange(size[1]), row, width), _profile(np.arange(size[0]), column, width)))
                 for index, (column, row) in enumerate(places))


def point_grid(size: tuple[int, int], *, spacing: float = 32.0, width: float = 4.0) -> tuple[Pattern, ...]:
    """Return one pattern with all points of a square grid at once, its corner half a spacing from the projector's."""
    lines = []
    for length in size:
        pixels = np.arange(length)
        nearest = (np.floor((pixels + 0.5) / spacing) + 0.5) * spacing - 0.5
        lines.append(_profile(pixels, nearest, width))
    return (Pattern("point-grid", {"kind": "point-grid", "spacing": spacing, "width": width}, _outer(lines[1], lines[0])),)


def checker(size: tuple[int, int], *, cell: int = 8, shifts: int = 5) -> tuple[Pattern, ...]:
    """Return a checkerboard shifted ``shifts`` times along each axis, for direct and global light (Nayar et al., 2006).

    Parameters
    ----------
    size : (int, int)
    cell : int
        Side of a square, in projector pixels.
    shifts : int
        Along each axis, over two cells: 25 patterns for 5, the paper's number.
    """
    rows, columns = np.mgrid[:size[1], :size[0]]
    offsets = [round(2 * cell * step / shifts) for step in range(shifts)]
    return tuple(Pattern(f"checker-{index:03d}", {"kind": "checker", "cell": cell, "step": index, "steps": shifts ** 2},
                         _levels(((columns + right) // cell + (rows + down) // cell) % 2 == 1))
                 for index, (down, right) in enumerate((down, right) for down in offsets for right in offsets))


def speckle(size: tuple[int, int], *, dot: int = 3, density: float = 0.3, seed: int = 1) -> tuple[Pattern, ...]:
    """Return one pattern of square dots, each place of a grid lit or not by a coin of its own."""
    fields = {"kind": "speckle", "dot": dot, "density": density, "seed": seed}
    return (Pattern("speckle", fields, speckle_image(size, fields)),)


def color_stripes(size: tuple[int, int], *, axis: str = "column", width: int = 8, frames: int = 1,
                  primaries: bool = False) -> tuple[Pattern, ...]:
    """Return stripes of colour whose edges are a De Bruijn sequence (Zhang, Curless & Seitz, 2002): see `stripe_code`.

    There are as many as the projector has room for, at most 126, in its middle; the outermost reach its borders.

    Parameters
    ----------
    size : (int, int)
    axis : {'column', 'row'}
        What the stripes number; it must cross the epipolar lines.
    width : int
        Of a stripe, in pixels.
    frames : int
        Each shifted by one more pixel.
    primaries : bool
        Whether red, green and blue alone, and black, follow: they tell cross-talk of the channels and the surface's colour.

    Raises
    ------
    ScanstageError
        There is no room for the code's shortest word.
    """
    length = size[AXES.index(axis)]
    stripes = min(EDGES + 1, length // width)
    if stripes <= WINDOW:
        raise ScanstageError(f"{stripes} stripes of {width} pixels fit on the projector's {length} {axis}s, which are too few to tell "
                             "apart; use narrower stripes")
    colors = (255 * stripe_colors(stripes)).astype(np.uint8)
    start, patterns = (length - stripes * width) // 2, []
    for shift in range(frames):
        number = np.clip((np.arange(length) - start - shift) // width, 0, stripes - 1)
        fields = {"kind": "color-stripes", "axis": axis, "stripes": stripes, "width": width, "start": start, "shift": shift}
        patterns.append(Pattern(f"color-stripes-{axis}-{shift:02d}", fields, _along(size, axis, colors[number])))
    if not primaries:
        return tuple(patterns)
    solid = [Pattern(f"primary-{name}", {"kind": "primary", "channel": channel},
                     np.broadcast_to(np.eye(3, dtype=np.uint8)[channel] * np.uint8(255), (*size[::-1], 3)))
             for channel, name in enumerate(("red", "green", "blue"))]
    return (*patterns, *solid, _white_and_black(size)[1])


def _gray_patterns(size: tuple[int, int], axis: str, finest: int, inverses: bool) -> list[Pattern]:
    length = size[AXES.index(axis)]
    bits = code_bits(length)
    if bits == 0:
        raise ScanstageError(f"a projector with a single {axis} has no {axis}s to tell apart; encode the other axis")
    number = np.arange(length)
    gray, patterns = number ^ (number >> 1), []
    for bit in range(bits - 1, finest - 1, -1):
        on = (gray >> bit) & 1 == 1
        for inverse in (False, True)[:1 + inverses]:
            name = f"gray-{axis}-{bits - 1 - bit:02d}" + ("-inverse" if inverse else "")
            fields = {"kind": "gray-code", "axis": axis, "bit": bit, "bits": bits, "inverse": inverse}
            patterns.append(Pattern(name, fields, _along(size, axis, _levels(on ^ inverse))))
    return patterns


def _coarser_periods(period: float, length: int, ratio: float) -> list[float]:
    """Return periods from one that spans the projector down to ``period``, each at most ``ratio`` times finer."""
    longest = _GUARD * length
    count = int(np.ceil(np.log(longest / period) / np.log(ratio) - 1e-9))
    return [float(value) for value in np.geomspace(longest, period, count + 1)] if count else [period]


def _sinusoid(size: tuple[int, int], axis: str, period: float, step: int, steps: int) -> Pattern:
    length = size[AXES.index(axis)]
    wave = 0.5 + 0.5 * np.cos(2 * np.pi * (np.arange(length) / period - step / steps))
    return Pattern(f"phase-{axis}-{period:010.4f}-{step:02d}",
                   {"kind": "phase-shift", "axis": axis, "period": period, "step": step, "steps": steps},
                   _along(size, axis, wave.astype(np.float32)))


def _white_and_black(size: tuple[int, int]) -> tuple[Pattern, Pattern]:
    return tuple(Pattern(kind, {"kind": kind}, np.broadcast_to(np.uint8(level), size[::-1]))
                 for kind, level in (("white", 255), ("black", 0)))


def _along(size: tuple[int, int], axis: str, line: np.ndarray) -> np.ndarray:
    """Return the (height, width) image that repeats a line of values over the other axis, without a copy of each."""
    return np.broadcast_to(line if axis == "column" else line[:, None], (*size[::-1], *line.shape[1:]))


def _levels(on: np.ndarray) -> np.ndarray:
    return np.where(on, np.uint8(255), np.uint8(0))


def _outer(down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return points of light as 8-bit levels: a grid of places in sequence must not take four times the memory."""
    return np.rint(255 * np.outer(down, across)).astype(np.uint8)


def _profile(pixels: np.ndarray, middle, width: float) -> np.ndarray:
    """Return a beam's Gaussian profile: ``width`` is four standard deviations, as for a laser (ISO 11146)."""
    return np.exp(-8 * ((pixels - middle) / width) ** 2).astype(np.float32)


def _spread(length: int, count: int) -> list[float]:
    """Return the middles of ``count`` equal parts of a projector's side."""
    return [(index + 0.5) * length / count - 0.5 for index in range(count)]


def _chosen(axes: str) -> tuple[str, ...]:
    return {"both": AXES, "columns": AXES[:1], "rows": AXES[1:]}[axes]


_AXIS_CHOICES = {"both": "columns and rows", "columns": "columns only: enough where the calibration is good", "rows": "rows only"}
_WIDTH = Option("width", 4.0, "Width of the light: four standard deviations of its Gaussian profile", unit=Unit.PIXELS,
                minimum=0.5, maximum=1000.0)

PATTERN_SETS = {entry.name: entry for entry in (
    PatternSet("gray-code", "Gray Code", "Black and white stripes that number every column and row", (
        Option("axes", "both", "What is encoded", choices=_AXIS_CHOICES),
        Option("inverses", True, "Show the inverse of every pattern, too: bits are then told whatever the surface's colour"),
    ), gray_code),
    PatternSet("phase-shift", "Phase Shift", "Sinusoids that place a pixel between the projector's columns", (
        Option("axes", "columns", "What is encoded", choices=_AXIS_CHOICES),
        Option("period", 16.0, "Period of the finest sinusoid: shorter is more precise and needs a sharper projector",
               unit=Unit.PIXELS, minimum=4.0, maximum=4096.0),
        Option("steps", 4, "Shifts of each sinusoid: noise falls with their square root", minimum=3, maximum=64),
        Option("unwrap", "gray", "What tells the periods apart", choices={
            "gray": "a Gray code", "frequencies": "coarser sinusoids, up to one period across the projector"}),
        Option("ratio", 6.0, "Ratio of neighbouring frequencies, where those tell the periods apart", minimum=1.5, maximum=16.0),
    ), phase_shift),
    PatternSet("stripe-sweep", "Stripe Sweep", "One stripe of light that moves across the scene", (
        Option("axis", "column", "Across what the stripe moves", choices={"column": "from left to right", "row": "from top to bottom"}),
        _WIDTH,
        Option("spacing", 1.0, "Step of the sweep", unit=Unit.PIXELS, minimum=0.01, maximum=4096.0),
    ), stripe_sweep),
    PatternSet("points", "Points", "One point of light at a time", (
        Option("columns", 8, "Points across", minimum=1, maximum=32),
        Option("rows", 6, "Points down", minimum=1, maximum=32),
        _WIDTH,
    ), single_points),
    PatternSet("point-grid", "Point Grid", "All points of a grid at once", (
        Option("spacing", 32.0, "Distance of neighbouring points", unit=Unit.PIXELS, minimum=2.0, maximum=4096.0),
        _WIDTH,
    ), point_grid),
    PatternSet("checker", "Checker", "A shifted checkerboard, which tells direct from global light", (
        Option("cell", 8, "Side of a square", unit=Unit.PIXELS, minimum=1, maximum=1024),
        Option("shifts", 5, "Shifts along each axis", minimum=2, maximum=16),
    ), checker),
    PatternSet("speckle", "Speckle", "Pseudo-random dots, as a depth sensor projects them", (
        Option("dot", 3, "Side of a dot: the camera should see one and a half to three pixels of it", unit=Unit.PIXELS,
               minimum=1, maximum=64),
        Option("density", 0.3, "Share of the places that are lit", minimum=0.05, maximum=0.95),
        Option("seed", 1, "Another number is another pattern", minimum=0, maximum=1_000_000),
    ), speckle),
    PatternSet("color-stripes", "Color Stripes", "Stripes of colour that are told by the edges beside them, all in one picture", (
        Option("axis", "column", "What the stripes number", choices={"column": "columns: for a projector beside the camera",
                                                                      "row": "rows: for one above or below it"}),
        Option("width", 8, "Width of a stripe; the camera should see at least three pixels of it", unit=Unit.PIXELS, minimum=2,
               maximum=1024),
        Option("frames", 1, "Pictures a pose, each with the stripes shifted by one pixel: from two on, edges are told by when they pass",
               minimum=1, maximum=64),
        Option("primaries", False, "Show red, green, blue and black alone, too: cross-talk and the surface's colour are then taken out"),
    ), color_stripes),
)}
