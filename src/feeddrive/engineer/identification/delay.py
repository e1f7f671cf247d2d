"""How long a logged force takes until the axis feels it, from the inverse dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.engineer.identification.covariance import errors, robust_covariance
from feeddrive.engineer.identification.motion_log import MotionLog
from feeddrive.engineer.identification.preparation import HOLD, Preparation, prepare
from feeddrive.engineer.identification.rigid import columns_of
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.table import Result, Table

REACH = 20  # samples to both sides that are tried
LATEST = 5e-3  # s: a force that acts later than that does not belong to this clock
_DRIFT = 2.0  # samples by which the delay of the two halves of a log may differ


@dataclass(frozen=True, eq=False, repr=False)
class DelayFit(Result):
    """Dead time in samples, without the half sample of the hold, with its standard error; the residual by delay tried.

    delays    whole samples of dead time, shape (m,); residual: of the inverse dynamics, relative, shape (m,)
    nearest   the whole number of samples that fits best
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

    def table(self) -> Table:
        """Residual of the delays around the best."""
        near = np.abs(self.delays - self.nearest) <= 2
        rows = [[f"{d:g}", f"{100.0 * r:.4g}"] for d, r in zip(self.delays[near], self.residual[near], strict=True)]
        title = f"{self.name}: dead time {self.dead_time:.2f} ± {self.error:.2f} samples besides the hold"
        return Table(title, ["samples", "residual %"], rows)

    def plot(self) -> Any:
        """Residual over delay, as a matplotlib figure."""
        from feeddrive.artefacts import plot

        return plot.delay_fit(self)

    def to_pandas(self) -> Any:
        """A DataFrame with one row a delay."""
        from feeddrive.artefacts.plot import frames

        return frames.frame(self.delays, {"residual": self.residual}, "samples")


def find_delay(log: MotionLog, *, friction: str = "directional", how: Preparation | None = None) -> DelayFit:
    """The dead time between a logged force and the acceleration that it causes, in samples.

        force(k - 1/2 - dead_time) = inverse dynamics(k),   the dead time that leaves the least residual

    Whole samples are tried; about the best one the delay is one more parameter of the least squares, with the slope of
    the force as its column, which gives the fraction and its error.  The logged force is the one that was commanded at
    its sample.
    Raises NotIdentifiableError where the force comes before its cause, acts later than 5 ms, or where its delay drifts:
    then force and position were recorded on two clocks.
    """
    how = replace(how or Preparation(), delay=HOLD)
    delays = np.arange(-REACH, REACH + 1)
    base = prepare(log, how)
    columns = columns_of(base, friction)
    basis = np.linalg.qr(columns)[0]
    forces = [prepare(log, replace(how, delay=HOLD + d)).force for d in delays]
    residual = np.array([_left(basis, force) for force in forces])
    best = int(np.argmin(residual))
    _check(log, int(delays[best]), delays, residual)
    half = base.time.size // 2
    parts = [int(delays[np.argmin([_left(np.linalg.qr(columns[rows])[0], f[rows]) for f in forces])])
             for rows in (slice(0, half), slice(half, None))]  # fmt: skip
    if abs(parts[1] - parts[0]) >= _DRIFT:
        raise NotIdentifiableError(
            f"{log.name}: force and position are not on one clock: the force acts {parts[0]} samples late in the first "
            f"half of the log and {parts[1]} in the second; record both channels with one recorder"
        )
    slope = 0.5 * (forces[min(best + 1, delays.size - 1)] - forces[max(best - 1, 0)])
    wide = np.column_stack([columns, -slope])
    values = np.linalg.lstsq(wide, forces[best], rcond=None)[0]
    off = forces[best] - wide @ values
    error = float(errors(robust_covariance(wide, off))[-1])
    return DelayFit(log.name, float(delays[best]) + float(values[-1]), error, delays, residual, log.sample_time)


def _left(basis: np.ndarray, force: np.ndarray) -> float:
    """Share of the force that the columns do not explain."""
    off = force - basis @ (basis.T @ force)
    return float(np.linalg.norm(off) / np.linalg.norm(force))


def _check(log: MotionLog, best: int, delays: np.ndarray, residual: np.ndarray) -> None:
    at_zero = float(residual[np.flatnonzero(delays == 0)[0]])
    clear = float(np.min(residual)) < 0.9 * at_zero  # else nothing speaks against 0
    late = best * log.sample_time > LATEST
    if clear and (best < -1 or late or abs(best) == REACH):
        when = (
            f"{-best} samples before" if best < 0 else f"{best} samples ({1e3 * best * log.sample_time:.3g} ms) after"
        )
        raise NotIdentifiableError(
            f"{log.name}: force and position are not synchronised: the axis seems to feel the force {when} it was "
            f"logged; record both channels with one recorder and one trigger, or shift one of them by that much"
        )
