"""The quickest stop on a curved path, by direct transcription.

u'''' is constant on each of n equal spans of a time T, so that u .. u''' at any time are linear in the snaps.  The
limits of the axes, linear about the last motion, are imposed at three points of each span; a sequence of linear
programs finds snaps that bring u' .. u''' to 0 with the least excess of any limit.  T is found by bisection.
"""

from __future__ import annotations

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Records, Records2, rows_for
from feeddrive.path.motion import Derivatives, Limits, Motion, Pieces, derivatives
from feeddrive.path.proof import faults_of
from feeddrive.path.schedule.brake import Moving

_SPANS = 24
_PARTS = (0.0, 0.5, 1.0)  # of a span: the points; there are more where the proof fails
_AIM = 0.985  # utilization of the limits there
_TIGHTER = 0.97  # reduction of a limit in the spans in which the proof fails between the points, and beside them
_ROUNDS = 10  # largest number of proofs
_SLOWER = 1.006  # ratio of the times of two of them
_STARTS = 0.2  # of T in which that of velocity to jerk falls to this from 1, which the present state may use
_HALVINGS = 7
_SHORTEST = 0.05  # of the step of a program: a shorter one is taken although it makes the excess larger
_PROGRAMS = 6  # largest number of linear programs for a time
_LOOKED = 0.5  # utilization above which a limit of velocity is part of a program
_LEAST = 0.45  # of the time of a proven stop: the lower end of the bisection
_LONGER = (1.0, 1.15, 1.3, 1.5, 1.75, 2.1)  # of the time of a stop that is not proven: times that are tried


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

    def __init__(
        self,
        pieces: Pieces,
        state: Moving,
        limits: np.ndarray,
        T: float,
        points: list[tuple[int, float]],
        aims: np.ndarray,
        unit: float,
    ) -> None:
        n, h = _SPANS, T / _SPANS
        self._pieces, self._h, self._unit = pieces, h, unit
        begins = [(np.array(state), np.zeros((4, n)))]
        for k in range(n):
            begins.append(_later(*begins[-1], k, h, unit))
        self.begins = begins
        points = sorted(points)
        states = [_later(*begins[k], k, part * h, unit) for k, part in points]
        self._span = np.array([k for k, _ in points])
        self.constant, self.slope = (np.array(each) for each in zip(*states, strict=True))
        self.end = begins[-1][0][1:], begins[-1][1][1:]
        at = h * np.sum(points, axis=1)
        part = np.minimum(at / (_STARTS * T), 1.0)[:, None, None]
        most = 1.0 - (1.0 - aims[self._span]) * np.where(np.arange(4) < 3, part, 1.0)
        self._limits = np.moveaxis(limits * most, 2, 0)

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
        axes = self._limits.shape[2]
        out = np.zeros((len(states), axes, 5))
        _along(self._pieces, np.maximum.accumulate(states[:, 0]), out, rows_for(Derivatives, axes))
        v, a, j = (each[:, None] for each in states.T[1:])
        s = (snaps * self._unit)[self._span][:, None]
        _, r1, r2, r3, r4 = np.moveaxis(out, 2, 0)
        nothing = np.zeros_like(r1)
        V, A, J, S = self._limits
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
            if found.x is None or (number >= 2 and found.x[n] > _HOPELESS):
                return None
            new, largest = self.at_rest(found.x[:n]), float(np.max(np.abs(value)))
            step = 1.0
            while step > _SHORTEST:
                if np.max(np.abs(self.shares(snaps + step * (new - snaps))[0])) <= max(largest, 1.0):
                    break
                step *= 0.4
            snaps = snaps + step * (new - snaps)
        return None

    def motion(self, snaps: np.ndarray) -> Motion:
        """Return the motion with these snaps."""
        n = _SPANS
        u, v, a, j = np.array([constant + slope @ snaps for constant, slope in self.begins[:-1]]).T
        joints = np.concatenate([[0.0], np.cumsum(self._pieces.length)])
        piece = np.clip(np.searchsorted(joints, u, side="right") - 1, 0, len(joints) - 2)
        return Motion(np.full(n, self._h), piece, u - joints[piece], v.copy(), a.copy(), j.copy(), snaps * self._unit)


_WIDEST = 1.8  # of the unit: largest snap, in a direction between the axes
_EASY = 0.95  # of the aim: a program need not do better
_HOPELESS = 1.005  # of the aim: a time at which the third program finds nothing better is given up


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
    aims = np.full((_SPANS, *limits.shape), _AIM)
    points = [(k, part) for k in range(_SPANS) for part in _PARTS]

    def at(T: float, snaps: np.ndarray) -> tuple[_Transcribed, np.ndarray | None]:
        tried = _Transcribed(pieces, state, limits, T, points, aims, unit)
        return tried, tried.stop(snaps)

    low, high, snaps = _LEAST * most, most, None
    for longer in () if known else _LONGER:
        _, snaps = at(longer * most, _shape(like, longer * most, unit))
        if snaps is not None:
            high = longer * most
            break
        low = longer * most
    if not known and snaps is None:
        return None
    best = snaps
    snaps = _shape(like, high, unit) if snaps is None else snaps
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        _, found = at(middle, snaps)
        if found is None:
            low = middle
        else:
            high, snaps, best = middle, found, found
    for _ in range(_ROUNDS if best is not None else 0):
        tried, found = at(high, snaps)
        if found is not None:
            snaps, motion = found, tried.motion(found)
            faults = faults_of(pieces, motion, limits)
            if not len(faults):
                return motion
            for _, where, t, which, _ in faults:
                if which < -1:  # a jump or a backward motion, which lower limits would not remove
                    return like if known else None
                axis, number = divmod(int(which), len(Limits._fields)) if which >= 0 else (slice(None), 0)
                aims[max(int(where) - 1, 0) : int(where) + 2, axis, number] *= _TIGHTER
                points.append((int(where), float(t) * _SPANS / high))
        high *= _SLOWER
        if known and high >= most:
            break
    return like if known else None
