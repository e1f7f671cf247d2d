"""Whether a polynomial is stable, for `fits`: on numbers, never in a trace."""

from __future__ import annotations

from collections.abc import Callable, Sequence


def is_stable(coefficients: Sequence[float]) -> bool:
    """True if c0 + c1 w + ... + cn wⁿ has all roots in Re w < 0 (Routh 1877); cn > 0."""
    above = [float(c) for c in coefficients[::-2]]
    below = [float(c) for c in coefficients[-2::-2]]
    while below:
        if not below[0] > 0.0 or not above[0] > 0.0:
            return False
        ratio = above[0] / below[0]
        rest = [*below[1:], 0.0]
        above, below = below, [a - ratio * b for a, b in zip(above[1:], rest, strict=False)]
    return above[0] > 0.0


def product(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """The product of two polynomials."""
    found = [0.0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            found[i + j] += x * y
    return found


def largest_share(admits: Callable[[float], bool]) -> float:
    """The largest share in [0, 1] that is admitted, if all below it are; to 12 digits, from below. 0 if none is."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if admits(middle) else (low, middle)
    return low
