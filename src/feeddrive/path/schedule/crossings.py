"""Runs that follow one another: how each corner between them is passed, and the parts of the motion that are final.

The corners themselves are planned in `corner.py`: runs along single lines many at a time, all others one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.kernels.source import by_field, columns, rows_for
from feeddrive.path.motion import (
    LINE,
    Derivatives,
    Entering,
    Interval,
    Motion,
    Part,
    Pieces,
    Section,
    derivatives,
    direction,
    from_rows,
    one_after_the_other,
    part_of_pieces,
    piece_of,
    rows,
    slowed,
    way,
)
from feeddrive.path.schedule.corner import (
    LONGEST,
    ROWS,
    SHORTEST,
    Before,
    Both,
    End,
    Leaves,
    LineRuns,
    LineStretch,
    Node,
    line_stretch,
    meet,
    meet_lines,
    overlap,
    shared,
    slower_overlap,
    stop_lines,
    straight,
    together,
)
from feeddrive.path.schedule.lift import divided
from feeddrive.path.schedule.ramp import Slopes, bounds

_SLOWED = (0.93, 0.85)  # shares of the jerk
_BESIDE = 1e-6  # of a piece, or of the way to its joint, is left of a plateau that is divided there
MANY = 64  # largest number of lines that are planned in one call, which then takes some 10 ms


def overlapped(one: Part, two: Part, lasts: float, tolerance: float) -> tuple[list[Part], Part]:
    """Overlap two runs by `lasts` s: return the parts until the first run ends, and the rest of the second run."""
    ends, begins = rows(one.motion), rows(two.motion)
    last, first = (rows_for(Interval, len(ends) + len(begins)) for _ in range(2))
    count, m, alone, n, rest = shared(ends, len(ends), begins, len(begins), lasts, last, first)
    entering = Entering(part_of_pieces(two.pieces, 0, 1), from_rows(first[:count], 0), tolerance)
    k = len(one.pieces.length) - 1
    leaves = [Part(part_of_pieces(one.pieces, k, k + 1), from_rows(last[:count], 0), True, entering, factor=one.factor)]
    before = Motion._make([array[: m + int(alone > 0.0)].copy() for array in one.motion])
    if len(before.duration):
        before.duration[-1] = alone if alone > 0.0 else before.duration[-1]
        leaves.insert(0, one._replace(motion=before, ends=False))
    behind = Motion._make([array[n:].copy() for array in two.motion])
    if len(behind.duration):
        for column, value in zip([behind.duration, *behind[2:]], rest, strict=True):
            column[0] = value
    return leaves, two._replace(motion=behind)


class _Stretch(NamedTuple):
    """The part of a motion that may be replanned: the time intervals from `first` up to but excluding `last`, on one
    line between two nodes.

    motion  of the run, in which a plateau that goes on beyond the line is divided
    """

    motion: Motion
    first: int
    last: int
    line: LineStretch


class _Run(NamedTuple):
    """A part of the motion whose end may still change, and its overlap with the previous part.

    whole  the line of a run along one, whose head and tail are planned together; None for other runs
    seen   motion of such a run at its corners
    bump   True if it begins with a bump, which only the previous run beside it keeps within the limits
    """

    part: Part
    tolerance: float  # of the corner in which it ends, m
    whole: LineStretch | None
    seen: End | None = None
    lasts: float = 0.0  # s
    corner: float = 0.0  # tolerance of that corner
    bump: bool = False


class Lines(NamedTuple):
    """Consecutive runs along single lines, planned from stop to stop; they depend on no other run.

    runs  has room for the two runs before them, and then a run for each section
    """

    sections: Sequence[Section]
    runs: LineRuns

    def run(self, k: int) -> _Run:
        """Return run k with its motion from stop to stop."""
        section = self.sections[k]
        return _line_run(section.pieces, self.runs, k + _BEFORE, section.tolerance)


_BEFORE = 2  # a line overlaps with the previous run, and this one with the run before it


def _line_run(pieces: Pieces, runs: LineRuns, k: int, tolerance: float, corner: float = 0.0) -> _Run:
    """Return run k of some lines; `corner` is the tolerance of the corner at which it begins."""
    arrays: Any = runs  # of records, which are numpy's here
    used = int(runs.used[k])
    new, line = arrays.motion[k][:used], by_field(LineStretch, arrays.line[k])
    motion = from_rows(new, 0)
    seen = End(
        new, used, _time(motion), line.length, float(runs.feed[k]), runs.along[k], runs.most[k], LINE, runs.along
    )
    bump = line.head.wide > 0.0
    return _Run(Part(pieces, motion, True), tolerance, line, seen, float(runs.lasts[k]), corner, bump)


class Crossings:
    """The planner of corners, which starts each run before the previous one has ended as far as limits and tolerances
    allow.

    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    """

    def __init__(self, limits: np.ndarray) -> None:
        self._limits = np.ascontiguousarray(limits, float)
        self._fixed: Part | None = None  # its end may overlap with the next
        self._open: _Run | None = None

    def add(self, part: Part, tolerance: float) -> list[Part]:
        """Add a part and return those that are now final; `tolerance` is the tolerance of the corner at the end of the
        part, m, or 0 for a stop there.
        """
        begins = part.motion.x[0] == 0.0 and part.motion.speed[0] == 0.0
        section = Section(part.pieces, part.ends, tolerance)
        lines = self.lines([section]) if begins and is_line(section) else None
        return self._next(lines.run(0) if lines and lines.sections else _Run(part, tolerance, None))

    def add_lines(self, lines: Lines) -> list[Part]:
        """Add runs along single lines and return the parts that are now final."""
        leaves, count = list[Part](), len(lines.sections)
        for k in range(count):
            one, before = self._open, self._fixed
            if one is not None and one.whole is not None and before is not None and _is_alone(before):
                return leaves + self._next_lines(before, one, lines, k)
            leaves += self._next(lines.run(k))
        return leaves

    def _next(self, two: _Run) -> list[Part]:
        one, self._open = self._open, two
        if one is None:
            return []
        if one.part.ends and one.tolerance > 0.0:
            one, self._open = self._met(one, two)
        return self._fix(one)

    def _next_lines(self, before: Part, one: _Run, lines: Lines, first: int) -> list[Part]:
        """Do as `_next` for the runs of lines from `first` on, all at once, behind two runs along lines."""
        runs = _some(lines.runs, first, len(lines.runs.used))
        assert one.whole is not None
        assert one.seen is not None
        end = _end(before, True)
        still = Node(0.0)
        _put(runs, 0, end, LineStretch(end.length, 0.0, 0.0, 0.0, 0.0, still, still), 0.0, one.corner)
        _put(runs, 1, one.seen, one.whole, one.lasts, one.tolerance)
        pieces = [before.pieces, one.part.pieces, *(section.pieces for section in lines.sections[first:])]
        leaves = _room(len(pieces))
        count = meet_lines(runs, self._limits, Both(*(rows_for(Interval, 2 * ROWS) for _ in range(2))), leaves)
        last = len(pieces) - 1
        self._open = _line_run(pieces[last], runs, last, float(runs.tolerance[last]), float(runs.tolerance[last - 1]))
        self._fixed = _line_run(pieces[last - 1], runs, last - 1, 0.0).part
        return list(_parts(pieces, runs.tolerance.tolist(), leaves, count))

    def end(self) -> list[Part]:
        """Return the remaining parts, after which the motion is at rest."""
        one, self._open = self._open, None
        leaves = self._fix(one) if one else []
        last, self._fixed = self._fixed, None
        return [*leaves, last] if last else leaves

    def lines(self, sections: Sequence[Section]) -> Lines:
        """Return the runs of sections for which `is_line`, planned in closed form, up to the first without a motion."""
        n, axes = len(sections) + _BEFORE, len(self._limits)
        runs = LineRuns(
            line=rows_for(LineStretch, n),
            feed=np.zeros(n),
            tolerance=np.zeros(n),
            along=np.zeros((n, axes)),
            most=rows_for(Slopes, n, axes),
            motion=rows_for(Interval, n, ROWS),
            used=np.zeros(n, np.int64),
            lasts=np.zeros(n),
        )
        runs.tolerance[_BEFORE:] = [section.tolerance for section in sections]
        pieces = one_after_the_other([section.pieces for section in sections])
        count = stop_lines(pieces, self._limits, _BEFORE, runs)
        return Lines(sections[:count], _some(runs, 0, count + _BEFORE))

    def _fix(self, run: _Run) -> list[Part]:
        """Make the motion of a run final; return the parts that are now final."""
        before, self._fixed = self._fixed, run.part
        if before is None:
            return []
        if run.lasts == 0.0:
            return [before]
        leaves, self._fixed = overlapped(before, run.part, run.lasts, run.corner)
        return leaves

    def _stopped(self, one: _Run, two: _Run) -> tuple[_Run, _Run]:
        """Return both runs with unchanged motions and their longest overlap."""
        end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
        lasts = overlap(end, begin, _longest(one, end, two, begin), one.tolerance, self._limits)
        return one, two._replace(lasts=lasts if lasts >= SHORTEST else 0.0, corner=one.tolerance)

    def _both_slower(self, one: _Run, two: _Run, best: tuple[_Run, _Run]) -> tuple[_Run, _Run]:
        """Return both runs slower as a whole, if with their overlap they take less time than `best`, which is returned
        otherwise.
        """
        # a bump at the other corner of the first run would no longer be the one of the run before it, and its overlap
        # cannot be shorter as that of two stops can
        if one.bump or not (_rests(one.part) and _rests(two.part)):
            return best
        end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
        longest, whole = _longest(one, end, two, begin), _time(one.part.motion) + _time(two.part.motion)
        least = max(whole - _together(best), 0.0) + SHORTEST
        lasts, factor = slower_overlap(end, begin, longest, one.tolerance, self._limits, whole, least)
        if lasts == 0.0:
            return best
        before = self._held(_slower(one, factor))
        found = before, _slower(two, factor)._replace(lasts=lasts, corner=one.tolerance)
        lost = best[0].lasts - before.lasts
        return found if _together(found) + lost < _together(best) else best

    def _met(self, one: _Run, two: _Run) -> tuple[_Run, _Run]:
        """Plan the corner between two runs; return both, the first one in its final form."""
        tail, head = self._tail(one), self._head(two)
        if tail is not None and head is not None:
            return self._on_lines(one, tail, two, head)
        best, ways = self._stopped(one, two), [(one, two)]
        # next to an arc a slower ramp on the line leaves room for the derivatives that curvature adds on its axes
        for share in _SLOWED if (tail is None) != (head is None) else ():
            before, after = self._slowed(one, tail, True, share), self._slowed(two, head, False, share)
            if before and after:
                ways.append((before, after))
                stopped = self._stopped(before, after)
                if _together(stopped) < _together(best) and self._holds(before):
                    best = stopped
        for before, after in ways:
            best = self._both_slower(before, after, best)
        return best

    def _slowed(self, run: _Run, stretch: _Stretch | None, tail: bool, share: float) -> _Run | None:
        """Return the run with a slower ramp on the line at the corner, which is its `tail` or its head: its jerk limit
        is multiplied by `share`, its snap limit by `share`².

        A run without such a stretch is returned unchanged; the result is None if no motion is possible.
        """
        if stretch is None:
            return run
        line, motion_rows = stretch.line, rows_for(Interval, ROWS)
        node = (line.tail if tail else line.head)._replace(jerk_share=share, snap_share=share * share)
        line = line._replace(tail=node) if tail else line._replace(head=node)
        count = straight(line, motion_rows)
        if not count:
            return None
        k = len(run.part.pieces.length) - 1 if tail else 0
        motion = _spliced(stretch, k, motion_rows[:count])
        run = run._replace(part=run.part._replace(motion=motion))
        if run.whole is None:
            return run
        return run._replace(whole=line, seen=_made(run.seen, motion_rows[:count], motion))

    def _holds(self, run: _Run) -> bool:
        """Return True if a replanned run still satisfies limits and tolerance in its overlap with the previous one."""
        if run.lasts == 0.0 or self._fixed is None:
            return True
        end, begin = _end(self._fixed, True), run.seen or _end(run.part, False)
        share, away, _ = together(end, begin, run.lasts, self._limits, max(end.feed, begin.feed))
        return share <= 1.0 + 1e-10 and away <= run.corner

    def _held(self, run: _Run) -> _Run:
        """Return a slower run whose overlap with the previous one is shorter if it would not hold otherwise."""
        if self._holds(run) or self._fixed is None:
            return run
        end, begin = _end(self._fixed, True), run.seen or _end(run.part, False)
        lasts = overlap(end, begin, run.lasts, run.corner, self._limits)
        return run._replace(lasts=lasts if lasts >= SHORTEST else 0.0)

    def _on_lines(self, one: _Run, tail: _Stretch, two: _Run, head: _Stretch) -> tuple[_Run, _Run]:
        """Plan the corner between two runs with these stretches of lines before and behind it."""
        end, begin = one.seen or _end(one.part, True), two.seen or _end(two.part, False)
        # a run along one line is planned anew as a whole, so that its overlap with the run before must be checked again
        before = Before(end, 0.0, one.corner)
        if one.whole is not None and one.lasts > 0.0 and self._fixed is not None:
            before = Before(_end(self._fixed, True), one.lasts, one.corner)
        rows0, rows1 = rows_for(Interval, ROWS), rows_for(Interval, ROWS)
        found = meet(
            tail.line,
            end,
            head.line,
            begin,
            before,
            two.whole is not None,
            one.tolerance,
            self._limits,
            _stretch_time(tail) + _stretch_time(head),
            _longest(one, end, two, begin),
            rows0,
            rows1,
        )
        two = two._replace(lasts=found.lasts, corner=one.tolerance, bump=found.first > 0)
        if not found.first:
            # without a bump both may stop in the corner more slowly
            alone = one.whole is not None and two.whole is not None
            return (one, two) if alone else self._both_slower(one, two, (one, two))
        n = len(one.part.pieces.length) - 1
        rows0, rows1 = rows0[: found.first], rows1[: found.second]
        made0, made1 = _spliced(tail, n, rows0), _spliced(head, 0, rows1)
        run = two._replace(
            part=two.part._replace(motion=made1),
            whole=head.line._replace(head=found.node) if two.whole is not None else None,
            seen=_made(two.seen, rows1, made1),
        )
        return one._replace(part=one.part._replace(motion=made0), seen=_made(one.seen, rows0, made0)), run

    def _tail(self, run: _Run) -> _Stretch | None:
        """Return the stretch from the first node on the last piece to the stop, or from where the motion comes onto
        this piece at constant speed.
        """
        part = run.part
        if run.whole is not None:
            return _Stretch(part.motion, 0, len(part.motion.duration), run.whole)
        motion, last = part.motion, len(part.pieces.length) - 1
        nodes = np.flatnonzero((motion.piece == last) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        if not len(nodes) or part.pieces.kind[last] != LINE:
            return None
        m, length = int(nodes[0]), float(part.pieces.length[last])
        speed, here = float(motion.speed[m]), float(motion.x[m])
        if m and _flat(motion, m - 1) and here > _BESIDE * length:
            # it began on the piece before, otherwise its begin would be the first node
            alone = float(motion.duration[m - 1]) - (1.0 - _BESIDE) * here / speed
            motion = divided(motion, m - 1, alone, part.pieces.length)
        line = self._stretch(part.pieces, last, length - float(motion.x[m]), Node(speed), Node(0.0))
        return _Stretch(motion, m, len(motion.piece), line)

    def _head(self, run: _Run) -> _Stretch | None:
        """Return the stretch from rest to the last node on the first piece, or to where the motion leaves this piece at
        constant speed.
        """
        part = run.part
        if run.whole is not None:
            return _Stretch(part.motion, 0, len(part.motion.duration), run.whole)
        motion = part.motion
        nodes = np.flatnonzero((motion.piece == 0) & (motion.acceleration == 0.0) & (motion.jerk == 0.0))
        m = int(nodes[-1]) if len(nodes) else 0
        if not m or part.pieces.kind[0] != LINE:
            return None
        length, speed, here = float(part.pieces.length[0]), float(motion.speed[m]), float(motion.x[m])
        if _flat(motion, m) and length - here > _BESIDE * length:
            if here + speed * float(motion.duration[m]) > length:
                motion = divided(motion, m, (1.0 - _BESIDE) * (length - here) / speed, part.pieces.length)
            here += speed * float(motion.duration[m])
            m += 1
        line = self._stretch(part.pieces, 0, here, Node(0.0), Node(speed))
        return _Stretch(motion, 0, m, line)

    def _stretch(self, pieces: Pieces, k: int, length: float, head: Node, tail: Node) -> LineStretch:
        """Return a stretch of line k from node to node, as for `straight`."""
        along, feed = np.ascontiguousarray(direction(pieces, k)), float(pieces.feed[k])
        return line_stretch(along, feed, length, self._limits, head, tail)


def is_line(section: Section) -> bool:
    """Return True for a run along a single line, from rest to rest."""
    pieces = section.pieces
    return section.ends and len(pieces.length) == 1 and pieces.kind[0] == LINE


def _is_alone(part: Part) -> bool:
    """Return True if the end of a run is on the single line of its part, with a motion as short as that of a line."""
    return len(part.pieces.length) == 1 and part.pieces.kind[0] == LINE and part.ends and len(part.motion.x) <= ROWS


def _some(runs: LineRuns, first: int, last: int) -> LineRuns:
    """Return the runs from `first` up to but excluding `last`."""
    arrays: list[Any] = list(runs)
    return LineRuns._make([array[first:last] for array in arrays])


def _put(runs: LineRuns, k: int, end: End, line: LineStretch, lasts: float, tolerance: float) -> None:
    """Make the end of a run along a line number k of some runs.

    `lasts` is its overlap with the previous run, s, and `tolerance` that of the corner at its end, m.
    """
    arrays: Any = runs  # of records, which are numpy's here
    arrays.motion[k, : end.used] = end.motion
    arrays.used[k], arrays.feed[k], arrays.along[k], arrays.most[k] = end.used, end.feed, end.direction, end.most
    arrays.line[k], arrays.lasts[k], arrays.tolerance[k] = columns(line), lasts, tolerance


def _room(n: int) -> Leaves:
    """Return room for the motions of n runs."""
    size = 5 * ROWS * n  # those before an overlap, and twice those of two runs in it
    motion = Motion(np.empty(size), np.empty(size, np.int64), *(np.empty(size) for _ in range(5)))
    return Leaves(motion, *(np.zeros(n, np.int64) for _ in range(3)))


def _parts(pieces: list[Pieces], tolerance: list[float], leaves: Leaves, count: int) -> Iterator[Part]:
    """Yield the parts of the motions of runs along single lines, all of which but two are final."""
    columns = [column[:count].copy() for column in leaves.motion]

    def motion(first: int, last: int) -> Motion:
        return Motion._make([column[first:last] for column in columns])

    final = len(pieces) - _BEFORE
    alone, common, entering = (list(map(int, begins[:final])) for begins in leaves[1:])
    for k, end in enumerate([*alone[1:], count]):
        if entering[k] == common[k]:
            yield Part(pieces[k], motion(alone[k], common[k]), True)
            continue
        if common[k] > alone[k]:
            yield Part(pieces[k], motion(alone[k], common[k]), False)
        enters = Entering(pieces[k + 1], motion(entering[k], end), tolerance[k])
        yield Part(pieces[k], motion(common[k], entering[k]), True, enters)


def _longest(one: _Run, end: End, two: _Run, begin: End) -> float:
    """Return the longest time that two runs may overlap, s."""
    # half of a run in a single part is reserved for the corner at its other end
    share = 0.5 if two.part.ends else 1.0
    room = min(share * _time(two.part.motion), _time(one.part.motion) - one.lasts)
    return min(end.lasts, begin.lasts, room) * LONGEST


def _rests(part: Part) -> bool:
    """Return True if a part is a whole run, from rest to rest."""
    return part.ends and part.motion.x[0] == 0.0 and part.motion.speed[0] == 0.0


def _slower(run: _Run, factor: float) -> _Run:
    """Return a run that takes `factor` times as long."""
    run = run._replace(part=run.part._replace(motion=slowed(run.part.motion, factor)))
    if run.whole is None or run.seen is None:
        return run
    # planned anew at its other corner with limits that make the same motion
    line = run.whole
    line = line._replace(
        fastest=line.fastest / factor,
        acceleration=line.acceleration / factor**2,
        jerk=line.jerk / factor**3,
        snap=line.snap / factor**4,
        head=_slower_node(line.head, factor),
        tail=_slower_node(line.tail, factor),
    )
    return run._replace(whole=line, seen=_made(run.seen, rows(run.part.motion), run.part.motion))


def _slower_node(node: Node, factor: float) -> Node:
    """Return the end of a stretch whose motion takes `factor` times as long."""
    return node._replace(
        speed=node.speed / factor, wide=node.wide * factor, short=node.short * factor, jerk=node.jerk / factor**3
    )


def _together(both: tuple[_Run, _Run]) -> float:
    """Return the total duration of both runs, s."""
    one, two = both
    return _time(one.part.motion) + _time(two.part.motion) - two.lasts


def _time(motion: Motion) -> float:
    return float(motion.duration.sum())


def _stretch_time(stretch: _Stretch) -> float:
    return float(stretch.motion.duration[stretch.first : stretch.last].sum())


def _flat(motion: Motion, m: int) -> bool:
    """Return True if time interval m has constant speed."""
    return motion.acceleration[m] == 0.0 and motion.jerk[m] == 0.0 and motion.snap[m] == 0.0


def _spliced(stretch: _Stretch, k: int, new: np.ndarray) -> Motion:
    """Replace a stretch on piece k of its motion by rows in the form of `straight`."""
    motion, first, last, _ = stretch
    if first == 0 and last == len(motion.duration):
        return from_rows(new, k, float(motion.x[0]))
    parts = zip(motion, from_rows(new, k, float(motion.x[first])), strict=True)
    return Motion._make([np.concatenate([old[:first], middle, old[last:]]) for old, middle in parts])


def _made(seen: End | None, new: np.ndarray, motion: Motion) -> End | None:
    """Return the end of a run along a line with its motion replaced, or None if there is no such end.

    `new` has the time intervals of `motion`.
    """
    return seen._replace(motion=new, used=len(new), lasts=_time(motion)) if seen else None


def _end(part: Part, last: bool) -> End:
    """Return the end of a part at a corner: on its last piece if `last`, otherwise on its first."""
    pieces, on = part.pieces, part.motion
    k = len(pieces.length) - 1 if last else 0
    if k or not last:
        inside = on.piece == k
        if not last:
            m = int(np.flatnonzero(inside)[-1])  # it may continue on the next piece
            there = on.x[m] + way(*(float(column[m]) for column in (*on[3:], on.duration)))
            inside[m] = inside.all() and there <= pieces.length[k]
        on = Motion._make([column[inside] for column in on])
    length, feed = float(pieces.length[k]), float(pieces.feed[k])
    if pieces.kind[k] == LINE:
        return End(rows(on), len(on.duration), _time(on), length, feed, *_along_line(pieces, k))
    piece = piece_of(pieces, k)
    axes = len(piece.shape)
    most, r = rows_for(Slopes, axes), rows_for(Derivatives, axes)
    bounds(piece, most)
    derivatives(*piece, length if last else 0.0, r)
    along = np.array(by_field(Derivatives, r).first)
    return End(rows(on), len(on.duration), _time(on), length, feed, along, most, int(piece.kind), piece.shape)


def _along_line(pieces: Pieces, k: int) -> tuple[np.ndarray, np.ndarray, int, np.ndarray]:
    """Return direction, bounds, kind and shape of a line."""
    along = direction(pieces, k)
    most = rows_for(Slopes, len(along))
    np.abs(along, out=np.asarray(by_field(Slopes, most).M1))
    return along, most, LINE, pieces.shape[k]
