"""Time-optimal z(u) = u'² as a cubic spline under the limits of each axis, by Newton's method with a barrier function.

With r_n the derivatives of an axis and z', z'', z''' those of z with respect to u

    q'   = r1 √z
    q''  = r2 z + r1 z'/2
    q''' = √z (r3 z + 3/2 r2 z' + r1 z''/2)
    q''''= r4 z² + 3 r3 z z' + r2 (3/4 z'² + 2 z z'') + r1 (z' z''/4 + z z'''/2)

A penalty -μ log(1 - g²) is added to the time ∫ du/√z for the utilization g of each limit at each point; μ is reduced
step by step.  The penalty is expanded to second order in g, and g to first order in z, so that each step solves a
positive definite system of half bandwidth three.  A step that violates a limit which was satisfied before is never
accepted.

Spans are the parts of the motion between knots; this module also places the knots, selects the points at which limits
are evaluated, and converts from u back to time.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints, zeros
from feeddrive.path.motion import cubic, derivatives, way
from feeddrive.path.schedule.ramp import bounds, boxcars, cap

_LOOSE = 1.03  # relaxed limit at a violating point, relative to its present share
_TOUCHES = 1.0 - 1e-6  # larger shares are treated as violations: the penalty would be too steep
_INWARDS = 0.3  # least penalty while a limit is violated
_NEARER = 0.1  # least part of the distance to a limit that a step must leave
# a faster fall saves no steps, since these are limited by the boundary and not by the penalty
_FALL = 0.25  # factor of the penalty per step
_HALVINGS = 12  # largest number of halvings of a step
_NOT_FORWARD = 1e300  # share returned where u'² is not positive


@kernel
def basis(knots: Floats, k: int, x: float, out: Floats2) -> int:
    """Write the weights of span k's four coefficients in z .. z''' at x as rows of `out`; knots[k+3] <= x <=
    knots[k+4].
    """
    t1 = knots[k + 1]
    t2 = knots[k + 2]
    t3 = knots[k + 3]
    t4 = knots[k + 4]
    t5 = knots[k + 5]
    t6 = knots[k + 6]
    p = (t4 - x) / (t4 - t3)
    q = (x - t3) / (t4 - t3)
    n0 = (t4 - x) / (t4 - t2) * p
    n1 = (x - t2) / (t4 - t2) * p + (t5 - x) / (t5 - t3) * q
    n2 = (x - t3) / (t5 - t3) * q
    out[0, 0] = (t4 - x) / (t4 - t1) * n0
    out[0, 1] = (x - t1) / (t4 - t1) * n0 + (t5 - x) / (t5 - t2) * n1
    out[0, 2] = (x - t2) / (t5 - t2) * n1 + (t6 - x) / (t6 - t3) * n2
    out[0, 3] = (x - t3) / (t6 - t3) * n2
    a0 = 3.0 / (t4 - t1)
    a1 = 3.0 / (t5 - t2)
    a2 = 3.0 / (t6 - t3)
    out[1, 0] = -a0 * n0
    out[1, 1] = a0 * n0 - a1 * n1
    out[1, 2] = a1 * n1 - a2 * n2
    out[1, 3] = a2 * n2
    b0 = 2.0 / (t4 - t2)
    b1 = 2.0 / (t5 - t3)
    out[2, 0] = p * b0 * a0
    out[2, 1] = -p * b0 * (a0 + a1) + q * b1 * a1
    out[2, 2] = p * b0 * a1 - q * b1 * (a1 + a2)
    out[2, 3] = q * b1 * a2
    g = 1.0 / (t4 - t3)
    out[3, 0] = -g * b0 * a0
    out[3, 1] = g * (b1 * a1 + b0 * (a0 + a1))
    out[3, 2] = -g * (b1 * (a1 + a2) + b0 * a1)
    out[3, 3] = g * b1 * a2
    return 0


@kernel
def _penalty(g: float, loose: float) -> tuple[float, float]:
    """Return the first and second derivative of -log(1 - (g/loose)²) with respect to g."""
    gap = loose * loose - g * g
    first = 2.0 * g / gap
    return first, 2.0 / gap + first * first


@kernel
def shares(z: Floats, r: Floats2, most: float, full: bool) -> float:
    """Return the largest utilization of a limit at a point; r1 .. r4 are scaled by the limits, see `quickest`."""
    if z[0] <= 0.0:
        return _NOT_FORWARD
    z0, z1, z2, z3 = z
    root = sqrt(z0)
    largest = z0 / most if full else 0.0
    for i in range(len(r)):
        a1, a2, j1, j2, j3, s1, s2, s3, s4 = r[i]
        if full:
            largest = max(largest, abs(a2 * z0 + 0.5 * a1 * z1))
            largest = max(largest, abs(root * (j3 * z0 + 1.5 * j2 * z1 + 0.5 * j1 * z2)))
        snap = s4 * z0 * z0 + 3.0 * s3 * z0 * z1
        snap = snap + s2 * (0.75 * z1 * z1 + 2.0 * z0 * z2)
        largest = max(largest, abs(snap + s1 * (0.25 * z1 * z2 + 0.5 * z0 * z3)))
    return largest


@kernel
def _expanded(
    z: Floats,
    r: Floats2,
    most: float,
    full: bool,
    loose: float,
    weight: float,
    away: float,
    slope: Floats,
    bend: Floats2,
) -> int:
    """Add gradient and Hessian of time and penalties at a point with respect to z .. z'''; `weight` multiplies the
    penalties, and `away` (m) the time.
    """
    z0, z1, z2, z3 = z
    root = sqrt(z0)
    # scalars instead of arrays: lifting takes two thirds of the time, with the same bits
    d0 = -0.5 * away / (z0 * root)
    d1 = 0.0
    d2 = 0.0
    d3 = 0.0
    b00 = 0.75 * away / (z0 * z0 * root)
    b01 = 0.0
    b02 = 0.0
    b03 = 0.0
    b11 = 0.0
    b12 = 0.0
    b13 = 0.0
    b22 = 0.0
    b23 = 0.0
    b33 = 0.0
    if full:
        gap = most * loose - z0
        d0 = d0 + weight / gap
        b00 = b00 + weight / (gap * gap)
    for i in range(len(r)):
        a1, a2, j1, j2, j3, s1, s2, s3, s4 = r[i]
        if a1 == 0.0 and a2 == 0.0 and s3 == 0.0 and s4 == 0.0:
            continue  # the axis does not move
        if full:
            g0 = a2
            g1 = 0.5 * a1
            # second derivatives of g are omitted (Gauss-Newton), so that the Hessian stays positive definite
            first, second = _penalty(g0 * z0 + g1 * z1, loose)
            d0 = d0 + weight * first * g0
            d1 = d1 + weight * first * g1
            h0 = weight * second * g0
            b00 = b00 + h0 * g0
            b01 = b01 + h0 * g1
            b11 = b11 + weight * second * g1 * g1
            inner = j3 * z0 + 1.5 * j2 * z1 + 0.5 * j1 * z2
            g0 = root * j3 + 0.5 * inner / root
            g1 = 1.5 * root * j2
            g2 = 0.5 * root * j1
            first, second = _penalty(root * inner, loose)
            d0 = d0 + weight * first * g0
            d1 = d1 + weight * first * g1
            d2 = d2 + weight * first * g2
            h0 = weight * second * g0
            h1 = weight * second * g1
            b00 = b00 + h0 * g0
            b01 = b01 + h0 * g1
            b02 = b02 + h0 * g2
            b11 = b11 + h1 * g1
            b12 = b12 + h1 * g2
            b22 = b22 + weight * second * g2 * g2
        snap = s4 * z0 * z0 + 3.0 * s3 * z0 * z1
        snap = snap + s2 * (0.75 * z1 * z1 + 2.0 * z0 * z2)
        snap = snap + s1 * (0.25 * z1 * z2 + 0.5 * z0 * z3)
        g0 = 2.0 * s4 * z0 + 3.0 * s3 * z1 + 2.0 * s2 * z2 + 0.5 * s1 * z3
        g1 = 3.0 * s3 * z0 + 1.5 * s2 * z1 + 0.25 * s1 * z2
        g2 = 2.0 * s2 * z0 + 0.25 * s1 * z1
        g3 = 0.5 * s1 * z0
        first, second = _penalty(snap, loose)
        d0 = d0 + weight * first * g0
        d1 = d1 + weight * first * g1
        d2 = d2 + weight * first * g2
        d3 = d3 + weight * first * g3
        h0 = weight * second * g0
        h1 = weight * second * g1
        h2 = weight * second * g2
        b00 = b00 + h0 * g0
        b01 = b01 + h0 * g1
        b02 = b02 + h0 * g2
        b03 = b03 + h0 * g3
        b11 = b11 + h1 * g1
        b12 = b12 + h1 * g2
        b13 = b13 + h1 * g3
        b22 = b22 + h2 * g2
        b23 = b23 + h2 * g3
        b33 = b33 + weight * second * g3 * g3
    slope[0] = d0
    slope[1] = d1
    slope[2] = d2
    slope[3] = d3
    bend[0] = b00, b01, b02, b03
    bend[1] = b01, b11, b12, b13
    bend[2] = b02, b12, b22, b23
    bend[3] = b03, b13, b23, b33
    return 0


@kernel
def at(row: Floats2, coefficient: Floats, k: int, z: Floats) -> int:
    """Evaluate z, z', z'', z''' from the four coefficients of span k and their `basis`."""
    c0 = coefficient[k]
    c1 = coefficient[k + 1]
    c2 = coefficient[k + 2]
    c3 = coefficient[k + 3]
    for m in range(4):
        a, b, c, d = row[m]
        z[m] = a * c0 + b * c1 + c * c2 + d * c3
    return 0


@kernel
def _system(
    span: Ints,
    row: Floats3,
    r: Floats3,
    most: Floats,
    full: Ints,
    loose: Floats,
    weight: Floats,
    away: Floats,
    mu: float,
    coefficient: Floats,
    slope: Floats,
    band: Floats2,
) -> int:
    """Assemble the gradient of time and penalties with respect to the coefficients, and the lower band of the
    Hessian.
    """
    z = zeros(4)
    by = zeros(4)
    bend = zeros(4, 4)
    for c in range(len(coefficient)):
        slope[c] = 0.0
        band[c] = 0.0, 0.0, 0.0, 0.0
    m = len(span)
    p = 0
    while p < m:
        # all points of a span have the same four coefficients
        k = int(span[p])
        s0 = s1 = s2 = s3 = 0.0
        h00 = h10 = h11 = h20 = h21 = h22 = h30 = h31 = h32 = h33 = 0.0
        while p < m and int(span[p]) == k:
            at(row[p], coefficient, k, z)
            _expanded(z, r[p], most[p], full[p] == 1, loose[p], mu * weight[p], away[p], by, bend)
            a0, a1, a2, a3 = row[p, 0]
            b0, b1, b2, b3 = row[p, 1]
            c0, c1, c2, c3 = row[p, 2]
            d0, d1, d2, d3 = row[p, 3]
            t0, t1, t2, t3 = by
            s0 = s0 + t0 * a0 + t1 * b0 + t2 * c0 + t3 * d0
            s1 = s1 + t0 * a1 + t1 * b1 + t2 * c1 + t3 * d1
            s2 = s2 + t0 * a2 + t1 * b2 + t2 * c2 + t3 * d2
            s3 = s3 + t0 * a3 + t1 * b3 + t2 * c3 + t3 * d3
            # the rows of the Hessian by z .. z''' times the basis, then the transposed basis times these
            t0, t1, t2, t3 = bend[0]
            e0 = t0 * a0 + t1 * b0 + t2 * c0 + t3 * d0
            e1 = t0 * a1 + t1 * b1 + t2 * c1 + t3 * d1
            e2 = t0 * a2 + t1 * b2 + t2 * c2 + t3 * d2
            e3 = t0 * a3 + t1 * b3 + t2 * c3 + t3 * d3
            t0, t1, t2, t3 = bend[1]
            f0 = t0 * a0 + t1 * b0 + t2 * c0 + t3 * d0
            f1 = t0 * a1 + t1 * b1 + t2 * c1 + t3 * d1
            f2 = t0 * a2 + t1 * b2 + t2 * c2 + t3 * d2
            f3 = t0 * a3 + t1 * b3 + t2 * c3 + t3 * d3
            t0, t1, t2, t3 = bend[2]
            g0 = t0 * a0 + t1 * b0 + t2 * c0 + t3 * d0
            g1 = t0 * a1 + t1 * b1 + t2 * c1 + t3 * d1
            g2 = t0 * a2 + t1 * b2 + t2 * c2 + t3 * d2
            g3 = t0 * a3 + t1 * b3 + t2 * c3 + t3 * d3
            t0, t1, t2, t3 = bend[3]
            i0 = t0 * a0 + t1 * b0 + t2 * c0 + t3 * d0
            i1 = t0 * a1 + t1 * b1 + t2 * c1 + t3 * d1
            i2 = t0 * a2 + t1 * b2 + t2 * c2 + t3 * d2
            i3 = t0 * a3 + t1 * b3 + t2 * c3 + t3 * d3
            h00 = h00 + a0 * e0 + b0 * f0 + c0 * g0 + d0 * i0
            h10 = h10 + a1 * e0 + b1 * f0 + c1 * g0 + d1 * i0
            h11 = h11 + a1 * e1 + b1 * f1 + c1 * g1 + d1 * i1
            h20 = h20 + a2 * e0 + b2 * f0 + c2 * g0 + d2 * i0
            h21 = h21 + a2 * e1 + b2 * f1 + c2 * g1 + d2 * i1
            h22 = h22 + a2 * e2 + b2 * f2 + c2 * g2 + d2 * i2
            h30 = h30 + a3 * e0 + b3 * f0 + c3 * g0 + d3 * i0
            h31 = h31 + a3 * e1 + b3 * f1 + c3 * g1 + d3 * i1
            h32 = h32 + a3 * e2 + b3 * f2 + c3 * g2 + d3 * i2
            h33 = h33 + a3 * e3 + b3 * f3 + c3 * g3 + d3 * i3
            p = p + 1
        slope[k] = slope[k] + s0
        slope[k + 1] = slope[k + 1] + s1
        slope[k + 2] = slope[k + 2] + s2
        slope[k + 3] = slope[k + 3] + s3
        band[k, 0] = band[k, 0] + h00
        band[k + 1, 0] = band[k + 1, 0] + h11
        band[k + 1, 1] = band[k + 1, 1] + h10
        band[k + 2, 0] = band[k + 2, 0] + h22
        band[k + 2, 1] = band[k + 2, 1] + h21
        band[k + 2, 2] = band[k + 2, 2] + h20
        band[k + 3, 0] = band[k + 3, 0] + h33
        band[k + 3, 1] = band[k + 3, 1] + h32
        band[k + 3, 2] = band[k + 3, 2] + h31
        band[k + 3, 3] = band[k + 3, 3] + h30
    return 0


@kernel
def _solved(band: Floats2, first: int, last: int, slope: Floats, step: Floats) -> bool:
    """Solve band · step = -slope for the coefficients from `first` up to but excluding `last`, by banded Cholesky
    factorization.
    """
    for c in range(first, last):
        for back in range(4):
            d = 3 - back
            if c - d < first:
                continue
            value = band[c, d]
            for e in range(d + 1, 4):
                if c - e >= first:
                    value = value - band[c, e] * band[c - d, e - d]
            if d == 0:
                # the Hessian is positive by construction: only rounding can fail here
                if value <= 0.0:
                    return False
                band[c, 0] = sqrt(value)
            else:
                band[c, d] = value / band[c - d, 0]
    for c in range(first, last):
        value = -slope[c]
        for d in range(1, 4):
            if c - d >= first:
                value = value - band[c, d] * step[c - d]
        step[c] = value / band[c, 0]
    for back in range(last - first):
        c = last - 1 - back
        value = step[c]
        for d in range(1, 4):
            if c + d < last:
                value = value - band[c + d, d] * step[c + d]
        step[c] = value / band[c, 0]
    return True


@kernel
def quickest(
    span: Ints,
    row: Floats3,
    r: Floats3,
    most: Floats,
    full: Ints,
    weight: Floats,
    away: Floats,
    coefficient: Floats,
    penalty: float,
    last: float,
    steps: int,
    share: Floats,
    loose: Floats,
    tried: Floats,
    slope: Floats,
    step: Floats,
    band: Floats2,
) -> int:
    """Optimize the spline for time, in place; return the number of points at which it still violates a limit.

    Three coefficients at each end are fixed.  At a point that violates a limit, this limit is relaxed, and then
    tightened with each step.  If u'² is not initially positive everywhere, nothing is changed and the result is 1.

    span     span index of each point, ascending; `row` is its `basis`
    r        r1 .. r4 of each axis over the limits: (n, N, 9) = r1 r2 for q'', r1 r2 r3 for q''', r1 .. r4 for q''''
    most     largest z that the velocity limits and the feed allow
    full     0 if only q'''' is evaluated
    weight   weight of the penalties at a point, s; `away` is the weight of the time, m
    penalty  initial μ; it is reduced stepwise down to `last`
    """
    z = zeros(4)
    n = len(coefficient)
    above = 0
    for p in range(len(span)):
        at(row[p], coefficient, int(span[p]), z)
        share[p] = shares(z, r[p], most[p], full[p] == 1)
        if share[p] >= _NOT_FORWARD:
            return 1
    for _ in range(steps):
        above = 0
        for p in range(len(span)):
            loose[p] = 1.0 if share[p] < _TOUCHES else _LOOSE * share[p]
            if share[p] >= 1.0:
                above = above + 1
        # violated limits first: with a small penalty the step would go for time and leave them violated
        if above > 0:
            penalty = max(penalty, _INWARDS)
        _system(span, row, r, most, full, loose, weight, away, penalty, coefficient, slope, band)
        if not _solved(band, 3, n - 3, slope, step):
            break
        for p in range(len(span)):
            # keep a distance to the barrier: at the limit itself its slope is infinite and the next step would be tiny
            loose[p] = loose[p] - _NEARER * (loose[p] - share[p])
        far = 1.0
        good = False
        for _ in range(_HALVINGS):
            for c in range(n):
                tried[c] = coefficient[c] + (far * step[c] if c >= 3 and c < n - 3 else 0.0)
            good = True
            for p in range(len(span)):
                at(row[p], tried, int(span[p]), z)
                share[p] = shares(z, r[p], most[p], full[p] == 1)
                if share[p] > loose[p]:
                    good = False
                    break
            if good:
                break
            far = 0.5 * far
        if not good:
            return max(above, 1)
        for c in range(n):
            coefficient[c] = tried[c]
        # lower the penalty only after nearly full steps: before, Newton's method has not converged for this one
        if above == 0 and far > 0.3:
            if penalty <= last:
                break
            penalty = max(last, _FALL * penalty)
    return above


GRADE = 0.1  # largest change of the span duration relative to the duration
_NEAR = 0.998  # usable share of a limit near the ends
POINTS = 2  # number of points of a span per path piece


@kernel
def tops(kind: Ints, length: Floats, shape: Floats3, feed: Floats, limits: Floats2, out: Floats, most: Floats2) -> int:
    """Write the largest u' allowed by feed and velocity limits on each piece into `out`.

    `most` is workspace of shape (N, 4).
    """
    for p in range(len(length)):
        norm = bounds(kind[p], length[p], shape[p], most)
        out[p] = cap(most, norm, feed[p], limits, 1e30)
    return 0


@kernel
def ramp_gain(
    kind: Ints,
    length: Floats,
    shape: Floats3,
    limits: Floats2,
    duration: Floats,
    piece: Ints,
    x: Floats,
    speed: Floats,
    acceleration: Floats,
    jerk: Floats,
    snap: Floats,
    first: int,
    last: int,
    r: Floats2,
) -> float:
    """Return the time, s, that a ramp of time intervals `first` up to but excluding `last` would save if its path were
    straight.

    Between the same speeds a ramp on a line takes L1 + L2 + L3; the line has the direction of the path at either end,
    whichever is more favorable.  The distance saved is covered at the higher speed.  The result is 1e300 for more than
    one ramp.
    """
    lasts = 0.0
    for m in range(first, last):
        if m > first and acceleration[m] == 0.0 and jerk[m] == 0.0:
            return 1e300
        lasts = lasts + duration[m]
    m = last - 1
    v = cubic(speed[m], acceleration[m], jerk[m], snap[m], duration[m])
    rise = abs(v - speed[first])
    p = int(piece[first])
    here = x[first]
    a = 0.0
    j = 0.0
    s = 0.0
    for _ in range(2):
        derivatives(kind[p], length[p], shape[p], min(here, length[p]), r)
        slowest = 1e300
        for i in range(len(limits)):
            if r[i, 1] != 0.0:
                slowest = min(slowest, limits[i, 1] / abs(r[i, 1]))
        a = max(a, slowest)
        slowest = 1e300
        for i in range(len(limits)):
            if r[i, 1] != 0.0:
                slowest = min(slowest, limits[i, 2] / abs(r[i, 1]))
        j = max(j, slowest)
        slowest = 1e300
        for i in range(len(limits)):
            if r[i, 1] != 0.0:
                slowest = min(slowest, limits[i, 3] / abs(r[i, 1]))
        s = max(s, slowest)
        p = int(piece[m])
        here = x[m] + way(speed[m], acceleration[m], jerk[m], snap[m], duration[m])
        while here > length[p] and p + 1 < len(length):
            here = here - length[p]
            p = p + 1
    b, c, d = boxcars(rise, a, j, s)
    return (lasts - b - c - d) * 0.5 * rise / max(v, speed[first])


@kernel
def graded(duration: Floats, edge: Floats) -> int:
    """Shrink the step sizes at the ends of time intervals, s, until neighboring steps differ by at most `GRADE` per
    second.
    """
    n = len(duration)
    for m in range(n):
        edge[m + 1] = min(edge[m + 1], edge[m] + GRADE * duration[m])
    for back in range(n):
        m = n - 1 - back
        edge[m] = min(edge[m], edge[m + 1] + GRADE * duration[m])
    return 0


@kernel
def instants(duration: Floats, step: Floats, edge: Floats, out: Floats) -> int:
    """Write knot times, s, with spacing `step` in each time interval, `edge` at their ends, and graded in between;
    return their number.
    """
    n = len(duration)
    count = 0
    t = 0.0  # in the present piece
    gone = 0.0
    for m in range(n):
        T = duration[m]
        while t < T:
            out[count] = gone + t
            count = count + 1
            # towards the end the spacing h must suit the end of the step: h = edge + GRADE (T - t - h)
            t = t + min(step[m], min(edge[m] + GRADE * t, (edge[m + 1] + GRADE * (T - t)) / (1.0 + GRADE)))
        t = t - T
        gone = gone + T
    # the last one is late by less than a step: all are scaled slightly
    for k in range(count):
        out[k] = out[k] * (gone / (gone + t))
    out[count] = gone
    return count + 1


@kernel
def states(
    duration: Floats,
    piece: Ints,
    x: Floats,
    speed: Floats,
    acceleration: Floats,
    jerk: Floats,
    snap: Floats,
    begin: Floats,
    time: Floats,
    out: Floats2,
) -> int:
    """Evaluate u to u''' of a motion at increasing times; `begin` is u at the start of each path piece."""
    m = 0
    gone = 0.0
    for k in range(len(time)):
        while m + 1 < len(duration) and time[k] >= gone + duration[m]:
            gone = gone + duration[m]
            m = m + 1
        t = time[k] - gone
        v = speed[m]
        a = acceleration[m]
        j = jerk[m]
        s = snap[m]
        out[k, 0] = begin[piece[m]] + x[m] + way(v, a, j, s, t)
        out[k, 1] = cubic(v, a, j, s, t)
        out[k, 2] = a + t * (j + 0.5 * t * s)
        out[k, 3] = j + t * s
    return 0


@kernel
def points(
    kind: Ints,
    length: Floats,
    shape: Floats3,
    begin: Floats,
    top: Floats,
    limits: Floats2,
    shares: Floats,
    knots: Floats,
    time: Floats,
    span: Ints,
    row: Floats3,
    r: Floats3,
    most: Floats,
    full: Ints,
    weight: Floats,
    away: Floats,
    d: Floats2,
) -> int:
    """Write the points that `quickest` evaluates; return their number.

    They are the start and the end of the part of each span that lies on each path piece.

    At the end of a span only the snap is evaluated, which differs from that at the start of the next.

    begin   u at the start of each path piece
    top     largest speed that feed and velocity limits allow on each piece
    shares  usable fractions of the velocity to snap limits; larger near the ends, where the state is given
    time    times of the knots in the present motion, s
    """
    count = 0
    p = 0
    axes = len(limits)
    n = len(time) - 1
    for k in range(n):
        # the given states at the ends use the limits almost fully: smaller shares would be violated from the start
        near = k < 3 or k >= n - 3
        x = knots[k + 3]
        ends = knots[k + 4]
        first = count
        while x < ends:
            while p + 1 < len(length) and begin[p + 1] <= x:
                p = p + 1
            e = min(ends, begin[p + 1]) if p + 1 < len(length) else ends
            for place in range(POINTS):
                here = x if place == 0 else e
                span[count] = k
                basis(knots, k, here, row[count])
                derivatives(kind[p], length[p], shape[p], min(max(here - begin[p], 0.0), length[p]), d)
                most[count] = top[p] * top[p] * (1.0 if near else shares[0] * shares[0])
                a_share = _NEAR if near else shares[1]
                j_share = _NEAR if near else shares[2]
                s_share = _NEAR if near else shares[3]
                full[count] = 1 if place == 0 else 0
                away[count] = 0.5 * (e - x)
                for i in range(axes):
                    for c in range(2):
                        r[count, i, c] = d[i, c + 1] / (limits[i, 1] * a_share)
                    for c in range(3):
                        r[count, i, 2 + c] = d[i, c + 1] / (limits[i, 2] * j_share)
                    for c in range(4):
                        r[count, i, 5 + c] = d[i, c + 1] / (limits[i, 3] * s_share)
                count = count + 1
            x = e
        for c in range(first, count):
            weight[c] = (time[k + 1] - time[k]) / (count - first)
    full[0] = 0  # the state at the start is given
    return count


@kernel
def _bent(first: int, last: int, miss: Floats, duration: Floats, snap: Floats, row: Floats2, system: Floats2) -> int:
    """Apply the smallest change of the snaps of spans `first` up to but excluding `last` that adds `miss` to the
    state at their end.
    """
    whole = 0.0
    for m in range(first, last):
        whole = whole + duration[m]
    for c in range(4):
        for b in range(4):
            system[c, b] = 0.0
    # miss of u''', u'', u', u in units of that time
    system[0, 4] = miss[3] / whole
    system[1, 4] = miss[2] / (whole * whole)
    system[2, 4] = miss[1] / (whole * whole * whole)
    system[3, 4] = miss[0] / (whole * whole * whole * whole)
    left = 1.0
    for m in range(first, last):
        low = max(left - duration[m] / whole, 0.0)
        # a snap from `left` to `low` before the end adds (leftᶜ - lowᶜ) / c!
        p = left
        q = low
        for c in range(4):
            row[m - first, c] = (p - q) / (1.0 if c == 0 else (2.0 if c == 1 else (6.0 if c == 2 else 24.0)))
            p = p * left
            q = q * low
        for c in range(4):
            for b in range(4):
                system[c, b] = system[c, b] + row[m - first, c] * row[m - first, b] / row[m - first, 0]
        left = low
    # symmetric and positive definite: elimination needs no pivoting
    for c in range(4):
        for b in range(c + 1, 4):
            f = system[b, c] / system[c, c]
            for k in range(c, 5):
                system[b, k] = system[b, k] - f * system[c, k]
    for back in range(4):
        c = 3 - back
        for b in range(c + 1, 4):
            system[c, 4] = system[c, 4] - system[c, b] * system[b, 4]
        system[c, 4] = system[c, 4] / system[c, c]
    for m in range(first, last):
        add = 0.0
        for c in range(4):
            add = add + row[m - first, c] * system[c, 4]
        snap[m] = snap[m] + add / row[m - first, 0]
    return 0


@kernel
def in_time(
    knots: Floats,
    coefficient: Floats,
    begin: Floats,
    ends: Floats2,
    together: int,
    duration: Floats,
    piece: Ints,
    x: Floats,
    speed: Floats,
    acceleration: Floats,
    jerk: Floats,
    snap: Floats,
    at_knots: Floats2,
    room: Floats2,
    system: Floats2,
) -> bool:
    """Write a time interval of constant snap for each span; return False if the spline is not positive everywhere.

    Each group of `together` intervals ends exactly in the state of the spline.

    The duration of a span is ∫ du/√z by four-point Gauss quadrature; its snap reproduces the change of u''' along the
    spline, with a small correction so that u, u' and u'' match as well.  `ends` are u' .. u''' at the start and the
    end.
    """
    n = len(duration)
    z = zeros(4)
    miss = zeros(4)
    for k in range(n + 1):
        near = min(k, n - 1)
        basis(knots, near, knots[k + 3], room)
        at(room, coefficient, near, z)
        # at the ends the given states apply, whatever rounding makes of z
        if z[0] <= 0.0 and k > 0 and k < n:
            return False
        v = sqrt(max(z[0], 0.0))
        at_knots[k] = v, 0.5 * z[1], 0.5 * v * z[2]
    for c in range(3):
        at_knots[0, c] = ends[0, c]
        at_knots[n, c] = ends[1, c]
    for k in range(n):
        h = knots[k + 4] - knots[k + 3]
        lasts = 0.0
        for number in range(4):
            place = 0.8611363115940526 if number % 2 == 0 else 0.3399810435848563
            share = 0.3478548451374538 if number % 2 == 0 else 0.6521451548625461
            place = 0.5 - 0.5 * place if number < 2 else 0.5 + 0.5 * place
            basis(knots, k, knots[k + 3] + place * h, room)
            at(room, coefficient, k, z)
            if z[0] <= 0.0:
                return False
            lasts = lasts + 0.5 * share * h / sqrt(z[0])
        duration[k] = lasts
        snap[k] = (at_knots[k + 1, 2] - at_knots[k, 2]) / lasts
    p = 0
    first = 0
    while first < n:
        # the last group takes the remainder, since fewer than four spans cannot meet four conditions
        last = first + together if n - first >= 2 * together else n
        for again in range(3):
            u = 0.0
            v = at_knots[first, 0]
            a = at_knots[first, 1]
            j = at_knots[first, 2]
            for k in range(first, last):
                t = duration[k]
                s = snap[k]
                if again == 2:
                    here = knots[first + 3] + u
                    while p + 2 < len(begin) and begin[p + 1] <= here:
                        p = p + 1
                    piece[k] = p
                    x[k] = here - begin[p]
                    speed[k] = v
                    acceleration[k] = a
                    jerk[k] = j
                u = u + way(v, a, j, s, t)
                v = cubic(v, a, j, s, t)
                a = a + t * (j + 0.5 * t * s)
                j = j + t * s
            if again < 2:
                # the second pass removes the rounding error of the first
                miss[0] = knots[last + 3] - knots[first + 3] - u
                miss[1] = at_knots[last, 0] - v
                miss[2] = at_knots[last, 1] - a
                miss[3] = at_knots[last, 2] - j
                _bent(first, last, miss, duration, snap, room, system)
        first = last
    return True
