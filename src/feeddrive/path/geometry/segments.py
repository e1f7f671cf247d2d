"""Segments in axis coordinates from the moves of a part program, and the blend that rounds the joint of two segments.

Moves become lines, arcs and splines in axis coordinates, with feed and tolerance.  If a move involves both linear and
rotary axes, its path length covers all of them.  An angle is multiplied by P / α, with the tolerance P of lengths and
the tolerance α of the axis, so that one number bounds both: a path within P of the program in these coordinates is
within P of it in X Y Z U V W, and within α in each rotary axis.  As in LinuxCNC, the feed refers to X Y Z; for a move
without these it refers to U V W; for a move of A B C alone it is in degrees.

A blend is a polynomial of seventh degree that matches both segments up to the third derivative.  At the distance L
before and after the joint the states r, r', r'', r''' of the segments are taken relative to the joint, and connected
over a parameter length B = L (1.4 + 0.3 (1 + t0·t1)), where t0 and t1 are the directions at the joint.  The distance to
the segments is bounded, not sampled: blend and segments are polynomials of the same parameter (arcs are approximated to
within R (φ/2)⁸/8!), and the convex hull of the Bernstein points of their difference contains this difference.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feeddrive.language.errors import ProgramError
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Records, rows_for, zeros
from feeddrive.path.geometry.hermite import State, hermite
from feeddrive.path.geometry.weights import ANGLE_TOLERANCE, ROTARY, Weights
from feeddrive.path.kinematics import UnreachableError
from feeddrive.path.motion import (
    ARC,
    LINE,
    POLYNOMIAL,
    ArcAxis,
    Derivatives,
    Pause,
    Piece,
    Pieces,
    TipColumns,
    arc_axis,
    arc_shape,
    derivatives,
    line_shapes,
    line_way,
    put_arc,
    put_line,
    turned,
)
from feeddrive.path.program.blocks import AXES, BlockError, Line, located
from feeddrive.path.program.budget import Spending
from feeddrive.path.program.moves import (
    Arc,
    Dwell,
    End,
    Feed,
    Move,
    PathMode,
    Spindle,
    Spline,
    Stop,
    Straight,
    Switch,
    Synchronized,
    ToolChange,
    ToolPoint,
)
from feeddrive.path.turning import Curves, along_arc, in_plane

_PARTS = 4  # parts of each half of a blend, whose hulls are computed separately
_SEARCH = 30
_SAME = 1e-12  # relative to r' .. r''' times the length, next to a spline and between arcs


class BlendRoom(NamedTuple):
    """Work arrays for a blend of N axes: states at its ends and at the joint, (N,); polynomials of a segment over half
    of the blend, of a part of this half, of the difference, and of the blend itself, shape (N, 8).
    """

    a: Records[State]
    b: Records[State]
    joint: Records[State]
    half: Floats2
    part: Floats2
    difference: Floats2
    blended: Floats2


class Blend(NamedTuple):
    """A blend: its length on each segment L, its parameter length B, and a bound on its distance to the segments, m; 0
    without a blend.
    """

    length: float
    span: float
    deviation: float


NO_BLEND = Blend(0.0, 0.0, 0.0)


def blend_room(axes: int) -> BlendRoom:
    """Return work arrays for blends."""
    return BlendRoom(*(rows_for(State, axes) for _ in range(3)), *(np.zeros((axes, 8)) for _ in range(4)))


@kernel
def state_near(piece: Piece, away: float, at_end: bool, out: Records[State]) -> int:
    """Write r relative to the end or the start of a segment, and r', r'', r''' at the distance `away` from it, into
    `out`; a positive `away` points along the path.
    """
    shape = piece.shape
    if piece.kind == 0:
        for i in range(len(shape)):
            slope = line_way(shape, i) / piece.length
            out[i] = State(away * slope, slope, 0.0, 0.0)
        return 0
    kappa = arc_axis(shape, 0).curvature
    s0, v0 = turned(kappa * piece.length if at_end else 0.0)
    c0 = 1.0 - v0
    s, v = turned(kappa * away)
    c = 1.0 - v
    for i in range(len(shape)):
        axis = arc_axis(shape, i)
        e1 = axis.E1 * c0 + axis.E2 * s0
        e2 = axis.E2 * c0 - axis.E1 * s0
        cosine = e2 * c - e1 * s
        sine = e1 * c + e2 * s
        out[i] = State(
            e2 * s - e1 * v + axis.slope * away,
            kappa * cosine + axis.slope,
            -kappa * kappa * sine,
            -kappa * kappa * kappa * cosine,
        )
    return 0


@kernel
def trimmed(piece: Piece, x0: float, x1: float, out: Floats2) -> float:
    """Write the part of a segment between x0 and x1 into `out`; return the length of this part."""
    rest = x1 - x0
    if piece.kind == 0:
        for i in range(len(out)):
            put_line(out, i, line_way(piece.shape, i) / piece.length * rest)
        return rest
    if piece.kind == 2:  # whole
        for i in range(len(out)):
            for k in range(8):
                out[i, k] = piece.shape[i, k]
        return rest
    s, v = turned(arc_axis(piece.shape, 0).curvature * x0)
    c = 1.0 - v
    for i in range(len(out)):
        e1, e2, slope, curvature = arc_axis(piece.shape, i)
        put_arc(out, i, ArcAxis(e1 * c + e2 * s, e2 * c - e1 * s, slope, curvature))
    return rest


@kernel
def part_of(c: Floats, begin: float, size: float, out: Floats) -> int:
    """Write the coefficients in η of Σ c_k ξᵏ with ξ = begin + size η, including the constant term, into `out`: a
    Taylor shift.
    """
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
def _arc_error(piece: Piece, L: float) -> float:
    """Bound the distance between the end of a segment of length L and its polynomial of seventh degree."""
    arc = arc_axis(piece.shape, 0).curvature
    if piece.kind != 1 or arc <= 0.0:
        return 0.0
    radius = 0.0
    for i in range(len(piece.shape)):
        e = arc_axis(piece.shape, i).E1
        radius = radius + e * e
    angle = 0.5 * arc * L
    error = angle * angle
    error = error * error
    return sqrt(radius) * error * error / 40320.0


@kernel
def _half_apart(side: int, error: float, room: BlendRoom) -> float:
    """Bound the distance between one half of a blend and the polynomial of its segment in `room.half`, which is within
    `error` of this segment.
    """
    most = 0.0
    # r relative to the joint: the polynomials omit their constant term
    for part in range(_PARTS):
        size = 1.0 / _PARTS
        for i in range(len(room.half)):
            start = room.a[i].value
            of_segment = room.part[i]
            difference = room.difference[i]
            part_of(room.half[i], part * size, size, of_segment)
            of_segment[0] = of_segment[0] + (start if side == 0 else 0.0)
            part_of(room.blended[i], 0.5 * side + 0.5 * part * size, 0.5 * size, difference)
            difference[0] = difference[0] + start
            for k in range(8):
                difference[k] = difference[k] - of_segment[k]
        most = max(most, largest_norm(room.difference) + error)
    return most


@kernel
def blend_at(one: Piece, two: Piece, L: float, factor: float, room: BlendRoom) -> float:
    """Write the blend that starts L before a joint into `room.blended`; return a bound on its distance to the
    segments, m.
    """
    state_near(one, -L, True, room.a)
    state_near(two, L, False, room.b)
    hermite(room.a, room.b, factor * L, room.blended)
    # each half has its own segment, and both are polynomials of one parameter there, so that they can be subtracted
    state_near(one, 0.0, True, room.joint)
    hermite(room.a, room.joint, L, room.half)
    most = _half_apart(0, _arc_error(one, L), room)
    state_near(two, 0.0, False, room.joint)
    hermite(room.joint, room.b, L, room.half)
    return max(most, _half_apart(1, _arc_error(two, L), room))


@kernel
def blend(
    one: Piece, two: Piece, cosine: float, longest: float, tolerance: float, straight: bool, room: BlendRoom
) -> Blend:
    """Find the longest blend up to `longest` that provably stays within `tolerance`; it is written into
    `room.blended`.
    """
    factor = 1.4 + 0.3 * (1.0 + cosine)
    away = longest
    most = blend_at(one, two, away, factor, room)
    if most <= tolerance:
        return Blend(away, factor * away, most)
    low = 0.0
    high = away
    for _ in range(_SEARCH):
        # the distance grows with away at a corner, and with its square where only the curvature jumps
        ratio = 0.999 * tolerance / most
        guess = away * (ratio if straight else sqrt(ratio))
        if guess <= low or guess >= high:
            guess = 0.5 * (low + high)
        away = guess
        most = blend_at(one, two, away, factor, room)
        if most <= tolerance:
            low = away
            # close enough: of a blend for a jump of curvature alone, 5 % less length would halve the speed
            if most >= 0.995 * tolerance:
                break
        else:
            high = away
        if high - low <= 1e-4 * high:
            break
    if low == 0.0:
        return NO_BLEND
    if low != away:
        away = low
        most = blend_at(one, two, away, factor, room)
    return Blend(away, factor * away, most)


@kernel
def _agree(size: float, apart: float, scale: float) -> bool:
    """Return True if two derivatives are the same up to rounding; `scale` is the length to the power of their order
    less 1.
    """
    return apart * scale <= _SAME * (1.0 + size * scale)


@kernel
def goes_on(one: Piece, two: Piece, a: Records[Derivatives], b: Records[Derivatives]) -> bool:
    """Return True if r' .. r''' agree on both sides of the joint of two segments, up to rounding."""
    derivatives(one.kind, one.length, one.shape, one.length, a)
    derivatives(two.kind, two.length, two.shape, 0.0, b)
    size1 = size2 = size3 = 0.0
    apart1 = apart2 = apart3 = 0.0
    for i in range(len(a)):
        _, a1, a2, a3, _ = a[i]
        _, b1, b2, b3, _ = b[i]
        size1 = max(size1, abs(a1))
        size2 = max(size2, abs(a2))
        size3 = max(size3, abs(a3))
        apart1 = max(apart1, abs(a1 - b1))
        apart2 = max(apart2, abs(a2 - b2))
        apart3 = max(apart3, abs(a3 - b3))
    return (
        _agree(size1, apart1, 1.0)
        and _agree(size2, apart2, one.length)
        and _agree(size3, apart3, one.length * one.length)
    )


_LETTERS = AXES.upper()
_COUNTED = ((0, 1, 2), (6, 7, 8), (3, 4, 5))
"""The groups of axes to which a feed can refer; the first group with a moving axis is used."""
# so that memory does not grow with the program
AT_ONCE = 1000  # largest number of segments of a chain
_STANDS = 1e-11  # m, or rad: blocks of 1e-9 mm stand, and rounded positions too
_CHORDS = 0.1  # of the tolerance: largest deviation of a spline's chords from it
_CUTS = 16  # number of pieces of a spline that is followed exactly

Going = Straight | Arc | Spline
"""The moves along a path."""


class Chain(NamedTuple):
    """Consecutive segments without a programmed stop between them.

    tolerance  tolerance of the joint after each segment, m; 0: stop unless the joint is smooth
    ends       True if such a stop follows; otherwise the next chain continues this one
    modes      path mode (see `PathMode`) of the stricter move at each joint, if it requires a stop there; empty if the
               joint has a tolerance
    weights    the length by which one m or rad of each axis was multiplied, m, shape (N,); None: 1 (no rotary axis)
    tip        the tool whose tip the segments move, and whose speed is their feed; None: they move the axes
    turns      True if the tip stands, so that the feed is that of the angles, rad/s
    chords     largest distance of chords from the splines for which they stand, next to each joint, m
    off        largest angle of the tool from its programmed direction, next to each joint, rad
    """

    segments: Pieces
    tolerance: np.ndarray
    ends: bool
    modes: Sequence[str] = ()
    weights: np.ndarray | None = None
    tip: TipColumns | None = None
    turns: bool = False
    chords: Sequence[float] = ()
    off: Sequence[float] = ()


class _Segment(NamedTuple):
    """A row of `Pieces`, with path mode and tolerance (m) of its joints; a line has no shape, only its displacement.

    chord  distance from the spline for which it stands, m
    off    angle of the tool from its programmed direction, rad
    """

    kind: int
    length: float
    start: list[float]
    way: list[float]
    speed: float
    line: int
    mode: str
    tolerance: float
    shape: np.ndarray | None = None
    chord: float = 0.0
    off: float = 0.0


class _Collected:
    """The segments collected so far for the next chain."""

    def __init__(self) -> None:
        self.rows: list[_Segment] = []

    def chain(self, ends: bool, weights: np.ndarray | None) -> Chain:
        """Return the collected segments as a chain; unless it `ends`, the last one is retained for the next chain."""
        # the joint after the last segment depends on the next one
        count = len(self.rows) - (0 if ends else 1)
        kind, length, start, way, feed, line, modes, tolerances, _, *errors = zip(*self.rows, strict=True)
        origin = np.array(start[:count])
        shape = line_shapes(np.array(way[:count]))
        for k, row in enumerate(self.rows[:count]):
            if row.shape is not None:
                shape[k] = row.shape
        kinds, lengths, feeds, lines = (np.array(column[:count]) for column in (kind, length, feed, line))
        pieces = Pieces(kinds, lengths, origin, shape, feeds, lines)
        # a joint keeps the stricter of the modes before and behind it
        tolerance = np.array(tolerances)
        stricter = tolerance[1:] < tolerance[:-1]
        joints = [modes[k + 1] if k < len(stricter) and stricter[k] else modes[k] for k in range(count)]
        tolerance[:-1] = np.minimum(tolerance[:-1], tolerance[1:])
        largest = np.array(errors)
        largest[:, :-1] = np.maximum(largest[:, :-1], largest[:, 1:])
        chords, off = largest[:, :count].tolist()
        del self.rows[:count]
        return Chain(pieces, tolerance[:count], ends, joints, weights, chords=chords, off=off)


class _Feeds:
    """The feed of moves, as set by the feed and spindle commands so far."""

    def __init__(self, axes: str) -> None:
        self._one = set(axes) <= set("XYZ")  # way of counting
        self.feed = Feed(Line("", 0, ""), 0.0, 0.0)
        self.of_tip = False  # True if it is the speed of the tip
        self.turns = 0.0  # spindle speed, 1/s; 0 at standstill

    def speed(self, move: Going, length: float) -> float:
        """Return the largest path speed, m/s, of a move whose path length in all axes is `length`."""
        if isinstance(move, Straight) and move.traverse:
            return math.inf
        counted, others = (_COUNTED[0], False) if self._one else _counted(move)
        feed = self.feed.angular if counted == _COUNTED[-1] else self.feed.linear
        if self.feed.per_turn:
            if not self.turns:
                raise _refused(
                    move.source, "G95 is a feed for each turn of the spindle, which stands: write S and M3 before"
                )
            feed *= self.turns
        if not feed > 0.0:
            raise _refused(move.source, "the feed is 0: write F in this block or before")
        if self.of_tip:
            return feed
        # the speed is planned along all axes: it is scaled so that the counted ones move at the feed
        return feed * length / _length(move, counted) if others or counted == _COUNTED[-1] else feed


def chains(
    moves: Iterable[Move],
    axes: str,
    angle_tolerance: ArrayLike = ANGLE_TOLERANCE,
    spending: Spending | None = None,
) -> Iterator[Chain | Pause]:
    """Yield the chains of a program and the pauses between them.

    A program that turns axes stops where its tolerance changes, since angles are then weighted anew.

    axes             letters of the machine's axes, such as XYZ
    angle_tolerance  tolerance of each axis, rad, one number or shape (N,); that of linear axes has no effect
    spending         counts motion and processor time, and refuses too much; None: nothing does

    Raises ProgramError for unsupported moves: axes that the machine does not have, spindle-synchronized moves (G33),
    and what `spending` refuses.
    """
    columns = [_LETTERS.index(letter) for letter in axes]
    turning = [_LETTERS.index(letter) for letter in axes if letter in ROTARY]
    weights = Weights(axes, angle_tolerance)
    absent = [k for k, letter in enumerate(_LETTERS) if letter not in axes]
    collected, feeds, mode = _Collected(), _Feeds(axes), "continuous"
    stops = False  # True if the previous move requires a stop after it
    tip: TipColumns | None = None
    still = False  # True if the tip stands in the moves collected, while angles change at the feed

    def collect(ends: bool) -> Chain:
        return collected.chain(ends, weights.values)._replace(tip=tip, turns=still)

    for move in moves:
        if isinstance(move, Going):
            for column in absent:
                if move.start[column] != move.end[column]:
                    letter = _LETTERS[column]
                    reason = f"the machine has no axis {letter}; it has {', '.join(axes)}"
                    raise located(move.source, BlockError(reason, letter))
            turns = any(move.start[column] != move.end[column] for column in turning)
            exact = stops or mode == "exact_stop"
            stands = tip is not None and _only_turns(move)
            if collected.rows and (exact or stands != still or not weights.fit(turns)):
                yield collect(True)
                why = "ExactStop" if exact else "Turn" if stands != still else "Tolerance"
                yield Pause(0.0, why, move.source.number)
            still = stands
            stops = mode == "exact_stop"
            if not collected.rows:
                weights.begin()
            tolerance = weights.tolerance_of(turns, move.off)
            if isinstance(move, Straight) and move.orientation != "axes" and turns and tip is not None:
                segments = _turning(move, columns, weights, feeds, mode, tip)
            else:
                segments = _segments(move, columns, weights.values, feeds, mode, tolerance)
            for segment in segments:
                if move.off > segment.off:
                    segment = segment._replace(off=move.off)
                if spending:
                    spending.move(move.source, segment.length / segment.speed, "F")
                collected.rows.append(segment)
                if len(collected.rows) > AT_ONCE:
                    yield collect(False)
        elif isinstance(move, PathMode):
            # G61 and G64 without P allow no deviation: both stop at each corner, for different reasons
            tolerance = move.tolerance if move.mode == "continuous" else 0.0
            weights.allow(tolerance)
            mode = "" if tolerance else move.mode
        elif isinstance(move, Feed):
            feeds.feed = move
        elif isinstance(move, ToolPoint):
            if collected.rows:
                yield collect(True)
            yield Pause(0.0, "ToolPoint", move.source.number)
            tip = None if move.kinematics is None else TipColumns.of(move.kinematics, axes)
            weights.aim(0.0 if tip is None else tip.kinematics.cosine_of_axes)
            feeds.of_tip, still = tip is not None, False
        elif isinstance(move, Synchronized):
            reason = (
                "a move that follows the spindle begins at an index of the real one, which is not known before: take "
                "it out of what is planned, or write G95 for a feed by the turn"
            )
            raise located(move.source, BlockError(reason, "G33"))
        elif isinstance(move, Dwell | Stop | ToolChange | Spindle | Switch | End):
            if isinstance(move, Spindle):
                feeds.turns = abs(move.direction) * move.spindle_speed / 60.0
            if collected.rows:
                yield collect(True)
            if spending and isinstance(move, Dwell):
                spending.move(move.source, move.duration, "P")
            if not isinstance(move, End):
                duration = move.duration if isinstance(move, Dwell) else 0.0
                yield Pause(duration, type(move).__name__, move.source.number)
    if collected.rows:
        yield collect(True)


def _only_turns(move: Going) -> bool:
    """Return True for a feed that turns axes and leaves all others where they are."""
    if isinstance(move, Arc) or (isinstance(move, Straight) and move.traverse):
        return False
    # a change to the tip of the tool and back rounds positions
    same = [all(abs(x - start) <= _STANDS for x in others) for start, *others in _coordinates(move)]
    return all(same[axis] for axes in _COUNTED[:2] for axis in axes) and not all(same)


def _segments(
    move: Going, columns: Sequence[int], weights: np.ndarray | None, feeds: _Feeds, mode: str, tolerance: float
) -> Iterator[_Segment]:
    """Yield the segments of a move, none for zero length; `columns` are the point indices of the machine's axes."""
    number = move.source.number
    start = [move.start[column] for column in columns]
    way = [move.end[column] - move.start[column] for column in columns]
    if weights is not None:
        start, way = (np.array(start) * weights).tolist(), (np.array(way) * weights).tolist()
    if isinstance(move, Straight):
        length = math.hypot(*way)
        if length > 0.0:
            yield _Segment(LINE, length, start, way, feeds.speed(move, length), number, mode, tolerance)
    elif isinstance(move, Arc):
        length, shape = _arc(move, start, way, columns)
        yield _Segment(ARC, length, start, way, feeds.speed(move, length), number, mode, tolerance, shape)
    else:
        yield from _spline(move, columns, weights, feeds, mode, tolerance)


def _turning(
    move: Straight, columns: Sequence[int], weights: Weights, feeds: _Feeds, mode: str, tip: TipColumns
) -> Iterator[_Segment]:
    """Yield a straight move of the tip in which the tool turns in a plane: within a tenth of the tolerance of the
    direction as lines on which the joints move straight; without a tolerance as polynomials that follow its arc.
    """
    kinematics, letters = tip.kinematics, tip.kinematics.rotary_letters
    places = [_LETTERS.index(letter) for letter in letters]
    begin, end = ([point[place] for place in places] for point in (move.start, move.end))
    start, way = np.array(move.start), np.array(move.end) - np.array(move.start)
    try:
        if not weights.angle:
            curves = along_arc(kinematics, begin, end, move.orientation)
            yield from _curved(move, curves, columns, weights, feeds, mode, tip)
            return
        parts = in_plane(kinematics, begin, end, move.orientation, _CHORDS * weights.angle)
    except UnreachableError as error:
        raise _refused(move.source, str(error)) from None
    # directions at both ends that are off move those between by more
    off = parts.off + move.off / math.cos(0.5 * min(parts.angle, math.pi))
    tolerance = weights.tolerance_of(True, off)
    points = start + parts.share[:, None] * way
    points[1:-1, places] = parts.rotary.T
    points[-1] = move.end
    for here, there in pairwise(points.tolist()):
        part = replace(move, start=tuple(here), end=tuple(there))
        for segment in _segments(part, columns, weights.values, feeds, mode, tolerance):
            yield segment._replace(off=off)


def _curved(
    move: Straight, curves: Curves, columns: Sequence[int], weights: Weights, feeds: _Feeds, mode: str, tip: TipColumns
) -> Iterator[_Segment]:
    """Yield a straight move of the tip along which the rotary joints follow polynomials."""
    scale = np.ones(len(columns)) if weights.values is None else weights.values
    start, end = (np.array([point[column] for column in columns]) * scale for point in (move.start, move.end))
    turns = list(tip.rotary)
    sizes, way = np.diff(curves.share), end - start
    # the rotary joints go a longer way than straight
    straight = np.delete(way, turns)
    bent = np.abs(curves.shape).sum(axis=2) * scale[turns]
    whole = math.hypot(float(np.linalg.norm(straight)), *bent.sum(axis=0))
    speed, tolerance = feeds.speed(move, whole), weights.tolerance_of(True)
    for share, size, origin, polynomial in zip(curves.share[:-1], sizes, curves.origin, curves.shape, strict=True):
        shape, begin = line_shapes(size * way[None])[0], start + share * way
        shape[turns], begin[turns] = polynomial * scale[turns, None], origin * scale[turns]
        # the parameter of a run is the share, so that the joints go on smoothly from part to part
        yield _Segment(
            POLYNOMIAL,
            whole * size,
            begin.tolist(),
            way.tolist(),
            speed,
            move.source.number,
            mode,
            tolerance,
            shape,
            off=curves.off,
        )


def _spline(
    move: Spline, columns: Sequence[int], weights: np.ndarray | None, feeds: _Feeds, mode: str, tolerance: float
) -> Iterator[_Segment]:
    """Yield a spline as chords within a tenth of the tolerance; without a tolerance, yield the exact curve, which
    starts and ends at rest.

    The chords of n equal steps are within max|B''| / (8 n²) of a Bezier curve B(0..1).
    """
    scale = np.ones(len(columns)) if weights is None else weights
    points = np.array([[point[column] for column in columns] for point in (move.start, *move.points, move.end)]) * scale
    start, speed = points[0].tolist(), feeds.speed(move, _polygon(points))
    shape = np.zeros((len(columns), 8))
    curve = _bezier(points)
    shape[:, 1:4] = np.stack(curve, axis=1)
    bent = 2.0 * max(float(np.linalg.norm(curve.second)), float(np.linalg.norm(curve.second + 3.0 * curve.third)))
    near = _CHORDS * tolerance
    count = max(1, math.ceil(math.sqrt(bent / (8.0 * near)))) if near else _CUTS
    number, here, piece = move.source.number, np.zeros(len(columns)), np.zeros_like(shape)
    # an estimate suffices: the length only scales the parameter, and |r'| need not be 1
    whole = float(np.sum(np.linalg.norm(np.diff([_at(curve, k / 64.0) for k in range(65)], axis=0), axis=1)))
    for k in range(count):
        there = _at(curve, (k + 1) / count)
        way = (there - here).tolist()
        if near:
            length = math.hypot(*way)
            if length > 0.0:
                begin = [*map(sum, zip(start, here.tolist(), strict=True))]
                # the deviation of the chords is subtracted from the tolerance of the joints
                yield _Segment(LINE, length, begin, way, speed, number, mode, tolerance - near, chord=near)
        elif whole > 0.0:
            for of, into in zip(shape, piece, strict=True):
                part_of.python(of, k / count, 1.0 / count, into)
            origin = [coordinate + float(row[0]) for coordinate, row in zip(start, piece, strict=True)]
            piece.T[0] = 0.0
            yield _Segment(POLYNOMIAL, whole / count, origin, way, speed, number, mode, tolerance, piece.copy())
        here = there


class _Bezier(NamedTuple):
    """The coefficients of first to third degree of a Bezier curve, relative to its start, shape (N,)."""

    first: np.ndarray
    second: np.ndarray
    third: np.ndarray


def _bezier(points: np.ndarray) -> _Bezier:
    """Return the coefficients of a Bezier curve of three or four points, shape (3 or 4, N)."""
    start, *others = points
    one, two, *rest = (point - start for point in others)
    if not rest:
        return _Bezier(2.0 * one, two - 2.0 * one, np.zeros_like(start))
    (three,) = rest
    return _Bezier(3.0 * one, 3.0 * (two - 2.0 * one), three - 3.0 * (two - one))


def _at(curve: _Bezier, x: float) -> np.ndarray:
    return x * (curve.first + x * (curve.second + x * curve.third))


def _counted(move: Going) -> tuple[tuple[int, ...], bool]:
    """Return the axes to which the feed refers, and True if other axes move as well."""
    moved = [any(x != start for x in others) for start, *others in _coordinates(move)]
    if isinstance(move, Arc):
        moved[:3] = True, True, True
    first = next((axes for axes in _COUNTED if any(moved[axis] for axis in axes)), _COUNTED[0])
    return first, any(moved[axis] for axis in range(9) if axis not in first)


def _coordinates(move: Going) -> Iterator[tuple[float, ...]]:
    """Yield the coordinates of each axis at the start, the control points of a spline, and the end of a move."""
    return zip(move.start, *(move.points if isinstance(move, Spline) else ()), move.end, strict=True)


def _polygon(points: np.ndarray) -> float:
    """Return the length of the lines through points, shape (n, N)."""
    return float(np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _length(move: Going, axes: tuple[int, ...]) -> float:
    """Return the length of a move along some axes; of a spline, that of its control polygon."""
    if isinstance(move, Spline):
        return _polygon(np.array([[point[axis] for axis in axes] for point in (move.start, *move.points, move.end)]))
    plane = move.axes[:2] if isinstance(move, Arc) else ()
    rest = [move.end[axis] - move.start[axis] for axis in axes if axis not in plane]
    return math.hypot(*rest, move.angle * move.radius if isinstance(move, Arc) else 0.0)


def _arc(move: Arc, start: list[float], way: list[float], columns: Sequence[int]) -> tuple[float, np.ndarray]:
    """Return the length and shape of an arc, as in `Pieces`."""
    angle = move.angle
    first, second = (columns.index(axis) for axis in move.axes[:2])
    center_first, center_second = move.center
    x, y = start[first] - center_first, start[second] - center_second
    sense = math.copysign(1.0, angle)
    E1, E2 = [0.0] * len(columns), [0.0] * len(columns)
    E1[first], E1[second] = x, y
    E2[first], E2[second] = -sense * y, sense * x
    # 1 - cos without cancellation
    s, versine = math.sin(abs(angle)), 2.0 * math.sin(0.5 * angle) ** 2
    # programs round the end of an arc: its distance from the circle is spread linearly, as are the other axes
    drift = [there - (e2 * s - e1 * versine) for there, e1, e2 in zip(way, E1, E2, strict=True)]
    straight = math.hypot(*[each for axis, each in enumerate(drift) if axis not in (first, second)])
    length = math.hypot(math.hypot(x, y) * abs(angle), straight)
    return length, arc_shape(E1, E2, [each / length for each in drift], abs(angle) / length)


def _refused(line: Line, reason: str) -> ProgramError:
    return located(line, BlockError(reason, index=0))
