# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Values out of a JSON document that nobody vouches for.

A `Field` is one value with its place in the document. Each of its methods returns the value as one type, checked, or
raises a `ScanstageError` that begins with the file and the place: ``capture.json: frames[3].image: ...``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ..errors import ScanstageError

MAX_BYTES = 1 << 26
MAX_NUMBER = 1e12  # beyond every length in a rig and every focal length; keeps products of numbers finite
MAX_TEXT = 1000


def parse_json(data: bytes, source: str) -> Field:
    """Read a JSON document.

    Parameters
    ----------
    data : bytes
        UTF-8.
    source : str
        The file's name, for error messages.

    Raises
    ------
    ScanstageError
        It is too large, too deeply nested, names a field twice, or is no JSON at all.
    """
    if len(data) > MAX_BYTES:
        raise ScanstageError(f"{source}: is larger than {MAX_BYTES >> 20} MiB, which no capture set needs; "
                             "check that it is the right file")
    try:
        return Field(json.loads(data.decode("utf-8-sig"), object_pairs_hook=_object_without_duplicates), source)
    except RecursionError:
        raise ScanstageError(f"{source}: is nested too deeply; check that it is the right file") from None
    except json.JSONDecodeError as error:
        raise ScanstageError(f"{source}: is not valid JSON at line {error.lineno}, column {error.colno} "
                             f"({error.msg}); correct it or capture again") from None
    except ValueError as error:  # not UTF-8, an integer of thousands of digits, or a duplicate
        raise ScanstageError(f"{source}: is not valid JSON ({str(error)[:200]}); "
                             "correct it or capture again") from None


def _object_without_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    result = dict(pairs)
    if len(result) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the field {twice[:100]!r} is given twice in one object")
    return result


@dataclass(frozen=True)
class Field:
    """One value of a JSON document.

    Parameters
    ----------
    value : object
        As `json` reads it.
    source : str
        The file's name, for error messages.
    path : str
        The value's place in the document; empty for the document itself.
    """

    value: object
    source: str
    path: str = ""

    def error(self, problem: str) -> ScanstageError:
        """Return the error that says ``problem`` about this place, to be raised."""
        return ScanstageError(": ".join(filter(None, (self.source, self.path, problem))))

    @property
    def given(self) -> bool:
        """Whether there is a value (absent and null are the same)."""
        return self.value is not None

    def object(self, required: Collection[str], optional: Collection[str] = ()) -> dict[str, Field]:
        """Return the fields of a JSON object; absent optional ones hold None.

        Raises
        ------
        ScanstageError
            A required field is absent, or there is one that is not known: a misspelt name must not pass for a default.
        """
        self._require(dict, "a JSON object")
        for name in required:
            if self.value.get(name) is None:
                raise self._child(name).error("is missing; add it or capture again")
        for name in self.value:
            if name not in required and name not in optional:
                known = ", ".join((*required, *optional))
                raise self._child(name).error(f"is not a known field; known are: {known}")
        return {name: self._child(name) for name in (*required, *optional)}

    def mapping(self, most: int = 100_000) -> dict[str, Field]:
        """Return the entries of a JSON object whose names are free (ids); absent is empty."""
        if not self.given:
            return {}
        self._require(dict, "a JSON object")
        if len(self.value) > most:
            raise self.error(f"has {len(self.value)} entries, more than {most}; split the set")
        for name in self.value:
            if not name or len(name) > 100 or not name.isprintable():
                raise self.error(f"{name[:20]!r} is no id; use 1 to 100 printable characters")
        return {name: self._child(name) for name in self.value}

    def items(self, most: int = 100_000) -> list[Field]:
        """Return the entries of a JSON list; absent is empty."""
        if not self.given:
            return []
        self._require(list, "a list")
        if len(self.value) > most:
            raise self.error(f"has {len(self.value)} entries, more than {most}; split the set")
        return [Field(item, self.source, f"{self.path}[{index}]") for index, item in enumerate(self.value)]

    def text(self) -> str:
        """Return a text of 1 to 1000 printable characters."""
        self._require(str, "a text")
        if not self.value or len(self.value) > MAX_TEXT or not self.value.isprintable():
            raise self.error(f"must be 1 to {MAX_TEXT} printable characters")
        return self.value

    def choice(self, known: Collection[str], what: str) -> str:
        """Return a text that is one of ``known``; ``what`` says what those are (``a camera``)."""
        text = self.text()
        if text not in known:
            listed = ", ".join(sorted(known)[:10]) or "none"
            raise self.error(f"{text!r} is not {what}; known are: {listed}")
        return text

    def boolean(self) -> bool:
        """Return true or false; absent is False."""
        if not self.given:
            return False
        self._require(bool, "true or false")
        return self.value

    def integer(self, least: int, most: int) -> int:
        """Return a whole number within bounds, both included."""
        if type(self.value) is not int or not least <= self.value <= most:
            raise self.error(f"must be a whole number from {least} to {most}, not {_shown(self.value)}")
        return self.value

    def number(self, least: float = -MAX_NUMBER, most: float = MAX_NUMBER) -> float:
        """Return a finite number within bounds, both included."""
        if type(self.value) not in (int, float) or not least <= self.value <= most:  # a NaN fails the comparison
            raise self.error(f"must be a number from {least:g} to {most:g}, not {_shown(self.value)}")
        return float(self.value)

    def numbers(self, *shape: int) -> np.ndarray:
        """Return a float64 array of the given shape from nested lists of finite numbers."""
        array = np.array(self._nested(shape), dtype=np.float64)
        array.flags.writeable = False
        return array

    def _nested(self, shape: tuple[int, ...]) -> object:
        if not shape:
            return self.number()
        self._require(list, f"a list of {shape[0]}")
        if len(self.value) != shape[0]:
            raise self.error(f"must have {shape[0]} entries, not {len(self.value)}")
        return [item._nested(shape[1:]) for item in self.items()]

    def _child(self, name: str) -> Field:
        shown = name if len(name) <= 100 and name.isprintable() else repr(name[:100])
        return Field(self.value.get(name), self.source, f"{self.path}.{shown}" if self.path else shown)

    def _require(self, kind: type, words: str) -> None:
        if type(self.value) is not kind:
            raise self.error(f"must be {words}, not {_shown(self.value)}")


def _shown(value: object) -> str:
    """Return a value as the file has it, short enough for one line of an error message."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (dict, list)):
        return {dict: "an object", list: "a list"}[type(value)]
    if isinstance(value, int) and abs(value) > MAX_NUMBER:
        return f"a number of about 2^{int(math.log2(abs(value)))}"  # its digits may be thousands
    return repr(value)[:60]
