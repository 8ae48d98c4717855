# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration boards: a checkerboard, or one with markers in its white squares (ChArUco), drawn and found.

The board's frame: x along the columns and y along the rows of its picture, z into the board, the first inner corner at the
origin. The picture's top left square is black.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np

from ..color import linear_to_srgb

KINDS = ("charuco", "checkerboard")
DICTIONARIES: Mapping[str, int] = MappingProxyType({
    f"{bits}X{bits}_{count}": getattr(cv2.aruco, f"DICT_{bits}X{bits}_{count}") for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)})
LEAST_SQUARES, MAX_SQUARES = 4, 50  # along one side
LEAST_CORNERS = 6  # of a partly seen board: fewer hardly bear a pose, let alone tell a wrong one
_ENOUGH = 1280  # pixels along the longer side, for a checkerboard to be found quickly
_REFINEMENT = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4
_WINDOW = 0.3  # half the side of the refinement's window, in squares of a checkerboard
_WINDOWS = 2, 15  # pixels, the least and the most of that half side
_WHITE = 99.0  # per cent of pixels that are darker than what is taken for white


@dataclass(frozen=True)
class Board:
    """A flat board of black and white squares.

    Parameters
    ----------
    kind : {'charuco', 'checkerboard'}
    columns, rows : int
        Squares along the board; the inner corners are one fewer each way.
    square : float
        Side of a square, in the scene's unit.
    marker : float
        Side of a marker of a ChArUco board, in the scene's unit.
    dictionary : str
        The markers of a ChArUco board: a key of `DICTIONARIES`.

    Raises
    ------
    ValueError
        There can be no such board; the message begins with the field's name.
    """

    kind: str
    columns: int
    rows: int
    square: float
    marker: float = 0.0
    dictionary: str = "5X5_100"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"kind must be one of {', '.join(KINDS)}, not {self.kind!r}")
        for name in ("columns", "rows"):
            if not LEAST_SQUARES <= getattr(self, name) <= MAX_SQUARES:
                raise ValueError(f"{name} must be from {LEAST_SQUARES} to {MAX_SQUARES} squares, not {getattr(self, name)}")
        if not 0 < self.square < np.inf:
            raise ValueError(f"square must be a positive length, not {self.square}")
        if self.kind == "checkerboard":
            return
        if not 0 < self.marker < self.square:
            raise ValueError(f"marker must be a length less than the square's, not {self.marker}")
        if self.dictionary not in DICTIONARIES:
            raise ValueError(f"dictionary must be one of {', '.join(DICTIONARIES)}, not {self.dictionary!r}")
        markers, most = self.columns * self.rows // 2, int(self.dictionary.split("_")[1])
        if markers > most:
            raise ValueError(f"dictionary {self.dictionary} has {most} markers, and the board needs {markers}")

    @property
    def corners(self) -> np.ndarray:
        """The (n, 3) inner corners in the board's frame, row by row: an id is an index into them."""
        row, column = np.divmod(np.arange((self.columns - 1) * (self.rows - 1)), self.columns - 1)
        return self.square * np.column_stack((column, row, np.zeros(len(row))))

    @property
    def symmetric(self) -> bool:
        """Whether half a turn leaves the board as it is, so that its pose has two answers."""
        return self.kind == "checkerboard" and (self.columns + self.rows) % 2 == 0

    def draw(self, pixels_per_square: int, margin: float = 0.5) -> np.ndarray:
        """Return the board's picture, to be printed or put on a plane.

        Parameters
        ----------
        pixels_per_square : int
        margin : float
            White border in squares, rounded to whole pixels; detectors need one.

        Returns
        -------
        (height, width) uint8 array
            Black squares are 0. Inner corner 0 lies where four pixels meet, ``margin + 1`` squares from the outer edges.

        Raises
        ------
        ValueError
            A marker's cells would be smaller than a pixel.
        """
        if self.kind == "charuco":
            size = self.columns * pixels_per_square, self.rows * pixels_per_square
            try:
                squares = self._charuco().generateImage(size, marginSize=0)
            except cv2.error:
                raise ValueError(f"pixels_per_square must be more than {pixels_per_square} to show the markers") from None
        else:
            row, column = np.mgrid[:self.rows * pixels_per_square, :self.columns * pixels_per_square] // pixels_per_square
            squares = np.where((row + column) % 2, np.uint8(255), np.uint8(0))
        return np.pad(squares, round(margin * pixels_per_square), constant_values=255)

    def find(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Find the inner corners in a picture.

        Parameters
        ----------
        rgb : (height, width, 3) array
            Linear light.

        Returns
        -------
        ids : (n,) int array
            Which corners (see `corners`); a checkerboard is found whole or not at all.
        pixels : (n, 2) float64 array
            Where they are.
        None
            Instead of both, if the board is not there.
        """
        grey = _eight_bit(rgb)
        return self._find_charuco(grey) if self.kind == "charuco" else self._find_checkerboard(grey)

    def _charuco(self) -> cv2.aruco.CharucoBoard:
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[self.dictionary])
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)

    def _find_charuco(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        pixels, ids, _, _ = cv2.aruco.CharucoDetector(self._charuco()).detectBoard(grey)
        if ids is None or len(ids) < LEAST_CORNERS:
            return None
        ids, pixels = ids.ravel(), pixels.reshape(-1, 2)
        pixels = _refined(grey, pixels, (self.square - self.marker) / (2 * self.square))  # no further than where the markers begin
        spread = np.linalg.svd(self.corners[ids][:, :2] - self.corners[ids][:, :2].mean(axis=0), compute_uv=False)
        return (ids, pixels) if spread[1] > 0.5 * self.square else None  # a single row of corners bears no pose

    def _find_checkerboard(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        inner = self.columns - 1, self.rows - 1
        factor = -(-max(grey.shape) // _ENOUGH)
        pixels = _squares_of(grey, inner, factor)
        if pixels is None and factor > 1:
            pixels = _squares_of(grey, inner, 1)
        if pixels is None:
            return None
        ids, pixels = np.arange(len(pixels)), self._oriented(grey, pixels.reshape(inner[1], inner[0], 2)).reshape(-1, 2)
        return ids, _refined(grey, pixels, _WINDOW)

    def _oriented(self, grey: np.ndarray, grid: np.ndarray) -> np.ndarray:
        """Return the (rows, columns, 2) corners so that x, y are right-handed in the picture and square (0, 0) is black."""
        across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        if across[0] * down[1] < across[1] * down[0]:
            grid = grid[:, ::-1]
        centres = (grid[:-1, :-1] + grid[1:, 1:] + grid[:-1, 1:] + grid[1:, :-1]) / 4
        column, row = np.moveaxis(np.round(centres).astype(int), -1, 0)
        seen = grey[row.clip(0, grey.shape[0] - 1), column.clip(0, grey.shape[1] - 1)].astype(float)
        sign = np.where(np.add(*np.indices(seen.shape)) % 2, -1.0, 1.0)  # the square below corner 0 has square (0, 0)'s colour
        return grid if (seen * sign).sum() <= (seen.mean() * sign).sum() else grid[::-1, ::-1]


def _squares_of(grey: np.ndarray, inner: tuple[int, int], factor: int) -> np.ndarray | None:
    """Return a checkerboard's corners, found in the picture reduced by a whole factor and so to about a pixel."""
    if factor > 1:
        grey = cv2.resize(grey, (grey.shape[1] // factor, grey.shape[0] // factor), interpolation=cv2.INTER_AREA)
    found, pixels = cv2.findChessboardCornersSB(grey, inner, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    return factor * (pixels + 0.5) - 0.5 if found else None


def spacing(pixels: np.ndarray) -> np.ndarray:
    """Return the distance from each of (n, 2) corners to the nearest other: about a square's shorter side in the picture."""
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    return apart.min(axis=1)


def _refined(grey: np.ndarray, pixels: np.ndarray, window: float) -> np.ndarray:
    """Return the (n, 2) corners moved to the saddle points of the picture, each seen through 2 * ``window`` squares."""
    half = min(int(np.clip(window * np.median(spacing(pixels)), *_WINDOWS)), (min(grey.shape) - 5) // 2)  # as OpenCV demands
    moved = cv2.cornerSubPix(grey, pixels.astype(np.float32).reshape(-1, 1, 2), (half, half), (-1, -1), _REFINEMENT)[:, 0]
    return moved.astype(np.float64)


def _eight_bit(rgb: np.ndarray) -> np.ndarray:
    """Return the picture as detectors know pictures: grey, 8 bit, sRGB, exposed so that white is nearly white."""
    grey = np.asarray(rgb, np.float32).mean(axis=-1)
    white = float(np.percentile(grey, _WHITE))
    return np.round(255 * linear_to_srgb(np.clip(grey / white if white > 0 else grey, 0, 1))).astype(np.uint8)
