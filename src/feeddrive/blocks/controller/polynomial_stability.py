"""Whether all roots of a polynomial lie inside the unit circle, for `fits`: on numbers, never in a trace."""

from __future__ import annotations

from collections.abc import Callable, Sequence


def is_stable(coefficients: Sequence[float]) -> bool:
    """True if c0 zⁿ + c1 zⁿ⁻¹ + ... + cn has all roots in |z| < 1 (Schur & Cohn; the table of Jury 1962)."""
    row = [float(c) for c in coefficients]
    while len(row) > 1:
        if abs(row[-1]) >= abs(row[0]):
            return False
        ratio = row[-1] / row[0]
        row = [a - ratio * b for a, b in zip(row[:-1], row[:0:-1], strict=True)]
    return row[0] != 0.0


def product(a: Sequence[float], b: Sequence[float]) -> list[float]:
    """The product of two polynomials."""
    found = [0.0] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            found[i + j] += x * y
    return found


def largest_share(admits: Callable[[float], bool]) -> float:
    """The largest share in (0, 1] that is admitted, if all below it are; to 12 digits, from below."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if admits(middle) else (low, middle)
    return low
