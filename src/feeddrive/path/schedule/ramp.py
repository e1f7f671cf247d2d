"""Ramps of the speed u': a step smoothed by three boxcars, so that the snap is constant by pieces.

    u'(t) = low + rise · (step * box(L1) * box(L2) * box(L3)),   L1 <= L2,  L1 + L2 <= L3

begins and ends with u'' = u''' = 0.  Its jerk is at most rise/(L2 L3), its acceleration rise/L3, its snap
rise/(L1 L2 L3), and it takes the way (low + high)/2 · (L1 + L2 + L3).  A ramp downwards is the same one, backwards.

Source: Lambrechts, Boerlage & Steinbuch 2005, whose fourth-order profile is two such ramps.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3
from feeddrive.path.motion import when
from feeddrive.path.schedule.room import cube_root

_HALVINGS = 6  # in search of the quickest ramp


@kernel
def boxcars(step: float, acceleration: float, jerk: float, snap: float) -> tuple[float, float, float]:
    """Widths L1, L2, L3 (s) of the shortest ramp over a step of speed; zeros for no step.

    L1 = min(J/S, √(A/S), ∛(dv/2S)),  L2 = min(A/(S L1), L with S L1 L (L1 + L) = dv),  L3 = dv/(S L1 L2)
    """
    rise = abs(step)
    if rise == 0.0:
        return 0.0, 0.0, 0.0
    first = min(jerk / snap, sqrt(acceleration / snap), cube_root(rise / (2.0 * snap)))
    reached = snap * first
    whole = 0.5 * (sqrt(first * first + 4.0 * rise / reached) - first)
    second = max(first, min(acceleration / reached, whole))
    return first, second, rise / (reached * second)


@kernel
def phase(number: int, rise: float, L1: float, L2: float, L3: float) -> tuple[float, float]:
    """Duration and snap of one of the seven phases of a ramp upwards."""
    snap = rise / (L1 * L2 * L3)
    if number == 0 or number == 6:
        return L1, snap
    if number == 2 or number == 4:
        return L1, -snap
    if number == 1 or number == 5:
        return L2 - L1, 0.0
    return L3 - L1 - L2, 0.0


@kernel
def jerk_before(number: int, jerk: float) -> float:
    """The jerk with which a phase of a ramp upwards begins, 7 for its end: it rises, holds, falls, rests, and back."""
    if number == 0 or number == 3 or number == 4 or number == 7:
        return 0.0
    return jerk if number < 3 else -jerk


@kernel
def speed_at(way: float, low: float, rise: float, L1: float, L2: float, L3: float) -> float:
    """The speed of a ramp upwards when it has gone this way, m/s."""
    if way <= 0.0:
        return low
    total = L1 + L2 + L3
    whole = (low + 0.5 * rise) * total
    if way >= whole:
        return low + rise
    jerk = rise / (L2 * L3)
    v = low
    a = 0.0
    j = 0.0
    gone = 0.0
    for number in range(7):
        T, s = phase(number, rise, L1, L2, L3)
        step = T * (v + T * (0.5 * a + T * (j / 6.0 + T * s / 24.0)))
        if gone + step >= way or number == 6:
            t = when(way - gone, v, a, j, s, 0.0, T)
            # not rounded down
            return min(low + rise, (v + t * (a + t * (0.5 * j + t * s / 6.0))) * (1.0 + 1e-12))
        gone = gone + step
        v = v + T * (a + T * (0.5 * j + T * s / 6.0))
        a = a + T * (j + 0.5 * T * s)
        j = jerk_before(number + 1, jerk)
    return low + rise


@kernel
def _fits_piece(
    most: Floats2, cap: float, crossing: float, limits: Floats2, v: float, a: float, j: float, s: float, free: bool
) -> bool:
    """Whether speeds, accelerations, jerks and snaps of u up to these keep the limits on a piece."""
    if free:
        v = min(v, crossing)
    elif v > cap * (1.0 + 1e-12):
        return False
    v2 = v * v
    for i in range(len(limits)):
        m1 = most[i, 0]
        m2 = most[i, 1]
        m3 = most[i, 2]
        if m2 * v2 + m1 * a > limits[i, 1] or m3 * v2 * v + 3.0 * m2 * v * a + m1 * j > limits[i, 2]:
            return False
        if most[i, 3] * v2 * v2 + 6.0 * m3 * v2 * a + m2 * (3.0 * a * a + 4.0 * v * j) + m1 * s > limits[i, 3]:
            return False
    return True


@kernel
def holds(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2,
    u: float, first: int, way: int, low: float, rise: float, L1: float, L2: float, L3: float, free: bool,
) -> bool:  # fmt: skip
    """Whether a ramp keeps every limit on every piece that it crosses, with its largest derivatives there."""
    jerk = rise / (L2 * L3)
    whole = (low + 0.5 * rise) * (L1 + L2 + L3)
    p = first
    number = 0
    v = low
    a = 0.0
    j = 0.0
    gone = 0.0
    lasts, s = phase(0, rise, L1, L2, L3)

    t = 0.0  # in the phase, where the piece begins
    while True:
        far = (begin[p + 1] - u) if way > 0 else (u - begin[p])
        # acceleration and jerk of u where the piece begins, then the largest until it ends
        a_most = a + t * (j + 0.5 * t * s)
        j_most = abs(j + t * s)
        s_most = abs(s)
        v_most = low + rise
        over = False
        while True:
            step = lasts * (v + lasts * (0.5 * a + lasts * (j / 6.0 + lasts * s / 24.0)))
            if gone + step >= far and far < whole:
                t = when(far - gone, v, a, j, s, t, lasts)
                break
            if number == 6:
                over = True
                t = lasts
                break
            gone = gone + step
            v = v + lasts * (a + lasts * (0.5 * j + lasts * s / 6.0))
            a = a + lasts * (j + 0.5 * lasts * s)
            number = number + 1
            j = jerk_before(number, jerk)
            lasts, s = phase(number, rise, L1, L2, L3)
            lasts = max(lasts, 0.0)
            t = 0.0
            a_most = max(a_most, a)
            j_most = max(j_most, abs(j))
            s_most = max(s_most, abs(s))
        a_most = max(a_most, a + t * (j + 0.5 * t * s))
        if not over:
            v_most = v + t * (a + t * (0.5 * j + t * s / 6.0))
            j_most = max(j_most, abs(j + t * s))
        if not _fits_piece(
            most[p], caps[p, 0], caps[p, 1], limits,
            min(low + rise, v_most * (1.0 + 1e-12)), a_most * (1.0 + 1e-12), j_most * (1.0 + 1e-12),
            s_most * (1.0 + 1e-12), free,
        ):  # fmt: skip
            return False
        if over or p + way < 0 or p + way >= len(most):
            return True
        p = p + way


@kernel
def fit(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2,
    u: float, first: int, way: int, end: float, low: float, high: float, free: bool,
) -> tuple[bool, float, float, float]:  # fmt: skip
    """The quickest ramp found from `low` at u to `high`, within what every piece that it crosses leaves.

    `way` is 1 towards greater u and -1 towards smaller u, along which the speed rises; `first` is the piece it starts
    on, `end` the last u it may reach.  False if there is none.  A free ramp may be quicker than the caps of pieces,
    which then leave it what they leave at their cap for crossing: it shows where caps bind.

    The shape of the ramp is that of the limits on the pieces it may cross, as if they were straight; it is made slower
    until it holds.
    """
    rise = high - low
    if rise <= 1e-14 * high:
        return True, 0.0, 0.0, 0.0
    space = (end - u) * way
    a_limit = 1e300
    j_limit = 1e300
    s_limit = 1e300
    for i in range(len(limits)):
        m1 = most[first, i, 0]
        if m1 > 0.0:
            a_limit = min(a_limit, limits[i, 1] / m1)
            j_limit = min(j_limit, limits[i, 2] / m1)
            s_limit = min(s_limit, limits[i, 3] / m1)
    L1, L2, L3 = boxcars(rise, a_limit, j_limit, s_limit)
    slowest = space / ((low + 0.5 * rise) * (L1 + L2 + L3))
    if slowest < 0.5:
        return False, 0.0, 0.0, 0.0
    slow = min(slowest, 1.0 + 1e-9)
    quick = 0.5 * slow
    # slower by steps until it holds, then between
    while not holds(begin, most, caps, limits, u, first, way, low, rise, slow * L1, slow * L2, slow * L3, free):
        if slow >= slowest or slow > 1e6:
            return False, 0.0, 0.0, 0.0
        quick = slow
        slow = min(slowest, 1.6 * slow)
    for _ in range(_HALVINGS):
        scale = sqrt(slow * quick)
        if holds(begin, most, caps, limits, u, first, way, low, rise, scale * L1, scale * L2, scale * L3, free):
            slow = scale
        else:
            quick = scale
    return True, slow * L1, slow * L2, slow * L3
