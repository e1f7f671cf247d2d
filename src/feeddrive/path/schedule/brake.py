"""The quickest braking from any state of a motion to a node with a given speed, or to rest.

u'' goes from its present value to -A, stays there, and returns to 0.  Its changes are the quickest ones with
|u'''| <= J and |u''''| <= S: the first with the bounds J1 and S1 from the present u''', the second with J2 and S2.  A
is as large as the speed to be lost requires, at most A_max.  Where the path is straight, the bounds are those of the
axes, and this is the time-optimal motion.  On other paths the utilization of the limits along the motion corrects each
bound where it matters, until all limits are kept.  A proof decides.
"""

from __future__ import annotations

from math import copysign, isinf, log, sqrt
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Records, by_field, rows_for
from feeddrive.path.motion import (
    Derivatives,
    Limits,
    Motion,
    Pieces,
    at_instant,
    derivatives,
    interval_of,
    piece_of,
    way,
)
from feeddrive.path.proof import faults_of

_POINTS = 6  # in each time interval at which the limits are looked at, both ends included
_AIMS = (0.996, 0.98, 0.93, 0.8)  # utilization of the limits at these points: less where the proof fails between them
_PASSES = 12  # largest number of corrections of the bounds
_ENOUGH = 0.004  # of a bound: smaller corrections are not made
_DOWN = 0.3  # smallest factor of a correction
_UP = 1.3  # largest one
_ROUNDING = 1e-9  # relative, as the proof widens the limits
_HALVINGS = 60


class Moving(NamedTuple):
    """The state of a motion on a piece of path: x (m), and u' .. u''' (m/s .. m/s³)."""

    x: float
    speed: float
    acceleration: float
    jerk: float


class _Bounds(NamedTuple):
    """The bounds of a braking motion: A_max, J1, S1, J2 and S2."""

    acceleration: float
    jerk: float
    snap: float
    last_jerk: float
    last_snap: float


class _Phase(NamedTuple):
    """A time interval: its duration (s), u'' and u''' at its start, and its snap."""

    duration: float
    acceleration: float
    jerk: float
    snap: float


def _change(a0: float, j0: float, a1: float, J: float, S: float) -> list[_Phase]:
    """Return the quickest change of u'' from a0 to a1, for u''' from j0 to 0, |u'''| <= J and |u''''| <= S.

    u''' may jump where S is infinite, and u'' too where both bounds are: there are no phases then.
    """
    if isinf(S):
        takes = abs(a1 - a0) / J
        return [_Phase(takes, a0, copysign(J, a1 - a0), 0.0)] if takes > 0.0 else []
    # with u''' brought to 0 at once, u'' ends here
    ends = a0 + 0.5 * j0 * abs(j0) / S
    sense = 1.0 if a1 >= ends else -1.0
    d, j = sense * (a1 - a0), sense * j0
    peak = sqrt(max(S * d + 0.5 * j * j, 0.0))
    cruise = 0.0
    if peak > J:
        peak = J
        # a jerk above its bound falls to it first
        before = (peak * peak - j * j) / (2.0 * S) * (1.0 if j <= peak else -1.0)
        cruise = max((d - before - 0.5 * peak * peak / S) / peak, 0.0)
    phases, a = list[_Phase](), a0
    for duration, snap in (
        (abs(peak - j) / S, sense * (S if peak >= j else -S)),
        (cruise, 0.0),
        (peak / S, -sense * S),
    ):
        if duration > 0.0:
            phases.append(_Phase(duration, a, sense * j, snap))
            a += duration * (sense * j + 0.5 * duration * snap)
            j += sense * duration * snap
    return phases


def _lost(phases: list[_Phase]) -> float:
    """Return the change of speed over some phases, m/s."""
    return sum(T * (a + T * (0.5 * j + T * s / 6.0)) for T, a, j, s in phases)


def _phases(state: Moving, speed: float | None, bounds: _Bounds) -> tuple[list[_Phase], int]:
    """Return the phases of the quickest motion to a speed, and how many of them change u'' to -A.

    A speed of None is the one at which u'' and u''' first are 0.  There are no phases if the motion is slower then.
    """
    most, J1, S1, J2, S2 = bounds

    def both(A: float) -> tuple[list[_Phase], list[_Phase]]:
        return _change(state.acceleration, state.jerk, -A, J1, S1), _change(-A, 0.0, 0.0, J2, S2)

    def end(A: float) -> float:
        first, last = both(A)
        return state.speed + _lost(first) + _lost(last)

    if speed is None:
        first, _ = both(0.0)
        return first, len(first)
    low, high = 0.0, most
    if end(low) < speed:
        return [], 0
    if end(high) < speed:
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            if end(middle) >= speed:
                low = middle
            else:
                high = middle
        high = low
    first, last = both(high)
    # what the halvings leave is lost at constant deceleration
    left = (end(high) - speed) / high if high > 0.0 else 0.0
    middle = [_Phase(left, -high, 0.0, 0.0)] if left > 0.0 else []
    return [*first, *middle, *last], len(first)


def _placed(phases: list[_Phase], pieces: Pieces, state: Moving) -> Motion | None:
    """Return phases as a motion from x on the first piece, or None if they reach the end of the path."""
    rows, length = np.zeros((len(phases), 7)), pieces.length
    v, p, x = state.speed, 0, state.x
    for k, (T, a, j, s) in enumerate(phases):
        rows[k] = T, p, x, v, a, j, s
        x += way(v, a, j, s, T)
        v += T * (a + T * (0.5 * j + T * s / 6.0))
        while x > length[p]:
            if p + 1 == len(length):
                return None
            x -= float(length[p])
            p += 1
    duration, piece, place, v, a, j, s = rows.T.copy()
    return Motion(duration, piece.astype(np.int64), place, v, a, j, s)


@kernel
def _uses(
    pieces: Pieces,
    motion: Motion,
    limits: Records[Limits],
    points: int,
    out: Records[Limits],
    r: Records[Derivatives],
    axes: Records[Derivatives],
) -> int:
    """Write the largest utilization of the limits at `points` points of each time interval into `out` (m,)."""
    for m in range(len(motion.duration)):
        now = interval_of(motion, m)
        p = int(motion.piece[m])
        most = Limits(0.0, 0.0, 0.0, 0.0)
        for k in range(points):
            p, x = at_instant(pieces, now, p, now.duration * k / (points - 1), r, axes)
            now = now._replace(x=x)
            for i in range(len(r)):
                limit = limits[i]
                most = Limits(
                    max(most.velocity, abs(axes[i].first) / limit.velocity),
                    max(most.acceleration, abs(axes[i].second) / limit.acceleration),
                    max(most.jerk, abs(axes[i].third) / limit.jerk),
                    max(most.snap, abs(axes[i].fourth) / limit.snap),
                )
        out[m] = most
    return 0


def _bounds_at(pieces: Pieces, x: float, limits: np.ndarray) -> _Bounds:
    """Return the bounds on a straight path in the direction at x."""
    r = rows_for(Derivatives, len(limits))
    derivatives(*piece_of(pieces, 0), x, r)
    along = np.maximum(np.abs(np.asarray(by_field(Derivatives, r).first)), 1e-200)
    _, a, j, s = (np.min(limits / along[:, None], axis=0) * (1.0 - 1e-12)).tolist()
    return _Bounds(a, j, s, j, s)


def straight_stop(pieces: Pieces, state: Moving, limits: np.ndarray) -> Motion | None:
    """Return the stop of a straight path, which need not keep the limits on this one; None if the path is shorter."""
    phases, _ = _phases(state, 0.0, _bounds_at(pieces, state.x, limits))
    return _placed(phases, pieces, state) if phases else None


def braking(pieces: Pieces, state: Moving, speed: float | None, limits: np.ndarray) -> Motion | None:
    """Return a quick and proven motion from a state on the first of these pieces to a node of a given speed, m/s.

    A speed of None is the one at which u'' and u''' first are 0.  The result is None if there is no such motion within
    the pieces, or none that is found.

    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    """
    for aim in _AIMS:
        motion = _aimed(pieces, state, speed, limits, aim)
        if motion is not None and not len(faults_of(pieces, motion, limits)):
            return motion
    return None


def _aimed(pieces: Pieces, state: Moving, speed: float | None, limits: np.ndarray, aim: float) -> Motion | None:
    """Return the quickest motion, as for `braking`, of those that use the limits up to a share `aim` and keep them at
    points in time.
    """
    top = bounds = _bounds_at(pieces, state.x, limits)
    r, axes = (rows_for(Derivatives, len(limits)) for _ in range(2))
    best: Motion | None = None
    for _ in range(_PASSES):
        phases, first = _phases(state, speed, bounds)
        motion = _placed(phases, pieces, state) if phases else None
        if motion is None:
            break
        out = rows_for(Limits, len(motion.duration))
        _uses(pieces, motion, limits, _POINTS, out, r, axes)
        keeps = bool(np.max(out) <= 1.0 + _ROUNDING)
        if keeps and (best is None or motion.duration.sum() < best.duration.sum()):
            best = motion
        new = _corrected(bounds, top, by_field(Limits, out), first, aim)
        if keeps and all(new[k] == bounds[k] or abs(log(new[k] / bounds[k])) <= _ENOUGH for k in range(len(new))):
            break
        bounds = new
    return best


def _corrected(bounds: _Bounds, top: _Bounds, use: Limits, first: int, aim: float) -> _Bounds:
    """Return bounds at which the utilization of the limits is nearer to `aim` in the phases that each of them shapes:
    the `first` ones, and the others.
    """

    def at_aim(bound: float, most: float, *uses: np.ndarray) -> float:
        largest = max((float(np.max(each)) for each in uses if len(each)), default=1.0)
        return min(most, bound * min(max(aim / max(largest, 1e-6), _DOWN), _UP))

    a, j, s = (np.asarray(each) for each in (use.acceleration, use.jerk, use.snap))
    n = max(first - 1, 0)
    return _Bounds(
        at_aim(bounds.acceleration, top.acceleration, a[n:]),
        at_aim(bounds.jerk, top.jerk, j[:first]),
        at_aim(bounds.snap, top.snap, s[:first]),
        at_aim(bounds.last_jerk, top.last_jerk, j[first:]),
        at_aim(bounds.last_snap, top.last_snap, s[first:]),
    )
