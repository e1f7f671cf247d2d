"""Joining of segments into a path: a joint is already smooth, rounded by a blend within the tolerance, or a stop.

The segments of a run are connected lines and arcs as `Pieces`.  A blend uses at most half of the length of each of its
segments.  A blend is stored in eight pieces, so that the bounds on its derivatives are tight.
"""

from __future__ import annotations

from itertools import pairwise
from math import sqrt
from typing import NamedTuple, cast

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Ints, Records, rows_for
from feeddrive.path.geometry.cluster import (
    BLEND,
    CROSSED,
    ENDS,
    FITTED,
    LARGEST_STEP,
    NEAR,
    Boundary,
    Fit,
    Goals,
    Joined,
    Lines,
    Unfinished,
    carried,
    cluster_room,
    clustered,
    fit_room,
    fitted,
    lines_room,
    spline_pieces,
    straight_pieces,
)
from feeddrive.path.geometry.cluster import Room as ClusterRoom
from feeddrive.path.geometry.hermite import State
from feeddrive.path.geometry.segments import (
    NO_BLEND,
    Blend,
    BlendRoom,
    Chain,
    blend,
    blend_room,
    goes_on,
    part_of,
    state_near,
    trimmed,
)
from feeddrive.path.motion import (
    POLYNOMIAL,
    Changes,
    Derivatives,
    Piece,
    Pieces,
    Section,
    derivatives,
    one_after_the_other,
    part_of_pieces,
)

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
_SLIVER = 1e-9  # of a piece


class Joint(NamedTuple):
    """The outcome for the joint after each segment: the deviation of its blend, and whether the run stops there."""

    deviation: Floats  # m, proven distance to the segments of the joint; 0 without a blend
    stop: Ints  # 1 if the run ends there


STOP, SMOOTH_JOINT, BLENDED, SMALL = 0, 1, 2, 3


class Rule(NamedTuple):
    """The rule by which joints are passed.

    sharpest  sine of half of the largest corner angle without a stop
    lonely    the run also stops at a corner of segments that are longer than this multiple of the blend length (next to
              an arc only at corners above 0.2 rad); 0: at every corner between lines
    held      a cluster that may continue is left for the next call while it has fewer lines than this
    """

    sharpest: float
    lonely: float
    held: int


class Passed(NamedTuple):
    """How a joint is passed, and the cosine and the chord of its turning angle.

    way  0: stop, 1: already smooth, 2: blend, 3: small blend between arcs of almost the same circle
    """

    way: int
    cosine: float
    turn: float


class Work(NamedTuple):
    """Work arrays of `join`: joints that belong to a cluster (of one that cannot be fitted they are cleared), and those
    of clusters and blends; states and derivatives of each axis.
    """

    inside: Ints
    lines: Lines
    fit: Fit
    cluster: ClusterRoom
    blend: BlendRoom
    r: Records[Derivatives]
    s: Records[Derivatives]


@kernel
def _passed(segments: Pieces, tolerance: Floats, k: int, rule: Rule, work: Work) -> Passed:
    """Return how the joint after segment k is passed."""
    if k + 1 == len(segments.length) or tolerance[k] < 0.0:
        return Passed(STOP, 0.0, 0.0)
    one = Piece(segments.kind[k], segments.length[k], segments.shape[k])
    two = Piece(segments.kind[k + 1], segments.length[k + 1], segments.shape[k + 1])
    if one.kind == 2 or two.kind == 2:  # a spline is followed exactly: no blend may start on it
        return Passed(SMOOTH_JOINT if goes_on(one, two, work.r, work.s) else STOP, 0.0, 0.0)
    arcs = one.kind == 1 and two.kind == 1
    lines = one.kind == 0 and two.kind == 0
    if arcs and goes_on(one, two, work.r, work.s):
        return Passed(SMOOTH_JOINT, 1.0, 0.0)
    state_near(one, 0.0, True, work.blend.a)
    state_near(two, 0.0, False, work.blend.b)
    cosine = 0.0
    size0 = 0.0
    size1 = 0.0
    turn = 0.0
    jump = 0.0
    bend = 0.0
    for i in range(len(work.blend.a)):
        a = work.blend.a[i]
        b = work.blend.b[i]
        cosine = cosine + a.first * b.first
        size0 = size0 + a.first * a.first
        size1 = size1 + b.first * b.first
        turn = turn + (a.first - b.first) * (a.first - b.first)
        jump = max(jump, abs(a.second - b.second))
        bend = max(bend, abs(a.second))
    cosine = cosine / sqrt(size0 * size1)
    turn = sqrt(turn)
    shorter = min(one.length, two.length)
    # collinear lines: their directions, quotients of rounded numbers, differ in the last digits
    if turn <= 1e-14 and jump * shorter <= 1e-14 and lines:
        return Passed(SMOOTH_JOINT, cosine, turn)
    # long lines: overlapping runs pass the corner faster than a blend of their tolerance
    alone = (lines or turn > _BENT) and rule.lonely * tolerance[k] < BLEND * turn * shorter
    if tolerance[k] > 0.0 and turn <= 2.0 * rule.sharpest and not alone:
        small = arcs and turn <= _ALMOST and jump <= _ALMOST * bend
        return Passed(SMALL if small else BLENDED, cosine, turn)
    return Passed(STOP, cosine, turn)


@kernel
def _blended(
    segments: Pieces,
    tolerance: Floats,
    k: int,
    passed: Passed,
    run: int,
    begin: float,
    count: int,
    work: Work,
    out: Joined,
) -> tuple[int, Blend]:
    """Append segment k from `begin` on, and the blend behind it; return the new count and the blend."""
    rounded = NO_BLEND
    length = segments.length[k]
    end = length
    if passed.way == BLENDED or passed.way == SMALL:
        rounded = blend(
            Piece(segments.kind[k], segments.length[k], segments.shape[k]),
            Piece(segments.kind[k + 1], segments.length[k + 1], segments.shape[k + 1]),
            passed.cosine,
            0.5 * min(length, segments.length[k + 1]),
            (1.0 if passed.way == BLENDED else _LITTLE) * tolerance[k],
            passed.turn > SMOOTH,
            work.blend,
        )
        if rounded.length > 0.0:
            end = length - rounded.length
    pieces = out.pieces
    axes = len(work.r)
    # blends on both sides may use up the whole segment: a remainder of rounding is no piece
    if end - begin > 1e-12 * length:
        pieces.kind[count] = segments.kind[k]
        pieces.length[count] = trimmed(
            Piece(segments.kind[k], segments.length[k], segments.shape[k]), begin, end, pieces.shape[count]
        )
        derivatives(segments.kind[k], length, segments.shape[k], begin, work.r)
        for i in range(axes):
            pieces.origin[count, i] = segments.origin[k, i] + work.r[i].value
        pieces.feed[count] = segments.feed[k]
        pieces.line[count] = segments.line[k]
        out.runs[count] = run
        out.segment[count] = k
        out.begin[count] = begin
        out.covers[count] = pieces.length[count]
        count = count + 1
    if rounded.length > 0.0:
        for cut in range(_CUTS):
            pieces.kind[count] = 2
            pieces.length[count] = rounded.span / _CUTS
            pieces.feed[count] = min(segments.feed[k], segments.feed[k + 1])
            pieces.line[count] = segments.line[k] if 2 * cut < _CUTS else segments.line[k + 1]
            out.runs[count] = run
            # the middle of the blend stands for the joint
            way = 2.0 * rounded.length * cut / _CUTS
            out.segment[count] = k if 2 * cut < _CUTS else k + 1
            out.begin[count] = end + way if 2 * cut < _CUTS else way - rounded.length
            out.covers[count] = 2.0 * rounded.length / _CUTS
            for i in range(axes):
                piece = pieces.shape[count]
                row = piece[i]
                part_of(work.blend.blended[i], cut / _CUTS, 1.0 / _CUTS, row)
                # the small terms first: added to the coordinate one by one they would lose digits
                pieces.origin[count, i] = segments.origin[k + 1, i] + (work.blend.a[i].value + row[0])
                row[0] = 0.0
            count = count + 1
    return count, rounded


class Ended(NamedTuple):
    """What `join` has written.

    pieces  number of pieces
    ended   number of runs that end in them
    done    the first remaining segment, or -1 if an unfinished spline cannot be continued
    taken   length of this segment used by the preceding blend, m
    goals   number of goals of an unfinished spline
    every   number of pieces including those of a planned stop
    """

    pieces: int
    ended: int
    done: int
    taken: float
    goals: int
    every: int


_NOT_CONTINUED = Ended(0, 0, -1, 0.0, 0, 0)


@kernel
def join(
    tolerance: Floats,
    rule: Rule,
    begin: float,
    flows: bool,
    ends: bool,
    begun: Unfinished,
    joint: Joint,
    out: Joined,
    work: Work,
) -> Ended:
    """Write the pieces of the segments `work.lines.pieces`, with blends or splines between them, into `out`.

    Unless the chain `ends`, the last segment, or a cluster that may continue, is left for the next call.  In a cluster
    of more than `rule.held` lines the spline is final up to a knot far enough before the last line; the pieces from
    there to the planned stop, at the end of the last line, follow the others.

    tolerance  tolerance of the joint after each segment, m; negative: stop; 0: stop unless it is smooth
    begin      length of the first segment used by the preceding blend, m
    flows      True if the run continues into the first segment
    begun      an unfinished spline at the start of the segments, and on output at their end
    joint      the outcome for the joints
    """
    lines = work.lines
    segments = lines.pieces
    length = segments.length
    inside = work.inside
    fit = work.fit
    n = len(length)
    count = 0
    clustered(segments, tolerance, rule.sharpest, rule.lonely, work.cluster, inside)
    run = 0
    ahead = 0.0
    k = 0
    while k < (n if ends else n - 1):
        if inside[k] == 1:
            last = k + 1
            while inside[last] == 1:
                last = last + 1
            continues = last == n - 1 and not ends
            if continues and n - k < rule.held:
                for m in range(k, n):
                    ahead = ahead + length[m]
                if n - k < rule.held // 5 or ahead < _AHEAD:
                    break
            fixed = 0
            if k == 0 and begun.many > 0:
                fixed = ENDS - 1
                for m in range(2 * ENDS):
                    fit.knots[m] = begun.knots[m]
            way = STOP if continues else _passed(segments, tolerance, last, rule, work).way
            leaves = flows and fixed == 0
            boundary = Boundary(
                0.5 * length[k] if leaves else 0.0,
                0.5 * length[last] if way > 0 else 0.0,
                leaves,
                way > 0,
                not flows and fixed == 0,
                way == 0 and not continues and last + 1 < n and tolerance[last] > 0.0,
            )
            most_steps = _LONG if continues else _SHORT
            steps, goals = fitted(lines, tolerance, k, last, boundary, most_steps, fixed, begun, fit, work.cluster)
            if steps == 0 and fixed > 0:
                return _NOT_CONTINUED
            if steps == 0:
                for m in range(k, last):
                    inside[m] = 0
            else:
                corner = lines.corner
                knots = fit.knots
                e = ENDS + steps
                if continues:
                    # beyond this knot the knots, the sharp corners and the end of the cluster may still change
                    e = e - FITTED - 2 * ENDS
                    until = min(corner[last], corner[n] - 2.0 * NEAR * tolerance[last - 1])
                    while e > ENDS and knots[e + 2 * ENDS] > until:
                        e = e - 1
                    if e <= ENDS:
                        break
                u = knots[ENDS] if fixed > 0 else corner[k] + begin
                count, u = spline_pieces(lines, k, last, ENDS, e, u, fit, run, count, out)
                until = knots[e] if continues else corner[last]
                if u < until:
                    count = straight_pieces(lines, k, last, u, until, run, count, out)
                    u = until
                left = fit.segment[e - ENDS] if continues else last
                for m in range(k, left):
                    joint.stop[m] = 0
                    joint.deviation[m] = max(lines.far[m], lines.far[m + 1])
                if continues:
                    every, u = spline_pieces(lines, k, last, e, ENDS + steps, u, fit, run, count, out)
                    every = straight_pieces(lines, k, last, u, corner[n], run, every, out)
                    goals = carried(e, corner[left], goals, work.cluster.goals, knots, begun)
                    for i in range(len(begun.begins)):
                        begun.begins[i] = fit.state[e, i]
                    for m in range(left, n):
                        if corner[m] > knots[e]:
                            lines.far[m] = 0.0
                    return Ended(count, run, left, 0.0, goals, every)
                begin = length[last] - boundary.end - (knots[e] - u)
                k = last
        elif k == 0 and begun.many > 0:
            return _NOT_CONTINUED
        passed = _passed(segments, tolerance, k, rule, work)
        count, rounded = _blended(segments, tolerance, k, passed, run, begin, count, work, out)
        begin = rounded.length
        flows = passed.way == SMOOTH_JOINT or rounded.length > 0.0
        joint.deviation[k] = rounded.deviation
        joint.stop[k] = 0 if flows else 1
        if not flows:
            run = run + 1
        k = k + 1
    return Ended(count, run, k, begin, 0, count)


class _Begun(NamedTuple):
    """An unfinished spline, and the pieces from its current end to a stop after the last segment, with the changes of
    the line along them.
    """

    spline: Unfinished
    hand: Pieces
    lines: Changes


class Joiner:
    """A joiner, which connects the segments of consecutive chains (`Chain`) into runs, the sections between two stops.

    sharpest, lonely  as in `Rule`
    held              a cluster (lines too short for separate blends) that may continue in the next chain is held back
                      while it has fewer lines than this; from a fifth of this number, only if they are shorter than
                      50 mm in total
    """

    def __init__(self, sharpest: float = 0.35, lonely: float = LONELY, held: int = 5000) -> None:
        self._rule = Rule(sharpest, lonely, held)
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
            held, kept = self._held
            segments, tolerance = one_after_the_other([held, segments]), np.concatenate([kept, tolerance])
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
        far, (held, tolerance) = self._begun.spline.floor, self._held
        count, n = len(far), len(tolerance)
        stop = Section(self._begun.hand, True, 0.0, self._begun.lines)
        before = Joint(np.append(np.maximum(far[:-1], far[1:]), 0.0), np.zeros(count, np.int64))
        before.stop[-1] = 1
        self._taken, self._flows, self._begun = 0.0, False, None
        self._held = (part_of_pieces(held, count, n), tolerance[count:]) if n > count else None
        sections, joint = self.join(chain)
        return [stop, *sections], Joint._make([np.concatenate(arrays) for arrays in zip(before, joint, strict=True)])

    def _joined(self, segments: Pieces, tolerance: np.ndarray, ends: bool) -> tuple[list[Section], Joint] | None:
        """Return the sections and the joints after the finished segments, or None if a spline cannot be continued."""
        n, axes = segments.origin.shape
        joint = Joint(np.zeros(n), np.zeros(n, np.int64))
        # two knots per line, and the largest steps over the length; the number is known only after the fit
        expected = 2.0 * n + float(np.sum(segments.length)) / LARGEST_STEP + 50.0
        many = int(min(expected, 2.0 * n + _FIRST))
        before = self._begun
        while True:
            out = _pieces_room((1 + _CUTS) * n + many, axes)
            begun, work = _unfinished(before, segments, many), _room(segments, many)
            try:
                ended = join(tolerance, self._rule, self._taken, self._flows, ends, begun, joint, out, work)
                break
            except IndexError:
                # the kernel ran out of room for its knots: it starts again with twice as much
                if many > _MOST * expected:
                    raise
                many *= 2
        if ended.done < 0:
            return None
        pieces = Pieces._make([array[: ended.pieces].copy() for array in out.pieces])
        runs = out.runs[: ended.pieces]
        joint = Joint._make([array[: ended.done] for array in joint])
        cuts = [0, *(np.flatnonzero(np.diff(runs)) + 1).tolist(), ended.pieces] if ended.pieces else []
        corners = np.maximum(tolerance[: ended.done][joint.stop == 1], 0.0)
        sections = list[Section]()
        begins = np.cumsum(segments.length) - segments.length
        for i, j in pairwise(cuts):
            corner = float(corners[runs[i]]) if runs[i] < ended.ended else 0.0
            if pieces.kind[j - 1] == POLYNOMIAL or j == ended.pieces or pieces.kind[j] == POLYNOMIAL:
                # a spline ends or begins there: its first and last span keep the other tenth
                corner = CROSSED * corner
            changes = _changes(segments, begins, out, i, j)
            sections.append(Section(part_of_pieces(pieces, i, j), bool(runs[i] < ended.ended), corner, changes))
        if ended.done == 0 and before:
            # wait for more segments; the unfinished spline stays as it was
            return sections, joint
        self._taken, self._begun = ended.taken, None
        if ended.goals:
            hand = Pieces._make([array[ended.pieces : ended.every].copy() for array in out.pieces])
            goals = Goals(*(array[: ended.goals].copy() for array in begun.goals))
            floor = work.lines.far[ended.done :].copy()
            spline = begun._replace(many=ended.goals, goals=goals, floor=floor)
            self._begun = _Begun(spline, hand, _changes(segments, begins, out, ended.pieces, ended.every))
        return sections, joint


def joined(
    segments: Pieces, tolerance: np.ndarray, sharpest: float = 0.35, lonely: float = LONELY
) -> tuple[list[Pieces], Joint]:
    """Return the runs of consecutive segments, and the joints after them; parameters as in `Rule`."""
    sections, joint = Joiner(sharpest, lonely).join(Chain(segments, tolerance, True))
    return [section.pieces for section in sections], joint


def _changes(segments: Pieces, begins: np.ndarray, out: Joined, first: int, last: int) -> Changes:
    """Return where the line of segments, which begin at the distances `begins`, changes along pieces from `first` up
    to but excluding `last`.
    """
    segment, covers, length = out.segment[first:last], out.covers[first:last], out.pieces.length[first:last]
    starts = begins[segment] + out.begin[first:last]
    # an end that is that of a segment up to rounding is no change
    ends = begins.searchsorted(starts + covers * (1.0 - _SLIVER))
    along = length.cumsum() - length
    more = np.maximum(ends - segment - 1, 0)
    if not more.any():
        return Changes(along, segments.line[segment])
    piece = np.repeat(np.arange(len(segment)), more)
    inside = np.arange(len(piece)) - np.repeat(np.cumsum(more) - more, more) + segment[piece] + 1
    share = (begins[inside] - starts[piece]) / covers[piece]
    at = np.concatenate([along, along[piece] + np.clip(share, 0.0, 1.0) * length[piece]])
    line = np.concatenate([segments.line[segment], segments.line[inside]])
    order = np.argsort(at, kind="stable")
    return Changes(at[order], line[order])


def _unfinished(before: _Begun | None, segments: Pieces, many: int) -> Unfinished:
    """Return the unfinished spline of the last call, with room for `many` goals and for all segments."""
    n, axes = segments.origin.shape
    goals = Goals(np.zeros(many), np.zeros(many))
    begun = Unfinished(0, goals, np.zeros(2 * ENDS), rows_for(State, axes), np.zeros(n))
    if before is None:
        return begun
    spline = before.spline
    for array, known in zip(goals, spline.goals, strict=True):
        array[: spline.many] = known
    begun.knots[:], begun.floor[: len(spline.floor)] = spline.knots, spline.floor
    np.copyto(cast(np.ndarray, begun.begins), cast(np.ndarray, spline.begins))
    return begun._replace(many=spline.many)


def _pieces_room(most: int, axes: int) -> Joined:
    """Return room for pieces."""
    return Joined(
        Pieces(
            np.zeros(most, np.int64),
            np.zeros(most),
            np.zeros((most, axes)),
            np.zeros((most, axes, 8)),
            np.zeros(most),
            np.zeros(most, np.int64),
        ),
        np.zeros(most, np.int64),
        np.zeros(most, np.int64),
        *np.zeros((2, most)),
    )


def _room(segments: Pieces, knots: int) -> Work:
    """Allocate the work arrays of `join` for the lines of a chain and the knots of a cluster."""
    n, axes = segments.origin.shape
    return Work(
        np.zeros(n, np.int64),
        lines_room(segments),
        fit_room(knots, axes),
        cluster_room(knots, axes),
        blend_room(axes),
        *(rows_for(Derivatives, axes) for _ in range(2)),
    )
