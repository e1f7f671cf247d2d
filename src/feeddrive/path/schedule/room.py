"""What a piece of path leaves for the speed: bounds of r' .. r'''' and caps.

With M_k = max |r_i^(k)| on a piece and speed, acceleration, jerk and snap of u up to v, A, J, S:

    |q'| <= M1 v,  |q''| <= M2 v² + M1 A,  |q'''| <= M3 v³ + 3 M2 v A + M1 J
    |q''''| <= M4 v⁴ + 6 M3 v² A + M2 (3 A² + 4 v J) + M1 S
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints

# a bound is sure to be one after rounding
_ABOVE = 1.0 + 1e-13
_LEVEL = 1.001  # ratio of caps of neighbors that get the same one


@kernel
def bounds(kind: int, length: float, shape: Floats2, out: Floats2) -> float:
    """M1 .. M4 of each axis into `out` (N, 4), and a bound of |r'|.

    Of a polynomial by the points of its Bernstein form, in whose hull it lies; of an arc in closed form.
    """
    n = len(shape)
    norm = 0.0
    if kind == 0:
        for i in range(n):
            slope = shape[i, 1] / length
            norm = norm + slope * slope
            out[i, 0] = abs(slope)
            for k in range(1, 4):
                out[i, k] = 0.0
        return sqrt(norm) * _ABOVE
    if kind == 1:
        kappa = shape[0, 3]
        size1 = 0.0
        size2 = 0.0
        skew = 0.0
        along1 = 0.0
        along2 = 0.0
        for i in range(n):
            e1 = shape[i, 0]
            e2 = shape[i, 1]
            drift = shape[i, 2]
            big = sqrt(e1 * e1 + e2 * e2) * _ABOVE
            out[i, 0] = big * kappa + abs(drift)
            out[i, 1] = big * kappa * kappa
            out[i, 2] = out[i, 1] * kappa
            out[i, 3] = out[i, 2] * kappa
            size1 = size1 + e1 * e1
            size2 = size2 + e2 * e2
            skew = skew + e1 * e2
            along1 = along1 + e1 * drift
            along2 = along2 + e2 * drift
            norm = norm + drift * drift
        oval = size1 - size2
        ring = 0.5 * (size1 + size2 + sqrt(oval * oval + 4.0 * skew * skew))
        return sqrt(kappa * kappa * ring + 2.0 * kappa * sqrt(along1 * along1 + along2 * along2) + norm) * _ABOVE
    points = zeros(8)
    norms = zeros(8)
    scale = 1.0
    for m in range(1, 5):
        scale = scale / length
        degree = 7 - m
        for i in range(n):
            # coefficients of the derivative over the binomials, then differences backwards: Bernstein points
            for k in range(degree + 1):
                value = shape[i, k + m]
                for j in range(m):
                    value = value * (k + m - j)
                for j in range(k):
                    value = value * (j + 1) / (degree - j)
                points[k] = value
            most = 0.0
            for k in range(degree):
                for back in range(degree - k):
                    j = degree - back
                    points[j] = points[j] + points[j - 1]
            for k in range(degree + 1):
                most = max(most, abs(points[k]))
                if m == 1:
                    norms[k] = norms[k] + points[k] * points[k]
            out[i, m - 1] = most * scale * _ABOVE
    for k in range(7):
        norm = max(norm, norms[k])
    return sqrt(norm) / length * _ABOVE


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
def root(value: float, degree: int) -> float:
    """The second, third or fourth root of a positive number."""
    if degree == 2:
        return sqrt(value)
    if degree == 3:
        return cube_root(value)
    return sqrt(sqrt(value))


@kernel
def cap(most: Floats2, norm: float, feed: float, limits: Floats2, share: float) -> float:
    """The speed at which a piece is passed: by the feed, by each velocity, by `share` of what its curvature allows."""
    # |r'| of splines is 1 but for a little: they get the same cap as lines
    speed = feed / norm if norm > 1.0 + 1e-10 else feed
    for i in range(len(limits)):
        if most[i, 0] > 0.0:
            speed = min(speed, limits[i, 0] / most[i, 0])
        for k in range(1, 4):
            if most[i, k] > 0.0:
                ratio = limits[i, k] / most[i, k]
                if ratio < 1e36:
                    speed = min(speed, share * root(ratio, k + 1))
    return speed * (1.0 - 1e-12)


@kernel
def pieces_room(
    kind: Ints, length: Floats, shape: Floats3, feed: Floats, limits: Floats2, cruise: float, crossing: float,
    most: Floats3, caps: Floats2,
) -> int:  # fmt: skip
    """`bounds` of n pieces into `most` (n, N, 4); their caps when held and when crossed by ramps into `caps` (n, 2).

    Neighbors whose caps differ by rounding or nearly so get the lowest of them: no ramps between such.
    """
    for p in range(len(length)):
        norm = bounds(kind[p], length[p], shape[p], most[p])
        caps[p, 0] = cap(most[p], norm, feed[p], limits, cruise)
        caps[p, 1] = cap(most[p], norm, feed[p], limits, crossing)
    first = 0
    low = 0.0
    high = 0.0
    for p in range(len(length) + 1):
        if p < len(length):
            speed = caps[p, 0]
            if p > first and max(high, speed) <= _LEVEL * min(low, speed):
                low = min(low, speed)
                high = max(high, speed)
                continue
        for k in range(first, p):
            caps[k, 0] = low
            caps[k, 1] = min(low, caps[k, 1])
        first = p
        low = caps[p, 0] if p < len(length) else 0.0
        high = low
    return 0
