"""A path r(x) in pieces, and a motion along it in time intervals of constant snap.

A piece of the path is a line, an arc or a seventh-degree polynomial, stored as one row of the arrays.  x is measured
from the start of each piece, and displacements from its own origin, so that no precision is lost far from the machine
zero. x is in m and nearly the arc length; |r'| need not be 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import floor
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints, Records, rows_for
from feeddrive.path.kinematics import LINEAR, Kinematics

LINE, ARC, POLYNOMIAL, PACED = 0, 1, 2, 3

# π/2 as a sum of two numbers, the first of them so short that small multiples of it are exact
_HALF_PI_HIGH = float.fromhex("0x1.921fb54400000p+0")
_HALF_PI_LOW = float.fromhex("0x1.0b4611a626331p-34")


class Pieces(NamedTuple):
    """The n pieces of a path of N axes; in each piece 0 <= x <= length, and ξ = x / length.

        line, polynomial   r_i = origin_i + Σ_{k=1..7} shape_ik ξᵏ; a line has only k = 1
        paced              a polynomial whose feed bounds u' and not |r'| u': the joints, while the tool's tip follows
                           the program
        arc, helix         r_i = origin_i + E1_i (cos θ - 1) + E2_i sin θ + slope_i x,   θ = κ x

    kind    LINE, ARC, POLYNOMIAL or PACED, shape (n,)
    length  m, shape (n,)
    origin  r(0), m, shape (n, N)
    shape   (n, N, 8), m; for an arc columns 0 to 3 are E1, E2, slope and κ in 1/m (same for each axis)
    feed    the largest path speed |r'| u' (u' if paced), m/s, shape (n,)
    line    line number in the part program, shape (n,)
    """

    kind: Ints
    length: Floats
    origin: Floats2
    shape: Floats3
    feed: Floats
    line: Ints


class Piece(NamedTuple):
    """The shape of one piece, as in `Pieces`: its kind, its length (m), and `shape` of shape (N, 8)."""

    kind: int
    length: float
    shape: Floats2


class ArcAxis(NamedTuple):
    """The shape of an arc along one axis, as in `Pieces`: E1 and E2 (m), slope, and κ (1/m, the same for each axis)."""

    E1: float
    E2: float
    slope: float
    curvature: float


class Derivatives(NamedTuple):
    """A coordinate and its first to fourth derivative, with respect to x or to time."""

    value: float
    first: float
    second: float
    third: float
    fourth: float


class Limits(NamedTuple):
    """The limits of an axis, m/s .. m/s⁴."""

    velocity: float
    acceleration: float
    jerk: float
    snap: float


class TipColumns(NamedTuple):
    """The kinematics with the tool whose tip a path moves, and the columns of its axes among those of the machine.

    linear, rotary  columns of the linear and of the rotary axes, in the order of the kinematics
    """

    kinematics: Kinematics
    linear: tuple[int, ...]
    rotary: tuple[int, ...]

    @staticmethod
    def of(kinematics: Kinematics, axes: str) -> TipColumns:
        """Return the columns for the letters of a machine's axes."""
        linear, rotary = (tuple(axes.index(x) for x in letters) for letters in (LINEAR, kinematics.rotary_letters))
        return TipColumns(kinematics, linear, rotary)


class Changes(NamedTuple):
    """Where the line of the part program changes along a path: `line[k]` holds from the distance `at[k]` on.

    A piece may stand for several lines: those of one direction, or those within a span of a spline.

    at    distance from the start of the first piece by the lengths of the pieces, ascending, m, shape (n,)
    line  line number, shape (n,)
    """

    at: np.ndarray
    line: np.ndarray


class Section(NamedTuple):
    """A section of a run: pieces that continue the previous section; `ends` is True if the run ends with it.

    tolerance  tolerance of the corner at which the run ends, m; 0: a stop
    lines      lines of the part program along the pieces; None: that of each piece
    """

    pieces: Pieces
    ends: bool
    tolerance: float = 0.0
    lines: Changes | None = None


def counted(pieces: Pieces, weights: np.ndarray | None) -> Pieces:
    """Return pieces with each coordinate multiplied by the weight of its axis.

    Rotary axes then have lengths, in which distances and directions of the path are measured.

    weights  the length that counts for one m or rad of each axis, m, shape (N,); None: 1
    """
    if weights is None:
        return pieces
    # an arc has its curvature in column 3 of each axis, and nothing behind it
    scales = np.where((np.arange(8) == 3) & (pieces.kind == ARC)[:, None, None], 1.0, weights[:, None])
    return pieces._replace(origin=pieces.origin * weights, shape=pieces.shape * scales)


def part_of_pieces(pieces: Pieces, first: int, last: int) -> Pieces:
    """Return the pieces from `first` up to but excluding `last`."""
    return Pieces._make([column[first:last] for column in pieces])


def one_after_the_other(pieces: Sequence[Pieces]) -> Pieces:
    """Concatenate pieces of one path."""
    return Pieces(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))


def piece_of(pieces: Pieces, p: int) -> Piece:
    """Return piece p."""
    return Piece(int(pieces.kind[p]), float(pieces.length[p]), pieces.shape[p])


@kernel
def turned(theta: float) -> tuple[float, float]:
    """Return sin θ and 1 - cos θ, the latter without cancellation at small angles; θ in rad, |θ| < 1e6."""
    # reduce to |r| <= π/4, where the series below are short
    k = floor(theta * 0.6366197723675814 + 0.5)
    r = (theta - k * _HALF_PI_HIGH) - k * _HALF_PI_LOW
    z = r * r
    # Taylor series to r¹⁷ and r¹⁸, summed from the smallest terms, so that rounding stays in the last places
    s = z * (1.0 / 6.227020800e9 - z * (1.0 / 1.307674368e12 - z / 3.55687428096e14))
    s = z * (1.0 / 120.0 - z * (1.0 / 5040.0 - z * (1.0 / 362880.0 - z / 39916800.0 + z * s)))
    s = r - r * z * (1.0 / 6.0 - s)
    c = z * (1.0 / 8.71782912e10 - z * (1.0 / 2.0922789888e13 - z / 6.402373705728e15))
    c = z * (1.0 / 720.0 - z * (1.0 / 40320.0 - z * (1.0 / 3628800.0 - z / 479001600.0 + z * c)))
    c = z * (0.5 - z * (1.0 / 24.0 - c))
    quarter = k % 4
    if quarter == 0:
        return s, c
    if quarter == 1:
        return 1.0 - c, 1.0 + s
    if quarter == 2:
        return -s, 2.0 - c
    return c - 1.0, 1.0 - s


@kernel
def arc_axis(shape: Floats2, i: int) -> ArcAxis:
    """Return the shape of an arc along axis i."""
    return ArcAxis(shape[i, 0], shape[i, 1], shape[i, 2], shape[i, 3])


@kernel
def line_way(shape: Floats2, i: int) -> float:
    """Return the displacement of a line along axis i, m."""
    return shape[i, 1]


@kernel
def put_line(shape: Floats2, i: int, way: float) -> int:
    """Make a piece a line along axis i, by its displacement in m."""
    shape[i] = 0.0, way, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return 0


@kernel
def put_arc(shape: Floats2, i: int, axis: ArcAxis) -> int:
    """Make a piece an arc along axis i."""
    shape[i] = axis.E1, axis.E2, axis.slope, axis.curvature, 0.0, 0.0, 0.0, 0.0
    return 0


@kernel
def less_line(shape: Floats2, i: int, way: float) -> int:
    """Subtract a line along axis i, by its displacement in m, from a polynomial."""
    shape[i, 1] = shape[i, 1] - way
    return 0


@kernel
def derivatives(kind: int, length: float, shape: Floats2, x: float, out: Records[Derivatives]) -> int:
    """Write r - r(0), r', r'', r''' and r'''' of each axis of one piece at x into `out`."""
    if kind == 1:
        kappa = arc_axis(shape, 0).curvature
        s, v = turned(kappa * x)
        c = 1.0 - v
        k2 = kappa * kappa
        for i in range(len(shape)):
            e1, e2, slope, _ = arc_axis(shape, i)
            out[i] = Derivatives(
                e2 * s - e1 * v + slope * x,
                kappa * (e2 * c - e1 * s) + slope,
                -k2 * (e1 * c + e2 * s),
                k2 * kappa * (e1 * s - e2 * c),
                k2 * k2 * (e1 * c + e2 * s),
            )
        return 0
    xi = x / length
    if kind == 0:
        for i in range(len(shape)):
            out[i] = Derivatives(line_way(shape, i) * xi, line_way(shape, i) / length, 0.0, 0.0, 0.0)
        return 0
    for i in range(len(shape)):
        p0 = 0.0
        p1 = 0.0
        p2 = 0.0
        p3 = 0.0
        p4 = 0.0
        # Horner's scheme for the value and, in the same pass, its derivatives over k!: hence 2, 6 and 24 below
        for back in range(8):
            k = 7 - back
            p4 = p4 * xi + p3
            p3 = p3 * xi + p2
            p2 = p2 * xi + p1
            p1 = p1 * xi + p0
            p0 = p0 * xi + (shape[i, k] if k > 0 else 0.0)
        out[i] = Derivatives(
            p0,
            p1 / length,
            2.0 * p2 / (length * length),
            6.0 * p3 / (length * length * length),
            24.0 * p4 / (length * length * length * length),
        )
    return 0


class Motion(NamedTuple):
    """A motion u(t) along a path as m time intervals of constant u''''.

    duration  s, shape (m,)
    piece     index of the path piece in which each interval begins, shape (m,)
    x         start position within that piece, m
    speed, acceleration, jerk, snap  u' .. u'''' at the start of each interval, m/s .. m/s⁴
    """

    duration: Floats
    piece: Ints
    x: Floats
    speed: Floats
    acceleration: Floats
    jerk: Floats
    snap: Floats


@kernel
def appended(motion: Motion, count: int, interval: Interval, p: int) -> int:
    """Write a time interval that begins on piece p; return the new count."""
    motion.duration[count] = interval.duration
    motion.piece[count] = p
    motion.x[count] = interval.x
    motion.speed[count] = interval.speed
    motion.acceleration[count] = interval.acceleration
    motion.jerk[count] = interval.jerk
    motion.snap[count] = interval.snap
    return count + 1


def slowed(motion: Motion, factor: float) -> Motion:
    """Return a motion along the same path that takes `factor` times as long."""
    duration, piece, x, v, a, j, s = motion
    return Motion(duration * factor, piece, x, v / factor, a / factor**2, j / factor**3, s / factor**4)


class Interval(NamedTuple):
    """A time interval of constant u'''' on one known piece: its duration (s), and x .. u'''' at its start."""

    duration: float
    x: float
    speed: float
    acceleration: float
    jerk: float
    snap: float


class Entering(NamedTuple):
    """The start of the next run, from rest, during the last part of the previous run: q is the sum of both motions
    minus the position of the corner between the runs.

    Both motions have the same time intervals, and each stays on one piece of its path.

    tolerance  proven bound on the distance between q and the two pieces, m
    lines      lines of the part program along the pieces; None: that of each piece
    """

    pieces: Pieces
    motion: Motion
    tolerance: float
    lines: Changes | None = None


class Part(NamedTuple):
    """A part of a run: some pieces of its path and the motion on them; a run starts and ends at rest.

    The first piece is the one on which the previous part ended.  `ends` is True if the run ends with this part.  If the
    next run is `entering` at the same time, the following part continues from the position that the next run has then
    reached.

    mode     path mode (`PathMode`) that requires the stop; empty if the joint has a tolerance, but cannot be passed
             within it
    factor   feed override that the feed of the pieces contains
    weights  the length that counts for one m or rad of each axis in path speeds (`Pieces.feed`) and distances, m, shape
             (N,); None: 1
    tip      the tool whose tip follows the program; None: the axes do
    lines    lines of the part program along the pieces; None: that of each piece
    """

    pieces: Pieces
    motion: Motion
    ends: bool
    entering: Entering | None = None
    mode: str = ""
    factor: float = 1.0
    weights: np.ndarray | None = None
    tip: TipColumns | None = None
    lines: Changes | None = None


class Pause(NamedTuple):
    """A standstill: a dwell or a hold of `duration` s, or 0 s if the program waits for another event."""

    duration: float
    why: str
    line: int


def rows(motion: Motion) -> np.ndarray:
    """Return the time intervals of a motion on one piece as an array of `Interval`."""
    table = rows_for(Interval, len(motion.duration))
    for column, values in zip(table.T, (motion.duration, *motion[2:]), strict=True):
        column[:] = values
    return table


def from_rows(new: np.ndarray, piece: int, x: float = 0.0) -> Motion:
    """Return the motion on one path piece, starting at x, from an array of `Interval`."""
    # copied, since callers reuse their rows and x is added in place
    duration, place, *state = new.T.copy()
    place += x
    return Motion(duration, np.full(len(new), piece), place, *state)


def line_shapes(ways: np.ndarray) -> np.ndarray:
    """Return the shape of lines, (n, N, 8), from their displacements, m, shape (n, N)."""
    shapes = np.zeros((*ways.shape, 8))
    shapes[:, :, 1] = ways
    return shapes


def arc_shape(E1: Sequence[float], E2: Sequence[float], slope: Sequence[float], curvature: float) -> np.ndarray:
    """Return the shape of an arc, (N, 8)."""
    shape = np.zeros((len(E1), 8))
    shape[:, :4] = [(*axis, curvature) for axis in zip(E1, E2, slope, strict=True)]
    return shape


def direction(pieces: Pieces, k: int) -> np.ndarray:
    """Return r' of a line, shape (N,)."""
    return pieces.shape[k, :, 1] / float(pieces.length[k])


@kernel
def cubic(a: float, b: float, c: float, d: float, t: float) -> float:
    """Evaluate a + b t + c t²/2 + d t³/6, which is u'(t) for u' .. u'''' = a .. d at t = 0."""
    return a + t * (b + t * (0.5 * c + t * d / 6.0))


@kernel
def way(v: float, a: float, j: float, s: float, t: float) -> float:
    """Return the distance ∫ u' dt from 0 to t, for u' .. u'''' = v, a, j, s at t = 0."""
    return t * (v + t * (0.5 * a + t * (j / 6.0 + t * s / 24.0)))


@kernel
def when(far: float, v: float, a: float, j: float, s: float, t0: float, t1: float) -> float:
    """Return the time in [t0, t1] at which an increasing u reaches the distance `far`, by Newton's method
    safeguarded by bisection.
    """
    low = t0
    high = t1
    t = 0.5 * (low + high)
    for _ in range(200):
        miss = way(v, a, j, s, t) - far
        if miss > 0.0:
            high = t
        else:
            low = t
        slope = cubic(v, a, j, s, t)
        step = t - miss / slope if slope > 0.0 else low
        # near a rest u' is small and Newton's step leaves the bracket: bisection instead
        if step <= low or step >= high:
            step = 0.5 * (low + high)
        if step == t or step <= low or step >= high:
            break
        t = step
    return t


@kernel
def interval_of(motion: Motion, m: int) -> Interval:
    """Return time interval m, without the index of its piece."""
    return Interval(
        motion.duration[m], motion.x[m], motion.speed[m], motion.acceleration[m], motion.jerk[m], motion.snap[m]
    )


@kernel
def moved(interval: Interval, t: float) -> Interval:
    """Return the rest of a time interval from t on."""
    duration, x, v, a, j, s = interval
    return Interval(duration - t, x + way(v, a, j, s, t), cubic(v, a, j, s, t), a + t * (j + 0.5 * t * s), j + t * s, s)


@kernel
def chain(v: float, a: float, j: float, s: float, r: Records[Derivatives], out: Records[Derivatives]) -> int:
    """Write q .. q'''' of each axis into `out`, by the chain rule from u' .. u'''' and r .. r''''."""
    for i in range(len(r)):
        r0, r1, r2, r3, r4 = r[i]
        out[i] = Derivatives(
            r0,
            r1 * v,
            r2 * v * v + r1 * a,
            r3 * v * v * v + 3.0 * r2 * v * a + r1 * j,
            r4 * v * v * v * v + 6.0 * r3 * v * v * a + r2 * (3.0 * a * a + 4.0 * v * j) + r1 * s,
        )
    return 0


@kernel
def at_instant(
    pieces: Pieces, now: Interval, p: int, t: float, r: Records[Derivatives], q: Records[Derivatives]
) -> tuple[int, float]:
    """Write r - r(0) .. r'''' and q - r(0) .. q'''' of each axis, t seconds after the start of a time interval.

    `now.x` is measured on piece p.  Return the piece on which the motion is then, and the start of the interval on it.
    """
    _, x0, v, a, j, s = now
    last = len(pieces.length) - 1
    here = x0 + way(v, a, j, s, t)
    while here > pieces.length[p] and p < last:
        x0 = x0 - pieces.length[p]
        here = here - pieces.length[p]
        p = p + 1
    here = min(max(here, 0.0), pieces.length[p])
    derivatives(pieces.kind[p], pieces.length[p], pieces.shape[p], here, r)
    chain(cubic(v, a, j, s, t), a + t * (j + 0.5 * t * s), j + t * s, s, r, q)
    return p, x0
