"""`//` and `%` of floats as Python defines them, by exact steps: no library is called.

The compiler puts them where a kernel divides floats so. They are written in the language of kernels; the interpreter
runs its own.
"""

from __future__ import annotations

from feeddrive.language.kernels.source import readable

_INFINITY = float("inf")
_WHOLE = 4503599627370496.0  # 2⁵²: from here on every float is a whole number


@readable
def left_over(x: float, y: float) -> float:
    """X minus the whole multiple of y next to it towards 0 (C's fmod), exactly; NaN where x is infinite or y is 0.

    y is doubled up to x, then subtracted wherever it fits: a difference of numbers within a factor of 2 is exact.
    """
    rest, part = abs(x), abs(y)
    if not (rest < _INFINITY and part > 0.0):
        return x - x if part == part else y
    if part == _INFINITY:
        return x
    least = part
    while part + part <= rest:
        part = part + part
    while part >= least and rest > 0.0:
        if part <= rest:
            rest = rest - part
        part = part * 0.5
    return rest if x > 0.0 else -rest


@readable
def modulo(x: float, y: float) -> float:
    """X % y: with the sign of y."""
    rest = left_over(x, y)
    if rest == 0.0:
        return 0.0 if y > 0.0 else -0.0
    if (y < 0.0) != (rest < 0.0):
        rest = rest + y
    return rest


@readable
def floor_division(x: float, y: float) -> float:
    """X // y: (x - remainder) / y, rounded to a whole number."""
    rest = left_over(x, y)
    quotient = (x - rest) / y
    if rest != 0.0 and (y < 0.0) != (rest < 0.0):
        quotient = quotient - 1.0
    if quotient == 0.0:
        ratio = x / y
        return -0.0 if ratio < 0.0 else (0.0 if ratio > 0.0 else ratio)
    if not abs(quotient) < _WHOLE:
        return quotient
    down = float(int(quotient))
    if down > quotient:
        down = down - 1.0
    if quotient - down > 0.5:
        down = down + 1.0
    return down
