# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes frames that were rendered elsewhere into a capture set: found by their numbers, checked one by one."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ..captures.files import read_bytes, write_bytes
from ..captures.picture_format import read_header
from ..captures.pictures import MAX_FILE_BYTES
from ..errors import ScanstageError
from ..stage.fingerprint import NOTE

_NUMBER = re.compile(r"(\d{1,9})\.png", re.IGNORECASE)  # at the end of a name: 0012.png, 000012.png, pot_0012.png


@dataclass
class FarmFrames:
    """The pictures below a folder that a render farm has filled.

    Parameters
    ----------
    folder : Path

    Attributes
    ----------
    taken : int
        How many frames were copied into the set.
    refused : dict of str to str
        By path, why a picture of a frame that was wanted is not taken. Of a frame that is there twice the whole one is.

    Raises
    ------
    ScanstageError
        There is no such folder.
    """

    folder: Path
    taken: int = 0
    refused: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not Path(self.folder).is_dir():
            raise ScanstageError(f"--frames-from: {self.folder} is not a folder; name the one that the farm wrote its frames to")
        self._found: dict[int, list[Path]] = {}
        for path in sorted(Path(self.folder).rglob("*")):
            if (number := _NUMBER.search(path.name)) and number.end() == len(path.name) and path.is_file():
                self._found.setdefault(int(number[1]), []).append(path)

    def take(self, number: int, target: Path, size: tuple[int, int], note: str) -> bool:
        """Copy one frame to where the set wants it, if there is one that is whole, of this size and of this plan.

        Parameters
        ----------
        number : int
            Of the timeline.
        target : Path
        size : (int, int)
        note : str
            The plan's fingerprint.
        """
        for path, data, problem in self._looked_at(number, size, note):
            if problem is None:
                write_bytes(target, data)
                self.taken += 1
                return True
            self.refused[str(path)] = problem
        return False

    def report(self) -> dict:
        """Return what was taken and what not, as JSON values."""
        return {"taken": self.taken, "refused": self.refused}

    def lines(self) -> list[str]:
        """Return the same for a person."""
        return [f"{self.folder}: {self.taken} frames taken", *(f"{path}: {problem}: not taken" for path, problem in self.refused.items())]

    def _looked_at(self, number: int, size: tuple[int, int], note: str) -> Iterator[tuple[Path, bytes, str | None]]:
        """Yield each file of a frame's number, its bytes, and what is wrong with it."""
        for path in self._found.get(number, ()):
            try:
                data = read_bytes(path, MAX_FILE_BYTES, str(path))
            except ScanstageError as error:
                yield path, b"", str(error)
                continue
            header = read_header(data)
            if header is None or not header.whole:
                yield path, data, "is cut short or damaged"
            elif (header.width, header.height) != tuple(size):
                yield path, data, f"is {header.width}x{header.height} pixels instead of {size[0]}x{size[1]}"
            elif header.texts.get(NOTE) != note or (header.texts.get("Frame", "").lstrip("0") or "0") != str(number):  # 07 of 32
                yield path, data, "is of another plan or another frame"
            else:
                yield path, data, None
