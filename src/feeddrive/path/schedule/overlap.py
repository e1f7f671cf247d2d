"""Two runs that overlap in the corner between them: the next begins before the one before has come to rest.

With D the time in which both move, q = q0(t) + q1(t - T0 + D) - c.  It keeps a limit if the sum of both motions does,
and between lines the tolerance if it is near enough to the corner when the ways of both to it are equal; between other
pieces these ways must be as short, too.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2
from feeddrive.path.motion import Entering, Motion, Part, cubic, from_rows, rows, way
from feeddrive.path.pieces import Pieces

_HALVINGS = 24  # of the time in which both move
_SLIVER = 1e-12  # of an overlap: two phases that end so near to each other end together
BELOW = 1.0 - 1e-10  # of a tolerance: rounding


@kernel
def _widened(low: float, high: float, down: float, up: float, more: float, out: Floats) -> int:
    """Add [low, high] · [-down, up] ± more to the interval in `out`."""
    out[0] = out[0] + min(min(-low * down, -high * down), min(low * up, high * up)) - more
    out[1] = out[1] + max(max(-low * down, -high * down), max(low * up, high * up)) + more
    return 0


@kernel
def _bent(most: Floats, c: float, v: float, a: float, j: float, s: float, h: float, away: float, out: Floats2) -> int:
    """Add to the rows of `out` by how much velocity .. snap of an axis may differ from those along the tangent.

    c is r' of the axis at the corner, `most` bounds r' .. r'''' and `away` the way to the corner; u' .. u'''' as they
    are at the begin of h seconds.
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
    """Of |value + rest|, of an interval."""
    return max(abs(value + rest[0]), abs(value + rest[1]))


@kernel
def together(
    motion0: Floats2, count0: int,
    length0: float, direction0: Floats, most0: Floats2,
    motion1: Floats2, count1: int,
    direction1: Floats, most1: Floats2,
    lasts: float, limits: Floats2, feed: float,
) -> tuple[float, float]:  # fmt: skip
    """The largest share of a limit or the feed that the sum takes at most, and the distance to the corner, m.

    The first motion ends on a piece of the given length, the second begins on another one, and they overlap for `lasts`
    seconds; the directions are r' in the corner.  Ranges are those of Bernstein points.
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
                # the ways become equal here
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
    motion0: Floats2, count0: int,
    length0: float, direction0: Floats, most0: Floats2,
    motion1: Floats2, count1: int,
    direction1: Floats, most1: Floats2,
    longest: float, tolerance: float, limits: Floats2, feed: float,
) -> float:  # fmt: skip
    """The longest time up to `longest` found in which both may move, by halving; 0: none."""
    low = 0.0
    high = longest
    lasts = longest
    for _ in range(_HALVINGS):
        share, distance = together(
            motion0, count0, length0, direction0, most0,
            motion1, count1, direction1, most1, lasts, limits, feed,
        )  # fmt: skip
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
    """A piece of time from t on, for `lasts` seconds."""
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
    """The last seconds of the one and the first of the other motion, in pieces of time that both have, and how many.

    Then the piece in which the one ends alone, after how many seconds of it, and that in which the other goes on alone:
    `rest` is what is left of it.  What ends within 1e-12 of the time together ends together.
    """
    near = _SLIVER * lasts
    m = len(one)
    left = lasts
    while m > 0 and left > near:
        m = m - 1
        if left < one[m, 0] - near:
            break
        left = left - one[m, 0]
    # what is left of both present pieces: no digits are lost where they are long
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
    """Two runs of which the second begins `lasts` s before the first ends: both until then, and what is left of it."""
    ends, begins = rows(one.motion), rows(two.motion)
    last, first, rest = (np.zeros((len(ends) + len(begins), 6)) for _ in range(3))
    count, m, alone, n = shared(ends, begins, lasts, last, first, rest[0])
    entering = Entering(Pieces(*(each[:1] for each in two.pieces)), from_rows(first[:count], 0), tolerance)
    k = len(one.pieces.length) - 1
    leaves = [Part(Pieces(*(each[k:] for each in one.pieces)), from_rows(last[:count], 0), True, entering)]
    before = Motion(*(each[: m + int(alone > 0.0)].copy() for each in one.motion))
    if len(before.duration):
        before.duration[-1] = alone if alone > 0.0 else before.duration[-1]
        leaves.insert(0, one._replace(motion=before, ends=False))
    behind = Motion(*(each[n:].copy() for each in two.motion))
    if len(behind.duration):
        for column, value in zip([behind.duration, *behind[2:]], rest[0].tolist(), strict=True):
            column[0] = value
    return leaves, two._replace(motion=behind)
