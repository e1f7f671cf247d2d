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

_SPANS = 24  # least number of spans
_MOST = 96  # largest one
_A_PHASE = 1.0  # number of spans in the time j/s of the axes
_HARD = 1.4  # ratio of T and the time on a straight path, above which spans are half as long
# share of the fall of the utilization that a longer T promises, below which they are half as long, too
_STUCK = 0.3
_FINER = 1.25  # smallest factor by which their number grows with T
_PARTS = (0.0, 0.5, 1.0)  # of a span: the points; there are more where the proof fails
_AIM = 0.996  # utilization of the limits there
_TIGHTER = 0.97  # reduction of a limit in the spans in which the proof fails between the points, and beside them
_ROUNDS = 14  # largest number of proofs
_SLOWER = 1.006  # least ratio of the times of two of them
_STARTS = 0.2  # of T in which that of velocity to jerk falls to this from 1, which the present state may use
_HALVINGS = 3
_SHORTEST = 0.05  # of the step of a program: a shorter one is taken although it makes the excess larger
_SHORTER = 0.4  # of such a step: the next one
_PROGRAMS = 6  # largest number of linear programs for a time
_LOOKED = 0.5  # utilization above which a limit of velocity is part of a program
_LONGEST = 3.0  # of the time on a straight path: longer stops are not looked for
_POWER = 0.35  # a time is multiplied by this power of the utilization that it needs
_LITTLE = 1.03  # smallest such factor
_MUCH = 1.15  # largest one
_WIDEST = 1.8  # of the unit: largest snap, in a direction between the axes
_EASY = 0.95  # of the aim: a program need not do better
_PROGRESS = 0.9  # of an excess over the aim: a program that leaves more is the last one for a time
_BACK = 1e-12  # of the present speed: rounding of a speed of 0


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
        n = len(aims)
        h = T / n
        self._pieces, self._h, self._unit = pieces, h, unit
        begins = [(np.array(state), np.zeros((4, n)))]
        for k in range(n):
            begins.append(_later(*begins[-1], k, h, unit))
        self._begins = begins
        points = sorted(points)
        states = [_later(*begins[k], k, part * h, unit) for k, part in points]
        self._span = np.array([k for k, _ in points])
        self.constant, self.slope = (np.array(each) for each in zip(*states, strict=True))
        last, by_snaps = begins[-1]
        self.end = last[1:], by_snaps[1:]
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
        _, n, axes = self._limits.shape
        u, *higher = states.T
        out = np.zeros((n, axes, 5))
        _along(self._pieces, np.maximum.accumulate(u), out, rows_for(Derivatives, axes))
        v, a, j = (each[:, None] for each in higher)
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
        value[0][:, :3] = 0.0
        point = np.broadcast_to(np.arange(n)[:, None, None], value.shape)
        slope = np.stack([np.stack(each, axis=2) for each in slopes], axis=2)
        return value.ravel(), point.ravel(), slope.reshape(-1, 5)

    def least(self, snaps: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the snaps of a stop with little excess over the limits, starting the search from others, and the
        largest utilization of a limit relative to the aim: up to 1 if all are kept.
        """
        # imported here: only a hold needs it
        from scipy.optimize import linprog

        constant, slope = self.end
        _, n = slope.shape
        u0, v0, _, _ = self.constant.T
        by_u, by_v, _, _ = np.moveaxis(self.slope, 1, 0)
        size = np.linalg.norm(slope, axis=1)
        snaps = self.at_rest(snaps)
        length = float(np.sum(self._pieces.length))
        last = np.inf
        for _ in range(_PROGRAMS):
            value, point, by_state = self.shares(snaps)
            u, v = u0 + by_u @ snaps, v0 + by_v @ snaps
            largest = float(np.max(np.abs(value)))
            stays = np.min(v) >= -_BACK * v[0] and u[-1] <= length
            if stays and (largest <= 1.0 or largest - 1.0 > _PROGRESS * (last - 1.0)):
                return snaps, largest
            last = largest
            near = np.any(by_state[:, 2:] != 0.0, axis=1) | (np.abs(value) > _LOOKED)
            *_, by_snap = by_state[near].T
            rows = np.einsum("ck,ckn->cn", by_state[near][:, :-1], self.slope[point[near]])
            rows[np.arange(len(rows)), self._span[point[near]]] += by_snap * self._unit
            offset = value[near] - rows @ snaps
            rows, offset = np.vstack([rows, -rows]), np.append(offset, -offset)
            # excess over the limits as the last unknown; the motion goes forward, and stays on the path
            matrix = np.vstack(
                [
                    np.column_stack([rows, -np.ones(len(rows))]),
                    np.column_stack([-by_v / v[0], np.zeros(len(v))]),
                    np.append(by_u[-1] / length, 0.0)[None],
                ]
            )
            right = np.concatenate([-offset, v0 / v[0], [1.0 - u0[-1] / length]])
            found = linprog(
                np.append(np.zeros(n), 1.0),
                matrix,
                right,
                np.column_stack([slope / size[:, None], np.zeros(3)]),
                -constant / size,
                [*((-_WIDEST, _WIDEST) for _ in range(n)), (_EASY, None)],
            )
            if found.x is None:
                break
            new, step = self.at_rest(found.x[:n]), 1.0
            while step > _SHORTEST:
                if np.max(np.abs(self.shares(snaps + step * (new - snaps))[0])) <= max(largest, 1.0):
                    break
                step *= _SHORTER
            snaps = snaps + step * (new - snaps)
        return snaps, np.inf

    def motion(self, snaps: np.ndarray) -> Motion:
        """Return the motion with these snaps."""
        n = len(snaps)
        u, v, a, j = np.array([constant + slope @ snaps for constant, slope in self._begins[:-1]]).T
        joints = np.concatenate([[0.0], np.cumsum(self._pieces.length)])
        piece = np.clip(np.searchsorted(joints, u, side="right") - 1, 0, len(joints) - 2)
        return Motion(np.full(n, self._h), piece, u - joints[piece], v.copy(), a.copy(), j.copy(), snaps * self._unit)


def _later(constant: np.ndarray, slope: np.ndarray, k: int, t: float, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Return u .. u''' a time t into span k from those at its start."""
    step = np.array(
        [[1.0, t, t * t / 2.0, t**3 / 6.0], [0.0, 1.0, t, t * t / 2.0], [0.0, 0.0, 1.0, t], [0.0, 0.0, 0.0, 1.0]]
    )
    slope = step @ slope
    slope[:, k] += unit * np.array([t**4 / 24.0, t**3 / 6.0, t * t / 2.0, t])
    return step @ constant, slope


def _shape(motion: Motion, n: int, T: float, unit: float) -> np.ndarray:
    """Return the mean snap of a motion on each of n spans of its time, which is scaled to T."""
    ends = np.concatenate([[0.0], np.cumsum(motion.duration)])
    changes = np.interp(
        np.linspace(0.0, ends[-1], n + 1), ends, np.concatenate([[0.0], np.cumsum(motion.duration * motion.snap)])
    )
    ratio = float(ends[-1]) / T
    return np.diff(changes) * n / T * ratio * ratio / unit


def _points(n: int) -> list[tuple[int, float]]:
    """Return the points of n spans: span, and part of it."""
    return [(k, part) for k in range(n) for part in _PARTS]


def _regridded(snaps: np.ndarray, n: int) -> np.ndarray:
    """Return the mean snap on each of n spans of the same time."""
    changes = np.concatenate([[0.0], np.cumsum(snaps)]) / len(snaps)
    return np.diff(np.interp(np.linspace(0.0, 1.0, n + 1), np.linspace(0.0, 1.0, len(snaps) + 1), changes)) * n


def quickest_stop(
    pieces: Pieces, state: Moving, straight: Motion, known: Motion | None, limits: np.ndarray
) -> Motion | None:
    """Return a proven stop from a state on the first of these pieces, or the known one if no quicker one is found.

    straight  the stop on a straight path, to begin with
    limits    limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4); where one is infinite, the known stop
              is returned
    """
    if not np.all(np.isfinite(limits)):
        return known
    _, _, jerk, snap = limits.T
    unit, lasts = float(np.max(snap)), float(straight.duration.sum())
    longest = _LONGEST * lasts if known is None else float(known.duration.sum())
    aims, points = np.zeros((0, *limits.shape)), list[tuple[int, float]]()

    def at(lasts: float, snaps: np.ndarray) -> tuple[_Transcribed, np.ndarray, float]:
        tried = _Transcribed(pieces, state, limits, lasts, points, aims, unit)
        return tried, *tried.least(snaps)

    # longer and longer, each begun with the last one: the path taken changes little
    low, snaps, use = 0.0, np.zeros(0), np.inf
    hard = False
    while longest > lasts:
        # where a stop takes much longer than on a straight path, or where more time does not help, the path turns
        # faster than such spans can follow
        hard = hard or lasts > _HARD * straight.duration.sum()
        n = int((2.0 if hard else 1.0) * _A_PHASE * lasts / np.max(jerk / snap))
        n = min(max(_SPANS, n), _MOST)
        if n > _FINER * len(aims):
            aims, points = np.full((n, *limits.shape), _AIM), _points(n)
            snaps = _regridded(snaps, n) if len(snaps) else _shape(straight, n, lasts, unit)
        before, (_, snaps, use) = use, at(lasts, snaps)
        if use <= 1.0:
            break
        promised = before * (low / lasts) ** (1.0 / _POWER) if low else 0.0
        hard = hard or (low > 0.0 and before - use < _STUCK * (before - promised))
        longer = min(max(use**_POWER, _LITTLE), _MUCH)
        low, lasts, snaps = lasts, longer * lasts, snaps / longer**3
    if use > 1.0:
        return known
    for _ in range(_HALVINGS if low else 0):
        middle = 0.5 * (low + lasts)
        _, found, use = at(middle, snaps * (lasts / middle) ** 3)
        if use <= 1.0:
            lasts, snaps = middle, found
        else:
            low = middle
    failed = False
    for _ in range(_ROUNDS):
        if longest <= lasts:
            break
        if failed and 2 * len(aims) <= _MOST:
            # the path turns within spans: more points in them would only make the stop longer
            failed, n = False, 2 * len(aims)
            aims, points, snaps = np.full((n, *limits.shape), _AIM), _points(n), _regridded(snaps, n)
        tried, snaps, use = at(lasts, snaps)
        if use <= 1.0:
            motion = tried.motion(snaps)
            faults = faults_of(pieces, motion, limits)
            if not len(faults):
                return motion
            failed = True
            for _, where, t, which, _ in faults:
                if which < -1:  # a jump or a backward motion, which lower limits would not remove
                    return known
                axis, number = divmod(int(which), len(Limits._fields)) if which >= 0 else (slice(None), 0)
                aims[max(int(where) - 1, 0) : int(where) + 2, axis, number] *= _TIGHTER
                points.append((int(where), float(t) * len(aims) / lasts))
        longer = min(max(use**_POWER, _SLOWER), _MUCH)
        lasts, snaps = longer * lasts, snaps / longer**3
    return known
