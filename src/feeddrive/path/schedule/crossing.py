"""How the corners between runs are passed: as overlapped stops or with a time bump, whichever is quicker."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feeddrive.path.motion import LINE, Motion, Part, Pieces, Section, derivatives, from_rows, rows, way
from feeddrive.path.schedule.corner import (
    FASTEST,
    HEAD,
    JERK_SHARE,
    LENGTH,
    NUMBERS,
    ROWS,
    SHORT,
    SNAP,
    SNAP_SHARE,
    TAIL,
    WIDE,
    bump,
    overlap,
    overlapped,
    straight,
    together,
)
from feeddrive.path.schedule.ramp import bounds

_SLOWED = (0.93, 0.85)  # shares of the jerk
_SHORTEST = 1e-4  # s of overlap; less is not worth parts of their own


class _End(NamedTuple):
    """The end of a run at a corner: a motion on one piece of its path, its direction there and its bounds."""

    rows: np.ndarray
    lasts: float  # s
    length: float
    feed: float
    direction: np.ndarray
    most: np.ndarray


class _Stretch(NamedTuple):
    """The part of a motion that may be replanned: on one line, between nodes, time pieces `first` to before `last`."""

    first: int
    last: int
    numbers: np.ndarray  # as of `straight`


class _Run(NamedTuple):
    """A part whose end is not fixed yet, and how it overlaps with the previous part.

    whole  it is a run along one line, and its head and its tail are made together
    seen   what corners at both of its ends see of such a run
    """

    part: Part
    tolerance: float  # of the corner in which it ends, m
    whole: _Stretch | None
    seen: _End | None = None
    lasts: float = 0.0  # s
    corner: float = 0.0  # tolerance of that corner


class Crossings:
    """Lets each run begin before the one before it has ended, as far as limits and tolerances allow.

    limits  of velocity .. snap of each axis, m/s .. m/s⁴, shape (N, 4)
    """

    def __init__(self, limits: np.ndarray) -> None:
        self._limits = np.ascontiguousarray(limits, float)
        self._fixed: Part | None = None  # its end may overlap with the next
        self._open: _Run | None = None

    def add(self, part: Part, tolerance: float) -> list[Part]:
        """Return the parts that are final once the next part is known; `tolerance` of the corner in which it ends, m,
        0: none.
        """
        begins = part.motion.x[0] == 0.0 and part.motion.speed[0] == 0.0
        run = self._line(Section(part.pieces, part.ends, tolerance)) if begins else None
        return self._next(run or _Run(part, tolerance, None))

    def add_line(self, section: Section) -> list[Part] | None:
        """As `add`, for a run that is one line, in closed form; None for any other section of a run."""
        run = self._line(section)
        return self._next(run) if run else None

    def _next(self, two: _Run) -> list[Part]:
        one, self._open = self._open, two
        if one is None:
            return []
        if one.part.ends and one.tolerance > 0.0:
            one, self._open = self._met(one, two)
        return self._fix(one)

    def end(self) -> list[Part]:
        """Return the remaining parts, with which the motion stops."""
        one, self._open = self._open, None
        leaves = self._fix(one) if one else []
        last, self._fixed = self._fixed, None
        return [*leaves, last] if last else leaves

    def _line(self, section: Section) -> _Run | None:
        """Return a run that begins here and is one line."""
        pieces = section.pieces
        if not section.ends or len(pieces.length) != 1 or pieces.kind[0] != LINE:
            return None
        numbers, motion_rows = self._numbers(pieces, 0, float(pieces.length[0]), 0.0, 0.0), np.zeros((ROWS, 6))
        count = straight(numbers, motion_rows)
        if not count:
            return None
        motion_rows = motion_rows[:count]
        length, feed = float(pieces.length[0]), float(pieces.feed[0])
        direction, most = pieces.shape[0, :, 1] / length, np.zeros((len(self._limits), 4))
        most[:, 0] = np.abs(direction)
        seen = _End(motion_rows, float(np.sum(motion_rows[:, 0])), length, feed, direction, most)
        return _Run(Part(pieces, from_rows(motion_rows, 0), True), section.tolerance, _Stretch(0, count, numbers), seen)

    def _fix(self, run: _Run) -> list[Part]:
        """Fix the motion of a run; return the parts that are final."""
        before, self._fixed = self._fixed, run.part
        if before is None:
            return []
        if run.lasts == 0.0:
            return [before]
        leaves, self._fixed = overlapped(before, run.part, run.lasts, run.corner)
        return leaves

    def _stopped(self, one: _Run, two: _Run) -> tuple[_Run, _Run]:
        """Return both runs unchanged, and how long they overlap."""
        end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
        feed = max(end.feed, begin.feed)
        # of a run that is a single part the other half is for its other end
        share = 0.5 if two.part.ends else 1.0
        longest = min(end.lasts, begin.lasts, share * _time(two.part.motion), _time(one.part.motion) - one.lasts) * (
            1.0 - 1e-6
        )
        lasts = overlap(
            end.rows,
            len(end.rows),
            end.length,
            end.direction,
            end.most,
            begin.rows,
            len(begin.rows),
            begin.direction,
            begin.most,
            longest,
            one.tolerance,
            self._limits,
            feed,
        )
        return one, two._replace(lasts=lasts if lasts >= _SHORTEST else 0.0, corner=one.tolerance)

    def _met(self, one: _Run, two: _Run) -> tuple[_Run, _Run]:
        """Return two runs with the corner between them, the first one in its final form."""
        best = self._stopped(one, two)
        tail = one.whole or self._tail(one.part)
        head = two.whole or self._head(two.part)
        if tail is not None and head is not None:
            end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
            return self._bump(one, end, tail, two, begin, head, best[1].lasts, max(end.feed, begin.feed)) or best
        # next to an arc a line leaves room for what the bend takes of its axis
        for share in _SLOWED if (tail is None) != (head is None) else ():
            slowed = self._slowed(one, tail, TAIL, share), self._slowed(two, head, HEAD, share)
            if slowed[0] and slowed[1]:
                stopped = self._stopped(slowed[0], slowed[1])
                if _together(stopped) < _together(best) and self._holds(stopped[0]):
                    best = stopped
        return best

    def _slowed(self, run: _Run, stretch: _Stretch | None, at: int, share: float) -> _Run | None:
        """Slow a run's ramp on a line to the corner: a share of the jerk, and the square of that share of the snap."""
        if stretch is None:
            return run
        numbers, motion_rows = stretch.numbers.copy(), np.zeros((ROWS, 6))
        numbers[[at + JERK_SHARE, at + SNAP_SHARE]] = share, share * share
        count = straight(numbers, motion_rows)
        if not count:
            return None
        k = len(run.part.pieces.length) - 1 if at == TAIL else 0
        part = run.part._replace(motion=_spliced(stretch, run.part.motion, k, motion_rows[:count]))
        if not run.whole:
            return run._replace(part=part)
        return run._replace(part=part, whole=_Stretch(0, count, numbers), seen=_made(run.seen, motion_rows[:count]))

    def _holds(self, run: _Run) -> bool:
        """True if a replanned run may still overlap with the previous one as it does."""
        if run.lasts == 0.0 or self._fixed is None:
            return True
        end, begin = _end(self._fixed, True), run.seen or _end(run.part, False)
        share, away = together(
            end.rows,
            len(end.rows),
            end.length,
            end.direction,
            end.most,
            begin.rows,
            len(begin.rows),
            begin.direction,
            begin.most,
            run.lasts,
            self._limits,
            max(end.feed, begin.feed),
        )
        return share <= 1.0 + 1e-10 and away <= run.corner

    def _bump(
        self, one: _Run, end: _End, tail: _Stretch, two: _Run, begin: _End, head: _Stretch, lasts: float, feed: float
    ) -> tuple[_Run, _Run] | None:
        """Return both runs with a bump, if that is quicker than an overlap of `lasts` seconds."""
        motion0, motion1 = one.part.motion, two.part.motion
        quickest = _time(motion0, tail) + _time(motion1, head) - lasts
        numbers0, numbers1 = tail.numbers.copy(), head.numbers.copy()
        # the head of a whole run that overlaps already is made anew with its tail, and looked at again
        again = one.whole is not None and one.lasts > 0.0 and self._fixed is not None
        before = _end(self._fixed, True) if again and self._fixed else end
        result, rows0, rows1 = np.zeros(5), np.zeros((ROWS, 6)), np.zeros((ROWS, 6))
        count0, count1 = bump(
            numbers0,
            end.direction,
            end.most,
            numbers1,
            begin.direction,
            begin.most,
            before.rows,
            before.length,
            before.direction,
            before.most,
            one.lasts if again else 0.0,
            one.corner,
            max(before.feed, end.feed),
            two.whole is not None,
            one.tolerance,
            self._limits,
            feed,
            quickest,
            rows0,
            rows1,
            result,
        )
        if not count0:
            return None
        n = len(one.part.pieces.length) - 1
        rows0, rows1 = rows0[:count0], rows1[:count1]
        made0, made1 = _spliced(tail, motion0, n, rows0), _spliced(head, motion1, 0, rows1)
        whole = _Stretch(0, count1, numbers1) if two.whole else None
        lasts = 2.0 * float(result[WIDE]) + float(result[SHORT])
        run = two._replace(
            part=two.part._replace(motion=made1),
            whole=whole,
            seen=_made(two.seen, rows1),
            lasts=lasts,
            corner=one.tolerance,
        )
        return one._replace(part=one.part._replace(motion=made0), seen=_made(one.seen, rows0)), run

    def _tail(self, part: Part) -> _Stretch | None:
        """Return the stretch from the first node on the last piece to the stop."""
        motion, last = part.motion, len(part.pieces.length) - 1
        nodes = np.flatnonzero((motion.piece == last) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        if not len(nodes) or part.pieces.kind[last] != LINE:
            return None
        m = int(nodes[0])
        length = float(part.pieces.length[last]) - float(motion.x[m])
        return _Stretch(m, len(motion.piece), self._numbers(part.pieces, last, length, float(motion.speed[m]), 0.0))

    def _head(self, part: Part) -> _Stretch | None:
        """Return the stretch from rest to the last node on the first piece."""
        motion = part.motion
        nodes = np.flatnonzero((motion.piece == 0) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        m = int(nodes[-1]) if len(nodes) else 0
        if not m or part.pieces.kind[0] != LINE:
            return None
        return _Stretch(0, m, self._numbers(part.pieces, 0, float(motion.x[m]), 0.0, float(motion.speed[m])))

    def _numbers(self, pieces: Pieces, k: int, length: float, begin: float, end: float) -> np.ndarray:
        """Return the numbers that describe a stretch of a line, from node to node."""
        slope = np.maximum(np.abs(pieces.shape[k, :, 1]) / float(pieces.length[k]), 1e-200)
        numbers = np.zeros(NUMBERS)
        numbers[FASTEST : SNAP + 1] = np.min(self._limits / slope[:, None], axis=0) * (1.0 - 1e-12)
        numbers[FASTEST] = min(numbers[FASTEST], float(pieces.feed[k]) / float(np.sqrt(slope @ slope)))
        numbers[LENGTH], numbers[HEAD], numbers[TAIL] = length, begin, end
        numbers[[end + share for end in (HEAD, TAIL) for share in (JERK_SHARE, SNAP_SHARE)]] = 1.0
        return numbers


def _together(both: tuple[_Run, _Run]) -> float:
    """Return the time of both runs, s."""
    return _time(both[0].part.motion) + _time(both[1].part.motion) - both[1].lasts


def _time(motion: Motion, stretch: _Stretch | None = None) -> float:
    return float(np.sum(motion.duration[stretch.first : stretch.last] if stretch else motion.duration))


def _spliced(stretch: _Stretch, motion: Motion, k: int, new: np.ndarray) -> Motion:
    """Replace a stretch on piece k of a motion, in rows as of `straight`."""
    if stretch.first == 0 and stretch.last == len(motion.duration):
        return from_rows(new, k, float(motion.x[0]))
    parts = zip(motion, from_rows(new, k, float(motion.x[stretch.first])), strict=True)
    return Motion(*(np.concatenate([old[: stretch.first], middle, old[stretch.last :]]) for old, middle in parts))


def _made(seen: _End | None, new: np.ndarray) -> _End | None:
    """Return the end of a run with another motion."""
    return seen._replace(rows=new, lasts=float(np.sum(new[:, 0]))) if seen else None


def _end(part: Part, last: bool) -> _End:
    """Return the end of a part: on its last piece, or on its first."""
    pieces, on = part.pieces, part.motion
    k = len(pieces.length) - 1 if last else 0
    if k or not last:
        inside = on.piece == k
        if not last:
            m = int(np.flatnonzero(inside)[-1])  # it may go on to the next piece
            there = on.x[m] + way(*(float(column[m]) for column in (*on[3:], on.duration)))
            inside[m] = inside.all() and there <= pieces.length[k]
        on = Motion(*(column[inside] for column in on))
    kind, length, shape = int(pieces.kind[k]), float(pieces.length[k]), pieces.shape[k]
    most, direction = np.zeros((len(shape), 4)), shape[:, 1] / length
    if kind == LINE:
        most[:, 0] = np.abs(direction)
    else:
        r = np.zeros((len(shape), 5))
        derivatives(kind, length, shape, length if last else 0.0, r)
        direction = r[:, 1].copy()
        bounds(kind, length, shape, most)
    return _End(rows(on), float(np.sum(on.duration)), length, float(pieces.feed[k]), direction, most)
