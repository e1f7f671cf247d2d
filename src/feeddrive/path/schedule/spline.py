"""Time-optimal z(u) = u'² as a cubic spline under the limits of each axis, by Newton's method with a barrier function.

With r_n the derivatives of an axis and z', z'', z''' those of z with respect to u

    q'   = r1 √z
    q''  = r2 z + r1 z'/2
    q''' = √z (r3 z + 3/2 r2 z' + r1 z''/2)
    q''''= r4 z² + 3 r3 z z' + r2 (3/4 z'² + 2 z z'') + r1 (z' z''/4 + z z'''/2)

A penalty -μ log(1 - g²) is added to the time ∫ du/√z for the utilization g of each limit at each point; μ is reduced
step by step.  Newton's method is applied to time and penalties, with g expanded to first order in z, so that each step
solves a positive definite system of half bandwidth three.  It is a primal-dual one: for each limit and direction, at
the distance d = 1 - g or 1 + g, the curvature of the penalty is not μ/d² but λ/d with a multiplier λ, which is moved
by each step towards λ d = μ.  When μ falls, the step then ends at the new minimum to first order, where with μ/d² it
would pass the limit.  A step that violates a limit which was satisfied before is never accepted.

Spans are the parts of the motion between knots; this module also places the knots, selects the points at which limits
are evaluated, and converts from u back to time.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Ints, Records, Records2, zeros
from feeddrive.path.motion import (
    Derivatives,
    Limits,
    Motion,
    Piece,
    Pieces,
    at_instant,
    cubic,
    derivatives,
    interval_of,
    way,
)
from feeddrive.path.schedule.ramp import Bounds, Slopes, bounds, boxcars, cube_root, duration, speed_cap, straight

_LOOSE = 1.03  # relaxed limit at a violating point, relative to its present share
_TOUCHES = 1.0 - 1e-6  # larger shares are treated as violations: the penalty would be too steep
_INWARDS = 0.3  # least penalty while a limit is violated
_NEARER = 0.1  # least part of the distance to a limit that a step must leave
_ROUNDING = 1e-9  # part of a relaxed limit that must be left, whatever the expansion to first order says
# a multiplier is kept within these multiples of that at which its penalty is smallest: far from it the curvature of the
# penalty says nothing
_LEAST_FORCE = 0.1
_MOST_FORCE = 10.0
_FALL = 0.1  # factor of the penalty per step
_LEFT = 0.2  # of the penalty: largest time still to be gained, relative to the whole, before the penalty is lowered
_PATIENCE = 8  # number of steps in which the worst violation may stay above 0.98 of the least so far
_PROGRESS = 0.98
_VIOLATED = 40  # number of steps after which one that still violates a limit is the last
_HALVINGS = 12  # largest number of halvings of a step
_NOT_FORWARD = 1e300  # share returned where u'² is not positive
SPEEDS = 1
"""The limits of the feed and of velocity to jerk, in `Points.looks`."""
SNAP = 2
"""The limits of snap, in `Points.looks`."""


class Weights(NamedTuple):
    """The weights of a span's four coefficients in a number."""

    c0: float
    c1: float
    c2: float
    c3: float


class Basis(NamedTuple):
    """The weights of a span's coefficients in z .. z''' at a point."""

    z: Weights
    z1: Weights
    z2: Weights
    z3: Weights


class Square(NamedTuple):
    """z = u'² and its derivatives with respect to u."""

    z: float
    z1: float
    z2: float
    z3: float


class Rates(NamedTuple):
    """The derivatives of an axis with respect to u, divided by its limits: r1 and r2 by that of acceleration, r1 .. r3
    by that of jerk, r1 .. r4 by that of snap.
    """

    a1: float
    a2: float
    j1: float
    j2: float
    j3: float
    s1: float
    s2: float
    s3: float
    s4: float


class Points(NamedTuple):
    """The points at which the limits are evaluated, n of them, in ascending order.

    span    span index
    place   distance from the start of the span, m
    r       derivatives of each axis, (n, N)
    most    largest z that the velocity limits and the feed allow
    looks   the limits evaluated there: `SPEEDS`, `SNAP` or their sum
    weight  weight of the penalties, s
    away    weight of the time, m
    """

    span: Ints
    place: Floats
    r: Records2[Rates]
    most: Floats
    looks: Ints
    weight: Floats
    away: Floats


class Use(NamedTuple):
    """The utilization of a limit, and its derivatives with respect to z .. z'''."""

    g: float
    d0: float
    d1: float
    d2: float
    d3: float


class Forces(NamedTuple):
    """The multipliers of the limits of an axis in both directions, s."""

    acceleration_up: float
    acceleration_down: float
    jerk_up: float
    jerk_down: float
    snap_up: float
    snap_down: float


class Steepness(NamedTuple):
    """The derivatives of the shares of acceleration, jerk and snap of an axis with respect to z .. z''', and the
    inverse of their distances to the limits in both directions, where the system was assembled last.
    """

    a0: float
    a1: float
    a_above: float
    a_below: float
    j0: float
    j1: float
    j2: float
    j_above: float
    j_below: float
    s0: float
    s1: float
    s2: float
    s3: float
    s_above: float
    s_below: float


_LEVEL = Steepness(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Room(NamedTuple):
    """Work arrays of `quickest`.

    share, loose  shares and relaxed limits of each point
    steepness     of the shares of each axis at each point, (n, N)
    forces        multipliers of the limits of each axis at each point, (n, N)
    force         multiplier of the largest z at each point, s
    coefficients, gradient, step and lower band of the Hessian
    """

    share: Floats
    loose: Floats
    steepness: Records2[Steepness]
    forces: Records2[Forces]
    force: Floats
    tried: Floats
    slope: Floats
    step: Floats
    band: Floats2


@kernel
def basis(knots: Floats, k: int, x: float) -> Basis:
    """Return the weights of span k's four coefficients in z .. z''' at x; knots[k+3] <= x <= knots[k+4]."""
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
    a0 = 3.0 / (t4 - t1)
    a1 = 3.0 / (t5 - t2)
    a2 = 3.0 / (t6 - t3)
    b0 = 2.0 / (t4 - t2)
    b1 = 2.0 / (t5 - t3)
    g = 1.0 / (t4 - t3)
    return Basis(
        Weights(
            (t4 - x) / (t4 - t1) * n0,
            (x - t1) / (t4 - t1) * n0 + (t5 - x) / (t5 - t2) * n1,
            (x - t2) / (t5 - t2) * n1 + (t6 - x) / (t6 - t3) * n2,
            (x - t3) / (t6 - t3) * n2,
        ),
        Weights(-a0 * n0, a0 * n0 - a1 * n1, a1 * n1 - a2 * n2, a2 * n2),
        Weights(
            p * b0 * a0,
            -p * b0 * (a0 + a1) + q * b1 * a1,
            p * b0 * a1 - q * b1 * (a1 + a2),
            q * b1 * a2,
        ),
        Weights(-g * b0 * a0, g * (b1 * a1 + b0 * (a0 + a1)), -g * (b1 * (a1 + a2) + b0 * a1), g * b1 * a2),
    )


@kernel
def _acceleration(z: Square, r: Rates) -> Use:
    """Return the utilization of the limit of acceleration."""
    d1 = 0.5 * r.a1
    return Use(r.a2 * z.z + d1 * z.z1, r.a2, d1, 0.0, 0.0)


@kernel
def _jerk(z: Square, root: float, r: Rates) -> Use:
    """Return the utilization of the limit of jerk; `root` is √z."""
    inner = r.j3 * z.z + 1.5 * r.j2 * z.z1 + 0.5 * r.j1 * z.z2
    return Use(root * inner, root * r.j3 + 0.5 * inner / root, 1.5 * root * r.j2, 0.5 * root * r.j1, 0.0)


@kernel
def _snap(z: Square, r: Rates) -> Use:
    """Return the utilization of the limit of snap."""
    z0, z1, z2, z3 = z
    g = r.s4 * z0 * z0 + 3.0 * r.s3 * z0 * z1
    g = g + r.s2 * (0.75 * z1 * z1 + 2.0 * z0 * z2)
    g = g + r.s1 * (0.25 * z1 * z2 + 0.5 * z0 * z3)
    return Use(
        g,
        2.0 * r.s4 * z0 + 3.0 * r.s3 * z1 + 2.0 * r.s2 * z2 + 0.5 * r.s1 * z3,
        3.0 * r.s3 * z0 + 1.5 * r.s2 * z1 + 0.25 * r.s1 * z2,
        2.0 * r.s2 * z0 + 0.25 * r.s1 * z1,
        0.5 * r.s1 * z0,
    )


@kernel
def _stands(r: Rates) -> bool:
    """Return True if an axis does not move."""
    return r.a1 == 0.0 and r.a2 == 0.0 and r.j3 == 0.0 and r.s3 == 0.0 and r.s4 == 0.0


@kernel
def shares(z: Square, r: Records[Rates], most: float, looks: int) -> float:
    """Return the largest utilization of a limit at a point."""
    if z.z <= 0.0:
        return _NOT_FORWARD
    root = sqrt(z.z)
    speeds = looks != SNAP
    largest = z.z / most if speeds else 0.0
    for i in range(len(r)):
        if _stands(r[i]):
            continue
        if speeds:
            largest = max(largest, abs(_acceleration(z, r[i]).g))
            largest = max(largest, abs(_jerk(z, root, r[i]).g))
        if looks != SPEEDS:
            largest = max(largest, abs(_snap(z, r[i]).g))
    return largest


@kernel
def _held(force: float, least: float) -> float:
    """Return a multiplier, kept near that at which its penalty is smallest."""
    return min(max(force, _LEAST_FORCE * least), _MOST_FORCE * least)


class Quadratic(NamedTuple):
    """Gradient, and upper triangle of the Hessian, with respect to z .. z'''."""

    d0: float
    d1: float
    d2: float
    d3: float
    b00: float
    b01: float
    b02: float
    b03: float
    b11: float
    b12: float
    b13: float
    b22: float
    b23: float
    b33: float


@kernel
def _gaps(g: float, loose: float) -> tuple[float, float]:
    """Return the inverse of the distances to both limits."""
    inverse = 1.0 / (loose * loose - g * g)
    return (loose + g) * inverse, (loose - g) * inverse


@kernel
def _pushed(up: float, down: float, above: float, below: float, weight: float) -> tuple[float, float, float, float]:
    """Return gradient and curvature of the penalties of both directions of a limit with respect to g, and the
    multipliers that were used; `above` and `below` are the inverse of the distances to the limit.
    """
    least_up = weight * above
    least_down = weight * below
    up = _held(up, least_up)
    down = _held(down, least_down)
    return least_up - least_down, up * above + down * below, up, down


@kernel
def _expanded(
    z: Square,
    r: Records[Rates],
    most: float,
    looks: int,
    loose: float,
    weight: float,
    away: float,
    force: float,
    forces: Records[Forces],
    steepness: Records[Steepness],
) -> Quadratic:
    """Return gradient and Hessian of time and penalties at a point; `weight` multiplies the penalties, and `away` (m)
    the time.
    """
    z0 = z.z
    root = sqrt(z0)
    d0 = -0.5 * away / (z0 * root)
    d1 = 0.0
    d2 = 0.0
    d3 = 0.0
    b00 = -1.5 * d0 / z0
    b01 = 0.0
    b02 = 0.0
    b03 = 0.0
    b11 = 0.0
    b12 = 0.0
    b13 = 0.0
    b22 = 0.0
    b23 = 0.0
    b33 = 0.0
    speeds = looks != SNAP
    if speeds:
        gap = 1.0 / (most * loose - z0)
        d0 = d0 + weight * gap
        b00 = b00 + force * gap
    for i in range(len(r)):
        if _stands(r[i]):
            continue
        a_up, a_down, j_up, j_down, s_up, s_down = forces[i]
        known = _LEVEL
        if speeds:
            # second derivatives of g are omitted (Gauss-Newton), so that the Hessian stays positive definite
            g, g0, g1, _, _ = _acceleration(z, r[i])
            above, below = _gaps(g, loose)
            known = known._replace(a0=g0, a1=g1, a_above=above, a_below=below)
            first, second, a_up, a_down = _pushed(a_up, a_down, above, below, weight)
            d0 = d0 + first * g0
            d1 = d1 + first * g1
            h0 = second * g0
            b00 = b00 + h0 * g0
            b01 = b01 + h0 * g1
            b11 = b11 + second * g1 * g1
            g, g0, g1, g2, _ = _jerk(z, root, r[i])
            above, below = _gaps(g, loose)
            known = known._replace(j0=g0, j1=g1, j2=g2, j_above=above, j_below=below)
            first, second, j_up, j_down = _pushed(j_up, j_down, above, below, weight)
            d0 = d0 + first * g0
            d1 = d1 + first * g1
            d2 = d2 + first * g2
            h0 = second * g0
            h1 = second * g1
            b00 = b00 + h0 * g0
            b01 = b01 + h0 * g1
            b02 = b02 + h0 * g2
            b11 = b11 + h1 * g1
            b12 = b12 + h1 * g2
            b22 = b22 + second * g2 * g2
        if looks != SPEEDS:
            g, g0, g1, g2, g3 = _snap(z, r[i])
            above, below = _gaps(g, loose)
            known = known._replace(s0=g0, s1=g1, s2=g2, s3=g3, s_above=above, s_below=below)
            first, second, s_up, s_down = _pushed(s_up, s_down, above, below, weight)
            d0 = d0 + first * g0
            d1 = d1 + first * g1
            d2 = d2 + first * g2
            d3 = d3 + first * g3
            h0 = second * g0
            h1 = second * g1
            h2 = second * g2
            b00 = b00 + h0 * g0
            b01 = b01 + h0 * g1
            b02 = b02 + h0 * g2
            b03 = b03 + h0 * g3
            b11 = b11 + h1 * g1
            b12 = b12 + h1 * g2
            b13 = b13 + h1 * g3
            b22 = b22 + h2 * g2
            b23 = b23 + h2 * g3
            b33 = b33 + second * g3 * g3
        forces[i] = Forces(a_up, a_down, j_up, j_down, s_up, s_down)
        steepness[i] = known
    return Quadratic(d0, d1, d2, d3, b00, b01, b02, b03, b11, b12, b13, b22, b23, b33)


@kernel
def _weighed(weights: Weights, c0: float, c1: float, c2: float, c3: float) -> float:
    """Return the number with these weights of the coefficients."""
    return weights.c0 * c0 + weights.c1 * c1 + weights.c2 * c2 + weights.c3 * c3


@kernel
def at(row: Basis, coefficient: Floats, k: int) -> Square:
    """Evaluate z .. z''' from the four coefficients of span k and their `basis`."""
    c0 = coefficient[k]
    c1 = coefficient[k + 1]
    c2 = coefficient[k + 2]
    c3 = coefficient[k + 3]
    return Square(
        _weighed(row.z, c0, c1, c2, c3),
        _weighed(row.z1, c0, c1, c2, c3),
        _weighed(row.z2, c0, c1, c2, c3),
        _weighed(row.z3, c0, c1, c2, c3),
    )


@kernel
def shifted(z: Square, x: float) -> Square:
    """Return z .. z''' at the distance x from where they are given, within a span."""
    half = 0.5 * x
    z2 = z.z2 + x * z.z3
    return Square(z.z + x * (z.z1 + half * (z.z2 + x * (1.0 / 3.0) * z.z3)), z.z1 + half * (z.z2 + z2), z2, z.z3)


@kernel
def _add_to(band: Floats2, c: int, d: int, value: float) -> int:
    """Add to the entry of row c that is d left of the diagonal."""
    band[c, d] = band[c, d] + value
    return 0


@kernel
def _system(points: Points, rows: Records[Basis], mu: float, coefficient: Floats, room: Room) -> int:
    """Assemble the gradient of time and penalties with respect to the coefficients, and the lower band of the
    Hessian.
    """
    slope = room.slope
    band = room.band
    for c in range(len(coefficient)):
        slope[c] = 0.0
        band[c] = 0.0, 0.0, 0.0, 0.0
    m = len(points.span)
    p = 0
    while p < m:
        # all points of a span have the same four coefficients; first by z .. z''' at its start
        k = points.span[p]
        begin = at(rows[k], coefficient, k)
        t0 = t1 = t2 = t3 = 0.0
        b00 = b01 = b02 = b03 = b11 = b12 = b13 = b22 = b23 = b33 = 0.0
        while p < m and points.span[p] == k:
            x1 = points.place[p]
            weight = mu * points.weight[p]
            loose = room.loose[p]
            z = shifted(begin, x1)
            if points.looks[p] != SNAP:
                room.force[p] = _held(room.force[p], weight / (points.most[p] * loose - z.z))
            d0, d1, d2, d3, c00, c01, c02, c03, c11, c12, c13, c22, c23, c33 = _expanded(
                z,
                points.r[p],
                points.most[p],
                points.looks[p],
                loose,
                weight,
                points.away[p],
                room.force[p],
                room.forces[p],
                room.steepness[p],
            )
            if x1 == 0.0:
                t0 = t0 + d0
                t1 = t1 + d1
                t2 = t2 + d2
                t3 = t3 + d3
                b00 = b00 + c00
                b01 = b01 + c01
                b02 = b02 + c02
                b03 = b03 + c03
                b11 = b11 + c11
                b12 = b12 + c12
                b13 = b13 + c13
                b22 = b22 + c22
                b23 = b23 + c23
                b33 = b33 + c33
                p = p + 1
                continue
            x2 = 0.5 * x1 * x1
            x3 = x1 * x2 * (1.0 / 3.0)
            t0 = t0 + d0
            t1 = t1 + d1 + x1 * d0
            t2 = t2 + d2 + x1 * d1 + x2 * d0
            t3 = t3 + d3 + x1 * d2 + x2 * d1 + x3 * d0
            # columns of the Hessian shifted to the start, then its rows
            e01 = c01 + x1 * c00
            e02 = c02 + x1 * c01 + x2 * c00
            e03 = c03 + x1 * c02 + x2 * c01 + x3 * c00
            e11 = c11 + x1 * c01
            e12 = c12 + x1 * c11 + x2 * c01
            e13 = c13 + x1 * c12 + x2 * c11 + x3 * c01
            e22 = c22 + x1 * c12 + x2 * c02
            e23 = c23 + x1 * c22 + x2 * c12 + x3 * c02
            e33 = c33 + x1 * c23 + x2 * c13 + x3 * c03
            b00 = b00 + c00
            b01 = b01 + e01
            b02 = b02 + e02
            b03 = b03 + e03
            b11 = b11 + e11 + x1 * e01
            b12 = b12 + e12 + x1 * e02
            b13 = b13 + e13 + x1 * e03
            b22 = b22 + e22 + x1 * e12 + x2 * e02
            b23 = b23 + e23 + x1 * e13 + x2 * e03
            b33 = b33 + e33 + x1 * e23 + x2 * e13 + x3 * e03
            p = p + 1
        row = rows[k]
        a0, a1, a2, a3 = row.z
        f0, f1, f2, f3 = row.z1
        g0, g1, g2, g3 = row.z2
        i0, i1, i2, i3 = row.z3
        slope[k] = slope[k] + t0 * a0 + t1 * f0 + t2 * g0 + t3 * i0
        slope[k + 1] = slope[k + 1] + t0 * a1 + t1 * f1 + t2 * g1 + t3 * i1
        slope[k + 2] = slope[k + 2] + t0 * a2 + t1 * f2 + t2 * g2 + t3 * i2
        slope[k + 3] = slope[k + 3] + t0 * a3 + t1 * f3 + t2 * g3 + t3 * i3
        # the rows of the Hessian by z .. z''' times the basis, then the transposed basis times these
        p0 = b00 * a0 + b01 * f0 + b02 * g0 + b03 * i0
        p1 = b00 * a1 + b01 * f1 + b02 * g1 + b03 * i1
        p2 = b00 * a2 + b01 * f2 + b02 * g2 + b03 * i2
        p3 = b00 * a3 + b01 * f3 + b02 * g3 + b03 * i3
        q0 = b01 * a0 + b11 * f0 + b12 * g0 + b13 * i0
        q1 = b01 * a1 + b11 * f1 + b12 * g1 + b13 * i1
        q2 = b01 * a2 + b11 * f2 + b12 * g2 + b13 * i2
        q3 = b01 * a3 + b11 * f3 + b12 * g3 + b13 * i3
        r0 = b02 * a0 + b12 * f0 + b22 * g0 + b23 * i0
        r1 = b02 * a1 + b12 * f1 + b22 * g1 + b23 * i1
        r2 = b02 * a2 + b12 * f2 + b22 * g2 + b23 * i2
        r3 = b02 * a3 + b12 * f3 + b22 * g3 + b23 * i3
        s0 = b03 * a0 + b13 * f0 + b23 * g0 + b33 * i0
        s1 = b03 * a1 + b13 * f1 + b23 * g1 + b33 * i1
        s2 = b03 * a2 + b13 * f2 + b23 * g2 + b33 * i2
        s3 = b03 * a3 + b13 * f3 + b23 * g3 + b33 * i3
        _add_to(band, k, 0, a0 * p0 + f0 * q0 + g0 * r0 + i0 * s0)
        _add_to(band, k + 1, 0, a1 * p1 + f1 * q1 + g1 * r1 + i1 * s1)
        _add_to(band, k + 1, 1, a1 * p0 + f1 * q0 + g1 * r0 + i1 * s0)
        _add_to(band, k + 2, 0, a2 * p2 + f2 * q2 + g2 * r2 + i2 * s2)
        _add_to(band, k + 2, 1, a2 * p1 + f2 * q1 + g2 * r1 + i2 * s1)
        _add_to(band, k + 2, 2, a2 * p0 + f2 * q0 + g2 * r0 + i2 * s0)
        _add_to(band, k + 3, 0, a3 * p3 + f3 * q3 + g3 * r3 + i3 * s3)
        _add_to(band, k + 3, 1, a3 * p2 + f3 * q2 + g3 * r2 + i3 * s2)
        _add_to(band, k + 3, 2, a3 * p1 + f3 * q1 + g3 * r1 + i3 * s1)
        _add_to(band, k + 3, 3, a3 * p0 + f3 * q0 + g3 * r0 + i3 * s0)
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
                band[c, d] = sqrt(value)
            else:
                band[c, d] = value / _diagonal(band, c - d)
    for c in range(first, last):
        value = -slope[c]
        for d in range(1, 4):
            if c - d >= first:
                value = value - band[c, d] * step[c - d]
        step[c] = value / _diagonal(band, c)
    for back in range(last - first):
        c = last - 1 - back
        value = step[c]
        for d in range(1, 4):
            if c + d < last:
                value = value - band[c + d, d] * step[c + d]
        step[c] = value / _diagonal(band, c)
    return True


@kernel
def _diagonal(band: Floats2, c: int) -> float:
    """Return the entry of row c on the diagonal."""
    row = band[c]
    return row[0]


@kernel
def _evaluated(points: Points, rows: Records[Basis], coefficient: Floats, room: Room) -> bool:
    """Write the shares at all points; return False if u'² is not positive everywhere."""
    k = -1
    begin = Square(1.0, 0.0, 0.0, 0.0)
    for p in range(len(points.span)):
        if points.span[p] != k:
            k = points.span[p]
            begin = at(rows[k], coefficient, k)
        z = shifted(begin, points.place[p])
        room.share[p] = shares(z, points.r[p], points.most[p], points.looks[p])
        if room.share[p] >= _NOT_FORWARD:
            return False
    return True


@kernel
def _moved(force: float, gap: float, change: float, weight: float) -> float:
    """Return the multiplier at the end of a step that lowers a distance to a limit, of which `gap` is the inverse, by
    `change`.
    """
    return (weight + force * change) * gap


@kernel
def _farthest(points: Points, rows: Records[Basis], mu: float, coefficient: Floats, room: Room) -> float:
    """Return the largest part of the step that keeps all limits to first order; update the multipliers."""
    most = 1.0 - _NEARER  # largest share of a distance to a limit by which the step lowers it
    k = -1
    begin = Square(1.0, 0.0, 0.0, 0.0)
    ahead = begin
    for p in range(len(points.span)):
        if points.span[p] != k:
            k = points.span[p]
            begin = at(rows[k], coefficient, k)
            ahead = at(rows[k], room.step, k)
        z = shifted(begin, points.place[p])
        dz = shifted(ahead, points.place[p])
        loose = room.loose[p]
        weight = mu * points.weight[p]
        looks = points.looks[p]
        most = max(most, -dz.z / z.z)
        if looks != SNAP:
            gap = 1.0 / (points.most[p] * loose - z.z)
            most = max(most, dz.z * gap)
            room.force[p] = _moved(room.force[p], gap, dz.z, weight)
        for i in range(len(points.r[p])):
            if _stands(points.r[p, i]):
                continue
            known = room.steepness[p, i]
            a_up, a_down, j_up, j_down, s_up, s_down = room.forces[p, i]
            if looks != SNAP:
                change = known.a0 * dz.z + known.a1 * dz.z1
                most = max(most, max(change * known.a_above, -change * known.a_below))
                a_up = _moved(a_up, known.a_above, change, weight)
                a_down = _moved(a_down, known.a_below, -change, weight)
                change = known.j0 * dz.z + known.j1 * dz.z1 + known.j2 * dz.z2
                most = max(most, max(change * known.j_above, -change * known.j_below))
                j_up = _moved(j_up, known.j_above, change, weight)
                j_down = _moved(j_down, known.j_below, -change, weight)
            if looks != SPEEDS:
                change = known.s0 * dz.z + known.s1 * dz.z1 + known.s2 * dz.z2 + known.s3 * dz.z3
                most = max(most, max(change * known.s_above, -change * known.s_below))
                s_up = _moved(s_up, known.s_above, change, weight)
                s_down = _moved(s_down, known.s_below, -change, weight)
            room.forces[p, i] = Forces(a_up, a_down, j_up, j_down, s_up, s_down)
    return (1.0 - _NEARER) / most


@kernel
def quickest(
    points: Points,
    rows: Records[Basis],
    coefficient: Floats,
    penalty: float,
    last: float,
    steps: int,
    room: Room,
) -> int:
    """Optimize the spline for time, in place; return the number of points at which it still violates a limit.

    Three coefficients at each end are fixed.  At a point that violates a limit, this limit is relaxed, and then
    tightened with each step.  If u'² is not initially positive everywhere, nothing is changed and the result is 1.

    penalty  initial μ; it is reduced stepwise down to `last`
    steps    largest number of steps, of which no more than `_VIOLATED` may violate a limit
    """
    share = room.share
    loose = room.loose
    n = len(coefficient)
    above = 0
    if not _evaluated(points, rows, coefficient, room):
        return 1
    whole = 0.0
    least = _NOT_FORWARD  # worst share so far
    waited = 0  # number of steps in which it did not fall
    for p in range(len(points.span)):
        whole = whole + points.weight[p]
    for c in range(n):
        room.step[c] = 0.0
    for again in range(steps):
        above = 0
        worst = 0.0
        for p in range(len(points.span)):
            loose[p] = 1.0 if share[p] < _TOUCHES else _LOOSE * share[p]
            worst = max(worst, share[p])
            if share[p] >= 1.0:
                above = above + 1
        if above > 0 and again >= _VIOLATED:
            break
        if above > 0:
            if worst > _PROGRESS * least:
                waited = waited + 1
                if waited == _PATIENCE:
                    break
            else:
                least = worst
                waited = 0
        # violated limits first: with a small penalty the step would go for time and leave them violated
        if above > 0:
            penalty = max(penalty, _INWARDS)
        if again == 0:
            for p in range(len(points.span)):
                weight = penalty * points.weight[p]
                room.force[p] = 0.0
                for i in range(len(points.r[p])):
                    room.forces[p, i] = Forces(weight, weight, weight, weight, weight, weight)
        _system(points, rows, penalty, coefficient, room)
        if not _solved(room.band, 3, n - 3, room.slope, room.step):
            break
        far = _farthest(points, rows, penalty, coefficient, room)
        good = False
        for _ in range(_HALVINGS):
            for c in range(3, n - 3):
                room.tried[c] = coefficient[c] + far * room.step[c]
            for c in range(3):
                room.tried[c] = coefficient[c]
                room.tried[n - 1 - c] = coefficient[n - 1 - c]
            good = _evaluated(points, rows, room.tried, room)
            if good:
                for p in range(len(points.span)):
                    if share[p] > (1.0 - _ROUNDING) * loose[p]:
                        good = False
                        break
            if good:
                break
            far = 0.5 * far
        if not good:
            return max(above, 1)
        for c in range(n):
            coefficient[c] = room.tried[c]
        gain = 0.0  # by the whole step, to second order
        for c in range(3, n - 3):
            gain = gain - room.slope[c] * room.step[c]
        # lower the penalty only when little of the step is left: before, Newton's method has not converged for this one
        if above == 0 and (1.0 - far) * gain <= _LEFT * penalty * whole:
            if penalty <= last:
                break
            penalty = max(last, _FALL * penalty)
    return above


@kernel
def utilization(points: Points, rows: Records[Basis], coefficient: Floats, share: Floats) -> int:
    """Write the largest utilization of a limit at each point into `share`, or 1e300 where u'² is not positive."""
    for p in range(len(points.span)):
        k = points.span[p]
        z = shifted(at(rows[k], coefficient, k), points.place[p])
        share[p] = shares(z, points.r[p], points.most[p], points.looks[p])
    return 0


@kernel
def tightened(points: Points, first: int, last: int, axis: int, which: int, factor: float) -> int:
    """Lower the acceleration (`which` 1), jerk (2) or snap (3) limit of an axis at the points from `first` up to but
    excluding `last`: multiply its derivatives by `factor`.
    """
    for p in range(first, last):
        a1, a2, j1, j2, j3, s1, s2, s3, s4 = points.r[p, axis]
        if which == 1:
            points.r[p, axis] = points.r[p, axis]._replace(a1=a1 * factor, a2=a2 * factor)
        elif which == 2:
            points.r[p, axis] = points.r[p, axis]._replace(j1=j1 * factor, j2=j2 * factor, j3=j3 * factor)
        else:
            points.r[p, axis] = points.r[p, axis]._replace(
                s1=s1 * factor, s2=s2 * factor, s3=s3 * factor, s4=s4 * factor
            )
    return 0


GRADE = 0.1  # largest change of the span duration relative to the duration
_FALLS = 0.1  # of the duration: within it the usable share of the velocity falls from 1
_NEAR = 0.998  # usable share of a limit near the ends
POINTS = 3  # number of points of a span per path piece
_SIMPSON = 1.0 / 6.0  # weight of either end of a span in its time; the middle has the rest


@kernel
def tops(pieces: Pieces, limits: Records[Limits], out: Floats, ramps: Floats, most: Records[Slopes]) -> int:
    """Write the largest u' allowed by feed and velocity limits on each piece into `out`, and the duration, s, of a ramp
    from rest to it on a straight path into `ramps`.

    `most` is workspace for each axis.
    """
    for p in range(len(pieces.length)):
        norm = bounds(Piece(pieces.kind[p], pieces.length[p], pieces.shape[p]), most)
        out[p] = speed_cap(most, norm, pieces.feed[p], limits, 1e30)
        a, j, s = straight(most, limits)
        ramps[p] = duration(boxcars(out[p], a, j, s))
    return 0


@kernel
def _along(r: Records[Derivatives], limits: Records[Limits]) -> Bounds:
    """Return the acceleration, jerk and snap of u that a line in a direction allows."""
    a = 1e300
    j = 1e300
    s = 1e300
    for i in range(len(limits)):
        slope = abs(r[i].first)
        if slope != 0.0:
            a = min(a, limits[i].acceleration / slope)
            j = min(j, limits[i].jerk / slope)
            s = min(s, limits[i].snap / slope)
    return Bounds(a, j, s)


@kernel
def ramp_gain(
    pieces: Pieces, limits: Records[Limits], motion: Motion, first: int, last: int, r: Records[Derivatives]
) -> float:
    """Return the time, s, that a ramp of time intervals `first` up to but excluding `last` would save if its path were
    straight.

    Between the same speeds a ramp on a line takes L1 + L2 + L3; the line has the direction of the path at either end,
    whichever is more favorable.  The distance saved is covered at the higher speed.  The result is 1e300 for more than
    one ramp.
    """
    lasts = 0.0
    for m in range(first, last):
        # a node, at which the jerk may jump, or the acceleration
        if m > first and (motion.acceleration[m] == 0.0 or motion.acceleration[m] * motion.acceleration[m - 1] < 0.0):
            return 1e300
        lasts = lasts + motion.duration[m]
    begin = interval_of(motion, first)
    _, x, v, a, j, s = interval_of(motion, last - 1)
    t = motion.duration[last - 1]
    p = int(motion.piece[first])
    derivatives(pieces.kind[p], pieces.length[p], pieces.shape[p], min(begin.x, pieces.length[p]), r)
    one = _along(r, limits)
    p = int(motion.piece[last - 1])
    here = x + way(v, a, j, s, t)
    while here > pieces.length[p] and p + 1 < len(pieces.length):
        here = here - pieces.length[p]
        p = p + 1
    derivatives(pieces.kind[p], pieces.length[p], pieces.shape[p], min(here, pieces.length[p]), r)
    two = _along(r, limits)
    ends = cubic(v, a, j, s, t)
    rise = abs(ends - begin.speed)
    ramp = boxcars(rise, max(one.acceleration, two.acceleration), max(one.jerk, two.jerk), max(one.snap, two.snap))
    return (lasts - ramp.L1 - ramp.L2 - ramp.L3) * 0.5 * rise / max(ends, begin.speed)


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


class State(NamedTuple):
    """u' .. u''' at an instant."""

    speed: float
    acceleration: float
    jerk: float


class Reached(NamedTuple):
    """u .. u''' at an instant."""

    u: float
    speed: float
    acceleration: float
    jerk: float


@kernel
def states(motion: Motion, begin: Floats, time: Floats, out: Records[Reached]) -> int:
    """Evaluate a motion at increasing times; `begin` is u at the start of each path piece."""
    m = 0
    gone = 0.0
    for k in range(len(time)):
        while m + 1 < len(motion.duration) and time[k] >= gone + motion.duration[m]:
            gone = gone + motion.duration[m]
            m = m + 1
        _, x, v, a, j, s = interval_of(motion, m)
        t = time[k] - gone
        out[k] = Reached(
            begin[int(motion.piece[m])] + x + way(v, a, j, s, t),
            cubic(v, a, j, s, t),
            a + t * (j + 0.5 * t * s),
            j + t * s,
        )
    return 0


_FINE = 7.0  # number of spans in the duration of half a ramp
# slow pieces of a path can make ramps over all of it much longer than they are once lifted
_WIDEST = 0.5  # of a ramp from rest to the top speed on a straight path, in place of half a ramp of the plan
# short time intervals of a plan, and those that exist only due to rounding, are none of the lifted motion
_FINEST = 0.2  # of the mean duration of time intervals
_LEAST_SPAN = 1e-9  # s: a first phase of the duration of rounding must not set the first span
_HIDDEN = 0.1  # of the spans: shorter time intervals do not show in the spline
_TURNS = 0.2  # largest duration of a span relative to u'/|u''|


@kernel
def spacing(
    motion: Motion,
    end: State,
    spans: int,
    wide: int,
    share: float,
    ramps: Floats,
    finer: Ints,
    first: float,
    last: float,
    step: Floats,
    edge: Floats,
) -> int:
    """Write the durations of spans, s: `step` within each time interval and `edge` at their ends.

    end          the state at the end
    spans        number of time intervals at the start that are spans of an earlier spline
    wide, share  half a ramp lasts as long as `share` of that many time intervals
    ramps        duration of a ramp from rest to the top speed on each piece, if it were straight, s
    finer        factor by which spans are shorter in each time interval
    first, last  durations of the first and of the last phase, s
    """
    lasting = motion.duration
    n = len(lasting)
    mean = 0.0
    for m in range(n):
        mean = mean + lasting[m] / float(n)
    for m in range(n):
        least = 1e300
        for begin in range(max(m - wide + 1, 0), min(m, n - wide) + 1):
            lasts = 0.0
            for k in range(begin, begin + wide):
                lasts = lasts + lasting[k]
            least = min(least, lasts)
        h = min(max(least * share / _FINE, _FINEST * mean), _WIDEST / _FINE * ramps[int(motion.piece[m])])
        # spans stay as they are: with other knots the snaps of a lifted motion would exceed their limits
        step[m] = (lasting[m] if m < spans else h) / float(finer[m])
    for m in range(n + 1):
        h = min(step[min(m, n - 1)], step[max(m - 1, 0)])
        # the states at the ends fix three coefficients: a span there must not be longer than the phase it lies in
        if m == 0:
            h = min(h, max(first, _LEAST_SPAN))
        if m == n:
            h = min(h, max(last, _LEAST_SPAN))
        speed = end.speed if m == n else motion.speed[m]
        acceleration = end.acceleration if m == n else motion.acceleration[m]
        edge[m] = min(h, _TURNS * speed / max(abs(acceleration), 1e-300))
    return 0


@kernel
def graded_room(lasting: Floats, step: Floats, edge: Floats) -> int:
    """Grade the durations of spans at the ends of time intervals, and return a bound on the number of knots."""
    graded(lasting, edge)
    size = 2.0
    for m in range(len(lasting)):
        size = size + 2.0 + (1.0 + GRADE) * lasting[m] / min(step[m], min(edge[m], edge[m + 1]))
    return int(size)


@kernel
def approximation(
    motion: Motion,
    begin: Floats,
    time: Floats,
    end: State,
    at_begin: float,
    at_end: float,
    blended: int,
    reached: Records[Reached],
    knots: Floats,
    coefficient: Floats,
) -> bool:
    """Write knots and coefficients of a spline u'²(u) that approximates a motion and has the states of motions at both
    ends that take `at_begin` and `at_end` times as long; return False if it does not move between two knots.

    begin    u at the start of each path piece
    time     times of the knots, s
    end      the state at the end
    blended  number of coefficients over which the spline takes up such a change of speed
    reached  workspace, a row for each knot
    """
    n = len(time)
    states(motion, begin, time, reached)
    reached[n - 1] = Reached(reached[n - 1].u, end.speed, end.acceleration, end.jerk)
    for k in range(n + 6):
        knots[k] = reached[min(max(k - 3, 0), n - 1)].u
    for k in range(n - 1):
        if reached[k + 1].u <= reached[k].u:
            return False
    m = 0
    gone = motion.duration[0]
    for c in range(n + 2):
        # the blossom of u'² at three knots, from its Taylor form at one of them
        k = 0 if c < 3 else (n - 1 if c > n - 2 else c - 1)
        u, v, a, j = reached[k]
        p = knots[c + 1] - u
        q = knots[c + 2] - u
        r = knots[c + 3] - u
        value = v * v + 2.0 / 3.0 * a * (p + q + r) + j / (3.0 * v) * (p * q + q * r + r * p)
        while m + 1 < len(motion.duration) and time[k] >= gone:
            m = m + 1
            gone = gone + motion.duration[m]
        if c >= 3 and c <= n - 2 and motion.duration[m] < _HIDDEN * min(time[k] - time[k - 1], time[k + 1] - time[k]):
            # beyond a time interval much shorter than the spans its Taylor form does not hold: there Schoenberg's
            # approximation, whose coefficients are u'² at the mean of the three knots, which overshoots nowhere
            mean = u + (p + q + r) / 3.0
            low = k - 1 if mean < u else k
            before = reached[low]
            after = reached[low + 1]
            way = (mean - before.u) / (after.u - before.u)
            value = (1.0 - way) * before.speed * before.speed + way * after.speed * after.speed
        for side in range(2):
            factor = at_begin if side == 0 else at_end
            far = (c if side == 0 else n + 1 - c) - 2
            part = 1.0 if far >= blended else max(float(far) / float(max(blended, 1)), 0.0)
            part = part * part * (3.0 - 2.0 * part)
            slower = 1.0 / (factor * factor)
            value = value * (slower + (1.0 - slower) * part)
        coefficient[c] = value
    return True


@kernel
def reserve_factor(
    pieces: Pieces,
    top: Floats,
    limits: Records[Limits],
    shares: Limits,
    motion: Motion,
    first: int,
    last: int,
    r: Records[Derivatives],
    q: Records[Derivatives],
) -> float:
    """Return the factor of the time of time intervals `first` up to but excluding `last` of a motion at which they use
    no more than shares of the limits of each axis, where they begin and end; `top` is the largest speed on each piece.

    r, q  workspace for each axis
    """
    factor = 0.0
    for m in range(first, last):
        now = interval_of(motion, m)
        for end in range(2):
            t = float(end) * now.duration
            p, _ = at_instant(pieces, now, motion.piece[m], t, r, q)
            v = cubic(now.speed, now.acceleration, now.jerk, now.snap, t)
            # a motion that takes f times as long has 1/f .. 1/f⁴ of the derivatives
            factor = max(factor, abs(v) / (shares.velocity * top[p]))
            for i in range(len(limits)):
                most = limits[i]
                factor = max(factor, abs(q[i].first) / (shares.velocity * most.velocity))
                factor = max(factor, sqrt(abs(q[i].second) / (shares.acceleration * most.acceleration)))
                factor = max(factor, cube_root(abs(q[i].third) / (shares.jerk * most.jerk)))
                factor = max(factor, sqrt(sqrt(abs(q[i].fourth) / (shares.snap * most.snap))))
    return factor


@kernel
def rows_at_knots(knots: Floats, out: Records[Basis]) -> int:
    """Write the weights of the coefficients of each span in z .. z''' at its start."""
    for k in range(len(out)):
        out[k] = basis(knots, k, knots[k + 3])
    return 0


@kernel
def points(
    pieces: Pieces,
    begin: Floats,
    top: Floats,
    limits: Records[Limits],
    shares: Limits,
    knots: Floats,
    time: Floats,
    out: Points,
    d: Records[Derivatives],
) -> int:
    """Write the points that `quickest` evaluates; return their number.

    They are the start, the middle and the end of the part of each span that lies on each path piece.  At the end only
    the snap is evaluated, as it differs from that at the start of the next span.

    The middles are needed for the acceleration: u'' = z'/2 is a quadratic spline, whose values at the knots leave one
    mode free, z' = 0 at every knot with z'' of alternating sign.  They determine it together with the middles.

    begin   u at the start of each path piece
    top     largest speed that feed and velocity limits allow on each piece
    shares  usable parts of the limits; larger near the ends, where the state is given
    time    times of the knots in the present motion, s
    """
    count = 0
    p = 0
    n = len(time) - 1
    whole = time[n]
    for k in range(n):
        # the given states at the ends use the limits almost fully: smaller shares would be violated from the start
        near = k < 3 or k >= n - 3
        a_share = _NEAR if near else shares.acceleration
        j_share = _NEAR if near else shares.jerk
        s_share = _NEAR if near else shares.snap
        x = knots[k + 3]
        ends = knots[k + 4]
        first = count
        while x < ends:
            while p + 1 < len(pieces.length) and begin[p + 1] <= x:
                p = p + 1
            length = pieces.length[p]
            e = min(ends, begin[p + 1]) if p + 1 < len(pieces.length) else ends
            for place in range(POINTS):
                here = x if place == 0 else (e if place == 2 else 0.5 * (x + e))
                out.span[count] = k
                out.place[count] = here - knots[k + 3]
                derivatives(pieces.kind[p], length, pieces.shape[p], min(max(here - begin[p], 0.0), length), d)
                # full at the ends, where the plan may be at the top speed already, and falling no faster than it can
                far = min(time[k], whole - time[k + 1]) / (_FALLS * whole)
                out.most[count] = top[p] * top[p] * (1.0 - 2.0 * (1.0 - shares.velocity) * min(1.0, far * far))
                out.looks[count] = SPEEDS + SNAP if place == 0 else (SNAP if place == 2 else SPEEDS)
                out.away[count] = (e - x) * (1.0 - 2.0 * _SIMPSON if place == 1 else _SIMPSON)
                for i in range(len(limits)):
                    _, r1, r2, r3, r4 = d[i]
                    a = limits[i].acceleration * a_share
                    j = limits[i].jerk * j_share
                    s = limits[i].snap * s_share
                    out.r[count, i] = Rates(r1 / a, r2 / a, r1 / j, r2 / j, r3 / j, r1 / s, r2 / s, r3 / s, r4 / s)
                count = count + 1
            x = e
        for c in range(first, count):
            out.weight[c] = (time[k + 1] - time[k]) / (count - first)
    out.looks[0] = SNAP  # the state at the start is given
    return count


@kernel
def _bent(first: int, last: int, miss: Reached, duration: Floats, snap: Floats, moments: Floats2) -> int:
    """Apply the smallest change of the snaps of spans `first` up to but excluding `last` that adds `miss` to the
    state at their end; `moments` is workspace with a row for each of these spans.
    """
    whole = 0.0
    for m in range(first, last):
        whole = whole + duration[m]
    system = zeros(4, 4)
    right = zeros(4)
    # miss of u''', u'', u', u in units of that time
    scale = 1.0
    for c in range(4):
        scale = scale * whole
        value = miss.jerk if c == 0 else (miss.acceleration if c == 1 else (miss.speed if c == 2 else miss.u))
        right[c] = value / scale
    left = 1.0
    for m in range(first, last):
        moment = moments[m - first]
        low = max(left - duration[m] / whole, 0.0)
        # a snap from `left` to `low` before the end adds (leftᶜ - lowᶜ) / c!
        p = left
        q = low
        for c in range(4):
            moment[c] = (p - q) / (1.0 if c == 0 else (2.0 if c == 1 else (6.0 if c == 2 else 24.0)))
            p = p * left
            q = q * low
        for c in range(4):
            for b in range(4):
                system[c, b] = system[c, b] + moment[c] * moment[b] / moment[0]
        left = low
    # symmetric and positive definite: elimination needs no pivoting
    for c in range(4):
        for b in range(c + 1, 4):
            f = system[b, c] / system[c, c]
            for k in range(c, 4):
                system[b, k] = system[b, k] - f * system[c, k]
            right[b] = right[b] - f * right[c]
    for back in range(4):
        c = 3 - back
        for b in range(c + 1, 4):
            right[c] = right[c] - system[c, b] * right[b]
        right[c] = right[c] / system[c, c]
    for m in range(first, last):
        moment = moments[m - first]
        add = 0.0
        for c in range(4):
            add = add + moment[c] * right[c]
        snap[m] = snap[m] + add / moment[0]
    return 0


@kernel
def in_time(
    knots: Floats,
    coefficient: Floats,
    rows: Records[Basis],
    begin: Floats,
    starts: State,
    ends: State,
    together: int,
    motion: Motion,
    at_knots: Records[State],
    moments: Floats2,
) -> bool:
    """Write a time interval of constant snap for each span; return False if the spline is not positive everywhere.

    Each group of `together` intervals ends exactly in the state of the spline.

    The duration of a span is ∫ du/√z by four-point Gauss quadrature; its snap reproduces the change of u''' along the
    spline, with a small correction so that u, u' and u'' match as well.  The given states at the start and the end
    apply, whatever rounding makes of z there.
    """
    n = len(motion.duration)
    for k in range(1, n):
        z = at(rows[k], coefficient, k)
        if z.z <= 0.0:
            return False
        v = sqrt(z.z)
        at_knots[k] = State(v, 0.5 * z.z1, 0.5 * v * z.z2)
    at_knots[0] = starts
    at_knots[n] = ends
    for k in range(n):
        h = knots[k + 4] - knots[k + 3]
        begins = at(rows[k], coefficient, k)
        lasts = 0.0
        for number in range(4):
            place = 0.8611363115940526 if number % 2 == 0 else 0.3399810435848563
            share = 0.3478548451374538 if number % 2 == 0 else 0.6521451548625461
            place = 0.5 - 0.5 * place if number < 2 else 0.5 + 0.5 * place
            z = shifted(begins, place * h)
            if z.z <= 0.0:
                return False
            lasts = lasts + 0.5 * share * h / sqrt(z.z)
        motion.duration[k] = lasts
        motion.snap[k] = (at_knots[k + 1].jerk - at_knots[k].jerk) / lasts
    p = 0
    first = 0
    while first < n:
        # the last group takes the remainder, since fewer than four spans cannot meet four conditions
        last = first + together if n - first >= 2 * together else n
        wanted = at_knots[last]
        for again in range(3):
            u = 0.0
            v, a, j = at_knots[first]
            for k in range(first, last):
                t = motion.duration[k]
                s = motion.snap[k]
                if again == 2:
                    here = knots[first + 3] + u
                    while p + 2 < len(begin) and begin[p + 1] <= here:
                        p = p + 1
                    motion.piece[k] = p
                    motion.x[k] = here - begin[p]
                    motion.speed[k] = v
                    motion.acceleration[k] = a
                    motion.jerk[k] = j
                u = u + way(v, a, j, s, t)
                v = cubic(v, a, j, s, t)
                a = a + t * (j + 0.5 * t * s)
                j = j + t * s
            if again < 2:
                # the second pass removes the rounding error of the first
                miss = Reached(
                    knots[last + 3] - knots[first + 3] - u, wanted.speed - v, wanted.acceleration - a, wanted.jerk - j
                )
                _bent(first, last, miss, motion.duration, motion.snap, moments)
        first = last
    return True
