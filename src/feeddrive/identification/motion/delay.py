"""The dead time between the logged force and the acceleration of the axis, from the inverse dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.preparation import HOLD, Preparation, delayed, prepare
from feeddrive.identification.motion.rigid import LEAST_OWN, columns_of, covariance_of
from feeddrive.identification.regression import errors
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text

REACH = 20  # samples to both sides that are tried
LATEST = 5e-3  # s: a force that acts later than that does not belong to this clock
CLEAR = 0.9  # largest ratio of the residuals of two delays at which the better one counts as certain
_EARLY = 1e-3  # s: unknown forces and counts shift the delay of a closed loop by as much
_DRIFT = 2  # times that, and samples, by which the delays of the two halves of a log differ if they drift


@dataclass(frozen=True, eq=False, repr=False)
class DelayFit(Result):
    """The dead time in samples, without the half sample of the hold, with its standard error and
    the residual by delay.

    delays, residual  whole samples that were tried, and the residual of the inverse dynamics with each, both of shape
                      (m,)
    """

    name: str
    dead_time: float
    error: float
    delays: np.ndarray
    residual: np.ndarray
    sample_time: float

    @property
    def nearest(self) -> int:
        """The whole number of samples with the least residual."""
        return int(self.delays[np.argmin(self.residual)])

    @property
    def clear(self) -> bool:
        """True if the residual of the best delay is a tenth less than without delay."""
        return self.tells(self.nearest, 0.0)

    def tells(self, better: float, other: float) -> bool:
        """Return True if the inverse dynamics leave a tenth less with one delay than with another.

        A ragged residual counts as well: of forces that are mostly made by counts, the delay that leaves least gives
        the better mass, whatever the true one is.
        """
        return self.left(better) < CLEAR * self.left(other)

    def left(self, samples: float) -> float:
        """Return the share of the force that the inverse dynamics leave with a delay, interpolated between whole
        samples.
        """
        return float(np.interp(samples, self.delays, self.residual))

    def table(self) -> Table:
        """Return the residual of the delays around the best."""
        near = np.abs(self.delays - self.nearest) <= 2
        rows = [[int(d), float(r)] for d, r in zip(self.delays[near], self.residual[near], strict=True)]
        dead_time = Quantity(self.dead_time, "samples", self.error)
        return Table(
            f"{self.name}: dead time {dead_time} besides the hold", ["samples", Column("residual", "share")], rows
        )


def find_delay(
    log: MotionLog, *, friction: str = "directional", how: Preparation | None = None, clocks: bool = True
) -> DelayFit:
    """Find the dead time between a logged force and the acceleration that it causes, in samples.

        force(k - 1/2 - dead_time) = inverse dynamics(k),   the dead time that leaves the least residual

    Whole samples are tried; about the best one the delay is one more parameter of the least squares, with the slope of
    the force as its column, which gives the fraction and its error.  The logged force is the one that was commanded at
    its sample.

    When not to trust it alone: in a closed loop the force reacts to disturbances, and part of that reaction is taken
    for a delay. This error grows with the residual of the model.  There `refine` decides between whole samples.

    clocks  whether a delay that cannot be is an error; not where the law proves that both channels have one clock

    Raises NotIdentifiableError where the force comes before its cause, acts later than 5 ms, or if its delay drifts:
    then force and position were recorded on two clocks.
    """
    how = replace(how or Preparation(), delay=HOLD)
    delays = np.arange(-REACH, REACH + 1)
    base = prepare(log, how)
    columns = columns_of(base, friction)
    columns = columns[:, np.any(columns != 0.0, axis=0)]  # a direction without motion has no friction
    basis = np.linalg.qr(columns)[0]
    forces = base.reduced(np.array([delayed(log.force, HOLD + d) for d in delays]))
    residual = np.array([_left(basis, force) for force in forces])
    best = int(np.argmin(residual))
    _check_slope(log, basis, forces, residual)
    if clocks:
        _check(log, int(delays[best]), delays, residual)
        _check_drift(log, columns, forces, delays)
    slope = 0.5 * (forces[min(best + 1, delays.size - 1)] - forces[max(best - 1, 0)])
    wide = np.column_stack([columns, -slope])
    values = np.linalg.lstsq(wide, forces[best], rcond=None)[0]
    error = float(errors(covariance_of(wide, forces[best] - wide @ values))[-1])
    return DelayFit(log.name, float(delays[best]) + float(values[-1]), error, delays, residual, log.sample_time)


def _left(basis: np.ndarray, force: np.ndarray) -> float:
    """Return the share of the force that the columns do not explain."""
    off = force - basis @ (basis.T @ force)
    size = float(np.linalg.norm(force))
    return float(np.linalg.norm(off)) / size if size > 0.0 else np.nan


def _check_slope(log: MotionLog, basis: np.ndarray, forces: np.ndarray, residual: np.ndarray) -> None:
    """Refuse a motion of one frequency: there a later force is equivalent to less mass and more damping."""
    if not np.all(np.isfinite(residual)):
        raise NotIdentifiableError(
            f"{log.name}: the force is 0 wherever the axis moves: record the commanded force next, on the same clock"
        )
    middle = len(forces) // 2
    slope = forces[middle + 1] - forces[middle - 1]
    own = _left(basis, slope) if np.any(slope) else 0.0
    if own < LEAST_OWN:
        raise NotIdentifiableError(
            f"{log.name}: the delay of the force is not identifiable: the motion has nearly one frequency only, where "
            f"a delay acts like less mass and more damping ({Quantity(own, 'share'):2} of its effect is independent, "
            f"at least {Quantity(LEAST_OWN, 'share'):6} are needed); record next moves to and fro at constant speeds, "
            "with ramps between"
        )


def _check(log: MotionLog, best: int, delays: np.ndarray, residual: np.ndarray) -> None:
    at_zero = float(residual[np.flatnonzero(delays == 0)[0]])
    # otherwise there is no evidence for a delay other than 0
    clear = float(np.min(residual)) < CLEAR * at_zero and at_zero - float(np.min(residual)) > _rough(residual)
    late = best * log.sample_time > LATEST
    early = best < -1 and -best * log.sample_time > _EARLY
    if clear and early and _trails(log):
        raise NotIdentifiableError(
            f"{log.name}: set position and position are swapped: the set position trails the position, and the axis "
            f"seems to feel the force {-best} samples before it was logged; exchange their columns, "
            f"with --set-position and --position"
        )
    if clear and (early or late or abs(best) == REACH):
        when = (
            f"{-best} samples before"
            if best < 0
            else Text(f"{best} samples ({Quantity(best * log.sample_time, 's'):3}) after")
        )
        raise NotIdentifiableError(
            f"{log.name}: force and position are not synchronised: the axis seems to feel the force {when} it was "
            f"logged; record both channels with one recorder and one trigger, or shift one of them by that much"
        )


def _rough(residual: np.ndarray) -> float:
    """Return twice the largest fall of a residual on the way from its minimum to longer or to shorter delays.

    Around the true delay a residual rises to both sides. Where counts go through a velocity gain into the force it is
    as ragged as the force, and its minimum says nothing about clocks.
    """
    best = int(np.argmin(residual))
    sides = residual[best:], residual[best::-1]
    return 2.0 * float(max(np.max(np.maximum.accumulate(side) - side) for side in sides))


def _trails(log: MotionLog) -> bool:
    """True if the set position lags the position: (r - x) v < 0 on average."""
    if log.set_position is None:
        return False
    return float(np.mean((log.set_position - log.position) * np.gradient(log.set_position))) < 0.0


def _check_drift(log: MotionLog, columns: np.ndarray, forces: np.ndarray, delays: np.ndarray) -> None:
    """Raise NotIdentifiableError if the delays of the two halves of a log differ: the channels had two clocks."""
    half = columns.shape[0] // 2
    halves = (slice(0, half), slice(half, None))
    left = [np.array([_left(np.linalg.qr(columns[rows])[0], force[rows]) for force in forces]) for rows in halves]
    first, second = (int(np.argmin(residual)) for residual in left)
    other = left[0][second], left[1][first]
    least = left[0][first], left[1][second]
    sure = all(
        own < CLEAR * at and at - own > _rough(residual) for own, at, residual in zip(least, other, left, strict=True)
    )
    if sure and abs(second - first) >= _DRIFT * max(1.0, _EARLY / log.sample_time):
        raise NotIdentifiableError(
            f"{log.name}: force and position are not on one clock: the force acts {delays[first]} samples late in the "
            f"first half of the log and {delays[second]} in the second; record both channels with one recorder"
        )
