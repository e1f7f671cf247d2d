"""Clusters: lines so short that the blends at their joints would overlap, smoothed by one spline.

Within the tolerance P the blend of a corner with turning angle θ extends over L = P / (0.156 · 2 sin θ/2) of both
lines.  If that is more than half of the shorter line, the joint belongs to a cluster.  The knots of the spline are
initially 10 mm apart; they are refined where S deviates too far from the lines, until the bound on the distance is
within the tolerance.

The spline has fifth degree and follows the polyline f(u): Schoenberg's variation-diminishing spline.

    S(u) = Σ f(x_i) N_i(u),    x_i = (τ_{i+1} + ... + τ_{i+5}) / 5

with B-splines N_i on the knots τ.  Straight parts are reproduced exactly, |S'| <= 1, no system has to be solved, and a
change of f or of a knot affects S only in its neighborhood.  Beyond its ends f is extended by point reflection, so that
S begins and ends on f.  The distance |S - f| is bounded on each interval between knots and corners, where both are
polynomials, by the convex hull of the Bernstein points.

Source: Schoenberg 1967, On spline functions; de Boor 1978, A practical guide to splines.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints, Records, Records2, rows_for, zeros
from feeddrive.path.geometry.hermite import State, hermite
from feeddrive.path.geometry.segments import largest_norm, part_of
from feeddrive.path.motion import Piece, Pieces, less_line, line_way, put_line

ENDS = 5  # number of knots beyond each end
GRADE = 0.35  # growth of the step per distance
FITTED = 20  # number of steps before the end that are adapted to it
_QUARTERS = 4  # subdivisions of an interval whose hull is too wide


class Goals(NamedTuple):
    """Limits of the step between knots at increasing positions, m."""

    at: Floats
    step: Floats


class Lines(NamedTuple):
    """The lines of a chain, of which a cluster consists, and what `fitted` knows of them.

    corner     u at the start of each line, and the end of the last, m
    group      equal numbers for consecutive lines of the same direction
    slope      direction, shape (n, N)
    tolerance  of each line, m: the smaller of the tolerances at its two joints
    far        bound on the distance to each line, m
    """

    pieces: Pieces
    corner: Floats
    group: Ints
    slope: Floats2
    tolerance: Floats
    far: Floats


class Fit(NamedTuple):
    """The spline of a cluster: knots and, for each of these, control points and polynomials.

    x         Greville abscissas, m
    control   values of f there
    segment   segment on which each x, or its mirror image, lies
    straight  equal numbers for neighboring abscissas if f is straight between them
    state     S - f(x_{e-3}) and the first three derivatives of S at knot e
    curved    0 for a straight span after a knot
    curve     polynomial of this span, otherwise
    """

    knots: Floats
    x: Floats
    control: Floats2
    segment: Ints
    straight: Ints
    state: Records2[State]
    curved: Ints
    curve: Floats3


class Room(NamedTuple):
    """Work arrays of `fitted`.

    goals, more    limits of the steps between knots, of this round and of the next
    a, b           states at the ends of a span, (N,)
    piece, rest    polynomials, shape (N, 8)
    before, behind, here  directions, shape (N,)
    """

    goals: Goals
    more: Goals
    a: Records[State]
    b: Records[State]
    piece: Floats2
    rest: Floats2
    before: Floats
    behind: Floats
    here: Floats


@kernel
def envelope(given: Goals, count: int, active: Goals) -> int:
    """Write the step limits that are active into `active`; return their number.

    The step size may grow from each position by at most GRADE times the distance; a limit above this bound is never
    active and is omitted. The first position is always included.
    """
    at = active.at
    goal = active.step
    at[0] = given.at[0]
    goal[0] = given.step[0]
    many = 1
    for k in range(1, count):
        u = given.at[k]
        step = given.step[k]
        if step >= goal[many - 1] + GRADE * (u - at[many - 1]):
            continue
        while many > 1 and goal[many - 1] >= step + GRADE * (u - at[many - 1]):
            many = many - 1
        if many == 1:
            goal[0] = min(goal[0], step + GRADE * (u - at[0]))
        at[many] = u
        goal[many] = step
        many = many + 1
    return many


@kernel
def place_knots(goals: Goals, many: int, largest: float, total: float, fixed: int, most: int, knots: Floats) -> int:
    """Place knots up to `total`, mirrored beyond the ends, so that the distances between them follow the goals; return
    the number of these steps.

    If the first `fixed` steps are fixed, all knots up to knots[ENDS + fixed], the first goal, are inputs.  Otherwise
    knots[ENDS] is 0.  There are at least five steps, provided that `largest` is at most total/6; the result is 0 if
    more than `most` are required.
    """
    at = goals.at
    goal = goals.step
    if fixed == 0:
        knots[ENDS] = 0.0
    u = knots[ENDS + fixed]
    p = 0
    count = fixed
    step = 0.0
    while u < total:
        # the goal is that at the middle of the step, which depends on the step: a fixed-point iteration, whose error
        # falls by GRADE/2 in each pass
        step = min(largest, goal[p] + GRADE * (u - at[p]))
        for _ in range(6):
            middle = u + 0.5 * step
            q = p
            while q + 1 < many and at[q + 1] < middle:
                q = q + 1
            step = min(largest, goal[q] + GRADE * (middle - at[q]))
            if q + 1 < many:
                step = min(step, goal[q + 1] + GRADE * (at[q + 1] - middle))
        u = u + step
        count = count + 1
        if count > most:
            return 0
        knots[ENDS + count] = u
        while p + 1 < many and at[p + 1] < u:
            p = p + 1
    # the last steps are shortened to fit the end, longer ones by more
    first = max(fixed, count - FITTED)
    squares = 0.0
    for k in range(first, count):
        step = knots[ENDS + k + 1] - knots[ENDS + k]
        squares = squares + step * step
    rest = (u - total) / squares
    before = knots[ENDS + first]
    u = before
    for k in range(first, count):
        step = knots[ENDS + k + 1] - before
        before = knots[ENDS + k + 1]
        u = u + step * (1.0 - rest * step)
        knots[ENDS + k + 1] = u
    knots[ENDS + count] = total
    for k in range(1, ENDS + 1):
        if fixed == 0:
            knots[ENDS - k] = -knots[ENDS + k]
        knots[ENDS + count + k] = 2.0 * total - knots[ENDS + count - k]
    return count


@kernel
def control_points(lines: Lines, first: int, last: int, total: float, count: int, fit: Fit) -> int:
    """Compute the control points for `count` steps between the knots."""
    knots = fit.knots
    corner = lines.corner
    k = first
    for i in range(count + ENDS):
        here = 0.2 * (knots[i + 1] + knots[i + 2] + knots[i + 3] + knots[i + 4] + knots[i + 5])
        fit.x[i] = here
        inside = min(abs(here), 2.0 * total - here) if here > total or here < 0.0 else here
        while k < last and corner[k + 1] < inside:
            k = k + 1
        while k > first and corner[k] > inside:
            k = k - 1
        fit.segment[i] = k
        fit.straight[i] = lines.group[k]
        end = -1
        if here < 0.0:
            end = first
        elif here > total:
            end = last
        for n in range(len(lines.slope[0])):
            control = lines.pieces.origin[k, n] + lines.slope[k, n] * (inside - corner[k])
            if end >= 0:
                ends = total if here > 0.0 else 0.0
                turn = lines.pieces.origin[end, n] + lines.slope[end, n] * (ends - corner[end])
                control = 2.0 * turn - control
            fit.control[i, n] = control
        if end >= 0 and lines.group[k] != lines.group[end]:
            # numbers that occur nowhere else: the mirror image of another line is parallel to it, but not on it
            fit.straight[i] = -1 - lines.group[k] if here < 0.0 else -2 - lines.group[last] - lines.group[k]
    return 0


@kernel
def states(lines: Lines, count: int, fit: Fit) -> int:
    """Compute the state at each knot from differences of control points (de Boor).

    If all relevant control points lie on one line, the results are exactly those of the line.
    """
    knots = fit.knots
    q = zeros(5)
    move = zeros(5)
    value = zeros(4)
    axes = len(lines.slope[0])
    for e in range(ENDS, ENDS + count + 1):
        here = knots[e]
        same = True
        for i in range(e - 4, e):
            same = same and fit.straight[i] == fit.straight[i - 1]
        k = fit.segment[e - 3]
        if same:
            for n in range(axes):
                fit.state[e, n] = State(lines.slope[k, n] * (here - fit.x[e - 3]), lines.slope[k, n], 0.0, 0.0)
            continue
        for n in range(axes):
            for m in range(1, 5):
                i = e - 5 + m
                # along one line from its slope: differences of absolute coordinates would bend it by their rounding
                if fit.straight[i] == fit.straight[i - 1]:
                    move[m] = lines.slope[fit.segment[i], n] * (fit.x[i] - fit.x[i - 1])
                else:
                    move[m] = fit.control[i, n] - fit.control[i - 1, n]
            # control points from that of e - 3, then their differences
            for derivative in range(4):
                degree = 5 - derivative
                if derivative == 0:
                    _from_third(move, q)
                elif derivative == 1:
                    for m in range(1, 5):
                        i = e - 5 + m
                        move[m] = 5.0 * move[m] / (knots[i + 5] - knots[i])
                        q[m] = move[m]
                else:
                    for back in range(degree):
                        m = 4 - back
                        i = e - 5 + m
                        move[m] = (degree + 1) * (move[m] - move[m - 1]) / (knots[i + degree + 1] - knots[i])
                        q[m] = move[m]
                for level in range(1, degree):
                    for back in range(degree - level):
                        m = 4 - back
                        i = e - 5 + m
                        share = (here - knots[i]) / (knots[i + degree + 1 - level] - knots[i])
                        q[m] = q[m - 1] + share * (q[m] - q[m - 1])
                value[derivative] = q[-1]
            value0, value1, value2, value3 = value
            fit.state[e, n] = State(value0, value1, value2, value3)
    return 0


@kernel
def _from_third(move: Floats, q: Floats) -> int:
    """Write the positions of five points relative to the third into `q`; move[m] leads from point m - 1 to point m."""
    for m in range(5):
        q[m] = 0.0
    for back in range(2):
        m = 1 - back
        q[m] = -move[m + 1] if back == 0 else q[m + 1] - move[m + 1]
    for m in range(3, 5):
        q[m] = move[m] if m == 3 else q[m - 1] + move[m]
    return 0


@kernel
def spline_span(lines: Lines, e: int, fit: Fit, room: Room) -> bool:
    """Compute the polynomial of the span after knot e; return False without writing if the span is straight."""
    same = True
    for i in range(e - 4, e + 1):
        same = same and fit.straight[i] == fit.straight[i - 1]
    if same:
        return False
    for n in range(len(lines.slope[0])):
        move = fit.control[e - 2, n] - fit.control[e - 3, n]
        if fit.straight[e - 2] == fit.straight[e - 3]:
            move = lines.slope[fit.segment[e - 2], n] * (fit.x[e - 2] - fit.x[e - 3])
        left = fit.state[e, n]
        right = fit.state[e + 1, n]
        room.a[n] = left._replace(value=0.0)
        room.b[n] = right._replace(value=(right.value - left.value) + move)
    hermite(room.a, room.b, fit.knots[e + 1] - fit.knots[e], fit.curve[e])
    return True


class Deviation(NamedTuple):
    """The largest ratio of |S - f| to the tolerance on a span, its position (a knot or a corner), and the last line
    reached.
    """

    share: float
    where: float
    line: int


@kernel
def deviation(lines: Lines, e: int, first: int, last: int, bounded: bool, fit: Fit, room: Room) -> Deviation:
    """Return the deviation on the span after knot e, and update the distances `lines.far`.

    The ratio is a bound if `bounded`, otherwise the maximum over the knots and corners.  The search for the line of the
    span starts at `first`.
    """
    corner = lines.corner
    shape = fit.curve[e]
    n = len(lines.slope[0])
    begin = fit.knots[e]
    end = fit.knots[e + 1]
    length = end - begin
    k = first
    while k < last and corner[k + 1] <= begin:
        k = k + 1
    squares = 0.0
    for i in range(n):
        at = lines.pieces.origin[k, i] + lines.slope[k, i] * (begin - corner[k])
        # the large coordinates cancel before the small state is added
        rest = room.rest[i]
        rest[0] = (fit.control[e - 3, i] - at) + fit.state[e, i].value
        squares = squares + rest[0] * rest[0]
    most = 0.0
    u = begin
    where = begin
    while True:
        until = end if k == last else min(end, corner[k + 1])
        tolerance = lines.tolerance[k]
        before = squares
        squares = 0.0
        if bounded:
            for i in range(n):
                rest = room.rest[i]
                start = rest[0]
                part_of(shape[i], (u - begin) / length, (until - u) / length, rest)
                rest[0] = start
                less_line(room.rest, i, lines.slope[k, i] * (until - u))
            bound = largest_norm(room.rest)
            # one hull is cheap, but too wide on long intervals: subdivided only where it does not suffice
            if bound > tolerance:
                bound = 0.0
                for part in range(_QUARTERS):
                    for i in range(n):
                        part_of(room.rest[i], part / _QUARTERS, 1.0 / _QUARTERS, room.piece[i])
                    bound = max(bound, largest_norm(room.piece))
            for i in range(n):
                rest = room.rest[i]
                over = 0.0
                for m in range(8):
                    over = over + rest[m]
                rest[0] = over
                squares = squares + over * over
        else:
            x0 = (u - begin) / length
            x1 = (until - begin) / length
            for i in range(n):
                p0 = 0.0
                p1 = 0.0
                for back in range(7):
                    p0 = (p0 + shape[i, 7 - back]) * x0
                    p1 = (p1 + shape[i, 7 - back]) * x1
                rest = room.rest[i]
                over = rest[0] + (p1 - p0) - lines.slope[k, i] * (until - u)
                rest[0] = over
                squares = squares + over * over
            bound = sqrt(max(before, squares))
        lines.far[k] = max(lines.far[k], bound)
        if bound > most * tolerance:
            most = bound / tolerance
            where = u if before > squares else until
        if until >= end:
            return Deviation(most, where, k)
        u = until
        k = k + 1


LARGEST_STEP = 0.01  # m
BLEND = 0.156  # deviation of a blend divided by its length and 2 sin(θ/2)
_SHARE = 0.999  # of the tolerance
CROSSED = 0.9  # of the tolerance, reserved for the corner at which a run ends and the next one begins
_ROUNDS = 40
_ENOUGH = 40  # largest number of steps per line
_STRAIGHT = 1e-13  # rad, between lines in one direction
# a corner changes the spline over three knots: with more steps before it the end stays on the line
_LEAVES = 3.2  # least number of steps between a straight end and the first corner
NEAR = 10.0  # tolerances on either side of a corner over which it must look like one
_ASIDE = 0.25  # of the tolerance


@kernel
def chord(one: Piece, two: Piece) -> float:
    """Return 2 sin(θ/2) for the angle θ between two lines."""
    turn = 0.0
    for i in range(len(one.shape)):
        bend = line_way(two.shape, i) / two.length - line_way(one.shape, i) / one.length
        turn = turn + bend * bend
    return sqrt(turn)


@kernel
def _looks_straight(segments: Pieces, near: int, way: int, far: float, aside: float, to: Floats, now: Floats) -> bool:
    """Return True if the lines from index `near` on, in the direction `way` (1 or -1), stay within `aside` of their
    chord over a distance of at least `far`.

    The direction of the chord is written to `to`; `now` is workspace.
    """
    n = len(to)
    for i in range(n):
        to[i] = 0.0
    gone = 0.0
    k = near
    while gone < far and k >= 0 and k < len(segments.length):
        for i in range(n):
            to[i] = to[i] + line_way(segments.shape[k], i)
        gone = gone + segments.length[k]
        k = k + way
    squares = 0.0
    for i in range(n):
        squares = squares + to[i] * to[i]
    if gone < far or squares == 0.0:
        return False
    size = sqrt(squares)
    for i in range(n):
        to[i] = to[i] / size
        now[i] = 0.0
    end = k
    k = near
    while k != end:
        along = 0.0
        squares = 0.0
        for i in range(n):
            now[i] = now[i] + line_way(segments.shape[k], i)
            along = along + now[i] * to[i]
            squares = squares + now[i] * now[i]
        if squares - along * along > aside * aside:
            return False
        k = k + way
    return True


@kernel
def clustered(segments: Pieces, tolerance: Floats, sharpest: float, lonely: float, room: Room, inside: Ints) -> int:
    """Mark the joints that belong to a cluster with 1 in `inside`; return their number.

    A sharp corner does not belong to a cluster if the path is nearly straight over ten tolerances on either side: the
    run stops there.
    """
    kind = segments.kind
    length = segments.length
    before = room.before
    behind = room.behind
    count = 0
    since = 1e300  # distance from the last such corner
    for k in range(len(length)):
        inside[k] = 0
        since = since + length[k]
        if k + 1 == len(length) or tolerance[k] <= 0.0 or kind[k] != 0 or kind[k + 1] != 0:
            continue
        turn = chord(
            Piece(segments.kind[k], segments.length[k], segments.shape[k]),
            Piece(segments.kind[k + 1], segments.length[k + 1], segments.shape[k + 1]),
        )
        most = BLEND * turn * min(length[k], length[k + 1])
        if tolerance[k] <= 0.5 * most or lonely * tolerance[k] < most:
            continue
        # noise of small steps makes every corner look sharp: only one between straight stretches is intended
        near = NEAR * tolerance[k]
        if turn > 2.0 * sharpest and since > near:
            aside = _ASIDE * tolerance[k]
            if _looks_straight(segments, k, -1, near, aside, before, room.here) and _looks_straight(
                segments, k + 1, 1, near, aside, behind, room.here
            ):
                turn = 0.0
                for i in range(len(before)):
                    turn = turn + (behind[i] - before[i]) * (behind[i] - before[i])
                if turn > 4.0 * sharpest * sharpest:
                    since = 0.0
                    continue
        inside[k] = 1
        count = count + 1
    return count


@kernel
def _prepared(lines: Lines, tolerance: Floats, first: int, last: int, begin: float, ahead: Floats) -> int:
    """Compute, for each line of a cluster, the start position, the direction, the tolerance, and the number of its
    group of consecutive lines with the same direction.

    tolerance  of the joint after each line, m
    begin      distance from the start of the first line at which the cluster begins, m
    ahead      workspace, shape (N,)
    """
    group = lines.group
    corner = lines.corner
    n = len(ahead)
    corner[first] = -begin
    for k in range(first, last + 1):
        corner[k + 1] = corner[k] + lines.pieces.length[k]
        before = tolerance[k - 1] if k > first else tolerance[k]
        behind = tolerance[k] if k < last else before
        lines.tolerance[k] = _SHARE * min(before, behind)
        turn = 0.0
        for i in range(n):
            slope = line_way(lines.pieces.shape[k], i) / lines.pieces.length[k]
            lines.slope[k, i] = slope
            # against the line that began the group
            turn = max(turn, abs(slope - ahead[i]))
        group[k] = group[k - 1] if k > first else 0
        if k == first or turn > _STRAIGHT:
            group[k] = group[k] + 1
            for i in range(n):
                ahead[i] = lines.slope[k, i]
    return 0


class Boundary(NamedTuple):
    """The ends of a cluster.

    begin, end  distances from the start of its first line and to the end of its last line, m; with `straight_...` the
                spline follows the line up to there; with `crossed_...` it ends at a corner where runs overlap, and the
                fraction CROSSED of the tolerance is reserved for the overlap
    """

    begin: float
    end: float
    straight_begin: bool
    straight_end: bool
    crossed_begin: bool
    crossed_end: bool


class Unfinished(NamedTuple):
    """The spline of a cluster up to a knot from which the next call goes on.

    goals   goals of the steps from there on, of which `many` are used; with 0 of them there is no such spline
    knots   2 ENDS knots around this one
    begins  state there, (N,)
    floor   bound on the distance to each line so far, m
    """

    many: int
    goals: Goals
    knots: Floats
    begins: Records[State]
    floor: Floats


class Fitted(NamedTuple):
    """The number of steps of a spline, 0 if there is none, and the number of its goals."""

    steps: int
    goals: int


_NO_FIT = Fitted(0, 0)


@kernel
def fitted(
    lines: Lines,
    tolerance: Floats,
    first: int,
    last: int,
    ends: Boundary,
    most_steps: float,
    fixed: int,
    begun: Unfinished,
    fit: Fit,
    room: Room,
) -> Fitted:
    """Fit the spline to the lines first .. last; return the number of its steps and of the goals, which are in
    `room.goals`.

    tolerance   tolerance of the joint after each line, m
    most_steps  the longest step is at most the total length divided by this number
    fixed       number of steps that are already fixed; if not 0, `begun` is an input, and its knots are in `fit`
    """
    corner = lines.corner
    knots = fit.knots
    at = room.goals.at
    goal = room.goals.step
    at_next = room.more.at
    goal_next = room.more.step
    _prepared(lines, tolerance, first, last, ends.begin, room.here)
    total = corner[last + 1] - ends.end
    largest = min(LARGEST_STEP, total / most_steps)
    if fixed > 0 and total <= knots[ENDS + fixed]:
        return _NO_FIT
    many = begun.many
    if fixed == 0:
        at_next[0] = 0.0
        goal_next[0] = min(largest, corner[first + 1] / _LEAVES) if ends.straight_begin else largest
        many = 1
    else:
        for m in range(many):
            at_next[m] = begun.goals.at[m]
            goal_next[m] = begun.goals.step[m]
    at_next[many] = total
    goal_next[many] = min(largest, (total - corner[last]) / _LEAVES) if ends.straight_end else largest
    new = many + 1
    bounded = False  # True if distances are bounds; sampled ones suffice while those at corners are too large
    for again in range(_ROUNDS):
        many = envelope(room.more, new, room.goals)
        most_count = _ENOUGH * (last - first + 2 + int(total / largest))
        count = place_knots(room.goals, many, largest, total, fixed, most_count, knots)
        if count == 0:
            return _NO_FIT
        control_points(lines, first, last, total, count, fit)
        states(lines, count, fit)
        if fixed > 0:
            # bitwise equal to the value in the preceding pieces
            for i in range(len(begun.begins)):
                fit.state[ENDS, i] = begun.begins[i]._replace(value=fit.state[ENDS, i].value)
        k = first
        for m in range(first, last + 1):
            lines.far[m] = begun.floor[m]
        most = 0.0
        # the deviation falls with the square of the step; later rounds overshoot, to end sooner
        careful = 0.95 if again < _ROUNDS // 2 else 0.85
        old = 0
        new = 0
        for e in range(ENDS, ENDS + count):
            fit.curved[e] = 0
            if spline_span(lines, e, fit, room):
                fit.curved[e] = 1
                share, where, k = deviation(lines, e, k, last, bounded, fit, room)
                # nine tenths of the tolerance are for the overlap of the runs in this corner (`CROSSED`)
                if (e == ENDS and ends.crossed_begin) or (e == ENDS + count - 1 and ends.crossed_end):
                    share = share / (1.0 - CROSSED)
                most = max(most, share)
                if share > 1.0:
                    # steps before the first goal are fixed
                    where = max(where, at[0])
                    while old < many and at[old] <= where:
                        at_next[new] = at[old]
                        goal_next[new] = goal[old]
                        new = new + 1
                        old = old + 1
                    step = min(largest, goal[old - 1] + GRADE * (where - at[old - 1]))
                    if old < many:
                        step = min(step, goal[old] + GRADE * (at[old] - where))
                    at_next[new] = where
                    goal_next[new] = step * min(max(careful / sqrt(share), 0.2), careful)
                    new = new + 1
        while old < many:
            at_next[new] = at[old]
            goal_next[new] = goal[old]
            new = new + 1
            old = old + 1
        # a blend or a line follows: the spline must leave the line only beyond the first control points
        if ends.straight_begin and fit.straight[ENDS - 1] != fit.straight[0]:
            most = 2.0
            goal_next[0] = 0.8 * goal_next[0]
        if ends.straight_end and fit.straight[count] != fit.straight[count + ENDS - 1]:
            most = 2.0
            at_next[new] = total
            goal_next[new] = 0.8 * (total - knots[ENDS + count - 1])
            new = new + 1
        if most <= 1.0 and bounded:
            return Fitted(count, many)
        bounded = most <= 1.0
    return _NO_FIT


@kernel
def carried(e: int, u: float, many: int, goals: Goals, knots: Floats, begun: Unfinished) -> int:
    """Save the data needed to continue the spline from knot e in `begun`: the knots around it and the goals after them;
    positions are then measured from u.

    Return the number of goals.
    """
    at = goals.at
    goal = goals.step
    kept = begun.knots
    for k in range(2 * ENDS):
        kept[k] = knots[e - ENDS + k] - u
    begin = knots[e + ENDS - 1]
    p = 0
    while p + 1 < many and at[p + 1] <= begin:
        p = p + 1
    step = goal[p] + GRADE * (begin - at[p])
    if p + 1 < many:
        step = min(step, goal[p + 1] + GRADE * (at[p + 1] - begin))
    begun.goals.at[0] = begin - u
    begun.goals.step[0] = step
    count = 1
    # those near the provisional end are omitted: they belong to a stop that does not take place
    while p + 1 < many and at[p + 1] < knots[e + FITTED]:
        p = p + 1
        begun.goals.at[count] = at[p] - u
        begun.goals.step[count] = goal[p]
        count = count + 1
    return count


class Joined(NamedTuple):
    """The pieces of a path, and the way along the segments that each stands for.

    runs     number of its run
    segment  index of the segment at which it starts
    begin    distance from the start of this segment, m
    covers   length of the way along the segments, m: that of the piece, except in a blend
    """

    pieces: Pieces
    runs: Ints
    segment: Ints
    begin: Floats
    covers: Floats


@kernel
def straight_pieces(
    lines: Lines, first: int, last: int, u0: float, u1: float, run: int, count: int, out: Joined
) -> int:
    """Append the straight pieces from u0 to u1, one for each section of equal feed; return the new count."""
    corner = lines.corner
    feed = lines.pieces.feed
    k = first
    while k < last and corner[k + 1] <= u0:
        k = k + 1
    u = u0
    while u < u1:
        ends = k
        while ends < last and corner[ends + 1] < u1 and feed[ends + 1] == feed[k]:
            ends = ends + 1
        until = u1 if ends == last else min(u1, corner[ends + 1])
        out.pieces.kind[count] = 0
        out.pieces.length[count] = until - u
        for i in range(len(lines.slope[0])):
            begin = lines.slope[k, i] * (u - corner[k])
            out.pieces.origin[count, i] = lines.pieces.origin[k, i] + begin
            way = lines.slope[k, i] * (until - u)
            if ends != k:
                way = (lines.pieces.origin[ends, i] - lines.pieces.origin[k, i]) + (
                    lines.slope[ends, i] * (until - corner[ends]) - begin
                )
            put_line(out.pieces.shape[count], i, way)
        out.pieces.feed[count] = feed[k]
        out.pieces.line[count] = lines.pieces.line[k]
        out.runs[count] = run
        out.segment[count] = k
        out.begin[count] = u - corner[k]
        out.covers[count] = until - u
        count = count + 1
        u = until
        k = min(ends + 1, last)
    return count


@kernel
def spline_pieces(
    lines: Lines, first: int, last: int, e0: int, e1: int, u: float, fit: Fit, run: int, count: int, out: Joined
) -> tuple[int, float]:
    """Append the pieces of a cluster from u to the last curved span before knot e1; return the new count and u."""
    corner = lines.corner
    knots = fit.knots
    k = first
    for e in range(e0, e1):
        if fit.curved[e] == 0:
            continue
        if knots[e] > u:
            count = straight_pieces(lines, k, last, u, knots[e], run, count, out)
        u = knots[e + 1]
        while k < last and corner[k + 1] <= knots[e]:
            k = k + 1
        out.pieces.kind[count] = 2
        out.pieces.length[count] = u - knots[e]
        out.pieces.line[count] = lines.pieces.line[k]
        out.runs[count] = run
        out.segment[count] = k
        out.begin[count] = knots[e] - corner[k]
        out.covers[count] = u - knots[e]
        # a span may cover several lines, and exceeds the feed of none
        slowest = lines.pieces.feed[k]
        m = k
        while m < last and corner[m + 1] < u:
            m = m + 1
            slowest = min(slowest, lines.pieces.feed[m])
        out.pieces.feed[count] = slowest
        for i in range(len(lines.slope[0])):
            out.pieces.origin[count, i] = fit.control[e - 3, i] + fit.state[e, i].value
            for m in range(8):
                out.pieces.shape[count, i, m] = fit.curve[e, i, m]
        count = count + 1
    return count, u


def lines_room(segments: Pieces) -> Lines:
    """Return room for what `fitted` knows of the lines of a chain."""
    n, axes = segments.origin.shape
    return Lines(segments, np.zeros(n + 1), np.zeros(n, np.int64), np.zeros((n, axes)), np.zeros(n + 1), np.zeros(n))


def fit_room(knots: int, axes: int) -> Fit:
    """Return room for a spline with so many knots."""
    return Fit(
        np.zeros(knots),
        np.zeros(knots),
        np.zeros((knots, axes)),
        np.zeros(knots, np.int64),
        np.zeros(knots, np.int64),
        rows_for(State, knots, axes),
        np.zeros(knots, np.int64),
        np.zeros((knots, axes, 8)),
    )


def cluster_room(knots: int, axes: int) -> Room:
    """Return work arrays for the fit of such a spline."""
    goals, more = (Goals(np.zeros(knots), np.zeros(knots)) for _ in range(2))
    a, b = rows_for(State, axes), rows_for(State, axes)
    piece, rest = np.zeros((axes, 8)), np.zeros((axes, 8))
    before, behind, here = np.zeros(axes), np.zeros(axes), np.zeros(axes)
    return Room(goals, more, a, b, piece, rest, before, behind, here)
