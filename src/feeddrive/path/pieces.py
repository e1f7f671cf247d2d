"""A path r(x) as lines, arcs and polynomials of seventh degree, one row of arrays a piece, and its derivatives.

Each piece counts x from its own start and holds displacements from its own origin, so that no digit is lost to the
distance from the machine's zero.  x is in m and nearly the length of the path; |r'| need not be 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats2

LINE, ARC, POLYNOMIAL = 0, 1, 2

# π/2 as a sum of two numbers, the first of them so short that small multiples of it are exact
_HALF_PI_HIGH = float.fromhex("0x1.921fb54400000p+0")
_HALF_PI_LOW = float.fromhex("0x1.0b4611a626331p-34")


class Pieces(NamedTuple):
    """n pieces of a path of N axes; in each 0 <= x <= length, and ξ = x / length.

        line, polynomial   r_i = origin_i + Σ_{k=1..7} shape_ik ξᵏ; a line has k = 1 alone
        arc, helix         r_i = origin_i + E1_i (cos θ - 1) + E2_i sin θ + slope_i x,   θ = κ x

    kind    LINE, ARC or POLYNOMIAL, shape (n,)
    length  m, shape (n,)
    origin  r(0), m, shape (n, N)
    shape   (n, N, 8), m; of an arc E1, E2, slope and κ in 1/m (on each axis) are columns 0 to 3
    feed    the largest path speed |r'| u', m/s, shape (n,)
    line    of the part program, shape (n,)
    """

    kind: np.ndarray
    length: np.ndarray
    origin: np.ndarray
    shape: np.ndarray
    feed: np.ndarray
    line: np.ndarray


class Section(NamedTuple):
    """A section of a run: pieces that go on from the section before; `ends` says that the run does.

    tolerance  of the corner in which it ends then, m; 0: it stops there
    """

    pieces: Pieces
    ends: bool
    tolerance: float = 0.0


def part_of_pieces(pieces: Pieces, first: int, last: int) -> Pieces:
    """Pieces `first` to before `last`."""
    return Pieces(*(each[first:last] for each in pieces))


def one_after_the_other(pieces: Sequence[Pieces]) -> Pieces:
    """Pieces of a path, and those that follow."""
    return Pieces(*(np.concatenate(each) for each in zip(*pieces, strict=True)))


@kernel
def turned(theta: float) -> tuple[float, float]:
    """sin θ and 1 - cos θ, which keeps its digits at small angles; θ in rad, |θ| < 1e6."""
    k = floor(theta * 0.6366197723675814 + 0.5)
    r = (theta - k * _HALF_PI_HIGH) - k * _HALF_PI_LOW
    z = r * r
    s = z * (1.0 / 6.227020800e9 - z * (1.0 / 1.307674368e12 - z / 3.55687428096e14))
    s = z * (1.0 / 120.0 - z * (1.0 / 5040.0 - z * (1.0 / 362880.0 - z / 39916800.0 + z * s)))
    s = r - r * z * (1.0 / 6.0 - s)
    c = z * (1.0 / 8.71782912e10 - z * (1.0 / 2.0922789888e13 - z / 6.402373705728e15))
    c = z * (1.0 / 720.0 - z * (1.0 / 40320.0 - z * (1.0 / 3628800.0 - z / 479001600.0 + z * c)))
    c = z * (0.5 - z * (1.0 / 24.0 - c))
    quarter = k % 4
    if quarter == 0:
        return s, c
    if quarter == 1:
        return 1.0 - c, 1.0 + s
    if quarter == 2:
        return -s, 2.0 - c
    return c - 1.0, 1.0 - s


@kernel
def derivatives(kind: int, length: float, shape: Floats2, x: float, out: Floats2) -> int:
    """r - r(0), r', r'', r''' and r'''' of one piece at x, into `out` of shape (N, >= 5)."""
    if kind == 1:
        kappa = shape[0, 3]
        s, v = turned(kappa * x)
        c = 1.0 - v
        k2 = kappa * kappa
        for i in range(len(shape)):
            e1 = shape[i, 0]
            e2 = shape[i, 1]
            out[i, 0] = e2 * s - e1 * v + shape[i, 2] * x
            out[i, 1] = kappa * (e2 * c - e1 * s) + shape[i, 2]
            out[i, 2] = -k2 * (e1 * c + e2 * s)
            out[i, 3] = k2 * kappa * (e1 * s - e2 * c)
            out[i, 4] = k2 * k2 * (e1 * c + e2 * s)
        return 0
    xi = x / length
    if kind == 0:
        for i in range(len(shape)):
            out[i, 0] = shape[i, 1] * xi
            out[i, 1] = shape[i, 1] / length
            out[i, 2] = 0.0
            out[i, 3] = 0.0
            out[i, 4] = 0.0
        return 0
    for i in range(len(shape)):
        p0 = 0.0
        p1 = 0.0
        p2 = 0.0
        p3 = 0.0
        p4 = 0.0
        for back in range(8):
            k = 7 - back
            p4 = p4 * xi + p3
            p3 = p3 * xi + p2
            p2 = p2 * xi + p1
            p1 = p1 * xi + p0
            p0 = p0 * xi + (shape[i, k] if k > 0 else 0.0)
        out[i, 0] = p0
        out[i, 1] = p1 / length
        out[i, 2] = 2.0 * p2 / (length * length)
        out[i, 3] = 6.0 * p3 / (length * length * length)
        out[i, 4] = 24.0 * p4 / (length * length * length * length)
    return 0
