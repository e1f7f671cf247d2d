"""Joining of segments into a path: a joint is already smooth, rounded by a blend within the tolerance, or a stop.

The segments of a run are connected lines and arcs as `Pieces`.  A blend uses at most half of the length of each of its
segments.  A blend is stored in eight pieces, so that the bounds on its derivatives are tight.
"""

from __future__ import annotations

from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints, zeros
from feeddrive.path.geometry.cluster import (
    BLEND,
    CROSSED,
    ENDS,
    FITTED,
    LARGEST_STEP,
    NEAR,
    carried,
    clustered,
    fitted,
    spline_pieces,
    straight_pieces,
)
from feeddrive.path.geometry.segments import Chain, blend, goes_on, part_of, state_near, trimmed
from feeddrive.path.motion import POLYNOMIAL, Pieces, Section, derivatives, one_after_the_other, part_of_pieces

_CUTS = 8  # number of pieces of a blend
# between lines that are longer, overlapping runs pass a corner faster than a blend
LONELY = 4.5  # multiple of the blend length
_AHEAD = 0.05  # m, length of a cluster held back
_SHORT, _LONG = 6.0, 60.0  # least number of steps of a cluster: of a complete one, and of one with unknown end
# next to an arc no bump is possible, and a blend is slower than a stop only at sharper corners
_BENT = 0.2  # rad
SMOOTH = 1e-9  # rad, and relative to the curvature: a smaller change is not a corner
_FIRST, _MOST = 1e5, 100.0  # initial space for knots, and its largest multiple of the expected number
# programs write parts of one circle with rounded end points and centers
_ALMOST = 1e-3  # rad, and relative to the curvature
# between such arcs it costs no time to stay near the circle
_LITTLE = 0.05  # of the tolerance, for the blend


class Joint(NamedTuple):
    """The outcome for the joint after each segment: the deviation of its blend, and whether the run stops there."""

    deviation: np.ndarray  # m, proven distance to the segments of the joint; 0 without a blend
    stop: np.ndarray  # True if the run ends there


@kernel
def _passed(
    k: int,
    kind: Ints,
    length: Floats,
    shape: Floats3,
    tolerance: Floats,
    sharpest: float,
    lonely: float,
    a: Floats2,
    b: Floats2,
) -> tuple[int, float, float]:
    """Return the type of the joint after segment k, and the cosine and the chord of its turning angle.

    0: stop, 1: already smooth, 2: blend, 3: small blend between arcs of almost the same circle
    """
    if k + 1 == len(length) or tolerance[k] < 0.0:
        return 0, 0.0, 0.0
    if kind[k] == 2 or kind[k + 1] == 2:  # a spline is followed exactly: no blend may start on it
        return (1 if goes_on(k, kind, length, shape, a, b) else 0), 0.0, 0.0
    arcs = kind[k] == 1 and kind[k + 1] == 1
    if arcs and goes_on(k, kind, length, shape, a, b):
        return 1, 1.0, 0.0
    state_near(kind[k], length[k], shape[k], 0.0, True, a)
    state_near(kind[k + 1], length[k + 1], shape[k + 1], 0.0, False, b)
    cosine = 0.0
    size0 = 0.0
    size1 = 0.0
    turn = 0.0
    jump = 0.0
    bend = 0.0
    for i in range(len(a)):
        cosine = cosine + a[i, 1] * b[i, 1]
        size0 = size0 + a[i, 1] * a[i, 1]
        size1 = size1 + b[i, 1] * b[i, 1]
        turn = turn + (a[i, 1] - b[i, 1]) * (a[i, 1] - b[i, 1])
        jump = max(jump, abs(a[i, 2] - b[i, 2]))
        bend = max(bend, abs(a[i, 2]))
    cosine = cosine / sqrt(size0 * size1)
    turn = sqrt(turn)
    shorter = min(length[k], length[k + 1])
    # collinear lines: their directions, quotients of rounded numbers, differ in the last digits
    if turn <= 1e-14 and jump * shorter <= 1e-14 and kind[k] == 0 and kind[k + 1] == 0:
        return 1, cosine, turn
    # long lines: overlapping runs pass the corner faster than a blend of their tolerance
    alone = ((kind[k] == 0 and kind[k + 1] == 0) or turn > _BENT) and lonely * tolerance[k] < BLEND * turn * shorter
    if tolerance[k] > 0.0 and turn <= 2.0 * sharpest and not alone:
        return (3 if arcs and turn <= _ALMOST and jump <= _ALMOST * bend else 2), cosine, turn
    return 0, cosine, turn


@kernel
def join(
    kind: Ints,
    length: Floats,
    origin: Floats2,
    shape: Floats3,
    feed: Floats,
    line: Ints,
    tolerance: Floats,
    sharpest: float,
    lonely: float,
    begin: float,
    flows: bool,
    ends: bool,
    held: int,
    deviation: Floats,
    stop: Ints,
    kinds: Ints,
    lengths: Floats,
    origins: Floats2,
    shapes: Floats3,
    feeds: Floats,
    lines: Ints,
    runs: Ints,
    goals: int,
    kept: Floats,
    begins: Floats2,
    floor: Floats,
    at: Floats,
    goal: Floats,
    directions: Floats2,
    inside: Ints,
    sharing: Floats,
    corner: Floats,
    group: Ints,
    slope: Floats2,
    far: Floats,
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
) -> tuple[int, int, int, float, int, int]:
    """Write the pieces of n segments, with blends or splines between them, into `kinds` .. `runs`.

    Return the number of pieces; the number of runs that end in them; the first remaining segment, or -1 if an
    unfinished spline cannot be continued; the length of this segment used by the preceding blend; the number of goal
    positions of an unfinished spline, which is `goals` in the next call; and the number of pieces including those of a
    planned stop.

    Unless the chain `ends`, the last segment, or a cluster that may continue, is left for the next call.  In a cluster
    of more than `held` lines the spline is final up to a knot far enough before the last line; the pieces from there to
    the planned stop, at the end of the last line, follow the others.

    tolerance  tolerance of the joint after each segment, m; negative: stop; 0: stop unless it is smooth
    sharpest   sine of half of the largest corner angle without a stop
    lonely     the run also stops at a corner of segments that are longer than this multiple of the blend length
               (next to an arc only at corners above 0.2 rad); 0: at every corner between lines
    begin      length of the first segment used by the preceding blend
    flows      True if the run continues into the first segment
    runs       run number of each piece
    kept, begins, floor, at, goal  knots, state, distances and goal positions of an unfinished spline, see `fitted`
    inside     joints that belong to a cluster; those of a cluster that cannot be fitted are cleared
    directions, sharing .. far, at_next .. curve  workspace for n + 1 segments, and for knots, as in `fitted`
    """
    n = len(length)
    axes = len(origin[0])
    a = room[0]
    b = room[1]
    at_joint = room[2]
    half = room[3]
    difference = room[4]
    blended = room[5]
    r = room[6]
    piece = zeros(8)
    count = 0
    clustered(kind, length, shape, tolerance, sharpest, lonely, directions, inside)
    run = 0
    ahead = 0.0
    k = 0
    while k < (n if ends else n - 1):
        if inside[k] == 1:
            last = k + 1
            while inside[last] == 1:
                last = last + 1
            goes_on = last == n - 1 and not ends
            if goes_on and n - k < held:
                for m in range(k, n):
                    ahead = ahead + length[m]
                if n - k < held // 5 or ahead < _AHEAD:
                    break
            fixed = 0
            if k == 0 and goals > 0:
                fixed = ENDS - 1
                for m in range(2 * ENDS):
                    knots[m] = kept[m]
            way, cosine, turn = _passed(last, kind, length, shape, tolerance, sharpest, lonely, a, b)
            if goes_on:
                way = 0
            end = 0.5 * length[last] if way > 0 else 0.0
            leaves = flows and fixed == 0
            crossed = not flows and fixed == 0
            stops = way == 0 and not goes_on and last + 1 < n and tolerance[last] > 0.0
            steps, places = fitted(
                k,
                last,
                0.5 * length[k] if leaves else 0.0,
                end,
                leaves,
                way > 0,
                crossed,
                stops,
                _LONG if goes_on else _SHORT,
                fixed,
                goals,
                begins,
                length,
                shape,
                origin,
                tolerance,
                sharing,
                corner,
                group,
                slope,
                floor,
                far,
                at,
                goal,
                at_next,
                goal_next,
                knots,
                x,
                control,
                segment,
                straight,
                curved,
                state,
                curve,
                room,
            )
            if steps == 0 and fixed > 0:
                return 0, 0, -1, 0.0, 0, 0
            if steps == 0:
                for m in range(k, last):
                    inside[m] = 0
            else:
                e = ENDS + steps
                if goes_on:
                    # beyond this knot the knots, the sharp corners and the end of the cluster may still change
                    e = e - FITTED - 2 * ENDS
                    until = min(corner[last], corner[n] - 2.0 * NEAR * tolerance[last - 1])
                    while e > ENDS and knots[e + 2 * ENDS] > until:
                        e = e - 1
                    if e <= ENDS:
                        break
                u = knots[ENDS] if fixed > 0 else corner[k] + begin
                count, u = spline_pieces(
                    k,
                    last,
                    ENDS,
                    e,
                    u,
                    corner,
                    origin,
                    slope,
                    feed,
                    line,
                    knots,
                    control,
                    state,
                    curve,
                    curved,
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
                until = knots[e] if goes_on else corner[last]
                if u < until:
                    count = straight_pieces(
                        u,
                        until,
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
                    u = until
                left = segment[e - ENDS] if goes_on else last
                for m in range(k, left):
                    stop[m] = 0
                    deviation[m] = max(far[m], far[m + 1])
                if goes_on:
                    every, u = spline_pieces(
                        k,
                        last,
                        e,
                        ENDS + steps,
                        u,
                        corner,
                        origin,
                        slope,
                        feed,
                        line,
                        knots,
                        control,
                        state,
                        curve,
                        curved,
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
                    every = straight_pieces(
                        u,
                        corner[n],
                        k,
                        last,
                        corner,
                        origin,
                        slope,
                        feed,
                        line,
                        run,
                        every,
                        kinds,
                        lengths,
                        origins,
                        shapes,
                        feeds,
                        lines,
                        runs,
                    )
                    places = carried(e, corner[left], at, goal, places, knots, kept)
                    for i in range(axes):
                        for m in range(4):
                            begins[i, m] = state[e, i, m]
                    for m in range(left, n):
                        if corner[m] > knots[e]:
                            far[m] = 0.0
                    return count, run, left, 0.0, places, every
                begin = length[last] - end - (knots[e] - u)
                k = last
        elif k == 0 and goals > 0:
            return 0, 0, -1, 0.0, 0, 0
        end = length[k]
        away = 0.0
        span = 0.0
        deviation[k] = 0.0
        stop[k] = 1
        way, cosine, turn = _passed(k, kind, length, shape, tolerance, sharpest, lonely, a, b)
        if way == 1:
            stop[k] = 0
        elif way > 1:
            away, span, most = blend(
                kind[k],
                length[k],
                shape[k],
                kind[k + 1],
                length[k + 1],
                shape[k + 1],
                cosine,
                0.5 * min(length[k], length[k + 1]),
                (1.0 if way == 2 else _LITTLE) * tolerance[k],
                turn > SMOOTH,
                a,
                b,
                at_joint,
                half,
                difference,
                blended,
            )
            if away > 0.0:
                stop[k] = 0
                deviation[k] = most
                end = length[k] - away
        # blends on both sides may use up the whole segment: a remainder of rounding is no piece
        if end - begin > 1e-12 * length[k]:
            kinds[count] = kind[k]
            lengths[count] = trimmed(kind[k], length[k], shape[k], begin, end, shapes[count])
            derivatives(kind[k], length[k], shape[k], begin, r)
            for i in range(axes):
                origins[count, i] = origin[k, i] + r[i, 0]
            feeds[count] = feed[k]
            lines[count] = line[k]
            runs[count] = run
            count = count + 1
        begin = 0.0
        if away > 0.0:
            for cut in range(_CUTS):
                kinds[count] = 2
                lengths[count] = span / _CUTS
                feeds[count] = min(feed[k], feed[k + 1])
                lines[count] = line[k] if 2 * cut < _CUTS else line[k + 1]
                runs[count] = run
                for i in range(axes):
                    part_of(blended[i], cut / _CUTS, 1.0 / _CUTS, piece)
                    # the small terms first: added to the coordinate one by one they would lose digits
                    origins[count, i] = origin[k + 1, i] + (a[i, 0] + piece[0])
                    shapes[count, i, 0] = 0.0
                    for m in range(1, 8):
                        shapes[count, i, m] = piece[m]
                count = count + 1
            begin = away
        flows = stop[k] == 0
        if stop[k] == 1:
            run = run + 1
        k = k + 1
    return count, run, k, begin, 0, count


class _Begun(NamedTuple):
    """The state of an unfinished spline that is continued in the next call of `join`."""

    places: int
    knots: np.ndarray
    state: np.ndarray
    far: np.ndarray
    at: np.ndarray
    goal: np.ndarray
    hand: Pieces  # pieces from its current end to a stop after the last segment


class Joiner:
    """A joiner, which connects the segments of consecutive chains (`Chain`) into runs, the sections between two stops.

    sharpest  sine of half of the largest corner angle without a stop, as in `join`
    lonely    limit of the length of the segments next to a corner, as in `join`
    held      a cluster (lines too short for separate blends) that may continue in the next chain is held back while it
              has fewer lines than this; from a fifth of this number, only if they are shorter than 50 mm in total
    """

    def __init__(self, sharpest: float = 0.35, lonely: float = LONELY, held: int = 5000) -> None:
        self._sharpest, self._lonely, self._most = sharpest, lonely, held
        self._taken, self._flows = 0.0, False
        self._held: tuple[Pieces, np.ndarray] | None = None  # the last segments of an unfinished chain
        self._begun: _Begun | None = None

    @property
    def rests(self) -> bool:
        """True if the next chain begins a run."""
        return self._held is None and self._begun is None and not self._flows

    def join(self, chain: Chain) -> tuple[list[Section], Joint]:
        """Return the sections that a chain adds to the runs, and the joints after its segments."""
        segments, tolerance = chain.segments, chain.tolerance
        if self._held:
            segments = one_after_the_other([self._held[0], segments])
            tolerance = np.concatenate([self._held[1], tolerance])
        result = self._joined(segments, tolerance, chain.ends)
        if result is None:
            return self._stopped(chain)
        sections, joint = result
        n, done = len(tolerance), len(joint.stop)
        if done:
            self._flows = not chain.ends and joint.stop[-1] == 0
        self._held = None if chain.ends else (part_of_pieces(segments, done, n), tolerance[done:])
        return sections, joint

    def _stopped(self, chain: Chain) -> tuple[list[Section], Joint]:
        """End the run at its planned stop, since its spline cannot be continued; join the chain from there as a new
        run.
        """
        assert self._begun is not None
        assert self._held is not None
        far, (held, tolerance) = self._begun.far, self._held
        count, n = len(far), len(tolerance)
        stop = Section(self._begun.hand, True, 0.0)
        before = Joint(np.append(np.maximum(far[:-1], far[1:]), 0.0), np.zeros(count, np.int64))
        before.stop[-1] = 1
        self._taken, self._flows, self._begun = 0.0, False, None
        self._held = (part_of_pieces(held, count, n), tolerance[count:]) if n > count else None
        sections, joint = self.join(chain)
        return [stop, *sections], Joint(*(np.concatenate(arrays) for arrays in zip(before, joint, strict=True)))

    def _joined(self, segments: Pieces, tolerance: np.ndarray, ends: bool) -> tuple[list[Section], Joint] | None:
        """Return the sections and the joints after the finished segments, or None if a spline cannot be continued."""
        n, axes = segments.origin.shape
        joint = Joint(np.zeros(n), np.zeros(n, np.int64))
        # two knots per line, and the largest steps over the length; the number is known only after the fit
        expected = 2.0 * n + float(np.sum(segments.length)) / LARGEST_STEP + 50.0
        many = int(min(expected, 2.0 * n + _FIRST))
        begun = self._begun
        while True:
            most = (1 + _CUTS) * n + many
            out = (
                np.zeros(most, np.int64),
                np.zeros(most),
                np.zeros((most, axes)),
                np.zeros((most, axes, 8)),
                np.zeros(most),
                np.zeros(most, np.int64),
                np.zeros(most, np.int64),
            )
            kept, state, far = np.zeros(2 * ENDS), np.zeros((axes, 4)), np.zeros(n)
            floor, at, goal = (np.zeros(size) for size in (n, many, many))
            if begun:
                kept[:], state[:], floor[: len(begun.far)] = begun.knots, begun.state, begun.far
                at[: begun.places], goal[: begun.places] = begun.at, begun.goal
            goals = begun.places if begun else 0
            try:
                count, ended, done, taken, places, every = join(
                    *segments,
                    tolerance,
                    self._sharpest,
                    self._lonely,
                    self._taken,
                    self._flows,
                    ends,
                    self._most,
                    *joint,
                    *out,
                    goals,
                    kept,
                    state,
                    floor,
                    at,
                    goal,
                    *_room(n, many, axes, far),
                )
                break
            except IndexError:
                # the kernel ran out of room for its knots: it starts again with twice as much
                if many > _MOST * expected:
                    raise
                many *= 2
        if done < 0:
            return None
        *columns, runs = (array[:count].copy() for array in out)
        joint = Joint(*(array[:done] for array in joint))
        cuts = [0, *(np.flatnonzero(np.diff(runs)) + 1).tolist(), count] if count else []
        corners = np.maximum(tolerance[:done][joint.stop == 1], 0.0)
        sections = list[Section]()
        for i, j in pairwise(cuts):
            corner = float(corners[runs[i]]) if runs[i] < ended else 0.0
            if columns[0][j - 1] == POLYNOMIAL or j == count or columns[0][j] == POLYNOMIAL:
                # a spline ends or begins there: its first and last span keep the other tenth
                corner = CROSSED * corner
            sections.append(Section(Pieces(*(column[i:j] for column in columns)), bool(runs[i] < ended), corner))
        if done == 0 and begun:
            # wait for more segments; the unfinished spline stays as it was
            return sections, joint
        self._taken, self._begun = taken, None
        if places:
            hand = Pieces(*(array[count:every].copy() for array in out[:-1]))
            self._begun = _Begun(places, kept, state, far[done:].copy(), at[:places].copy(), goal[:places].copy(), hand)
        return sections, joint


def joined(
    segments: Pieces, tolerance: np.ndarray, sharpest: float = 0.35, lonely: float = LONELY
) -> tuple[list[Pieces], Joint]:
    """Return the runs of consecutive segments, and the joints after them; parameters as in `join`."""
    sections, joint = Joiner(sharpest, lonely).join(Chain(segments, tolerance, True))
    return [section.pieces for section in sections], joint


def _room(lines: int, knots: int, axes: int, far: np.ndarray) -> list[np.ndarray]:
    """Allocate the work arrays of `join` for the lines of a chain and the knots of a cluster."""
    return [
        np.zeros((3, axes)),
        np.zeros(lines, np.int64),
        *(np.zeros(lines + 1) for _ in range(2)),
        np.zeros(lines, np.int64),
        np.zeros((lines, axes)),
        far,
        *(np.zeros(knots) for _ in range(4)),
        np.zeros((knots, axes)),
        *(np.zeros(knots, np.int64) for _ in range(3)),
        np.zeros((knots, axes, 4)),
        np.zeros((knots, axes, 8)),
        np.zeros((7, axes, max(8, axes))),
    ]
