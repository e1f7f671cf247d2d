"""A spline of fifth degree through the neighborhood of a polyline f(u): the variation-diminishing one of Schoenberg.

    S(u) = Σ f(x_i) N_i(u),    x_i = (τ_{i+1} + ... + τ_{i+5}) / 5

with B-splines N_i on the knots τ.  Straight parts are kept exactly, |S'| <= 1, there is no system to solve, and a
change of f or of a knot is felt three knots away only.  Beyond its ends f is reflected at them, so that S begins and
ends on f.  The distance |S - f| is bounded on each stretch between knots and corners, where both are polynomials, by
the hull of Bernstein points.

Source: Schoenberg 1967, On spline functions; de Boor 1978, A practical guide to splines.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.path.geometry.blend import hermite, largest_norm, part_of

ENDS = 5  # knots beyond each end
GRADE = 0.35  # of the step, by the way
FITTED = 20  # steps before the end that are made to fit it
_QUARTERS = 4  # of a stretch whose hull is too wide


@kernel
def envelope(given: Floats, steps: Floats, count: int, at: Floats, goal: Floats) -> int:
    """Of places where steps may be so long at most, those that count: how many, into `at` and `goal`.

    Steps grow by GRADE of the way from each place; the first place stays.
    """
    at[0] = given[0]
    goal[0] = steps[0]
    many = 1
    for k in range(1, count):
        u = given[k]
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
) -> int:  # fmt: skip
    """Knots up to `total` whose steps follow the goals at the places `at`, and their mirror images; how many steps.

    The first steps may be fixed: then all knots are given up to knots[ENDS + fixed], which is at[0].  Otherwise
    knots[ENDS] is 0.  There are at least five steps, as long as `largest` is at most total/6; 0 if more than `most`.
    """
    if fixed == 0:
        knots[ENDS] = 0.0
    u = knots[ENDS + fixed]
    p = 0
    count = fixed
    step = 0.0
    while u < total:
        # the goal in the middle of the step
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
    # the last steps are made shorter to fit the end, the longer ones more
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
    corner: Floats, group: Ints, origin: Floats2, slope: Floats2, first: int, last: int,
    total: float, knots: Floats, count: int, x: Floats, control: Floats2, segment: Ints, straight: Ints,
) -> int:  # fmt: skip
    """f at the Greville abscissas x.

    corner    u where each segment begins, and one more
    group     the same number for segments in one direction
    segment   on which each x lies, or its mirror image
    straight  the same number for neighbors between which f is straight
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
            straight[i] = -1 - group[k] if here < 0.0 else -2 - group[last] - group[k]
    return 0


@kernel
def states(
    knots: Floats, count: int, x: Floats, control: Floats2, segment: Ints, straight: Ints, slope: Floats2,
    state: Floats3,
) -> int:  # fmt: skip
    """S - f(x_{e-3}), S', S'' and S''' at each knot e by differences of control points (de Boor), into `state`.

    Exactly those of the line where all control points that count lie on one.
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
    e: int, knots: Floats, x: Floats, control: Floats2, segment: Ints, straight: Ints, slope: Floats2, state: Floats3,
    a: Floats2, b: Floats2, out: Floats2,
) -> bool:  # fmt: skip
    """The polynomial of the span behind knot e, into `out` (N, 8); False and nothing if the span is straight."""
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
    e: int, knots: Floats, shape: Floats2, corner: Floats, origin: Floats2, slope: Floats2, tolerance: Floats,
    first: int, last: int, state: Floats3, control: Floats2, bounded: bool, piece: Floats2, difference: Floats2,
    far: Floats,
) -> tuple[float, float, int]:  # fmt: skip
    """|S - f| on a span as a share of the tolerance of each segment, where, and the last segment that it reaches.

    A bound if `bounded`, else the largest at knots and corners.  The search for segments begins with `first`.
    far[k], the largest distance in m on segment k, is raised.
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
