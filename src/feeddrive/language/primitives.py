"""Operations that a processor executes in one or a few instructions, for float, array and symbol alike.

`mathematics.py` builds the elementary functions from them; `ops.py` contains all that a law may use.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from feeddrive.language.graph import Symbol


def on_symbols(name: str, *arguments: Any) -> Symbol | None:
    """The operation on symbols, or None if no argument is one."""
    for argument in arguments:
        if isinstance(argument, Symbol):
            return argument.graph.apply(name, *arguments)
    return None


def where(condition: Any, a: Any, b: Any) -> Any:
    """`a` where the condition is true, else `b`; the value that is not selected has no effect, even if it is NaN."""
    symbol = on_symbols("select", condition, a, b)
    if symbol is not None:
        return symbol
    if isinstance(condition, np.ndarray) or isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.where(condition, a, b)
    return np.float64(a) if condition else np.float64(b)


def zero(x: Any) -> Any:
    """Zero in the type of x: a number, an array over lanes, or the constant of a trace."""
    if isinstance(x, Symbol):
        return x.graph.constant(0.0)
    return np.zeros_like(x)[()] if isinstance(x, np.ndarray | np.floating) else np.float64(0.0)


def both(a: Any, b: Any) -> Any:
    """True where both truth values are."""
    symbol = on_symbols("and", a, b)
    return symbol if symbol is not None else np.logical_and(a, b)


def either(a: Any, b: Any) -> Any:
    """True where at least one truth value is."""
    symbol = on_symbols("or", a, b)
    return symbol if symbol is not None else np.logical_or(a, b)


def no(a: Any) -> Any:
    """True where the truth value is false."""
    symbol = on_symbols("not", a)
    return symbol if symbol is not None else np.logical_not(a)


def equal(a: Any, b: Any) -> Any:
    """True where two numbers are equal."""
    symbol = on_symbols("eq", a, b)
    return symbol if symbol is not None else np.equal(a, b)


def absolute(x: Any) -> Any:
    """|x|."""
    symbol = on_symbols("abs", x)
    return symbol if symbol is not None else np.abs(x)


def sqrt(x: Any) -> Any:
    """√x, correctly rounded; NaN for x < 0."""
    symbol = on_symbols("sqrt", x)
    if symbol is not None:
        return symbol
    with np.errstate(invalid="ignore"):
        return np.sqrt(x)


def floor(x: Any) -> Any:
    """Largest whole number not above x. Its derivative is 0."""
    symbol = on_symbols("floor", x)
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


def power_of_two(k: Any) -> Any:
    """2ᵏ for a whole number k in -1022 .. 1023, exact; outside of this range the result differs between machines."""
    symbol = on_symbols("power_of_two", k)
    if symbol is not None:
        return symbol
    if isinstance(k, np.ndarray):
        inside = (k >= -1022.0) & (k <= 1023.0)
        return np.where(inside, np.ldexp(1.0, np.where(inside, k, 0.0).astype(np.int64)), math.nan)
    return np.float64(math.ldexp(1.0, int(k))) if -1022.0 <= k <= 1023.0 else np.float64(math.nan)


def exponent(x: Any) -> Any:
    """The whole number k with 2ᵏ <= |x| < 2ᵏ⁺¹ for a normal number x, read from its bits; -1023 for 0."""
    symbol = on_symbols("exponent", x)
    if symbol is not None:
        return symbol
    bits = np.asarray(x, dtype=np.float64).view(np.int64)
    k = ((bits >> 52) & 0x7FF) - 1023
    return k.astype(np.float64) if isinstance(x, np.ndarray) else np.float64(k)


def quantise(x: Any, step: Any) -> Any:
    """x rounded to the nearest multiple of `step`: step · floor(x/step + 1/2).

    Its derivative to x is taken as 1: margins and gradients are those of the loop without the quantizer.
    """
    symbol = on_symbols("quantise", x, step)
    return symbol if symbol is not None else step * np.floor(x / step + 0.5)


def gather(row: Any, index: Any) -> Any:
    """The entry of a table at a whole-number index, held to the table's ends. The only read from memory.

    Its derivative is 0: interpolation is written around it.
    """
    symbol = on_symbols("gather", row, index)
    if symbol is not None:
        return symbol
    place = clip(index, 0.0, float(len(row) - 1))
    place = np.where(place == place, place, 0.0)  # a NaN index reads the first entry
    cells = row[np.asarray(place, dtype=np.int64)]
    return cells if isinstance(index, np.ndarray) else np.float64(cells)


def length(row: Any) -> int:
    """Entries of a table."""
    return row.graph.nodes[row.index][2] if isinstance(row, Symbol) else len(row)


def interpolate(row: Any, place: Any) -> Any:
    """Linear interpolation in a table at a real place (0 = first entry), held to its ends."""
    below = floor(place)
    left = gather(row, below)
    right = gather(row, below + 1.0)
    share = where(place < 0.0, 0.0, place - below)
    return left + share * (right - left)


MIX = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
STRIDES = (0x9E3779B97F4A7C15, 0xD1B54A32D192ED03, 0x8CB92BA72F3D8DD7)


def uniform(seed: Any, sample: Any, channel: Any) -> Any:
    """A random number in (0, 1) that depends only on three whole numbers in 0 .. 2⁵³.

    It is (h + 1/2) / 2⁵² with h the upper 52 bits of a mix of the three whole numbers.

    The mix is the finaliser of SplitMix64 (Steele, Lea, Flood 2014), run once over each of the three.
    """
    symbol = on_symbols("uniform", seed, sample, channel)
    if symbol is not None:
        return symbol
    lanes = any(isinstance(number, np.ndarray) for number in (seed, sample, channel))
    with np.errstate(over="ignore"):
        bits = np.uint64(0)
        for number, stride in zip((seed, sample, channel), STRIDES, strict=True):
            bits = bits + np.asarray(number).astype(np.uint64) + np.uint64(1)
            bits = bits * np.uint64(stride)
            bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(MIX[0])
            bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(MIX[1])
            bits = bits ^ (bits >> np.uint64(31))
    share = ((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    return share if lanes else np.float64(share)


def most(x: Any, unknown: float) -> float:
    """The largest value over lanes as a plain number: a bound for loops of fixed count.

    For a symbol it is the bound of its graph (`Graph.counted`), else `unknown`.
    """
    if isinstance(x, Symbol):
        return unknown if x.graph.counted is None else x.graph.counted(x)
    return float(np.max(x))
