"""A prefilter of the setpoint that cancels the tracking error of a loop, fitted by least squares to one run or log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.blocks.signals import Setpoint
from feeddrive.identification.regression import standard_errors
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.learning.trial import differenced
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate

REGRESSORS = ("velocity", "acceleration", "jerk", "snap")
_UNITS = ("s", "s2", "s3", "s4")
REST = 1e-9  # of a regressor's largest value: a sample where all are below it is not used
LEAST_SAMPLES = 25  # in motion, for each regressor: with fewer the fit would follow the noise
LARGEST_CONDITION = 1e3  # of columns of equal size: beyond it the parameters cannot be separated
# of a motion in closed form: 1e-6 over 10 s is 10 us, at 1 m/s an error of 10 um
LIMIT_CLOCK = 1e-6  # largest relative difference of two clocks


@dataclass(frozen=True, eq=False, repr=False)
class PrefilterFit(Result):
    """The part of a tracking error explained by reference derivatives: e = θ1 v + θ2 a + θ3 j + θ4 s + remainder.

    theta             θ by regressor, in s, s², s³, s⁴
    standard_error    standard errors of theta, which allow for an autocorrelated remainder
    condition         condition number of the regressors' columns, scaled to equal RMS
    present           prefilter that was active in the run; `prefilter` adds θ to it
    error, explained  tracking error and its part explained by theta, m, shape (n,)
    counted           mask of the samples in motion
    """

    theta: Mapping[str, float]
    standard_error: Mapping[str, float]
    condition: float
    present: TrajectoryPrefilter
    time: np.ndarray
    error: np.ndarray
    explained: np.ndarray
    setpoint: Setpoint
    counted: np.ndarray

    @property
    def prefilter(self) -> TrajectoryPrefilter:
        """The prefilter for the next run: that of this run with θ added to its parameters."""
        parts = {name: getattr(self.present, name) for name in _NAMES}
        for name, value in self.theta.items():
            parts[_NAMES[REGRESSORS.index(name)]] += value
        return TrajectoryPrefilter(**parts)

    @property
    def exact(self) -> TrajectoryPrefilter:
        """The prefilter for a large θ: the series expansion of (1 + present) / (1 - θ(s)), truncated after the snap."""
        t1, t2, t3, t4 = (self.theta.get(name, 0.0) for name in REGRESSORS)
        inverse = (
            t1,
            t2 + t1 * t1,
            t3 + 2.0 * t1 * t2 + t1 * t1 * t1,
            t4 + 2.0 * t1 * t3 + t2 * t2 + 3.0 * t1 * t1 * t2 + t1 * t1 * t1 * t1,
        )
        one = [1.0, *(getattr(self.present, name) for name in _NAMES)]
        other = [1.0, *inverse]
        product = [sum(one[i] * other[order - i] for i in range(order + 1)) for order in range(1, 5)]
        return TrajectoryPrefilter(**dict(zip(_NAMES, product, strict=True)))

    @property
    def predicted(self) -> np.ndarray:
        """The predicted error of the next run, m: the remainder plus θ(s)² x, truncated after the snap.

        The loop is assumed to follow θ(s) x immediately.  In reality it smooths the steps of θ4 times the snap, so the
        error is smaller.
        """
        # the snap's own square is of eighth order and left out, like all above the snap
        t1, t2, t3, _ = (self.theta.get(name, 0.0) for name in REGRESSORS)
        _, _, a, j, s = self.setpoint
        return self.error - self.explained + t1 * t1 * a + 2.0 * t1 * t2 * j + (2.0 * t1 * t3 + t2 * t2) * s

    def rms(self, error: np.ndarray) -> float:
        """Return the RMS of an error over the counted samples, m."""
        return float(np.sqrt(np.mean(error[self.counted] ** 2)))

    def correlation(self, error: np.ndarray) -> dict[str, float]:
        """Return the correlation of an error with each nonzero derivative of the reference.

        Only the samples included in the evaluation (`counted`) are used.
        """
        correlations: dict[str, float] = {}
        for name in REGRESSORS:
            column = getattr(self.setpoint, name)[self.counted]
            if np.ptp(column) > 0.0 and np.ptp(error[self.counted]) > 0.0:
                correlations[name] = float(np.corrcoef(error[self.counted], column)[0, 1])
        return correlations

    def table(self) -> Table:
        """Return a table with one row per regressor; the last columns are its correlations with error and remainder."""
        before, after = self.correlation(self.error), self.correlation(self.error - self.explained)
        rows = []
        for i, name in enumerate(REGRESSORS):
            fitted = name in self.theta
            values = (self.theta[name], self.standard_error[name], getattr(self.prefilter, _NAMES[i])) if fitted else ()
            cells = [Quantity(value, _UNITS[i]) for value in values] or [None, None, None]
            rows.append([name, UNIT if fitted else _UNITS[i], *cells, before.get(name), after.get(name)])
        title = Text(
            f"{int(self.counted.sum())} samples in motion: error {Quantity(self.rms(self.error), 'm')} RMS, "
            f"{Quantity(self.rms(self.predicted), 'm')} predicted; condition {Quantity(self.condition):3}"
        )
        columns = [
            "regressor",
            "unit",
            Column("theta", form="SI"),
            Column("std. error", form="2 SI"),
            Column("next theta", form="SI"),
            Column("corr.", "", ".2f"),
            Column("left", "", ".2f"),
        ]
        return Table(title, columns, rows)


_NAMES = ("theta1", "theta2", "theta3", "theta4")


def fit_prefilter(
    run: Run,
    reference: Reference,
    *,
    regressors: Sequence[str] = REGRESSORS,
    present: TrajectoryPrefilter | None = None,
) -> PrefilterFit:
    """Fit a prefilter to one run of a loop along a reference; repeat run and fit as long as the error decreases.

        least ‖e - [v a j s] θ‖ over the samples in motion,  e = set position - reading,  v .. s exact, not filtered

    regressors  derivatives that may be used
    present     prefilter that was active in the run; θ is added to it
    Columns are divided by their maximum; standard errors allow for autocorrelated remainders (Newey & West 1987).

    Raises ParameterError for unknown regressors, and LogError if the run reached its force limit, is in motion for too
    short a time, or does not excite the requested regressors.
    Not suitable if friction is not fed forward, because its error is not a linear combination of the derivatives.
    Source: Gordon & Erkorkmaz 2013, section 2 (trajectory prefilter, identified from one run).
    """
    if "requested" in run.signals and "force" in run.signals:
        _check_limit(run.name, np.flatnonzero(run["requested"] != run["force"]), run.time)
    setpoint = reference.at(run.time)
    return _fit(run.name, run.time, run["following_error"], setpoint, regressors, present)


def fit_prefilter_to_log(
    time: np.ndarray,
    set_position: np.ndarray,
    position: np.ndarray,
    sample_time: float,
    *,
    reference: Reference | None = None,
    regressors: Sequence[str] = REGRESSORS,
    present: TrajectoryPrefilter | None = None,
    force: np.ndarray | None = None,
    control: Loop | None = None,
    name: str = "the log",
) -> PrefilterFit:
    """Fit a prefilter to a measured log: set positions (before any prefilter) and table positions, in m.

    reference  the motion in closed form, for exact derivatives; it is aligned with the set positions.  Without it, the
               derivatives are central differences of the sampled set positions
    force      force, N, to detect whether the force limit of `control` was reached
    control    the loop of the machine, whose sample time the log must have

    Raises LogError as `fit_prefilter` does, and also if the sample time is not the controller's, the reference does not
    match the log, or the set positions are rounded too coarsely to be differentiated.
    """
    time, set_position, position = (np.asarray(signal, dtype=float) for signal in (time, set_position, position))
    if control is not None:
        _check_clock(name, sample_time, float(control.sample_time))
        limit = control.control.force_limit
        if force is not None and limit is not None:
            _check_limit(name, np.flatnonzero(np.abs(force) >= (1.0 - 1e-6) * limit), time)
    if reference is None:
        setpoint = differenced(name, set_position, sample_time, _known(regressors))
    else:
        setpoint = _laid_over(name, time, set_position, reference)
    _check_follows(name, set_position, position)
    return _fit(name, time, set_position - position, setpoint, regressors, present)


def tune_prefilter(
    loop: Loop, reference: Reference, *, runs: int = 2, regressors: Sequence[str] = REGRESSORS, seed: int = 0
) -> tuple[PrefilterFit, ...]:
    """Simulate `runs` runs, each with the prefilter fitted to the previous one; return all fits."""
    present = loop.control.prefilter
    if present is not None and not isinstance(present, TrajectoryPrefilter):
        raise ParameterError(f"control.prefilter is a {present.kind}: remove it, or tune a trajectory_prefilter")
    fits: list[PrefilterFit] = []
    record = ("following_error", "requested", "force")
    for k in range(runs):
        held = replace(loop, control=replace(loop.control, prefilter=present))
        run = simulate(held, reference, seed=seed, record=record, name=f"run {k + 1}")
        fits.append(fit_prefilter(run, reference, regressors=regressors, present=present))
        present = fits[-1].prefilter
    return tuple(fits)


def _known(regressors: Sequence[str]) -> list[str]:
    for name in regressors:
        if name not in REGRESSORS:
            raise ParameterError(f"regressor '{name}' is not known; there are {', '.join(REGRESSORS)}")
    if not regressors:
        raise ParameterError(f"a prefilter needs at least one regressor of {', '.join(REGRESSORS)}")
    return [name for name in REGRESSORS if name in regressors]


def _check_limit(name: str, limited: np.ndarray, time: np.ndarray) -> None:
    if limited.size:
        raise LogError(
            f"{name}: the force met its limit in {limited.size} samples (> 0), first at "
            f"{Quantity(time[limited[0]], 's'):6 SI}: its error is not that of the reference; take a run with lower "
            "acceleration or jerk"
        )


def _check_clock(name: str, actual: float, wanted: float) -> None:
    off = abs(actual / wanted - 1.0)
    if off > LIMIT_CLOCK:
        raise LogError(
            f"{name}: its sample time {Quantity(actual, 's'):9 SI} is not the controller's, "
            f"{Quantity(wanted, 's'):9 SI}: they differ by {Quantity(off, 'share'):3}, at most "
            f"{Quantity(LIMIT_CLOCK, 'share'):6} is admitted; record on the controller's clock, "
            f"{Quantity(wanted, 's'):9 SI}, or name the machine file of this controller"
        )


def _check_follows(name: str, set_position: np.ndarray, position: np.ndarray) -> None:
    """Raise LogError if the error reaches half the travel, which indicates a dead encoder or a wrong unit."""
    travel, off = float(np.ptp(set_position)), float(np.max(np.abs(set_position - position), initial=0.0))
    if travel > 0.0 and not off < 0.5 * travel:
        raise LogError(
            f"{name}: the position is up to {Quantity(off, 'm'):SI} away from the set position, less than half the "
            f"travel, {Quantity(0.5 * travel, 'm'):SI}, is allowed: the axis does not follow; check the columns, their "
            "units and their offset"
        )


def _laid_over(name: str, time: np.ndarray, set_position: np.ndarray, reference: Reference) -> Setpoint:
    """Return the reference at the times of the log, aligned where the set positions first pass half the travel."""
    travel = float(np.ptp(set_position))
    # the crossing is then known to a few millionths of the duration, and interpolated
    grid = np.linspace(0.0, reference.duration, 200_001)
    shift = _half_way(time, set_position) - _half_way(grid, np.asarray(reference.at(grid).position))
    setpoint = reference.at(time - shift)
    off = float(np.max(np.abs(setpoint.position - set_position), initial=0.0))
    if not off <= 1e-5 * travel:
        raise LogError(
            f"{name}: its set positions are not those of the reference: they differ by up to {Quantity(off, 'm')}, at "
            f"most {Quantity(1e-5 * travel, 'm')} is admitted; give the job that was run, or none"
        )
    return setpoint


def _half_way(time: np.ndarray, position: np.ndarray) -> float:
    middle = 0.5 * (float(np.min(position)) + float(np.max(position)))
    # a motion may begin at its upper end
    level = (position - middle) * (1.0 if position[0] <= middle else -1.0)
    first = int(np.argmax(level > 0.0))
    if first == 0:
        return float(time[0])
    part = level[first - 1] / (level[first - 1] - level[first])
    return float(time[first - 1] + part * (time[first] - time[first - 1]))


def _fit(
    name: str,
    time: np.ndarray,
    error: np.ndarray,
    setpoint: Setpoint,
    regressors: Sequence[str],
    present: TrajectoryPrefilter | None,
) -> PrefilterFit:
    chosen = _known(regressors)
    columns = np.column_stack([np.asarray(getattr(setpoint, regressor), dtype=float) for regressor in chosen])
    largest = np.max(np.abs(columns), axis=0, initial=0.0)
    for regressor, size in zip(chosen, largest, strict=True):
        if size == 0.0:
            there = ", ".join(other for other, s in zip(chosen, largest, strict=True) if s > 0.0)
            raise LogError(
                f"{name}: the reference has no {regressor} (0 {_si(regressor)}, > 0 is needed), so that its part "
                f"cannot be identified: take a reference that has it, or only the regressors "
                f"{there or 'of one that moves'}"
            )
    # m/s and m/s⁴ differ by many decades
    scaled = columns / largest
    counted = np.max(np.abs(scaled), axis=1) > REST
    least = LEAST_SAMPLES * len(chosen)
    if int(counted.sum()) < least:
        raise LogError(
            f"{name}: only {int(counted.sum())} samples are in motion; {len(chosen)} regressors need at least {least}: "
            f"take a longer move, or fewer regressors"
        )
    rows, target = scaled[counted], error[counted]
    condition, weakest = _condition(rows)
    if not condition <= LARGEST_CONDITION:
        # a unit vector of four parts: those above 0.2 take part in the combination that is not excited
        together = [regressor for regressor, part in zip(chosen, weakest, strict=True) if abs(part) > 0.2]
        raise LogError(
            f"{name}: {' and '.join(together)} cannot be told apart in this motion (condition {number(condition, 3)}, "
            f"at most {number(LARGEST_CONDITION)} is admitted): leave one out, or take a move with dwells and plateaus"
        )
    parameters = np.linalg.lstsq(rows, target, rcond=None)[0]
    remainder = target - rows @ parameters
    theta, errors = parameters / largest, standard_errors(rows, remainder, _memory(remainder)) / largest
    return PrefilterFit(
        theta=dict(zip(chosen, map(float, theta), strict=True)),
        standard_error=dict(zip(chosen, map(float, errors), strict=True)),
        condition=condition,
        present=present or TrajectoryPrefilter(),
        time=time,
        error=error,
        explained=columns @ theta,
        setpoint=setpoint,
        counted=counted,
    )


def _condition(rows: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the condition number after scaling columns to equal RMS, and the least excited combination of columns."""
    _, sizes, directions = np.linalg.svd(rows / np.sqrt(np.mean(rows**2, axis=0)), full_matrices=False)
    return float(sizes[0] / sizes[-1]) if sizes[-1] > 0.0 else float("inf"), directions[-1]


def _memory(remainder: np.ndarray) -> int:
    """Return twice the lag in samples at which the autocorrelation of the remainder first vanishes."""
    n = remainder.size
    # twice the length: otherwise the end of the remainder would be correlated with its start
    correlation = np.fft.irfft(np.abs(np.fft.rfft(remainder, 2 * n)) ** 2)[:n]
    gone = np.flatnonzero(correlation <= 0.0)
    return int(2 * gone[0]) if gone.size else n


def _si(regressor: str) -> str:
    return ("m/s", "m/s2", "m/s3", "m/s4")[REGRESSORS.index(regressor)]
