# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A view's pictures by their patterns: which of them are there, which are missing, and whether they are what they say.

The fields of a pattern come from a capture set that somebody may have written by hand, so none of them is trusted, and the
pictures may be in another order than somebody believes. Each error names the frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...errors import ScanstageError
from ..scan import ProjectedPicture
from .correspondence import full_scale
from .patterns import AXES, code_bits

AGAIN = "check the order of the frames"
_MOST_BITS = 16
_MOST_STEPS = 256
_SPARSE = slice(None, None, 4)  # of rows and columns: enough pixels to judge a picture by
_LARGEST_MISFIT = 0.2  # of the range between black and white: by how much a picture and its inverse may miss their sum
_MOST_SATURATED = 0.5  # of the lit pixels


def read_grey(picture: ProjectedPicture) -> np.ndarray:
    """Return a picture as (h, w) float32: the mean of its channels, or 1 where one of them is saturated."""
    image = picture.read_image()
    grey = cv2.transform(image, np.full((1, 3), 1 / 3, np.float32))
    grey[image.max(axis=2) >= 1] = 1
    return grey


def of_kind(pictures: Sequence[ProjectedPicture], kind: str) -> list[ProjectedPicture]:
    """Return the pictures under patterns of one kind, in their order."""
    return [picture for picture in pictures if picture.pattern.get("kind") == kind]


def only(pictures: Sequence[ProjectedPicture], kind: str) -> ProjectedPicture | None:
    """Return the picture under ``white`` or ``black``; None if there is none.

    Raises
    ------
    ScanstageError
        There are several.
    """
    found = of_kind(pictures, kind)
    if len(found) > 1:
        raise ScanstageError(f"frame {found[1].name}: shows the same pattern as frame {found[0].name}; leave one of them out")
    return found[0] if found else None


@dataclass(frozen=True)
class GrayPictures:
    """The pictures of one axis of a Gray code.

    Parameters
    ----------
    axis : {'column', 'row'}
    pairs : tuple of (ProjectedPicture, ProjectedPicture or None)
        Each bit's picture and that of its inverse, the coarsest first.
    finest : int
        Index of the last bit that is there.
    """

    axis: str
    pairs: tuple[tuple[ProjectedPicture, ProjectedPicture | None], ...]
    finest: int

    def read(self, white: np.ndarray, black: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray | None]]:
        """Yield the pictures for `gray_code.decode_gray`, and refuse a pair that cannot be one."""
        for on, off in self.pairs:
            image, inverse = read_grey(on), None if off is None else read_grey(off)
            if inverse is not None:
                _refuse_misfit(on, off, image, inverse, white, black)
            yield image, inverse


def gray_pictures(pictures: Sequence[ProjectedPicture], axis: str, length: int, where: str) -> GrayPictures | None:
    """Find the pictures of one axis of a Gray code; None if there are none.

    Parameters
    ----------
    pictures : sequence of ProjectedPicture
    axis : {'column', 'row'}
    length : int
        Number of the projector's columns, or rows.
    where : str
        The view, for error messages.

    Raises
    ------
    ScanstageError
        A field is not what it must be, a bit is missing or there twice, or the code cannot number that many columns.
    """
    found: dict[tuple[int, bool], ProjectedPicture] = {}
    bits = None
    for picture in of_kind(pictures, "gray-code"):
        if _choice(picture, "axis", AXES) != axis:
            continue
        count = _whole(picture, "bits", 1, _MOST_BITS)
        bits = bits or count
        if count != bits or 2 ** count < length:
            raise ScanstageError(f"frame {picture.name}: a Gray code of {count} bits cannot number the projector's {length} {axis}s, "
                                 f"which take {code_bits(length)}; correct the pattern or the projector's size")
        key = _whole(picture, "bit", 0, bits - 1), bool(picture.pattern.get("inverse", False))
        if key in found:
            raise ScanstageError(f"frame {picture.name}: shows the same pattern as frame {found[key].name}; leave one of them out")
        found[key] = picture
    if bits is None:
        return None
    shown = sorted({bit for bit, _ in found}, reverse=True)
    for bit in range(bits - 1, shown[-1] - 1, -1):
        if (bit, False) not in found:
            raise ScanstageError(f"{where}: the Gray code of the {axis}s has no frame for bit {bit}; capture it, or leave out all "
                                 "that are finer")
    return GrayPictures(axis, tuple((found[bit, False], found.get((bit, True))) for bit in shown), shown[-1])


@dataclass(frozen=True)
class PhasePictures:
    """The pictures of one sinusoid.

    Parameters
    ----------
    period : float
        In projector pixels.
    pictures : tuple of ProjectedPicture
        In the order of their steps.
    """

    period: float
    pictures: tuple[ProjectedPicture, ...]

    @property
    def frames(self) -> str:
        """The frames' names, for error messages."""
        return f"frames {self.pictures[0].name} to {self.pictures[-1].name}"


def phase_pictures(pictures: Sequence[ProjectedPicture], axis: str, where: str) -> list[PhasePictures]:
    """Find the sinusoids along one axis, the longest period first.

    Raises
    ------
    ScanstageError
        A field is not what it must be, or a step is missing or there twice.
    """
    found: dict[tuple[float, int], dict[int, ProjectedPicture]] = {}
    for picture in of_kind(pictures, "phase-shift"):
        if _choice(picture, "axis", AXES) != axis:
            continue
        steps, period = _whole(picture, "steps", 3, _MOST_STEPS), number_of(picture, "period", 1.0, 1e6)
        step, sinusoid = _whole(picture, "step", 0, steps - 1), found.setdefault((period, steps), {})
        if step in sinusoid:
            raise ScanstageError(f"frame {picture.name}: shows the same pattern as frame {sinusoid[step].name}; leave one of them out")
        sinusoid[step] = picture
    for (period, steps), sinusoid in found.items():
        if len(sinusoid) < steps:
            missing = min(set(range(steps)) - sinusoid.keys())
            raise ScanstageError(f"{where}: the sinusoid of {period:g} pixels has {len(sinusoid)} of its {steps} frames; "
                                 f"capture step {missing}, too")
    return [PhasePictures(period, tuple(sinusoid[step] for step in range(steps)))
            for (period, steps), sinusoid in sorted(found.items(), reverse=True)]


def refuse_saturated(picture: ProjectedPicture, image: np.ndarray, black: np.ndarray, least: float) -> None:
    """Refuse a picture of which most that is lit is brighter than the camera can tell."""
    image, black = image[_SPARSE, _SPARSE], black[_SPARSE, _SPARSE]
    lit = image.astype(np.float32) - black >= least
    share = np.count_nonzero(lit & (image >= full_scale(image))) / max(np.count_nonzero(lit), 1)
    if share > _MOST_SATURATED:
        raise ScanstageError(f"frame {picture.name}: {100 * share:.0f} % of what the projector lights is saturated; capture with less "
                             "exposure or a weaker projector")


def refuse_dark(white: ProjectedPicture, black: ProjectedPicture, bright: np.ndarray, dark: np.ndarray, least: float) -> None:
    """Refuse white and black if one does not outshine the other anywhere, or if they are mixed up."""
    gain = bright[_SPARSE, _SPARSE].astype(np.float32) - dark[_SPARSE, _SPARSE]
    lit, fallen = np.count_nonzero(gain >= least), np.count_nonzero(gain <= -least)
    if fallen > lit:
        raise ScanstageError(f"frame {white.name}: is darker under white than frame {black.name} under black; {AGAIN}")
    if not lit:
        raise ScanstageError(f"frame {white.name}: the projector lights nothing in it; check its pose and power, or lower the contrast")


def _refuse_misfit(on: ProjectedPicture, off: ProjectedPicture, image: np.ndarray, inverse: np.ndarray, white: np.ndarray,
                   black: np.ndarray) -> None:
    """Refuse a pair that does not add up to white and black: one of the two is another bit's."""
    image, inverse, white, black = (array[_SPARSE, _SPARSE].astype(np.float32) for array in (image, inverse, white, black))
    lit = white - black > 0.25 * float((white - black).max())
    misfit = np.abs(image + inverse - white - black)[lit] / (white - black)[lit]
    if misfit.size and misfit.mean() > _LARGEST_MISFIT:
        raise ScanstageError(f"frame {on.name}: does not add up to white with its inverse, frame {off.name}; {AGAIN}")


def _choice(picture: ProjectedPicture, field: str, known: Sequence[str]) -> str:
    value = picture.pattern.get(field)
    if value not in known:
        raise ScanstageError(f"frame {picture.name}: its pattern's {field} must be {' or '.join(known)}, not {str(value)[:40]!r}")
    return value


def _whole(picture: ProjectedPicture, field: str, least: int, most: int) -> int:
    value = picture.pattern.get(field)
    if type(value) is not int or not least <= value <= most:
        raise ScanstageError(f"frame {picture.name}: its pattern's {field} must be a whole number from {least} to {most}, "
                             f"not {str(value)[:40]!r}")
    return value


def number_of(picture: ProjectedPicture, field: str, least: float, most: float) -> float:
    """Return a number that a pattern's field must hold.

    Raises
    ------
    ScanstageError
        It is absent, no number, or out of bounds; a bool is no number.
    """
    value = picture.pattern.get(field)
    if type(value) not in (int, float) or not least <= value <= most:
        raise ScanstageError(f"frame {picture.name}: its pattern's {field} must be a number from {least:g} to {most:g}, "
                             f"not {str(value)[:40]!r}")
    return float(value)
