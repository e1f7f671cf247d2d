"""The operations that a law may use beside + - * / and comparisons, for float, array and symbol alike.

Both branches of `where` are always computed: guard arguments (`sqrt(maximum(v, tiny))`).
NaN in a signal passes through `minimum`, `maximum` and `clip`; it is the loop's guard that stops it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.language import mathematics
from feeddrive.language.graph import Symbol

__all__ = [
    "absolute", "atan", "atan2", "both", "clip", "cos", "either", "equal", "exp", "expm1", "exponent", "floor",
    "gather", "interpolate", "log", "maximum", "minimum", "most", "no", "normal", "pi", "power", "power_of_two",
    "quantise", "sign", "sin", "sqrt", "tan", "tanh", "uniform", "where",
]  # fmt: skip

pi = 3.141592653589793


def _apply(name: str, *arguments: Any) -> Symbol | None:
    """The operation on symbols, or None if no argument is one."""
    for argument in arguments:
        if isinstance(argument, Symbol):
            return argument.graph.apply(name, *arguments)
    return None


def where(condition: Any, a: Any, b: Any) -> Any:
    """`a` where the condition is true, else `b`; what is not selected cannot leak."""
    symbol = _apply("select", condition, a, b)
    if symbol is not None:
        return symbol
    if isinstance(condition, np.ndarray) or isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.where(condition, a, b)
    return np.float64(a) if condition else np.float64(b)


def both(a: Any, b: Any) -> Any:
    """True where both truth values are."""
    symbol = _apply("and", a, b)
    return symbol if symbol is not None else np.logical_and(a, b)


def either(a: Any, b: Any) -> Any:
    """True where at least one truth value is."""
    symbol = _apply("or", a, b)
    return symbol if symbol is not None else np.logical_or(a, b)


def no(a: Any) -> Any:
    """True where the truth value is false."""
    symbol = _apply("not", a)
    return symbol if symbol is not None else np.logical_not(a)


def equal(a: Any, b: Any) -> Any:
    """True where two numbers are equal."""
    symbol = _apply("eq", a, b)
    return symbol if symbol is not None else np.equal(a, b)


def absolute(x: Any) -> Any:
    """|x|."""
    symbol = _apply("abs", x)
    return symbol if symbol is not None else np.abs(x)


def sqrt(x: Any) -> Any:
    """√x, correctly rounded; NaN for x < 0."""
    symbol = _apply("sqrt", x)
    return symbol if symbol is not None else np.sqrt(x)


def floor(x: Any) -> Any:
    """Largest whole number not above x. Its derivative is 0."""
    symbol = _apply("floor", x)
    return symbol if symbol is not None else np.floor(x)


def minimum(a: Any, b: Any) -> Any:
    """The smaller number; `a` if one of them is NaN."""
    return where(b < a, b, a)


def maximum(a: Any, b: Any) -> Any:
    """The larger number; `a` if one of them is NaN."""
    return where(b > a, b, a)


def clip(x: Any, low: Any, high: Any) -> Any:
    """x held between two bounds; a NaN stays NaN."""
    return minimum(maximum(x, low), high)


def sign(x: Any) -> Any:
    """-1, 0 or 1."""
    return where(x > 0.0, 1.0, where(x < 0.0, -1.0, 0.0))


def exp(x: Any) -> Any:
    """eˣ."""
    symbol = _apply("exp", x)
    return symbol if symbol is not None else mathematics.exp(x)


def expm1(x: Any) -> Any:
    """eˣ - 1, exact to the last bits for small x."""
    symbol = _apply("expm1", x)
    return symbol if symbol is not None else mathematics.expm1(x)


def log(x: Any) -> Any:
    """Natural logarithm; NaN for x < 0, -inf for 0."""
    symbol = _apply("log", x)
    return symbol if symbol is not None else mathematics.log(x)


def sin(x: Any) -> Any:
    """Sine of an angle in rad; NaN beyond 1e9 rad, where the angle itself has lost its meaning."""
    symbol = _apply("sin", x)
    return symbol if symbol is not None else mathematics.sin(x)


def cos(x: Any) -> Any:
    """Cosine of an angle in rad; NaN beyond 1e9 rad."""
    symbol = _apply("cos", x)
    return symbol if symbol is not None else mathematics.cos(x)


def tan(x: Any) -> Any:
    """Tangent of an angle in rad."""
    return sin(x) / cos(x)


def tanh(x: Any) -> Any:
    """Hyperbolic tangent."""
    symbol = _apply("tanh", x)
    return symbol if symbol is not None else mathematics.tanh(x)


def atan(x: Any) -> Any:
    """Arc tangent in rad."""
    symbol = _apply("atan", x)
    return symbol if symbol is not None else mathematics.atan(x)


def atan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y) in rad, in (-π, π]; 0 at the origin."""
    safe = where(equal(x, 0.0), 1.0, x)
    angle = atan(y / safe)
    beside = where(x < 0.0, where(y < 0.0, angle - pi, angle + pi), angle)
    return where(equal(x, 0.0), where(y > 0.0, 0.5 * pi, where(y < 0.0, -0.5 * pi, 0.0)), beside)


def power(x: Any, y: Any) -> Any:
    """xʸ for x > 0, as e^(y ln x); its relative error grows with |y ln x|."""
    return exp(y * log(x))


def power_of_two(k: Any) -> Any:
    """2ᵏ for a whole number k in -1022 .. 1023, exact."""
    symbol = _apply("power_of_two", k)
    return symbol if symbol is not None else mathematics.power_of_two(k)


def exponent(x: Any) -> Any:
    """The whole number k with 2ᵏ <= |x| < 2ᵏ⁺¹, for a normal number x."""
    symbol = _apply("exponent", x)
    return symbol if symbol is not None else mathematics.exponent(x)


def quantise(x: Any, step: Any) -> Any:
    """x rounded to the nearest multiple of `step`: step · floor(x/step + 1/2).

    Its derivative to x is taken as 1: margins and gradients are those of the loop without the quantiser.
    """
    symbol = _apply("quantise", x, step)
    return symbol if symbol is not None else step * np.floor(x / step + 0.5)


def gather(row: Any, index: Any) -> Any:
    """The entry of a table at a whole-number index, held to the table's ends. The only read from memory.

    Its derivative is 0: interpolation is written around it.
    """
    symbol = _apply("gather", row, index)
    if symbol is not None:
        return symbol
    place = clip(index, 0.0, float(len(row) - 1))
    place = np.where(place == place, place, 0.0)  # a NaN index reads the first entry
    found = row[np.asarray(place, dtype=np.int64)]
    return found if isinstance(index, np.ndarray) else np.float64(found)


def interpolate(row: Any, place: Any) -> Any:
    """Linear interpolation in a table at a real place (0 = first entry), held to its ends."""
    below = floor(place)
    left = gather(row, below)
    right = gather(row, below + 1.0)
    share = where(place < 0.0, 0.0, place - below)
    return left + share * (right - left)


def uniform(seed: Any, sample: Any, channel: Any) -> Any:
    """A random number in (0, 1) that depends on nothing but three whole numbers in 0 .. 2⁵³."""
    symbol = _apply("uniform", seed, sample, channel)
    return symbol if symbol is not None else mathematics.uniform(seed, sample, channel)


def normal(seed: Any, sample: Any, channel: Any) -> Any:
    """A random number with mean 0 and standard deviation 1 (Box & Muller 1958), from two uniform ones."""
    radius = sqrt(-2.0 * log(uniform(seed, sample, 2.0 * channel)))
    return radius * cos(2.0 * pi * uniform(seed, sample, 2.0 * channel + 1.0))


def most(x: Any, unknown: float) -> float:
    """The largest value over lanes as a plain number, or `unknown` for a symbol: a bound for loops of fixed count."""
    return unknown if isinstance(x, Symbol) else float(np.max(x))
