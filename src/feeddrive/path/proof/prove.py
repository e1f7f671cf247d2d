"""An independent proof that a planned motion keeps the limits of each axis in continuous time, joints included.

Over a span of time on one piece of the path each factor of the chain rule is an interval (`ranges`).  A span that does
not hold is halved, until it holds or its middle breaks a limit.  At the joints of path and time the jumps are taken
from the planned state.  Nothing here is shared with what plans: a fault there is not repeated here.

Rounding is not directed.  A test rounds some hundred times, so that 1e-13 of its largest term is added to its interval;
each limit is widened by 1e-9 of itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.path.motion import Entering, Motion, Part, chain, cubic, rows, way, when
from feeddrive.path.pieces import Pieces, derivatives, part_of_pieces
from feeddrive.path.proof.overlap import prove_sum
from feeddrive.path.proof.ranges import cubic_range, line_range, parabola_range, share_of_limits, slopes

WIDENED = 1e-9  # of a limit
_KEPT = 100  # faults


@kernel
def _span(
    kind: int, length: float, shape: Floats2, feed: float, limits: Floats2, widened: float,
    x: float, v: float, a: float, j: float, s: float, t0: float, t1: float, halves: Floats2, r: Floats3,
) -> tuple[int, int, float]:  # fmt: skip
    """Tests made, the limit that does not hold (-2: all hold) and when, on one piece; x, u' .. u'''' are at t = 0."""
    tests = 0
    count = 1
    halves[0, 0] = t0
    halves[0, 1] = t1
    shortest = (t1 - t0) * 1e-12
    while count > 0:
        count = count - 1
        b = halves[count, 0]
        e = halves[count, 1]
        tests = tests + 1
        v0, v1 = cubic_range(v, a, j, s, b, e)
        a0, a1 = parabola_range(a, j, s, b, e)
        j0, j1 = line_range(j, s, b, e)
        x0 = min(max(x + way(v, a, j, s, b), 0.0), length)
        x1 = min(max(x + way(v, a, j, s, e), 0.0), length)
        norm = slopes(kind, length, shape, x0, max(x0, x1), r)
        share, which = share_of_limits(v0, v1, a0, a1, j0, j1, s, r, norm, limits, feed, 1e-13)
        if share <= 1.0 + widened:
            continue
        m = 0.5 * (b + e)
        x0 = min(max(x + way(v, a, j, s, m), 0.0), length)
        v0 = cubic(v, a, j, s, m)
        a0 = a + m * (j + 0.5 * m * s)
        j0 = j + m * s
        norm = slopes(kind, length, shape, x0, x0, r)
        share, which = share_of_limits(v0, v0, a0, a0, j0, j0, s, r, norm, limits, feed, -1e-13)
        if share > 1.0 + widened or e - b <= shortest or count + 2 > len(halves):
            return tests, which, m
        halves[count, 0] = m
        halves[count, 1] = e
        halves[count + 1, 0] = b
        halves[count + 1, 1] = m
        count = count + 2
    return tests, -2, 0.0


@kernel
def _noted(faults: Floats2, found: int, p: int, m: int, time: float, which: float, share: float) -> int:
    """A fault more; those that have no row are counted only."""
    if found < len(faults):
        faults[found] = float(p), float(m), time, which, share
    return found + 1


@kernel
def _prove(
    kind: Ints, length: Floats, origin: Floats2, shape: Floats3, feed: Floats,
    duration: Floats, piece: Ints, x: Floats, speed: Floats, acceleration: Floats, jerk: Floats, snap: Floats,
    limits: Floats2, widened: float, anywhere: bool, ends: bool, alone: bool,
    state: Floats, place: Floats, faults: Floats2, uses: Floats2, jumps: Floats,
    halves: Floats2, r: Floats3, before: Floats2, after: Floats2, q: Floats2,
) -> tuple[int, int]:  # fmt: skip
    """Tests made and faults found; each a row of `faults`: piece of the path, time piece, time in it, limit, share.

    A motion that is not `alone` is only proven to have no jumps: its limits are those of a sum, for `prove_sum`.
    `state` is x, u' .. u''' where the part before ended, on the first piece of this one, and `place` the position there
    unless it begins `anywhere`; then where this one ends.
    """
    tests = 0
    found = 0
    n = len(limits)
    last = len(length) - 1
    backwards = 1e300
    sliver = 0.0
    for k in range(len(length)):
        sliver = sliver + 1e-15 * length[k]
    for i in range(n):
        backwards = min(backwards, widened * limits[i, 0])
    p = 0
    came = state[0]
    derivatives(kind[0], length[0], shape[0], came, before)
    apart = 0.0
    size = 1.0
    for i in range(n):
        apart = max(apart, abs(origin[0, i] + before[i, 0] - place[i]))
        size = max(size, 1.0 + abs(place[i]))
    if not anywhere and apart > 1e-12 * size:
        found = _noted(faults, found, 0, 0, 0.0, -8.0, apart)
    v = state[1]
    a = state[2]
    j = state[3]
    for m in range(len(duration) + 1):
        # what jumps in time, seen by the axes; a run begins and ends at rest, at the ends of its path
        rest = m == len(duration)
        if rest and not ends:
            break
        v1 = 0.0 if rest else speed[m]
        a1 = 0.0 if rest else acceleration[m]
        j1 = 0.0 if rest else jerk[m]
        gap = (length[last] if rest else x[m]) - came
        right = p == (last if rest else piece[m])
        worst = 0.0
        if right:
            derivatives(kind[p], length[p], shape[p], came, before)
            chain(v1 - v, 0.0, 0.0, 0.0, before, q)
            for i in range(n):
                worst = max(worst, abs(q[i, 1]) / limits[i, 0])
                worst = max(worst, abs(before[i, 1] * (a1 - a) + before[i, 2] * (v1 * v1 - v * v)) / limits[i, 1])
                worst = max(worst, abs(before[i, 1] * (j1 - j)) / limits[i, 2])
                jumps[0] = max(jumps[0], abs(before[i, 1] * gap))
            jumps[1] = max(jumps[1], worst)
        outside = came < -1e-12 or came > length[p] + 1e-12 * (1.0 + length[p])
        if not right or outside or worst > widened or abs(gap) > 1e-12 * (1.0 + length[p]):
            found = _noted(faults, found, p, m, 0.0, -3.0, worst)
            if not right:
                return tests, found
        if rest:
            break
        v = speed[m]
        a = acceleration[m]
        j = jerk[m]
        s = snap[m]
        T = duration[m]
        low, high = cubic_range(v, a, j, s, 0.0, T)
        if not (T > 0.0) or low < -backwards or not (high < 1e300):
            # it must not run backwards, but for rounding
            return tests, _noted(faults, found, p, m, 0.0, -4.0, low)
        whole = way(v, a, j, s, T)
        begin = x[m]  # of the time piece, from the start of the present piece of the path
        t0 = 0.0
        while True:
            left = length[p] - begin
            # what ends within rounding of a joint lies before it
            on = whole > left + sliver and p < last
            t1 = when(left, v, a, j, s, t0, T) if on else T
            if t1 > t0 and alone:
                made, which, broke = _span(
                    kind[p], length[p], shape[p], feed[p], limits, widened, begin, v, a, j, s, t0, t1, halves, r
                )
                tests = tests + made
                if which != -2:
                    found = _noted(faults, found, p, m, broke, float(which), 1.0)
                for part in range(2):
                    t = t0 if part == 0 else 0.5 * (t0 + t1)
                    here = min(max(begin + way(v, a, j, s, t), 0.0), length[p])
                    derivatives(kind[p], length[p], shape[p], here, before)
                    chain(cubic(v, a, j, s, t), a + t * (j + 0.5 * t * s), j + t * s, s, before, q)
                    for i in range(n):
                        for k in range(4):
                            uses[i, k] = max(uses[i, k], abs(q[i, k + 1]) / limits[i, k])
            t0 = t1
            # a part of a run may end at a joint, where its last piece begins
            ahead = piece[m + 1] == p + 1 if m + 1 < len(duration) else not ends and p + 1 == last
            if not on and not (ahead and p < last):
                break
            # the joint of the path: what jumps there, with the speed that is planned
            v1 = cubic(v, a, j, s, t0)
            a1 = a + t0 * (j + 0.5 * t0 * s)
            j1 = j + t0 * s
            derivatives(kind[p], length[p], shape[p], length[p], before)
            derivatives(kind[p + 1], length[p + 1], shape[p + 1], 0.0, after)
            worst = 0.0
            for i in range(n):
                d1 = after[i, 1] - before[i, 1]
                d2 = after[i, 2] - before[i, 2]
                d3 = after[i, 3] - before[i, 3]
                worst = max(worst, abs(d1 * v1) / limits[i, 0])
                worst = max(worst, abs(d2 * v1 * v1 + d1 * a1) / limits[i, 1])
                worst = max(worst, abs(d3 * v1 * v1 * v1 + 3.0 * d2 * v1 * a1 + d1 * j1) / limits[i, 2])
                apart = abs(origin[p + 1, i] - (origin[p, i] + before[i, 0]))
                jumps[0] = max(jumps[0], apart)
                if apart > 1e-12 * (1.0 + abs(origin[p, i]) + length[p]):
                    worst = max(worst, 1.0)
            jumps[1] = max(jumps[1], worst)
            if worst > widened:
                found = _noted(faults, found, p, m, t0, -5.0, worst)
            begin = begin - length[p]
            p = p + 1
            if not on:
                break
        came = begin + whole
        v1 = cubic(v, a, j, s, T)
        a = a + T * (j + 0.5 * T * s)
        j = j + T * s
        v = v1
    derivatives(kind[p], length[p], shape[p], came, before)
    for i in range(n):
        place[i] = origin[p, i] + before[i, 0]
    state[0] = came
    state[1] = v
    state[2] = a
    state[3] = j
    return tests, found


DERIVATIVES = ("velocity", "acceleration", "jerk", "snap")


class Fault(NamedTuple):
    """Where a motion is not proven."""

    line: int  # of the part program
    time: float  # s from the begin of the run
    what: str

    def __str__(self) -> str:
        return Text(f"line {self.line}, {Quantity(self.time, 's'):6 SI} into the run: {self.what}")


@dataclass(frozen=True, eq=False, repr=False)
class Proof(Result):
    """What is proven of a motion along a path.

    faults    where a limit is exceeded, or could not be shown to hold; the first hundred
    count     of all faults
    use       the largest share of velocity .. snap limit that each axis takes at the times looked at, shape (N, 4)
    jump      largest jump of velocity, acceleration or jerk at a joint, as a share of its limit
    apart     largest jump of a position at a joint, m
    missed    largest distance to a corner where runs overlap, as a share of its tolerance
    spans     spans of time that were looked at
    """

    faults: tuple[Fault, ...]
    count: int
    use: np.ndarray
    jump: float
    apart: float
    missed: float
    spans: int

    def table(self) -> Table:
        """The largest share of each limit, by axis."""
        rows = [[axis, *(Quantity(share, "share") for share in row)] for axis, row in enumerate(self.use)]
        held = "every limit holds" if self.count == 0 else f"{self.count} faults, the first: {self.faults[0]}"
        return Table(f"{held}; {self.spans} spans of time", ["axis", *DERIVATIVES], rows)


class Prover:
    """Proves the parts of runs in their order; `limits` m/s .. m/s⁴, shape (N, 4)."""

    def __init__(self, limits: np.ndarray, widened: float = WIDENED) -> None:
        axes = len(limits)
        self._limits, self._widened = np.ascontiguousarray(limits, float), widened
        self._state, self._time, self._place = np.zeros(4), 0.0, np.zeros(axes)
        self._stands = False  # whether a run has ended at `_place`, where the next one must begin
        self._faults, self._use, self._jumps = np.zeros((_KEPT, 5)), np.zeros((axes, 4)), np.zeros(2)
        self._room = [np.zeros((64, 2)), np.zeros((axes, 4, 2)), *(np.zeros((axes, 5)) for _ in range(3))]
        self._both = [np.zeros((3, axes, 5)), np.zeros((2, axes, 5))]
        self._said: list[Fault] = []
        self._count = self._spans = 0
        self._missed = 0.0

    def prove(self, part: Part) -> bool:
        """Whether the next part holds."""
        before = self._count
        time, alone = self._time, part.entering is None
        self._along(part.pieces, part.motion, part.ends, alone, not self._stands)
        if part.entering is not None:
            # the next run begins here, from rest
            self._state[:], self._time, corner = 0.0, 0.0, self._place.copy()
            self._along(part.entering.pieces, part.entering.motion, False, alone, True)
            self._together(part, part.entering, corner, time)
        if (part.ends and alone) or self._count > before:
            self._state[:], self._time = 0.0, 0.0
        self._stands = self._count == before
        return self._count == before

    def _along(self, pieces: Pieces, motion: Motion, ends: bool, alone: bool, anywhere: bool) -> None:
        """One run: without jumps, within its limits if `alone`, from where the last one ended or `anywhere`."""
        spans, found = _prove(
            pieces.kind, pieces.length, pieces.origin, pieces.shape, pieces.feed, *motion, self._limits, self._widened,
            anywhere, ends, alone, self._state, self._place, self._faults, self._use, self._jumps, *self._room,
        )  # fmt: skip
        self._note(found, spans, pieces.line, motion.duration, self._time)
        self._time += float(motion.duration.sum())

    def _together(self, part: Part, entering: Entering, corner: np.ndarray, time: float) -> None:
        """Two runs that overlap: on one piece each, equally long, from the corner; limits of the sum, and distance."""
        one, two = part.pieces, entering.pieces
        alike = np.array_equal(part.motion.duration, entering.motion.duration)
        if len(one.length) != 1 or len(two.length) != 1 or not part.ends or not alike:
            self._refuse(one, time, -6, 0.0)
            return
        apart = float(np.abs(corner - two.origin[0]).max())
        self._jumps[0] = max(self._jumps[0], apart)
        if apart > 1e-12 * (1.0 + np.abs(corner).max()):
            self._refuse(one, time, -6, 0.0)
            return
        spans, found, away = prove_sum(
            int(one.kind[0]), float(one.length[0]), one.shape[0], rows(part.motion),
            int(two.kind[0]), float(two.length[0]), two.shape[0], rows(entering.motion),
            self._limits, self._widened, float(max(one.feed[0], two.feed[0])), self._faults, self._use, *self._both,
        )  # fmt: skip
        self._note(found, spans, one.line, part.motion.duration, time)
        self._missed = max(self._missed, away / entering.tolerance)
        if not away <= entering.tolerance * (1.0 + self._widened):
            self._refuse(one, time, -7, away / entering.tolerance)

    def _refuse(self, pieces: Pieces, time: float, which: int, share: float) -> None:
        self._faults[0] = 0.0, 0.0, 0.0, which, share
        self._note(1, 0, pieces.line, np.zeros(0), time)

    def _note(self, found: int, spans: int, line: np.ndarray, duration: np.ndarray, time: float) -> None:
        """The faults of a motion that begins at `time` in the run."""
        rows = self._faults[: min(found, _KEPT - len(self._said))]
        if len(rows):
            begins = time + np.concatenate([[0.0], np.cumsum(duration)])
            self._said += [_fault(row, line, begins) for row in rows]
        self._count += found
        self._spans += spans

    def proof(self) -> Proof:
        """Of all parts so far."""
        apart, jump = map(float, self._jumps)
        return Proof(tuple(self._said), self._count, self._use.copy(), jump, apart, self._missed, self._spans)


def faults_of(pieces: Pieces, motion: Motion, limits: np.ndarray) -> np.ndarray:
    """The faults of a motion that does not begin at rest, as rows of piece, time piece, time in it, limit, share."""
    axes, first = len(limits), int(motion.piece[0])
    state = np.array([motion.x[0], motion.speed[0], motion.acceleration[0], motion.jerk[0]])
    faults = np.zeros((_KEPT, 5))
    room = [np.zeros((64, 2)), np.zeros((axes, 4, 2)), *(np.zeros((axes, 5)) for _ in range(3))]
    on = part_of_pieces(pieces, first, len(pieces.length))
    _, found = _prove(
        on.kind, on.length, on.origin, on.shape, on.feed, *motion._replace(piece=motion.piece - first),
        limits, WIDENED, True, False, True, state,
        np.zeros(axes), faults, np.zeros((axes, 4)), np.zeros(2), *room,
    )  # fmt: skip
    return faults[:found]


def _fault(row: np.ndarray, line: np.ndarray, begins: np.ndarray) -> Fault:
    which, share = int(row[3]), Quantity(row[4])
    if which >= 0:
        what = f"the {DERIVATIVES[which % 4]} of axis {which // 4} exceeds its limit, or cannot be shown to keep it"
    elif which == -1:
        what = "the speed along the path exceeds the feed"
    elif which == -3:
        what = Text(
            f"the motion jumps by {share:3} of a limit between two pieces of time, or leaves its piece of the path"
        )
    elif which == -4:
        what = "the motion runs backwards, or has no duration"
    elif which == -6:
        what = "two runs overlap that do not meet in a corner, or by more than a piece of path or other pieces of time"
    elif which == -8:
        what = "the part does not go on from where the one before has ended, so that a move is lost or displaced"
    elif which == -7:
        what = Text(f"two runs that overlap miss the corner by {share:9} of its tolerance")
    else:
        what = Text(f"the path jumps by {share:3} of a limit between two pieces")
    return Fault(int(line[int(row[0])]), float(begins[int(row[1])] + row[2]), what)
