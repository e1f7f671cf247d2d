"""Operations that a processor executes in one or a few instructions, for floats, arrays and symbols.

`mathematics.py` builds the elementary functions from them; `ops.py` contains all that a law may use.
"""

import math
from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any

import numpy as np

from feeddrive.language.graph import Symbol


class Composite(ABC):
    """A number that is made of several numbers, such as a Taylor series or an interval (`series.py`).

    It supports + - *, and sine and cosine by `ops.sin` and `ops.cos`.
    """

    # numpy leaves array * composite to the composite, in place of making an array of objects
    __array_ufunc__ = None

    @abstractmethod
    def waves(self) -> tuple[Any, Any]:
        """Compute the sine and cosine of an angle in rad."""

    @cached_property
    def sine_cosine(self) -> tuple[Any, Any]:
        """The sine and cosine of an angle in rad, computed once."""
        return self.waves()


def on_symbols(name: str, *arguments: Any) -> Symbol | None:
    """Return the symbol of an operation on the arguments, or None if no argument is a symbol."""
    for argument in arguments:
        if isinstance(argument, Symbol):
            return argument.graph.apply(name, *arguments)
    return None


def where(condition: Any, a: Any, b: Any) -> Any:
    """Return `a` where the condition is true, otherwise `b`; the other value has no effect, even if it is NaN."""
    symbol = on_symbols("select", condition, a, b)
    if symbol is not None:
        return symbol
    if isinstance(condition, np.ndarray) or isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.where(condition, a, b)
    # numpy's number in a single run, too: it divides by 0 as IEEE 754 says
    return np.float64(a) if condition else np.float64(b)


def zero(x: Any) -> Any:
    """Return zero in the type of x: a number, an array over variants, or a constant of the trace."""
    if isinstance(x, Symbol):
        return x.graph.constant(0.0)
    return np.zeros_like(x)[()] if isinstance(x, np.ndarray | np.floating) else np.float64(0.0)


def both(a: Any, b: Any) -> Any:
    """Return True where both conditions are true."""
    symbol = on_symbols("and", a, b)
    return symbol if symbol is not None else np.logical_and(a, b)


def either(a: Any, b: Any) -> Any:
    """Return True where at least one condition is true."""
    symbol = on_symbols("or", a, b)
    return symbol if symbol is not None else np.logical_or(a, b)


def no(a: Any) -> Any:
    """Return True where the condition is false."""
    symbol = on_symbols("not", a)
    return symbol if symbol is not None else np.logical_not(a)


def equal(a: Any, b: Any) -> Any:
    """Return True where two numbers are equal."""
    symbol = on_symbols("eq", a, b)
    return symbol if symbol is not None else np.equal(a, b)


def absolute(x: Any) -> Any:
    """Return |x|."""
    symbol = on_symbols("abs", x)
    return symbol if symbol is not None else np.abs(x)


def sqrt(x: Any) -> Any:
    """Return √x, correctly rounded; NaN for x < 0."""
    symbol = on_symbols("sqrt", x)
    if symbol is not None:
        return symbol
    with np.errstate(invalid="ignore"):
        return np.sqrt(x)


def floor(x: Any) -> Any:
    """Return the largest integer <= x. Its derivative is 0."""
    symbol = on_symbols("floor", x)
    return symbol if symbol is not None else np.floor(x)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller number; `a` if either is NaN."""
    # not numpy.minimum, which returns any NaN: a graph has only comparison and selection
    return where(b < a, b, a)


def maximum(a: Any, b: Any) -> Any:
    """Return the larger number; `a` if either is NaN."""
    return where(b > a, b, a)


def clip(x: Any, low: Any, high: Any) -> Any:
    """Limit x to the range from `low` to `high`; a NaN stays NaN."""
    return minimum(maximum(x, low), high)


def sign(x: Any) -> Any:
    """Return the sign of x: -1, 0 or 1."""
    return where(x > 0.0, 1.0, where(x < 0.0, -1.0, 0.0))


def power_of_two(k: Any) -> Any:
    """Return 2ᵏ exactly for an integer k in -1022 .. 1023; outside this range the result is machine-dependent."""
    symbol = on_symbols("power_of_two", k)
    if symbol is not None:
        return symbol
    if isinstance(k, np.ndarray):
        inside = (k >= -1022.0) & (k <= 1023.0)
        # numpy computes before it selects, and a huge k is no integer
        return np.where(inside, np.ldexp(1.0, np.where(inside, k, 0.0).astype(np.int64)), math.nan)
    return np.float64(math.ldexp(1.0, int(k))) if -1022.0 <= k <= 1023.0 else np.float64(math.nan)


def exponent(x: Any) -> Any:
    """Return the integer k with 2ᵏ <= |x| < 2ᵏ⁺¹ for a normal number x, read from its bits; -1023 for 0."""
    symbol = on_symbols("exponent", x)
    if symbol is not None:
        return symbol
    bits = np.asarray(x, dtype=np.float64).view(np.int64)
    k = ((bits >> 52) & 0x7FF) - 1023
    return k.astype(np.float64) if isinstance(x, np.ndarray) else np.float64(k)


def quantise(x: Any, step: Any) -> Any:
    """Round x to the nearest multiple of `step`: step · floor(x/step + 1/2).

    Its derivative with respect to x is taken as 1: margins and gradients are those of the loop without the quantizer.
    """
    symbol = on_symbols("quantise", x, step)
    return symbol if symbol is not None else step * np.floor(x / step + 0.5)


def gather(row: Any, index: Any) -> Any:
    """Return the table entry at an integer index, clamped to the table. No other operation reads a table.

    Its derivative is 0: the gradient of a table lookup comes from the interpolation between entries.
    """
    symbol = on_symbols("gather", row, index)
    if symbol is not None:
        return symbol
    place = clip(index, 0.0, float(len(row) - 1))
    place = np.where(place == place, place, 0.0)  # a NaN index reads the first entry
    cells = row[np.asarray(place, dtype=np.int64)]
    return cells if isinstance(index, np.ndarray) else np.float64(cells)


def length(row: Any) -> int:
    """Return the number of entries of a table."""
    return row.graph.nodes[row.index][2] if isinstance(row, Symbol) else len(row)


def interpolate(row: Any, place: Any) -> Any:
    """Interpolate linearly in a table at a real-valued index (0 = first entry), clamped to its ends."""
    below = floor(place)
    left = gather(row, below)
    right = gather(row, below + 1.0)
    share = where(place < 0.0, 0.0, place - below)
    return left + share * (right - left)


# The two multipliers of SplitMix64; its increment is the first stride. Odd factors lose no bits modulo 2⁶⁴.
MIX = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
STRIDES = (0x9E3779B97F4A7C15, 0xD1B54A32D192ED03, 0x8CB92BA72F3D8DD7)


def uniform(seed: Any, sample: Any, channel: Any) -> Any:
    """Return a random number in (0, 1) that depends only on three integers in 0 .. 2⁵³.

    It is (h + 1/2) / 2⁵² with h the upper 52 bits of a hash of the three integers.

    The hash applies the finalizer of SplitMix64 (Steele, Lea, Flood 2014) once for each of these integers.
    """
    symbol = on_symbols("uniform", seed, sample, channel)
    if symbol is not None:
        return symbol
    lanes = any(isinstance(number, np.ndarray) for number in (seed, sample, channel))
    with np.errstate(over="ignore"):
        bits = np.uint64(0)
        for number, stride in zip((seed, sample, channel), STRIDES, strict=True):
            # + 1: the mixing maps 0 to 0, and seed, sample and channel all start at 0
            bits = bits + np.asarray(number).astype(np.uint64) + np.uint64(1)
            bits = bits * np.uint64(stride)
            bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(MIX[0])
            bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(MIX[1])
            bits = bits ^ (bits >> np.uint64(31))
    # + 1/2 keeps the number off 0 and 1, since `normal` takes its logarithm
    share = ((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    return share if lanes else np.float64(share)


def most(x: Any, unknown: float) -> float:
    """Return the largest value over all variants as a plain number, to bound the iterations of a fixed-count loop.

    For a symbol, return the bound from its graph (`Graph.counted`), or `unknown` if there is none.
    """
    if isinstance(x, Symbol):
        return unknown if x.graph.counted is None else x.graph.counted(x)
    return float(np.max(x))
