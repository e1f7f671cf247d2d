"""Unit conversion at the interfaces: values are SI inside, and any other unit is always written with its name.

A parameter declares its unit as text ("N s/m", "kg m2", "Hz").  A file may give the same parameter in another unit of
the same dimension by a suffix on the key: `stiffness_N_per_um`, `Kv_m_per_min_per_mm`, `dead_time_us`.

Angle counts as a dimension of its own, so that Hz (= 2π rad/s) and 1/s can never be taken for each other.
"""

from __future__ import annotations

import math
import re
from functools import cache, lru_cache
from typing import Annotated, Any, NamedTuple, TypeAlias, get_args, get_origin, get_type_hints

from feeddrive.language.errors import ParameterError


class Unit(NamedTuple):
    """The unit of a field, declared in its annotation: `force: Annotated[Number, Unit("N")]`."""

    name: str


@cache
def units_of(fields: type) -> dict[str, str]:
    """The unit that each field of a class declares in its annotation; fields without one are left out."""
    found: dict[str, str] = {}
    for name, hint in get_type_hints(fields, include_extras=True).items():
        units = [each.name for each in _metadata(hint) if isinstance(each, Unit)]
        if units:
            found[name] = units[0]
    return found


def _metadata(hint: Any) -> tuple[Any, ...]:
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


# exponents of (m, kg, s, A, rad)
Dimension: TypeAlias = tuple[int, int, int, int, int]

_NONE: Dimension = (0, 0, 0, 0, 0)
_BASE: dict[str, tuple[float, Dimension]] = {
    "m": (1.0, (1, 0, 0, 0, 0)),
    "g": (1e-3, (0, 1, 0, 0, 0)),
    "s": (1.0, (0, 0, 1, 0, 0)),
    "A": (1.0, (0, 0, 0, 1, 0)),
    "rad": (1.0, (0, 0, 0, 0, 1)),
    "N": (1.0, (1, 1, -2, 0, 0)),
    "W": (1.0, (2, 1, -3, 0, 0)),
    "J": (1.0, (2, 1, -2, 0, 0)),
    "V": (1.0, (2, 1, -3, -1, 0)),
    "Hz": (2 * math.pi, (0, 0, -1, 0, 1)),
}
_PREFIX = {"G": 1e9, "M": 1e6, "k": 1e3, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
_OTHER: dict[str, tuple[float, Dimension]] = {
    "kg": (1.0, (0, 1, 0, 0, 0)),
    "t": (1e3, (0, 1, 0, 0, 0)),
    "min": (60.0, (0, 0, 1, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0)),
    "in": (0.0254, (1, 0, 0, 0, 0)),
    "deg": (math.pi / 180, (0, 0, 0, 0, 1)),
    "mdeg": (math.pi / 180e3, (0, 0, 0, 0, 1)),
    "rev": (2 * math.pi, (0, 0, 0, 0, 1)),
    "rpm": (2 * math.pi / 60, (0, 0, -1, 0, 1)),
    "percent": (1e-2, _NONE),
    "1": (1.0, _NONE),
}


def _unit(word: str) -> tuple[float, Dimension]:
    """Factor to SI and dimension of one word such as `mm`, `kHz` or `min` (no exponent)."""
    if word in _OTHER:
        return _OTHER[word]
    if word in _BASE:
        return _BASE[word]
    if len(word) > 1 and word[0] in _PREFIX and word[1:] in _BASE:
        factor, dimension = _BASE[word[1:]]
        return _PREFIX[word[0]] * factor, dimension
    raise ParameterError(f"unit '{word}' is not known")


@lru_cache(maxsize=1024)
def measure(unit: str) -> tuple[float, Dimension]:
    """Factor to SI and dimension of a unit such as `N s/m`, `kg m2`, `N_per_um` or `m_per_min_per_mm`.

    Everything after the first `/` or `per` is divided by; a trailing digit is an exponent.
    Raises ParameterError for a word that is not a unit.
    """
    if unit == "":
        return 1.0, _NONE
    factor, total, sign = 1.0, [0, 0, 0, 0, 0], 1
    for word in re.split(r"[ _]+", unit.replace("/", " per ").replace("(", " ").replace(")", " ").strip()):
        if word == "per":
            sign = -1
            continue
        found = re.fullmatch(r"([A-Za-z]+|1)([0-9]?)", word)
        if found is None:
            raise ParameterError(f"'{word}' in the unit '{unit}' is not a unit")
        size, dimension = _unit(found[1])
        exponent = sign * int(found[2] or 1)
        factor *= size**exponent
        total = [t + exponent * d for t, d in zip(total, dimension, strict=True)]
    return factor, (total[0], total[1], total[2], total[3], total[4])


def factor(given: str, declared: str) -> float:
    """Number by which a value in the unit `given` is multiplied to stand in the unit `declared`.

    Raises ParameterError if `given` is not a unit or has another dimension.
    """
    size, dimension = measure(given)
    declared_size, declared_dimension = measure(declared)
    if dimension != declared_dimension:
        raise ParameterError(f"unit '{given}' does not measure the same thing as '{declared or 'a plain number'}'")
    # kHz to Hz is 1000, not the 999.9999999999999 of its way over rad/s
    return decimal(size / declared_size)


def decimal(value: float) -> float:
    """The number of twelve digits that only rounding tells from `value`, if there is one: 50 times 1e-6 is 5e-05."""
    near = float(f"{value:.12g}")
    return near if abs(near - value) <= 4 * math.ulp(value) else value
