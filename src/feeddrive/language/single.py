"""Elementary functions in single precision, and the reference evaluation of a graph in single precision.

The functions are those of `mathematics.py` with 24 bits instead of 53: the same range reductions with shorter constants
and shorter series, truncated where the next term is below 2⁻²⁷ of the result.  Every constant is a
single-precision number, so that exported code and the reference below use the same constants.  The functions run on the
symbols of a graph whose operations are in single precision: `exponent` and `power_of_two` are those of 32-bit numbers.

For the accuracy against 30-digit arithmetic see docs/reference/accuracy.md.
The functions are valid everywhere; sin and cos return NaN beyond 1e4 rad, where neighboring numbers are a thousandth
of a radian apart.  Subnormal numbers count as 0.

The reference evaluates a graph one operation after the other.  Each operation is rounded separately, subnormal numbers
count as 0 with their sign, and the elementary functions are those above: its results equal those of a float build on
any processor, bit for bit except for the payload of NaN.  Processors differ in one case: an exact result just below
2⁻¹²⁶ that rounds up to 2⁻¹²⁶ is 0 on ARM and here, and 2⁻¹²⁶ on x86.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.language.graph import ELEMENTARY, Graph, Symbol, arguments, reachable, rebuilt
from feeddrive.language.mathematics import series
from feeddrive.language.primitives import (
    absolute,
    clip,
    either,
    equal,
    exponent,
    floor,
    maximum,
    minimum,
    power_of_two,
    sqrt,
    where,
)


def held(value: float) -> float:
    """Round a double to the nearest single-precision number."""
    return float(np.float32(value))


# ln 2 and π/2 as sums of shorter and shorter numbers: k times a high part is exact for every k that can occur, up to
# 2⁸ and 2¹³.
LN2_HIGH = float.fromhex("0x1.62e4p-1")
LN2_LOW = held(float.fromhex("0x1.7f7d1cf79abcap-20"))
HALF_PI = tuple(map(float.fromhex, ("0x1.920p+0", "0x1.fb4p-12", "0x1.444p-24", "0x1.68c234p-39")))

# Beyond these arguments eˣ counts as infinite (2¹²⁷·⁵) and as 0 (2⁻¹²⁵).
# 1e-4 less, as in `mathematics`: k must not become 128
EXP_MOST = held(127.5 * math.log(2.0) - 1e-4)
EXP_LEAST = held(-125.0 * math.log(2.0))
PER_LN2 = held(1.0 / math.log(2.0))
PER_QUARTER = held(2.0 / math.pi)
ROOT_TWO = held(math.sqrt(2.0))
TAN_PI_8 = held(math.sqrt(2.0) - 1.0)
MOST_ANGLE = 1e4  # rad
LEAST_NORMAL = 2.0**-126
LARGEST = float(np.finfo(np.float32).max)

_EXP = [held(1.0 / math.factorial(i)) for i in range(8)]
_ATANH = [held(2.0 / (2 * i + 1)) for i in range(1, 5)]
_SIN = [held((-1.0) ** i / math.factorial(2 * i + 1)) for i in range(1, 5)]
_COS = [held((-1.0) ** i / math.factorial(2 * i)) for i in range(2, 6)]
_ATAN = [held((-1.0) ** i / (2 * i + 1)) for i in range(1, 10)]
# the two halves of π/2 and of π/4, since one float alone would cost a third of a last digit
_HALF_HIGH = held(0.5 * math.pi)
_HALF_LOW = held(0.5 * math.pi - _HALF_HIGH)


def _reduced_exp(x: Any) -> tuple[Any, Any]:
    """Return k and p with eˣ = 2ᵏ (1 + p) and |p| <= √2 - 1."""
    k = floor(x * PER_LN2 + 0.5)
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    return k, r + (r * r) * series(r, _EXP[2:])


def exp(x: Any) -> Any:
    """Return eˣ = 2ᵏ (1 + p). Results below 2⁻¹²⁵ are 0, above 2¹²⁷·⁵ infinite."""
    k, p = _reduced_exp(x)
    # not valid beyond the bounds, where it is not selected
    scale = power_of_two(k)
    # p · scale alone could be below the normal numbers
    result = (1.0 + p) * scale
    return where(x > EXP_MOST, math.inf, where(x < EXP_LEAST, 0.0, result))


def expm1(x: Any) -> Any:
    """Return eˣ - 1 = 2ᵏ p + (2ᵏ - 1)."""
    # e⁻²⁰ is below half a last digit of 1: the result is -1
    k, p = _reduced_exp(clip(x, -20.0, EXP_MOST))
    scale = power_of_two(k)
    result = scale * p + (scale - 1.0)
    return where(x > EXP_MOST, math.inf, result)


def tanh(x: Any) -> Any:
    """Return tanh x = m / (m + 2) with m = e^(2|x|) - 1, with the sign of x."""
    # tanh 10 rounds to 1
    m = expm1(2.0 * minimum(absolute(x), 10.0))
    size = m / (m + 2.0)
    return where(x < 0.0, -size, size)


def log(x: Any) -> Any:
    """Return ln x = k ln 2 + 2 (f + f³/3 + f⁵/5 + ...) with x = 2ᵏ m, √½ <= m < √2 and f = (m - 1)/(m + 1)."""
    k = exponent(x)
    # in two factors, since 2⁻¹²⁷ is no normal number
    m = (0.5 * x) * power_of_two(1.0 - k)
    # here the half would not be normal
    m = where(x < 2.0 * LEAST_NORMAL, x * 2.0**126, m)
    high = m > ROOT_TWO
    m = where(high, 0.5 * m, m)
    k = where(high, k + 1.0, k)
    f = (m - 1.0) / (m + 1.0)
    square = f * f
    # 2f = (m - 1) - f (m - 1) keeps the bits of m - 1, which is exact
    tail = f * (square * series(square, _ATANH))
    result = k * LN2_HIGH + ((m - 1.0) - (f * (m - 1.0) - (tail + k * LN2_LOW)))
    result = where(x > LARGEST, math.inf, result)
    result = where(x < LEAST_NORMAL, where(x < 0.0, sqrt(-1.0 - absolute(x)), -math.inf), result)
    return where(equal(x, x), result, x)


def _reduced_angle(x: Any) -> tuple[Any, Any]:
    """Return k and r with x = k π/2 + r and |r| <= π/4, with π/2 split into four parts (Cody & Waite 1980)."""
    r = where(absolute(x) <= MOST_ANGLE, x, 0.0)
    k = floor(r * PER_QUARTER + 0.5)
    for piece in HALF_PI:
        r = r - k * piece
    return k, r


def _sine_part(r: Any) -> Any:
    square = r * r
    return r + r * (square * series(square, _SIN))


def _cosine_part(r: Any) -> Any:
    square = r * r
    return 1.0 - (0.5 * square - (square * square) * series(square, _COS))


def _wave(x: Any, quarter: float) -> Any:
    """Return sin(x + quarter · π/2)."""
    k, r = _reduced_angle(x)
    turn = k + quarter
    place = turn - 4.0 * floor(0.25 * turn)  # 0, 1, 2 or 3
    odd = either(equal(place, 1.0), equal(place, 3.0))
    size = where(odd, _cosine_part(r), _sine_part(r))
    value = where(place >= 2.0, -size, size)
    return where(absolute(x) <= MOST_ANGLE, value, sqrt(-1.0 - absolute(x)))


def sin(x: Any) -> Any:
    """Return sin x, computed after the angle is reduced to |r| <= π/4."""
    return _wave(x, 0.0)


def cos(x: Any) -> Any:
    """Return cos x, computed after the angle is reduced to |r| <= π/4."""
    return _wave(x, 1.0)


def atan(x: Any) -> Any:
    """Return atan x from the series z - z³/3 + z⁵/5 - ..., after x is reduced to z.

    y = |x|, or 1/|x| if |x| > 1;  z = y, or (y - 1)/(y + 1) if y > tan π/8
    """
    size = absolute(x)
    inverted = size > 1.0
    y = where(inverted, 1.0 / maximum(size, 1.0), size)
    turned = y > TAN_PI_8
    z = where(turned, (y - 1.0) / (y + 1.0), y)
    square = z * z
    angle = z + z * (square * series(square, _ATAN))
    angle = where(turned, (angle + 0.5 * _HALF_LOW) + 0.5 * _HALF_HIGH, angle)
    angle = where(inverted, _HALF_HIGH - (angle - _HALF_LOW), angle)
    return where(x < 0.0, -angle, angle)


FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "exp": exp,
    "expm1": expm1,
    "log": log,
    "sin": sin,
    "cos": cos,
    "tanh": tanh,
    "atan": atan,
}


def single_lowered(graph: Graph, roots: Sequence[int]) -> tuple[Graph, dict[int, int]]:
    """Rebuild a graph with `exp`, `sin` etc. of this module; return it and a map from old to new node indices."""

    def compose(target: Graph, name: str, values: list[Symbol]) -> Symbol:
        return FUNCTIONS[name](*values) if name in ELEMENTARY else target.apply(name, *values)

    return rebuilt(graph, roots, compose)


def single_values(graph: Graph, outputs: Sequence[int], leaves: Mapping[str, Any]) -> list[np.ndarray]:
    """Return the values of the nodes `outputs` in single precision.

    `leaves` are the values of inputs and tables by name: numbers, or arrays of equal length.  Constants and leaves are
    rounded to single precision first.

    Raises KeyError for a missing leaf.
    """
    lowered, place = single_lowered(graph, outputs)
    values_: dict[int, Any] = {}
    with np.errstate(all="ignore"):
        for index in reachable(lowered, [place[i] for i in outputs]):
            node = lowered.nodes[index]
            match node[0]:
                case "const":
                    values_[index] = _flushed(np.float32(float.fromhex(node[1])))
                case "truth":
                    values_[index] = np.bool_(node[1])
                case "input" | "table":
                    values_[index] = _flushed(np.asarray(leaves[node[1]], dtype=np.float64).astype(np.float32))
                case name:
                    value = _OPERATIONS[name](*(values_[i] for i in arguments(node)))
                    values_[index] = _flushed(value) if np.asarray(value).dtype == np.float32 else value
    return [np.asarray(values_[place[i]]) for i in outputs]


def _flushed(x: Any) -> Any:
    """Return x with subnormal numbers replaced by zeros of the same sign."""
    return np.where(np.abs(x) < np.float32(LEAST_NORMAL), np.copysign(np.float32(0.0), x), x)


def _power_of_two(k: Any) -> Any:
    inside = (k >= -126.0) & (k <= 127.0)
    power = np.ldexp(np.float32(1.0), np.where(inside, k, 0.0).astype(np.int32))
    return np.where(inside, power, np.float32(np.nan)).astype(np.float32)


def _exponent(x: Any) -> Any:
    bits = np.asarray(x, dtype=np.float32).view(np.int32)
    return (((bits >> 23) & 0xFF) - 127).astype(np.float32)


def _gather(row: Any, index: Any) -> Any:
    place = np.where(index == index, np.clip(index, 0.0, len(row) - 1.0), 0.0)
    return row[place.astype(np.int64)]


def _quantise(x: Any, step: Any) -> Any:
    # flushed after each operation, as on a target
    return step * np.floor(_flushed(_flushed(x / step) + np.float32(0.5)))


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
    "select": np.where,
    "power_of_two": _power_of_two,
    "exponent": _exponent,
    "gather": _gather,
    "quantise": _quantise,
}
