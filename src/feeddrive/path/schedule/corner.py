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

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Ints, Records, Records2, records
from feeddrive.path.motion import (
    LINE,
    Derivatives,
    Interval,
    Limits,
    Motion,
    Pieces,
    appended,
    cubic,
    derivatives,
    line_way,
    moved,
    way,
)
from feeddrive.path.schedule.ramp import (
    Ramp,
    Slopes,
    acceleration_before,
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
_CLOSER = 3  # number of times that these steps are halved
_SLIVER = 1e-12  # of an overlap or a bump: two phases that end so close together end simultaneously
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
    kind, shape  of the piece, as in `Pieces`; a line needs no shape here
    """

    motion: Records[Interval]
    used: int
    lasts: float
    length: float
    feed: float
    direction: Floats
    most: Records[Slopes]
    kind: int
    shape: Floats2


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
    """Return the extreme value of a quadratic with three Bernstein points that is not at its ends, or that at its begin
    if there is none.
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
    curved = max(curved0, curved1) > 0.0
    rates0 = records(Derivatives, 9)
    rates1 = records(Derivatives, 9)
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
                derivatives(one.kind, one.length, one.shape, min(max(0.5 * (x0 + far0), 0.0), one.length), rates0)
                curve0 = _along_curve(now0, h)
            if curved1 > 0.0:
                derivatives(two.kind, two.length, two.shape, min(max(0.5 * (x1 + far1), 0.0), two.length), rates1)
                curve1 = _along_curve(now1, h)
            squares0 = 0.0
            squares1 = 0.0
            squares2 = 0.0
            squares3 = 0.0
            for i in range(axes):
                c0 = one.direction[i]
                c1 = two.direction[i]
                rest = _NOTHING
                if curved0 > 0.0:
                    c0 = rates0[i].first
                    rest = _bent(one.most[i], rates0[i], 0.5 * (far0 - x0), curve0, s0, rest)
                if curved1 > 0.0:
                    c1 = rates1[i].first
                    rest = _bent(two.most[i], rates1[i], 0.5 * (far1 - x1), curve1, s1, rest)
                v = c0 * v0 + c1 * v1
                a = c0 * a0 + c1 * a1
                j = c0 * j0 + c1 * j1
                s = c0 * s0 + c1 * s1
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
                middle = a + 0.5 * h * j
                ends = a + h * (j + 0.5 * h * s)
                largest = max(_largest(a, rest.acceleration), _largest(ends, rest.acceleration))
                # in most intervals the point in the middle is the bound, which takes no division
                if _largest(middle, rest.acceleration) > max(largest, acceleration * limit.acceleration):
                    largest = max(largest, _largest(_vertex(a, middle, ends), rest.acceleration))
                acceleration = max(acceleration, largest / limit.acceleration)
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
        share, distance, _slower = together(one, two, lasts, limits, feed)
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
    f D - (f - 1) whole.  Where both motions use the limits throughout, their sum is above a limit by little for
    overlaps of very different durations, and none of them would hold without that.
    """
    feed = max(one.feed, two.feed)
    within = 0.0
    high = longest
    lasts = longest
    for _ in range(_HALVINGS):
        # the way to the corner grows with the overlap
        _share, distance, _slower = together(one, two, lasts, limits, feed)
        if distance <= tolerance * BELOW:
            within = lasts
        else:
            high = lasts
        if high - within <= _TOLERANT * high or high <= least:
            break
        lasts = 0.5 * (within + high)
    best = -1e300
    found = 0.0
    factor = 1.0
    step = within / float(_SHORTER)
    place = within
    middle = within
    for k in range(_SHORTER + 2 * _CLOSER):
        # in equal steps, then on either side of the best of them in steps that are halved
        lasts = within - float(k) * step
        if k >= _SHORTER:
            if (k - _SHORTER) % 2 == 0:
                step = 0.5 * step
                middle = place
            lasts = min(middle + (step if (k - _SHORTER) % 2 == 0 else -step), within)
        if lasts <= max(best, least):
            continue  # it would save less
        _share, distance, slower = together(one, two, lasts, limits, feed)
        slower = max(slower, 1.0) * (1.0 + 1e-9)
        saved = slower * lasts - (slower - 1.0) * whole
        if saved > best:
            best = saved
            found = slower * lasts
            factor = slower
            place = lasts
    if best <= least:
        return 0.0, 1.0
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
    used0: int,
    two: Records[Interval],
    used1: int,
    lasts: float,
    last: Records[Interval],
    first: Records[Interval],
) -> Shared:
    """Split the last `lasts` seconds of one motion and the first `lasts` seconds of the other into common time
    intervals, written into `last` and `first`.

    Of the motions the first `used0` and `used1` intervals count.  Ends within 1e-12 of the overlap time are treated as
    simultaneous.
    """
    # ends that differ by rounding only would leave intervals of almost no duration
    near = _SLIVER * lasts
    m = used0
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
    while m < used0 and n < used1:
        h = min(left0, left1)
        if h > near:
            last[count] = moved(one[m], one[m].duration - left0)._replace(duration=h)
            first[count] = moved(two[n], two[n].duration - left1)._replace(duration=h)
            count = count + 1
        left0 = left0 - h
        left1 = left1 - h
        if left0 <= near:
            m = m + 1
            left0 = one[m].duration if m < used0 else 0.0
        if left1 <= near:
            n = n + 1
            left1 = two[n].duration if n < used1 else 0.0
    if n < used1:
        rest = moved(two[n], two[n].duration - left1)._replace(duration=left1)
    return Shared(count, begins, alone, n, rest)


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
_RISES = 0.5  # of the width of a bump: where ramps take longer to rise, the jerk is not loose
_STEEP = 0.2  # of that width: where they rise faster, less of the jerk leaves the bump no more
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
    plateau = (length - fall - rise) / peak
    near = _SLIVER * (h0 + h1)
    if plateau <= near and count > 0:
        # it would be left out below, and the way jump by its length: the phase before it lasts longer instead
        base[count - 1] = base[count - 1]._replace(duration=base[count - 1].duration + plateau)
    else:
        count = _phase(Interval(plateau, rise, peak, 0.0, 0.0, 0.0), count, base)
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


class Meeting(NamedTuple):
    """How two stretches meet in a corner.

    first, second  numbers of the time intervals of both motions with a bump; 0 without
    node           the node of the bump
    lasts          overlap of both motions, s: as they were if there is no bump
    """

    first: int
    second: int
    node: Node
    lasts: float


_REST = Node(0.0)
SHORTEST = 1e-4  # s of overlap; less does not justify separate parts
LONGEST = 1.0 - 1e-6  # of the time that two runs may overlap: some of each stays apart


@kernel
def _stops(end: End, begin: End, longest: float, tolerance: float, limits: Records[Limits]) -> float:
    """Return the longest `overlap` of two stops, or 0 if it is too short."""
    lasts = overlap(end, begin, longest, tolerance, limits)
    return lasts if lasts >= SHORTEST else 0.0


@kernel
def meet(
    one: LineStretch,
    end: End,
    two: LineStretch,
    begin: End,
    before: Before,
    half: bool,
    tolerance: float,
    limits: Records[Limits],
    stops: float,
    longest: float,
    rows0: Records[Interval],
    rows1: Records[Interval],
) -> Meeting:
    """Find the fastest way through the corner between two stretches that take `stops` s from stop to stop: an overlap
    of the stops by up to `longest` s, or a bump, whose motions are written into `rows0` and `rows1`.

    `end` and `begin` have the motions, directions and bounds of the stretches.  `before` overlaps with the first
    stretch.  With `half`, half of the second stretch remains free for the following corner.

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
    best_node = _REST
    if gap <= 1e-18:
        return Meeting(0, 0, best_node, _stops(end, begin, longest, tolerance, limits))
    near = tolerance * BELOW / sqrt(gap)
    fastest = min(min(one.fastest, two.fastest), cube_root(79.2 * jerk * near * near))
    feed = max(end.feed, begin.feed)
    before_feed = max(before.end.feed, end.feed)
    # the overlap is found only where it might be quicker than a bump
    lasts = -1.0
    best = stops - max(longest, 0.0)
    ours = 0.0
    stop = end
    start = begin
    reached = 0.0
    # part of the width of a bump in which the acceleration of a ramp rises
    rise = one.acceleration * fastest / (one.jerk * 6.0 * near)
    for shape in range(7):
        # ramps and bump add up on some axes and cancel on others: with less jerk for the ramps the bump may be faster
        share = 1.0 if shape == 0 else (0.93 if shape == 1 else (0.85 if shape == 2 else 0.7))
        rises = 0.0
        blunt = 0.0
        if shape >= 1 and shape <= 3 and rise < _STEEP:
            continue  # the jerk does not matter
        if shape >= 4:
            if rise > _RISES:
                break
            # where the jerk is loose the accelerations add up: that of a blunt bump, with a longer s, is smaller, and
            # ramps that rise over a part of the bump leave it more
            share = 1.0
            rises = 0.0 if shape == 4 else (0.35 if shape == 5 else 0.6)
            blunt = 0.5 if shape == 6 else 1.0
        low = reached  # slower ramps require a higher speed in the corner
        high = fastest
        above = 1.0  # largest share of a limit at `high`; 1 if unknown
        more = 1.0  # the same at the last higher speed, whose cube is `farther`
        farther = 0.0
        v = fastest
        for again in range(_TRIES):
            # the snap of a bump is twice its jerk over s: at the limit of the jerk half of that of the snap
            least = 4.0 * one.jerk / one.snap if one.snap < 1e299 else 0.0
            blunted = blunt / (1.0 / 6.0 + blunt * blunt * (8.0 - blunt) / 192.0)  # s for s = blunt w, by phi(0)
            w, short = width(near / v, max(least, blunted * near / v))
            # the snaps of ramp and bump add up in the corner
            node = Node(v, w, short, share, 0.5, one.acceleration / (rises * w) if rises > 0.0 else 1e300)
            one = one._replace(tail=node)
            two = two._replace(head=node)
            good = False
            long = False  # if there is no room for the bump
            excess = 1.0  # largest share of a limit; 1 if unknown
            both = 2.0 * w + short
            peak0 = _peak(one)
            peak1 = _peak(two)
            time0 = _duration(one, peak0)
            time1 = _duration(two, peak1)
            time = time0 + time1 - both
            if lasts < 0.0 and ours == 0.0 and time0 > 0.0 and time1 > 0.0 and time >= best:
                lasts = _stops(stop, start, longest, tolerance, limits)
                best = stops - lasts
            slower = time0 > 0.0 and time1 > 0.0 and time >= best
            if time0 > 0.0 and time1 > 0.0 and not slower:
                n = _rows(one, peak0, rows0)
                m = _rows(two, peak1, rows1)
                good = n > 0 and m > 0
                long = both > time0 - before.lasts or both > (0.5 * time1 if half else time1)
                good = good and not long
                end = end._replace(motion=rows0, used=n, length=one.length)
                begin = begin._replace(motion=rows1, used=m)
            if good:
                most, away, _slower = together(end, begin, both, limits, feed)
                good = most <= 1.0 + 1e-10 and away <= tolerance
                excess = most
            if good and before.lasts > 0.0:
                most, away, _slower = together(before.end, end, before.lasts, limits, before_feed)
                good = most <= 1.0 + 1e-10 and away <= before.tolerance
                excess = most
            if slower or good or long:
                low = v  # lower speeds are slower as well, and their bumps longer
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
        if lasts < 0.0:
            lasts = _stops(stop, start, longest, tolerance, limits)
        return Meeting(0, 0, best_node, lasts)
    count0 = straight(one._replace(tail=best_node), rows0)
    count1 = straight(two._replace(head=best_node), rows1)
    return Meeting(count0, count1, best_node, 2.0 * best_node.wide + best_node.short)


@kernel
def line_stretch(
    along: Floats, feed: float, length: float, limits: Records[Limits], head: Node, tail: Node
) -> LineStretch:
    """Return a stretch of a line from node to node; `along` is the direction of the line, `feed` in m/s."""
    fastest = 1e300
    a = 1e300
    j = 1e300
    s = 1e300
    norm = 0.0
    for i in range(len(limits)):
        # an axis that does not move sets no limit, and must not divide by zero
        slope = max(abs(along[i]), 1e-200)
        limit = limits[i]
        fastest = min(fastest, limit.velocity / slope)
        a = min(a, limit.acceleration / slope)
        j = min(j, limit.jerk / slope)
        s = min(s, limit.snap / slope)
        norm = norm + slope * slope
    below = 1.0 - 1e-12
    fastest = min(fastest * below, feed / sqrt(norm))
    return LineStretch(length, fastest, a * below, j * below, s * below, head, tail)


class LineRuns(NamedTuple):
    """Consecutive runs along a single line each, from rest to rest, as arrays over the n runs.

    line       the whole run as a stretch
    feed       m/s
    tolerance  of the corner in which it ends, m; 0: a stop
    along      direction, shape (n, N)
    most       bounds of each axis, shape (n, N)
    motion     time intervals, shape (n, ROWS), of which the first `used` count
    lasts      overlap with the previous run, s
    """

    line: Records[LineStretch]
    feed: Floats
    tolerance: Floats
    along: Floats2
    most: Records2[Slopes]
    motion: Records2[Interval]
    used: Ints
    lasts: Floats


@kernel
def lasting(motion: Records[Interval], used: int) -> float:
    """Return the duration of the first `used` time intervals, s."""
    total = 0.0
    for m in range(used):
        total = total + motion[m].duration
    return total


@kernel
def stop_lines(pieces: Pieces, limits: Records[Limits], first: int, runs: LineRuns) -> int:
    """Plan lines from stop to stop, as runs from number `first` on; return how many have a motion: up to the first one
    that has none.
    """
    rest = Node(0.0)
    for k in range(len(pieces.length)):
        to = first + k
        length = pieces.length[k]
        feed = pieces.feed[k]
        for i in range(len(limits)):
            slope = line_way(pieces.shape[k], i) / length
            runs.along[to, i] = slope
            runs.most[to, i] = Slopes(abs(slope), 0.0, 0.0, 0.0)
        line = line_stretch(runs.along[to], feed, length, limits, rest, rest)
        runs.line[to] = line
        runs.feed[to] = feed
        runs.lasts[to] = 0.0
        runs.used[to] = straight(line, runs.motion[to])
        if runs.used[to] == 0:
            return k
    return len(pieces.length)


class Leaves(NamedTuple):
    """The motions of runs that are final, one after the other.

    motion    all their time intervals
    alone     where the motion of each run before its overlap with the next run begins, shape (n,)
    common    where its part in this overlap begins
    entering  where the part of the next run in this overlap begins, and ends where that of the next run begins
    """

    motion: Motion
    alone: Ints
    common: Ints
    entering: Ints


class Both(NamedTuple):
    """Room for the time intervals of two runs at a corner, 2 ROWS each."""

    first: Records[Interval]
    second: Records[Interval]


@kernel
def _copied(motion: Records[Interval], used: int, to: Records[Interval]) -> int:
    """Copy the first `used` time intervals; return their number."""
    for m in range(used):
        to[m] = motion[m]
    return used


@kernel
def _leave(runs: LineRuns, k: int, work: Both, count: int, out: Leaves) -> int:
    """Append the final motion of run k, and drop what run k + 1 has of it; return the number of time intervals."""
    out.alone[k] = count
    two = k + 1
    if runs.lasts[two] == 0.0:
        for m in range(runs.used[k]):
            count = appended(out.motion, count, runs.motion[k, m], 0)
        out.common[k] = count
        out.entering[k] = count
        return count
    both = shared(
        runs.motion[k], runs.used[k], runs.motion[two], runs.used[two], runs.lasts[two], work.first, work.second
    )
    for m in range(both.begins):
        count = appended(out.motion, count, runs.motion[k, m], 0)
    if both.alone > 0.0:
        count = appended(out.motion, count, runs.motion[k, both.begins]._replace(duration=both.alone), 0)
    out.common[k] = count
    for m in range(both.common):
        count = appended(out.motion, count, work.first[m], 0)
    out.entering[k] = count
    for m in range(both.common):
        count = appended(out.motion, count, work.second[m], 0)
    left = runs.used[two] - both.ends
    behind = runs.motion[two]
    for m in range(left):
        behind[m] = behind[both.ends + m]
    if left > 0:
        behind[0] = both.rest
    runs.used[two] = left
    return count


@kernel
def meet_lines(runs: LineRuns, limits: Records[Limits], work: Both, out: Leaves) -> int:
    """Plan the corners behind all runs but the first and the last; write all but the last two runs, which are final
    then, and return the number of their time intervals.

    The corner between the first two is planned already.
    """
    count = 0
    motion, used, line, feed, along, most = runs.motion, runs.used, runs.line, runs.feed, runs.along, runs.most
    for two in range(2, len(used)):
        one = two - 1
        if runs.tolerance[one] > 0.0:
            zero = one - 1
            time0 = lasting(motion[zero], used[zero])
            time1 = lasting(motion[one], used[one])
            time2 = lasting(motion[two], used[two])
            ended = End(
                motion[zero], used[zero], time0, line[zero].length, feed[zero], along[zero], most[zero], LINE, along
            )
            end = End(motion[one], used[one], time1, line[one].length, feed[one], along[one], most[one], LINE, along)
            begin = End(motion[two], used[two], time2, line[two].length, feed[two], along[two], most[two], LINE, along)
            found = meet(
                line[one],
                end,
                line[two],
                begin,
                Before(ended, runs.lasts[one], runs.tolerance[zero]),
                True,
                runs.tolerance[one],
                limits,
                time1 + time2,
                # half of a run is reserved for the corner at its other end
                min(0.5 * time2, time1 - runs.lasts[one]) * LONGEST,
                work.first,
                work.second,
            )
            runs.lasts[two] = found.lasts
            if found.first > 0:
                used[one] = _copied(work.first, found.first, motion[one])
                used[two] = _copied(work.second, found.second, motion[two])
                line[two] = line[two]._replace(head=found.node)
        count = _leave(runs, one - 1, work, count, out)
    return count
