"""Stability of a polynomial, for validity rules that are evaluated with numbers or traced."""

from collections.abc import Callable, Sequence
from typing import Any

from feeddrive.language import ops
from feeddrive.language.block import Number


def is_stable(coefficients: Sequence[Number]) -> Any:
    """Return True if c0 + c1 w + ... + cn wⁿ has all roots in Re w < 0 (Routh 1877); cn must be positive."""
    above, below = list(coefficients[::-2]), list(coefficients[-2::-2])
    holds: Any = True
    while below:
        holds = ops.both(holds, ops.both(below[0] > 0.0, above[0] > 0.0))
        # where below[0] <= 0 the answer is no already: the 1 only avoids a division by 0 in the unused rest
        ratio = above[0] / ops.where(below[0] > 0.0, below[0], 1.0)
        rest = [*below[1:], 0.0]
        above, below = below, [a - ratio * b for a, b in zip(above[1:], rest, strict=False)]
    return ops.both(holds, above[0] > 0.0)


def product(a: Sequence[Number], b: Sequence[Number]) -> list[Any]:
    """Return the product of two polynomials."""
    coefficients: list[Any] = [0.0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            coefficients[i + j] = coefficients[i + j] + x * y
    return coefficients


def largest_share(admits: Callable[[float], bool]) -> float:
    """Return the largest admissible share in [0, 1], approached from below by bisection; 0 if there is none.

    All smaller shares must be admissible too.
    """
    low, high = 0.0, 1.0
    # 2⁻⁶⁰ is below the spacing of doubles near 1
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if admits(middle) else (low, middle)
    return low
