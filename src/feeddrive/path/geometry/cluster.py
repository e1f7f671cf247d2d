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

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints, zeros
from feeddrive.path.geometry.segments import hermite, largest_norm, part_of

ENDS = 5  # number of knots beyond each end
GRADE = 0.35  # growth of the step per distance
FITTED = 20  # number of steps before the end that are adapted to it
_QUARTERS = 4  # subdivisions of an interval whose hull is too wide


@kernel
def envelope(places: Floats, steps: Floats, count: int, at: Floats, goal: Floats) -> int:
    """Write the positions at which the step limits are active, and these limits, into `at` and `goal`; return their
    number.

    The step size may grow from each position by at most GRADE times the distance; a limit above this bound is never
    active and is omitted. The first position is always included.
    """
    at[0] = places[0]
    goal[0] = steps[0]
    many = 1
    for k in range(1, count):
        u = places[k]
        step = steps[k]
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
def place_knots(
    at: Floats, goal: Floats, many: int, largest: float, total: float, fixed: int, most: int, knots: Floats
) -> int:
    """Place knots up to `total`, mirrored beyond the ends, so that the distances between them follow the goals at the
    positions `at`; return the number of these steps.

    If the first `fixed` steps are fixed, all knots up to knots[ENDS + fixed] = at[0] are inputs.  Otherwise knots[ENDS]
    is 0.  There are at least five steps, provided that `largest` is at most total/6; the result is 0 if more than
    `most` are required.
    """
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
def control_points(
    corner: Floats,
    group: Ints,
    origin: Floats2,
    slope: Floats2,
    first: int,
    last: int,
    total: float,
    knots: Floats,
    count: int,
    x: Floats,
    control: Floats2,
    segment: Ints,
    straight: Ints,
) -> int:
    """Write the Greville abscissas into `x`, and the values of f there into `control`.

    corner    u at the start of each segment, and the end of the last
    group     equal numbers for consecutive segments of the same direction
    segment   segment on which each x, or its mirror image, lies
    straight  equal numbers for neighboring abscissas if f is straight between them
    """
    k = first
    for i in range(count + ENDS):
        here = 0.2 * (knots[i + 1] + knots[i + 2] + knots[i + 3] + knots[i + 4] + knots[i + 5])
        x[i] = here
        inside = min(abs(here), 2.0 * total - here) if here > total or here < 0.0 else here
        while k < last and corner[k + 1] < inside:
            k = k + 1
        while k > first and corner[k] > inside:
            k = k - 1
        segment[i] = k
        straight[i] = group[k]
        end = -1
        if here < 0.0:
            end = first
        elif here > total:
            end = last
        for n in range(len(slope[0])):
            control[i, n] = origin[k, n] + slope[k, n] * (inside - corner[k])
            if end >= 0:
                turn = origin[end, n] + slope[end, n] * ((total if here > 0.0 else 0.0) - corner[end])
                control[i, n] = 2.0 * turn - control[i, n]
        if end >= 0 and group[k] != group[end]:
            # numbers that occur nowhere else: the mirror image of another line is parallel to it, but not on it
            straight[i] = -1 - group[k] if here < 0.0 else -2 - group[last] - group[k]
    return 0


@kernel
def states(
    knots: Floats,
    count: int,
    x: Floats,
    control: Floats2,
    segment: Ints,
    straight: Ints,
    slope: Floats2,
    state: Floats3,
) -> int:
    """Write S - f(x_{e-3}), S', S'' and S''' at each knot e, computed from differences of control points (de Boor),
    into `state`.

    If all relevant control points lie on one line, the results are exactly those of the line.
    """
    q = zeros(5)
    move = zeros(5)
    for e in range(ENDS, ENDS + count + 1):
        here = knots[e]
        same = True
        for i in range(e - 4, e):
            same = same and straight[i] == straight[i - 1]
        k = segment[e - 3]
        if same:
            for n in range(len(slope[0])):
                state[e, n, 0] = slope[k, n] * (here - x[e - 3])
                state[e, n, 1] = slope[k, n]
                state[e, n, 2] = 0.0
                state[e, n, 3] = 0.0
            continue
        for n in range(len(slope[0])):
            for m in range(1, 5):
                i = e - 5 + m
                # along one line from its slope: differences of absolute coordinates would bend it by their rounding
                if straight[i] == straight[i - 1]:
                    move[m] = slope[segment[i], n] * (x[i] - x[i - 1])
                else:
                    move[m] = control[i, n] - control[i - 1, n]
            # control points from that of e - 3, then their differences
            for derivative in range(4):
                degree = 5 - derivative
                if derivative == 0:
                    q[0] = -move[2] - move[1]
                    q[1] = -move[2]
                    q[2] = 0.0
                    q[3] = move[3]
                    q[4] = move[3] + move[4]
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
                state[e, n, derivative] = q[4]
    return 0


@kernel
def spline_span(
    e: int,
    knots: Floats,
    x: Floats,
    control: Floats2,
    segment: Ints,
    straight: Ints,
    slope: Floats2,
    state: Floats3,
    a: Floats2,
    b: Floats2,
    out: Floats2,
) -> bool:
    """Write the polynomial of the span after knot e into `out` (N, 8); return False without writing if the span is
    straight.
    """
    same = True
    for i in range(e - 4, e + 1):
        same = same and straight[i] == straight[i - 1]
    if same:
        return False
    for n in range(len(out)):
        move = control[e - 2, n] - control[e - 3, n]
        if straight[e - 2] == straight[e - 3]:
            move = slope[segment[e - 2], n] * (x[e - 2] - x[e - 3])
        for k in range(1, 4):
            a[n, k] = state[e, n, k]
            b[n, k] = state[e + 1, n, k]
        a[n, 0] = 0.0
        b[n, 0] = (state[e + 1, n, 0] - state[e, n, 0]) + move
    hermite(a, b, knots[e + 1] - knots[e], out)
    return True


@kernel
def deviation(
    e: int,
    knots: Floats,
    shape: Floats2,
    corner: Floats,
    origin: Floats2,
    slope: Floats2,
    tolerance: Floats,
    first: int,
    last: int,
    state: Floats3,
    control: Floats2,
    bounded: bool,
    piece: Floats2,
    difference: Floats2,
    far: Floats,
) -> tuple[float, float, int]:
    """Return the largest ratio of |S - f| to the tolerance of its segment on a span, the position of that maximum, and
    the last segment reached.

    The ratio is a bound if `bounded`, otherwise the maximum over the knots and corners; the position is always a knot
    or a corner.  The segment search starts at `first`. far[k], the largest distance in m on segment k, is updated.
    """
    n = len(slope[0])
    begin = knots[e]
    end = knots[e + 1]
    length = end - begin
    k = first
    while k < last and corner[k + 1] <= begin:
        k = k + 1
    squares = 0.0
    for i in range(n):
        at = origin[k, i] + slope[k, i] * (begin - corner[k])
        # the large coordinates cancel before the small state is added
        difference[i, 0] = (control[e - 3, i] - at) + state[e, i, 0]
        squares = squares + difference[i, 0] * difference[i, 0]
    most = 0.0
    u = begin
    where = begin
    while True:
        until = end if k == last else min(end, corner[k + 1])
        before = squares
        squares = 0.0
        if bounded:
            for i in range(n):
                start = difference[i, 0]
                part_of(shape[i], (u - begin) / length, (until - u) / length, difference[i])
                difference[i, 0] = start
                difference[i, 1] = difference[i, 1] - slope[k, i] * (until - u)
            bound = largest_norm(difference)
            # one hull is cheap, but too wide on long intervals: subdivided only where it does not suffice
            if bound > tolerance[k]:
                bound = 0.0
                for part in range(_QUARTERS):
                    for i in range(n):
                        part_of(difference[i], part / _QUARTERS, 1.0 / _QUARTERS, piece[i])
                    bound = max(bound, largest_norm(piece))
            for i in range(n):
                over = 0.0
                for m in range(8):
                    over = over + difference[i, m]
                difference[i, 0] = over
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
                over = difference[i, 0] + (p1 - p0) - slope[k, i] * (until - u)
                difference[i, 0] = over
                squares = squares + over * over
            bound = sqrt(max(before, squares))
        far[k] = max(far[k], bound)
        if bound > most * tolerance[k]:
            most = bound / tolerance[k]
            where = u if before > squares else until
        if until >= end:
            return most, where, k
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
def chord(length0: float, shape0: Floats2, length1: float, shape1: Floats2) -> float:
    """Return 2 sin(θ/2) for the angle θ between two lines."""
    turn = 0.0
    for i in range(len(shape0)):
        bend = shape1[i, 1] / length1 - shape0[i, 1] / length0
        turn = turn + bend * bend
    return sqrt(turn)


@kernel
def _looks_straight(
    length: Floats, shape: Floats3, near: int, way: int, far: float, aside: float, to: Floats, now: Floats
) -> bool:
    """Return True if the lines from index `near` on, in the direction `way` (1 or -1), stay within `aside` of their
    chord over a distance of at least `far`.

    The direction of the chord is written to `to`; `now` is workspace.
    """
    n = len(to)
    for i in range(n):
        to[i] = 0.0
    gone = 0.0
    k = near
    while gone < far and k >= 0 and k < len(length):
        for i in range(n):
            to[i] = to[i] + shape[k, i, 1]
        gone = gone + length[k]
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
            now[i] = now[i] + shape[k, i, 1]
            along = along + now[i] * to[i]
            squares = squares + now[i] * now[i]
        if squares - along * along > aside * aside:
            return False
        k = k + way
    return True


@kernel
def clustered(
    kind: Ints,
    length: Floats,
    shape: Floats3,
    tolerance: Floats,
    sharpest: float,
    lonely: float,
    room: Floats2,
    inside: Ints,
) -> int:
    """Mark the joints that belong to a cluster with 1 in `inside`; return their number.

    A sharp corner does not belong to a cluster if the path is nearly straight over ten tolerances on either side: the
    run stops there.
    """
    count = 0
    since = 1e300  # distance from the last such corner
    for k in range(len(length)):
        inside[k] = 0
        since = since + length[k]
        if k + 1 == len(length) or tolerance[k] <= 0.0 or kind[k] != 0 or kind[k + 1] != 0:
            continue
        turn = chord(length[k], shape[k], length[k + 1], shape[k + 1])
        most = BLEND * turn * min(length[k], length[k + 1])
        if tolerance[k] <= 0.5 * most or lonely * tolerance[k] < most:
            continue
        # noise of small steps makes every corner look sharp: only one between straight stretches is intended
        near = NEAR * tolerance[k]
        if turn > 2.0 * sharpest and since > near:
            aside = _ASIDE * tolerance[k]
            if _looks_straight(length, shape, k, -1, near, aside, room[0], room[2]) and _looks_straight(
                length, shape, k + 1, 1, near, aside, room[1], room[2]
            ):
                turn = 0.0
                for i in range(len(room[0])):
                    turn = turn + (room[1, i] - room[0, i]) * (room[1, i] - room[0, i])
                if turn > 4.0 * sharpest * sharpest:
                    since = 0.0
                    continue
        inside[k] = 1
        count = count + 1
    return count


@kernel
def _prepared(
    first: int,
    last: int,
    begin: float,
    length: Floats,
    shape: Floats3,
    tolerance: Floats,
    sharing: Floats,
    corner: Floats,
    group: Ints,
    slope: Floats2,
    ahead: Floats,
) -> int:
    """Compute, for each line of a cluster, the start position, the direction, the tolerance, and the number of its
    group of consecutive lines with the same direction; `ahead` is workspace.
    """
    n = len(slope[0])
    corner[first] = -begin
    for k in range(first, last + 1):
        corner[k + 1] = corner[k] + length[k]
        before = tolerance[k - 1] if k > first else tolerance[k]
        behind = tolerance[k] if k < last else before
        sharing[k] = _SHARE * min(before, behind)
        turn = 0.0
        for i in range(n):
            slope[k, i] = shape[k, i, 1] / length[k]
            # against the line that began the group
            turn = max(turn, abs(slope[k, i] - ahead[i]))
        group[k] = group[k - 1] if k > first else 0
        if k == first or turn > _STRAIGHT:
            group[k] = group[k] + 1
            for i in range(n):
                ahead[i] = slope[k, i]
    return 0


@kernel
def fitted(
    first: int,
    last: int,
    begin: float,
    end: float,
    straight_begin: bool,
    straight_end: bool,
    crossed_begin: bool,
    crossed_end: bool,
    most_steps: float,
    fixed: int,
    many: int,
    begins: Floats2,
    length: Floats,
    shape: Floats3,
    origin: Floats2,
    tolerance: Floats,
    sharing: Floats,
    corner: Floats,
    group: Ints,
    slope: Floats2,
    floor: Floats,
    far: Floats,
    at: Floats,
    goal: Floats,
    at_next: Floats,
    goal_next: Floats,
    knots: Floats,
    x: Floats,
    control: Floats2,
    segment: Ints,
    straight: Ints,
    curved: Ints,
    state: Floats3,
    curve: Floats3,
    room: Floats3,
) -> tuple[int, int]:
    """Fit the spline to the lines first .. last, from `begin` m after the start of the first to `end` m before the end
    of the last.

    Return the number of steps, 0 on failure, and the number of goal positions.

    begin, end  with `straight_...` the spline follows the line up to there; with `crossed_...` it ends at a corner
                where runs overlap, and the fraction CROSSED of the tolerance is reserved for the overlap
    most_steps  the longest step is at most the total length divided by this number
    fixed       number of steps that are already fixed; if not 0, the knots up to there, `many` goal positions from
                there on, and the state `begins` at the first knot are also inputs
    corner      u at the start of each line, counted from `begin`, and the end of the last one
    sharing     tolerance of each line, m: the smaller of the tolerances at its two joints
    curve       polynomials of the spans after knots; spans with `curved` 0 are straight
    far         bound on the distance to each line, m; not less than `floor`
    """
    _prepared(first, last, begin, length, shape, tolerance, sharing, corner, group, slope, room[0, 0])
    total = corner[last + 1] - end
    largest = min(LARGEST_STEP, total / most_steps)
    if fixed > 0 and total <= knots[ENDS + fixed]:
        return 0, 0
    if fixed == 0:
        at[0] = 0.0
        goal[0] = min(largest, corner[first + 1] / _LEAVES) if straight_begin else largest
        many = 1
    for m in range(many):
        at_next[m] = at[m]
        goal_next[m] = goal[m]
    at_next[many] = total
    goal_next[many] = min(largest, (total - corner[last]) / _LEAVES) if straight_end else largest
    new = many + 1
    bounded = False  # True if distances are bounds; sampled ones suffice while those at corners are too large
    for again in range(_ROUNDS):
        many = envelope(at_next, goal_next, new, at, goal)
        count = place_knots(
            at, goal, many, largest, total, fixed, _ENOUGH * (last - first + 2 + int(total / largest)), knots
        )
        if count == 0:
            return 0, 0
        control_points(corner, group, origin, slope, first, last, total, knots, count, x, control, segment, straight)
        states(knots, count, x, control, segment, straight, slope, state)
        if fixed > 0:
            # bitwise equal to the value in the preceding pieces
            for i in range(len(begins)):
                for m in range(1, 4):
                    state[ENDS, i, m] = begins[i, m]
        k = first
        for m in range(first, last + 1):
            far[m] = floor[m]
        most = 0.0
        # the deviation falls with the square of the step; later rounds overshoot, to end sooner
        careful = 0.95 if again < _ROUNDS // 2 else 0.85
        old = 0
        new = 0
        for e in range(ENDS, ENDS + count):
            curved[e] = 0
            if spline_span(e, knots, x, control, segment, straight, slope, state, room[1], room[2], curve[e]):
                curved[e] = 1
                share, where, k = deviation(
                    e,
                    knots,
                    curve[e],
                    corner,
                    origin,
                    slope,
                    sharing,
                    k,
                    last,
                    state,
                    control,
                    bounded,
                    room[3],
                    room[4],
                    far,
                )
                # nine tenths of the tolerance are for the overlap of the runs in this corner (`CROSSED`)
                if (e == ENDS and crossed_begin) or (e == ENDS + count - 1 and crossed_end):
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
        if straight_begin and straight[4] != straight[0]:
            most = 2.0
            goal_next[0] = 0.8 * goal_next[0]
        if straight_end and straight[count] != straight[count + 4]:
            most = 2.0
            at_next[new] = total
            goal_next[new] = 0.8 * (total - knots[ENDS + count - 1])
            new = new + 1
        if most <= 1.0 and bounded:
            return count, many
        bounded = most <= 1.0
    return 0, 0


@kernel
def carried(e: int, u: float, at: Floats, goal: Floats, many: int, knots: Floats, kept: Floats) -> int:
    """Save the data needed to continue the spline from knot e: write the knots around it to `kept`, and move the goal
    positions after them to the front of `at` and `goal`; positions are then measured from u.

    Return the number of goal positions.
    """
    for k in range(2 * ENDS):
        kept[k] = knots[e - ENDS + k] - u
    begin = knots[e + ENDS - 1]
    p = 0
    while p + 1 < many and at[p + 1] <= begin:
        p = p + 1
    step = goal[p] + GRADE * (begin - at[p])
    if p + 1 < many:
        step = min(step, goal[p + 1] + GRADE * (at[p + 1] - begin))
    at[0] = begin - u
    goal[0] = step
    count = 1
    # those near the provisional end are omitted: they belong to a stop that does not take place
    while p + 1 < many and at[p + 1] < knots[e + FITTED]:
        p = p + 1
        at[count] = at[p] - u
        goal[count] = goal[p]
        count = count + 1
    return count


@kernel
def straight_pieces(
    u0: float,
    u1: float,
    first: int,
    last: int,
    corner: Floats,
    origin: Floats2,
    slope: Floats2,
    feed: Floats,
    line: Ints,
    run: int,
    count: int,
    kinds: Ints,
    lengths: Floats,
    origins: Floats2,
    shapes: Floats3,
    feeds: Floats,
    lines: Ints,
    runs: Ints,
) -> int:
    """Append the straight pieces from u0 to u1, one for each section of equal feed; return the new count."""
    k = first
    while k < last and corner[k + 1] <= u0:
        k = k + 1
    u = u0
    while u < u1:
        ends = k
        while ends < last and corner[ends + 1] < u1 and feed[ends + 1] == feed[k]:
            ends = ends + 1
        until = u1 if ends == last else min(u1, corner[ends + 1])
        kinds[count] = 0
        lengths[count] = until - u
        for i in range(len(slope[0])):
            begin = slope[k, i] * (u - corner[k])
            origins[count, i] = origin[k, i] + begin
            for m in range(8):
                shapes[count, i, m] = 0.0
            way = slope[k, i] * (until - u)
            if ends != k:
                way = (origin[ends, i] - origin[k, i]) + (slope[ends, i] * (until - corner[ends]) - begin)
            shapes[count, i, 1] = way
        feeds[count] = feed[k]
        lines[count] = line[k]
        runs[count] = run
        count = count + 1
        u = until
        k = min(ends + 1, last)
    return count


@kernel
def spline_pieces(
    first: int,
    last: int,
    e0: int,
    e1: int,
    u: float,
    corner: Floats,
    origin: Floats2,
    slope: Floats2,
    feed: Floats,
    line: Ints,
    knots: Floats,
    control: Floats2,
    state: Floats3,
    curve: Floats3,
    curved: Ints,
    run: int,
    count: int,
    kinds: Ints,
    lengths: Floats,
    origins: Floats2,
    shapes: Floats3,
    feeds: Floats,
    lines: Ints,
    runs: Ints,
) -> tuple[int, float]:
    """Append the pieces of a cluster from u to the last curved span before knot e1; return the new count and u."""
    k = first
    for e in range(e0, e1):
        if curved[e] == 0:
            continue
        if knots[e] > u:
            count = straight_pieces(
                u,
                knots[e],
                k,
                last,
                corner,
                origin,
                slope,
                feed,
                line,
                run,
                count,
                kinds,
                lengths,
                origins,
                shapes,
                feeds,
                lines,
                runs,
            )
        u = knots[e + 1]
        while k < last and corner[k + 1] <= knots[e]:
            k = k + 1
        kinds[count] = 2
        lengths[count] = u - knots[e]
        lines[count] = line[k]
        runs[count] = run
        # a span may cover several lines, and exceeds the feed of none
        slowest = feed[k]
        m = k
        while m < last and corner[m + 1] < u:
            m = m + 1
            slowest = min(slowest, feed[m])
        feeds[count] = slowest
        for i in range(len(slope[0])):
            origins[count, i] = control[e - 3, i] + state[e, i, 0]
            for m in range(8):
                shapes[count, i, m] = curve[e, i, m]
        count = count + 1
    return count, u
