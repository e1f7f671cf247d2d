"""Ranges of the derivatives of a path, of a motion along it, and of what each axis then does.

    q'    = r' u'
    q''   = r'' u'² + r' u''
    q'''  = r''' u'³ + 3 r'' u' u'' + r' u'''
    q'''' = r'''' u'⁴ + 6 r''' u'² u'' + r'' (3 u''² + 4 u' u''') + r' u''''

with q = r(u(t)).  Polynomials of time have exact extremes; r' .. r'''' have Taylor forms about the middle of a span.
Rounding is not directed: what is summed here gets a slack of its largest term, which covers it.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3
from feeddrive.path.motion import cubic, turned


@kernel
def times(a: float, b: float, c: float, d: float) -> tuple[float, float]:
    """Return [a, b] · [c, d]."""
    p = a * c
    q = a * d
    r = b * c
    s = b * d
    return min(min(p, q), min(r, s)), max(max(p, q), max(r, s))


@kernel
def square(a: float, b: float) -> tuple[float, float]:
    """Return [a, b]²."""
    p = a * a
    q = b * b
    if a <= 0.0 and b >= 0.0:
        return 0.0, max(p, q)
    return min(p, q), max(p, q)


@kernel
def line_range(a: float, b: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the range of a + b t."""
    p = a + b * t0
    q = a + b * t1
    return min(p, q), max(p, q)


@kernel
def parabola_range(a: float, b: float, c: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the range of a + b t + c t²/2."""
    p = a + t0 * (b + 0.5 * c * t0)
    q = a + t1 * (b + 0.5 * c * t1)
    low = min(p, q)
    high = max(p, q)
    if c != 0.0:
        t = -b / c
        if t > t0 and t < t1:
            p = a + t * (b + 0.5 * c * t)
            low = min(low, p)
            high = max(high, p)
    return low, high


@kernel
def cubic_range(a: float, b: float, c: float, d: float, t0: float, t1: float) -> tuple[float, float]:
    """Return the range of a + b t + c t²/2 + d t³/6: its ends, and where its slope b + c t + d t²/2 is 0."""
    p = cubic(a, b, c, d, t0)
    q = cubic(a, b, c, d, t1)
    low = min(p, q)
    high = max(p, q)
    root = c * c - 2.0 * b * d
    if root >= 0.0:
        # the root that does not cancel, and the other one from their product
        h = -(c + sqrt(root)) if c >= 0.0 else -(c - sqrt(root))
        if d != 0.0:
            t = h / d
            if t > t0 and t < t1:
                p = cubic(a, b, c, d, t)
                low = min(low, p)
                high = max(high, p)
        if h != 0.0:
            t = 2.0 * b / h
            if t > t0 and t < t1:
                p = cubic(a, b, c, d, t)
                low = min(low, p)
                high = max(high, p)
    return low, high


@kernel
def slopes(kind: int, length: float, shape: Floats2, x0: float, x1: float, out: Floats3) -> float:
    """Bound |r'| over [x0, x1]; write the intervals of r' .. r'''' by Taylor forms about its middle in out[i, k-1]."""
    middle = 0.5 * (x0 + x1)
    radius = 0.5 * (x1 - x0)
    n = len(shape)
    norm = 0.0
    if kind == 0:
        for i in range(n):
            slope = shape[i, 1] / length
            norm = norm + slope * slope
            for k in range(4):
                out[i, k, 0] = slope
                out[i, k, 1] = slope
                slope = 0.0
        return sqrt(norm)
    if kind == 1:
        kappa = shape[0, 3]
        s, versine = turned(kappa * middle)
        c = 1.0 - versine
        most = kappa * radius
        # |r'|² = κ² |E2 cos θ - E1 sin θ|² + 2 κ (E2 cos θ - E1 sin θ) · slope + |slope|²
        length1 = 0.0
        length2 = 0.0
        skew = 0.0
        along1 = 0.0
        along2 = 0.0
        for i in range(n):
            e1 = shape[i, 0]
            e2 = shape[i, 1]
            drift = shape[i, 2]
            length1 = length1 + e1 * e1
            length2 = length2 + e2 * e2
            skew = skew + e1 * e2
            along1 = along1 + e1 * drift
            along2 = along2 + e2 * drift
            norm = norm + drift * drift
            big = sqrt(e1 * e1 + e2 * e2)
            rest = 0.5 * big * most * most  # the second term of each Taylor form, by the amplitude
            value = e2 * c - e1 * s
            slope = -(e1 * c + e2 * s)
            scale = kappa
            for k in range(4):
                half = abs(slope) * most + rest
                out[i, k, 0] = max(value - half, -big) * scale
                out[i, k, 1] = min(value + half, big) * scale
                value, slope = slope, -value
                scale = scale * kappa
            out[i, 0, 0] = out[i, 0, 0] + drift
            out[i, 0, 1] = out[i, 0, 1] + drift
        oval = length1 - length2
        ring = 0.5 * (length1 + length2 + sqrt(oval * oval + 4.0 * skew * skew))
        return sqrt(kappa * kappa * ring + 2.0 * kappa * sqrt(along1 * along1 + along2 * along2) + norm)
    xi = middle / length
    rho = radius / length
    tilt = 0.0
    bend = 0.0
    scale1 = 1.0 / length
    scale2 = scale1 / length
    scale3 = scale2 / length
    scale4 = scale3 / length
    for i in range(n):
        # Taylor coefficients about the middle, by repeated synthetic division
        _, c1, c2, c3, c4, c5, c6, c7 = shape[i]
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c2 = c2 + xi * c3
        c1 = c1 + xi * c2
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c2 = c2 + xi * c3
        c1 = c1 + xi * c2
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c2 = c2 + xi * c3
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c3 = c3 + xi * c4
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c4 = c4 + xi * c5
        c6 = c6 + xi * c7
        c5 = c5 + xi * c6
        c6 = c6 + xi * c7
        # r^(m)(middle + δ) = Σ_k k!/(k-m)! c_k δ^(k-m) / length^m
        s2, s3, s4, s5, s6, s7 = abs(c2), abs(c3), abs(c4), abs(c5), abs(c6), abs(c7)
        half = (((7.0 * s7 * rho + 6.0 * s6) * rho + 5.0 * s5) * rho + 4.0 * s4) * rho
        half = ((half + 3.0 * s3) * rho + 2.0 * s2) * rho
        out[i, 0] = (c1 - half) * scale1, (c1 + half) * scale1
        half = ((((42.0 * s7 * rho + 30.0 * s6) * rho + 20.0 * s5) * rho + 12.0 * s4) * rho + 6.0 * s3) * rho
        out[i, 1] = (2.0 * c2 - half) * scale2, (2.0 * c2 + half) * scale2
        half = (((210.0 * s7 * rho + 120.0 * s6) * rho + 60.0 * s5) * rho + 24.0 * s4) * rho
        out[i, 2] = (6.0 * c3 - half) * scale3, (6.0 * c3 + half) * scale3
        half = ((840.0 * s7 * rho + 360.0 * s6) * rho + 120.0 * s5) * rho
        out[i, 3] = (24.0 * c4 - half) * scale4, (24.0 * c4 + half) * scale4
        # |r'|² about the middle: value, slope, and a bound of half the second derivative
        p = max(-out[i, 0, 0], out[i, 0, 1])
        q = max(-out[i, 1, 0], out[i, 1, 1])
        norm = norm + c1 * c1
        tilt = tilt + 4.0 * c1 * c2
        bend = bend + q * q + p * max(-out[i, 2, 0], out[i, 2, 1])
    norm = (norm + abs(tilt) * rho) / (length * length)
    return sqrt(norm + bend * radius * radius)


@kernel
def products(v0: float, v1: float, a0: float, a1: float, j0: float, j1: float, u: Floats2) -> int:
    """Write the ranges of u', u'², u'³, u'⁴, u'', u' u'', u'² u'', u''' and 3 u''² + 4 u' u''' into the rows of `u`."""
    u[0] = v0, v1
    b, c = square(v0, v1)
    u[1] = b, c
    p, q = times(v0, v1, b, c)
    u[2] = p, q
    p, q = square(b, c)
    u[3] = p, q
    u[4] = a0, a1
    p, q = times(v0, v1, a0, a1)
    u[5] = p, q
    p, q = times(b, c, a0, a1)
    u[6] = p, q
    u[7] = j0, j1
    p, q = times(v0, v1, j0, j1)
    b, c = square(a0, a1)
    u[8] = 3.0 * b + 4.0 * p, 3.0 * c + 4.0 * q
    return 0


@kernel
def add_product(r0: float, r1: float, u0: float, u1: float, out: Floats) -> int:
    """Add [r0, r1] · [u0, u1] to the interval in `out`, and its size to that of the largest term there."""
    low, high = times(r0, r1, u0, u1)
    out[0] = out[0] + low
    out[1] = out[1] + high
    out[2] = max(out[2], max(-low, high))
    return 0


@kernel
def add_ranges(u: Floats2, s: float, r: Floats2, middle: float, out: Floats2) -> int:
    """Add q' .. q'''' of one axis to the rows of `out`: low, high and the size of the largest term.

    The products are in `u`, r' .. r'''' in the rows of `r`; of r' only what it differs from `middle` is taken.
    """
    low = r[0, 0] - middle
    high = r[0, 1] - middle
    add_product(low, high, u[0, 0], u[0, 1], out[0])
    add_product(r[1, 0], r[1, 1], u[1, 0], u[1, 1], out[1])
    add_product(low, high, u[4, 0], u[4, 1], out[1])
    add_product(r[2, 0], r[2, 1], u[2, 0], u[2, 1], out[2])
    add_product(r[1, 0], r[1, 1], 3.0 * u[5, 0], 3.0 * u[5, 1], out[2])
    add_product(low, high, u[7, 0], u[7, 1], out[2])
    add_product(r[3, 0], r[3, 1], u[3, 0], u[3, 1], out[3])
    add_product(r[2, 0], r[2, 1], 6.0 * u[6, 0], 6.0 * u[6, 1], out[3])
    add_product(r[1, 0], r[1, 1], u[8, 0], u[8, 1], out[3])
    add_product(low, high, s, s, out[3])
    return 0


@kernel
def largest_share(out: Floats2, limits: Floats, slack: float) -> tuple[float, int]:
    """Return the largest share of a limit of one axis that the intervals of `add_ranges` allow, and its derivative."""
    most = 0.0
    where = 0
    for k in range(4):
        share = (max(-out[k, 0], out[k, 1]) + slack * out[k, 2]) / limits[k]
        if share > most:
            most = share
            where = k
    return most, where


@kernel
def _stands(r: Floats2) -> bool:
    """True if an axis does not move."""
    most = 0.0
    for k in range(4):
        most = max(most, max(abs(r[k, 0]), abs(r[k, 1])))
    return most == 0.0


@kernel
def share_of_limits(
    v0: float,
    v1: float,
    a0: float,
    a1: float,
    j0: float,
    j1: float,
    s: float,
    r: Floats3,
    norm: float,
    limits: Floats2,
    feed: float,
    slack: float,
) -> tuple[float, int]:
    """Return the largest share of a limit that the intervals allow, and which: 4 axis + derivative - 1, or -1 for the
    feed.
    """
    u = zeros(9, 2)
    out = zeros(4, 3)
    most = norm * max(-v0, v1) * (1.0 + slack) / feed
    where = -1
    products(v0, v1, a0, a1, j0, j1, u)
    for i in range(len(limits)):
        if _stands(r[i]):
            continue
        for k in range(4):
            out[k] = 0.0, 0.0, 0.0
        add_ranges(u, s, r[i], 0.0, out)
        share, k = largest_share(out, limits[i], slack)
        if share > most:
            most = share
            where = 4 * i + k
    return most, where
