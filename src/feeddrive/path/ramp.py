"""Ramps of speed under limits of acceleration, jerk and snap: a step of speed, smoothed by three boxcars.

Kernels, for any unit of length and seconds. A ramp leads from one node to another; at a node acceleration and jerk are
zero. With boxcars of the widths L1 <= L2 and L1 + L2 <= L3 (s) and a step of speed dv:

    snap = dv / (L1 L2 L3),  jerk = snap L1,  acceleration = jerk L2,  duration = L1 + L2 + L3
    distance = (v0 + v1) (L1 + L2 + L3) / 2

Source: Lambrechts, Boerlage & Steinbuch 2005, whose fourth-order profile is two such ramps.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2

_STEPS = 60  # of Newton's method, which ends earlier


@kernel
def cube_root(x: float) -> float:
    """The cube root of x >= 0, within two units of the last place."""
    if x < 0.0:
        raise ValueError("the cube root is taken of numbers from 0 on")
    if x == 0.0 or x - x != 0.0:
        return x
    rest, scale = x, 1.0
    while rest >= 1.0:
        rest, scale = rest * 0.125, scale * 2.0
    while rest < 0.125:
        rest, scale = rest * 8.0, scale * 0.5
    root = 0.4 + 0.6 * rest
    for _ in range(5):
        root -= (root - rest / (root * root)) / 3.0
    return root * scale


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
def ramp_distance(start: float, end: float, acceleration: float, jerk: float, snap: float) -> float:
    """What the shortest ramp between two speeds travels."""
    first, second, third = boxcars(end - start, acceleration, jerk, snap)
    return 0.5 * (start + end) * (first + second + third)


@kernel
def ramp_pieces(
    time: float, position: float, start: float, end: float, acceleration: float, jerk: float, snap: float,
    times: Floats, pieces: Floats2, count: int,
) -> tuple[int, float, float]:  # fmt: skip
    """Appends the shortest ramp as up to seven pieces of constant snap; gives their count, its last time and position.

    times   when each piece begins, s
    pieces  position in the time since then: coefficients of degree 0 to 4
    """
    first, second, third = boxcars(end - start, acceleration, jerk, snap)
    if third == 0.0:
        return count, time, position
    height = (end - start) / (first * second * third)
    x, v, a, j = position, start, 0.0, 0.0
    for phase in range(7):
        sign, duration = 0.0, first
        if phase == 0 or phase == 6:
            sign = 1.0
        elif phase == 2 or phase == 4:
            sign = -1.0
        elif phase == 3:
            duration = third - second - first
        else:
            duration = second - first
        if duration > 0.0:
            s, t = sign * height, duration
            times[count] = time
            pieces[count] = x, v, a / 2.0, j / 6.0, s / 24.0
            count += 1
            x += t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0))))
            v += t * (a + t * (j / 2.0 + t * (s / 6.0)))
            a += t * (j + t * (s / 2.0))
            j += t * s
            time += t
    return count, time, position + 0.5 * (start + end) * (first + second + third)


@kernel
def endless_speed(start: float, distance: float, acceleration: float, jerk: float, snap: float) -> float:
    """Speed at a distance behind a node that is passed at speed `start`, on a ramp that never ends.

    No ramp from that node is faster there, whatever speed it leads to. Rounded up: Newton's method comes from above,
    since the travelled way is convex in time.
    """
    if distance <= 0.0:
        return start
    first = min(jerk / snap, sqrt(acceleration / snap))
    second = max(first, acceleration / (snap * first))
    x, v, a, j = 0.0, start, 0.0, 0.0
    for phase in range(3):
        s = snap * (1.0 - phase)
        t = second - first if phase == 1 else first
        way = x + t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0))))
        speed = v + t * (a + t * (j / 2.0 + t * (s / 6.0)))
        if way >= distance:
            for _ in range(_STEPS):
                less = (way - distance) / speed
                if not less > 1e-15 * t:
                    break
                t -= less
                way = x + t * (v + t * (a / 2.0 + t * (j / 6.0 + t * (s / 24.0))))
                speed = v + t * (a + t * (j / 2.0 + t * (s / 6.0)))
            return speed
        x, v, a, j = way, speed, a + t * (j + t * (s / 2.0)), j + t * s
    return sqrt(v * v + 2.0 * a * (distance - x))


@kernel
def stays_below(cap: float, start: float, distance: float, acceleration: float, jerk: float, snap: float) -> bool:
    """Whether every ramp that begins at speed `start` is below a cap of speed until a distance is travelled."""
    return endless_speed(start, distance, acceleration, jerk, snap) < cap
