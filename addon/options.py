# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Typed options: declared once beside the function that takes them, read by the command line, panels and documentation.

An option's type is that of its default. Values are in the units of the code (metres, radians); only the two faces
speak degrees. Text from a user goes through `Option.parse`, values from a program through `Option.check`.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from .errors import ScanstageError

Value = bool | int | float | str


class Unit(Enum):
    """What a number measures; the faces choose their display from it."""

    NONE = ""
    LENGTH = "m"
    ANGLE = "degrees"
    PIXELS = "px"
    MILLIMETRES = "mm"


@dataclass(frozen=True)
class Option:
    """One option of a method, a preset or a silhouette extractor.

    Parameters
    ----------
    name : str
        Also the keyword of the function that takes it.
    default : bool, int, float or str
        Its type is the option's type.
    description : str
        What it does to the result: the tooltip and the manual's sentence, without a full stop.
    unit : Unit
    minimum, maximum : float
        Both included, in the units of the code.
    choices : mapping of str to str
        For text: the allowed values and what each means. Empty for free text.
    """

    name: str
    default: Value
    description: str
    unit: Unit = Unit.NONE
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: Mapping[str, str] | None = None

    @property
    def label(self) -> str:
        """The name as a panel shows it."""
        return self.name.replace("_", " ").title()

    def parse(self, text: str) -> Value:
        """Read the value a user typed; angles in degrees.

        Raises
        ------
        ScanstageError
            The text is no such value, or the value is not allowed.
        """
        kind = type(self.default)
        try:
            if kind is bool:
                return {"true": True, "yes": True, "1": True, "on": True,
                        "false": False, "no": False, "0": False, "off": False}[text.strip().lower()]
            value = kind(text)
        except (KeyError, ValueError):
            words = {bool: "true or false", int: "a whole number", float: "a number"}
            raise ScanstageError(f"option {self.name}: {text!r} is not {words[kind]}") from None
        if self.unit is Unit.ANGLE:
            value = math.radians(value)
        return self.check(value)

    def check(self, value: Value) -> Value:
        """Return ``value`` if it is allowed, as the option's type.

        Raises
        ------
        ScanstageError
            It is of another type, not finite, out of bounds or none of the choices.
        """
        kind = type(self.default)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            try:
                value = float(value)
            except OverflowError:
                raise ScanstageError(f"option {self.name}: the number is too large") from None
        if type(value) is not kind:
            raise ScanstageError(f"option {self.name}: {value!r} is not of type {kind.__name__}")
        if kind in (int, float) and not ((kind is int or math.isfinite(value)) and self.minimum <= value <= self.maximum):
            raise ScanstageError(f"option {self.name}: {self.show(value)} is not {self._range()}")
        if self.choices and value not in self.choices:
            raise ScanstageError(f"option {self.name}: {value!r} is none of {', '.join(self.choices)}")
        return value

    def show(self, value: Value) -> str:
        """Return the value as a user reads it, with its unit."""
        if self.unit is Unit.ANGLE:
            value = math.degrees(value)
        text = f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)
        return f"{text} {self.unit.value}".rstrip()

    def _range(self) -> str:
        if math.isinf(self.maximum):
            return f"at least {self.show(self.minimum)}"
        if math.isinf(self.minimum):
            return f"at most {self.show(self.maximum)}"
        return f"from {self.show(self.minimum)} to {self.show(self.maximum)}"


def resolve(options: Iterable[Option], given: Mapping[str, Value], owner: str) -> dict[str, Value]:
    """Return a value for every option: the given one, checked, or the default.

    Parameters
    ----------
    options : iterable of Option
    given : mapping
        Text is parsed as a user's; anything else is checked as a program's.
    owner : str
        Whose options these are, for the error message.

    Raises
    ------
    ScanstageError
        A given name is not an option, or its value is not allowed.
    """
    table = {option.name: option for option in options}
    for name in given:
        if name not in table:
            known = ", ".join(table) or "none"
            raise ScanstageError(f"{owner} has no option {name!r}; its options are: {known}")
    values = {}
    for name, option in table.items():
        value = given.get(name, option.default)
        is_text = isinstance(value, str) and not isinstance(option.default, str)
        values[name] = option.parse(value) if is_text else option.check(value)
    return values
