"""The motion along a run, from rest to rest, planned window by window while its path comes in.

Each window ends with a stop, so that there is always one in hand.  Of its plan the nodes in its first part are kept;
the next window goes on from the last of them.  If a slower path that comes into view asks for more than can be braked
from there, the plan before is followed to its next node, at the latest to its stop.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from feeddrive.path.motion import Motion, Part
from feeddrive.path.pieces import Pieces, Section, one_after_the_other, part_of_pieces
from feeddrive.path.schedule.hump import COLUMNS
from feeddrive.path.schedule.plan import MARGIN, plan, timed
from feeddrive.path.schedule.room import pieces_room

# shares of what curvature allows, of a piece that is held at its cap and of one that ramps cross: for contours, and for
# chains of corners, where ramps need more of the room
SHARES = ((0.9, 0.6), (0.7, 0.4))
WINDOW = 400  # pieces
_KEPT = 0.6  # of the way of a window


class _Room(NamedTuple):
    """Bounds and caps of pieces, for one of `SHARES`."""

    most: np.ndarray
    caps: np.ndarray


class _Plan(NamedTuple):
    """Stretches from the present node on, and where each piece of the path begins there; the last is where they end."""

    begin: np.ndarray
    rows: np.ndarray


class Schedule:
    """Plans runs whose sections come one after the other.

    limits  of velocity .. snap of each axis, m/s .. m/s⁴, shape (N, 4)
    window  pieces that are planned at once; more where ramps are longer
    """

    def __init__(self, limits: np.ndarray, window: int = WINDOW) -> None:
        self._limits, self._window = np.ascontiguousarray(limits, float), window
        self._begin()

    def _begin(self) -> None:
        """At rest before a run."""
        self._pieces: Pieces | None = None  # from the present node on
        self._rooms: list[_Room] = []
        self._u, self._speed, self._wide = 0.0, 0.0, self._window  # u on the first of the pieces
        self._hand: _Plan | None = None  # the rest of the last plan, to its stop

    @property
    def rests(self) -> bool:
        """Whether the next section begins a run."""
        return self._pieces is None

    def add(self, section: Section) -> Iterator[Part]:
        """The parts of the motion that are fixed when this section is known: all, where the run ends."""
        self._append(section.pieces)
        while self._pieces is not None:
            n = len(self._pieces.length)
            last = min(n, self._wide)
            if last < self._wide and not section.ends:
                return
            found = self._planned(last, section.ends and last == n)
            if found is None:
                assert self._hand is not None  # from rest there is a plan
                yield self._go(self._hand, 1)
                continue
            if last == n and section.ends:
                part = _part(self._pieces, found.begin, found.rows, True)
                self._begin()
                yield part
                return
            found, count = _cut(found)
            if count:
                self._wide = self._window
                yield self._go(found, count)
            else:
                self._wide = 2 * last  # ramps are longer than the window

    def stop(self) -> Part | None:
        """From the end of the last part to the stop that is in hand; None at rest before a run."""
        if self._pieces is None or self._hand is None or not len(self._hand.rows):
            return None
        pieces = part_of_pieces(self._pieces, 0, len(self._hand.begin) - 1)
        return _part(pieces, self._hand.begin, self._hand.rows, True)

    def _append(self, pieces: Pieces) -> None:
        rooms = [_room(pieces, self._limits, shares) for shares in SHARES]
        if self._pieces is None:
            self._pieces, self._rooms = pieces, rooms
            return
        self._pieces = one_after_the_other([self._pieces, pieces])
        self._rooms = [
            _Room(*(np.concatenate(each) for each in zip(*both, strict=True)))
            for both in zip(self._rooms, rooms, strict=True)
        ]

    def _planned(self, last: int, ends: bool) -> _Plan | None:
        """The quickest plan to a stop at the end of so many pieces; None if the speed is too high for one."""
        assert self._pieces is not None
        begin = np.concatenate([[0.0], np.cumsum(self._pieces.length[:last])])
        stop = begin[-1] if ends else begin[-1] * (1.0 - MARGIN)
        size = 4 * last + 16
        found: list[np.ndarray] = []
        for room in self._rooms:
            rows = np.zeros((size, COLUMNS))
            given = room.most[:last], room.caps[:last]
            slow, stack = np.zeros(last, np.int64), np.zeros((size, COLUMNS))
            quick = self._rooms[0].caps[:last]
            count = plan(begin, *given, self._limits, quick, self._u, stop, self._speed, slow, stack, rows)
            if count:
                found.append(rows[:count])
        return _Plan(begin, min(found, key=_time)) if found else None

    def _go(self, found: _Plan, count: int) -> Part:
        """The first `count` stretches of a plan; the others are in hand."""
        assert self._pieces is not None
        kept, begin = found.rows[:count], found.begin
        pieces, node = self._pieces, float(kept[-1, 1])
        place = min(int(np.searchsorted(begin, node, side="right")) - 1, len(begin) - 2)
        if place + 1 < len(pieces.length) and node - begin[place] >= pieces.length[place]:
            place += 1  # at a joint, but for rounding
        self._u, self._speed = max(node - float(begin[place]), 0.0), float(kept[-1, 3])
        self._pieces = part_of_pieces(pieces, place, len(pieces.length))
        self._rooms = [_Room(room.most[place:], room.caps[place:]) for room in self._rooms]
        self._hand = _Plan(begin[place:], found.rows[count:])
        return _part(part_of_pieces(pieces, 0, place + 1), begin, kept, False)


def plan_run(pieces: Pieces, limits: np.ndarray, window: int = WINDOW) -> Motion:
    """The motion along a whole run; `limits` and `window` as of a `Schedule`."""
    motions, first = list[Motion](), 0
    for part in Schedule(limits, window).add(Section(pieces, True)):
        motions.append(part.motion._replace(piece=part.motion.piece + first))
        first += len(part.pieces.length) - 1  # where a part ends, the next one begins
    return Motion(*(np.concatenate(each) for each in zip(*motions, strict=True)))


def _room(pieces: Pieces, limits: np.ndarray, shares: tuple[float, float]) -> _Room:
    n = len(pieces.length)
    most, caps = np.zeros((n, len(limits), 4)), np.zeros((n, 2))
    pieces_room(pieces.kind, pieces.length, pieces.shape, pieces.feed, limits, *shares, most, caps)
    return _Room(most, caps)


def _time(rows: np.ndarray) -> float:
    """Of stretches, s."""
    u0, u1, v0, v1, peak = rows[:, :5].T
    up, down = rows[:, 5:8].sum(axis=1), rows[:, 8:11].sum(axis=1)
    way = u1 - u0 - 0.5 * (v0 + peak) * up - 0.5 * (v1 + peak) * down
    return float(np.sum(up + down + np.maximum(way, 0.0) / peak))


def _cut(found: _Plan) -> tuple[_Plan, int]:
    """How many stretches end in the first part of a window; a plateau is cut there in two."""
    rows, ends = found.rows, _KEPT * found.begin[-1]
    count = int(np.searchsorted(rows[:, 1], ends, side="right"))
    if count < len(rows):
        u0, u1, v0, v1, peak = rows[count, :5]
        low = u0 + 0.5 * (v0 + peak) * rows[count, 5:8].sum()
        high = u1 - 0.5 * (v1 + peak) * rows[count, 8:11].sum()
        cut = min(ends, high)
        if cut > low and cut > u0:
            one, two = rows[count].copy(), rows[count].copy()
            one[1], one[3], one[8:11] = cut, peak, 0.0
            two[0], two[2], two[5:8] = cut, peak, 0.0
            return found._replace(rows=np.vstack([rows[:count], one, two, rows[count + 1 :]])), count + 1
    return found, count


def _part(pieces: Pieces, begin: np.ndarray, rows: np.ndarray, ends: bool) -> Part:
    """In pieces of constant snap: two ramps of seven phases and a plateau for each stretch."""
    size = 15 * len(rows)
    room = Motion(np.zeros(size), np.zeros(size, np.int64), *(np.zeros(size) for _ in range(5)))
    count = timed(begin, np.ascontiguousarray(rows), len(rows), *room)
    return Part(pieces, Motion(*(each[:count].copy() for each in room)), ends)
