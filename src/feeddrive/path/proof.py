"""The independent proof that a planned motion satisfies its limits in continuous time.

It bounds the ranges of the derivatives of a path, of a motion along it, and of each axis:

    q'    = r' u'
    q''   = r'' u'² + r' u''
    q'''  = r''' u'³ + 3 r'' u' u'' + r' u'''
    q'''' = r'''' u'⁴ + 6 r''' u'² u'' + r'' (3 u''² + 4 u' u''') + r' u''''

with q = r(u(t)).  Extremes of polynomials of time are exact; r' .. r'''' are bounded by Taylor forms about the middle
of a span.

Over a span of time on one piece of the path each factor of the chain rule is an interval.  A span whose motion cannot
be shown to satisfy the limits is halved until it can, or until a limit is violated at its middle.  At the joints of
path and time the jumps are computed from the planned state.  Apart from the evaluation of path and motion no code is
shared with the planner, so its errors are not repeated here.

Rounding is not directed.  A test involves some hundred roundings, so 1e-13 of its largest term is added to its
interval; each limit is relaxed by a relative 1e-9.

Two runs may overlap: while one comes to rest in the corner c and the next one leaves it, q = q0 + q1 - c.  Each
derivative of q is the sum of two motions along one piece each.  With r' replaced by its midpoint the dominant terms of
both form one polynomial of time, whose range is exact even if they cancel; the remaining terms are intervals.

Let w0 be the remaining distance of the first run and w1 the distance covered by the second, and t* the time at which
they are equal.  Between lines q is assigned to the path point at the distance w1 - w0 from the corner, from which it
deviates by min(w0, w1) |t1 - t0|, which is largest at t*.  Otherwise it is assigned to q0 before t* (distance at most
w1), to q1 after t*, and at t* to the path between them: the (Fréchet) distance is at most max(w0, w1, |q - c|) at t*,
plus the deviation of the pieces from their chords.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Records, Records2, zeros
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.path.limits import DERIVATIVES
from feeddrive.path.motion import (
    Derivatives,
    Entering,
    Motion,
    Part,
    Piece,
    Pieces,
    chain,
    counted,
    cubic,
    derivatives,
    part_of_pieces,
    turned,
    way,
    when,
)


@kernel
def times(a: float, b: float, c: float, d: float) -> tuple[float, float]:
    """Return [a, b] · [c, d]."""
    p = a * c
    q = a * d
    r = b * c
    s = b * d
    return min(min(p, q), min(r, s)), max(max(p, q), max(r, s))


@kernel
def square(a: float, b: float) -> tuple[float, float]:
    """Return [a, b]²."""
    # tighter than `times` of the interval with itself: both factors are one number, whose square is not negative
    p = a * a
    q = b * b
    if a <= 0.0 and b >= 0.0:
        return 0.0, max(p, q)
    return min(p, q), max(p, q)


@kernel
def line_range(a: float, b: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the range of a + b t."""
    p = a + b * t0
    q = a + b * t1
    return min(p, q), max(p, q)


@kernel
def parabola_range(a: float, b: float, c: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the range of a + b t + c t²/2."""
    p = a + t0 * (b + 0.5 * c * t0)
    q = a + t1 * (b + 0.5 * c * t1)
    low = min(p, q)
    high = max(p, q)
    if c != 0.0:
        t = -b / c
        if t > t0 and t < t1:
            p = a + t * (b + 0.5 * c * t)
            low = min(low, p)
            high = max(high, p)
    return low, high


@kernel
def cubic_range(a: float, b: float, c: float, d: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the range of a + b t + c t²/2 + d t³/6: from its ends and the zeros of its derivative b + c t + d t²/2."""
    p = cubic(a, b, c, d, t0)
    q = cubic(a, b, c, d, t1)
    low = min(p, q)
    high = max(p, q)
    root = c * c - 2.0 * b * d
    if root >= 0.0:
        # the root that does not cancel, and the other one from their product
        h = -(c + sqrt(root)) if c >= 0.0 else -(c - sqrt(root))
        if d != 0.0:
            t = h / d
            if t > t0 and t < t1:
                p = cubic(a, b, c, d, t)
                low = min(low, p)
                high = max(high, p)
        if h != 0.0:
            t = 2.0 * b / h
            if t > t0 and t < t1:
                p = cubic(a, b, c, d, t)
                low = min(low, p)
                high = max(high, p)
    return low, high


@kernel
def slopes(kind: int, length: float, shape: Floats2, x0: float, x1: float, out: Floats3) -> float:
    """Return a bound on |r'| over [x0, x1], or 1 for a paced piece; write intervals of r' .. r'''' into out[i, k-1], by
    Taylor forms about the midpoint.
    """
    middle = 0.5 * (x0 + x1)
    radius = 0.5 * (x1 - x0)
    n = len(shape)
    norm = 0.0
    if kind == 0:
        for i in range(n):
            slope = shape[i, 1] / length
            norm = norm + slope * slope
            for k in range(4):
                out[i, k, 0] = slope
                out[i, k, 1] = slope
                slope = 0.0
        return sqrt(norm)
    if kind == 1:
        kappa = shape[0, 3]
        s, versine = turned(kappa * middle)
        c = 1.0 - versine
        most = kappa * radius
        # |r'|² = κ² |E2 cos θ - E1 sin θ|² + 2 κ (E2 cos θ - E1 sin θ) · slope + |slope|²
        length1 = 0.0
        length2 = 0.0
        skew = 0.0
        along1 = 0.0
        along2 = 0.0
        for i in range(n):
            e1 = shape[i, 0]
            e2 = shape[i, 1]
            drift = shape[i, 2]
            length1 = length1 + e1 * e1
            length2 = length2 + e2 * e2
            skew = skew + e1 * e2
            along1 = along1 + e1 * drift
            along2 = along2 + e2 * drift
            norm = norm + drift * drift
            big = sqrt(e1 * e1 + e2 * e2)
            rest = 0.5 * big * most * most  # the second term of each Taylor form, by the amplitude
            value = e2 * c - e1 * s
            slope = -(e1 * c + e2 * s)
            scale = kappa
            for k in range(4):
                half = abs(slope) * most + rest
                out[i, k, 0] = max(value - half, -big) * scale
                out[i, k, 1] = min(value + half, big) * scale
                value, slope = slope, -value
                scale = scale * kappa
            out[i, 0, 0] = out[i, 0, 0] + drift
            out[i, 0, 1] = out[i, 0, 1] + drift
        # the larger eigenvalue of the Gram matrix of E1 and E2 bounds the first term at any angle
        oval = length1 - length2
        ring = 0.5 * (length1 + length2 + sqrt(oval * oval + 4.0 * skew * skew))
        return sqrt(kappa * kappa * ring + 2.0 * kappa * sqrt(along1 * along1 + along2 * along2) + norm)
    xi = middle / length
    rho = radius / length
    tilt = 0.0
    bend = 0.0
    scale1 = 1.0 / length
    scale2 = scale1 / length
    scale3 = scale2 / length
    scale4 = scale3 / length
    for i in range(n):
        # Taylor coefficients about the middle, by repeated synthetic division
        _, c1, c2, c3, c4, c5, c6, c7 = shape[i]
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c2 = c2 + xi * c3
        c1 = c1 + xi * c2
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c2 = c2 + xi * c3
        c1 = c1 + xi * c2
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c2 = c2 + xi * c3
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c6 = c6 + xi * c7
        # r^(m)(middle + δ) = Σ_k k!/(k-m)! c_k δ^(k-m) / length^m
        s2, s3, s4, s5, s6, s7 = abs(c2), abs(c3), abs(c4), abs(c5), abs(c6), abs(c7)
        half = (((7.0 * s7 * rho + 6.0 * s6) * rho + 5.0 * s5) * rho + 4.0 * s4) * rho
        half = ((half + 3.0 * s3) * rho + 2.0 * s2) * rho
        out[i, 0] = (c1 - half) * scale1, (c1 + half) * scale1
        half = ((((42.0 * s7 * rho + 30.0 * s6) * rho + 20.0 * s5) * rho + 12.0 * s4) * rho + 6.0 * s3) * rho
        out[i, 1] = (2.0 * c2 - half) * scale2, (2.0 * c2 + half) * scale2
        half = (((210.0 * s7 * rho + 120.0 * s6) * rho + 60.0 * s5) * rho + 24.0 * s4) * rho
        out[i, 2] = (6.0 * c3 - half) * scale3, (6.0 * c3 + half) * scale3
        half = ((840.0 * s7 * rho + 360.0 * s6) * rho + 120.0 * s5) * rho
        out[i, 3] = (24.0 * c4 - half) * scale4, (24.0 * c4 + half) * scale4
        # |r'|² about the middle: value, slope, and a bound of half the second derivative
        p = max(-out[i, 0, 0], out[i, 0, 1])
        q = max(-out[i, 1, 0], out[i, 1, 1])
        norm = norm + c1 * c1
        tilt = tilt + 4.0 * c1 * c2
        bend = bend + q * q + p * max(-out[i, 2, 0], out[i, 2, 1])
    if kind == 3:
        return 1.0
    norm = (norm + abs(tilt) * rho) / (length * length)
    return sqrt(norm + bend * radius * radius)


@kernel
def products(v0: float, v1: float, a0: float, a1: float, j0: float, j1: float, u: Floats2) -> int:
    """Write the ranges of u', u'², u'³, u'⁴, u'', u' u'', u'² u'', u''' and 3 u''² + 4 u' u''' into the rows of `u`."""
    u[0] = v0, v1
    b, c = square(v0, v1)
    u[1] = b, c
    p, q = times(v0, v1, b, c)
    u[2] = p, q
    p, q = square(b, c)
    u[3] = p, q
    u[4] = a0, a1
    p, q = times(v0, v1, a0, a1)
    u[5] = p, q
    p, q = times(b, c, a0, a1)
    u[6] = p, q
    u[7] = j0, j1
    p, q = times(v0, v1, j0, j1)
    b, c = square(a0, a1)
    u[8] = 3.0 * b + 4.0 * p, 3.0 * c + 4.0 * q
    return 0


@kernel
def add_product(r0: float, r1: float, u0: float, u1: float, out: Floats) -> int:
    """Add [r0, r1] · [u0, u1] to the interval in `out`, and update the magnitude of its largest term."""
    low, high = times(r0, r1, u0, u1)
    out[0] = out[0] + low
    out[1] = out[1] + high
    out[2] = max(out[2], max(-low, high))
    return 0


@kernel
def add_ranges(u: Floats2, s: float, r: Floats2, middle: float, out: Floats2) -> int:
    """Add q' .. q'''' of one axis to the rows of `out`: low, high and the magnitude of the largest term.

    The products are in `u`, r' .. r'''' in the rows of `r`; for r' only its difference from `middle` is used.
    """
    low = r[0, 0] - middle
    high = r[0, 1] - middle
    add_product(low, high, u[0, 0], u[0, 1], out[0])
    add_product(r[1, 0], r[1, 1], u[1, 0], u[1, 1], out[1])
    add_product(low, high, u[4, 0], u[4, 1], out[1])
    add_product(r[2, 0], r[2, 1], u[2, 0], u[2, 1], out[2])
    add_product(r[1, 0], r[1, 1], 3.0 * u[5, 0], 3.0 * u[5, 1], out[2])
    add_product(low, high, u[7, 0], u[7, 1], out[2])
    add_product(r[3, 0], r[3, 1], u[3, 0], u[3, 1], out[3])
    add_product(r[2, 0], r[2, 1], 6.0 * u[6, 0], 6.0 * u[6, 1], out[3])
    add_product(r[1, 0], r[1, 1], u[8, 0], u[8, 1], out[3])
    add_product(low, high, s, s, out[3])
    return 0


@kernel
def largest_share(out: Floats2, limits: Floats, slack: float) -> tuple[float, int]:
    """Return the largest utilization of any limit of one axis that the intervals of `add_ranges` allow, and the index
    of that limit.
    """
    most = 0.0
    where = 0
    for k in range(4):
        share = (max(-out[k, 0], out[k, 1]) + slack * out[k, 2]) / limits[k]
        if share > most:
            most = share
            where = k
    return most, where


@kernel
def _stands(r: Floats2) -> bool:
    """Return True if an axis does not move."""
    most = 0.0
    for k in range(4):
        most = max(most, max(abs(r[k, 0]), abs(r[k, 1])))
    return most == 0.0


@kernel
def share_of_limits(
    v0: float,
    v1: float,
    a0: float,
    a1: float,
    j0: float,
    j1: float,
    s: float,
    r: Floats3,
    norm: float,
    limits: Floats2,
    feed: float,
    slack: float,
) -> tuple[float, int]:
    """Return the largest utilization of any limit that the intervals allow, and the index of that limit: 4 axis +
    derivative - 1, or -1 for the feed.
    """
    u = zeros(9, 2)
    out = zeros(4, 3)
    most = norm * max(-v0, v1) * (1.0 + slack) / feed
    where = -1
    products(v0, v1, a0, a1, j0, j1, u)
    for i in range(len(limits)):
        if _stands(r[i]):
            continue
        for k in range(4):
            out[k] = 0.0, 0.0, 0.0
        add_ranges(u, s, r[i], 0.0, out)
        share, k = largest_share(out, limits[i], slack)
        if share > most:
            most = share
            where = 4 * i + k
    return most, where


@kernel
def _taken(piece: Piece, x: float, s: float, u: Floats2, b: float, e: float, r: Floats3) -> float:
    """Write the intervals of one motion over a span: products into `u`, r' .. r'''' into `r`; return a bound on |r'|.

    On input u[9] to u[11] contain u' .. u''' at t = 0.
    """
    v = u[9, 0]
    a = u[10, 0]
    j = u[11, 0]
    v0, v1 = cubic_range(v, a, j, s, b, e)
    a0, a1 = parabola_range(a, j, s, b, e)
    j0, j1 = line_range(j, s, b, e)
    products(v0, v1, a0, a1, j0, j1, u)
    x0 = min(max(x + way(v, a, j, s, b), 0.0), piece.length)
    x1 = min(max(x + way(v, a, j, s, e), 0.0), piece.length)
    # near a rest rounding may let the end lie before the start
    return slopes(piece.kind, piece.length, piece.shape, x0, max(x0, x1), r)


class _Moving(NamedTuple):
    """One of two motions over a span of time, on a piece of its path.

    x, s  position at t = 0, m, and constant snap u''''
    u     products, as written by `products`, and in rows 9 to 11 u' .. u''' at t = 0
    r     intervals of r' .. r'''' over the span
    """

    piece: Piece
    x: float
    s: float
    u: Floats2
    r: Floats3


@kernel
def _share(
    one: _Moving, two: _Moving, limits: Floats2, feed: float, b: float, e: float, slack: float
) -> tuple[float, int]:
    """Return an upper bound, over all values within the intervals, on the utilization of any limit by the sum of two
    motions from b to e, and the index of the limit with that bound, as in `share_of_limits`.
    """
    u0, s0, r0 = one.u, one.s, one.r
    u1, s1, r1 = two.u, two.s, two.r
    out = zeros(4, 3)
    _taken(one.piece, one.x, s0, u0, b, e, r0)
    _taken(two.piece, two.x, s1, u1, b, e, r1)
    most = 0.0
    where = 0
    speed = 0.0
    for i in range(len(limits)):
        c0 = 0.5 * (r0[i, 0, 0] + r0[i, 0, 1])
        c1 = 0.5 * (r1[i, 0, 0] + r1[i, 0, 1])
        v = c0 * u0[9, 0] + c1 * u1[9, 0]
        a = c0 * u0[10, 0] + c1 * u1[10, 0]
        j = c0 * u0[11, 0] + c1 * u1[11, 0]
        s = c0 * s0 + c1 * s1
        low, high = cubic_range(v, a, j, s, b, e)
        out[0] = low, high, abs(c0) * u0[0, 1] + abs(c1) * u1[0, 1]
        low, high = parabola_range(a, j, s, b, e)
        out[1] = low, high, abs(c0) * max(-u0[4, 0], u0[4, 1]) + abs(c1) * max(-u1[4, 0], u1[4, 1])
        low, high = line_range(j, s, b, e)
        out[2] = low, high, abs(c0) * max(-u0[7, 0], u0[7, 1]) + abs(c1) * max(-u1[7, 0], u1[7, 1])
        out[3] = s, s, abs(c0 * s0) + abs(c1 * s1)
        add_ranges(u0, s0, r0[i], c0, out)
        add_ranges(u1, s1, r1[i], c1, out)
        share, k = largest_share(out, limits[i], slack)
        if share > most:
            most = share
            where = 4 * i + k
        v = max(-out[0, 0], out[0, 1])
        speed = speed + v * v
    share = sqrt(speed) * (1.0 + slack) / feed
    if share > most:
        most = share
        where = -1
    return most, where


@kernel
def _used(v: float, a: float, j: float, s: float, limits: Floats, uses: Floats) -> int:
    """Update the peak utilization of the limits of one axis."""
    uses[0] = max(uses[0], abs(v) / limits[0])
    uses[1] = max(uses[1], abs(a) / limits[1])
    uses[2] = max(uses[2], abs(j) / limits[2])
    uses[3] = max(uses[3], abs(s) / limits[3])
    return 0


@kernel
def _derived(moving: _Moving, r: Records[Derivatives], q: Records[Derivatives]) -> int:
    """Write the derivatives of the piece at the start of a span into r, and those of the motion into q."""
    kind, length, shape = moving.piece
    u = moving.u
    derivatives(kind, length, shape, min(max(moving.x, 0.0), length), r)
    chain(u[9, 0], u[10, 0], u[11, 0], moving.s, r, q)
    return 0


@kernel
def prove_sum(
    one: Piece,
    motion0: Motion,
    two: Piece,
    motion1: Motion,
    limits: Floats2,
    widened: float,
    feed: float,
    faults: Floats2,
    uses: Floats2,
    work: _Work,
) -> tuple[int, int, float]:
    """Prove the sum of two motions with common time intervals, each on a piece of its own; return the number of spans
    tested, the number of faults, and a bound on the distance, m.

    Each fault is a row of `faults`: time interval, time within it, limit, utilization.
    """
    r, q = work.paths, work.motions
    spans = 0
    faulty = 0
    # depth first: the 40 halvings down to a share of 1e-12 need no more than 41 open spans
    halves = zeros(64, 2)
    u0 = zeros(12, 2)
    u1 = zeros(12, 2)
    r0 = zeros(12, 4, 2)
    r1 = zeros(12, 4, 2)
    for m in range(len(motion0.duration)):
        u0[9, 0], u0[10, 0], u0[11, 0] = motion0.speed[m], motion0.acceleration[m], motion0.jerk[m]
        u1[9, 0], u1[10, 0], u1[11, 0] = motion1.speed[m], motion1.acceleration[m], motion1.jerk[m]
        moving0 = _Moving(one, motion0.x[m], motion0.snap[m], u0, r0)
        moving1 = _Moving(two, motion1.x[m], motion1.snap[m], u1, r1)
        _derived(moving0, r[0], q[0])
        _derived(moving1, r[1], q[1])
        for i in range(len(limits)):
            left = q[0, i]
            right = q[1, i]
            _used(
                left.first + right.first,
                left.second + right.second,
                left.third + right.third,
                left.fourth + right.fourth,
                limits[i],
                uses[i],
            )
        count = 1
        halves[0] = 0.0, motion0.duration[m]
        # a span that is still open at this width is at a limit up to rounding: it counts as a fault
        shortest = motion0.duration[m] * 1e-12
        while count > 0:
            count = count - 1
            b = halves[count, 0]
            e = halves[count, 1]
            spans = spans + 1
            share, which = _share(moving0, moving1, limits, feed, b, e, 1e-13)
            if share <= 1.0 + widened:
                continue
            middle = 0.5 * (b + e)
            share, which = _share(moving0, moving1, limits, feed, middle, middle, -1e-13)
            if share > 1.0 + widened or e - b <= shortest or count + 2 > len(halves):
                if faulty < len(faults):
                    faults[faulty] = 0.0, float(m), middle, float(which), share
                faulty = faulty + 1
                break
            halves[count] = middle, e
            halves[count + 1] = b, middle
            count = count + 2
    away = distance(one, motion0, two, motion1, r)
    return spans, faulty, away


@kernel
def _after(motion: Motion, m: int, t: float) -> float:
    """Return the position x of a motion t seconds after the start of time interval m."""
    return motion.x[m] + way(motion.speed[m], motion.acceleration[m], motion.jerk[m], motion.snap[m], t)


@kernel
def _place(motion: Motion, t: float) -> float:
    """Return the position x of a motion at the time t."""
    begin = 0.0
    m = 0
    while m + 1 < len(motion.duration) and t >= begin + motion.duration[m]:
        begin = begin + motion.duration[m]
        m = m + 1
    return _after(motion, m, t - begin)


@kernel
def distance(one: Piece, motion0: Motion, two: Piece, motion1: Motion, r: Records2[Derivatives]) -> float:
    """Bound the distance between q and the corner's two pieces, m, for motions that do not run backwards."""
    kind0, length0, shape0 = one
    kind1, length1, shape1 = two
    r0 = zeros(12, 4, 2)
    r1 = zeros(12, 4, 2)
    norm0 = slopes(kind0, length0, shape0, min(max(motion0.x[0], 0.0), length0), length0, r0)
    last = len(motion1.duration) - 1
    x1 = _after(motion1, last, motion1.duration[last])
    norm1 = slopes(kind1, length1, shape1, 0.0, min(max(x1, 0.0), length1), r1)
    low = 0.0
    high = 0.0
    for m in range(len(motion0.duration)):
        high = high + motion0.duration[m]
    # the remaining distance falls and the covered one rises, so there is one time at which they are equal
    for _ in range(60):
        t = 0.5 * (low + high)
        x0 = _place(motion0, t)
        x1 = _place(motion1, t)
        if norm0 * (length0 - x0) > norm1 * x1:
            low = t
        else:
            high = t
    t = 0.5 * (low + high)
    x0 = min(max(_place(motion0, t), 0.0), length0)
    x1 = min(max(_place(motion1, t), 0.0), length1)
    left = norm0 * (length0 - x0)
    done = norm1 * x1
    gap = 0.0
    turn = 0.0
    bend0 = 0.0
    bend1 = 0.0
    derivatives(kind0, length0, shape0, length0, r[0])
    derivatives(kind0, length0, shape0, x0, r[1])
    derivatives(kind1, length1, shape1, x1, r[2])
    for i in range(len(shape0)):
        # q - c, and the deviation of the pieces from their chords to the corner
        apart = r[1, i].value - r[0, i].value + r[2, i].value
        gap = gap + apart * apart
        apart = r[2, i].first / norm1 - r[0, i].first / norm0
        turn = turn + apart * apart
        p = max(-r0[i, 1, 0], r0[i, 1, 1])
        bend0 = bend0 + p * p
        p = max(-r1[i, 1, 0], r1[i, 1, 1])
        bend1 = bend1 + p * p
    if bend0 == 0.0 and bend1 == 0.0:
        return sqrt(turn) * max(left, done) * (1.0 + 1e-12)
    # a curve with |r''| <= M leaves its chord of the length w by at most M w²/8
    bent = 0.125 * max(sqrt(bend0) * (length0 - x0) * (length0 - x0), sqrt(bend1) * x1 * x1)
    return max(max(left, done), sqrt(gap) + bent) * (1.0 + 1e-12)


# far above rounding, of which 1e-13 of the largest term is added, and far below what a drive resolves
WIDENED = 1e-9  # relative widening of a limit
_KEPT = 100  # largest number of faults recorded


@kernel
def _span(
    kind: int,
    length: float,
    shape: Floats2,
    feed: float,
    limits: Floats2,
    widened: float,
    x: float,
    v: float,
    a: float,
    j: float,
    s: float,
    t0: float,
    t1: float,
    halves: Floats2,
    r: Floats3,
) -> tuple[int, int, float]:
    """Test one time interval; return the number of tests, the violated limit (-2: none) and its time; the values x, u'
    .. u'''' are those at t = 0.
    """
    tests = 0
    count = 1
    halves[0, 0] = t0
    halves[0, 1] = t1
    shortest = (t1 - t0) * 1e-12
    while count > 0:
        count = count - 1
        b = halves[count, 0]
        e = halves[count, 1]
        tests = tests + 1
        v0, v1 = cubic_range(v, a, j, s, b, e)
        a0, a1 = parabola_range(a, j, s, b, e)
        j0, j1 = line_range(j, s, b, e)
        x0 = min(max(x + way(v, a, j, s, b), 0.0), length)
        x1 = min(max(x + way(v, a, j, s, e), 0.0), length)
        norm = slopes(kind, length, shape, x0, max(x0, x1), r)
        share, which = share_of_limits(v0, v1, a0, a1, j0, j1, s, r, norm, limits, feed, 1e-13)
        if share <= 1.0 + widened:
            continue
        m = 0.5 * (b + e)
        x0 = min(max(x + way(v, a, j, s, m), 0.0), length)
        v0 = cubic(v, a, j, s, m)
        a0 = a + m * (j + 0.5 * m * s)
        j0 = j + m * s
        norm = slopes(kind, length, shape, x0, x0, r)
        # at a point the slack is subtracted, so that rounding alone is never reported as a violation
        share, which = share_of_limits(v0, v0, a0, a0, j0, j0, s, r, norm, limits, feed, -1e-13)
        if share > 1.0 + widened or e - b <= shortest or count + 2 > len(halves):
            return tests, which, m
        halves[count, 0] = m
        halves[count, 1] = e
        halves[count + 1, 0] = b
        halves[count + 1, 1] = m
        count = count + 2
    return tests, -2, 0.0


@kernel
def jump(limits: Floats, k: int, share: float) -> float:
    """Return a jump of the acceleration (k = 1) or the jerk (k = 2) of an axis, as a share of its limit, or 0 if it may
    jump: no higher derivative is limited.
    """
    for higher in range(k + 1, 4):
        # infinity less infinity is no number
        if limits[higher] - limits[higher] == 0.0:
            return share
    return 0.0


class Broken(NamedTuple):
    """A fault as noted by kernels: path piece, time interval, time within it (s), number of the limit, utilization."""

    piece: float
    interval: float
    time: float
    limit: float
    share: float


@kernel
def _noted(faults: Floats2, count: int, p: int, m: int, time: float, which: float, share: float) -> int:
    """Record one more fault; faults beyond the last row are only counted."""
    if count < len(faults):
        faults[count] = float(p), float(m), time, which, share
    return count + 1


class _Reached(NamedTuple):
    """What is carried from part to part.

    state  x, u' .. u''' at the end of the previous part, on the first piece of the next one
    place  position there, m, shape (N,)
    uses   peak utilization of each limit, shape (N, 4), or (0, 4) if nobody asks for it
    jumps  largest jumps at joints so far: of the position, m, and of velocity to jerk, as a share of its limit
    """

    state: Floats
    place: Floats
    uses: Floats2
    jumps: Floats


class _Work(NamedTuple):
    """Work arrays: open spans, intervals of r' .. r'''', and derivatives of paths, three, and motions, two of them."""

    halves: Floats2
    r: Floats3
    paths: Records2[Derivatives]
    motions: Records2[Derivatives]


@kernel
def _prove(
    pieces: Pieces,
    motion: Motion,
    limits: Floats2,
    widened: float,
    anywhere: bool,
    ends: bool,
    alone: bool,
    reached: _Reached,
    faults: Floats2,
    work: _Work,
) -> tuple[int, int]:
    """Return the number of tests and the number of faults; a row of `faults` contains path piece, time interval, time
    within it, limit, utilization.

    A motion that is not `alone` is only proven to have no jumps; its limits apply to a sum, checked by `prove_sum`. It
    begins where `reached` says, or `anywhere`, and on output `reached` is the end of this part.
    """
    kind, length, origin, shape, feed = pieces.kind, pieces.length, pieces.origin, pieces.shape, pieces.feed
    duration, piece, x, speed, acceleration, jerk, snap = motion
    state, place, uses, jumps = reached
    halves, r = work.halves, work.r
    before, after, q = work.paths[0], work.paths[1], work.motions[0]
    tests = 0
    count = 0
    n = len(limits)
    last = len(length) - 1
    backwards = 1e300
    sliver = 0.0
    for k in range(len(length)):
        # positions of the plan are rounded to 1e-16 of the path planned at once
        sliver = sliver + 1e-15 * length[k]
    for i in range(n):
        # slower backward motion is within the widening of every velocity limit
        backwards = min(backwards, widened * limits[i, 0])
    p = 0
    came = state[0]
    derivatives(kind[0], length[0], shape[0], came, before)
    apart = 0.0
    size = 1.0
    for i in range(n):
        apart = max(apart, abs(origin[0, i] + before[i].value - place[i]))
        size = max(size, 1.0 + abs(place[i]))
    if not anywhere and apart > 1e-12 * size:
        count = _noted(faults, count, 0, 0, 0.0, -8.0, apart)
    v = state[1]
    a = state[2]
    j = state[3]
    for m in range(len(duration) + 1):
        # jumps in time, for the axes; a run begins and ends at rest, at the ends of its path
        rest = m == len(duration)
        if rest and not ends:
            break
        v1 = 0.0 if rest else speed[m]
        a1 = 0.0 if rest else acceleration[m]
        j1 = 0.0 if rest else jerk[m]
        gap = (length[last] if rest else x[m]) - came
        right = p == (last if rest else piece[m])
        worst = 0.0
        if right:
            derivatives(kind[p], length[p], shape[p], came, before)
            chain(v1 - v, 0.0, 0.0, 0.0, before, q)
            for i in range(n):
                worst = max(worst, abs(q[i].first) / limits[i, 0])
                over = abs(before[i].first * (a1 - a) + before[i].second * (v1 * v1 - v * v)) / limits[i, 1]
                worst = max(worst, jump(limits[i], 1, over))
                worst = max(worst, jump(limits[i], 2, abs(before[i].first * (j1 - j)) / limits[i, 2]))
                jumps[0] = max(jumps[0], abs(before[i].first * gap))
            jumps[1] = max(jumps[1], worst)
        outside = came < -1e-12 or came > length[p] + 1e-12 * (1.0 + length[p])
        if not right or outside or worst > widened or abs(gap) > 1e-12 * (1.0 + length[p]):
            count = _noted(faults, count, p, m, 0.0, -3.0, worst)
            if not right:
                return tests, count
        if rest:
            break
        v = speed[m]
        a = acceleration[m]
        j = jerk[m]
        s = snap[m]
        T = duration[m]
        low, high = cubic_range(v, a, j, s, 0.0, T)
        if not (T > 0.0) or low < -backwards or not (high < 1e300):
            # backward motion by more than rounding would make the range of x wrong, which is taken from its ends
            return tests, _noted(faults, count, p, m, 0.0, -4.0, low)
        whole = way(v, a, j, s, T)
        begin = x[m]  # of the time piece, from the start of the present piece of the path
        t0 = 0.0
        while True:
            left = length[p] - begin
            # an interval that ends within rounding of a joint lies before it
            on = whole > left + sliver and p < last
            t1 = when(left, v, a, j, s, t0, T) if on else T
            if t1 > t0 and alone:
                passed, which, broke = _span(
                    kind[p], length[p], shape[p], feed[p], limits, widened, begin, v, a, j, s, t0, t1, halves, r
                )
                tests = tests + passed
                if which != -2:
                    count = _noted(faults, count, p, m, broke, float(which), 1.0)
                # the reported use is that at these times; the proof itself needs no samples
                for part in range(2 if len(uses) > 0 else 0):
                    t = t0 if part == 0 else 0.5 * (t0 + t1)
                    here = min(max(begin + way(v, a, j, s, t), 0.0), length[p])
                    derivatives(kind[p], length[p], shape[p], here, before)
                    chain(cubic(v, a, j, s, t), a + t * (j + 0.5 * t * s), j + t * s, s, before, q)
                    for i in range(n):
                        _used(q[i].first, q[i].second, q[i].third, q[i].fourth, limits[i], uses[i])
            t0 = t1
            # a part of a run may end at a joint, where its last piece begins
            ahead = piece[m + 1] == p + 1 if m + 1 < len(duration) else not ends and p + 1 == last
            if not on and not (ahead and p < last):
                break
            # the joint of the path: jumps there, at the planned speed
            v1 = cubic(v, a, j, s, t0)
            a1 = a + t0 * (j + 0.5 * t0 * s)
            j1 = j + t0 * s
            derivatives(kind[p], length[p], shape[p], length[p], before)
            derivatives(kind[p + 1], length[p + 1], shape[p + 1], 0.0, after)
            worst = 0.0
            far = 0.0
            for i in range(n):
                far = max(far, abs(origin[p, i]))
            for i in range(n):
                # jumps of q' .. q''' by the chain rule: derivatives of u are continuous at a joint of the path
                d1 = after[i].first - before[i].first
                d2 = after[i].second - before[i].second
                d3 = after[i].third - before[i].third
                worst = max(worst, abs(d1 * v1) / limits[i, 0])
                worst = max(worst, jump(limits[i], 1, abs(d2 * v1 * v1 + d1 * a1) / limits[i, 1]))
                over = abs(d3 * v1 * v1 * v1 + 3.0 * d2 * v1 * a1 + d1 * j1) / limits[i, 2]
                worst = max(worst, jump(limits[i], 2, over))
                apart = abs(origin[p + 1, i] - (origin[p, i] + before[i].value))
                jumps[0] = max(jumps[0], apart)
                # and some roundings of an angle that is wound up, which the linear joints along a tip follow
                if apart > 1e-12 * (1.0 + abs(origin[p, i]) + length[p]) + 1e-15 * far:
                    worst = max(worst, 1.0)
            jumps[1] = max(jumps[1], worst)
            if worst > widened:
                count = _noted(faults, count, p, m, t0, -5.0, worst)
            begin = begin - length[p]
            p = p + 1
            if not on:
                break
        came = begin + whole
        v1 = cubic(v, a, j, s, T)
        a = a + T * (j + 0.5 * T * s)
        j = j + T * s
        v = v1
    derivatives(kind[p], length[p], shape[p], came, before)
    for i in range(n):
        place[i] = origin[p, i] + before[i].value
    state[0] = came
    state[1] = v
    state[2] = a
    state[3] = j
    return tests, count


class _Faults(NamedTuple):
    """The faults of both motions of two runs that overlap, and of their sum, as rows of `Broken`."""

    first: Floats2
    second: Floats2
    both: Floats2


class _Corner(NamedTuple):
    """What was found where two runs overlap.

    spans                number of tests
    first, second, both  numbers of faults of both motions and of their sum
    meets                True if both are on one piece of path, in the same pieces of time, and meet in the corner
    away                 bound on the distance to the corner, m
    """

    spans: int
    first: int
    second: int
    both: int
    meets: bool
    away: float


@kernel
def _prove_corner(
    one: Pieces,
    motion0: Motion,
    two: Pieces,
    motion1: Motion,
    limits: Floats2,
    widened: float,
    anywhere: bool,
    ends: bool,
    reached: _Reached,
    faults: _Faults,
    work: _Work,
) -> _Corner:
    """Prove two runs that overlap: the end of the first, and the beginning of the second from rest in the corner."""
    spans0, first = _prove(one, motion0, limits, widened, anywhere, ends, False, reached, faults.first, work)
    state, place = reached.state, reached.place
    n = len(place)
    for k in range(len(state)):
        state[k] = 0.0
    apart = 0.0
    size = 0.0
    for i in range(n):
        apart = max(apart, abs(place[i] - two.origin[0, i]))
        size = max(size, abs(place[i]))
    spans1, second = _prove(two, motion1, limits, widened, True, False, False, reached, faults.second, work)
    meets = len(one.length) == 1 and len(two.length) == 1 and ends
    meets = meets and len(motion0.duration) == len(motion1.duration)
    if meets:
        for m in range(len(motion0.duration)):
            meets = meets and motion0.duration[m] == motion1.duration[m]
    if meets:
        reached.jumps[0] = max(reached.jumps[0], apart)
        meets = apart <= 1e-12 * (1.0 + size)
    if not meets:
        return _Corner(spans0 + spans1, first, second, 0, False, 0.0)
    spans, both, away = prove_sum(
        Piece(one.kind[0], one.length[0], one.shape[0]),
        motion0,
        Piece(two.kind[0], two.length[0], two.shape[0]),
        motion1,
        limits,
        widened,
        max(one.feed[0], two.feed[0]),
        faults.both,
        reached.uses,
        work,
    )
    return _Corner(spans0 + spans1 + spans, first, second, both, True, away)


class Fault(NamedTuple):
    """A point of a motion at which a limit is exceeded, or was not shown to be satisfied."""

    line: int  # of the part program
    time: float  # s from the start of the run
    what: str

    def __str__(self) -> str:
        return Text(f"line {self.line}, {Quantity(self.time, 's'):6 SI} into the run: {self.what}")


@dataclass(frozen=True, eq=False, repr=False)
class Proof(Result):
    """The result of the proof of a motion along a path.

    faults    the first hundred points at which a limit is exceeded, or was not shown to be satisfied
    count     number of all faults
    use       the peak utilization of the velocity to snap limits of each axis at the times evaluated, shape (N, 4)
    jump      largest jump of velocity, acceleration or jerk at a joint, as a fraction of its limit
    apart     largest jump of position at a joint, m
    missed    largest distance to a corner where runs overlap, as a fraction of its tolerance
    spans     number of time spans tested
    """

    faults: tuple[Fault, ...]
    count: int
    use: np.ndarray
    jump: float
    apart: float
    missed: float
    spans: int

    def table(self) -> Table:
        """Return a table of the peak utilization of each limit, by axis."""
        rows = [[axis, *(Quantity(share, "share") for share in row)] for axis, row in enumerate(self.use)]
        held = "every limit holds" if self.count == 0 else f"{self.count} faults, the first: {self.faults[0]}"
        return Table(f"{held}; {self.spans} spans of time", ["axis", *DERIVATIVES], rows)


class Prover:
    """The prover of consecutive parts of runs; `limits` are in m/s .. m/s⁴ (rad/s .. rad/s⁴), shape (N, 4).

    A part with `weights` is proven in coordinates in which each axis, with its limits, is multiplied by its weight: the
    feed and the distance of overlapping runs to the corner are measured in them.
    """

    def __init__(self, limits: np.ndarray, widened: float = WIDENED) -> None:
        axes = len(limits)
        self._raw, self._ones = np.ascontiguousarray(limits, float), np.ones(axes)
        self._limits, self._widened = self._raw, widened
        self._given: np.ndarray | None = None  # weights of the last part
        self._reached, self._time = _Reached(np.zeros(4), np.zeros(axes), np.zeros((axes, 4)), np.zeros(2)), 0.0
        self._stands = False  # True if a run has ended there, where the next one must begin
        self._work, self._faults = _work_for(axes), _Faults(*(np.zeros((_KEPT, 5)) for _ in range(3)))
        self._first_faults: list[Fault] = []
        self._count = self._spans = 0
        self._missed = 0.0

    def prove(self, part: Part) -> bool:
        """Check the next part; return True if all its limits are proven to be satisfied."""
        before = self._count
        if part.weights is not self._given:
            self._weigh(part.weights)
        if part.weights is not None:
            part = _weighted(part, part.weights)
        if part.entering is None:
            self._alone(part)
        else:
            self._together(part, part.entering)
        # after a fault the next part starts from its own state: one error is not reported again by all that follow
        if (part.ends and part.entering is None) or self._count > before:
            self._reached.state[:], self._time = 0.0, 0.0
        self._stands = self._count == before
        return self._count == before

    def _weigh(self, weights: np.ndarray | None) -> None:
        """Multiply limits and place by the weights of the next part instead of those of the last one."""
        old, by = (self._ones if each is None else each for each in (self._given, weights))
        self._reached.place[:] *= by / old
        self._limits, self._given = self._raw * by[:, None], weights

    def _alone(self, part: Part) -> None:
        """Prove that a motion has no jumps and satisfies the limits, and begins where the previous one has ended."""
        spans, count = _prove(
            part.pieces,
            part.motion,
            self._limits,
            self._widened,
            not self._stands,
            part.ends,
            True,
            self._reached,
            self._faults.first,
            self._work,
        )
        self._spans += spans
        self._note(count, self._faults.first, part.pieces.line, part.motion.duration, self._time)
        self._time += float(part.motion.duration.sum())

    def _together(self, part: Part, entering: Entering) -> None:
        """Prove two overlapping runs: that neither jumps, limits of the sum, and distance to the corner."""
        one, two, time = part.pieces, entering.pieces, self._time
        found = _prove_corner(
            one,
            part.motion,
            two,
            entering.motion,
            self._limits,
            self._widened,
            not self._stands,
            part.ends,
            self._reached,
            self._faults,
            self._work,
        )
        self._spans += found.spans
        # the next run begins here, from rest
        self._time = float(entering.motion.duration.sum())
        self._note(found.first, self._faults.first, one.line, part.motion.duration, time)
        self._note(found.second, self._faults.second, two.line, entering.motion.duration, 0.0)
        if not found.meets:
            self._refuse(one, time, -6, 0.0)
            return
        self._note(found.both, self._faults.both, one.line, part.motion.duration, time)
        self._missed = max(self._missed, found.away / entering.tolerance)
        if not found.away <= entering.tolerance * (1.0 + self._widened):
            self._refuse(one, time, -7, found.away / entering.tolerance)

    def _refuse(self, pieces: Pieces, time: float, which: int, share: float) -> None:
        self._faults.both[0] = 0.0, 0.0, 0.0, which, share
        self._note(1, self._faults.both, pieces.line, np.zeros(0), time)

    def _note(self, count: int, faults: np.ndarray, line: np.ndarray, duration: np.ndarray, time: float) -> None:
        """Record the faults of a motion that begins at `time` in the run."""
        rows = faults[: min(count, _KEPT - len(self._first_faults))] if count else ()
        if len(rows):
            begins = time + np.concatenate([[0.0], np.cumsum(duration)])
            self._first_faults += [_fault(row, line, begins) for row in rows]
        self._count += count

    def proof(self) -> Proof:
        """Return the proof of all parts so far."""
        apart, jump = map(float, self._reached.jumps)
        use = self._reached.uses.copy()
        return Proof(tuple(self._first_faults), self._count, use, jump, apart, self._missed, self._spans)


def _weighted(part: Part, weights: np.ndarray) -> Part:
    """Return a part with each axis multiplied by its weight."""
    entering = part.entering
    if entering is not None:
        entering = entering._replace(pieces=counted(entering.pieces, weights))
    return part._replace(pieces=counted(part.pieces, weights), entering=entering)


def _work_for(axes: int) -> _Work:
    return _Work(np.empty((64, 2)), np.empty((axes, 4, 2)), np.empty((3, axes, 5)), np.empty((2, axes, 5)))


def faults_of(pieces: Pieces, motion: Motion, limits: np.ndarray) -> np.ndarray:
    """Return the faults of a motion that does not begin at rest, as rows of path piece, time interval, time within it,
    limit, utilization.
    """
    axes, first = len(limits), int(motion.piece[0])
    state = np.array([motion.x[0], motion.speed[0], motion.acceleration[0], motion.jerk[0]])
    faults = np.empty((_KEPT, 5))
    _, count = _prove(
        part_of_pieces(pieces, first, len(pieces.length)),
        motion._replace(piece=motion.piece - first),
        limits,
        WIDENED,
        True,
        False,
        True,
        _Reached(state, np.zeros(axes), np.zeros((0, 4)), np.zeros(2)),
        faults,
        _work_for(axes),
    )
    return faults[:count]


def _fault(row: np.ndarray, line: np.ndarray, begins: np.ndarray) -> Fault:
    which, share = int(row[3]), Quantity(row[4])
    if which >= 0:
        what = f"the {DERIVATIVES[which % 4]} of axis {which // 4} exceeds its limit, or cannot be shown to keep it"
    elif which == -1:
        what = "the speed along the path exceeds the feed"
    elif which == -3:
        what = Text(
            f"the motion jumps by {share:3} of a limit between two pieces of time, or leaves its piece of the path"
        )
    elif which == -4:
        what = "the motion runs backwards, or has no duration"
    elif which == -6:
        what = "two runs overlap that do not meet in a corner, or by more than a piece of path or other pieces of time"
    elif which == -8:
        what = "the part does not go on from where the one before has ended, so that a move is lost or displaced"
    elif which == -7:
        what = Text(f"two runs that overlap miss the corner by {share:9} of its tolerance")
    else:
        what = Text(f"the path jumps by {share:3} of a limit between two pieces")
    return Fault(int(line[int(row[0])]), float(begins[int(row[1])] + row[2]), what)
