"""Spans of a motion between the knots of a spline: their places, what is looked at in each, and back into time."""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.path.motion import cubic, way
from feeddrive.path.pieces import derivatives
from feeddrive.path.schedule.ramp import boxcars
from feeddrive.path.schedule.room import bounds, cap
from feeddrive.path.schedule.spline import at, basis

GRADE = 0.1  # by how much the duration of a span may change over its duration
_NEAR = 0.998  # of a limit may be used near the ends
POINTS = 2  # of a span on one piece of the path


@kernel
def tops(kind: Ints, length: Floats, shape: Floats3, feed: Floats, limits: Floats2, out: Floats, most: Floats2) -> int:
    """The speed u' that feed and velocities allow on each piece, into `out`; `most` is room, (N, 4)."""
    for p in range(len(length)):
        norm = bounds(kind[p], length[p], shape[p], most)
        out[p] = cap(most, norm, feed[p], limits, 1e30)
    return 0


@kernel
def ramp_gain(
    kind: Ints, length: Floats, shape: Floats3, limits: Floats2,
    duration: Floats, piece: Ints, x: Floats, speed: Floats, acceleration: Floats, jerk: Floats, snap: Floats,
    first: int, last: int, r: Floats2,
) -> float:  # fmt: skip
    """The time, s, that a ramp of time pieces `first` to before `last` would save if its path were straight.

    On a line in the direction of either end, the more favorable one, it takes L1 + L2 + L3 between the same speeds; the
    way that this saves is gone at the higher one.  1e300 if it is more than one ramp.
    """
    lasts = 0.0
    for m in range(first, last):
        if m > first and acceleration[m] == 0.0 and jerk[m] == 0.0:
            return 1e300
        lasts = lasts + duration[m]
    m = last - 1
    v = cubic(speed[m], acceleration[m], jerk[m], snap[m], duration[m])
    rise = abs(v - speed[first])
    p = int(piece[first])
    here = x[first]
    a = 0.0
    j = 0.0
    s = 0.0
    for _ in range(2):
        derivatives(kind[p], length[p], shape[p], min(here, length[p]), r)
        slowest = 1e300
        for i in range(len(limits)):
            if r[i, 1] != 0.0:
                slowest = min(slowest, limits[i, 1] / abs(r[i, 1]))
        a = max(a, slowest)
        slowest = 1e300
        for i in range(len(limits)):
            if r[i, 1] != 0.0:
                slowest = min(slowest, limits[i, 2] / abs(r[i, 1]))
        j = max(j, slowest)
        slowest = 1e300
        for i in range(len(limits)):
            if r[i, 1] != 0.0:
                slowest = min(slowest, limits[i, 3] / abs(r[i, 1]))
        s = max(s, slowest)
        p = int(piece[m])
        here = x[m] + way(speed[m], acceleration[m], jerk[m], snap[m], duration[m])
        while here > length[p] and p + 1 < len(length):
            here = here - length[p]
            p = p + 1
    b, c, d = boxcars(rise, a, j, s)
    return (lasts - b - c - d) * 0.5 * rise / max(v, speed[first])


@kernel
def graded(duration: Floats, edge: Floats) -> int:
    """Lower the steps at the ends of time pieces, s, until they change by no more than `GRADE` over the time."""
    n = len(duration)
    for m in range(n):
        edge[m + 1] = min(edge[m + 1], edge[m] + GRADE * duration[m])
    for back in range(n):
        m = n - 1 - back
        edge[m] = min(edge[m], edge[m + 1] + GRADE * duration[m])
    return 0


@kernel
def instants(duration: Floats, step: Floats, edge: Floats, out: Floats) -> int:
    """Times of knots, s, `step` apart in each time piece and `edge` at their ends, and graded between; how many."""
    n = len(duration)
    count = 0
    t = 0.0  # in the present piece
    gone = 0.0
    for m in range(n):
        T = duration[m]
        while t < T:
            out[count] = gone + t
            count = count + 1
            t = t + min(step[m], min(edge[m] + GRADE * t, (edge[m + 1] + GRADE * (T - t)) / (1.0 + GRADE)))
        t = t - T
        gone = gone + T
    # the last one comes too late by less than a step: all are moved a little
    for k in range(count):
        out[k] = out[k] * (gone / (gone + t))
    out[count] = gone
    return count + 1


@kernel
def states(
    duration: Floats, piece: Ints, x: Floats, speed: Floats, acceleration: Floats, jerk: Floats, snap: Floats,
    begin: Floats, time: Floats, out: Floats2,
) -> int:  # fmt: skip
    """u to u''' of a motion at rising times; `begin` is u where each piece of the path begins."""
    m = 0
    gone = 0.0
    for k in range(len(time)):
        while m + 1 < len(duration) and time[k] >= gone + duration[m]:
            gone = gone + duration[m]
            m = m + 1
        t = time[k] - gone
        v = speed[m]
        a = acceleration[m]
        j = jerk[m]
        s = snap[m]
        out[k, 0] = begin[piece[m]] + x[m] + way(v, a, j, s, t)
        out[k, 1] = cubic(v, a, j, s, t)
        out[k, 2] = a + t * (j + 0.5 * t * s)
        out[k, 3] = j + t * s
    return 0


@kernel
def points(
    kind: Ints, length: Floats, shape: Floats3, begin: Floats, top: Floats, limits: Floats2, shares: Floats,
    knots: Floats, time: Floats,
    span: Ints, row: Floats3, r: Floats3, most: Floats, full: Ints, weight: Floats, away: Floats, d: Floats2,
) -> int:  # fmt: skip
    """What `quickest` looks at: begin and end of what lies of each span on each piece; how many points.

    At the end only the snap, which differs from that at the begin behind it.

    begin   u where each piece of the path begins
    top     speed that feed and velocities allow on it
    shares  of the limits of velocity to snap that may be used; more near the ends, where the state is given
    time    of the knots in the motion so far, s
    """
    count = 0
    p = 0
    axes = len(limits)
    n = len(time) - 1
    for k in range(n):
        near = k < 3 or k >= n - 3
        x = knots[k + 3]
        ends = knots[k + 4]
        first = count
        while x < ends:
            while p + 1 < len(length) and begin[p + 1] <= x:
                p = p + 1
            e = min(ends, begin[p + 1]) if p + 1 < len(length) else ends
            for place in range(POINTS):
                here = x if place == 0 else e
                span[count] = k
                basis(knots, k, here, row[count])
                derivatives(kind[p], length[p], shape[p], min(max(here - begin[p], 0.0), length[p]), d)
                most[count] = top[p] * top[p] * (1.0 if near else shares[0] * shares[0])
                a_share = _NEAR if near else shares[1]
                j_share = _NEAR if near else shares[2]
                s_share = _NEAR if near else shares[3]
                full[count] = 1 if place == 0 else 0
                away[count] = 0.5 * (e - x)
                for i in range(axes):
                    for c in range(2):
                        r[count, i, c] = d[i, c + 1] / (limits[i, 1] * a_share)
                    for c in range(3):
                        r[count, i, 2 + c] = d[i, c + 1] / (limits[i, 2] * j_share)
                    for c in range(4):
                        r[count, i, 5 + c] = d[i, c + 1] / (limits[i, 3] * s_share)
                count = count + 1
            x = e
        for c in range(first, count):
            weight[c] = (time[k + 1] - time[k]) / (count - first)
    full[0] = 0  # where it begins is given
    return count


@kernel
def _bent(first: int, last: int, miss: Floats, duration: Floats, snap: Floats, row: Floats2, system: Floats2) -> int:
    """Add to the snaps of spans `first` to before `last` the least that adds `miss` to u' .. u at their end."""
    whole = 0.0
    for m in range(first, last):
        whole = whole + duration[m]
    for c in range(4):
        for b in range(4):
            system[c, b] = 0.0
    # miss of u''', u'', u', u in units of that time
    system[0, 4] = miss[3] / whole
    system[1, 4] = miss[2] / (whole * whole)
    system[2, 4] = miss[1] / (whole * whole * whole)
    system[3, 4] = miss[0] / (whole * whole * whole * whole)
    left = 1.0
    for m in range(first, last):
        low = max(left - duration[m] / whole, 0.0)
        # a snap from `left` to `low` before the end adds (leftᶜ - lowᶜ) / c!
        p = left
        q = low
        for c in range(4):
            row[m - first, c] = (p - q) / (1.0 if c == 0 else (2.0 if c == 1 else (6.0 if c == 2 else 24.0)))
            p = p * left
            q = q * low
        for c in range(4):
            for b in range(4):
                system[c, b] = system[c, b] + row[m - first, c] * row[m - first, b] / row[m - first, 0]
        left = low
    for c in range(4):
        for b in range(c + 1, 4):
            f = system[b, c] / system[c, c]
            for k in range(c, 5):
                system[b, k] = system[b, k] - f * system[c, k]
    for back in range(4):
        c = 3 - back
        for b in range(c + 1, 4):
            system[c, 4] = system[c, 4] - system[c, b] * system[b, 4]
        system[c, 4] = system[c, 4] / system[c, c]
    for m in range(first, last):
        add = 0.0
        for c in range(4):
            add = add + row[m - first, c] * system[c, 4]
        snap[m] = snap[m] + add / row[m - first, 0]
    return 0


@kernel
def in_time(
    knots: Floats, coefficient: Floats, begin: Floats, ends: Floats2, together: int,
    duration: Floats, piece: Ints, x: Floats, speed: Floats, acceleration: Floats, jerk: Floats, snap: Floats,
    found: Floats2, room: Floats2, system: Floats2,
) -> bool:  # fmt: skip
    """A piece of constant snap for each span; False if the spline is not above 0 everywhere.

    As many pieces as are taken `together` end where the spline does, exactly.

    The time of a span is ∫ du/√z by Gauss's rule of four points; its snap changes u''' by as much as the spline does,
    and a little more, so that u, u' and u'' meet the spline, too.  `ends` are u' .. u''' where it begins and ends.
    """
    n = len(duration)
    z = zeros(4)
    miss = zeros(4)
    for k in range(n + 1):
        near = min(k, n - 1)
        basis(knots, near, knots[k + 3], room)
        at(room, coefficient, near, z)
        if z[0] <= 0.0 and k > 0 and k < n:
            return False
        v = sqrt(max(z[0], 0.0))
        found[k] = v, 0.5 * z[1], 0.5 * v * z[2]
    for c in range(3):
        found[0, c] = ends[0, c]
        found[n, c] = ends[1, c]
    for k in range(n):
        h = knots[k + 4] - knots[k + 3]
        lasts = 0.0
        for number in range(4):
            place = 0.8611363115940526 if number % 2 == 0 else 0.3399810435848563
            share = 0.3478548451374538 if number % 2 == 0 else 0.6521451548625461
            place = 0.5 - 0.5 * place if number < 2 else 0.5 + 0.5 * place
            basis(knots, k, knots[k + 3] + place * h, room)
            at(room, coefficient, k, z)
            if z[0] <= 0.0:
                return False
            lasts = lasts + 0.5 * share * h / sqrt(z[0])
        duration[k] = lasts
        snap[k] = (found[k + 1, 2] - found[k, 2]) / lasts
    p = 0
    first = 0
    while first < n:
        last = first + together if n - first >= 2 * together else n
        for again in range(3):
            u = 0.0
            v = found[first, 0]
            a = found[first, 1]
            j = found[first, 2]
            for k in range(first, last):
                t = duration[k]
                s = snap[k]
                if again == 2:
                    here = knots[first + 3] + u
                    while p + 2 < len(begin) and begin[p + 1] <= here:
                        p = p + 1
                    piece[k] = p
                    x[k] = here - begin[p]
                    speed[k] = v
                    acceleration[k] = a
                    jerk[k] = j
                u = u + way(v, a, j, s, t)
                v = cubic(v, a, j, s, t)
                a = a + t * (j + 0.5 * t * s)
                j = j + t * s
            if again < 2:
                # the second time for what the first one leaves by rounding
                miss[0] = knots[last + 3] - knots[first + 3] - u
                miss[1] = found[last, 0] - v
                miss[2] = found[last, 1] - a
                miss[3] = found[last, 2] - j
                _bent(first, last, miss, duration, snap, room, system)
        first = last
    return True
