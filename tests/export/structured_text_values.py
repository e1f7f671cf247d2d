"""Numbers, names and first values of Structured Text, as strict as the machine that runs it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from structured_text_grammar import IllegalTextError, Literal

from feeddrive.export.identifiers import ST_WORDS

LEAST_NORMAL = 2.0**-1022
LEAST_NORMAL_SHORT = 2.0**-126
LEAST_LITERAL, MOST_LITERAL = 1.18e-38, 3.4e38
REALS = ("LREAL", "REAL")
INTEGERS = ("INT", "DINT")


def divide(a: float, b: float) -> float:
    """IEEE 754: by zero as well."""
    if b != 0.0:
        return a / b
    if a == 0.0 or a != a:
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def root(a: float) -> float:
    """IEEE 754: NaN below 0."""
    return math.sqrt(a) if a >= 0.0 else math.nan


def flushed(x: float) -> float:
    """Zero of the same sign for a number below the normal ones."""
    return x if x >= LEAST_NORMAL or x <= -LEAST_NORMAL or x != x else x * 0.0


def short(x: float) -> float:
    """Rounded to 32 bits."""
    with np.errstate(all="ignore"):
        return float(np.float32(x))


def short_flushed(x: float) -> float:
    """Rounded to 32 bits; zero below the normal ones of those."""
    y = short(x)
    return y if y >= LEAST_NORMAL_SHORT or y <= -LEAST_NORMAL_SHORT or y != y else y * 0.0


def to_integer(x: float, kind: str) -> int:
    """A real that is a whole number within an integer's range, since PLCs differ in all others."""
    most = 2**15 if kind == "INT" else 2**31
    if not (-most <= x < most) or x != int(x):
        raise IllegalTextError(f"{x!r} becomes {kind}, which PLCs do differently")
    return int(x)


def truncated(a: int, b: int) -> int:
    """Division of integers, towards zero."""
    return int(a / b) if abs(a) < 2**52 else -(-a // b) if (a < 0) != (b < 0) else a // b


def checked_name(name: str, taken: set[str]) -> None:
    """A new name: no keyword, and not taken in any case."""
    if name.upper() in ST_WORDS:
        raise IllegalTextError(f"{name} is no name")
    if name.upper() in taken:
        raise IllegalTextError(f"{name} is declared twice")
    taken.add(name.upper())


def initial(kind: Any, value: Literal | None) -> Any:
    """The value of a constant that stands in a declaration."""
    if value is None:
        return None
    if value.form == "truth" and kind == "BOOL":
        return value.text == "TRUE"
    if value.form == "real" and kind in REALS:
        return real(value, kind)[0]
    if value.form == "integer" and kind in INTEGERS and value.kind in (None, kind):
        return int(value.text)
    raise IllegalTextError(f"{value.text} cannot be the first value of {kind}")


def real(given: Literal, wanted: str | None = None) -> tuple[float, str]:
    """Value and type of a real literal."""
    value = float(given.text)
    if value != 0.0 and not LEAST_LITERAL <= abs(value) <= MOST_LITERAL:
        raise IllegalTextError(f"{given.text} is beyond a short real, by which matiec reads every literal")
    if given.kind is None:
        if wanted is None and short(value) != value:
            raise IllegalTextError(f"{given.text} needs its type in front: a short real rounds it")
        return (short(value) if wanted == "REAL" else value), wanted or "ANY_REAL"
    if given.kind not in REALS or wanted not in (None, given.kind):
        raise IllegalTextError(f"{given.kind}#{given.text} where {wanted} is needed")
    return (short(value) if given.kind == "REAL" else value), given.kind


class Struct:
    """A value of a structure."""

    def __init__(self, values: dict[str, Any]) -> None:
        self.__dict__.update(values)

    def copy(self) -> Struct:
        return Struct(self.__dict__)
