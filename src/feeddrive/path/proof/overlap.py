"""The proof of two runs that overlap: limits of the sum of both motions, and its distance to the corner between them.

While the run before comes to rest in the corner c and the next one leaves it, q = q0 + q1 - c.  Each derivative of q is
the sum of two motions along one piece each.  With r' near its middle the largest terms of both are one polynomial of
time, whose range is exact, also where they cancel; the others are intervals (`ranges`).

Let w0 be the way that is left of the first and w1 that which is done of the second, and t* the time at which they are
equal.  Between lines q stands for the point of the path at the way w1 - w0 from the corner, from which it is
min(w0, w1) |t1 - t0| away: most at t*.  Otherwise it stands for q0 before t*, at most w1 away, for q1 behind, and at t*
for the path between them: the distance (of Fréchet) is at most max(w0, w1, |q - c|) there, and what the pieces bend
beside their chords.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats2, Floats3
from feeddrive.path.motion import chain, way
from feeddrive.path.pieces import derivatives
from feeddrive.path.proof.ranges import (
    add_ranges,
    cubic_range,
    largest_share,
    line_range,
    parabola_range,
    products,
    slopes,
)


@kernel
def _taken(
    kind: int, length: float, shape: Floats2, x: float, s: float, u: Floats2, b: float, e: float, r: Floats3
) -> float:
    """Intervals of one motion over a span: products in `u`, r' .. r'''' in `r`; u' and on at t = 0 from u[9]."""
    v = u[9, 0]
    a = u[10, 0]
    j = u[11, 0]
    v0, v1 = cubic_range(v, a, j, s, b, e)
    a0, a1 = parabola_range(a, j, s, b, e)
    j0, j1 = line_range(j, s, b, e)
    products(v0, v1, a0, a1, j0, j1, u)
    x0 = min(max(x + way(v, a, j, s, b), 0.0), length)
    x1 = min(max(x + way(v, a, j, s, e), 0.0), length)
    return slopes(kind, length, shape, x0, max(x0, x1), r)


@kernel
def _share(
    kind0: int, length0: float, shape0: Floats2, x0: float, s0: float, u0: Floats2,
    kind1: int, length1: float, shape1: Floats2, x1: float, s1: float, u1: Floats2,
    limits: Floats2, feed: float, b: float, e: float, slack: float, r0: Floats3, r1: Floats3,
) -> tuple[float, int]:  # fmt: skip
    """The largest share of a limit that the sum may take from b to e, and which, as `share_of_limits`."""
    out = zeros(4, 3)
    _taken(kind0, length0, shape0, x0, s0, u0, b, e, r0)
    _taken(kind1, length1, shape1, x1, s1, u1, b, e, r1)
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
def _derived(kind: int, length: float, shape: Floats2, x: float, s: float, u: Floats2, r: Floats2, q: Floats2) -> int:
    """r - r(0) into the first column of r, and q' .. q'''' of one motion into columns 1 to 4 of q."""
    derivatives(kind, length, shape, min(max(x, 0.0), length), r)
    chain(u[9, 0], u[10, 0], u[11, 0], s, r, q)
    return 0


@kernel
def prove_sum(
    kind0: int, length0: float, shape0: Floats2, motion0: Floats2,
    kind1: int, length1: float, shape1: Floats2, motion1: Floats2,
    limits: Floats2, widened: float, feed: float, faults: Floats2, uses: Floats2, r: Floats3, q: Floats3,
) -> tuple[int, int, float]:  # fmt: skip
    """Spans looked at, faults found, and a bound of the distance, m, of motions with the same pieces of time.

    Each fault is a row of `faults`: time piece, time in it, limit, share.
    """
    spans = 0
    found = 0
    halves = zeros(64, 2)
    u0 = zeros(12, 2)
    u1 = zeros(12, 2)
    r0 = zeros(12, 4, 2)
    r1 = zeros(12, 4, 2)
    for m in range(len(motion0)):
        x0 = motion0[m, 1]
        x1 = motion1[m, 1]
        s0 = motion0[m, 5]
        s1 = motion1[m, 5]
        for k in range(3):
            u0[9 + k, 0] = motion0[m, 2 + k]
            u1[9 + k, 0] = motion1[m, 2 + k]
        _derived(kind0, length0, shape0, x0, s0, u0, r[0], q[0])
        _derived(kind1, length1, shape1, x1, s1, u1, r[1], q[1])
        for i in range(len(limits)):
            for k in range(4):
                uses[i, k] = max(uses[i, k], abs(q[0, i, k + 1] + q[1, i, k + 1]) / limits[i, k])
        count = 1
        halves[0] = 0.0, motion0[m, 0]
        shortest = motion0[m, 0] * 1e-12
        while count > 0:
            count = count - 1
            b = halves[count, 0]
            e = halves[count, 1]
            spans = spans + 1
            share, which = _share(
                kind0, length0, shape0, x0, s0, u0, kind1, length1, shape1, x1, s1, u1,
                limits, feed, b, e, 1e-13, r0, r1,
            )  # fmt: skip
            if share <= 1.0 + widened:
                continue
            middle = 0.5 * (b + e)
            share, which = _share(
                kind0, length0, shape0, x0, s0, u0, kind1, length1, shape1, x1, s1, u1,
                limits, feed, middle, middle, -1e-13, r0, r1,
            )  # fmt: skip
            if share > 1.0 + widened or e - b <= shortest or count + 2 > len(halves):
                if found < len(faults):
                    faults[found] = 0.0, float(m), middle, float(which), share
                found = found + 1
                break
            halves[count] = middle, e
            halves[count + 1] = b, middle
            count = count + 2
    away = distance(kind0, length0, shape0, motion0, kind1, length1, shape1, motion1, r)
    return spans, found, away


@kernel
def _place(motion: Floats2, t: float) -> float:
    """Where a motion is at t."""
    begin = 0.0
    m = 0
    while m + 1 < len(motion) and t >= begin + motion[m, 0]:
        begin = begin + motion[m, 0]
        m = m + 1
    return motion[m, 1] + way(motion[m, 2], motion[m, 3], motion[m, 4], motion[m, 5], t - begin)


@kernel
def distance(
    kind0: int, length0: float, shape0: Floats2, motion0: Floats2,
    kind1: int, length1: float, shape1: Floats2, motion1: Floats2,
    r: Floats3,
) -> float:  # fmt: skip
    """A bound of the distance between q and the corner's two pieces, m, of motions that do not run backwards."""
    r0 = zeros(12, 4, 2)
    r1 = zeros(12, 4, 2)
    norm0 = slopes(kind0, length0, shape0, min(max(motion0[0, 1], 0.0), length0), length0, r0)
    last = len(motion1) - 1
    x1 = motion1[last, 1] + way(
        motion1[last, 2], motion1[last, 3], motion1[last, 4], motion1[last, 5], motion1[last, 0]
    )
    norm1 = slopes(kind1, length1, shape1, 0.0, min(max(x1, 0.0), length1), r1)
    low = 0.0
    high = 0.0
    for m in range(len(motion0)):
        high = high + motion0[m, 0]
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
        # q - c, and how far the pieces bend beside their chords to the corner
        apart = r[1, i, 0] - r[0, i, 0] + r[2, i, 0]
        gap = gap + apart * apart
        apart = r[2, i, 1] / norm1 - r[0, i, 1] / norm0
        turn = turn + apart * apart
        p = max(-r0[i, 1, 0], r0[i, 1, 1])
        bend0 = bend0 + p * p
        p = max(-r1[i, 1, 0], r1[i, 1, 1])
        bend1 = bend1 + p * p
    if bend0 == 0.0 and bend1 == 0.0:
        return sqrt(turn) * max(left, done) * (1.0 + 1e-12)
    bent = 0.125 * max(sqrt(bend0) * (length0 - x0) * (length0 - x0), sqrt(bend1) * x1 * x1)
    return max(max(left, done), sqrt(gap) + bent) * (1.0 + 1e-12)
