"""The declaration of a field: unit, meaning, bounds, options; and the check of a value against it.

Blocks (`language/block.py`), requests of commands (`workflow/request.py`) and sections of files (`files/section.py`)
declare their fields in this way. `Declared` is their base.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined

LARGEST = sys.float_info.max


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """Declaration of a field; `above`/`below` are open bounds, `least`/`most` closed ones.

    infinite   an infinite value is allowed
    shortest   least number of entries of a table, or of sections under names
    inline     the fields of this part stand among those of the block or section that holds it
    example    the value as a file states it, for messages and documentation
    pattern    regular expression of the names under which sections or values stand
    """

    role: str
    unit: str
    meaning: str
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None
    options: tuple[Any, ...] = ()
    infinite: bool = False
    shortest: int = 0
    inline: bool = False
    example: str = ""
    pattern: str = ""

    def of_axis(self, rotary: bool) -> Declaration:
        """Return the declaration for a rotary axis, in rad, N m and kg m2; unchanged for a linear one."""
        return replace(self, unit=units.turning(self.unit)) if rotary else self

    def bounds(self) -> Text:
        """The bounds as text, such as `> 0 kg and <= 5 kg`; empty if there are none."""
        signs = (("> ", self.above), (">= ", self.least), ("< ", self.below), ("<= ", self.most))
        return joined(
            " and ", (f"{sign}{Quantity(bound, self.unit):6 SI}" for sign, bound in signs if bound is not None)
        )

    def conditions(self, value: Any) -> Iterator[Any]:
        """Yield the conditions on a number or symbol: it is finite, unless declared otherwise, and keeps the bounds."""
        yield value >= (-math.inf if self.infinite else -LARGEST)
        yield value <= (math.inf if self.infinite else LARGEST)
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
    if math.isnan(number) or (math.isinf(number) and not declaration.infinite):
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


class Declared:
    """Base of frozen dataclasses whose fields are declared: blocks, requests, sections of files.

    A value checks itself when it is made: each field against its declaration, then all of them together by `check`.
    """

    def __post_init__(self) -> None:
        for name, declaration in declarations(type(self)).items():
            object.__setattr__(self, name, self._checked(name, declaration, getattr(self, name)))
        self.require()

    @abstractmethod
    def _checked(self, name: str, declaration: Declaration, value: Any) -> Any:
        """Return the value of a field as it is kept. Raise ParameterError if it does not fit its declaration."""

    def check(self) -> None:
        """Raise an error for fields that do not fit each other (empty hook)."""

    def require(self) -> None:
        """Raise the error of `check`."""
        self.check()


@cache
def declarations(kind: type[Declared]) -> dict[str, Declaration]:
    """Return the declarations of the fields by name, in the order of the class; the result must not be changed."""
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    return {spec.name: spec.metadata["declaration"] for spec in fields}


@cache
def defaults(kind: type[Declared]) -> dict[str, Any]:
    """Return the defaults of the fields that have one; the result must not be changed."""
    values: dict[str, Any] = {}
    for spec in dataclasses.fields(kind):  # type: ignore[arg-type]
        if spec.default is not dataclasses.MISSING:
            values[spec.name] = spec.default
        elif spec.default_factory is not dataclasses.MISSING:
            values[spec.name] = spec.default_factory()
    return values
