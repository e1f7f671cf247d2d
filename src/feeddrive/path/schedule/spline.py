"""z(u) = u'² as a cubic spline, as quick as the limits of each axis allow: Newton's method with a barrier.

With r_n the derivatives of an axis by u and z', z'', z''' those of z by u

    q'   = r1 √z
    q''  = r2 z + r1 z'/2
    q''' = √z (r3 z + 3/2 r2 z' + r1 z''/2)
    q''''= r4 z² + 3 r3 z z' + r2 (3/4 z'² + 2 z z'') + r1 (z' z''/4 + z z'''/2)

The time ∫ du/√z gets a penalty -μ log(1 - g²) for each share g of a limit at each point; μ falls.  The penalty of a
share, not of z, is expanded to second order with the slope of g alone, so that each step solves a positive system with
three neighbors on either side.  A state of the spline is never accepted that breaks a limit which held before.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints

_LOOSE = 1.03  # times the share of a point that breaks a limit: what it may take
_TOUCHES = 1.0 - 1e-6  # a share as large is taken for one that breaks a limit: its penalty would be too steep
_INWARDS = 0.3  # the least penalty while one does
_NEARER = 0.1  # of the way to a limit is left by a step at least
_FALL = 0.25  # of the penalty in a step
_HALVINGS = 12  # of a step
_NOT_FORWARD = 1e300  # the share where u'² is not above 0


@kernel
def basis(knots: Floats, k: int, x: float, out: Floats2) -> int:
    """z, z', z'', z''' at x in span k from its four coefficients, as rows of `out`; knots[k+3] <= x <= knots[k+4]."""
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
    """First and second derivative of -log(1 - (g/loose)²) by g."""
    gap = loose * loose - g * g
    first = 2.0 * g / gap
    return first, 2.0 / gap + first * first


@kernel
def shares(z: Floats, r: Floats2, most: float, full: bool) -> float:
    """The largest share of a limit at a point; r1 .. r4 in shares of the limits, see `lifted`."""
    if z[0] <= 0.0:
        return _NOT_FORWARD
    z0, z1, z2, z3 = z
    root = sqrt(z0)
    found = z0 / most if full else 0.0
    for i in range(len(r)):
        a1, a2, j1, j2, j3, s1, s2, s3, s4 = r[i]
        if full:
            found = max(found, abs(a2 * z0 + 0.5 * a1 * z1))
            found = max(found, abs(root * (j3 * z0 + 1.5 * j2 * z1 + 0.5 * j1 * z2)))
        snap = s4 * z0 * z0 + 3.0 * s3 * z0 * z1
        snap = snap + s2 * (0.75 * z1 * z1 + 2.0 * z0 * z2)
        found = max(found, abs(snap + s1 * (0.25 * z1 * z2 + 0.5 * z0 * z3)))
    return found


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
    """Slope and bend of the time and the penalties at a point, by z .. z'''.  `weight` of penalties, m of `away`."""
    z0, z1, z2, z3 = z
    root = sqrt(z0)
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
            continue  # it stands
        if full:
            g0 = a2
            g1 = 0.5 * a1
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
    """z, z', z'', z''' from the four coefficients of span k and their `basis`."""
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
    span: Ints, row: Floats3, r: Floats3, most: Floats, full: Ints, loose: Floats, weight: Floats, away: Floats,
    mu: float, coefficient: Floats, slope: Floats, band: Floats2,
) -> int:  # fmt: skip
    """Slope of time and penalties by the coefficients, and the lower band of their bend."""
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
            # a row of the bend by z .. z''' times the basis, then the basis times that
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
    """step = - band^-1 slope for the coefficients from `first` to before `last`, by Cholesky within the band."""
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
    span: Ints, row: Floats3, r: Floats3, most: Floats, full: Ints, weight: Floats, away: Floats,
    coefficient: Floats, penalty: float, last: float, steps: int,
    share: Floats, loose: Floats, tried: Floats, slope: Floats, step: Floats, band: Floats2,
) -> int:  # fmt: skip
    """Make the spline quicker, in place; at how many points it breaks a limit after all; three of each end stay.

    A point that breaks a limit has a looser one of its own, which is drawn tight with each step.  Nothing is done, and
    the answer is 1, if u'² is not above 0 everywhere at first.

    span     of each point, ascending, and `row` its `basis`
    r        r1 .. r4 of each axis over the limits: (n, N, 9) = r1 r2 for q'', r1 r2 r3 for q''', r1 .. r4 for q''''
    most     z by velocity and feed
    full     whether more than q'''' is looked at
    weight   of the penalties at a point, s; `away` of the time there, m
    penalty  at first; each step takes a part of it, down to `last`
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
        if above > 0:
            penalty = max(penalty, _INWARDS)
        _system(span, row, r, most, full, loose, weight, away, penalty, coefficient, slope, band)
        if not _solved(band, 3, n - 3, slope, step):
            break
        for p in range(len(span)):
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
        if above == 0 and far > 0.3:
            if penalty <= last:
                break
            penalty = max(last, _FALL * penalty)
    return above
