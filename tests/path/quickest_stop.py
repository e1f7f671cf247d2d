"""A reference for a hold: the quickest stop from a state of a motion, by direct transcription.

It has finer spans than the planner's and none of its reserve: u'''' is constant on each of 40 spans of a time T; the
smallest T at which u' .. u''' can be brought from their values at the hold to 0, with velocity to snap of each axis
within the limits at the ends of all spans, is found by bisection.  A try is a sequence of linear programs about the
last motion.  Limits are kept at these points only, so that T is a little below the quickest time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linprog

from feeddrive.path.motion import (
    Part,
    Pause,
    Pieces,
    cubic,
    derivatives,
    one_after_the_other,
    part_of_pieces,
    piece_of,
    way,
)

SPANS, TRIES, HALVINGS, FEASIBLE = 40, 5, 6, 1.003


def lasts(part: Part | Pause) -> float:
    return float(np.sum(part.motion.duration)) if isinstance(part, Part) else part.duration


def state_at(parts: Sequence[Part | Pause], at: float) -> tuple[Pieces, np.ndarray] | None:
    """Return the rest of the run from a time on and u .. u''' there, or None at rest or within a corner in time."""
    for k, part in enumerate(parts):
        if at >= lasts(part):
            at -= lasts(part)
            continue
        if isinstance(part, Pause) or part.entering is not None:
            return None
        begins = np.cumsum(part.motion.duration) - part.motion.duration
        m = int(np.searchsorted(begins, at, side="right")) - 1
        t, (x, v, a, j, s) = at - float(begins[m]), (float(column[m]) for column in part.motion[2:])
        p = int(part.motion.piece[m])
        ahead = [part_of_pieces(part.pieces, p, len(part.pieces.length))]
        for later in parts[k + 1 :]:
            if part.ends:
                break
            assert isinstance(later, Part)  # it does not rest before the run ends
            ahead.append(part_of_pieces(later.pieces, 1, len(later.pieces.length)))
            part = later
        state = [x + way(v, a, j, s, t), cubic(v, a, j, s, t), a + t * (j + t * s / 2), j + t * s]
        return one_after_the_other(ahead), np.array(state)
    return None


def along(pieces: Pieces, u: np.ndarray) -> np.ndarray:
    """Derivatives of the path at u, shape (n, N, 5)."""
    ends = np.cumsum(pieces.length)
    out, row = np.zeros((len(u), pieces.origin.shape[1], 5)), np.zeros((pieces.origin.shape[1], 5))
    for k, each in enumerate(u):
        p = min(int(np.searchsorted(ends, each)), len(ends) - 1)
        x = min(max(each - (ends[p] - pieces.length[p]), 0.0), float(pieces.length[p]))
        derivatives(*piece_of(pieces, p), x, row)
        out[k] = row
    return out


class _Stop:
    """Stops in a time T from a state along pieces: all of u .. u''' at the ends of spans are linear in the snaps."""

    def __init__(self, pieces: Pieces, limits: np.ndarray, state: np.ndarray, T: float) -> None:
        h, n = T / SPANS, SPANS
        self.pieces, self.limits = pieces, limits
        step = np.array([[1, h, h * h / 2, h**3 / 6], [0, 1, h, h * h / 2], [0, 0, 1, h], [0, 0, 0, 1]])
        snap = np.array([h**4 / 24, h**3 / 6, h * h / 2, h])
        self.constant, self.slope = np.zeros((n + 1, 4)), np.zeros((n + 1, 4, n))
        self.constant[0] = state
        for k in range(n):
            self.constant[k + 1] = step @ self.constant[k]
            self.slope[k + 1] = step @ self.slope[k]
            self.slope[k + 1, :, k] += snap

    def shares(self, snaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the use of each limit at both ends of each span, and its slopes by the snaps."""
        states = self.constant + self.slope @ snaps
        values, slopes = [], []
        n = SPANS
        rows = np.concatenate([np.arange(n), np.arange(1, n + 1)])
        spans = np.concatenate([np.arange(n), np.arange(n)])
        r = along(self.pieces, states[:, 0])[rows]
        v, a, j = (each[:, None] for each in states[rows].T[1:])
        s = snaps[spans][:, None]
        r1, r2, r3, r4 = (r[:, :, k] for k in range(1, 5))
        du, dv, da, dj = (self.slope[rows, k][:, None, :] for k in range(4))
        ds = np.eye(n)[spans][:, None, :]

        def add(value: np.ndarray, limit: np.ndarray, *parts: tuple[np.ndarray, np.ndarray]) -> None:
            values.append((value / limit).ravel())
            slopes.append(
                (sum(factor[:, :, None] * each for factor, each in parts) / limit[None, :, None]).reshape(-1, n)
            )

        V, A, J, S = self.limits.T
        add(r1 * v, V, (r2 * v, du), (r1, dv))
        add(r2 * v * v + r1 * a, A, (r3 * v * v + r2 * a, du), (2 * r2 * v, dv), (r1, da))
        add(
            r3 * v**3 + 3 * r2 * v * a + r1 * j,
            J,
            (r4 * v**3 + 3 * r3 * v * a + r2 * j, du),
            (3 * r3 * v * v + 3 * r2 * a, dv),
            (3 * r2 * v, da),
            (r1, dj),
        )
        add(
            r4 * v**4 + 6 * r3 * v * v * a + r2 * (3 * a * a + 4 * v * j) + r1 * s,
            S,
            (6 * r4 * v * v * a + r3 * (3 * a * a + 4 * v * j) + r2 * s, du),
            (4 * r4 * v**3 + 12 * r3 * v * a + 4 * r2 * j, dv),
            (6 * r3 * v * v + 6 * r2 * a, da),
            (4 * r2 * v, dj),
            (r1, ds),
        )
        return np.concatenate(values), np.concatenate(slopes)

    def possible(self) -> bool:
        """True if the linear programs come to a stop within the limits."""
        n, top = SPANS, float(self.limits[:, 3].max()) * 1.8
        snaps = np.zeros(n)
        # any stop to begin with: the one of least squares
        equal = self.slope[-1, 1:]
        snaps = np.linalg.lstsq(equal, -self.constant[-1, 1:], rcond=None)[0]
        scale = np.max(np.abs(equal), axis=1)
        way_left = float(np.sum(self.pieces.length))
        for k in range(TRIES):
            values, slopes = self.shares(snaps)
            change = slopes * top
            offset = values - slopes @ snaps
            backward = -self.slope[:, 1] * top
            beyond = self.slope[-1:, 0] * top / way_left
            rows = np.vstack(
                [
                    np.column_stack([change, -np.ones(len(values))]),
                    np.column_stack([-change, -np.ones(len(values))]),
                    np.column_stack([backward, np.zeros(n + 1)]),
                    np.column_stack([beyond, np.zeros(1)]),
                ]
            )
            right = np.concatenate([-offset, offset, self.constant[:, 1], [1.0 - self.constant[-1, 0] / way_left]])
            trust = 2.0 if k == 0 else 1.0 * 0.6**k
            now = snaps / top
            found = linprog(
                np.append(np.zeros(n), 1.0),
                rows,
                right,
                np.column_stack([equal * top / (scale[:, None] * top), np.zeros(3)]),
                -self.constant[-1, 1:] / (scale * top),
                [*((max(-1.0, x - trust), min(1.0, x + trust)) for x in np.clip(now, -1, 1)), (0.0, None)],
            )
            if found.x is None:
                return False
            snaps = found.x[:n] * top
            if found.x[n] > 1.3 and k:
                return False
            if float(np.max(np.abs(self.shares(snaps)[0]))) <= FEASIBLE:
                return True
        return False


def quickest(pieces: Pieces, limits: np.ndarray, state: np.ndarray, at_most: float) -> float:
    """Return the time of the quickest stop, s, or infinity if none is found that is as quick as `at_most`."""
    low, high = 0.5 * at_most, at_most * 1.02
    if not _Stop(pieces, limits, state, high).possible():
        return np.inf
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _Stop(pieces, limits, state, middle).possible():
            high = middle
        else:
            low = middle
    return high
