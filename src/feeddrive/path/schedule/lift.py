"""Lifting: motions made faster by dropping the condition u'' = u''' = 0 at the nodes inside a lifted section.

The original plan has u'' = u''' = 0 at each node, and each ramp obeys the strictest limits of all pieces that it
crosses.  Here u'² is a spline in u between two states of that plan, and all its coefficients are optimized
simultaneously (`spline`).  The result, in time intervals of constant snap, is used if it is proven to keep the limits
and is faster; otherwise the original plan is kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Ints, Records, by_field, layout_of, rows_for
from feeddrive.language.threads import in_order
from feeddrive.path.limits import DERIVATIVES
from feeddrive.path.motion import (
    LINE,
    Derivatives,
    Interval,
    Limits,
    Motion,
    Part,
    Pieces,
    appended,
    cubic,
    interval_of,
    one_after_the_other,
    part_of_pieces,
    slowed,
    way,
)
from feeddrive.path.proof import Broken, faults_of
from feeddrive.path.schedule import spline
from feeddrive.path.schedule.ramp import Slopes
from feeddrive.path.schedule.spline import Basis, Forces, Points, Rates, Reached, Room, State, Steepness, reserve_factor

if TYPE_CHECKING:
    from concurrent.futures import Executor

# less reserve fails more proofs and costs more rounds, more reserve costs time of the motion
SHARES = (1.0 - 1e-4, 0.995, 0.99, 0.98)  # of the limits, at the points: the rest is for the motion between them
# half a ramp as a number of time intervals and their share, with limits of jerk and snap, without one of snap, and
# without both: a ramp then has 6 or 7 intervals, 2 or 3, or 1
_HALF = ((4, 1.0), (1, 1.0), (1, 0.5))
# from rest z = u'² grows as u^1.5, which no cubic spline follows: beyond, spans of growing length do
_AT_REST = 0.05  # of half a ramp from rest, and of one to rest, is not optimized
# that ends either early in the first phase, in which the jerk grows, or within the second, at constant jerk: where the
# first one is nearly over, its rest would be the first span
_EARLY = 0.5  # of the first phase
_LATE = 1.3  # of the first phase
_NEAR_REST = 0.1  # of the first phase is not optimized at least
_QUICKER = 0.3  # least factor of the time of what is not optimized, whose jerk may be far below the limit
# the state behind such a beginning is given: at the limit itself no spline could start
_AT_ENDS = Limits(0.97, 0.97, 0.97, 0.998)  # usable shares of the limits of velocity to snap there
_BLENDED = 300  # number of coefficients over which the first spline takes up such a change of speed
_RESTS = 1e-9  # of the largest speed: below it the motion is at rest
_TOGETHER = 6  # number of spans after which the motion ends exactly in the state of the spline
_STEPS = 160  # from the slow ramps of some plans it is far to a quick motion
_FIRST = 0.1  # initial penalty
_NEAREST = 4e-3  # final penalty
_AGAIN = (0.01, 4e-3)  # the initial and the final one where a proof has failed
_ROUNDS = 8  # largest number of proofs
_TIGHTER = 0.01  # reduction of a limit where its proof fails, as a share: first twice this, then doubled in each round
_GIVEN = 8.0  # number of spans from a given state at an end over which the reduction grows to that
_REFINED = 3  # largest number of times that a section is tried, each time with spans half as long where it failed
_LONG = 120  # number of time intervals from which on a section is divided where it failed, before spans are halved
_ASIDE = 32  # number of spans on either side of such a point that are optimized again
# a lifted motion ends in a node of the plan; lifted again with the next part, it need not have u'' = u''' = 0 there
_HELD = 0.3  # of the duration of the lifted motion is held back for the next part
_HUMP = 15  # number of time intervals of a ramp up, a plateau and a ramp down
_LEAST = 100  # least number of time intervals lifted together, except at the end of a run
_LITTLE = 0.007  # of the time around a ramp: least saving on a straight path; lifting gains at most 0.7 of that
# long windows of chords and of arcs with lines have 2,200; a slow plateau of minutes beside ramps of milliseconds would
# have a million, for nothing
_MOST = 20_000  # largest number of spans of a section
_TOP = 0.995  # of the speed allowed by feed and velocity limits: such a plateau is kept


class Lifter:
    """The lifter of consecutive parts of runs; `limits` are in m/s .. m/s⁴, shape (N, 4).

    `workers` lift the sections of a part that do not depend on each other; None: one after the other.

    The last portion of a lifted section is held back, to be lifted again with the next part. A lifted section ends in
    the same state as the original plan, whose planned stop therefore remains valid.
    """

    def __init__(self, limits: np.ndarray, workers: Executor | None = None) -> None:
        self._limits, self._workers = np.ascontiguousarray(limits, float), workers
        self.hand: Part | None = None  # the part held back
        self._spans = 0  # number of its time intervals that are already spans

    def add(self, part: Part) -> Iterator[Part]:
        """Yield the parts that are final after this one: all of them if the run ends."""
        if self.hand is not None:
            part = _after(self.hand, part)
        if not part.ends and len(part.motion.duration) - self._spans < _LEAST:
            self.hand = part
            return
        motion, spans = part.motion, self._spans
        self.hand, self._spans = None, 0
        path = _Path(part.pieces, self._limits)
        rests = _rests(motion)
        motions: list[Motion] = []
        come, n = 0, len(motion.duration)

        def within(section: tuple[int, int]) -> list[tuple[int, int, Motion, int]]:
            """Lift a section, or what of its halves can be; it depends on no other section."""
            waiting, done = [section], list[tuple[int, int, Motion, int]]()
            while waiting:
                first, last = waiting.pop()
                begins, ends = bool(rests[first]), bool(rests[last])
                # an estimate, not a bound: lifting 1,908 ramps gained at most 0.69 of it
                gain = path.gain(motion, first, last)
                if gain < np.inf and gain < _LITTLE * _around_time(motion, first, last):
                    continue
                tried = path.lifted(_some(motion, first, last), begins, ends, spans if first == 0 else 0)
                if tried.motion is not None:
                    done.append((first, last, tried.motion, tried.kept))
                elif tried.failed is not None:
                    one, two = (first + k for k in tried.failed)
                    waiting += [(a, b) for a, b in ((two, last), (one, two), (first, one)) if a < b]
                else:
                    waiting += _halves(motion, first, last)
            return done

        sections = _sections(motion, rests, path.top, part.pieces.length)
        for first, last, lifted, kept in chain.from_iterable(in_order(self._workers, within, sections)):
            motions += [_some(motion, come, first), lifted]
            come = last
            if last == n and not rests[last]:
                self._spans = len(lifted.duration) - kept  # it goes on
        motions.append(_some(motion, come, n))
        part = part._replace(motion=_one(motions))
        if self._spans:
            part, self.hand = _cut(part, self._spans)
            self._spans = len(self.hand.motion.duration)
        yield part


class Prepared(NamedTuple):
    """A section whose ends near rest are divided off.

    first, last  the time intervals in between, up to but excluding `last`, of `size`
    begin, end   factors of the time of what is before and behind them, that leave some reserve of each limit
    state        u' .. u''' at the end of what is in between
    """

    first: int
    last: int
    size: int
    begin: float
    end: float
    state: State


@kernel
def near_rest(duration: Floats, snap: Floats, first: int, sense: int, count: int, unlimited: int) -> tuple[int, float]:
    """Return the time interval, and the time within it, up to which a motion from rest is not optimized: from time
    interval `first` on, in ascending order (`sense` 1) or in descending order (-1), of which there are `count`.

    unlimited  0 if snap and jerk are limited, 1 if only the jerk is, and 2 if neither is
    """
    most = min(4 - unlimited, count)
    whole = 0.0
    for k in range(most):
        whole = whole + duration[first + sense * k]
    t = _AT_REST * whole
    # without a limit of the snap the jerk is constant from the start
    if unlimited == 0 and most > 1:
        one = duration[first]
        # a short ramp has no phase at constant jerk
        steady = duration[first + sense] if snap[first + sense] == 0.0 else 0.0
        late = max(t, _LATE * one)
        early = min(max(t, _NEAR_REST * one), _EARLY * one)
        t = late if t > early and late <= one + 0.5 * steady else early
    ends = 0.0
    for k in range(most):
        lasts = duration[first + sense * k]
        if ends + lasts >= t:
            return k, t - ends
        ends = ends + lasts
    return most, t - ends


@kernel
def split(motion: Motion, count: int, m: int, t: float, length: Floats) -> int:
    """Split time interval m after the time t, on a path with pieces of the given lengths; return the new count."""
    for back in range(count - m - 1):
        k = count - 1 - back
        appended(motion, k + 1, interval_of(motion, k), int(motion.piece[k]))
    T, x, v, a, j, s = interval_of(motion, m)
    p = int(motion.piece[m])
    there = x + way(v, a, j, s, t)
    while there > length[p] and p + 1 < len(length):
        there = there - length[p]
        p = p + 1
    motion.duration[m] = t
    appended(motion, m + 1, Interval(T - t, there, cubic(v, a, j, s, t), a + t * (j + 0.5 * t * s), j + t * s, s), p)
    return count + 1


@kernel
def state_behind(motion: Motion, m: int) -> State:
    """Return u' .. u''' at the end of time interval m."""
    t, _, v, a, j, s = interval_of(motion, m)
    return State(cubic(v, a, j, s, t), a + t * (j + 0.5 * t * s), j + t * s)


@kernel
def _reserve(
    motion: Motion,
    first: int,
    last: int,
    pieces: Pieces,
    top: Floats,
    limits: Records[Limits],
    r: Records[Derivatives],
    q: Records[Derivatives],
) -> float:
    """Return the factor of the time of some time intervals from or to rest that leaves some reserve of each limit."""
    if last == first:
        return 1.0
    return max(_QUICKER, reserve_factor(pieces, top, limits, _AT_ENDS, motion, first, last, r, q))


@kernel
def prepared(
    motion: Motion,
    begins: bool,
    ends: bool,
    unlimited: int,
    pieces: Pieces,
    top: Floats,
    limits: Records[Limits],
    plan: Motion,
    r: Records[Derivatives],
    q: Records[Derivatives],
) -> Prepared:
    """Copy a section, which may begin or end at rest, into `plan`, which has room for two more time intervals, and
    divide it where what is not optimized near rest ends and begins.

    unlimited  as for `near_rest`
    r, q       workspace for each axis
    """
    count = len(motion.duration)
    for m in range(count):
        appended(plan, m, interval_of(motion, m), int(motion.piece[m]))
    first = 0
    last = count
    if begins:
        k, t = near_rest(plan.duration, plan.snap, 0, 1, count, unlimited)
        count = split(plan, count, k, t, pieces.length)
        first = k + 1
        last = last + 1
    if ends:
        k, t = near_rest(plan.duration, plan.snap, count - 1, -1, count, unlimited)
        last = last - k
        count = split(plan, count, last - 1, plan.duration[last - 1] - t, pieces.length)
    begin = _reserve(plan, 0, first, pieces, top, limits, r, q)
    end = _reserve(plan, last, count, pieces, top, limits, r, q)
    return Prepared(first, last, count, begin, end, state_behind(plan, last - 1))


@kernel
def unlimited_of(limits: Records[Limits]) -> int:
    """Return the largest number of absent limits of jerk and snap of an axis."""
    most = 0
    for i in range(len(limits)):
        jerk = limits[i].jerk
        snap = limits[i].snap
        # infinity less infinity is no number
        most = max(most, (0 if jerk - jerk == 0.0 else 1) + (0 if snap - snap == 0.0 else 1))
    return most


@kernel
def rests(motion: Motion, out: Ints) -> int:
    """Write 1 where the motion is at rest, and 0 elsewhere: at the start of each time interval, and at the end."""
    n = len(motion.duration)
    end = state_behind(motion, n - 1).speed
    most = end
    for m in range(n):
        most = max(most, motion.speed[m])
    slow = _RESTS * most
    before = end
    for m in range(n + 1):
        speed = motion.speed[m] if m < n else end
        out[m] = 1 if speed <= slow else 0
        # the first phase from rest, and the last one to rest, may be so short that they hardly move
        if m == 0:
            if motion.speed[0] != 0.0 and motion.acceleration[0] != 0.0:
                out[m] = 0
        elif m < n:
            after = motion.speed[m + 1] if m + 1 < n else end
            if speed >= before or speed >= after:
                out[m] = 0
        before = speed
    return 0


@kernel
def _is_top(motion: Motion, m: int, top: Floats, length: Floats) -> bool:
    """Return True for a plateau at the largest speed of the pieces on which it lies."""
    if motion.acceleration[m] != 0.0 or motion.jerk[m] != 0.0 or motion.snap[m] != 0.0:
        return False
    last = len(top) - 1
    if m + 1 < len(motion.duration):
        # a time interval that ends at a joint is not affected by the piece after it
        last = motion.piece[m + 1]
        if motion.x[m + 1] <= 1e-9 * length[last]:
            last = last - 1
    most = top[motion.piece[m]]
    for p in range(motion.piece[m], last + 1):
        most = max(most, top[p])
    return motion.speed[m] >= _TOP * most


@kernel
def sections(motion: Motion, rests: Ints, top: Floats, length: Floats, begins: Ints, ends: Ints) -> int:
    """Write the ranges of time intervals that can be lifted, and return their number; they are separated by standstills
    or plateaus at top speed.

    rests        as written by `rests`
    top, length  largest speed that feed and velocity limits allow on each piece, and the length of the pieces
    """
    count = 0
    first = 0
    n = len(motion.duration)
    for last in range(n + 1):
        flat = last < n and _is_top(motion, min(last, n - 1), top, length)
        if last == n or flat or rests[last] != 0:
            if last > first:
                begins[count] = first
                ends[count] = last
                count = count + 1
            first = last + 1 if flat else last
    return count


class Tried(NamedTuple):
    """What became of a section.

    motion  the faster motion, or None
    kept    number of its time intervals at the start that remain unchanged
    failed  the time intervals in which limits could not be kept, from one up to but excluding another, if these are few
    """

    motion: Motion | None = None
    kept: int = 0
    failed: tuple[int, int] | None = None


class _Path:
    """The pieces of a path with the limits of the axes; u is measured from the start of the first piece."""

    def __init__(self, pieces: Pieces, limits: np.ndarray) -> None:
        n, axes = len(pieces.length), len(limits)
        self._pieces, self._limits = pieces, limits
        self._begin = np.concatenate([[0.0], np.cumsum(pieces.length)])
        self._unlimited = unlimited_of(limits)
        self.top, self._from_rest = np.empty(n), np.empty(n)
        spline.tops(pieces, limits, self.top, self._from_rest, rows_for(Slopes, axes))

    def gain(self, motion: Motion, first: int, last: int) -> float:
        """Return the largest time that may be saved in a section, s: the result of `ramp_gain` for a ramp, otherwise
        infinite (unknown).
        """
        if last - first > _HUMP // 2:
            return np.inf
        room = rows_for(Derivatives, len(self._limits))
        return spline.ramp_gain(self._pieces, self._limits, motion, first, last, room)

    def lifted(self, motion: Motion, begins: bool, ends: bool, spans: int) -> Tried:
        """Try to find a faster, proven motion between the same states; it may begin or end at rest.

        The first `spans` time intervals are already spans of an earlier spline.
        """
        if len(motion.duration) <= _HUMP and np.all(self._pieces.kind[motion.piece[0] : motion.piece[-1] + 1] == LINE):
            return Tried()  # on a line it is already time-optimal
        size = len(motion.duration) + 2
        plan = _unset_motion(size)
        r, q = (rows_for(Derivatives, len(self._limits)) for _ in range(2))
        made = prepared(motion, begins, ends, self._unlimited, self._pieces, self.top, self._limits, plan, r, q)
        first, last, whole = made.first, made.last, len(motion.duration)
        motion = _some(plan, 0, made.size)
        head, tail = _some(plan, 0, first), _some(plan, last, made.size)
        between = _some(plan, first, last)
        begin, end = made.begin, made.end
        for one, two in dict.fromkeys([(begin, end), (max(begin, 1.0), max(end, 1.0))]):
            beside = slowed(head, one), slowed(tail, two)
            lifted = self._between(between, made.state, spans, (one, two), beside)
            if isinstance(lifted, Motion):
                return Tried(lifted, first) if np.sum(lifted.duration) < np.sum(motion.duration) else Tried()
            if lifted is not None:
                # the time interval that was divided near a rest at the start counts once
                near, far = ((k + first - begins if k else 0) for k in lifted)
                return Tried(failed=(near, far if far < last - begins else whole))
        return Tried()

    def _between(
        self, motion: Motion, end: State, spans: int, factors: Sequence[float], beside: tuple[Motion, Motion]
    ) -> Motion | tuple[int, int] | None:
        """Return a proven motion between the same states, or None, for a motion that is at rest at neither end; `end`
        is u' .. u''' at its end.

        Both states are those of a motion whose time is multiplied by one of the two factors.  `beside` are the motions
        before and after, which are proven and returned with it.  Where it fails, spans are halved; of a long motion
        that fails in few places the range of time intervals around these is returned instead.
        """
        finer = np.ones(len(motion.duration), np.int64)
        for again in range(_REFINED):
            lifted, time, failed = self._tried(motion, end, spans, factors, beside, finer)
            if lifted is not None or not len(failed):
                return lifted
            edges = np.concatenate([[0.0], np.cumsum(motion.duration)])
            first = np.searchsorted(edges, time[np.maximum(failed - 1, 0)], side="right") - 1
            last = np.searchsorted(edges, time[np.minimum(failed + 2, len(time) - 1)])
            of_failed = np.zeros(len(finer), bool)
            for one, two in zip(first.tolist(), last.tolist(), strict=True):
                of_failed[one:two] = True
            if again > 0 and len(finer) >= _LONG:
                apart = _nodes_around(motion, int(np.min(first)), int(np.max(last)))
                if apart is not None:
                    return apart
            finer[of_failed] *= 2
        return None

    def _tried(
        self,
        motion: Motion,
        end: State,
        spans: int,
        factors: Sequence[float],
        beside: tuple[Motion, Motion],
        finer: np.ndarray,
    ) -> tuple[Motion | None, np.ndarray, np.ndarray]:
        """Return a motion as `_between` does, the times of the knots in the given one, and the spans at which limits
        cannot be kept if there is none.

        finer  factor by which spans are shorter in each time interval, shape (m,)
        """
        nowhere = np.zeros(0, np.int64)
        time, knots, coefficient, moves = self._spline(motion, end, spans, factors, finer)
        if not moves:
            return None, time, nowhere
        n = len(time) - 1
        looked = self._points(time, knots)
        rows = _unset(Basis, n)
        spline.rows_at_knots(knots, rows)
        if _quicker(looked, rows, coefficient, _FIRST, _NEAREST, 0, n):
            return None, time, _exceeded(looked, rows, coefficient)
        at_begin, at_end = factors
        starts = _slower(State(motion.speed[0], motion.acceleration[0], motion.jerk[0]), at_begin)
        end = _slower(end, at_end)
        given = _reduced(n)
        failed = nowhere
        head, tail = beside
        before, count = len(head.duration), len(head.duration) + n + len(tail.duration)
        whole = _unset_motion(count)
        for column, one, two in zip(whole, head, tail, strict=True):
            column[:before], column[before + n :] = one, two
        timed = _some(whole, before, before + n)
        more = np.empty((n + 1, len(State._fields))), np.empty((2 * _TOGETHER, 4))
        tried, new = coefficient.copy(), [(0, n)]
        for number in range(1, _ROUNDS + 1):
            for first, last in new if number > 1 else ():
                if _quicker(looked, rows, tried, *_AGAIN, first, last):
                    if last - first == n:
                        return None, time, _exceeded(looked, rows, tried)
                    # changing these spans alone is infeasible: optimize all of them
                    tried, new = coefficient.copy(), [(0, n)]
                    if _quicker(looked, rows, tried, *_AGAIN, 0, n):
                        return None, time, _exceeded(looked, rows, tried)
                    break
            if not spline.in_time(knots, tried, rows, self._begin, starts, end, _TOGETHER, timed, *more):
                return None, time, nowhere  # it moves backwards between the evaluated points
            if number == 1:
                faults = self._faults(whole, 0, count)
                if len(faults):
                    faults = faults - Broken(0.0, before, 0.0, 0.0, 0.0)
            else:
                faults = np.concatenate([self._faults(timed, first, last) for first, last in new])
            if not len(faults):
                return whole, time, nowhere
            where = np.asarray(by_field(Broken, faults).interval)
            if np.any((where < 0) | (where >= n)):
                return None, time, nowhere  # not the spline but the motion before or after it
            for _, where, _, which, _ in faults:
                # a jump or a backward motion, which lower limits would not remove
                if which < -1:
                    return None, time, nowhere
                near, behind = np.searchsorted(looked.span, [where - 1, where + 2]).tolist()
                axis, number_of = divmod(int(which), len(DERIVATIVES))
                share = 2.0**number * float(given[int(where)])
                # r is scaled by the limits: enlarging it lowers them at these points
                if which == -1 or number_of == 0:
                    looked.most[near:behind] *= 1.0 - 1e-3 * share
                else:
                    spline.tightened(looked, near, behind, axis, number_of, 1.0 + _TIGHTER * share)
            failed = np.unique(np.asarray(by_field(Broken, faults).interval).astype(int))
            new = _around(failed, n)
        return None, time, failed

    def _faults(self, motion: Motion, first: int, last: int) -> np.ndarray:
        """Return the faults, in the form of `faults_of`, in the section affected when the spans from `first` up to but
        excluding `last` are changed.
        """
        # `in_time` corrects the snaps of a whole group, which has up to twice as many spans at the end
        first, last = max(first - 2 * _TOGETHER, 0), last + 2 * _TOGETHER
        faults = faults_of(self._pieces, _some(motion, first, last), self._limits)
        return faults + Broken(0.0, first, 0.0, 0.0, 0.0) if len(faults) else faults

    def _spline(
        self, motion: Motion, end: State, spans: int, factors: Sequence[float], finer: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
        """Return knot times, knots and coefficients of a spline u'²(u) that approximates a motion and has the states at
        both ends, as for `_between`, with `finer` as for `_tried`; False if there is none: it does not move between two
        knots, or has too many of them.
        """
        n = len(motion.duration)
        spans = min(spans, n)
        wide, share = _HALF[self._unlimited]
        step, edge = np.empty(n), np.empty(n + 1)
        phases = _first_phase(motion), _first_phase(motion, -1)
        spline.spacing(motion, end, spans, min(wide, n), share, self._from_rest, finer, *phases, step, edge)
        kept = finer[:spans]
        time = np.zeros(1)
        if spans:
            time = np.concatenate([time, np.cumsum(np.repeat(motion.duration[:spans] / kept, kept))])
        if spans < n:
            lasting, step, edge = motion.duration[spans:], step[spans:], edge[spans:]
            behind = np.empty(spline.graded_room(lasting, step, edge))
            behind = behind[: spline.instants(lasting, step, edge, behind)]
            time = np.concatenate([time[:-1], time[-1] + behind]) if spans else behind
        m = len(time)
        if m > _MOST:
            return time, np.zeros(0), np.zeros(0), False
        knots, coefficient, room = np.empty(m + 6), np.empty(m + 2), _unset(Reached, m)
        blended = min(_BLENDED, (m - 4) // 2)
        one, two = factors
        moves = spline.approximation(motion, self._begin, time, end, one, two, blended, room, knots, coefficient)
        return time, knots, coefficient, moves

    def _points(self, time: np.ndarray, knots: np.ndarray) -> Points:
        pieces, axes = self._pieces, len(self._limits)
        first, last = self._begin.searchsorted(knots[[0, -1]])
        size = spline.POINTS * (len(time) + int(last - first) + 1)
        filled = Points(
            np.empty(size, np.int64),
            np.empty(size),
            _unset(Rates, size, axes),
            np.empty(size),
            np.empty(size, np.int64),
            np.empty(size),
            np.empty(size),
        )
        count = spline.points(
            pieces,
            self._begin,
            self.top,
            self._limits,
            Limits(*SHARES),
            knots,
            time,
            filled,
            rows_for(Derivatives, axes),
        )
        return _some_points(filled, 0, count)


def _quicker(
    looked: Points, rows: np.ndarray, coefficient: np.ndarray, begins: float, ends: float, first: int, last: int
) -> int:
    """Run `quickest` on the spans from `first` up to but excluding `last`; three coefficients at each end are fixed."""
    part = looked
    if last - first < len(rows):
        begins_at, ends_at = np.searchsorted(looked.span, [first, last]).tolist()
        part = _some_points(looked, begins_at, ends_at)
        part = part._replace(span=part.span - first)
    m, axes, _ = np.asarray(part.r).shape
    n = last - first + 3
    return spline.quickest(
        part, rows[first:last], coefficient[first : last + 3], begins, ends, _STEPS, _room(m, n, axes)
    )


def _exceeded(looked: Points, rows: np.ndarray, coefficient: np.ndarray) -> np.ndarray:
    """Return the spans at which a spline exceeds a limit, or nearly so if it exceeds none."""
    share = np.zeros(len(looked.span))
    spline.utilization(looked, rows, coefficient, share)
    return np.unique(looked.span[share >= min(1.0, float(np.max(share)))])


def _room(m: int, n: int, axes: int) -> Room:
    """Return the work arrays of `quickest` for m points, n coefficients and a number of axes."""
    share, loose, force = (np.empty(m) for _ in range(3))
    steepness, forces = _unset(Steepness, m, axes), _unset(Forces, m, axes)
    return Room(share, loose, steepness, forces, force, np.empty(n), np.empty(n), np.empty(n), np.empty((n, 4)))


def _unset(record: type, *sizes: int) -> np.ndarray:
    """Return an array for records whose contents are not set."""
    return np.empty((*sizes, layout_of(record).width))


def _some_points(points: Points, first: int, last: int) -> Points:
    return Points._make([array[first:last] for array in cast("tuple[np.ndarray, ...]", points)])


def _reduced(n: int) -> np.ndarray:
    """Return the share of the reduction of a limit in each of n spans: with all of it next to the given states at the
    ends the limit would fall faster than the motion can.
    """
    from_end = np.minimum(np.arange(n), n - 1 - np.arange(n))
    return np.minimum(1.0, ((1.0 + from_end) / _GIVEN) ** 2)


def _around(spans: np.ndarray, n: int) -> list[tuple[int, int]]:
    """Return the ranges, among n spans, to be optimized again after the limits at `spans` were lowered: each of these
    spans with `_ASIDE` neighbors on either side.
    """
    ranges = list[tuple[int, int]]()
    for k in np.unique(spans).tolist():
        first, last = max(k - _ASIDE, 0), min(k + 1 + _ASIDE, n)
        if ranges:
            begins, ends = ranges[-1]
            if first <= ends:
                first = begins
                ranges.pop()
        ranges.append((first, last))
    return ranges


def _around_time(motion: Motion, first: int, last: int) -> float:
    """Return the duration of a section plus half the durations of the plateaus before and after it, s."""
    beside = [m for m in (first - 1, last) if 0 <= m < len(motion.duration)]
    flat = [m for m in beside if motion.acceleration[m] == 0.0 and motion.jerk[m] == 0.0 and motion.snap[m] == 0.0]
    return float(np.sum(motion.duration[first:last]) + 0.5 * np.sum(motion.duration[flat]))


def _sections(motion: Motion, rests: np.ndarray, top: np.ndarray, length: np.ndarray) -> list[tuple[int, int]]:
    """Return the ranges of time intervals that can be lifted; `rests` is that of `_rests`."""
    out = np.empty((2, len(motion.duration) + 1), np.int64)
    begins, ends = out
    count = sections(motion, rests, top, length, begins, ends)
    return list(zip(begins[:count].tolist(), ends[:count].tolist(), strict=True))


def _nodes_around(motion: Motion, first: int, last: int) -> tuple[int, int] | None:
    """Return the nodes, or ends of the motion, around some time intervals, with room for ramps; None if these are more
    than half of the motion.
    """
    n = len(motion.duration)
    nodes = np.flatnonzero((motion.acceleration == 0.0) & (motion.jerk == 0.0))
    before, behind = nodes[nodes <= first - _HUMP], nodes[nodes >= last + _HUMP]
    one, two = int(before[-1]) if len(before) else 0, int(behind[0]) if len(behind) else n
    return (one, two) if 2 * (two - one) <= n else None


def _halves(motion: Motion, first: int, last: int) -> list[tuple[int, int]]:
    """Split, at its middle node, a section that cannot be lifted as a whole; return the second half, then the first."""
    inner = np.arange(first + _HUMP, last - _HUMP)
    nodes = inner[(motion.acceleration[inner] == 0.0) & (motion.jerk[inner] == 0.0)]
    if not len(nodes):
        return []
    k = int(nodes[np.argmin(np.abs(nodes - 0.5 * (first + last)))])
    return [(k, last), (first, k)]


def _rests(motion: Motion) -> np.ndarray:
    """Return 1 where the motion is at rest, and 0 elsewhere: at the start of each time interval, and at the end."""
    out = np.empty(len(motion.duration) + 1, np.int64)
    rests(motion, out)
    return out


def _first_phase(motion: Motion, sense: int = 1) -> float:
    """Return the duration of the first (`sense` 1) or last (-1) time interval, s, or that of its neighbor if it is a
    plateau shorter than that, as ramps may leave plateaus of the size of their error.
    """
    end, next_to = (0, 1) if sense == 1 else (-1, -2)
    flat = motion.acceleration[end] == 0.0 and motion.jerk[end] == 0.0 and motion.snap[end] == 0.0
    if flat and len(motion.duration) > 1:
        return max(float(motion.duration[end]), float(motion.duration[next_to]))
    return float(motion.duration[end])


def _unset_motion(n: int) -> Motion:
    """Return a motion of n time intervals that are not set."""
    return Motion(np.empty(n), np.empty(n, np.int64), np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n))


def _some(motion: Motion, first: int, last: int) -> Motion:
    return Motion._make([column[first:last] for column in motion])


def _one(motions: list[Motion]) -> Motion:
    """Concatenate motions."""
    return Motion._make([np.concatenate(columns) for columns in zip(*motions, strict=True)])


def _slower(state: State, factor: float) -> State:
    """Return the state of such a motion."""
    return State(state.speed / factor, state.acceleration / factor**2, state.jerk / factor**3)


def divided(motion: Motion, m: int, t: float, length: np.ndarray) -> Motion:
    """Return a motion whose time interval m is split after the time t, as by `split`."""
    count = len(motion.duration)
    out = _unset_motion(count + 1)
    for column, given in zip(out, motion, strict=True):
        column[:count] = given
    split(out, count, m, t, length)
    return out


def _after(hand: Part, part: Part) -> Part:
    """Join two consecutive parts."""
    last = len(hand.pieces.length) - 1
    pieces = one_after_the_other([part_of_pieces(hand.pieces, 0, last), part.pieces])
    motion = part.motion._replace(piece=part.motion.piece + last)
    return part._replace(pieces=pieces, motion=_one([hand.motion, motion]))


def _cut(part: Part, spans: int) -> tuple[Part, Part]:
    """Split a part within its last `spans` spans, about 30 % of their duration before the end, where |u'''| is
    smallest of the knots at which the motion is in the state of the spline; return the final part and the part held
    back.
    """
    motion, n = part.motion, len(part.motion.duration)
    left = np.cumsum(motion.duration[::-1])[::-1][n - spans :]
    exact = np.arange(spans) % _TOGETHER == 0
    here = np.flatnonzero(exact & (left <= 1.2 * _HELD * left[0]) & (left >= 0.8 * _HELD * left[0]))
    k = n - spans + (int(here[np.argmin(np.abs(motion.jerk[n - spans + here]))]) if len(here) else spans // 2)
    p = int(motion.piece[k])
    last = len(part.pieces.length)
    rest = _some(motion, k, n)
    return (
        part._replace(pieces=part_of_pieces(part.pieces, 0, p + 1), motion=_some(motion, 0, k)),
        part._replace(pieces=part_of_pieces(part.pieces, p, last), motion=rest._replace(piece=rest.piece - p)),
    )
