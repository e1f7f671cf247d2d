"""Unit conversion at the interfaces: internal values are in SI units, and any other unit is always written with its
name.

A parameter declares its unit as a string ("N s/m", "kg m2", "Hz").  A file may give the same parameter in another unit
of the same dimension by a suffix on the key: `stiffness_N_per_um`, `Kv_m_per_min_per_mm`, `dead_time_us`.

Angle is treated as a separate dimension, so that Hz (= 2π rad/s) and 1/s can never be confused.
"""

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
    """Return the units declared in the annotations of a class, by field."""
    by_field: dict[str, str] = {}
    for name, hint in get_type_hints(fields, include_extras=True).items():
        units = [entry.name for entry in _metadata(hint) if isinstance(entry, Unit)]
        if units:
            by_field[name] = units[0]
    return by_field


def _metadata(hint: Any) -> tuple[Any, ...]:
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


# exponents of (m, kg, s, A, rad)
Dimension: TypeAlias = tuple[int, int, int, int, int]

_NONE: Dimension = (0, 0, 0, 0, 0)
# g instead of kg, since these units may have prefixes
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
# Without prefixes, and looked up first: `min` is not a milli-inch.
_OTHER: dict[str, tuple[float, Dimension]] = {
    "kg": (1.0, (0, 1, 0, 0, 0)),
    "t": (1e3, (0, 1, 0, 0, 0)),
    "min": (60.0, (0, 0, 1, 0, 0)),
    "h": (3600.0, (0, 0, 1, 0, 0)),
    "in": (0.0254, (1, 0, 0, 0, 0)),
    "deg": (math.pi / 180, (0, 0, 0, 0, 1)),
    "mdeg": (math.pi / 180e3, (0, 0, 0, 0, 1)),
    "arcmin": (math.pi / 10800, (0, 0, 0, 0, 1)),
    "arcsec": (math.pi / 648000, (0, 0, 0, 0, 1)),
    "rev": (2 * math.pi, (0, 0, 0, 0, 1)),
    "U": (2 * math.pi, (0, 0, 0, 0, 1)),  # Umdrehung: U/min is rpm, mm/U a lead
    "rpm": (2 * math.pi / 60, (0, 0, -1, 0, 1)),
    "percent": (1e-2, _NONE),
    "permille": (1e-3, _NONE),
    "1": (1.0, _NONE),
}


WORD = f"[{''.join(_PREFIX)}]?(?:{'|'.join(_BASE)})|{'|'.join(_OTHER)}"
"""A regular expression of all units of one word."""


def _unit(word: str) -> tuple[float, Dimension]:
    """Return the factor to SI and the dimension of a single word such as `mm`, `kHz` or `min` (no exponent)."""
    if word in _OTHER:
        return _OTHER[word]
    if word in _BASE:
        return _BASE[word]
    if len(word) > 1 and word[0] in _PREFIX and word[1:] in _BASE:
        factor, dimension = _BASE[word[1:]]
        return _PREFIX[word[0]] * factor, dimension
    raise ParameterError(f"unit '{word}' is not known")


_TOKEN = re.compile(r"[/()]|[^ _/()]+")


@lru_cache(maxsize=1024)
def measure(unit: str) -> tuple[float, Dimension]:
    """Return the factor to SI and the dimension of a unit: `N s/m`, `kg m2`, `N_per_um`, `rad/(N m s)` or `(m/s)/N`.

        unit    = product {("/" | "per") product}        each "/" divides by the next product: m/s/N is m/(s N)
        product = factor {(" " | "_") factor}
        factor  = word [digit] | "1" | "(" unit ")"      the digit is an exponent

    Raises ParameterError for a string that violates this grammar, and for a word that is not a unit.
    """
    if unit == "":
        return 1.0, _NONE
    tokens = ["/" if token == "per" else token for token in _TOKEN.findall(unit)]
    size, dimension, end = _quotient(unit, tokens, 0, 0)
    if end < len(tokens):
        raise ParameterError(f"'{tokens[end]}' in the unit '{unit}' has no opening parenthesis")
    return size, dimension


# the parser is recursive, and a unit may come from any file
_DEEPEST = 8  # nesting depth of parentheses


def _quotient(unit: str, tokens: list[str], at: int, depth: int) -> tuple[float, Dimension, int]:
    """Parse products starting at a token; return factor, dimension and the index of the next token."""
    size, total, sign, empty = 1.0, list(_NONE), 1, True
    while at < len(tokens) and tokens[at] != ")":
        token = tokens[at]
        at += 1
        if token == "/":
            if empty and sign < 0:
                raise ParameterError(f"in the unit '{unit}' there is no unit between two strokes")
            sign, empty = -1, True
            continue
        if token == "(":
            if depth == _DEEPEST:
                raise ParameterError(f"the unit '{unit}' has more than {_DEEPEST} nested parentheses")
            part, dimension, at = _quotient(unit, tokens, at, depth + 1)
            if at == len(tokens):
                raise ParameterError(f"in the unit '{unit}' a parenthesis is not closed")
            at, exponent = at + 1, 1
        else:
            match = re.fullmatch(r"([A-Za-z]+|1)([0-9]?)", token)
            if match is None:
                raise ParameterError(f"'{token}' in the unit '{unit}' is not a unit")
            part, dimension = _unit(match[1])
            exponent = int(match[2] or 1)
        empty = False
        size *= part ** (sign * exponent)
        total = [t + sign * exponent * d for t, d in zip(total, dimension, strict=True)]
    if empty:
        raise ParameterError(f"the unit '{unit}' has an empty place where a unit is expected")
    return size, (total[0], total[1], total[2], total[3], total[4]), at


# input and output quantities of the response of an axis, compared by dimension, so that every spelling is recognized
_INPUTS = ("N", "N m", "A", "V")
_OUTPUTS = ("m", "rad", "m/s", "rad/s", "m/s2", "rad/s2")


@lru_cache(maxsize=256)
def response(unit: str) -> tuple[str, float] | None:
    """Return the canonical SI name of a unit of motion per force, current or voltage, and the factor to it.

    `um/N` is m/N times 1e-6, `rad/(s N m)` and `rad/(N m s)` are (rad/s)/(N m), `mm/s/A` is (m/s)/A times 1e-3.
    Returns None for the unit of another quantity. Raises ParameterError for a string that is not a unit.
    """
    # for its error: in the loop a ParameterError only means another quantity
    measure(unit)
    for above in _OUTPUTS:
        for below in _INPUTS:
            name = f"({above})" if "/" in above else above
            name += f"/({below})" if " " in below else f"/{below}"
            try:
                return name, factor(unit, name)
            except ParameterError:
                continue
    return None


# on a rotary axis lengths become angles, forces torques and masses inertias; the numbers are unchanged
_LENGTH, _FORCE = r"[kmunµ]?m", r"[kmun]?N"
_WORD = rf"(?:{_LENGTH}|{_FORCE}|kg|[munµ]?rad|deg|rev|[munµ]?s(?:\^½|\^1/2)?|√s|min|Hz|A|V|1)[2-9²³⁴]?(?![\w^])"
# with a word joiner behind the slash, by which pages keep N/µm on one line
_JOINED = r"(?: |·|/(?:\u2060|&#8288;)?)"
_PRODUCT = rf"(?:\({_WORD}(?:{_JOINED}{_WORD})*\)|{_WORD})"
_UNIT = re.compile(rf"(?<![\w./^√-]){_PRODUCT}(?:{_JOINED}{_PRODUCT})*(?![\w/^]|\.\w| =)")
# units that are already rotary, or that no quantity of an axis has, such as N/m2
_OTHERS = re.compile(r"rad|deg|rev|N[ ·]m(?!\w)|m[2-9²³⁴]")


@lru_cache(maxsize=1024)
def turning(unit: str) -> str:
    """Return the unit that a rotary axis has in place of a unit of a linear axis: N m s/rad for N s/m."""
    if _OTHERS.search(unit):
        return unit
    turned = re.sub(rf"(?<!\w){_LENGTH}(?!\w)", lambda match: f"{match[0][:-1]}rad", unit)
    turned = re.sub(rf"(?<![\w/;\u2060])({_FORCE}|kg)(?!\w)", lambda match: _torque(match[1]), turned)
    return re.sub(rf"(?<=[/;\u2060]){_FORCE}(?!\w)", lambda match: f"({_torque(match[0])})", turned)


def _torque(unit: str) -> str:
    return f"{unit} m2" if unit == "kg" else f"{unit} m"


def in_key(unit: str) -> str:
    """Return a unit in the spelling of key suffixes: `N_per_m_s` for N/(m s)."""
    # a root of seconds has no spelling in a key: such a key names its root itself (rope_snap_ISE_root_m_per_N)
    plain = unit.replace(" √s", "").replace("(", "").replace(")", "")
    return plain.replace("/", "_per_").replace(" ", "_")


def turning_key(key: str) -> str:
    """Return the key of the rotary counterpart: force_peak_N becomes force_peak_N_m; a key without a unit is unchanged.

    The unit is the longest suffix of the key that is a valid unit, so no list of units is needed.
    """
    words = key.split("_")
    for start in range(1, len(words)):
        unit = "_".join(words[start:])
        try:
            measure(unit)
        except ParameterError:
            continue
        return "_".join([*words[:start], in_key(turning(unit.replace("_per_", "/").replace("_", " ")))])
    return key


def turning_docstring(text: str) -> str:
    """Return the docstring of a state or precomputed coefficient with the units of a rotary axis, for an export.

    A docstring contains no quantities, so its units are found by pattern matching.
    """
    return _UNIT.sub(lambda match: turning(match[0]), text)


def factor(unit: str, declared: str) -> float:
    """Return the conversion factor from a unit to the unit `declared`.

    Raises ParameterError if `unit` is not a unit or has another dimension.
    """
    size, dimension = measure(unit)
    declared_size, declared_dimension = measure(declared)
    if dimension != declared_dimension:
        raise ParameterError(f"unit '{unit}' does not measure the same thing as '{declared or 'a plain number'}'")
    # kHz to Hz is 1000, not 999.9999999999999 as via rad/s
    return decimal(size / declared_size)


def scaled(value: Any, factor: float) -> Any:
    """Return value · factor for a number or an array; if 1/factor is an integer (1e-6, 1/60), divide by that integer.

    Dividing by an integer rounds only once: 100 us are 1e-4 s, not 9.999999999999999e-05.
    """
    inverse = decimal(1.0 / factor) if 0.0 < abs(factor) < 1.0 else 0.0
    return value / inverse if inverse and inverse == round(inverse) else value * factor


def shortest(value: float, factor: float) -> str:
    """Return the shortest decimal that `scaled` converts to a value: 0.2 for 2e-7 and the factor 1e-6.

    If no number converts exactly to the value, the quotient is returned; it converts to the value within one rounding
    error.
    """
    near = value / factor
    texts = [f"{near:.{digits}g}" for digits in range(1, 17)]
    # 17 digits: rounding in `scaled` may map a neighbor to the value, but not the quotient itself
    texts += [repr(number) for number in (near, math.nextafter(near, math.inf), math.nextafter(near, -math.inf))]
    return next((text for text in texts if scaled(float(text), factor) == value), repr(near))


def rounded(value: float, digits: int) -> float:
    """Round a number to `digits` significant digits."""
    return float(f"{value:.{digits}g}")


def decimal(value: float) -> float:
    """Round to twelve digits if that removes only a rounding error, otherwise return `value`: 50 · 1e-6 gives 5e-05."""
    near = rounded(value, 12)
    return near if abs(near - value) <= 4 * math.ulp(value) else value
