"""The motion along a whole run, from rest to rest, planned window by window.

Each window ends with a stop, so that there is always one in hand.  Of its plan the nodes in its first part are kept;
the next window goes on from the last of them.  If a slower path that comes into view asks for more than can be braked
from there, the plan before is followed to its next node, at the latest to its stop.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from feeddrive.path.motion import Motion
from feeddrive.path.pieces import Pieces
from feeddrive.path.schedule.plan import COLUMNS, plan, timed
from feeddrive.path.schedule.room import pieces_room

# shares of what curvature allows, of a piece that is held at its cap and of one that ramps cross: for contours, and for
# chains of corners, where ramps need more of the room
SHARES = ((0.9, 0.6), (0.7, 0.4))
WINDOW = 400  # pieces
_KEPT = 0.6  # of the way of a window


class _Room(NamedTuple):
    """Bounds and caps of all pieces, for one of `SHARES`."""

    most: np.ndarray
    caps: np.ndarray


class _Plan(NamedTuple):
    """Stretches of a window; u counts from the start of its first piece."""

    first: int
    begin: np.ndarray
    rows: np.ndarray


def plan_run(pieces: Pieces, limits: np.ndarray, window: int = WINDOW) -> Motion:
    """The motion along a run; `limits` of velocity .. snap, m/s .. m/s⁴, shape (N, 4), `window` in pieces."""
    parts = list(motions(pieces, np.ascontiguousarray(limits, float), window))
    return Motion(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def motions(pieces: Pieces, limits: np.ndarray, window: int) -> Iterator[Motion]:
    """The same, in parts, each as soon as it is fixed."""
    rooms = [_room(pieces, limits, shares) for shares in SHARES]
    n, first, u, speed, wide = len(pieces.length), 0, 0.0, 0.0, window
    before: _Plan | None = None  # what is left of the plan before
    while True:
        last = min(n, first + wide)
        found = _window(pieces, limits, rooms, first, last, u, speed)
        if found is None:
            assert before is not None  # from rest there is a plan
            yield _motion(before, before.rows[:1])
            done, left = before.rows[0], before.rows[1:]
            first, u, speed = _node(before, done)
            before = before._replace(rows=left)
            continue
        if last == n:
            yield _motion(found, found.rows)
            return
        kept, left = _kept(found)
        if not len(kept):
            wide *= 2  # ramps are longer than the window
            continue
        yield _motion(found, kept)
        first, u, speed = _node(found, kept[-1])
        before, wide = found._replace(rows=left), window


def _room(pieces: Pieces, limits: np.ndarray, shares: tuple[float, float]) -> _Room:
    n = len(pieces.length)
    most, caps = np.zeros((n, len(limits), 4)), np.zeros((n, 2))
    pieces_room(pieces.kind, pieces.length, pieces.shape, pieces.feed, limits, *shares, most, caps)
    return _Room(most, caps)


def _window(
    pieces: Pieces, limits: np.ndarray, rooms: list[_Room], first: int, last: int, u: float, speed: float
) -> _Plan | None:
    """The quickest plan to a stop at the end of a window; None if the speed is too high for one."""
    begin = np.concatenate([[0.0], np.cumsum(pieces.length[first:last])])
    size = 4 * (last - first) + 16
    found = []
    for room in rooms:
        rows = np.zeros((size, COLUMNS))
        given = room.most[first:last], room.caps[first:last]
        count = plan(begin, *given, limits, u, begin[-1], speed, 0.0, np.zeros((size, COLUMNS)), rows)
        if count:
            found.append(rows[:count])
    return _Plan(first, begin, min(found, key=_time)) if found else None


def _time(rows: np.ndarray) -> float:
    """Of stretches, s."""
    u0, u1, v0, v1, peak = rows[:, :5].T
    up, down = rows[:, 5:8].sum(axis=1), rows[:, 8:11].sum(axis=1)
    way = u1 - u0 - 0.5 * (v0 + peak) * up - 0.5 * (v1 + peak) * down
    return float(np.sum(up + down + np.maximum(way, 0.0) / peak))


def _kept(found: _Plan) -> tuple[np.ndarray, np.ndarray]:
    """The stretches that end in the first part of a window, and the rest; a plateau may be cut at its end."""
    ends = _KEPT * found.begin[-1]
    count = int(np.searchsorted(found.rows[:, 1], ends, side="right"))
    kept, left = found.rows[:count], found.rows[count:]
    if len(left):
        u0, u1, v0, v1, peak = left[0, :5]
        low = u0 + 0.5 * (v0 + peak) * left[0, 5:8].sum()
        high = u1 - 0.5 * (v1 + peak) * left[0, 8:11].sum()
        cut = min(ends, high)
        if cut > low and cut > u0:
            one, two = left[0].copy(), left[0].copy()
            one[1], one[3], one[8:11] = cut, peak, 0.0
            two[0], two[2], two[5:8] = cut, peak, 0.0
            return np.vstack([kept, one]), np.vstack([two, left[1:]])
    return kept, left


def _node(found: _Plan, row: np.ndarray) -> tuple[int, float, float]:
    """Where a stretch ends: index of the piece, u from its start, speed."""
    place = int(np.searchsorted(found.begin, row[1], side="right")) - 1
    place = min(place, len(found.begin) - 2)
    return found.first + place, float(row[1] - found.begin[place]), float(row[3])


def _motion(found: _Plan, rows: np.ndarray) -> Motion:
    """In pieces of constant snap: two ramps of seven phases and a plateau for each stretch."""
    size = 15 * len(rows)
    room = Motion(np.zeros(size), np.zeros(size, np.int64), *(np.zeros(size) for _ in range(5)))
    count = timed(found.begin, np.ascontiguousarray(rows), len(rows), *room)
    motion = Motion(*(each[:count] for each in room))
    return motion._replace(piece=motion.piece + found.first)
