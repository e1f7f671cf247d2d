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
from typing import NamedTuple, TypeAlias

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Records, by_field, records, rows_for
from feeddrive.path.motion import (
    LINE,
    Derivatives,
    Entering,
    Interval,
    Limits,
    Motion,
    Part,
    Piece,
    Pieces,
    Section,
    cubic,
    derivatives,
    direction,
    from_rows,
    moved,
    part_of_pieces,
    piece_of,
    rows,
    slowed,
    way,
)
from feeddrive.path.schedule.ramp import (
    Ramp,
    Slopes,
    acceleration_before,
    bounds,
    boxcars,
    cube_root,
    duration,
    jerk_before,
    phase,
    ramp_jerk,
)

_HALVINGS = 24  # largest number of halvings of the overlap
_TOLERANT = 0.02  # relative accuracy of the longest overlap within the tolerance
_SHORTER = 8  # number of overlaps tried with slower motions, in equal steps
_SLIVER = 1e-12  # of an overlap: two phases that end so close together end simultaneously
BELOW = 1.0 - 1e-10  # of a tolerance, for rounding


class Range(NamedTuple):
    """An interval of numbers."""

    low: float
    high: float


class Ranges(NamedTuple):
    """Intervals of the velocity, acceleration, jerk and snap of an axis."""

    velocity: Range
    acceleration: Range
    jerk: Range
    snap: Range


class Curve(NamedTuple):
    """Ranges of u' .. u''' and of what curvature multiplies: u'², u' u'', u'³, 3 u''² + 4 u' u''', 6 u'² u'', u'⁴."""

    speed: Range
    acceleration: Range
    jerk: Range
    square: Range
    power: Range
    cube: Range
    mixed: Range
    cubed: Range
    fourth: Range


_ZERO = Range(0.0, 0.0)
_STILL = Curve(_ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO)
_NOTHING = Ranges(Range(0.0, 0.0), Range(0.0, 0.0), Range(0.0, 0.0), Range(0.0, 0.0))


class End(NamedTuple):
    """The end of a run at a corner: its motion on one piece of its path, and this piece.

    motion     time intervals, of which the first `used` count
    lasts      their duration, s
    length     of the piece, m
    feed       m/s
    direction  r' at the corner, shape (N,)
    most       bounds of each axis on the piece
    piece      the piece, with workspace for its derivatives
    """

    motion: Records[Interval]
    used: int
    lasts: float
    length: float
    feed: float
    direction: Floats
    most: Records[Slopes]
    piece: Piece
    rates: Records[Derivatives]


@kernel
def _sum(one: Range, two: Range) -> Range:
    """Return the interval of the sums of two numbers."""
    return Range(one.low + two.low, one.high + two.high)


@kernel
def _product(one: Range, two: Range) -> Range:
    """Return the interval of the products of two numbers."""
    a = one.low * two.low
    b = one.low * two.high
    c = one.high * two.low
    d = one.high * two.high
    return Range(min(min(a, b), min(c, d)), max(max(a, b), max(c, d)))


@kernel
def _times(factor: float, rest: Range) -> Range:
    """Return the interval of the multiples of a number."""
    return Range(min(factor * rest.low, factor * rest.high), max(factor * rest.low, factor * rest.high))


@kernel
def _near(value: float, change: float, most: float) -> Range:
    """Return the interval of a number that is at most `most` in size and differs from `value` by at most `change`."""
    return Range(max(value - change, -most), min(value + change, most))


@kernel
def _along_curve(now: Interval, h: float) -> Curve:
    """Return the ranges of a motion in h seconds that curvature multiplies."""
    _, _, v, a, j, s = now
    v1 = v + h * a / 3.0
    v2 = v + h * (2.0 * a + 0.5 * h * j) / 3.0
    v3 = cubic(v, a, j, s, h)
    a1 = a + 0.5 * h * j
    a2 = a + h * (j + 0.5 * h * s)
    j1 = j + h * s
    speed = Range(max(min(min(v, v1), min(v2, v3)), 0.0), max(max(v, v1), max(v2, v3)))
    acceleration = Range(min(min(a, a1), a2), max(max(a, a1), a2))
    jerk = Range(min(j, j1), max(j, j1))
    square = Range(speed.low * speed.low, speed.high * speed.high)
    largest = max(abs(acceleration.low), abs(acceleration.high))
    return Curve(
        speed,
        acceleration,
        jerk,
        square,
        _product(speed, acceleration),
        _product(speed, square),
        _sum(Range(0.0, 3.0 * largest * largest), _times(4.0, _product(speed, jerk))),
        _times(6.0, _product(square, acceleration)),
        _product(square, square),
    )


@kernel
def _bent(most: Slopes, r: Derivatives, away: float, curve: Curve, s: float, rest: Ranges) -> Ranges:
    """Add to `rest` the ranges by which the derivatives of an axis may differ from those of motion along the tangent in
    the middle of an interval of the path, due to curvature.

    r are the derivatives of the axis in the middle, `away` is the way from there to either end, and s the snap of u.
    """
    second = _near(r.second, most.M3 * away, most.M2)
    third = _near(r.third, most.M4 * away, most.M3)
    turns = Range(-most.M2 * away, most.M2 * away)  # r' less that in the middle
    jerk = _sum(_times(3.0, _product(second, curve.power)), _product(third, curve.cube))
    snap = _sum(_product(second, curve.mixed), _product(third, curve.cubed))
    snap = _sum(snap, _product(Range(-most.M4, most.M4), curve.fourth))
    return Ranges(
        _sum(rest.velocity, _product(turns, curve.speed)),
        _sum(rest.acceleration, _sum(_product(second, curve.square), _product(turns, curve.acceleration))),
        _sum(rest.jerk, _sum(jerk, _product(turns, curve.jerk))),
        _sum(rest.snap, _sum(snap, _times(s, turns))),
    )


@kernel
def _largest(value: float, rest: Range) -> float:
    """Return the largest |value + r| for all r in the interval `rest`."""
    return max(abs(value + rest.low), abs(value + rest.high))


@kernel
def _vertex(begin: float, middle: float, end: float) -> float:
    """Return the extreme value of a quadratic with three Bernstein points that is not at its ends, or that at an end if
    there is none.
    """
    if (middle - begin) * (end - middle) >= 0.0:
        return begin
    return begin - (middle - begin) * (middle - begin) / (begin - 2.0 * middle + end)


@kernel
def together(one: End, two: End, lasts: float, limits: Records[Limits], feed: float) -> tuple[float, float, float]:
    """Return the peak utilization of the limits and the feed by the sum of two motions, the distance to the corner, m,
    and the factor by which the time of both must grow for the sum to keep all limits.

    The first motion ends on a piece, the second begins on another piece, and they overlap for `lasts` seconds.  Ranges
    are bounded by Bernstein points.
    """
    axes = len(limits)
    curved0 = 0.0
    curved1 = 0.0
    for i in range(axes):
        curved0 = max(curved0, one.most[i].M2)
        curved1 = max(curved1, two.most[i].M2)
        # on a line they are the same everywhere
        one.rates[i] = Derivatives(0.0, one.direction[i], 0.0, 0.0, 0.0)
        two.rates[i] = Derivatives(0.0, two.direction[i], 0.0, 0.0, 0.0)
    curved = max(curved0, curved1) > 0.0
    # where the first motion is when the second begins
    m = one.used
    left = lasts
    while m > 0 and left > 0.0:
        m = m - 1
        left = left - one.motion[m].duration
    begin0 = left  # of time piece m, from when the second begins
    n = 0
    begin1 = 0.0
    t = 0.0
    velocity = 0.0
    acceleration = 0.0
    jerk = 0.0
    snap = 0.0
    distance = 1e300
    while t < lasts and m < one.used and n < two.used:
        end0 = begin0 + one.motion[m].duration
        end1 = begin1 + two.motion[n].duration
        end = min(min(end0, end1), lasts)
        # both last intervals end with the overlap, although the sums of durations differ from it by rounding
        if m + 1 == one.used and n + 1 == two.used:
            end = lasts
        h = end - t
        if h > _SLIVER * lasts:
            now0 = moved(one.motion[m], t - begin0)
            now1 = moved(two.motion[n], t - begin1)
            _, x0, v0, a0, j0, s0 = now0
            _, x1, v1, a1, j1, s1 = now1
            far0 = x0 + way(v0, a0, j0, s0, h)
            far1 = x1 + way(v1, a1, j1, s1, h)
            curve0 = _STILL
            curve1 = _STILL
            if curved0 > 0.0:
                middle = min(max(0.5 * (x0 + far0), 0.0), one.length)
                derivatives(one.piece.kind, one.piece.length, one.piece.shape, middle, one.rates)
                curve0 = _along_curve(now0, h)
            if curved1 > 0.0:
                middle = min(max(0.5 * (x1 + far1), 0.0), two.piece.length)
                derivatives(two.piece.kind, two.piece.length, two.piece.shape, middle, two.rates)
                curve1 = _along_curve(now1, h)
            squares0 = 0.0
            squares1 = 0.0
            squares2 = 0.0
            squares3 = 0.0
            for i in range(axes):
                c0 = one.rates[i].first
                c1 = two.rates[i].first
                v = c0 * v0 + c1 * v1
                a = c0 * a0 + c1 * a1
                j = c0 * j0 + c1 * j1
                s = c0 * s0 + c1 * s1
                rest = _NOTHING
                if curved0 > 0.0:
                    rest = _bent(one.most[i], one.rates[i], 0.5 * (far0 - x0), curve0, s0, rest)
                if curved1 > 0.0:
                    rest = _bent(two.most[i], two.rates[i], 0.5 * (far1 - x1), curve1, s1, rest)
                limit = limits[i]
                # Bernstein points
                fast0 = _largest(v, rest.velocity)
                fast1 = _largest(v + h * a / 3.0, rest.velocity)
                fast2 = _largest(v + h * (2.0 * a + 0.5 * h * j) / 3.0, rest.velocity)
                fast3 = _largest(cubic(v, a, j, s, h), rest.velocity)
                squares0 = squares0 + fast0 * fast0
                squares1 = squares1 + fast1 * fast1
                squares2 = squares2 + fast2 * fast2
                squares3 = squares3 + fast3 * fast3
                velocity = max(velocity, max(max(fast0, fast1), max(fast2, fast3)) / limit.velocity)
                ends = a + h * (j + 0.5 * h * s)
                most = max(_largest(a, rest.acceleration), _largest(ends, rest.acceleration))
                most = max(most, _largest(_vertex(a, a + 0.5 * h * j, ends), rest.acceleration))
                acceleration = max(acceleration, most / limit.acceleration)
                jerk = max(jerk, max(_largest(j, rest.jerk), _largest(j + h * s, rest.jerk)) / limit.jerk)
                snap = max(snap, _largest(s, rest.snap) / limit.snap)
            speed = max(max(squares0, squares1), max(squares2, squares3))
            velocity = max(velocity, sqrt(speed) / feed)
            if distance == 1e300 and (one.length - far0 <= max(far1, 0.0) or end >= lasts):
                # the distances to the corner become equal here
                low = 0.0
                high = h
                for _halving in range(50):
                    b = 0.5 * (low + high)
                    if one.length - (x0 + way(v0, a0, j0, s0, b)) > x1 + way(v1, a1, j1, s1, b):
                        low = b
                    else:
                        high = b
                b = 0.5 * (low + high)
                w0 = one.length - (x0 + way(v0, a0, j0, s0, b))
                w1 = x1 + way(v1, a1, j1, s1, b)
                distance = _apart(one, two, w0, w1, curved)
        if end0 <= end:
            begin0 = end0
            m = m + 1
        if end1 <= end:
            begin1 = end1
            n = n + 1
        t = end
    share = max(max(velocity, acceleration), max(jerk, snap))
    slower = max(max(velocity, sqrt(acceleration)), max(cube_root(jerk), sqrt(sqrt(snap))))
    return share, distance, slower


@kernel
def _apart(one: End, two: End, w0: float, w1: float, curved: bool) -> float:
    """Return a bound on the distance to the corner for motions that are w0 before and w1 behind it."""
    gap = 0.0
    size0 = 0.0
    size1 = 0.0
    bend = 0.0
    for i in range(len(one.direction)):
        most0 = one.most[i]
        most1 = two.most[i]
        g = w1 * two.direction[i] - w0 * one.direction[i]
        gap = gap + g * g
        size0 = size0 + most0.M1 * most0.M1
        size1 = size1 + most1.M1 * most1.M1
        bend = bend + max(most0.M2 * w0 * w0, most1.M2 * w1 * w1)
    distance = sqrt(gap)
    if curved:
        distance = max(max(w0 * sqrt(size0), w1 * sqrt(size1)), distance + 2.0 * bend)
    return distance


@kernel
def overlap(one: End, two: End, longest: float, tolerance: float, limits: Records[Limits]) -> float:
    """Return the longest overlap up to `longest` that satisfies limits and tolerance, found by bisection, or 0 if there
    is none.
    """
    feed = max(one.feed, two.feed)
    low = 0.0
    high = longest
    lasts = longest
    for _ in range(_HALVINGS):
        share, distance, _needed = together(one, two, lasts, limits, feed)
        if share <= 1.0 + 1e-10 and distance <= tolerance * BELOW:
            low = lasts
        else:
            high = lasts
        if high - low <= 1e-6 * high:
            break
        lasts = 0.5 * (low + high)
    return low


@kernel
def slower_overlap(
    one: End, two: End, longest: float, tolerance: float, limits: Records[Limits], whole: float, least: float
) -> tuple[float, float]:
    """Return the overlap of two motions that take longer by a factor, and this factor, so that most time is saved; the
    first is 0 if that is not more than `least` s.

    `whole` is the sum of the durations of both runs, s: slower by f, with an overlap of f D, they save
    f D - (f - 1) whole.  A sum of two motions that is above a limit by little is so for overlaps of very different
    durations, since the motions use the limits throughout.
    """
    feed = max(one.feed, two.feed)
    within = 0.0
    high = longest
    lasts = longest
    for _ in range(_HALVINGS):
        # the way to the corner grows with the overlap
        _share, distance, _needed = together(one, two, lasts, limits, feed)
        if distance <= tolerance * BELOW:
            within = lasts
        else:
            high = lasts
        if high - within <= _TOLERANT * high or high <= least:
            break
        lasts = 0.5 * (within + high)
    best = least
    found = 0.0
    factor = 1.0
    for k in range(_SHORTER):
        lasts = within * (1.0 - float(k) / float(_SHORTER))
        if lasts <= best:
            break
        _share, _distance, slower = together(one, two, lasts, limits, feed)
        slower = max(slower, 1.0) * (1.0 + 1e-9)
        saved = slower * lasts - (slower - 1.0) * whole
        if saved > best:
            best = saved
            found = slower * lasts
            factor = slower
    return found, factor


class Shared(NamedTuple):
    """Two motions split into common time intervals, see `shared`.

    common  number of common intervals
    begins  interval of the first motion in which the overlap starts
    alone   duration of this interval before the overlap, s
    ends    interval of the second motion in which the overlap ends
    rest    the remainder of that interval
    """

    common: int
    begins: int
    alone: float
    ends: int
    rest: Interval


@kernel
def shared(
    one: Records[Interval],
    two: Records[Interval],
    lasts: float,
    last: Records[Interval],
    first: Records[Interval],
) -> Shared:
    """Split the last `lasts` seconds of one motion and the first `lasts` seconds of the other into common time
    intervals, written into `last` and `first`.

    Ends within 1e-12 of the overlap time are treated as simultaneous.
    """
    # ends that differ by rounding only would leave intervals of almost no duration
    near = _SLIVER * lasts
    m = len(one)
    left = lasts
    while m > 0 and left > near:
        m = m - 1
        if left < one[m].duration - near:
            break
        left = left - one[m].duration
    # the remainders of both current intervals, so that no digits are lost in long ones
    left0 = left if left > near else one[m].duration
    begins = m
    alone = one[m].duration - left0
    n = 0
    left1 = two[0].duration
    count = 0
    rest = Interval(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    while m < len(one) and n < len(two):
        h = min(left0, left1)
        if h > near:
            last[count] = moved(one[m], one[m].duration - left0)._replace(duration=h)
            first[count] = moved(two[n], two[n].duration - left1)._replace(duration=h)
            count = count + 1
        left0 = left0 - h
        left1 = left1 - h
        if left0 <= near:
            m = m + 1
            left0 = one[m].duration if m < len(one) else 0.0
        if left1 <= near:
            n = n + 1
            left1 = two[n].duration if n < len(two) else 0.0
    if n < len(two):
        rest = moved(two[n], two[n].duration - left1)._replace(duration=left1)
    return Shared(count, begins, alone, n, rest)


def overlapped(one: Part, two: Part, lasts: float, tolerance: float) -> tuple[list[Part], Part]:
    """Overlap two runs by `lasts` s: return the parts until the first run ends, and the rest of the second run."""
    ends, begins = rows(one.motion), rows(two.motion)
    last, first = (rows_for(Interval, len(ends) + len(begins)) for _ in range(2))
    count, m, alone, n, rest = shared(ends, begins, lasts, last, first)
    entering = Entering(part_of_pieces(two.pieces, 0, 1), from_rows(first[:count], 0), tolerance)
    k = len(one.pieces.length) - 1
    leaves = [Part(part_of_pieces(one.pieces, k, k + 1), from_rows(last[:count], 0), True, entering, factor=one.factor)]
    before = Motion._make([array[: m + int(alone > 0.0)].copy() for array in one.motion])
    if len(before.duration):
        before.duration[-1] = alone if alone > 0.0 else before.duration[-1]
        leaves.insert(0, one._replace(motion=before, ends=False))
    behind = Motion._make([array[n:].copy() for array in two.motion])
    if len(behind.duration):
        for column, value in zip([behind.duration, *behind[2:]], rest, strict=True):
            column[0] = value
    return leaves, two._replace(motion=behind)


class Node(NamedTuple):
    """The head or the tail of a stretch of a line.

    speed        at the node, m/s
    wide, short  boxcar widths w and s of the bump there, s; 0 without a bump: the stretch begins or ends with the node
    jerk_share, snap_share  parts of the jerk and snap limits that the ramp to it may use
    jerk         largest jerk of that ramp, m/s³
    """

    speed: float
    wide: float = 0.0
    short: float = 0.0
    jerk_share: float = 1.0
    snap_share: float = 1.0
    jerk: float = 1e300


class LineStretch(NamedTuple):
    """A stretch of a line between two nodes: its length (m), the highest speed (m/s), the limits of acceleration, jerk
    and snap along it, and its ends.
    """

    length: float
    fastest: float
    acceleration: float
    jerk: float
    snap: float
    head: Node
    tail: Node


class Ramps(NamedTuple):
    """Both ramps of a stretch: from its head up to a peak speed, and down to its tail."""

    up: Ramp
    down: Ramp


ROWS = 40  # largest number of time intervals of its motion
_TRIES = 9  # largest number of trial speeds in a corner
_NEAR = 0.005  # relative accuracy of this speed
_RISES = 0.5  # of the width of a bump: longer rises of the acceleration are not tried
_SECANT = 0.1  # of the distance between two speeds: a secant nearer to the lower one is not used
_PEAKS = 60  # largest number of trial peaks of a stretch
_FULL = 1e-9  # of its length need not be used by ramps


@kernel
def _phase(interval: Interval, count: int, out: Records[Interval]) -> int:
    """Append a time interval if its duration is positive."""
    if interval.duration <= 0.0:
        return count
    out[count] = interval
    return count + 1


@kernel
def _ramp(low: float, rise: float, ramp: Ramp, x: float, up: bool, count: int, out: Records[Interval]) -> int:
    """Append the phases of a ramp that starts at x."""
    if rise <= 0.0 or ramp.L3 <= 0.0:
        return count
    sense = 1.0 if up else -1.0
    jerk = ramp_jerk(rise, ramp)
    v = low if up else low + rise
    acceleration = 0.0
    for number in range(7):
        T, s = phase(number, rise, ramp)
        s = sense * s
        j = sense * jerk_before(number, jerk)
        acceleration = sense * acceleration_before(number, rise, ramp, sense * acceleration)
        count = _phase(Interval(T, x, v, acceleration, j, s), count, out)
        if T > 0.0:
            x = x + way(v, acceleration, j, s, T)
            v, acceleration = cubic(v, acceleration, j, s, T), acceleration + T * (j + 0.5 * T * s)
    return count


@kernel
def _box(node: Node, out: Records[Interval]) -> int:
    """Write the five phases of the speed v H, from rest to v, where H is the smoothed unit step of the module
    docstring.
    """
    _, wide, short, _, _, _ = node
    jerk = node.speed / (wide * wide)
    k = jerk / short if short > 0.0 else 0.0
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
        j = 0.0 if number == 0 else (jerk if number < 3 else -jerk)
        out[number] = Interval(T, x, u, a, j, s)
        x = x + way(u, a, j, s, T)
        u, a = cubic(u, a, j, s, T), a + T * (j + 0.5 * T * s)
    return 5


@kernel
def _ramps(stretch: LineStretch, peak: float) -> Ramps:
    """Return the ramps of a stretch with this peak speed."""
    _, _, A, J, S, head, tail = stretch
    return Ramps(
        boxcars(peak - head.speed, A, min(head.jerk, head.jerk_share * J), head.snap_share * S),
        boxcars(peak - tail.speed, A, min(tail.jerk, tail.jerk_share * J), tail.snap_share * S),
    )


@kernel
def _used(stretch: LineStretch, ramps: Ramps, peak: float) -> float:
    """Return the total distance covered by the two ramps of a stretch."""
    return 0.5 * ((stretch.head.speed + peak) * duration(ramps.up) + (stretch.tail.speed + peak) * duration(ramps.down))


@kernel
def _peak(stretch: LineStretch) -> float:
    """Return the highest speed of a stretch, or 0 if no motion is possible."""
    length = stretch.length
    low = max(stretch.head.speed, stretch.tail.speed)
    high = stretch.fastest
    if low > high:
        return 0.0
    used = _used(stretch, _ramps(stretch, high), high)
    if used <= length:
        return high
    over = used - length
    under = -length
    if low > 0.0:
        used = _used(stretch, _ramps(stretch, low), low)
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
        used = _used(stretch, _ramps(stretch, peak), peak)
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
def _duration(stretch: LineStretch, peak: float) -> float:
    """Return the duration in s of the motion on a stretch with this peak speed, bumps included, or 0 if there is no
    motion.
    """
    if peak <= 0.0:
        return 0.0
    ramps = _ramps(stretch, peak)
    head = stretch.head
    tail = stretch.tail
    # from left to right: the sum of both durations would round otherwise
    total = ramps.up.L1 + ramps.up.L2 + ramps.up.L3 + ramps.down.L1 + ramps.down.L2 + ramps.down.L3
    total = total + (stretch.length - _used(stretch, ramps, peak)) / peak
    return total + head.wide + tail.wide + 0.5 * (head.short + tail.short)


@kernel
def straight(stretch: LineStretch, out: Records[Interval]) -> int:
    """Write the time-optimal motion on a stretch into `out`; return the number of time intervals, or 0 if there is no
    such motion.
    """
    return _rows(stretch, _peak(stretch), out)


@kernel
def _rows(stretch: LineStretch, peak: float, out: Records[Interval]) -> int:
    """Write the motion with a given peak speed; return the number of time intervals, or 0 if there is no motion."""
    length = stretch.length
    v0 = stretch.head.speed
    v1 = stretch.tail.speed
    if peak <= 0.0:
        return 0
    up, down = _ramps(stretch, peak)
    base = records(Interval, 20)
    h0 = stretch.head.wide + 0.5 * stretch.head.short
    h1 = stretch.tail.wide + 0.5 * stretch.tail.short
    count = _phase(Interval(h0, -v0 * h0, v0, 0.0, 0.0, 0.0), 0, base)
    count = _ramp(v0, peak - v0, up, 0.0, True, count, base)
    rise = 0.5 * (v0 + peak) * duration(up)
    fall = 0.5 * (v1 + peak) * duration(down)
    count = _phase(Interval((length - fall - rise) / peak, rise, peak, 0.0, 0.0, 0.0), count, base)
    count = _ramp(v1, peak - v1, down, length - fall, False, count, base)
    count = _phase(Interval(h1, length, v1, 0.0, 0.0, 0.0), count, base)
    head = records(Interval, 5)
    tail = records(Interval, 5)
    heads = 0
    tails = 0
    if h0 > 0.0:
        heads = _box(stretch.head, head)
    if h1 > 0.0:
        tails = _box(stretch.tail, tail)
    # the base is split where the tail begins: times from the start of a long interval have too few digits at its end
    first = count
    left = 2.0 * h1
    while first > 0 and left > 0.0:
        first = first - 1
        whole = base[first]
        if left < whole.duration:
            for k in range(count - first):
                base[count - k] = base[count - k - 1]
            count = count + 1
            t = whole.duration - left
            base[first] = whole._replace(duration=t)
            first = first + 1
            base[first] = moved(whole, t)._replace(duration=left)
            left = 0.0
        else:
            left = left - whole.duration
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
        h = base[m].duration - tb
        if p < heads:
            h = min(h, head[p].duration - th)
        if q < tails and runs:
            h = min(h, tail[q].duration - tt)
        if h > near:
            _, x, v, u, j, s = moved(base[m], tb)
            if p < heads:
                _, more, speed, acceleration, jerk, snap = moved(head[p], th)
                x = x + v0 * (h0 - since) + more
                v = v - v0 + speed
                u = u + acceleration
                j = j + jerk
                s = s + snap
            if q < tails and runs:
                _, more, speed, acceleration, jerk, snap = moved(tail[q], tt)
                x = x - more
                v = v - speed
                u = u - acceleration
                j = j - jerk
                s = s - snap
            out[written] = Interval(h, x, v, u, j, s)
            written = written + 1
        since = since + h
        tb = tb + h
        if base[m].duration - tb <= near:
            m = m + 1
            tb = 0.0
        if p < heads:
            th = th + h
            if head[p].duration - th <= near:
                p = p + 1
                th = 0.0
        if q < tails and runs:
            tt = tt + h
            if tail[q].duration - tt <= near:
                q = q + 1
                tt = 0.0
    return written


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
        before = w
        w = 6.0 * away - short * short / (4.0 * w) * (1.0 - short / (8.0 * w))
        if w == before:
            break
    return w, short


class Before(NamedTuple):
    """The end of the run that overlaps with the begin of a stretch for `lasts` seconds, and the tolerance of the corner
    between them, m; with 0 seconds there is none.
    """

    end: End
    lasts: float
    tolerance: float


_NODE = Node(0.0)


@kernel
def bump(
    one: LineStretch,
    end: End,
    two: LineStretch,
    begin: End,
    before: Before,
    half: bool,
    tolerance: float,
    limits: Records[Limits],
    quickest: float,
    rows0: Records[Interval],
    rows1: Records[Interval],
) -> tuple[int, int, Node]:
    """Find the fastest bump between two stretches; write both motions into `rows0` and `rows1`, and return the numbers
    of their time intervals and the node in the corner.

    `end` and `begin` have the directions and bounds of the stretches.  `before` overlaps with the first stretch.  Both
    numbers are 0 if no bump brings the total time of both stretches below `quickest` s; with `half`, half of the second
    stretch remains free for the following corner.

    With d = tolerance/|t1 - t0| and w = 6 d/v the jerk of the bump is v |t1 - t0|/w².  Of this jerk the ramps cancel
    less than 1.2 j, where j is the jerk limit, so v³ is at most 2.2 · 36 J d², with J the least j/|t1 - t0| of the
    axes.
    """
    gap = 0.0
    jerk = 1e300
    for i in range(len(limits)):
        g = abs(begin.direction[i] - end.direction[i])
        gap = gap + g * g
        if g * jerk > limits[i].jerk:
            jerk = limits[i].jerk / g
    best_node = _NODE
    if gap <= 1e-18:
        return 0, 0, best_node
    near = tolerance * BELOW / sqrt(gap)
    fastest = min(min(one.fastest, two.fastest), cube_root(79.2 * jerk * near * near))
    feed = max(end.feed, begin.feed)
    before_feed = max(before.end.feed, end.feed)
    best = quickest
    ours = 0.0
    reached = 0.0
    for shape in range(6):
        # ramps and bump add up on some axes and cancel on others: with less jerk for the ramps the bump may be faster
        share = 1.0 if shape == 0 else (0.93 if shape == 1 else (0.85 if shape == 2 else 0.7))
        # where the jerk is loose the accelerations add up: ramps that rise over a part of the bump leave it more
        rises = 0.0
        if shape >= 4:
            if one.acceleration * fastest > _RISES * one.jerk * 6.0 * near:
                break
            share = 1.0
            rises = 0.25 if shape == 4 else 0.5
        low = reached  # slower ramps require a higher speed in the corner
        high = fastest
        above = 1.0  # largest share of a limit at `high`; 1 if unknown
        more = 1.0  # the same at the last higher speed, whose cube is `farther`
        farther = 0.0
        v = fastest
        for again in range(_TRIES):
            # the snap of a bump is twice its jerk over s: at the limit of the jerk half of that of the snap
            w, short = width(near / v, 4.0 * one.jerk / one.snap if one.snap < 1e299 else 0.0)
            # the snaps of ramp and bump add up in the corner
            node = Node(v, w, short, share, 0.5, one.acceleration / (rises * w) if rises > 0.0 else 1e300)
            one = one._replace(tail=node)
            two = two._replace(head=node)
            good = False
            excess = 1.0  # largest share of a limit; 1 if unknown
            both = 2.0 * w + short
            peak0 = _peak(one)
            peak1 = _peak(two)
            time0 = _duration(one, peak0)
            time1 = _duration(two, peak1)
            time = time0 + time1 - both
            slower = time0 > 0.0 and time1 > 0.0 and time >= best
            if time0 > 0.0 and time1 > 0.0 and not slower:
                n = _rows(one, peak0, rows0)
                m = _rows(two, peak1, rows1)
                good = n > 0 and m > 0
                good = good and both <= time0 - before.lasts and both <= (0.5 * time1 if half else time1)
                end = end._replace(motion=rows0, used=n, length=one.length)
                begin = begin._replace(motion=rows1, used=m)
            if good:
                most, away, _needed = together(end, begin, both, limits, feed)
                good = most <= 1.0 + 1e-10 and away <= tolerance
                excess = most
            if good and before.lasts > 0.0:
                most, away, _needed = together(before.end, end, before.lasts, limits, before_feed)
                good = most <= 1.0 + 1e-10 and away <= before.tolerance
                excess = most
            if slower or good:
                low = v  # lower speeds are slower as well
                if good:
                    reached = v
                    best = time
                    ours = time
                    best_node = node
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
                # where the acceleration is at its limit, which grows as v², the secant falls far below
                secant = cube_root(cubes) if cubes > 0.0 else 0.0
                if secant >= low + _SECANT * (high - low):
                    v = min(max(secant, (1.0 + 0.9 * _NEAR) * low), v)
            elif above > 1.0 and again == 0:
                v = high / cube_root(above)
                if v <= 0.9 * low:
                    break
                v = max(v, 0.5 * (low + high)) if v <= low else v
    if ours <= 0.0:
        return 0, 0, best_node
    return straight(one._replace(tail=best_node), rows0), straight(two._replace(head=best_node), rows1), best_node


_SLOWED = (0.93, 0.85)  # shares of the jerk
_SHORTEST = 1e-4  # s of overlap; less does not justify separate parts


class _Stretch(NamedTuple):
    """The part of a motion that may be replanned: the time intervals from `first` up to but excluding `last`, on one
    line between two nodes.
    """

    first: int
    last: int
    line: LineStretch


class _Run(NamedTuple):
    """A part of the motion whose end may still change, and its overlap with the previous part.

    whole  stretch of a run along one line, whose head and tail are planned together; None for other runs
    seen   motion of such a run at its corners
    """

    part: Part
    tolerance: float  # of the corner in which it ends, m
    whole: _Stretch | None
    seen: End | None = None
    lasts: float = 0.0  # s
    corner: float = 0.0  # tolerance of that corner


Line: TypeAlias = _Run
"""A run along a single line."""


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
        run = self.line(Section(part.pieces, part.ends, tolerance)) if begins else None
        return self._next(run or _Run(part, tolerance, None))

    def add_line(self, line: Line) -> list[Part]:
        """Add a run along a single line and return the parts that are now final."""
        return self._next(line)

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

    def line(self, section: Section) -> Line | None:
        """Return the run of a section that is a single line, planned in closed form, or None for any other section.

        It depends on no other run.
        """
        pieces = section.pieces
        if not section.ends or len(pieces.length) != 1 or pieces.kind[0] != LINE:
            return None
        length, rest = float(pieces.length[0]), Node(0.0)
        line, motion_rows = self._stretch(pieces, 0, length, rest, rest), rows_for(Interval, ROWS)
        count = straight(line, motion_rows)
        if not count:
            return None
        motion = from_rows(motion_rows[:count], 0)
        seen = End(motion_rows, count, _time(motion), length, float(pieces.feed[0]), *_along_line(pieces, 0))
        return _Run(Part(pieces, motion, True), section.tolerance, _Stretch(0, count, line), seen)

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
        # half of a run in a single part is reserved for the corner at its other end
        share = 0.5 if two.part.ends else 1.0
        longest = min(end.lasts, begin.lasts, share * _time(two.part.motion), _time(one.part.motion) - one.lasts) * (
            1.0 - 1e-6
        )
        lasts = overlap(end, begin, longest, one.tolerance, self._limits)
        two = two._replace(lasts=lasts if lasts >= _SHORTEST else 0.0, corner=one.tolerance)
        # motions along one line are planned anew with other limits instead
        if one.whole or two.whole or not (_rests(one.part) and _rests(two.part)):
            return one, two
        whole = _time(one.part.motion) + _time(two.part.motion)
        lasts, factor = slower_overlap(end, begin, longest, one.tolerance, self._limits, whole, two.lasts + _SHORTEST)
        if lasts == 0.0:
            return one, two
        before, after = _slower(one, factor), _slower(two, factor)._replace(lasts=lasts)
        return (before, after) if self._holds(before) else (one, two)

    def _met(self, one: _Run, two: _Run) -> tuple[_Run, _Run]:
        """Plan the corner between two runs; return both, the first one in its final form."""
        best = self._stopped(one, two)
        tail = one.whole or self._tail(one.part)
        head = two.whole or self._head(two.part)
        if tail is not None and head is not None:
            end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
            _, overlapping = best
            return self._bump(one, end, tail, two, begin, head, overlapping.lasts) or best
        # next to an arc a slower ramp on the line leaves room for the derivatives that curvature adds on its axes
        for share in _SLOWED if (tail is None) != (head is None) else ():
            before, after = self._slowed(one, tail, True, share), self._slowed(two, head, False, share)
            if before and after:
                stopped = self._stopped(before, after)
                if _together(stopped) < _together(best) and self._holds(before):
                    best = stopped
        return best

    def _slowed(self, run: _Run, stretch: _Stretch | None, tail: bool, share: float) -> _Run | None:
        """Return the run with a slower ramp on the line at the corner, which is its `tail` or its head: its jerk limit
        is multiplied by `share`, its snap limit by `share`².

        A run without such a stretch is returned unchanged; the result is None if no motion is possible.
        """
        if stretch is None:
            return run
        line, motion_rows = stretch.line, rows_for(Interval, ROWS)
        node = (line.tail if tail else line.head)._replace(jerk_share=share, snap_share=share * share)
        line = line._replace(tail=node) if tail else line._replace(head=node)
        count = straight(line, motion_rows)
        if not count:
            return None
        k = len(run.part.pieces.length) - 1 if tail else 0
        motion = _spliced(stretch, run.part.motion, k, motion_rows[:count])
        run = run._replace(part=run.part._replace(motion=motion))
        if not run.whole:
            return run
        return run._replace(whole=_Stretch(0, count, line), seen=_made(run.seen, motion_rows[:count], motion))

    def _holds(self, run: _Run) -> bool:
        """Return True if a replanned run still satisfies limits and tolerance in its overlap with the previous one."""
        if run.lasts == 0.0 or self._fixed is None:
            return True
        end, begin = _end(self._fixed, True), run.seen or _end(run.part, False)
        share, away, _ = together(end, begin, run.lasts, self._limits, max(end.feed, begin.feed))
        return share <= 1.0 + 1e-10 and away <= run.corner

    def _bump(
        self, one: _Run, end: End, tail: _Stretch, two: _Run, begin: End, head: _Stretch, lasts: float
    ) -> tuple[_Run, _Run] | None:
        """Return both runs with a bump if that is faster than an overlap of `lasts` seconds, or None otherwise."""
        motion0, motion1 = one.part.motion, two.part.motion
        quickest = _time(motion0, tail) + _time(motion1, head) - lasts
        # a run along one line is planned anew as a whole, so that its overlap with the run before must be checked again
        before = Before(end, 0.0, one.corner)
        if one.whole is not None and one.lasts > 0.0 and self._fixed is not None:
            before = Before(_end(self._fixed, True), one.lasts, one.corner)
        rows0, rows1 = rows_for(Interval, ROWS), rows_for(Interval, ROWS)
        count0, count1, node = bump(
            tail.line,
            end,
            head.line,
            begin,
            before,
            two.whole is not None,
            one.tolerance,
            self._limits,
            quickest,
            rows0,
            rows1,
        )
        if not count0:
            return None
        n = len(one.part.pieces.length) - 1
        rows0, rows1 = rows0[:count0], rows1[:count1]
        made0, made1 = _spliced(tail, motion0, n, rows0), _spliced(head, motion1, 0, rows1)
        run = two._replace(
            part=two.part._replace(motion=made1),
            whole=_Stretch(0, count1, head.line._replace(head=node)) if two.whole else None,
            seen=_made(two.seen, rows1, made1),
            lasts=2.0 * node.wide + node.short,
            corner=one.tolerance,
        )
        return one._replace(part=one.part._replace(motion=made0), seen=_made(one.seen, rows0, made0)), run

    def _tail(self, part: Part) -> _Stretch | None:
        """Return the stretch from the first node on the last piece to the stop."""
        motion, last = part.motion, len(part.pieces.length) - 1
        nodes = np.flatnonzero((motion.piece == last) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        if not len(nodes) or part.pieces.kind[last] != LINE:
            return None
        m = int(nodes[0])
        length = float(part.pieces.length[last]) - float(motion.x[m])
        line = self._stretch(part.pieces, last, length, Node(float(motion.speed[m])), Node(0.0))
        return _Stretch(m, len(motion.piece), line)

    def _head(self, part: Part) -> _Stretch | None:
        """Return the stretch from rest to the last node on the first piece."""
        motion = part.motion
        nodes = np.flatnonzero((motion.piece == 0) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        m = int(nodes[-1]) if len(nodes) else 0
        if not m or part.pieces.kind[0] != LINE:
            return None
        line = self._stretch(part.pieces, 0, float(motion.x[m]), Node(0.0), Node(float(motion.speed[m])))
        return _Stretch(0, m, line)

    def _stretch(self, pieces: Pieces, k: int, length: float, head: Node, tail: Node) -> LineStretch:
        """Return a stretch of a line from node to node, as for `straight`."""
        # an axis that does not move sets no limit, and must not divide by zero
        slope = np.maximum(np.abs(direction(pieces, k)), 1e-200)
        fastest, a, j, s = (np.min(self._limits / slope[:, None], axis=0) * (1.0 - 1e-12)).tolist()
        fastest = min(fastest, float(pieces.feed[k]) / float(np.sqrt(slope @ slope)))
        return LineStretch(length, fastest, a, j, s, head, tail)


def _rests(part: Part) -> bool:
    """Return True if a part is a whole run, from rest to rest."""
    return part.ends and part.motion.x[0] == 0.0 and part.motion.speed[0] == 0.0


def _slower(run: _Run, factor: float) -> _Run:
    """Return a run, other than along one line, that takes `factor` times as long."""
    return run._replace(part=run.part._replace(motion=slowed(run.part.motion, factor)))


def _together(both: tuple[_Run, _Run]) -> float:
    """Return the total duration of both runs, s."""
    one, two = both
    return _time(one.part.motion) + _time(two.part.motion) - two.lasts


def _time(motion: Motion, stretch: _Stretch | None = None) -> float:
    return float((motion.duration[stretch.first : stretch.last] if stretch else motion.duration).sum())


def _spliced(stretch: _Stretch, motion: Motion, k: int, new: np.ndarray) -> Motion:
    """Replace a stretch on piece k of a motion by rows in the form of `straight`."""
    if stretch.first == 0 and stretch.last == len(motion.duration):
        return from_rows(new, k, float(motion.x[0]))
    parts = zip(motion, from_rows(new, k, float(motion.x[stretch.first])), strict=True)
    return Motion._make([np.concatenate([old[: stretch.first], middle, old[stretch.last :]]) for old, middle in parts])


def _made(seen: End | None, new: np.ndarray, motion: Motion) -> End | None:
    """Return the end of a run along a line with its motion replaced, or None if there is no such end.

    `new` has the time intervals of `motion`.
    """
    return seen._replace(motion=new, used=len(new), lasts=_time(motion)) if seen else None


def _end(part: Part, last: bool) -> End:
    """Return the end of a part at a corner: on its last piece if `last`, otherwise on its first."""
    pieces, on = part.pieces, part.motion
    k = len(pieces.length) - 1 if last else 0
    if k or not last:
        inside = on.piece == k
        if not last:
            m = int(np.flatnonzero(inside)[-1])  # it may continue on the next piece
            there = on.x[m] + way(*(float(column[m]) for column in (*on[3:], on.duration)))
            inside[m] = inside.all() and there <= pieces.length[k]
        on = Motion._make([column[inside] for column in on])
    length, feed = float(pieces.length[k]), float(pieces.feed[k])
    if pieces.kind[k] == LINE:
        return End(rows(on), len(on.duration), _time(on), length, feed, *_along_line(pieces, k))
    piece = piece_of(pieces, k)
    axes = len(piece.shape)
    most, r = rows_for(Slopes, axes), rows_for(Derivatives, axes)
    bounds(piece, most)
    derivatives(*piece, length if last else 0.0, r)
    along = np.array(by_field(Derivatives, r).first)
    return End(rows(on), len(on.duration), _time(on), length, feed, along, most, piece, r)


def _along_line(pieces: Pieces, k: int) -> tuple[np.ndarray, np.ndarray, Piece, np.ndarray]:
    """Return direction and bounds of a line, and it with workspace for its derivatives."""
    along = direction(pieces, k)
    most = rows_for(Slopes, len(along))
    np.abs(along, out=np.asarray(by_field(Slopes, most).M1))
    return along, most, piece_of(pieces, k), rows_for(Derivatives, len(along))
