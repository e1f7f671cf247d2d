"""Elementary functions in plain arithmetic: bit-identical in Python, native code, SIMD vectors and C on every machine.

The functions of NumPy, libm and compilers differ in the last bit, so none of them can serve as the definition.  Each
function here is a range reduction and a power series, truncated where the next term is below 2⁻⁵⁵ of the result and
summed in pairs (Estrin's scheme), so that a processor can work on several terms in parallel.  No branch depends on a
value: `where` selects.

For the accuracy against 50-digit arithmetic see docs/reference/accuracy.md.
The functions are valid everywhere; sin and cos return NaN beyond 1e9 rad.
"""

import math
from collections.abc import Sequence
from typing import Any

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

# ln 2 and π/2 as sums of shorter and shorter numbers.  The high parts have so many zero bits at their ends that
# k times them is exact for every k that can occur.
LN2_HIGH = float.fromhex("0x1.62e42fefa0000p-1")
LN2_LOW = float.fromhex("0x1.cf79abc9e3b3ap-40")
HALF_PI = tuple(
    map(
        float.fromhex,
        ("0x1.921fb40000000p+0", "0x1.4442d00000000p-24", "0x1.8469880000000p-48", "0x1.8cc51701b839ap-72"),
    )
)

# Beyond these arguments eˣ counts as infinite (2¹⁰²³·⁵) and as 0 (2⁻¹⁰²¹).
# 1e-9 less: k = floor(x/ln 2 + ½) must not become 1024, for which there is no 2ᵏ
EXP_MOST = 1023.5 * math.log(2.0) - 1e-9
EXP_LEAST = -1021.0 * math.log(2.0)


def series(x: Any, coefficients: Sequence[float]) -> Any:
    """Return Σ cᵢ xⁱ, summed in pairs: (c₀ + c₁x) + (c₂ + c₃x)x² + ..."""
    terms: list[Any] = list(coefficients)
    while len(terms) > 1:
        pairs = [terms[i] + terms[i + 1] * x for i in range(0, len(terms) - 1, 2)]
        terms = [*pairs, terms[-1]] if len(terms) % 2 else pairs
        x = x * x
    return terms[0]


_EXP = [1.0 / math.factorial(i) for i in range(14)]


def _reduced_exp(x: Any) -> tuple[Any, Any]:
    """Return k and p with eˣ = 2ᵏ (1 + p) and |p| <= √2 - 1."""
    k = floor(x * (1.0 / math.log(2.0)) + 0.5)
    r = (x - k * LN2_HIGH) - k * LN2_LOW
    # Σ rⁱ/i! from 1 to 13: three parts that are summed at the same time, since friction waits for this function, and r
    # last, since it is by far the largest
    c, r2 = _EXP, r * r
    r4 = r2 * r2
    low = c[2] + c[3] * r
    middle = (c[4] + c[5] * r) + r2 * (c[6] + c[7] * r)
    high = ((c[8] + c[9] * r) + r2 * (c[10] + c[11] * r)) + r4 * (c[12] + c[13] * r)
    return k, r + ((r2 * low + r4 * middle) + (r4 * r4) * high)


def exp(x: Any) -> Any:
    """Return eˣ = 2ᵏ (1 + p). Results below 2⁻¹⁰²¹ are 0, above 2¹⁰²³·⁵ infinite."""
    k, p = _reduced_exp(x)
    # not valid beyond the bounds, where it is not selected
    scale = power_of_two(k)
    result = scale + p * scale
    return where(x > EXP_MOST, math.inf, where(x < EXP_LEAST, 0.0, result))


def expm1(x: Any) -> Any:
    """Return eˣ - 1 = 2ᵏ p + (2ᵏ - 1)."""
    # e⁻⁴⁰ is below half a last digit of 1: the result is -1
    held = clip(x, -40.0, EXP_MOST)
    k, p = _reduced_exp(held)
    scale = power_of_two(k)
    result = scale * p + (scale - 1.0)
    return where(x > EXP_MOST, math.inf, result)


def tanh(x: Any) -> Any:
    """Return tanh x = m / (m + 2) with m = e^(2|x|) - 1, with the sign of x."""
    # tanh 20 rounds to 1
    m = expm1(2.0 * minimum(absolute(x), 20.0))
    size = m / (m + 2.0)
    return where(x < 0.0, -size, size)


_ATANH = [2.0 / (2 * i + 1) for i in range(1, 11)]


def log(x: Any) -> Any:
    """Return ln x = k ln 2 + 2 (f + f³/3 + f⁵/5 + ...) with x = 2ᵏ m, √½ <= m < √2 and f = (m - 1)/(m + 1)."""
    # subnormal numbers have no exponent to be read: scale up
    small = x < 1e-300
    scaled = where(small, x * 2.0**54, x)
    k = exponent(scaled)
    # in two factors, since 2⁻¹⁰²³ is no normal number
    m = (0.5 * scaled) * power_of_two(1.0 - k)
    high = m > math.sqrt(2.0)
    m = where(high, 0.5 * m, m)
    k = where(high, k + 1.0, k) - where(small, 54.0, 0.0)
    f = (m - 1.0) / (m + 1.0)
    square = f * f
    # 2f = (m - 1) - f (m - 1) keeps the bits of m - 1, which is exact
    tail = f * (square * series(square, _ATANH))
    result = k * LN2_HIGH + ((m - 1.0) - (f * (m - 1.0) - (tail + k * LN2_LOW)))
    return _log_ends(x, result)


def _log_ends(x: Any, result: Any) -> Any:
    """Return the logarithm, corrected for special arguments: -inf for 0, inf for inf, NaN for x < 0 and for NaN."""
    result = where(x > 1.7976931348623157e308, math.inf, result)
    result = where(x <= 0.0, where(x < 0.0, sqrt(-1.0 - absolute(x)), -math.inf), result)
    return where(equal(x, x), result, x)


_SIN = [(-1.0) ** i / math.factorial(2 * i + 1) for i in range(1, 9)]
_COS = [(-1.0) ** i / math.factorial(2 * i) for i in range(2, 10)]


def _reduced_angle(x: Any) -> tuple[Any, Any]:
    """Return k and r with x = k π/2 + r and |r| <= π/4, with π/2 split into four parts (Cody & Waite 1980)."""
    # up to 1e9 rad k is below 2³⁰, and its products with the high parts of π/2 are exact
    held = where(absolute(x) <= 1e9, x, 0.0)
    k = floor(held * (2.0 / math.pi) + 0.5)
    r = held
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
    # NaN as the root of a negative number, since a graph refuses NaN as a constant
    return where(absolute(x) <= 1e9, value, sqrt(-1.0 - absolute(x)))


def sin(x: Any) -> Any:
    """Return sin x, computed after the angle is reduced to |r| <= π/4."""
    return _wave(x, 0.0)


def cos(x: Any) -> Any:
    """Return cos x, computed after the angle is reduced to |r| <= π/4."""
    return _wave(x, 1.0)


_ATAN = [(-1.0) ** i / (2 * i + 1) for i in range(1, 22)]
TAN_PI_8 = math.sqrt(2.0) - 1.0


def atan(x: Any) -> Any:
    """Return atan x from the series z - z³/3 + z⁵/5 - ..., after x is reduced to z.

    y = |x|, or 1/|x| if |x| > 1;  z = y, or (y - 1)/(y + 1) if y > tan π/8
    """
    size = absolute(x)
    inverted = size > 1.0
    # the other branch of a choice is computed, too: it must not divide by 0
    y = where(inverted, 1.0 / maximum(size, 1e-300), size)
    turned = y > TAN_PI_8
    z = where(turned, (y - 1.0) / (y + 1.0), y)
    square = z * z
    angle = z + z * (square * series(square, _ATAN))
    angle = where(turned, angle + 0.25 * math.pi, angle)
    angle = where(inverted, 0.5 * math.pi - angle, angle)
    return where(x < 0.0, -angle, angle)
