"""Ramps of the speed u', and their bounds on a piece of the path.

With M_k = max |r_i^(k)| on a piece and speed, acceleration, jerk and snap of u up to v, A, J, S:

    |q'| <= M1 v,  |q''| <= M2 v² + M1 A,  |q'''| <= M3 v³ + 3 M2 v A + M1 J
    |q''''| <= M4 v⁴ + 6 M3 v² A + M2 (3 A² + 4 v J) + M1 S

A ramp is a step smoothed by three boxcars, so that the snap is piecewise constant:

    u'(t) = low + rise · (step * box(L1) * box(L2) * box(L3)),   L1 <= L2,  L1 + L2 <= L3

It begins and ends with u'' = u''' = 0.  Its jerk is at most rise/(L2 L3), its acceleration rise/L3, its snap
rise/(L1 L2 L3), and it covers the distance (low + high)/2 · (L1 + L2 + L3).  A ramp down is a time-reversed ramp up.
Without a limit of the snap L1 is 0, and the jerk is piecewise constant; without a limit of the jerk as well L2 is 0,
and the acceleration is constant.

Source: Lambrechts, Boerlage & Steinbuch 2005, whose fourth-order profile is two such ramps.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Records, Records2, zeros
from feeddrive.path.motion import Limits, Piece, Pieces, arc_axis, cubic, line_way, way, when

# so that a bound still holds after rounding
_WIDER = 1.0 + 1e-13
# `straight` starts its minima at 1e300, as kernels have no infinity
_NO_LIMIT = 1e299
# caps at one feed differ by the rounding of |r'|, and a ramp between them would cost time for nothing
_LEVEL = 1.001  # largest ratio of the caps of neighbors that are made equal


# lifting begins and ends on plateaus: at the limit itself no spline could start (`_TOUCHES` in `spline`, in speeds)
_BELOW = 1.0 - 6e-7


class Slopes(NamedTuple):
    """The largest |r'| .. |r''''| of an axis on a piece: M1 .. M4."""

    M1: float
    M2: float
    M3: float
    M4: float


@kernel
def bounds(piece: Piece, out: Records[Slopes]) -> float:
    """Write the bounds of each axis into `out`; return a bound on |r'|, or 1 for a paced piece.

    Polynomials are bounded by the convex hull of their Bernstein points, arcs in closed form.
    """
    n = len(piece.shape)
    norm = 0.0
    if piece.kind == 0:
        for i in range(n):
            slope = line_way(piece.shape, i) / piece.length
            norm = norm + slope * slope
            out[i] = Slopes(abs(slope), 0.0, 0.0, 0.0)
        return sqrt(norm) * _WIDER
    if piece.kind == 1:
        kappa = arc_axis(piece.shape, 0).curvature
        size1 = 0.0
        size2 = 0.0
        skew = 0.0
        along1 = 0.0
        along2 = 0.0
        for i in range(n):
            e1, e2, drift, _ = arc_axis(piece.shape, i)
            big = sqrt(e1 * e1 + e2 * e2) * _WIDER
            second = big * kappa * kappa
            third = second * kappa
            out[i] = Slopes(big * kappa + abs(drift), second, third, third * kappa)
            size1 = size1 + e1 * e1
            size2 = size2 + e2 * e2
            skew = skew + e1 * e2
            along1 = along1 + e1 * drift
            along2 = along2 + e2 * drift
            norm = norm + drift * drift
        # the larger eigenvalue of the Gram matrix of E1 and E2 bounds |E2 cos θ - E1 sin θ|² at any θ
        oval = size1 - size2
        ring = 0.5 * (size1 + size2 + sqrt(oval * oval + 4.0 * skew * skew))
        return sqrt(kappa * kappa * ring + 2.0 * kappa * sqrt(along1 * along1 + along2 * along2) + norm) * _WIDER
    points = zeros(8)
    norms = zeros(8)
    scale1 = 1.0 / piece.length
    scale2 = scale1 / piece.length
    scale3 = scale2 / piece.length
    scale4 = scale3 / piece.length
    for i in range(n):
        c = piece.shape[i]
        second = _hull(c, 2, points) * scale2 * _WIDER
        third = _hull(c, 3, points) * scale3 * _WIDER
        fourth = _hull(c, 4, points) * scale4 * _WIDER
        out[i] = Slopes(_hull(c, 1, points) * scale1 * _WIDER, second, third, fourth)
        for k in range(7):
            norms[k] = norms[k] + points[k] * points[k]
    if piece.kind == 3:
        return 1.0
    for k in range(7):
        norm = max(norm, norms[k])
    return sqrt(norm) / piece.length * _WIDER


@kernel
def _hull(c: Floats, m: int, points: Floats) -> float:
    """Return the largest of the Bernstein points of the m-th derivative of Σ c_k ξᵏ with respect to ξ; write all of
    them into `points`.
    """
    degree = 7 - m
    # coefficients of the derivative over the binomials, then differences backwards: Bernstein points
    for k in range(degree + 1):
        value = c[k + m]
        for j in range(m):
            value = value * (k + m - j)
        for j in range(k):
            value = value * (j + 1) / (degree - j)
        points[k] = value
    for k in range(degree):
        for back in range(degree - k):
            j = degree - back
            points[j] = points[j] + points[j - 1]
    most = 0.0
    for k in range(degree + 1):
        most = max(most, abs(points[k]))
    return most


@kernel
def cube_root(x: float) -> float:
    """Return the cube root of x >= 0, within two units in the last place."""
    if x < 0.0:
        raise ValueError("the cube root is taken of numbers from 0 on")
    if x == 0.0 or x - x != 0.0:
        return x
    # scaling by powers of 8 is exact, so the result does not depend on the size of x
    rest, scale = x, 1.0
    while rest >= 1.0:
        rest, scale = rest * 0.125, scale * 2.0
    while rest < 0.125:
        rest, scale = rest * 8.0, scale * 0.5
    # the line is within 14 % of the root on 1/8 .. 1, and each Newton step doubles the digits: five reach rounding
    root = 0.4 + 0.6 * rest
    for _ in range(5):
        root -= (root - rest / (root * root)) / 3.0
    return root * scale


@kernel
def root(value: float, degree: int) -> float:
    """Return the second, third or fourth root of a positive number."""
    if degree == 2:
        return sqrt(value)
    if degree == 3:
        return cube_root(value)
    return sqrt(sqrt(value))


@kernel
def _slower(speed: float, limit: float, most: float, degree: int, share: float) -> float:
    """Return the lower of two speeds: the given one, and `share` times that at which `most` reaches a limit."""
    if most > 0.0:
        ratio = limit / most
        if ratio < 1e36:
            return min(speed, share * root(ratio, degree))
    return speed


@kernel
def speed_cap(most: Records[Slopes], norm: float, feed: float, limits: Records[Limits], share: float) -> float:
    """Return the speed limit of a piece: the lowest of the feed, the velocity limits, and `share` times the limit due
    to curvature.
    """
    # |r'| of splines exceeds 1 by rounding only: they get the same cap as lines
    speed = feed / norm if norm > 1.0 + 1e-10 else feed
    for i in range(len(limits)):
        slopes = most[i]
        limit = limits[i]
        if slopes.M1 > 0.0:
            speed = min(speed, limit.velocity / slopes.M1)
        speed = _slower(speed, limit.acceleration, slopes.M2, 2, share)
        speed = _slower(speed, limit.jerk, slopes.M3, 3, share)
        speed = _slower(speed, limit.snap, slopes.M4, 4, share)
    # a plateau at the cap must keep the limit in spite of rounding
    return speed * (1.0 - 1e-12)


class Cap(NamedTuple):
    """The speed limits of a piece, m/s: of a plateau on it, and of a ramp that crosses it."""

    plateau: float
    ramp: float


@kernel
def pieces_room(
    pieces: Pieces,
    limits: Records[Limits],
    cruise: float,
    crossing: float,
    known: bool,
    most: Records2[Slopes],
    norms: Floats,
    caps: Records[Cap],
) -> int:
    """Write the `bounds` of n pieces into `most` (n, N) and `norms` (n,), unless they are `known`, and their caps for
    plateaus and for crossing ramps into `caps` (n,).

    Neighbors with nearly equal caps all get the lowest of them, so that no ramps occur between them.
    """
    n = len(pieces.length)
    for p in range(n):
        if not known:
            norms[p] = bounds(Piece(pieces.kind[p], pieces.length[p], pieces.shape[p]), most[p])
        norm = norms[p]
        feed = pieces.feed[p]
        caps[p] = Cap(
            _BELOW * speed_cap(most[p], norm, feed, limits, cruise),
            _BELOW * speed_cap(most[p], norm, feed, limits, crossing),
        )
    first = 0
    low = 0.0
    high = 0.0
    for p in range(n + 1):
        if p < n:
            speed = caps[p].plateau
            if p > first and max(high, speed) <= _LEVEL * min(low, speed):
                low = min(low, speed)
                high = max(high, speed)
                continue
        for k in range(first, p):
            caps[k] = Cap(low, min(low, caps[k].ramp))
        first = p
        low = caps[p].plateau if p < n else 0.0
        high = low
    return 0


_WALKS = 16  # largest number of passes along a ramp to find the fastest one
_NEAR = 0.003  # logarithm of the duration by which a ramp may be too slow
_ABOVE = 1.0 + 2e-9  # relative tolerance of speed, acceleration and jerk for Newton's method


class Ramp(NamedTuple):
    """The widths of a ramp's boxcars, s, or zeros for no ramp."""

    L1: float
    L2: float
    L3: float


NO_RAMP = Ramp(0.0, 0.0, 0.0)


class Bounds(NamedTuple):
    """The largest acceleration .. snap of u, m/s² .. m/s⁴."""

    acceleration: float
    jerk: float
    snap: float


class Path(NamedTuple):
    """The pieces of a path with their bounds and speed limits.

    begin   u at the start of each of n pieces, and at the end of the last, m, shape (n + 1,)
    most    bounds of the first .. fourth derivative of each axis with respect to u, (n, N)
    caps    speed limits of each piece, (n,)
    limits  limits of each axis, (N,)
    """

    begin: Floats
    most: Records2[Slopes]
    caps: Records[Cap]
    limits: Records[Limits]


@kernel
def duration(ramp: Ramp) -> float:
    """Return the duration of a ramp, s."""
    return ramp.L1 + ramp.L2 + ramp.L3


@kernel
def boxcars(step: float, acceleration: float, jerk: float, snap: float) -> Ramp:
    """Return the shortest ramp for a change of speed, m/s; a jerk or snap from 1e299 on is not limited.

    L1 = min(J/S, √(A/S), ∛(dv/2S)),  L2 = min(A/(S L1), L with S L1 L (L1 + L) = dv),  L3 = dv/(S L1 L2)

    Without a limit of the snap L1 = 0, L2 = min(A/J, √(dv/J)), L3 = dv/(J L2), and without both L2 = 0, L3 = dv/A.
    """
    rise = abs(step)
    if rise == 0.0:
        return NO_RAMP
    if snap >= _NO_LIMIT:
        if jerk >= _NO_LIMIT:
            return Ramp(0.0, 0.0, rise / acceleration)
        second = min(acceleration / jerk, sqrt(rise / jerk))
        return Ramp(0.0, second, rise / (jerk * second))
    # full snap, unless jerk, acceleration or the step of speed itself ends the first boxcar earlier
    first = min(jerk / snap, sqrt(acceleration / snap))
    cube = rise / (2.0 * snap)
    # a root that exceeds the others by more than rounding is not taken
    if cube <= first * first * first * _WIDER:
        first = min(first, cube_root(cube))
    reached = snap * first
    # the second boxcar with which the ramp has no phase of constant acceleration
    whole = 0.5 * (sqrt(first * first + 4.0 * rise / reached) - first)
    second = max(first, min(acceleration / reached, whole))
    return Ramp(first, second, rise / (reached * second))


@kernel
def phase(number: int, rise: float, ramp: Ramp) -> tuple[float, float]:
    """Return the duration and snap of one of the seven phases of a ramp up."""
    L1, L2, L3 = ramp
    snap = rise / (L1 * L2 * L3) if L1 > 0.0 else 0.0
    if number == 0 or number == 6:
        return L1, snap
    if number == 2 or number == 4:
        return L1, -snap
    if number == 1 or number == 5:
        return L2 - L1, 0.0
    return max(L3 - L1 - L2, 0.0), 0.0


@kernel
def ramp_jerk(rise: float, ramp: Ramp) -> float:
    """Return the largest jerk of a ramp, or 0 if its acceleration jumps."""
    return rise / (ramp.L2 * ramp.L3) if ramp.L2 > 0.0 else 0.0


@kernel
def acceleration_before(number: int, rise: float, ramp: Ramp, before: float) -> float:
    """Return the acceleration at the start of a phase of a ramp up: that `before`, unless it jumps."""
    if ramp.L2 > 0.0:
        return before
    return rise / ramp.L3 if number == 3 else 0.0


@kernel
def jerk_before(number: int, jerk: float) -> float:
    """Return the jerk at the start of a phase of a ramp up (7: its end): the jerk rises, is constant, falls, is 0, and
    then repeats this with negative sign.
    """
    if number == 0 or number == 3 or number == 4 or number == 7:
        return 0.0
    return jerk if number < 3 else -jerk


@kernel
def speed_at(far: float, low: float, rise: float, ramp: Ramp) -> float:
    """Return the speed in m/s reached after the distance `far` of an acceleration ramp."""
    if far <= 0.0:
        return low
    whole = (low + 0.5 * rise) * duration(ramp)
    if far >= whole:
        return low + rise
    jerk = ramp_jerk(rise, ramp)
    v = low
    a = 0.0
    j = 0.0
    gone = 0.0
    for number in range(7):
        T, s = phase(number, rise, ramp)
        step = T * (v + T * (0.5 * a + T * (j / 6.0 + T * s / 24.0)))
        if gone + step >= far or number == 6:
            t = when(far - gone, v, a, j, s, 0.0, T)
            # rounded upwards, since the caller compares it with a cap
            return min(low + rise, (v + t * (a + t * (0.5 * j + t * s / 6.0))) * (1.0 + 1e-12))
        gone = gone + step
        v = v + T * (a + T * (0.5 * j + T * s / 6.0))
        a = acceleration_before(number + 1, rise, ramp, a + T * (j + 0.5 * T * s))
        j = jerk_before(number + 1, jerk)
    return low + rise


@kernel
def _lacks(
    most: Records[Slopes], cap: Cap, limits: Records[Limits], v: float, a: float, j: float, s: float, free: bool
) -> float:
    """Return the factor by which a ramp's duration must increase to satisfy the limits on a piece, as a logarithm;
    negative if the ramp may be shorter.

    v .. s are the largest speed .. snap of u there.  The result is one Newton step towards a utilization of 1, where
    u'', u''', u'''' decrease with the first, second, third power of the duration: the utilization is convex in the
    logarithm of the duration, so the step never overshoots.
    """
    least = -0.3
    if free:
        v = min(v, cap.ramp)
    elif v > cap.plateau * (1.0 + 1e-12):
        least = 0.02 + 2.0 * (v - cap.plateau) / v
    v2 = v * v
    v3 = v2 * v
    va = 3.0 * v * a
    vva = 6.0 * v2 * a
    mixed = 3.0 * a * a + 4.0 * v * j
    for i in range(len(limits)):
        m1, m2, m3, m4 = most[i]
        if m1 == 0.0:
            continue  # the axis stands
        limit = limits[i]
        one = m1 * a
        over = m2 * v2 + one - limit.acceleration
        if over > least * one:
            least = over / max(one, over)
        one = m2 * va
        two = m1 * j
        over = m3 * v3 + one + two - limit.jerk
        one = one + two + two
        if over > least * one:
            least = over / max(one, over)
        one = m3 * vva
        two = m2 * mixed
        three = m1 * s
        over = m4 * v2 * v2 + one + two + three - limit.snap
        one = one + two + two + three + three + three
        if over > least * one:
            least = over / max(one, over)
    return least


@kernel
def _until(far: float, v: float, a: float, j: float, s: float, t0: float, t1: float) -> float:
    """Return the time in [t0, t1] at which a ramp up reaches the distance `far`, by Newton's method from above, as
    the distance is convex.
    """
    # the distance is convex: its tangent at t0 arrives too late, and from there Newton's method cannot overshoot
    slope = cubic(v, a, j, s, t0)
    t = t1
    if slope > 0.0:
        t = min(t1, t0 + (far - way(v, a, j, s, t0)) / slope)
    for _ in range(40):
        slope = cubic(v, a, j, s, t)
        if slope <= 0.0:
            break
        step = (way(v, a, j, s, t) - far) / slope
        t = t - step
        if step <= 1e-5 * t:
            break
    return min(max(t, t0), t1)


@kernel
def lacking(
    path: Path, u: float, first: int, sense: int, low: float, rise: float, ramp: Ramp, free: bool, enough: float
) -> float:
    """Return the factor by which a ramp's duration must increase to satisfy the limits on every piece that it crosses,
    as a logarithm; they are satisfied if the result is <= 0.

    A result above `enough` is only a lower bound.
    """
    L1, L2, L3 = ramp
    jerk = ramp_jerk(rise, ramp)
    whole = (low + 0.5 * rise) * (L1 + L2 + L3)
    p = first
    number = 0
    v = low
    a = 0.0
    j = 0.0
    gone = 0.0
    least = -0.3
    lasts, s = phase(0, rise, ramp)
    step = way(v, a, j, s, lasts)
    t = 0.0  # in the phase, where the piece begins
    while True:
        far = (path.begin[p + 1] - u) if sense > 0 else (u - path.begin[p])
        # acceleration and jerk of u where the piece begins, then their largest values on it
        a_most = a + t * (j + 0.5 * t * s)
        j_most = abs(j + t * s)
        s_most = abs(s)
        v_most = low + rise
        over = far >= whole
        while over or gone + step < far:
            if number == 6:
                over = True
                t = lasts
                break
            gone = gone + step
            v = cubic(v, a, j, s, lasts)
            number = number + 1
            a = acceleration_before(number, rise, ramp, a + lasts * (j + 0.5 * lasts * s))
            j = jerk_before(number, jerk)
            lasts, s = phase(number, rise, ramp)
            step = way(v, a, j, s, lasts)
            t = 0.0
            a_most = max(a_most, a)
            j_most = max(j_most, abs(j))
            s_most = max(s_most, abs(s))
        if not over:
            t = _until(far - gone, v, a, j, s, t, lasts)
            v_most = min(v_most, cubic(v, a, j, s, t) * _ABOVE)
        a_most = max(a_most, a + t * (j + 0.5 * t * s)) * _ABOVE
        j_most = max(j_most, abs(j + t * s)) * _ABOVE
        least = max(least, _lacks(path.most[p], path.caps[p], path.limits, v_most, a_most, j_most, s_most, free))
        p = p + sense
        if over or p < 0 or p >= len(path.most) or least > enough:
            return least


@kernel
def straight(most: Records[Slopes], limits: Records[Limits]) -> Bounds:
    """Return the acceleration, jerk and snap of u that a piece would allow without curvature."""
    a = 1e300
    j = 1e300
    s = 1e300
    for i in range(len(limits)):
        m1 = most[i].M1
        if m1 > 0.0:
            a = min(a, limits[i].acceleration / m1)
            j = min(j, limits[i].jerk / m1)
            s = min(s, limits[i].snap / m1)
    return Bounds(a, j, s)


@kernel
def fit(
    path: Path, u: float, first: int, sense: int, end: float, low: float, high: float, free: bool, guess: float
) -> tuple[bool, Ramp, float]:
    """Return the fastest ramp found from `low` at u to `high` that satisfies the limits on every piece it crosses.

    `sense` is the direction in which the speed rises, 1 for increasing and -1 for decreasing u; `first` is the piece it
    starts on, `end` the last u it may reach.  The first result is False if there is none.  A `free` ramp may exceed the
    caps of pieces, where limits are evaluated at the cap for crossing: it shows which caps are active.

    The shape of the ramp follows from the limits on its first piece without curvature.  It is scaled in time until it
    satisfies all limits; the last result is the scale factor, or the one that would be required, and `guess` its
    initial value.
    """
    rise = high - low
    if rise <= 1e-14 * high:
        return True, NO_RAMP, guess
    a, j, s = straight(path.most[first], path.limits)
    L1, L2, L3 = boxcars(rise, a, j, s)
    slowest = (end - u) * sense / ((low + 0.5 * rise) * (L1 + L2 + L3))
    if slowest < 0.5:
        return False, NO_RAMP, guess
    # on straight pieces the ramp is feasible at scale 1, but for the margin that `lacking` adds to its values
    shape = 1.0 + 4e-9
    least = 0.5 * min(1.0, slowest)
    scale = min(max(guess, least), slowest)
    slow = 0.0  # the fastest feasible one
    quick = 0.0  # the slowest infeasible one
    for _ in range(_WALKS):
        ramp = Ramp(scale * L1, scale * L2, scale * L3)
        lack = lacking(path, u, first, sense, low, rise, ramp, free, 0.0 if scale >= slowest else 0.5)
        lack = min(lack, 0.5)
        # 0.3 % beyond Newton's step, which approaches the limit from the infeasible side and would never cross it
        wanted = scale * (1.003 + lack * (1.0 + 0.5 * lack))
        if lack <= 0.0:
            slow = scale
            if lack >= -_NEAR or slow <= least:
                break
        else:
            quick = scale
            if scale >= slowest or scale > 1e6:
                return False, NO_RAMP, wanted
        if quick < shape and shape < slowest and (slow == 0.0 or shape < slow) and abs(wanted - shape) < 0.012:
            wanted = shape
        if slow > 0.0:
            if slow <= (1.0 + _NEAR) * quick:
                break
            if wanted <= quick or wanted >= slow:
                wanted = sqrt(slow * max(quick, least))
        scale = min(max(wanted, least), slowest)
    if slow == 0.0:
        return False, NO_RAMP, scale
    return True, Ramp(slow * L1, slow * L2, slow * L3), slow
