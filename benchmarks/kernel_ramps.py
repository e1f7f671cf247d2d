"""Ramps and polynomials for the planner of this benchmark, which is written in C by hand, too.

A ramp leads from one speed to another; at its ends acceleration and jerk are zero.  See `feeddrive.path.schedule.ramp`.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2
from feeddrive.path.schedule.ramp import boxcars

_STEPS = 60  # of Newton's method, which ends earlier


@kernel
def ramp_distance(start: float, end: float, acceleration: float, jerk: float, snap: float) -> float:
    """What the shortest ramp between two speeds travels."""
    first, second, third = boxcars(end - start, acceleration, jerk, snap)
    return 0.5 * (start + end) * (first + second + third)


@kernel
def ramp_pieces(
    time: float,
    position: float,
    start: float,
    end: float,
    acceleration: float,
    jerk: float,
    snap: float,
    times: Floats,
    pieces: Floats2,
    count: int,
) -> tuple[int, float, float]:
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
def piece_at(times: Floats, count: int, time: float, first: int) -> int:
    """The last piece, from `first` on, that begins at or before an instant; `first` if none does.

    Ascending instants are found in few steps: the search doubles its stride before it halves it.
    """
    low, stride = first, 1
    while low + stride < count and times[low + stride] <= time:
        low, stride = low + stride, 2 * stride
    high = min(low + stride, count)
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= time:
            low = middle
        else:
            high = middle
    return low


@kernel
def derivative(coefficients: Floats, order: int, t: float) -> float:
    """A derivative of a polynomial, by Horner's rule: coefficients of degree 0, 1, ..."""
    value = 0.0
    for k in range(len(coefficients) - 1, order - 1, -1):
        factor = 1.0
        for m in range(order):
            factor *= k - m
        value = value * t + factor * coefficients[k]
    return value


@kernel
def evaluate(times: Floats, pieces: Floats2, count: int, at: Floats, values: Floats2) -> None:
    """Value and derivatives, one a column of `values`, of the first `count` pieces at ascending instants.

    Before the first piece and behind the last one their polynomials go on. Instants that do not ascend are an error.
    """
    place, last = 0, at[0] if len(at) > 0 else 0.0
    for k in range(len(at)):
        if at[k] < last:
            raise ValueError("instants must ascend: sort them")
        last = at[k]
        place = piece_at(times, count, last, place)
        row, coefficients = values[k], pieces[place]
        for order in range(len(row)):
            row[order] = derivative(coefficients, order, last - times[place])
