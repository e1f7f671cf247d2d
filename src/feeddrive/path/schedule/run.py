"""The motion along a run, from rest to rest, planned window by window as its path becomes available.

Each window ends with a stop, so a safe stop is always planned.  The nodes in the first part of its plan become final;
the next window starts from the last of them.  If the motion cannot brake from there to the speed that newly added
pieces allow, the previous plan is followed to its next node, or at the latest to its stop.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.source import by_field, columns, rows_for
from feeddrive.path.motion import Motion, Part, Pieces, Section, one_after_the_other, part_of_pieces
from feeddrive.path.schedule.plan import (
    MARGIN,
    Stretch,
    brake_soon,
    plan,
    plateau_begin,
    plateau_end,
    takes_time,
    timed,
)
from feeddrive.path.schedule.ramp import NO_RAMP, Cap, Path, Slopes, duration, pieces_room

# shares of the speed that curvature allows: on a piece held at its cap, and on one that ramps cross.  The second pair
# is for chains of corners, where ramps need more room; both are planned, and the faster plan is taken
SHARES = ((0.9, 0.6), (0.7, 0.4))
# a second plan takes as long as the first: where the first has been faster in _SURE windows of a run in sequence, the
# second is made in every _AGAIN-th window only
_SURE = 2
_AGAIN = 8
_FEW = 3  # number of stretches from rest to rest: lifting finds what a second plan of so few would
# 3,000 chords of 1 mm take 0.4 % longer with windows of 400 pieces of which 0.6 are kept, and 1.15 times the CPU
WINDOW = 800  # number of pieces
# beyond that the plan already brakes to the stop at the end of its window
_KEPT = 0.8  # of the length of a window becomes final
# shares of the speed to which a motion brakes if it cannot be planned from there
_SLOWER = (0.97, 0.9, 0.75, 0.5, 0.25)


class _Room(NamedTuple):
    """The bounds and caps of pieces, for one pair of limit shares in `SHARES`."""

    most: np.ndarray
    caps: np.ndarray

    @property
    def plateau(self) -> np.ndarray:
        """The largest speed of a plateau on each piece, m/s."""
        return np.asarray(by_field(Cap, self.caps).plateau)


class _Rooms:
    """The room of pieces for each pair in `SHARES`; that of the second pair is made when it is asked for, since many
    runs are planned with the first one only.
    """

    def __init__(self, pieces: Pieces, limits: np.ndarray) -> None:
        self._given, self._norms = (pieces, limits), np.empty(len(pieces.length))
        most = rows_for(Slopes, len(pieces.length), len(limits))
        self._made = [self._room(most, SHARES[0], False)]

    def _room(self, most: np.ndarray, shares: tuple[float, float], known: bool) -> _Room:
        """Return the room for a pair of shares, with the bounds in `most` if they are `known`."""
        pieces, limits = self._given
        room = _Room(most, rows_for(Cap, len(pieces.length)))
        pieces_room(pieces, limits, *shares, known, most, self._norms, room.caps)
        return room

    @property
    def first(self) -> _Room:
        """That of the first pair."""
        return self._made[0]

    def __iter__(self) -> Iterator[_Room]:
        yield self.first
        for shares in SHARES[len(self._made) :]:
            self._made.append(self._room(self.first.most, shares, True))
        yield from self._made[1:]

    def extend(self, pieces: Pieces) -> None:
        """Add the room of the pieces that follow."""
        _, limits = self._given
        both = zip(self, _Rooms(pieces, limits), strict=True)
        self._made = [_Room(*(np.concatenate(arrays) for arrays in zip(*pair, strict=True))) for pair in both]

    def drop(self, count: int) -> None:
        """Remove the room of the first pieces."""
        self._made = [_Room(room.most[count:], room.caps[count:]) for room in self]


class _Plan(NamedTuple):
    """A plan from the current node: its stretches, and u at the start of each path piece and at the end of the last.

    ends    True if the run ends with this plan
    shares  index in `SHARES` of the pair with which it was made
    """

    begin: np.ndarray
    rows: np.ndarray
    ends: bool
    shares: int = 0


class Start(NamedTuple):
    """A node at which a motion begins within a run: u on the first piece (m), the speed (m/s), and a plan to a stop."""

    u: float
    speed: float
    stop: _Plan | None = None


def start_at(pieces: Pieces, limits: np.ndarray, u: float, speed: float) -> Start | None:
    """Return the start of a motion from a node on the first of these pieces, or None if they leave no room to stop."""
    begin = np.concatenate([[0.0], np.cumsum(pieces.length)])
    stop = _fastest(begin, _Rooms(pieces, limits), limits, False, u, speed)
    return Start(u, speed, stop) if stop else None


def highest_speeds(pieces: Pieces, limits: np.ndarray) -> np.ndarray:
    """Return the largest speed u' of a plateau on each piece, m/s, shape (n,)."""
    return _Rooms(pieces, limits).first.plateau


class Schedule:
    """The planner of runs whose sections are added successively.

    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    window  number of pieces planned together; more where ramps are longer
    start   where the motion begins, if it is not at rest at the start of a run
    """

    def __init__(self, limits: np.ndarray, window: int = WINDOW, start: Start | None = None) -> None:
        self._limits, self._window = np.ascontiguousarray(limits, float), window
        self._begin()
        self.rests = start is None
        """True if the next section begins a run at rest."""
        if start is not None:
            self._u, self._speed, self._hand = start
            if start.stop is not None:  # it must be within the first window
                self._wide = max(window, len(start.stop.begin) - 1)

    def _begin(self) -> None:
        """Start a run at rest."""
        self._pieces: Pieces | None = None  # from the current node on
        self._rooms: _Rooms | None = None
        self._u, self._speed, self._wide = 0.0, 0.0, self._window  # u on the first of the pieces
        self._hand: _Plan | None = None  # the rest of the last plan, to its stop
        self._sure = 0  # number of windows since the second pair of shares was faster
        self.rests = True

    def add(self, section: Section) -> Iterator[Part]:
        """Yield the parts of the motion that are final after this section: all of them if the run ends."""
        self._append(section.pieces)
        while self._pieces is not None:
            n = len(self._pieces.length)
            last = min(n, self._wide)
            if last < self._wide and not section.ends:
                return
            ends = section.ends and last == n
            planned = self._planned(last, ends)
            if planned is None:
                assert self._hand is not None  # from rest there is a plan
                yield self._go(self._slowed(last, ends) or self._hand, 1)
                continue
            planned, count = (planned, len(planned.rows)) if ends else _cut(planned)
            if not count:
                # no node lies early enough, since ramps are longer than the window
                self._wide = 2 * last
                continue
            self._wide = self._window
            yield self._go(planned, count)

    def _slowed(self, last: int, ends: bool) -> _Plan | None:
        """Return a plan that brakes to the first of some speeds from which there is a plan; None if there is none.

        A plan needs caps ahead that are no lower than its first speed.  Caps that fall from piece to piece, as where a
        rotary axis turns ever faster, are below it, and the previous plan would be followed to its stop.
        """
        assert self._pieces is not None
        assert self._rooms is not None
        begin = np.concatenate([[0.0], np.cumsum(self._pieces.length[:last])])
        room = self._rooms.first
        path = Path(begin, room.most[:last], room.caps[:last], self._limits)
        for share in _SLOWER if self._speed > 0.0 else ():
            speed = share * self._speed
            braking = brake_soon(path, self._u, begin[-1] * (1.0 - MARGIN), self._speed, speed)
            if braking.peak == 0.0 or not takes_time(braking, begin):
                continue
            behind = _fastest(begin, self._rooms, self._limits, ends, braking.end, speed)
            if behind is not None:
                return behind._replace(rows=np.vstack([np.array(columns(braking))[None, :], behind.rows]))
        return None

    def stop(self) -> Part | None:
        """Return the part from the end of the last one to the stop already planned, or None at rest before a run."""
        if self._pieces is None or self._hand is None or not len(self._hand.rows):
            return None
        pieces = part_of_pieces(self._pieces, 0, len(self._hand.begin) - 1)
        return self._part(pieces, self._hand.begin, self._hand.rows, True)

    def _append(self, pieces: Pieces) -> None:
        self.rests = False
        if self._pieces is None or self._rooms is None:
            self._pieces, self._rooms = pieces, _Rooms(pieces, self._limits)
            return
        self._pieces = one_after_the_other([self._pieces, pieces])
        self._rooms.extend(pieces)

    def _planned(self, last: int, ends: bool) -> _Plan | None:
        """Return the fastest plan to a stop at the end of the first `last` pieces, or None if the speed is too high to
        stop.
        """
        assert self._pieces is not None
        assert self._rooms is not None
        begin = np.concatenate([[0.0], np.cumsum(self._pieces.length[:last])])
        first = self._sure >= _SURE and self._sure % _AGAIN != 0
        planned = _fastest(begin, self._rooms, self._limits, ends, self._u, self._speed, first)
        if planned is not None:
            self._sure = self._sure + 1 if planned.shares == 0 else 0
        return planned

    def _go(self, planned: _Plan, count: int) -> Part:
        """Return the first `count` stretches of a plan as a part; the others become the planned stop."""
        assert self._pieces is not None
        assert self._rooms is not None
        if planned.ends and count == len(planned.rows):
            whole = self._part(self._pieces, planned.begin, planned.rows, True)
            self._begin()
            return whole
        kept, begin = planned.rows[:count], planned.begin
        stretch = by_field(Stretch, kept[-1])
        pieces, node = self._pieces, float(stretch.end)
        place = min(int(np.searchsorted(begin, node, side="right")) - 1, len(begin) - 2)
        if place + 1 < len(pieces.length) and node - begin[place] >= pieces.length[place]:
            place += 1  # at a joint, up to rounding
        self._u, self._speed = max(node - float(begin[place]), 0.0), float(stretch.v1)
        self._pieces = part_of_pieces(pieces, place, len(pieces.length))
        self._rooms.drop(place)
        self._hand = _Plan(begin[place:], planned.rows[count:], planned.ends)
        return self._part(part_of_pieces(pieces, 0, place + 1), begin, kept, False)

    def _part(self, pieces: Pieces, begin: np.ndarray, rows: np.ndarray, ends: bool) -> Part:
        """Return one part of the motion as time intervals of constant snap: two ramps of seven phases and a plateau for
        each stretch.
        """
        size = 15 * len(rows)
        room = Motion(np.zeros(size), np.zeros(size, np.int64), *(np.zeros(size) for _ in range(5)))
        count = timed(begin, np.ascontiguousarray(rows), room)
        return Part(pieces, Motion._make([array[:count].copy() for array in room]), ends)


def _fastest(
    begin: np.ndarray,
    rooms: _Rooms,
    limits: np.ndarray,
    ends: bool,
    u: float,
    speed: float,
    first: bool = False,
) -> _Plan | None:
    """Return the fastest plan from u to a stop at the end of the pieces that begin at `begin`, or None if the speed is
    too high to stop.

    The second pair of shares is left out where the `first` one has a plan, or one of few stretches from rest to rest.
    """
    last = len(begin) - 1
    # the stop of a window lies before the joint, so that rounding cannot move it to the next piece
    stop = begin[-1] if ends else begin[-1] * (1.0 - MARGIN)
    size = 4 * last + 16
    plans: list[_Plan] = []
    for shares, room in enumerate(rooms):
        path = Path(begin, room.most[:last], room.caps[:last], limits)
        slow, stack, rows = np.zeros(last, np.int64), rows_for(Stretch, size), rows_for(Stretch, size)
        count = plan(path, rooms.first.caps[:last], u, stop, speed, slow, stack, rows)
        if count >= 0:
            plans.append(_Plan(begin, rows[:count], ends, shares))
            if first or (ends and speed == 0.0 and count <= _FEW):
                break
    return min(plans, key=lambda made: _time(made.rows)) if len(plans) > 1 else plans[0] if plans else None


def plan_run(pieces: Pieces, limits: np.ndarray, window: int = WINDOW) -> Motion:
    """Return the motion along a whole run; `limits` and `window` as for `Schedule`."""
    motions, first = list[Motion](), 0
    for part in Schedule(limits, window).add(Section(pieces, True)):
        motions.append(part.motion._replace(piece=part.motion.piece + first))
        first += len(part.pieces.length) - 1  # the next part begins on the piece where this one ends
    return Motion(*(np.concatenate(arrays) for arrays in zip(*motions, strict=True)))


def _time(rows: np.ndarray) -> float:
    """Return the total duration of stretches, s."""
    now = by_field(Stretch, rows)
    up, down = duration.python(now.up), duration.python(now.down)
    way = now.end - now.begin - 0.5 * (now.v0 + now.peak) * up - 0.5 * (now.v1 + now.peak) * down
    return float(np.sum(up + down + np.maximum(way, 0.0) / now.peak))


def _cut(planned: _Plan) -> tuple[_Plan, int]:
    """Split the plateau at which the final part of a window ends; return the plan, and the number of stretches in this
    part.
    """
    rows, ends = planned.rows, _KEPT * planned.begin[-1]
    count = int(np.searchsorted(np.asarray(by_field(Stretch, rows).end), ends, side="right"))
    if count < len(rows):
        now = by_field(Stretch, rows[count])
        low, high = plateau_begin.python(now), plateau_end.python(now)
        cut, margin = min(ends, high), MARGIN * (planned.begin[-1] - planned.begin[0])
        if now.end - cut <= margin:
            return planned, count + 1
        if cut - low > margin:
            both = [columns(_before(now, cut)), columns(_behind(now, cut))]
            return planned._replace(rows=np.vstack([rows[:count], both, rows[count + 1 :]])), count + 1
    return planned, count


def _before(stretch: Stretch, u: float) -> Stretch:
    """Return a stretch up to a point of its plateau."""
    return stretch._replace(end=u, v1=stretch.peak, down=NO_RAMP)


def _behind(stretch: Stretch, u: float) -> Stretch:
    """Return a stretch from a point of its plateau on."""
    return stretch._replace(begin=u, v0=stretch.peak, up=NO_RAMP)
