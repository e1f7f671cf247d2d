"""Motion through the corner between two runs: overlapping stops or a bump in time, whichever is faster.

Overlap: the next run begins before the previous one has come to rest.  With T0 the duration of the first run, D the
time during which both move, and c the position of the corner, q = q0(t) + q1(t - T0 + D) - c.  The limits apply to the
sum of both motions.  Between lines the tolerance is satisfied if q is close enough to the corner at the time when both
runs are at equal distances from it; between other pieces these distances must also be within the tolerance.

Bump: a run that passes a corner at the speed v has a node there, where u'' = u''' = 0.  To remove the jump t1 - t0 of
its direction, the motion is superposed with v (t1 - t0) phi(t), phi = K * (t)_+ - (t)_+, K = box(w) * box(w) * box(s),
s <= w, which is 0 at |t| >= h = w + s/2.  This equals an overlap of two stops by 2 h: with H the unit step smoothed by
K, the first run has the speed u' - v H, continues for h after the node, and comes to rest in the corner; the other
begins h before the node and has the speed u' - v (1 - H).  Both are nearest to the corner at the node, at the distance
v phi(0):

    phi(0) = w/6 + s²/(24 w) - s³/(192 w²)
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, zeros
from feeddrive.path.motion import (
    LINE,
    Entering,
    Motion,
    Part,
    Pieces,
    Section,
    cubic,
    derivatives,
    from_rows,
    rows,
    way,
)
from feeddrive.path.schedule.ramp import bounds, boxcars, cube_root, jerk_before, phase

_HALVINGS = 24  # largest number of halvings of the overlap
_SLIVER = 1e-12  # of an overlap: two phases that end so close together end simultaneously
BELOW = 1.0 - 1e-10  # of a tolerance, for rounding


@kernel
def _widened(low: float, high: float, down: float, up: float, more: float, out: Floats) -> int:
    """Add [low, high] · [-down, up] ± more to the interval in `out`."""
    out[0] = out[0] + min(min(-low * down, -high * down), min(low * up, high * up)) - more
    out[1] = out[1] + max(max(-low * down, -high * down), max(low * up, high * up)) + more
    return 0


@kernel
def _bent(most: Floats, c: float, v: float, a: float, j: float, s: float, h: float, away: float, out: Floats2) -> int:
    """Add to the rows of `out` the ranges by which the velocity, acceleration, jerk and snap of an axis may differ from
    those of motion along the tangent, due to curvature.

    c is r' of the axis at the corner, `most` are bounds on r' .. r'''', and `away` is a bound on the distance to the
    corner; u' .. u'''' are the values at the start of an interval of h seconds.
    """
    # r' - c
    up = min(most[1] * away, max(most[0] - c, 0.0))
    down = min(most[1] * away, max(most[0] + c, 0.0))
    j1 = j + h * s
    a1 = a + 0.5 * h * j
    a2 = a + h * (j + 0.5 * h * s)
    A = max(max(abs(a), abs(a1)), abs(a2))
    J = max(abs(j), abs(j1))
    V = abs(v) + h * A
    _widened(0.0, V, down, up, 0.0, out[0])
    _widened(min(min(a, a1), a2), max(max(a, a1), a2), down, up, most[1] * V * V, out[1])
    _widened(min(j, j1), max(j, j1), down, up, 3.0 * most[1] * V * A + most[2] * V * V * V, out[2])
    more = most[1] * (3.0 * A * A + 4.0 * V * J) + 6.0 * most[2] * V * V * A + most[3] * V * V * V * V
    _widened(s, s, down, up, more, out[3])
    return 0


@kernel
def _largest(value: float, rest: Floats) -> float:
    """Return the largest |value + r| for all r in the interval `rest`."""
    return max(abs(value + rest[0]), abs(value + rest[1]))


@kernel
def together(
    motion0: Floats2,
    count0: int,
    length0: float,
    direction0: Floats,
    most0: Floats2,
    motion1: Floats2,
    count1: int,
    direction1: Floats,
    most1: Floats2,
    lasts: float,
    limits: Floats2,
    feed: float,
) -> tuple[float, float]:
    """Return the peak utilization of the limits and the feed by the sum of two motions, and the distance to the corner,
    m.

    The first motion ends on a piece of the given length, the second begins on another piece, and they overlap for
    `lasts` seconds; the directions are r' at the corner.  Ranges are bounded by Bernstein points.
    """
    axes = len(limits)
    p0 = zeros(4)
    p1 = zeros(4)
    p2 = zeros(4)
    rest = zeros(4, 2)
    curved = 0.0
    for i in range(axes):
        curved = max(curved, max(most0[i, 1], most1[i, 1]))
    # where the first motion is when the second begins
    m = count0
    left = lasts
    while m > 0 and left > 0.0:
        m = m - 1
        left = left - motion0[m, 0]
    begin0 = left  # of time piece m, from when the second begins
    n = 0
    begin1 = 0.0
    t = 0.0
    share = 0.0
    distance = 1e300
    while t < lasts and m < count0 and n < count1:
        end0 = begin0 + motion0[m, 0]
        end1 = begin1 + motion1[n, 0]
        end = min(min(end0, end1), lasts)
        # both last intervals end with the overlap, although the sums of durations differ from it by rounding
        if m + 1 == count0 and n + 1 == count1:
            end = lasts
        h = end - t
        if h > _SLIVER * lasts:
            b = t - begin0
            s0 = motion0[m, 5]
            x0 = motion0[m, 1] + way(motion0[m, 2], motion0[m, 3], motion0[m, 4], s0, b)
            v0 = cubic(motion0[m, 2], motion0[m, 3], motion0[m, 4], s0, b)
            a0 = motion0[m, 3] + b * (motion0[m, 4] + 0.5 * b * s0)
            j0 = motion0[m, 4] + b * s0
            b = t - begin1
            s1 = motion1[n, 5]
            x1 = motion1[n, 1] + way(motion1[n, 2], motion1[n, 3], motion1[n, 4], s1, b)
            v1 = cubic(motion1[n, 2], motion1[n, 3], motion1[n, 4], s1, b)
            a1 = motion1[n, 3] + b * (motion1[n, 4] + 0.5 * b * s1)
            j1 = motion1[n, 4] + b * s1
            far0 = max(length0 - x0, 0.0)
            far1 = max(x1 + way(v1, a1, j1, s1, h), 0.0)
            speed = 0.0
            for k in range(4):
                p2[k] = 0.0
            for i in range(axes):
                c0 = direction0[i]
                c1 = direction1[i]
                v = c0 * v0 + c1 * v1
                a = c0 * a0 + c1 * a1
                j = c0 * j0 + c1 * j1
                s = c0 * s0 + c1 * s1
                for k in range(4):
                    rest[k] = 0.0, 0.0
                if curved > 0.0:
                    _bent(most0[i], c0, v0, a0, j0, s0, h, far0, rest)
                    _bent(most1[i], c1, v1, a1, j1, s1, h, far1, rest)
                p0[0] = v
                p0[1] = v + h * a / 3.0
                p0[2] = v + h * (2.0 * a + 0.5 * h * j) / 3.0
                p0[3] = cubic(v, a, j, s, h)
                p1[0] = a
                p1[1] = a + 0.5 * h * j
                p1[2] = a + h * (j + 0.5 * h * s)
                most = 0.0
                for k in range(4):
                    fast = _largest(p0[k], rest[0])
                    p2[k] = p2[k] + fast * fast
                    most = max(most, fast)
                share = max(share, most / limits[i, 0])
                for k in range(3):
                    share = max(share, _largest(p1[k], rest[1]) / limits[i, 1])
                share = max(share, max(_largest(j, rest[2]), _largest(j + h * s, rest[2])) / limits[i, 2])
                share = max(share, _largest(s, rest[3]) / limits[i, 3])
            for k in range(4):
                speed = max(speed, p2[k])
            share = max(share, sqrt(speed) / feed)
            end_left = length0 - (x0 + way(v0, a0, j0, s0, h))
            if distance == 1e300 and (end_left <= far1 or end >= lasts):
                # the distances to the corner become equal here
                low = 0.0
                high = h
                for _ in range(50):
                    b = 0.5 * (low + high)
                    if length0 - (x0 + way(v0, a0, j0, s0, b)) > x1 + way(v1, a1, j1, s1, b):
                        low = b
                    else:
                        high = b
                b = 0.5 * (low + high)
                w0 = length0 - (x0 + way(v0, a0, j0, s0, b))
                w1 = x1 + way(v1, a1, j1, s1, b)
                gap = 0.0
                size0 = 0.0
                size1 = 0.0
                bend = 0.0
                for i in range(axes):
                    g = w1 * direction1[i] - w0 * direction0[i]
                    gap = gap + g * g
                    size0 = size0 + most0[i, 0] * most0[i, 0]
                    size1 = size1 + most1[i, 0] * most1[i, 0]
                    bend = bend + max(most0[i, 1] * w0 * w0, most1[i, 1] * w1 * w1)
                distance = sqrt(gap)
                if curved > 0.0:
                    distance = max(max(w0 * sqrt(size0), w1 * sqrt(size1)), distance + 2.0 * bend)
        if end0 <= end:
            begin0 = end0
            m = m + 1
        if end1 <= end:
            begin1 = end1
            n = n + 1
        t = end
    return share, distance


@kernel
def overlap(
    motion0: Floats2,
    count0: int,
    length0: float,
    direction0: Floats,
    most0: Floats2,
    motion1: Floats2,
    count1: int,
    direction1: Floats,
    most1: Floats2,
    longest: float,
    tolerance: float,
    limits: Floats2,
    feed: float,
) -> float:
    """Return the longest overlap up to `longest` that satisfies limits and tolerance, found by bisection, or 0 if there
    is none.
    """
    low = 0.0
    high = longest
    lasts = longest
    for _ in range(_HALVINGS):
        share, distance = together(
            motion0,
            count0,
            length0,
            direction0,
            most0,
            motion1,
            count1,
            direction1,
            most1,
            lasts,
            limits,
            feed,
        )
        if share <= 1.0 + 1e-10 and distance <= tolerance * BELOW:
            low = lasts
        else:
            high = lasts
        if high - low <= 1e-6 * high:
            break
        lasts = 0.5 * (low + high)
    return low


@kernel
def _state_at(row: Floats, t: float, lasts: float, out: Floats) -> int:
    """Write into `out` the section of a time interval that begins at t and lasts `lasts` seconds."""
    out[0] = lasts
    out[1] = row[1] + way(row[2], row[3], row[4], row[5], t)
    out[2] = cubic(row[2], row[3], row[4], row[5], t)
    out[3] = row[3] + t * (row[4] + 0.5 * t * row[5])
    out[4] = row[4] + t * row[5]
    out[5] = row[5]
    return 0


@kernel
def shared(
    one: Floats2, two: Floats2, lasts: float, last: Floats2, first: Floats2, rest: Floats
) -> tuple[int, int, float, int]:
    """Split the last `lasts` seconds of one motion and the first `lasts` seconds of the other into common time
    intervals; return their number.

    The other results are the interval of the first motion in which the overlap starts, its duration in s before the
    overlap, and the interval of the second motion in which the overlap ends, whose remainder is `rest`.  Ends within
    1e-12 of the overlap time are treated as simultaneous.
    """
    # ends that differ by rounding only would leave intervals of almost no duration
    near = _SLIVER * lasts
    m = len(one)
    left = lasts
    while m > 0 and left > near:
        m = m - 1
        if left < one[m, 0] - near:
            break
        left = left - one[m, 0]
    # the remainders of both current intervals, so that no digits are lost in long ones
    left0 = left if left > near else one[m, 0]
    begins = m
    alone = one[m, 0] - left0
    n = 0
    left1 = two[0, 0]
    count = 0
    while m < len(one) and n < len(two):
        h = min(left0, left1)
        if h > near:
            _state_at(one[m], one[m, 0] - left0, h, last[count])
            _state_at(two[n], two[n, 0] - left1, h, first[count])
            count = count + 1
        left0 = left0 - h
        left1 = left1 - h
        if left0 <= near:
            m = m + 1
            left0 = one[m, 0] if m < len(one) else 0.0
        if left1 <= near:
            n = n + 1
            left1 = two[n, 0] if n < len(two) else 0.0
    if n < len(two):
        _state_at(two[n], two[n, 0] - left1, left1, rest)
    return count, begins, alone, n


def overlapped(one: Part, two: Part, lasts: float, tolerance: float) -> tuple[list[Part], Part]:
    """Overlap two runs by `lasts` s: return the parts until the first run ends, and the rest of the second run."""
    ends, begins = rows(one.motion), rows(two.motion)
    last, first, rest = (np.zeros((len(ends) + len(begins), 6)) for _ in range(3))
    count, m, alone, n = shared(ends, begins, lasts, last, first, rest[0])
    entering = Entering(Pieces(*(array[:1] for array in two.pieces)), from_rows(first[:count], 0), tolerance)
    k = len(one.pieces.length) - 1
    leaves = [Part(Pieces(*(array[k:] for array in one.pieces)), from_rows(last[:count], 0), True, entering)]
    before = Motion(*(array[: m + int(alone > 0.0)].copy() for array in one.motion))
    if len(before.duration):
        before.duration[-1] = alone if alone > 0.0 else before.duration[-1]
        leaves.insert(0, one._replace(motion=before, ends=False))
    behind = Motion(*(array[n:].copy() for array in two.motion))
    if len(behind.duration):
        for column, value in zip([behind.duration, *behind[2:]], rest[0].tolist(), strict=True):
            column[0] = value
    return leaves, two._replace(motion=behind)


# indices into the description of a stretch, as in `straight`
LENGTH, FASTEST, ACCELERATION, JERK, SNAP, HEAD, TAIL, NUMBERS = 0, 1, 2, 3, 4, 5, 10, 15
WIDE, SHORT, JERK_SHARE, SNAP_SHARE = 1, 2, 3, 4  # offsets from the speed at the head and at the tail of a stretch
ROWS = 40  # largest number of rows of its motion
_TRIES = 9  # largest number of trial speeds in a corner
_NEAR = 0.005  # relative accuracy of this speed
_PEAKS = 60  # largest number of trial peaks of a stretch
_FULL = 1e-9  # of its length need not be used by ramps


@kernel
def _phase(at: float, v: float, a: float, j: float, s: float, T: float, count: int, out: Floats2) -> int:
    """Append a time interval if its duration is positive."""
    if T <= 0.0:
        return count
    out[count] = T, at, v, a, j, s
    return count + 1


@kernel
def _ramp(low: float, rise: float, a: float, b: float, c: float, x: float, up: bool, count: int, out: Floats2) -> int:
    """Append the phases of a ramp that starts at x."""
    if rise <= 0.0 or a <= 0.0:
        return count
    sense = 1.0 if up else -1.0
    jerk = rise / (b * c)
    v = low if up else low + rise
    acceleration = 0.0
    for number in range(7):
        T, s = phase(number, rise, a, b, c)
        s = sense * s
        j = sense * jerk_before(number, jerk)
        count = _phase(x, v, acceleration, j, s, T, count, out)
        if T > 0.0:
            x = x + way(v, acceleration, j, s, T)
            v, acceleration = cubic(v, acceleration, j, s, T), acceleration + T * (j + 0.5 * T * s)
    return count


@kernel
def _box(v: float, wide: float, short: float, out: Floats2) -> int:
    """Write the five phases of the speed v H, from rest to v, where H is the smoothed unit step of the module
    docstring.
    """
    k = v / (wide * wide * short)
    x = 0.0
    u = 0.0
    a = 0.0
    j = 0.0
    for number in range(5):
        T = short if number % 2 == 0 else wide - short
        s = 0.0
        if number == 0 or number == 4:
            s = k
        elif number == 2:
            s = -2.0 * k
        j = 0.0 if number == 0 else (k * short if number < 3 else -k * short)
        out[number] = T, x, u, a, j, s
        x = x + way(u, a, j, s, T)
        u, a = cubic(u, a, j, s, T), a + T * (j + 0.5 * T * s)
    return 5


@kernel
def _ramps(stretch: Floats, peak: float) -> tuple[float, float, float, float, float, float]:
    """Return the boxcar widths of both ramps of a stretch: from its head up to a peak speed, and down to its tail."""
    v0 = stretch[HEAD]
    v1 = stretch[TAIL]
    A = stretch[ACCELERATION]
    a, b, c = boxcars(
        peak - v0, A, stretch[HEAD + JERK_SHARE] * stretch[JERK], stretch[HEAD + SNAP_SHARE] * stretch[SNAP]
    )
    d, e, f = boxcars(
        peak - v1, A, stretch[TAIL + JERK_SHARE] * stretch[JERK], stretch[TAIL + SNAP_SHARE] * stretch[SNAP]
    )
    return a, b, c, d, e, f


@kernel
def _used(stretch: Floats, peak: float) -> float:
    """Return the total distance covered by the two ramps of a stretch."""
    a, b, c, d, e, f = _ramps(stretch, peak)
    return 0.5 * ((stretch[HEAD] + peak) * (a + b + c) + (stretch[TAIL] + peak) * (d + e + f))


@kernel
def _peak(stretch: Floats) -> float:
    """Return the highest speed of a stretch, or 0 if no motion is possible."""
    length = stretch[LENGTH]
    low = max(stretch[HEAD], stretch[TAIL])
    high = stretch[FASTEST]
    if low > high:
        return 0.0
    used = _used(stretch, high)
    if used <= length:
        return high
    over = used - length
    under = -length
    if low > 0.0:
        used = _used(stretch, low)
        under = used - length
        if under > 0.0:
            return 0.0
    # regula falsi (Illinois): an end retained twice gets half its weight
    side = 0
    for _ in range(_PEAKS):
        if high - low <= 1e-12 * high or under >= -_FULL * length:
            break
        peak = low - under * (high - low) / (over - under)
        if peak <= low or peak >= high:
            peak = 0.5 * (low + high)
        used = _used(stretch, peak)
        if used > length:
            high = peak
            over = used - length
            under = 0.5 * under if side > 0 else under
            side = 1
        else:
            low = peak
            under = used - length
            over = 0.5 * over if side < 0 else over
            side = -1
    return low


@kernel
def _duration(stretch: Floats, peak: float) -> float:
    """Return the duration in s of the motion on a stretch with this peak speed, bumps included, or 0 if there is no
    motion.
    """
    if peak <= 0.0:
        return 0.0
    a, b, c, d, e, f = _ramps(stretch, peak)
    total = a + b + c + d + e + f + (stretch[LENGTH] - _used(stretch, peak)) / peak
    return total + stretch[HEAD + WIDE] + stretch[TAIL + WIDE] + 0.5 * (stretch[HEAD + SHORT] + stretch[TAIL + SHORT])


@kernel
def straight(stretch: Floats, out: Floats2) -> int:
    """Write the time-optimal motion on a stretch as rows of duration, x and initial u' .. u''''; return their number,
    or 0 if there is no such motion.

    The entries of `stretch` are: length, highest speed; acceleration, jerk and snap limits along the line; for head and
    tail the speed at the node, the boxcar widths w and s of the bump there (0 without a bump: the stretch then begins
    or ends with the node), and the fractions of the jerk and snap limits that the ramp to it may use.
    """
    return _rows(stretch, _peak(stretch), out)


@kernel
def _rows(stretch: Floats, peak: float, out: Floats2) -> int:
    """Write the motion with a given peak speed; return the number of rows, or 0 if there is no motion."""
    length = stretch[LENGTH]
    v0 = stretch[HEAD]
    v1 = stretch[TAIL]
    if peak <= 0.0:
        return 0
    a, b, c, d, e, f = _ramps(stretch, peak)
    base = zeros(20, 6)
    h0 = stretch[HEAD + WIDE] + 0.5 * stretch[HEAD + SHORT]
    h1 = stretch[TAIL + WIDE] + 0.5 * stretch[TAIL + SHORT]
    count = _phase(-v0 * h0, v0, 0.0, 0.0, 0.0, h0, 0, base)
    count = _ramp(v0, peak - v0, a, b, c, 0.0, True, count, base)
    rise = 0.5 * (v0 + peak) * (a + b + c)
    fall = 0.5 * (v1 + peak) * (d + e + f)
    count = _phase(rise, peak, 0.0, 0.0, 0.0, (length - fall - rise) / peak, count, base)
    count = _ramp(v1, peak - v1, d, e, f, length - fall, False, count, base)
    count = _phase(length, v1, 0.0, 0.0, 0.0, h1, count, base)
    head = zeros(5, 6)
    tail = zeros(5, 6)
    heads = 0
    tails = 0
    if h0 > 0.0:
        heads = _box(v0, stretch[HEAD + WIDE], stretch[HEAD + SHORT], head)
    if h1 > 0.0:
        tails = _box(v1, stretch[TAIL + WIDE], stretch[TAIL + SHORT], tail)
    # the base is split where the tail begins: times from the start of a long interval have too few digits at its end
    first = count
    left = 2.0 * h1
    while first > 0 and left > 0.0:
        first = first - 1
        if left < base[first, 0]:
            for k in range(count - first):
                m = count - k
                for i in range(6):
                    base[m, i] = base[m - 1, i]
            count = count + 1
            x, v, u, j, s = base[first, 1], base[first, 2], base[first, 3], base[first, 4], base[first, 5]
            t = base[first, 0] - left
            base[first, 0] = t
            first = first + 1
            base[first] = left, x + way(v, u, j, s, t), cubic(v, u, j, s, t), u + t * (j + 0.5 * t * s), j + t * s, s
            left = 0.0
        else:
            left = left - base[first, 0]
    # base, head and tail are added interval by interval; times from the start of each phase keep their digits
    near = 1e-12 * (h0 + h1)
    p = 0
    q = 0
    tb = 0.0
    th = 0.0
    tt = 0.0
    since = 0.0
    written = 0
    m = 0
    while m < count:
        runs = m >= first
        h = base[m, 0] - tb
        if p < heads:
            h = min(h, head[p, 0] - th)
        if q < tails and runs:
            h = min(h, tail[q, 0] - tt)
        if h > near:
            x = base[m, 1] + way(base[m, 2], base[m, 3], base[m, 4], base[m, 5], tb)
            v = cubic(base[m, 2], base[m, 3], base[m, 4], base[m, 5], tb)
            u = base[m, 3] + tb * (base[m, 4] + 0.5 * tb * base[m, 5])
            j = base[m, 4] + tb * base[m, 5]
            s = base[m, 5]
            if p < heads:
                x = x + v0 * (h0 - since) + (head[p, 1] + way(head[p, 2], head[p, 3], head[p, 4], head[p, 5], th))
                v = v - v0 + cubic(head[p, 2], head[p, 3], head[p, 4], head[p, 5], th)
                u = u + (head[p, 3] + th * (head[p, 4] + 0.5 * th * head[p, 5]))
                j = j + (head[p, 4] + th * head[p, 5])
                s = s + head[p, 5]
            if q < tails and runs:
                x = x - (tail[q, 1] + way(tail[q, 2], tail[q, 3], tail[q, 4], tail[q, 5], tt))
                v = v - cubic(tail[q, 2], tail[q, 3], tail[q, 4], tail[q, 5], tt)
                u = u - (tail[q, 3] + tt * (tail[q, 4] + 0.5 * tt * tail[q, 5]))
                j = j - (tail[q, 4] + tt * tail[q, 5])
                s = s - tail[q, 5]
            out[written] = h, x, v, u, j, s
            written = written + 1
        since = since + h
        tb = tb + h
        if base[m, 0] - tb <= near:
            m = m + 1
            tb = 0.0
        if p < heads:
            th = th + h
            if head[p, 0] - th <= near:
                p = p + 1
                th = 0.0
        if q < tails and runs:
            tt = tt + h
            if tail[q, 0] - tt <= near:
                q = q + 1
                tt = 0.0
    return written


@kernel
def lasting(rows: Floats2, count: int) -> float:
    """Return the total duration of the first `count` rows, s."""
    total = 0.0
    for k in range(count):
        total = total + rows[k, 0]
    return total


@kernel
def width(away: float, short: float) -> tuple[float, float]:
    """Return the boxcar widths w and s of the bump with phi(0) = `away`, s; s is `short`, or w if that is shorter."""
    # with s = w the peak is phi(0) = 39 w/192: a longer s would exceed w
    if 39.0 * short >= 192.0 * away:
        w = away * 192.0 / 39.0
        return w, w
    w = 6.0 * away
    # phi(0) = away solved for w by fixed-point iteration
    for _ in range(60):
        w = 6.0 * away - short * short / (4.0 * w) * (1.0 - short / (8.0 * w))
    return w, short


@kernel
def bump(
    one: Floats,
    direction0: Floats,
    most0: Floats2,
    two: Floats,
    direction1: Floats,
    most1: Floats2,
    before: Floats2,
    before_length: float,
    before_direction: Floats,
    before_most: Floats2,
    lasts: float,
    before_tolerance: float,
    before_feed: float,
    half: bool,
    tolerance: float,
    limits: Floats2,
    feed: float,
    quickest: float,
    rows0: Floats2,
    rows1: Floats2,
    result: Floats,
) -> tuple[int, int]:
    """Find the fastest bump between two stretches; write both motions into `rows0` and `rows1`, and the speed, the
    boxcar widths w and s and the ramp fractions of the bump into `result`; return the numbers of rows.

    `before` overlaps with the first stretch for `lasts` seconds.  Both numbers are 0 if no bump brings the total time
    of both stretches below `quickest` s; with `half`, half of the second stretch remains free for the following corner.

    With d = tolerance/|t1 - t0| and w = 6 d/v the jerk of the bump is v |t1 - t0|/w². Of this jerk the ramps cancel
    less than 1.2 j, where j is the jerk limit, so v³ is at most 2.2 · 36 J d², with J the least j/|t1 - t0| of the
    axes.
    """
    gap = 0.0
    jerk = 1e300
    for i in range(len(limits)):
        g = abs(direction1[i] - direction0[i])
        gap = gap + g * g
        if g * jerk > limits[i, 2]:
            jerk = limits[i, 2] / g
    if gap <= 1e-18:
        return 0, 0
    near = tolerance * BELOW / sqrt(gap)
    fastest = min(min(one[FASTEST], two[FASTEST]), cube_root(79.2 * jerk * near * near))
    best = quickest
    ours = 0.0
    reached = 0.0
    for shape in range(4):
        # ramps and bump add up on some axes and cancel on others: with less jerk for the ramps the bump may be faster
        share = 1.0 if shape == 0 else (0.93 if shape == 1 else (0.85 if shape == 2 else 0.7))
        low = reached  # slower ramps require a higher speed in the corner
        high = fastest
        above = 1.0  # largest share of a limit at `high`; 1 if unknown
        more = 1.0  # the same at the last higher speed, whose cube is `farther`
        farther = 0.0
        v = fastest
        for again in range(_TRIES):
            # the snap of a bump is twice its jerk over s: at the limit of the jerk half of that of the snap
            short = 4.0 * one[JERK] / one[SNAP]
            w, short = width(near / v, short)
            one[TAIL] = v
            one[TAIL + WIDE] = w
            one[TAIL + SHORT] = short
            one[TAIL + JERK_SHARE] = share
            # the snaps of ramp and bump add up in the corner
            one[TAIL + SNAP_SHARE] = 0.5
            for k in range(5):
                two[HEAD + k] = one[TAIL + k]
            good = False
            excess = 1.0  # largest share of a limit; 1 if unknown
            both = 2.0 * w + short
            peak0 = _peak(one)
            peak1 = _peak(two)
            time0 = _duration(one, peak0)
            time1 = _duration(two, peak1)
            time = time0 + time1 - both
            n = 0
            m = 0
            slower = time0 > 0.0 and time1 > 0.0 and time >= best
            if time0 > 0.0 and time1 > 0.0 and not slower:
                n = _rows(one, peak0, rows0)
                m = _rows(two, peak1, rows1)
                good = n > 0 and m > 0
                good = good and both <= time0 - lasts and both <= (0.5 * time1 if half else time1)
            if good:
                most, away = together(
                    rows0, n, one[LENGTH], direction0, most0, rows1, m, direction1, most1, both, limits, feed
                )
                good = most <= 1.0 + 1e-10 and away <= tolerance
                excess = most
            if good and lasts > 0.0:
                most, away = together(
                    before,
                    len(before),
                    before_length,
                    before_direction,
                    before_most,
                    rows0,
                    n,
                    direction0,
                    most0,
                    lasts,
                    limits,
                    before_feed,
                )
                good = most <= 1.0 + 1e-10 and away <= before_tolerance
                excess = most
            if slower or good:
                low = v  # lower speeds are slower as well
                if good:
                    reached = v
                    best = time
                    ours = time
                    for k in range(5):
                        result[k] = one[TAIL + k]
            else:
                farther = high * high * high
                more = above
                high = v
                above = excess
            if high - low <= _NEAR * high:
                break
            # the jerk of a bump grows as v³, that of ramps is constant: a secant in v³ through two infeasible speeds
            v = 0.5 * (low + high)
            if above > 1.0 and more > above:
                cubes = high * high * high
                cubes = cubes - (above - 1.0) * (farther - cubes) / (more - above)
                if cubes > 0.0:
                    v = min(max(cube_root(cubes), (1.0 + 0.9 * _NEAR) * low), v)
            elif above > 1.0 and again == 0:
                v = high / cube_root(above)
                if v <= 0.9 * low:
                    break
                v = max(v, 0.5 * (low + high)) if v <= low else v
    n = 0
    m = 0
    if ours > 0.0:
        for k in range(5):
            one[TAIL + k] = result[k]
            two[HEAD + k] = result[k]
        n = straight(one, rows0)
        m = straight(two, rows1)
    return n, m


_SLOWED = (0.93, 0.85)  # shares of the jerk
_SHORTEST = 1e-4  # s of overlap; less does not justify separate parts


class _End(NamedTuple):
    """The end of a run at a corner: the motion on one piece of its path, its direction at the corner and its bounds."""

    rows: np.ndarray
    lasts: float  # s
    length: float
    feed: float
    direction: np.ndarray
    most: np.ndarray


class _Stretch(NamedTuple):
    """The part of a motion that may be replanned: the time intervals from `first` up to but excluding `last`, on one
    line between two nodes.
    """

    first: int
    last: int
    numbers: np.ndarray  # as in `straight`


class _Run(NamedTuple):
    """A part of the motion whose end may still change, and its overlap with the previous part.

    whole  stretch of a run along one line, whose head and tail are planned together; None for other runs
    seen   motion of such a run at its corners
    """

    part: Part
    tolerance: float  # of the corner in which it ends, m
    whole: _Stretch | None
    seen: _End | None = None
    lasts: float = 0.0  # s
    corner: float = 0.0  # tolerance of that corner


class Crossings:
    """The planner of corners, which starts each run before the previous one has ended as far as limits and tolerances
    allow.

    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    """

    def __init__(self, limits: np.ndarray) -> None:
        self._limits = np.ascontiguousarray(limits, float)
        self._fixed: Part | None = None  # its end may overlap with the next
        self._open: _Run | None = None

    def add(self, part: Part, tolerance: float) -> list[Part]:
        """Add a part and return those that are now final; `tolerance` is the tolerance of the corner at the end of the
        part, m, or 0 for a stop there.
        """
        begins = part.motion.x[0] == 0.0 and part.motion.speed[0] == 0.0
        run = self._line(Section(part.pieces, part.ends, tolerance)) if begins else None
        return self._next(run or _Run(part, tolerance, None))

    def add_line(self, section: Section) -> list[Part] | None:
        """If a section is a complete run along a single line, plan the run in closed form, add it and return the parts
        as `add` does; otherwise return None.
        """
        run = self._line(section)
        return self._next(run) if run else None

    def _next(self, two: _Run) -> list[Part]:
        one, self._open = self._open, two
        if one is None:
            return []
        if one.part.ends and one.tolerance > 0.0:
            one, self._open = self._met(one, two)
        return self._fix(one)

    def end(self) -> list[Part]:
        """Return the remaining parts, after which the motion is at rest."""
        one, self._open = self._open, None
        leaves = self._fix(one) if one else []
        last, self._fixed = self._fixed, None
        return [*leaves, last] if last else leaves

    def _line(self, section: Section) -> _Run | None:
        """Return the run of a section that is a single line, or None for any other section."""
        pieces = section.pieces
        if not section.ends or len(pieces.length) != 1 or pieces.kind[0] != LINE:
            return None
        numbers, motion_rows = self._numbers(pieces, 0, float(pieces.length[0]), 0.0, 0.0), np.zeros((ROWS, 6))
        count = straight(numbers, motion_rows)
        if not count:
            return None
        motion_rows = motion_rows[:count]
        length, feed = float(pieces.length[0]), float(pieces.feed[0])
        direction, most = pieces.shape[0, :, 1] / length, np.zeros((len(self._limits), 4))
        most[:, 0] = np.abs(direction)
        seen = _End(motion_rows, float(np.sum(motion_rows[:, 0])), length, feed, direction, most)
        return _Run(Part(pieces, from_rows(motion_rows, 0), True), section.tolerance, _Stretch(0, count, numbers), seen)

    def _fix(self, run: _Run) -> list[Part]:
        """Make the motion of a run final; return the parts that are now final."""
        before, self._fixed = self._fixed, run.part
        if before is None:
            return []
        if run.lasts == 0.0:
            return [before]
        leaves, self._fixed = overlapped(before, run.part, run.lasts, run.corner)
        return leaves

    def _stopped(self, one: _Run, two: _Run) -> tuple[_Run, _Run]:
        """Return both runs with unchanged motions and their longest overlap."""
        end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
        feed = max(end.feed, begin.feed)
        # half of a run in a single part is reserved for the corner at its other end
        share = 0.5 if two.part.ends else 1.0
        longest = min(end.lasts, begin.lasts, share * _time(two.part.motion), _time(one.part.motion) - one.lasts) * (
            1.0 - 1e-6
        )
        lasts = overlap(
            end.rows,
            len(end.rows),
            end.length,
            end.direction,
            end.most,
            begin.rows,
            len(begin.rows),
            begin.direction,
            begin.most,
            longest,
            one.tolerance,
            self._limits,
            feed,
        )
        return one, two._replace(lasts=lasts if lasts >= _SHORTEST else 0.0, corner=one.tolerance)

    def _met(self, one: _Run, two: _Run) -> tuple[_Run, _Run]:
        """Plan the corner between two runs; return both, the first one in its final form."""
        best = self._stopped(one, two)
        tail = one.whole or self._tail(one.part)
        head = two.whole or self._head(two.part)
        if tail is not None and head is not None:
            end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
            return self._bump(one, end, tail, two, begin, head, best[1].lasts, max(end.feed, begin.feed)) or best
        # next to an arc a slower ramp on the line leaves room for the derivatives that curvature adds on its axes
        for share in _SLOWED if (tail is None) != (head is None) else ():
            slowed = self._slowed(one, tail, TAIL, share), self._slowed(two, head, HEAD, share)
            if slowed[0] and slowed[1]:
                stopped = self._stopped(slowed[0], slowed[1])
                if _together(stopped) < _together(best) and self._holds(stopped[0]):
                    best = stopped
        return best

    def _slowed(self, run: _Run, stretch: _Stretch | None, at: int, share: float) -> _Run | None:
        """Return the run with a slower ramp on the line at the corner: its jerk limit is multiplied by `share`, its
        snap limit by `share`².

        A run without such a stretch is returned unchanged; the result is None if no motion is possible.
        """
        if stretch is None:
            return run
        numbers, motion_rows = stretch.numbers.copy(), np.zeros((ROWS, 6))
        numbers[[at + JERK_SHARE, at + SNAP_SHARE]] = share, share * share
        count = straight(numbers, motion_rows)
        if not count:
            return None
        k = len(run.part.pieces.length) - 1 if at == TAIL else 0
        part = run.part._replace(motion=_spliced(stretch, run.part.motion, k, motion_rows[:count]))
        if not run.whole:
            return run._replace(part=part)
        return run._replace(part=part, whole=_Stretch(0, count, numbers), seen=_made(run.seen, motion_rows[:count]))

    def _holds(self, run: _Run) -> bool:
        """Return True if a replanned run still satisfies limits and tolerance in its overlap with the previous one."""
        if run.lasts == 0.0 or self._fixed is None:
            return True
        end, begin = _end(self._fixed, True), run.seen or _end(run.part, False)
        share, away = together(
            end.rows,
            len(end.rows),
            end.length,
            end.direction,
            end.most,
            begin.rows,
            len(begin.rows),
            begin.direction,
            begin.most,
            run.lasts,
            self._limits,
            max(end.feed, begin.feed),
        )
        return share <= 1.0 + 1e-10 and away <= run.corner

    def _bump(
        self, one: _Run, end: _End, tail: _Stretch, two: _Run, begin: _End, head: _Stretch, lasts: float, feed: float
    ) -> tuple[_Run, _Run] | None:
        """Return both runs with a bump if that is faster than an overlap of `lasts` seconds, or None otherwise."""
        motion0, motion1 = one.part.motion, two.part.motion
        quickest = _time(motion0, tail) + _time(motion1, head) - lasts
        numbers0, numbers1 = tail.numbers.copy(), head.numbers.copy()
        # a run along one line is planned anew as a whole, so that its overlap with the run before must be checked again
        again = one.whole is not None and one.lasts > 0.0 and self._fixed is not None
        before = _end(self._fixed, True) if again and self._fixed else end
        result, rows0, rows1 = np.zeros(5), np.zeros((ROWS, 6)), np.zeros((ROWS, 6))
        count0, count1 = bump(
            numbers0,
            end.direction,
            end.most,
            numbers1,
            begin.direction,
            begin.most,
            before.rows,
            before.length,
            before.direction,
            before.most,
            one.lasts if again else 0.0,
            one.corner,
            max(before.feed, end.feed),
            two.whole is not None,
            one.tolerance,
            self._limits,
            feed,
            quickest,
            rows0,
            rows1,
            result,
        )
        if not count0:
            return None
        n = len(one.part.pieces.length) - 1
        rows0, rows1 = rows0[:count0], rows1[:count1]
        made0, made1 = _spliced(tail, motion0, n, rows0), _spliced(head, motion1, 0, rows1)
        whole = _Stretch(0, count1, numbers1) if two.whole else None
        lasts = 2.0 * float(result[WIDE]) + float(result[SHORT])
        run = two._replace(
            part=two.part._replace(motion=made1),
            whole=whole,
            seen=_made(two.seen, rows1),
            lasts=lasts,
            corner=one.tolerance,
        )
        return one._replace(part=one.part._replace(motion=made0), seen=_made(one.seen, rows0)), run

    def _tail(self, part: Part) -> _Stretch | None:
        """Return the stretch from the first node on the last piece to the stop."""
        motion, last = part.motion, len(part.pieces.length) - 1
        nodes = np.flatnonzero((motion.piece == last) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        if not len(nodes) or part.pieces.kind[last] != LINE:
            return None
        m = int(nodes[0])
        length = float(part.pieces.length[last]) - float(motion.x[m])
        return _Stretch(m, len(motion.piece), self._numbers(part.pieces, last, length, float(motion.speed[m]), 0.0))

    def _head(self, part: Part) -> _Stretch | None:
        """Return the stretch from rest to the last node on the first piece."""
        motion = part.motion
        nodes = np.flatnonzero((motion.piece == 0) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        m = int(nodes[-1]) if len(nodes) else 0
        if not m or part.pieces.kind[0] != LINE:
            return None
        return _Stretch(0, m, self._numbers(part.pieces, 0, float(motion.x[m]), 0.0, float(motion.speed[m])))

    def _numbers(self, pieces: Pieces, k: int, length: float, begin: float, end: float) -> np.ndarray:
        """Return the parameters of a stretch of a line from node to node, as for `straight`."""
        # an axis that does not move sets no limit, and must not divide by zero
        slope = np.maximum(np.abs(pieces.shape[k, :, 1]) / float(pieces.length[k]), 1e-200)
        numbers = np.zeros(NUMBERS)
        numbers[FASTEST : SNAP + 1] = np.min(self._limits / slope[:, None], axis=0) * (1.0 - 1e-12)
        numbers[FASTEST] = min(numbers[FASTEST], float(pieces.feed[k]) / float(np.sqrt(slope @ slope)))
        numbers[LENGTH], numbers[HEAD], numbers[TAIL] = length, begin, end
        numbers[[end + share for end in (HEAD, TAIL) for share in (JERK_SHARE, SNAP_SHARE)]] = 1.0
        return numbers


def _together(both: tuple[_Run, _Run]) -> float:
    """Return the total duration of both runs, s."""
    return _time(both[0].part.motion) + _time(both[1].part.motion) - both[1].lasts


def _time(motion: Motion, stretch: _Stretch | None = None) -> float:
    return float(np.sum(motion.duration[stretch.first : stretch.last] if stretch else motion.duration))


def _spliced(stretch: _Stretch, motion: Motion, k: int, new: np.ndarray) -> Motion:
    """Replace a stretch on piece k of a motion by rows in the form of `straight`."""
    if stretch.first == 0 and stretch.last == len(motion.duration):
        return from_rows(new, k, float(motion.x[0]))
    parts = zip(motion, from_rows(new, k, float(motion.x[stretch.first])), strict=True)
    return Motion(*(np.concatenate([old[: stretch.first], middle, old[stretch.last :]]) for old, middle in parts))


def _made(seen: _End | None, new: np.ndarray) -> _End | None:
    """Return the end of a run with its motion replaced by the rows `new`, or None if there is no such end."""
    return seen._replace(rows=new, lasts=float(np.sum(new[:, 0]))) if seen else None


def _end(part: Part, last: bool) -> _End:
    """Return the end of a part at a corner: on its last piece if `last`, otherwise on its first."""
    pieces, on = part.pieces, part.motion
    k = len(pieces.length) - 1 if last else 0
    if k or not last:
        inside = on.piece == k
        if not last:
            m = int(np.flatnonzero(inside)[-1])  # it may continue on the next piece
            there = on.x[m] + way(*(float(column[m]) for column in (*on[3:], on.duration)))
            inside[m] = inside.all() and there <= pieces.length[k]
        on = Motion(*(column[inside] for column in on))
    kind, length, shape = int(pieces.kind[k]), float(pieces.length[k]), pieces.shape[k]
    most, direction = np.zeros((len(shape), 4)), shape[:, 1] / length
    if kind == LINE:
        most[:, 0] = np.abs(direction)
    else:
        r = np.zeros((len(shape), 5))
        derivatives(kind, length, shape, length if last else 0.0, r)
        direction = r[:, 1].copy()
        bounds(kind, length, shape, most)
    return _End(rows(on), float(np.sum(on.duration)), length, float(pieces.feed[k]), direction, most)
