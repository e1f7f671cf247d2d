"""Polynomials of seventh degree between two states, and points whose hull holds them."""

from __future__ import annotations

from math import comb
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats2, Records

BERNSTEIN_7 = np.array([[comb(k, j) / comb(7, j) if j <= k else 0.0 for j in range(8)] for k in range(8)])
"""Bernstein coefficients of a polynomial of seventh degree from its power coefficients, shape (8, 8)."""


class State(NamedTuple):
    """A coordinate and its first to third derivative with respect to the path parameter."""

    value: float
    first: float
    second: float
    third: float


@kernel
def hermite(a: Records[State], b: Records[State], length: float, out: Floats2) -> int:
    """Write the coefficients of the polynomial in ξ = x/length between two states into `out` (N, 8).

    The coefficients of first to third degree follow from the left state, the others from the residual at the right
    state.
    """
    for i in range(len(a)):
        left = a[i]
        right = b[i]
        c1 = left.first * length
        c2 = 0.5 * left.second * length * length
        c3 = left.third * length * length * length / 6.0
        # differences of nearby states: in absolute coordinates r''' of pieces of some um would lose seven digits
        e0 = right.value - left.value - c1 - c2 - c3
        e1 = right.first * length - c1 - 2.0 * c2 - 3.0 * c3
        e2 = right.second * length * length - 2.0 * c2 - 6.0 * c3
        e3 = right.third * length * length * length - 6.0 * c3
        c4 = 35.0 * e0 - 15.0 * e1 + 2.5 * e2 - e3 / 6.0
        c5 = -84.0 * e0 + 39.0 * e1 - 7.0 * e2 + 0.5 * e3
        c6 = 70.0 * e0 - 34.0 * e1 + 6.5 * e2 - 0.5 * e3
        out[i] = 0.0, c1, c2, c3, c4, c5, c6, -20.0 * e0 + 10.0 * e1 - 2.0 * e2 + e3 / 6.0
    return 0
