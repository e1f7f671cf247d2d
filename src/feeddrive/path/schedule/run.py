"""The motion along a whole run, from rest to rest."""

from __future__ import annotations

import numpy as np

from feeddrive.path.motion import Motion
from feeddrive.path.pieces import Pieces
from feeddrive.path.schedule.plan import COLUMNS, plan, timed
from feeddrive.path.schedule.room import pieces_room

# shares of what curvature allows, of a piece that is held at its cap and of one that ramps cross: for contours, and for
# chains of corners, where ramps need more of the room
SHARES = ((0.9, 0.6), (0.7, 0.4))


def plan_run(pieces: Pieces, limits: np.ndarray) -> Motion:
    """The quicker motion of those with either of `SHARES`; `limits` of velocity .. snap, m/s .. m/s⁴, shape (N, 4)."""
    limits = np.ascontiguousarray(limits, float)
    begin = np.concatenate([[0.0], np.cumsum(pieces.length)])
    plans = [_stretches(pieces, limits, begin, shares) for shares in SHARES]
    found = [_motion(begin, rows) for rows in plans if len(rows)]
    return min(found, key=lambda motion: float(np.sum(motion.duration)))


def _stretches(pieces: Pieces, limits: np.ndarray, begin: np.ndarray, shares: tuple[float, float]) -> np.ndarray:
    n = len(pieces.length)
    most, caps = np.zeros((n, len(limits), 4)), np.zeros((n, 2))
    pieces_room(pieces.kind, pieces.length, pieces.shape, pieces.feed, limits, *shares, most, caps)
    rows, stack = np.zeros((4 * n + 16, COLUMNS)), np.zeros((4 * n + 16, COLUMNS))
    return rows[: plan(begin, most, caps, limits, 0.0, begin[-1], 0.0, 0.0, stack, rows)]


def _motion(begin: np.ndarray, rows: np.ndarray) -> Motion:
    size = 15 * len(rows)  # two ramps of seven phases and a plateau
    room = Motion(np.zeros(size), np.zeros(size, np.int64), *(np.zeros(size) for _ in range(5)))
    count = timed(begin, rows, len(rows), *room)
    return Motion(*(each[:count] for each in room))
