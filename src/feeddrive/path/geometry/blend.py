"""A joint of two segments, rounded by a polynomial of seventh degree that meets both with three derivatives.

At the way L before the joint and L behind it the states r, r', r'', r''' of the segments are taken relative to the
joint, and joined over a parameter length B = L (1.4 + 0.3 (1 + t0·t1)), t0 and t1 the directions at the joint.  The
distance to the segments is bounded, not sampled: both are polynomials of the same parameter (an arc is one within
R (φ/2)⁸/8!), and the Bernstein points of their difference hold it in their hull.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.path.motion import derivatives, turned

_PARTS = 4  # of each half of a blend, whose hulls are taken one by one
_SEARCH = 30
_SAME = 1e-12  # of r' .. r''' times the length, next to a spline and between arcs


@kernel
def state_near(kind: int, length: float, shape: Floats2, away: float, at_end: bool, out: Floats2) -> int:
    """Write r relative to the end or the start of a segment, and r', r'', r''' at the distance `away` from there, into
    `out`.

    `out` has the shape (N, 4); a positive `away` is forwards.
    """
    if kind == 0:
        for i in range(len(shape)):
            slope = shape[i, 1] / length
            out[i, 0] = away * slope
            out[i, 1] = slope
            out[i, 2] = 0.0
            out[i, 3] = 0.0
        return 0
    kappa = shape[0, 3]
    s0, v0 = turned(kappa * length if at_end else 0.0)
    c0 = 1.0 - v0
    s, v = turned(kappa * away)
    c = 1.0 - v
    for i in range(len(shape)):
        e1 = shape[i, 0] * c0 + shape[i, 1] * s0
        e2 = shape[i, 1] * c0 - shape[i, 0] * s0
        cosine = e2 * c - e1 * s
        sine = e1 * c + e2 * s
        out[i, 0] = e2 * s - e1 * v + shape[i, 2] * away
        out[i, 1] = kappa * cosine + shape[i, 2]
        out[i, 2] = -kappa * kappa * sine
        out[i, 3] = -kappa * kappa * kappa * cosine
    return 0


@kernel
def trimmed(kind: int, length: float, shape: Floats2, x0: float, x1: float, out: Floats2) -> float:
    """Write the part of a segment between two places into `out`; return its length."""
    rest = x1 - x0
    if kind == 0:
        for i in range(len(shape)):
            for k in range(8):
                out[i, k] = 0.0
            out[i, 1] = shape[i, 1] / length * rest
        return rest
    if kind == 2:  # whole
        for i in range(len(shape)):
            for k in range(8):
                out[i, k] = shape[i, k]
        return rest
    s, v = turned(shape[0, 3] * x0)
    c = 1.0 - v
    for i in range(len(shape)):
        for k in range(8):
            out[i, k] = 0.0
        out[i, 0] = shape[i, 0] * c + shape[i, 1] * s
        out[i, 1] = shape[i, 1] * c - shape[i, 0] * s
        out[i, 2] = shape[i, 2]
        out[i, 3] = shape[0, 3]
    return rest


@kernel
def hermite(a: Floats2, b: Floats2, length: float, out: Floats2) -> int:
    """Write the coefficients of the polynomial in ξ = x/length between two states r .. r''' (N, 4) into `out` (N, 8).

    Those of first to third degree are the left state, the others its residual at the right one.
    """
    for i in range(len(a)):
        c1 = a[i, 1] * length
        c2 = 0.5 * a[i, 2] * length * length
        c3 = a[i, 3] * length * length * length / 6.0
        e0 = b[i, 0] - a[i, 0] - c1 - c2 - c3
        e1 = b[i, 1] * length - c1 - 2.0 * c2 - 3.0 * c3
        e2 = b[i, 2] * length * length - 2.0 * c2 - 6.0 * c3
        e3 = b[i, 3] * length * length * length - 6.0 * c3
        out[i, 0] = 0.0
        out[i, 1] = c1
        out[i, 2] = c2
        out[i, 3] = c3
        out[i, 4] = 35.0 * e0 - 15.0 * e1 + 2.5 * e2 - e3 / 6.0
        out[i, 5] = -84.0 * e0 + 39.0 * e1 - 7.0 * e2 + 0.5 * e3
        out[i, 6] = 70.0 * e0 - 34.0 * e1 + 6.5 * e2 - 0.5 * e3
        out[i, 7] = -20.0 * e0 + 10.0 * e1 - 2.0 * e2 + e3 / 6.0
    return 0


@kernel
def part_of(c: Floats, begin: float, size: float, out: Floats) -> int:
    """Return the coefficients in η of Σ c_k ξᵏ with ξ = begin + size η: a Taylor shift, including the constant term."""
    for k in range(8):
        out[k] = c[k]
    for k in range(7):
        for back in range(7 - k):
            j = 6 - back
            out[j] = out[j] + begin * out[j + 1]
    scale = 1.0
    for k in range(8):
        out[k] = out[k] * scale
        scale = scale * size
    return 0


@kernel
def largest_norm(c: Floats2) -> float:
    """Bound |Σ c_k ξᵏ| on 0 <= ξ <= 1: the largest norm of its Bernstein points."""
    norms = zeros(8)
    points = zeros(8)
    for i in range(len(c)):
        choices = 1.0
        for k in range(8):
            points[k] = c[i, k] / choices
            choices = choices * (7 - k) / (k + 1)
        for k in range(7):
            for back in range(7 - k):
                j = 7 - back
                points[j] = points[j] + points[j - 1]
        for k in range(8):
            norms[k] = norms[k] + points[k] * points[k]
    most = 0.0
    for k in range(8):
        most = max(most, norms[k])
    return sqrt(most)


@kernel
def blend_at(
    kind0: int,
    length0: float,
    shape0: Floats2,
    kind1: int,
    length1: float,
    shape1: Floats2,
    L: float,
    factor: float,
    a: Floats2,
    b: Floats2,
    at: Floats2,
    half: Floats2,
    difference: Floats2,
    out: Floats2,
) -> float:
    """Write the blend that begins L before a joint into `out` (N, 8); return a bound of its distance to the segments,
    m.
    """
    n = len(shape0)
    B = factor * L
    state_near(kind0, length0, shape0, -L, True, a)
    state_near(kind1, length1, shape1, L, False, b)
    hermite(a, b, B, out)
    most = 0.0
    for side in range(2):
        # the segment over its half of the parameter, as a polynomial of η in 0 .. 1
        arc = 0.0
        if side == 0:
            state_near(kind0, length0, shape0, 0.0, True, at)
            hermite(a, at, L, half)
            if kind0 == 1:
                arc = shape0[0, 3]
        else:
            state_near(kind1, length1, shape1, 0.0, False, at)
            hermite(at, b, L, half)
            if kind1 == 1:
                arc = shape1[0, 3]
        radius = 0.0
        for i in range(n):
            e = shape0[i, 0] if side == 0 else shape1[i, 0]
            radius = radius + e * e
        error = 0.0
        if arc > 0.0:
            angle = 0.5 * arc * L
            error = angle * angle
            error = error * error
            error = sqrt(radius) * error * error / 40320.0
        # r relative to the joint: the polynomials above leave out their first value
        for part in range(_PARTS):
            size = 1.0 / _PARTS
            for i in range(n):
                start = a[i, 0] if side == 0 else 0.0
                part_of(half[i], part * size, size, at[i])
                at[i, 0] = at[i, 0] + start
                part_of(out[i], 0.5 * side + 0.5 * part * size, 0.5 * size, difference[i])
                difference[i, 0] = difference[i, 0] + a[i, 0]
                for k in range(8):
                    difference[i, k] = difference[i, k] - at[i, k]
            most = max(most, largest_norm(difference) + error)
    return most


@kernel
def blend(
    kind0: int,
    length0: float,
    shape0: Floats2,
    kind1: int,
    length1: float,
    shape1: Floats2,
    cosine: float,
    longest: float,
    tolerance: float,
    straight: bool,
    a: Floats2,
    b: Floats2,
    at: Floats2,
    half: Floats2,
    difference: Floats2,
    out: Floats2,
) -> tuple[float, float, float]:
    """Return L, B and the distance bound of the longest blend up to `longest` that is proven within `tolerance`; zeros
    if there is none.
    """
    factor = 1.4 + 0.3 * (1.0 + cosine)
    away = longest
    most = blend_at(kind0, length0, shape0, kind1, length1, shape1, away, factor, a, b, at, half, difference, out)
    if most <= tolerance:
        return away, factor * away, most
    low = 0.0
    high = away
    for _ in range(_SEARCH):
        # the distance grows with away at a corner, and with its square where only the curvature jumps
        ratio = 0.999 * tolerance / most
        guess = away * (ratio if straight else sqrt(ratio))
        if guess <= low or guess >= high:
            guess = 0.5 * (low + high)
        away = guess
        most = blend_at(kind0, length0, shape0, kind1, length1, shape1, away, factor, a, b, at, half, difference, out)
        if most <= tolerance:
            low = away
            if most >= 0.995 * tolerance:
                break
        else:
            high = away
        if high - low <= 1e-4 * high:
            break
    if low == 0.0:
        return 0.0, 0.0, 0.0
    if low != away:
        away = low
        most = blend_at(kind0, length0, shape0, kind1, length1, shape1, away, factor, a, b, at, half, difference, out)
    return away, factor * away, most


@kernel
def goes_on(k: int, kind: Ints, length: Floats, shape: Floats3, a: Floats2, b: Floats2) -> bool:
    """True if r' .. r''' agree on both sides of the joint behind k, but for rounding."""
    derivatives(kind[k], length[k], shape[k], length[k], a)
    derivatives(kind[k + 1], length[k + 1], shape[k + 1], 0.0, b)
    scale = 1.0
    for m in range(1, 4):
        size = 0.0
        apart = 0.0
        for i in range(len(a)):
            size = max(size, abs(a[i, m]))
            apart = max(apart, abs(a[i, m] - b[i, m]))
        if apart * scale > _SAME * (1.0 + size * scale):
            return False
        scale = scale * length[k]
    return True
