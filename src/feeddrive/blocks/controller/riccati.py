"""The steady solution of a sampled Riccati equation, in plain arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from feeddrive.language import matrix
from feeddrive.language.matrix import Matrix, Row

DOUBLINGS = 14  # 2¹⁴ samples: exact to rounding where a motion decays by e in less than a thousand of them


def steady(transition: Matrix, measured: Matrix, added: Matrix) -> Matrix:
    """P of P = A (P⁻¹ + Y)⁻¹ Aᵀ + Q: the covariance of a filter before its correction, with A, Y = Cᵀ R⁻¹ C and Q.

    With A = Φᵀ, Y = Γ R⁻¹ Γᵀ and Q the weight of the states it is the cost of a controller.  By the doubling that goes
    2ⁿ samples in n steps, with A, Y and P = Q at first:

        N = 1 + P Y,   P <- P + A N⁻¹ P Aᵀ,   Y <- Y + Aᵀ Y N⁻¹ A,   A <- A N⁻¹ A

    P and Y are symmetric, and of each product that is, one half is computed.  Elimination in N takes no pivots: its
    eigenvalues are real and at least 1.
    Source: Anderson & Moore 1979, section 6.7.
    """
    a, y, p = transition, measured, added
    n = len(a)
    one = tuple(tuple(1.0 if i == j else 0.0 for j in range(n)) for i in range(n))
    for _ in range(DOUBLINGS):
        turned = _transposed(a)
        both = matrix.solve(
            matrix.add(one, matrix.multiply(p, y)),
            [[*row, *other] for row, other in zip(a, matrix.multiply(p, turned), strict=True)],
        )
        u, v = tuple(row[:n] for row in both), tuple(row[n:] for row in both)
        p = matrix.add(p, _symmetric(a, v))
        y = matrix.add(y, _symmetric(turned, matrix.multiply(y, u)))
        a = matrix.multiply(a, u)
    return p


def outer(column: Row, factor: Any = 1.0) -> Matrix:
    """factor · c cᵀ."""
    scaled = [factor * x if not matrix.is_zero(x) else 0.0 for x in column]
    return tuple(tuple(0.0 if matrix.is_zero(x) or matrix.is_zero(y) else x * y for y in column) for x in scaled)


def _transposed(a: Matrix) -> Matrix:
    return tuple(zip(*a, strict=True))


def _symmetric(a: Sequence[Row], b: Sequence[Row]) -> Matrix:
    """A·B, of which it is known that it is symmetric."""
    columns = list(zip(*b, strict=True))
    n = len(a)
    upper = [[matrix.dot(a[i], columns[j]) if j >= i else 0.0 for j in range(n)] for i in range(n)]
    return tuple(tuple(upper[min(i, j)][max(i, j)] for j in range(n)) for i in range(n))
