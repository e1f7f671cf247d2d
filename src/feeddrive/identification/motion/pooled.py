"""One rigid drive from several logs of the same axis: pooled values, whose errors contain the scatter of the logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.motion.motion_log import MotionLog, Preparation
from feeddrive.identification.motion.rigid import FRICTIONS, RigidFit, identify_rigid
from feeddrive.identification.regression import NORMAL, Estimate, estimate_row, estimates_table
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.language.text import Text

LEAST_LOGS = 2
_HALVINGS = 60  # of the interval of the scatter: its rounding is then far below any error
_CHANCE = 0.05  # of logs that agree: the probability of a larger disagreement below which they are said to differ


@dataclass(frozen=True, eq=False, repr=False)
class PooledFit(Result):
    """A rigid drive from several logs of the same axis.

    fits       the fit of each log, with the same friction model
    estimates  the pooled values; `error` is such that 1.96 errors make a 95 % interval, `ols` is without the scatter
    scatter    standard deviation of each parameter from log to log, beyond the errors of the fits
    chance     probability of a larger disagreement if all logs had the same value
    """

    name: str
    fits: tuple[RigidFit, ...]
    estimates: tuple[Estimate, ...]
    scatter: dict[str, float]
    chance: dict[str, float]

    def __getitem__(self, parameter: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == parameter:
                return estimate
        raise ParameterError(
            f"the fit has no parameter '{parameter}'; it has {', '.join(estimate.name for estimate in self.estimates)}"
        )

    @property
    def differing(self) -> tuple[str, ...]:
        """The parameters in which the logs differ by more than their errors explain."""
        return tuple(name for name, chance in self.chance.items() if chance < _CHANCE)

    @property
    def remark(self) -> str:
        """A sentence on whether the logs agree."""
        if not self.differing:
            return Text(f"the {len(self.fits)} logs agree within their errors")
        parts = ", ".join(f"{name} by {Quantity(self.scatter[name], self[name].unit):2}" for name in self.differing)
        return Text(
            f"the {len(self.fits)} logs differ by more than their errors, from log to log {parts}: the model lacks "
            "something that changed between them (temperature, lubrication, position, load); the pooled errors contain "
            "this scatter"
        )

    def table(self) -> Table:
        """Return a table of the pooled parameters."""
        return estimates_table(f"{self.name}: pooled from {len(self.fits)} logs", self.estimates)

    def compared(self) -> Table:
        """Return a table with the values of each log, the scatter, and the probability of the disagreement."""
        heads = ["parameter", "unit", *(fit.name for fit in self.fits)]
        columns = [*heads, Column("scatter", form="2"), Column("chance", "share", "2")]
        rows: list[list[Cell]] = []
        for estimate in self.estimates:
            values = [fit[estimate.name].quantity for fit in self.fits]
            scatter = Quantity(self.scatter[estimate.name], estimate.unit)
            rows.append([*estimate_row(estimate)[:1], UNIT, *values, scatter, self.chance[estimate.name]])
        return Table("the logs compared", columns, rows)


def identify_pooled(
    logs: Sequence[MotionLog], *, friction: str = "best", how: Preparation | None = None, name: str = "pooled"
) -> PooledFit:
    """Identify one rigid drive from several logs of the same axis.

        value = Σ w y / Σ w,   w = 1 / (σ² + τ²),   Σ w (y - value)² = logs - 1

    y ± σ are the values of the single logs; the scatter τ follows from the last equation and is 0 if the logs agree.
    The error is √(1 / Σ w), times Student's factor for the degrees of freedom of its scatter part (Satterthwaite), so
    that few logs that differ give a wide interval.

    friction  as in `identify_rigid`; "best" takes the model with the lower sum of the information criteria
    how       filters and delays of every log

    Raises ParameterError for fewer than two logs or logs in different units, NotIdentifiableError for a log that
    cannot be identified.
    Sources: Paule & Mandel 1982; Satterthwaite 1946.
    """
    if len(logs) < LEAST_LOGS:
        raise ParameterError(f"logs = {len(logs)} must be >= {LEAST_LOGS}: pooling needs several logs of one axis")
    frames = {log.frame.name for log in logs}
    if len(frames) > 1:
        raise ParameterError(f"the logs are in units of {' and of '.join(sorted(frames))}: give all at the same place")
    models = tuple(FRICTIONS) if friction == "best" else (friction,)
    by_model = {model: tuple(identify_rigid(log, friction=model, how=how) for log in logs) for model in models}
    best = min(models, key=lambda model: sum(fit.criterion[model] for fit in by_model[model]))
    return pooled(by_model[best], name)


def pooled(fits: Sequence[RigidFit], name: str = "pooled") -> PooledFit:
    """Pool fits with the same friction model; see `identify_pooled`."""
    if len({fit.friction for fit in fits}) > 1:
        raise ParameterError("the fits have different friction models: identify all with the same `friction`")
    # takes a second to import
    from scipy.special import chdtrc, stdtrit

    estimates, scatter, chance = [], {}, {}
    for first in fits[0].estimates:
        y = np.array([fit[first.name].value for fit in fits])
        variance = np.maximum([fit[first.name].error ** 2 for fit in fits], np.finfo(float).tiny)
        tau = scatter_of(y, variance)
        weights = 1.0 / (variance + tau**2)
        value, squared = float(weights @ y / weights.sum()), float(1.0 / weights.sum())
        between = tau**2 / len(fits)
        freedom = (len(fits) - 1) * (squared / between) ** 2 if between > 0.0 else np.inf
        student = float(stdtrit(min(freedom, 1e9), 0.975)) / NORMAL
        within = 1.0 / variance
        estimates.append(
            Estimate(first.name, value, first.unit, student * np.sqrt(squared), float(np.sqrt(1.0 / within.sum())))
        )
        scatter[first.name] = tau
        disagreement = float(within @ (y - within @ y / within.sum()) ** 2)
        chance[first.name] = float(chdtrc(len(fits) - 1, disagreement))
    return PooledFit(name, tuple(fits), tuple(estimates), scatter, chance)


def scatter_of(values: np.ndarray, variance: np.ndarray) -> float:
    """Return τ >= 0 with Σ (y - mean)² / (σ² + τ²) = n - 1, mean weighted by 1 / (σ² + τ²); 0 if the values agree."""

    def excess(squared: float) -> float:
        weights = 1.0 / (variance + squared)
        return float(weights @ (values - weights @ values / weights.sum()) ** 2) - (values.size - 1)

    if excess(0.0) <= 0.0:
        return 0.0
    low, high = 0.0, float(np.sum((values - values.mean()) ** 2)) + float(np.max(variance))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return float(np.sqrt(high))
