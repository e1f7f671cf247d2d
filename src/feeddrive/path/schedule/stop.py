"""The quickest stop on a curved path, by direct transcription.

u'''' is constant on each of n equal spans of a time T, so that u .. u''' at any time are linear in the snaps.  The
limits of the axes, linear about the last motion, are imposed at three points of each span; a sequence of linear
programs finds snaps that bring u' .. u''' to 0 with the least excess of any limit.  T is found by bisection.
"""

from __future__ import annotations

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Records, Records2, rows_for
from feeddrive.path.motion import Derivatives, Motion, Pieces, derivatives
from feeddrive.path.proof import faults_of
from feeddrive.path.schedule.brake import Moving

_SPANS = 24
_PARTS = (0.0, 0.5, 1.0)  # of a span: the points
_AIMS = (0.985, 0.95, 0.9)  # utilization of the limits there: less where the proof fails between them
_STARTS = 0.2  # of T in which that of velocity to jerk falls to this from 1, which the present state may use
_HALVINGS = 7
_PROGRAMS = 4  # largest number of linear programs for a time
_LOOKED = 0.5  # utilization above which a limit of velocity is part of a program
_LEAST, _LONGER = 0.45, 1.6  # of the known time: the bisection begins there, and ends there if it is not proven


@kernel
def _along(pieces: Pieces, u: Floats, out: Records2[Derivatives], r: Records[Derivatives]) -> int:
    """Write r .. r'''' at each u, which increase, into `out` (n, N)."""
    p = 0
    begin = 0.0
    last = len(pieces.length) - 1
    for k in range(len(u)):
        while u[k] > begin + pieces.length[p] and p < last:
            begin = begin + pieces.length[p]
            p = p + 1
        x = min(max(u[k] - begin, 0.0), pieces.length[p])
        derivatives(pieces.kind[p], pieces.length[p], pieces.shape[p], x, r)
        for i in range(len(r)):
            out[k, i] = r[i]
    return 0


class _Transcribed:
    """The motions from a state within a time T, s, as functions of the snaps of all spans in units of `unit`."""

    def __init__(self, pieces: Pieces, state: Moving, limits: np.ndarray, T: float, aim: float, unit: float) -> None:
        n, h = _SPANS, T / _SPANS
        self._pieces, self._limits, self._h, self._unit, self._aim = pieces, limits, h, unit, aim
        constant, slope = np.array(state), np.zeros((4, n))
        states = list[tuple[np.ndarray, np.ndarray]]()
        self._span = np.repeat(np.arange(n), len(_PARTS))
        for k in range(n):
            states += [_later(constant, slope, k, part * h, unit) for part in _PARTS]
            constant, slope = states[-1]
        self.constant, self.slope = (np.array(each) for each in zip(*states, strict=True))
        self.end = constant[1:], slope[1:]
        at = np.arange(n)[:, None] * h + np.array(_PARTS) * h
        self._most = 1.0 - (1.0 - aim) * np.minimum(at.ravel() / (_STARTS * T), 1.0)

    def at_rest(self, snaps: np.ndarray) -> np.ndarray:
        """Return the nearest snaps at which the motion ends at rest."""
        constant, slope = self.end
        size = np.linalg.norm(slope, axis=1)
        for _ in range(2):
            missed = (constant + slope @ snaps) / size
            snaps = snaps - np.linalg.lstsq(slope / size[:, None], missed, rcond=None)[0]
        return snaps

    def shares(self, snaps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the utilization of all limits relative to the aim, the index of the point of each, and the slopes by
        u .. u'''' there.
        """
        states = self.constant + self.slope @ snaps
        axes = len(self._limits)
        out = np.zeros((len(states), axes, 5))
        _along(self._pieces, np.maximum.accumulate(states[:, 0]), out, rows_for(Derivatives, axes))
        v, a, j = (each[:, None] for each in states.T[1:])
        s = (snaps * self._unit)[self._span][:, None]
        _, r1, r2, r3, r4 = np.moveaxis(out, 2, 0)
        nothing = np.zeros_like(r1)
        most = self._most[:, None]
        V, A, J = (limit * most for limit in self._limits.T[:3])
        S = self._limits[:, 3] * self._aim
        values = [r1 * v / V, (r2 * v * v + r1 * a) / A, (r3 * v**3 + 3.0 * r2 * v * a + r1 * j) / J]
        bend = 3.0 * a * a + 4.0 * v * j
        values.append((r4 * v**4 + 6.0 * r3 * v * v * a + r2 * bend + r1 * s) / S)
        slopes = [
            [r2 * v / V, r1 / V, nothing, nothing, nothing],
            [(r3 * v * v + r2 * a) / A, 2.0 * r2 * v / A, r1 / A, nothing, nothing],
            [
                (r4 * v**3 + 3.0 * r3 * v * a + r2 * j) / J,
                (3.0 * r3 * v * v + 3.0 * r2 * a) / J,
                3.0 * r2 * v / J,
                r1 / J,
                nothing,
            ],
            [
                (6.0 * r4 * v * v * a + r3 * bend + r2 * s) / S,
                (4.0 * r4 * v**3 + 12.0 * r3 * v * a + 4.0 * r2 * j) / S,
                (6.0 * r3 * v * v + 6.0 * r2 * a) / S,
                4.0 * r2 * v / S,
                r1 / S,
            ],
        ]
        value = np.stack(values, axis=2)
        # the present velocity to jerk are as they are
        value[0, :, :3] = 0.0
        point = np.broadcast_to(np.arange(len(states))[:, None, None], value.shape)
        slope = np.stack([np.stack(each, axis=2) for each in slopes], axis=2)
        return value.ravel(), point.ravel(), slope.reshape(-1, 5)

    def stop(self, snaps: np.ndarray) -> np.ndarray | None:
        """Return the snaps of a stop that keeps all limits, starting the search from others, or None."""
        # imported here: only a hold needs it
        from scipy.optimize import linprog

        n = _SPANS
        constant, slope = self.end
        size = np.linalg.norm(slope, axis=1)
        snaps = self.at_rest(snaps)
        length = float(np.sum(self._pieces.length))
        for number in range(_PROGRAMS):
            value, point, by_state = self.shares(snaps)
            states = self.constant + self.slope @ snaps
            if (
                np.max(np.abs(value)) <= 1.0
                and np.min(states[:, 1]) >= -1e-12 * states[0, 1]
                and states[-1, 0] <= length
            ):
                return snaps
            near = np.any(by_state[:, 2:] != 0.0, axis=1) | (np.abs(value) > _LOOKED)
            rows = np.einsum("ck,ckn->cn", by_state[near][:, :4], self.slope[point[near]])
            rows[np.arange(len(rows)), self._span[point[near]]] += by_state[near][:, 4] * self._unit
            offset = value[near] - rows @ snaps
            rows, offset = np.vstack([rows, -rows]), np.append(offset, -offset)
            # excess over the limits as the last unknown; the motion goes forward, and stays on the path
            matrix = np.vstack(
                [
                    np.column_stack([rows, -np.ones(len(rows))]),
                    np.column_stack([-self.slope[:, 1] / states[0, 1], np.zeros(len(states))]),
                    np.append(self.slope[-1, 0] / length, 0.0)[None],
                ]
            )
            right = np.concatenate([-offset, self.constant[:, 1] / states[0, 1], [1.0 - self.constant[-1, 0] / length]])
            found = linprog(
                np.append(np.zeros(n), 1.0),
                matrix,
                right,
                np.column_stack([slope / size[:, None], np.zeros(3)]),
                -constant / size,
                [*((-_WIDEST, _WIDEST) for _ in range(n)), (_EASY, None)],
            )
            if found.x is None or (number and found.x[n] > _HOPELESS):
                return None
            snaps = self.at_rest(found.x[:n])
        return None

    def motion(self, snaps: np.ndarray) -> Motion:
        """Return the motion with these snaps."""
        n = _SPANS
        u, v, a, j = (self.constant + self.slope @ snaps)[:: len(_PARTS)].T
        joints = np.concatenate([[0.0], np.cumsum(self._pieces.length)])
        piece = np.clip(np.searchsorted(joints, u, side="right") - 1, 0, len(joints) - 2)
        return Motion(np.full(n, self._h), piece, u - joints[piece], v.copy(), a.copy(), j.copy(), snaps * self._unit)


_WIDEST = 1.8  # of the unit: largest snap, in a direction between the axes
_EASY = 0.95  # of the aim: a program need not do better
_HOPELESS = 1.005  # of the aim: a time at which the second program finds nothing better is given up


def _later(constant: np.ndarray, slope: np.ndarray, k: int, t: float, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return u .. u''' a time t into span k from those at its start."""
    step = np.array(
        [[1.0, t, t * t / 2.0, t**3 / 6.0], [0.0, 1.0, t, t * t / 2.0], [0.0, 0.0, 1.0, t], [0.0, 0.0, 0.0, 1.0]]
    )
    slope = step @ slope
    slope[:, k] += unit * np.array([t**4 / 24.0, t**3 / 6.0, t * t / 2.0, t])
    return step @ constant, slope


def _shape(motion: Motion, T: float, unit: float) -> np.ndarray:
    """Return the mean snap of a motion on each span of its time, which is scaled to T."""
    ends = np.concatenate([[0.0], np.cumsum(motion.duration)])
    changes = np.interp(
        np.linspace(0.0, ends[-1], _SPANS + 1), ends, np.concatenate([[0.0], np.cumsum(motion.duration * motion.snap)])
    )
    ratio = float(ends[-1]) / T
    return np.diff(changes) * _SPANS / T * ratio * ratio / unit


def quickest_stop(pieces: Pieces, state: Moving, like: Motion, known: bool, limits: np.ndarray) -> Motion | None:
    """Return a proven stop from a state on the first of these pieces.

    like    a stop of similar shape, to begin the search with; it lasts longer than the one to be found
    known   True if that stop is proven; it is returned if no quicker one is found
    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    """
    unit, most = float(np.max(limits[:, 3])), float(like.duration.sum())
    for aim in _AIMS:
        low, high = _LEAST * most, most if known else _LONGER * most
        snaps, best = _shape(like, high, unit), None
        for halving in range(_HALVINGS):
            T = 0.5 * (low + high) if halving or known else high
            tried = _Transcribed(pieces, state, limits, T, aim, unit)
            found = tried.stop(snaps)
            if found is None:
                low = T
                if not halving and not known:
                    break
            else:
                high, snaps, best = T, found, tried.motion(found)
        if best is not None and not len(faults_of(pieces, best, limits)):
            return best
    return like if known else None
