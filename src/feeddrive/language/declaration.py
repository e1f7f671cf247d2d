"""The declaration of a field: unit, meaning, bounds, options; and the check of a value against it.

Blocks (`language/block.py`) and requests (`workflow/request.py`) declare their fields in this way.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined

LARGEST = sys.float_info.max


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """Declaration of a field; `above`/`below` are open bounds, `least`/`most` closed ones."""

    role: str
    unit: str
    meaning: str
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None
    options: tuple[Any, ...] = ()
    inline: bool = False  # of a part: its fields stand among those of the block that holds it

    def of_axis(self, rotary: bool) -> Declaration:
        """The same on an axis that turns: in rad, N m and kg m2."""
        return replace(self, unit=units.turning(self.unit)) if rotary else self

    def bounds(self) -> Text:
        """The bounds as text, such as `> 0 kg and <= 5 kg`; empty if there are none."""
        signs = (("> ", self.above), (">= ", self.least), ("< ", self.below), ("<= ", self.most))
        return joined(
            " and ", (f"{sign}{Quantity(bound, self.unit):6 SI}" for sign, bound in signs if bound is not None)
        )

    def conditions(self, value: Any) -> Iterator[Any]:
        """What must be true of a number or a symbol: it is finite and keeps the bounds."""
        yield value >= -LARGEST
        yield value <= LARGEST
        if self.above is not None:
            yield value > self.above
        if self.least is not None:
            yield value >= self.least
        if self.below is not None:
            yield value < self.below
        if self.most is not None:
            yield value <= self.most

    def admits(self, value: float) -> bool:
        """True if a value is finite and keeps the bounds."""
        return all(self.conditions(value))


def check_bounds(where: str, declaration: Declaration, number: float) -> None:
    """Raise ParameterError for a number that is not finite or outside its bounds."""
    shown = f"{where} = {Quantity(number, declaration.unit):6 SI}"
    if not math.isfinite(number):
        raise ParameterError(f"{shown} ({declaration.meaning}) must be a finite number")
    if not declaration.admits(number):
        raise ParameterError(f"{shown} ({declaration.meaning}) must be {declaration.bounds()}")


def check_choice(where: str, declaration: Declaration, value: Any) -> None:
    """Raise ParameterError for a value that is not one of the options, or not a whole number within the bounds."""
    if declaration.options and value not in declaration.options:
        allowed = ", ".join(repr(option) for option in declaration.options)
        raise ParameterError(f"{where} = {value!r} ({declaration.meaning}) must be one of {allowed}")
    if declaration.least is not None:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ParameterError(f"{where} = {value!r} ({declaration.meaning}) must be a whole number")
        if value < declaration.least:
            raise ParameterError(
                f"{where} = {value} ({declaration.meaning}) must be >= {Quantity(declaration.least):6}"
            )
    if declaration.most is not None and value > declaration.most:
        raise ParameterError(f"{where} = {value} ({declaration.meaning}) must be <= {Quantity(declaration.most):6}")
