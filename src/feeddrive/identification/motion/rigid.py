"""Identification of a rigid drive with friction by inverse dynamics, and of the dead time of its force."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Self, cast

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.blocks.force.force_map import ForceMap
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.identification import regression
from feeddrive.identification.motion import motion_log
from feeddrive.identification.motion.motion_log import MotionLog, Preparation, Prepared
from feeddrive.identification.regression import Estimate, Frame, Residuals, Validation
from feeddrive.language.block import Number
from feeddrive.language.errors import FeeddriveError, LogError, NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table
from feeddrive.language.text import Text

# by structure alone: the columns are traced, so that the values do not matter
FRICTIONS: dict[str, Friction] = {
    "symmetric": Coulomb(coulomb=1.0),
    "directional": Directional(coulomb_positive=1.0, coulomb_negative=1.0),
}
NAMES = {
    "symmetric": ("mass", "viscous", "coulomb", "offset"),
    "directional": ("mass", "viscous_positive", "coulomb_positive", "viscous_negative", "coulomb_negative"),
}
_DRAWN = 4  # sets of readings with other places within their counts
LEAST_REVERSAL = 0.05  # least share of the moving rows in each direction
LEAST_INDEPENDENT = 0.02  # share of a column's size that the other columns must leave unexplained
# bounded as in Andrews' rule: near 1 the recolored covariance would grow without limit
MOST_MEMORY = 0.97
LARGEST_ERROR = 0.5  # largest standard error over value of a mass that counts as identified
# s: time constants of the low passes through which the set motion serves as instruments. They span the following
# errors of position loops of some 5 to 100 1/s; more of them would bring the bias of least squares back
FILTERED = (0.0, 8e-3, 30e-3, 0.1)
_RANK = 1e-8  # of the largest eigenvalue: instruments that are alike beyond this are one
BLOCKS = 10  # of rows, each predicted from the others: each is longer than the memory of a disturbance
_STRONG = 10.0  # F of the first stage below which instruments are weak (Staiger & Stock 1997)
_MOST_CONDITION = 1e12  # of the projected columns: beyond it rounding decides
_LATEST_DOUBT = 5.0  # samples: what weak instruments may say about a delay is bounded by what delays are
_TURNS = 8  # steps of Gauss-Newton to the dead time
_SETTLED = 0.02  # samples: the slope of the force is the same over such a step
_LARGEST_STEP = 2.0  # samples: over more the force is not straight
# classes of speed, as shares of the largest, from the fast to the slow: the width of a Stribeck curve is unknown
_SLOW = (0.3, 0.2, 0.14, 0.1, 0.07, 0.05, 0.035, 0.025, 0.015, 0.01, 0.005)
_PASSAGES = 4  # through a class of speed: fewer show no scatter
_PULSE = 6.0  # robust standard deviations: a normal residual exceeds them once in 5e8 rows
_PULSE_SPREAD = 2  # rows to both sides of a pulse that go with it
_PULSE_TURNS = 4  # fits without the pulses found so far
_MOST_PULSES = 0.4  # of the rows: what acts in more of them is no pulse
# by which the variance of a value may rise without the rows of pulses: drawn pulses raise it by 1.3, ramps by 30
_MOST_LOSS = 4.0
_MOST_ASYMMETRY = 0.5  # of the mean level: guideways with a ratio above 3 : 1 are not known, weights are
_EVIDENCE = 10.0  # of the information criterion: very strong evidence (Kass & Raftery 1995)
# standard errors of a force along the travel; some 400 periods are tried, so that chance reaches 3.5
_SURE_TERM = 5.0
_LEAST_TURN = 0.25  # of a turn: over less of it a weight that turns looks like a constant and a slope
_LEAST_REPEATS = 2.0  # periods in the travel: fewer are a bow of the friction, and no repetition
_MOST_REPEATS = 200.0  # periods in the travel: shorter ones are no shape of an axis
_FINER = 3  # grids of periods, each ten times finer than the one before
_MAP_ENTRIES = 65  # of a force along the travel: 32 repeats are still seen
MORE_RAMPS = (
    "record next moves with short ramps, but of 30 ms or more: the inertial force should be at least as large as "
    "friction for a tenth of the time"
)
SURE_MASS = 0.025  # largest relative standard error of a mass that is recommended: 5 % are then two errors
_FINER_CUTOFF, _FINER_STEP = 200.0, 5e-3  # Hz, s: of the second preparation, twice as fine as the usual one
_WIDEST = 10.0  # errors over those for a white residual
_HARMLESS = 0.02  # share of the force: an axis that changes by less along the log has its mass within 5 % all the same
_EXACT = 1e-3  # share of the RMS force: the filters alone leave about as much of a log without noise
_DEVIATES = 0.05  # chance of a class of speed: one in twenty is left out without a reason, which costs few rows


@dataclass(frozen=True, eq=False, repr=False)
class RigidFit(Result):
    """A rigid drive identified from a log; in shaft units the parameter `mass` is an inertia in kg m².

    estimates   every parameter with its standard errors
    covariance  robust covariance, in the order of the estimates
    validation  prediction of unused rows
    criterion   information criterion (lower is better) of the friction models that were compared
    counts      residual due to quantization of the readings, relative to the force, in used and in unused rows
    dead_time   samples from the logged force to its effect, without the half sample of the zero-order hold; its error
                is 0 if it was not fitted
    how         the preparation of the rows, with the delay of the fit
    instruments True if the set motion was used as instruments: the values are then free of the errors caused by
                quantization and by the reaction of the control to disturbances
    left_out    number of excluded rows by cause (`motion_log.CAUSES`)
    periods     periods of a position-dependent force; infinite for a force proportional to the position
    bends       True if the log shows elasticity of the axis: part of the force follows the fourth position derivative
    travel      smallest and largest position in the log
    """

    name: str
    friction: str
    estimates: tuple[Estimate, ...]
    covariance: np.ndarray
    residuals: Residuals
    validation: Validation
    criterion: dict[str, float]
    time: np.ndarray
    frame: Frame
    dead_time: Estimate
    how: Preparation
    instruments: bool = False
    left_out: Mapping[str, int] = field(default_factory=dict[str, int])
    periods: tuple[float, ...] = ()
    bends: bool = False
    travel: tuple[float, float] = (0.0, 0.0)
    counts: tuple[float, float] = (0.0, 0.0)

    @property
    def slowest(self) -> float:
        """The speed below which rows were excluded, as friction is not Coulomb plus viscous there; 0 if none were."""
        return self.how.rest if self.how.rest > motion_log.REST else 0.0

    @property
    def left(self) -> float:
        """The relative residual of the force without the effect of quantization."""
        return float(np.sqrt(max(0.0, self.residuals.relative**2 - self.counts[0] ** 2)))

    @property
    def bends_at(self) -> Quantity | None:
        """The frequency by which the axis bends, f = (M / |bend|)^½ / 2π, in Hz; None if the log shows none.

        Behind an encoder of the load, bend = m1 m2/k > 0, it is the resonance of the two masses. Behind one of the
        motor, bend = -m2²/k, the antiresonance is lower by (m2/M)^½, which such a log does not tell.
        """
        if not self.bends:
            return None
        mass, bend = self["mass"], self["bend"]
        frequency = np.sqrt(mass.value / abs(bend.value)) / (2.0 * np.pi)
        return Quantity(frequency, "Hz", 0.5 * frequency * bend.error / abs(bend.value))

    @property
    def changed(self) -> bool:
        """True if the error in unused rows is 50 % larger than in used rows, and more than 2 % of the force.

        The error excludes the effect of quantization and twice the part explained by the parameter errors of the fits
        without these rows: if only one stretch contains fast motion, the others predict it poorly.
        """
        chance = self.counts[1] ** 2 + (2.0 * self.validation.expected) ** 2
        beyond = np.sqrt(max(0.0, self.validation.relative**2 - chance))
        return bool(beyond > max(1.5 * self.residuals.relative, _HARMLESS))

    def __getitem__(self, parameter: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == parameter:
                return estimate
        raise ParameterError(f"the fit has no parameter '{parameter}'; it has {', '.join(NAMES[self.friction])}")

    def table(self) -> Table:
        """Return a table of the parameters with both standard errors."""
        off = Text(
            f"residual {Quantity(self.residuals.relative, 'share'):3}, unused rows "
            f"{Quantity(self.validation.relative, 'share'):3}"
        )
        return regression.estimates_table(f"{self.name}: rigid drive, {self.friction} friction; {off}", self.estimates)

    def rows_table(self) -> Table:
        """Return a table of the used rows, and of the excluded rows with cause and remedy."""
        count = self.residuals.values.size
        whole = max(count + sum(self.left_out.values()), 1)
        rows: list[list[Cell]] = [["used", count, count / whole, ""]]
        rows += [
            list[Cell]([motion_log.CAUSES[cause][0], left, left / whole, motion_log.CAUSES[cause][1]])
            for cause, left in self.left_out.items()
            if left
        ]
        return Table(
            "rows of the log that count", ["rows", "number", Column("share", "share", "3"), "what helps"], rows
        )

    def at_table(self, lead: float, gear: float = 1.0) -> Self:
        """Return the drive in kg and N at a table with a screw of `lead` (m) and `gear` motor turns per screw turn."""
        if self.frame is not regression.SHAFT:
            return self
        r = regression.lever(lead, gear)
        estimates = tuple(estimate.at_table(r) for estimate in self.estimates)
        factors = np.array(
            [new.value / old.value if old.value else 0.0 for new, old in zip(estimates, self.estimates, strict=True)]
        )
        residuals = replace(
            self.residuals, values=self.residuals.values / r, measured=self.residuals.measured / r, unit="N"
        )
        return replace(
            self,
            estimates=estimates,
            covariance=self.covariance * np.outer(factors, factors),
            residuals=residuals,
            frame=regression.TABLE,
            periods=tuple(r * period for period in self.periods),
            travel=(r * self.travel[0], r * self.travel[1]),
        )

    def plant(self) -> Rigid:
        """Return the moving mass as a plant."""
        regression.require_table(self.frame, "the mass")
        return Rigid(mass=self["mass"].value)

    @property
    def levels(self) -> tuple[float, float, float]:
        """The Coulomb friction in the positive and negative direction, and the constant force of the drive.

        In motion, half the difference between the two levels cannot be distinguished from a constant force. It is
        attributed to friction up to `_MOST_ASYMMETRY` of the mean level; a larger one is a weight, such as that of a
        vertical axis.
        """
        if self.friction == "symmetric":
            return self["coulomb"].value, self["coulomb"].value, self["offset"].value
        positive, negative = self["coulomb_positive"].value, self["coulomb_negative"].value
        mean, half = 0.5 * (positive + negative), 0.5 * (positive - negative)
        return (mean, mean, half) if abs(half) > _MOST_ASYMMETRY * abs(mean) else (positive, negative, 0.0)

    def friction_block(self) -> Friction:
        """Return the friction as a block; a negative viscous or Coulomb part becomes 0."""
        regression.require_table(self.frame, "the friction")
        value = {estimate.name: max(0.0, estimate.value) for estimate in self.estimates}
        positive, negative, _ = self.levels
        if self.friction == "symmetric":
            return Coulomb(coulomb=value["coulomb"], viscous=value["viscous"])
        levels = {"coulomb_positive": max(0.0, positive), "coulomb_negative": max(0.0, negative)}
        return Directional(**{name: value[name] for name in NAMES["directional"] if name[:7] == "viscous"}, **levels)

    @property
    def is_pulled(self) -> bool:
        """True if the offset is large enough to indicate a constant force on the axis (see `pulls`)."""
        if self.friction == "symmetric":
            return regression.pulls(self["offset"], self["coulomb"].value)
        return self.levels[2] != 0.0

    def gravity(self) -> Gravity | None:
        """Return the constant force that acts on the table, or None if directional friction contains it."""
        regression.require_table(self.frame, "the offset")
        if self.friction == "directional" and not self.is_pulled:
            return None
        # the offset is the force of the drive, which balances the constant force on the table
        return Gravity(force=-self.levels[2])

    def position_force(self) -> ForceMap | None:
        """Return the position-dependent force over the travel of the log, or None if the log shows none."""
        regression.require_table(self.frame, "the force along the travel")
        if not self.periods:
            return None
        begin, end = self.travel
        places = np.linspace(begin, end, _MAP_ENTRIES)
        values = [self[name].value for name in place_names(self.periods)]
        row = -(place_columns(places, self.periods, 0.5 * (begin + end)) @ np.array(values))
        return ForceMap(
            row=cast(Number, tuple(float(f) for f in row)), begin=begin, spacing=(end - begin) / (_MAP_ENTRIES - 1)
        )


def identify_rigid(
    log: MotionLog,
    *,
    friction: str = "best",
    how: Preparation | None = None,
    folds: int = 5,
    dead_time: float | None = None,
) -> RigidFit:
    """Identify mass, friction, offset and dead time of a rigid drive from its inverse dynamics.

        symmetric:    force = mass a + viscous v + coulomb sign(v) + offset
        directional:  force = mass a + (viscous± v + coulomb± sign(v)),   ± the direction of v

    friction   "symmetric", "directional", or "best": the one with the lower information criterion
    how        filters and delays; the delay is then fixed.  Default: `Preparation()`, with the dead time as another
               unknown, since a wrong one would bias viscous friction
    folds      number of stretches in the cross-validation, each predicted by a fit of the others
    dead_time  initial value of the dead time in samples, without the half sample of the zero-order hold; default: 0

    Without `how` the log is fitted twice, in rows of 10 ms and of 5 ms. The finer rows are used if the others do not
    determine the mass to within 5 % and the finer ones are more precise. Errors include the disagreement of the two
    fits.

    With a set position, the set motion provides instruments (two-stage least squares): errors of the readings, and the
    reaction of the control to a disturbance, are not correlated with it.  Otherwise ordinary least squares is used.

    Standard errors are robust; those for a white residual are also returned.  Not suitable for an axis with significant
    elastic deformation (fit its frequency response), or near standstill (fit constant-speed runs).
    Raises NotIdentifiableError with what to measure next, LogError for a log that is too short.
    Sources: Janot, Gautier & Brunot 2019, with the force delayed by half a sample because of its hold; Young 2011 for
    instruments from the reference of a closed loop.
    """
    if friction not in (*FRICTIONS, "best"):
        raise ParameterError(f"friction = {friction!r} must be one of best, {', '.join(FRICTIONS)}")
    models = tuple(FRICTIONS) if friction == "best" else (friction,)
    if how is not None:
        return _identified(log, _moving(log, how), models, folds, judged=False)
    start = Preparation(delay=motion_log.HOLD + (dead_time or 0.0))
    # a log without motion is refused as one
    rows = [_moving(log, start)]
    with suppress(LogError, NotIdentifiableError):
        # ramps that last two or three rows tell little of a mass; finer rows may tell more
        step = max(1, round(_FINER_STEP / log.sample_time))
        rows.append(_moving(log, replace(start, cutoff=_FINER_CUTOFF, decimation=step)))
    fits: list[RigidFit] = []
    refusals: list[FeeddriveError] = []
    for tried in rows:
        try:
            fits.append(_identified(log, tried, models, folds, judged=True))
        except (LogError, NotIdentifiableError) as error:
            refusals.append(error)
    if not fits:
        raise refusals[0]
    if len(fits) == 1:
        return fits[0]
    usual, finer = fits
    if _doubt(usual) > SURE_MASS and _doubt(finer) < _doubt(usual):
        return beside(finer, usual.estimates)
    return beside(usual, finer.estimates)


def _moving(log: MotionLog, how: Preparation) -> Prepared:
    rows = motion_log.prepare(log, how)
    check_motion(log.name, rows.velocity, log.frame)
    return rows


def _doubt(fit: RigidFit) -> float:
    return fit["mass"].error / fit["mass"].value


def beside(fit: RigidFit, others: Iterable[Estimate]) -> RigidFit:
    """Return a fit with errors increased by its disagreement with other estimates from the same log, by their names."""
    named = {estimate.name: estimate for estimate in others}
    return widened(fit, (one.beside(named[one.name]) for one in fit.estimates if one.name in named))


def widened(fit: RigidFit, estimates: Iterable[Estimate]) -> RigidFit:
    """Return a fit with estimates in place of those of the same name, and the covariance by their errors."""
    named = {one.name: one for one in fit.estimates} | {one.name: one for one in estimates}
    all_of_them = tuple(named[one.name] for one in fit.estimates)
    wider = [new.error / one.error if one.error else 1.0 for one, new in zip(fit.estimates, all_of_them, strict=True)]
    return replace(fit, estimates=all_of_them, covariance=fit.covariance * np.outer(wider, wider))


def _identified(log: MotionLog, rows: Prepared, models: Sequence[str], folds: int, *, judged: bool) -> RigidFit:
    """Identify with the rows of one preparation; if `judged`, select rows and terms by evidence, and fit the delay."""
    used, instruments, terms = np.ones(rows.time.size, bool), None, Terms()
    if judged:
        instruments = instruments_of(log, rows)
        faster = _without_slow_rows(log, rows, instruments)
        if faster is not rows:
            rows, instruments = faster, instruments_of(log, faster)
        used = _without_pulses(log, rows, instruments)
        terms = _by_evidence(log, rows, used, instruments)
    fits = [_fit(log, rows, used, instruments, model, folds, terms, free=judged) for model in models]
    criterion = {fit.friction: fit.criterion[fit.friction] for fit in fits}
    best = min(fits, key=lambda fit: criterion[fit.friction])
    return replace(best, criterion=criterion)


@dataclass(frozen=True)
class Terms:
    """The forces besides those of mass and friction: a position-dependent force, and the elasticity of the axis.

        slope (x - middle) + Σ (sine sin 2πx/period + cosine cos 2πx/period) + bend d⁴x/dt⁴

    periods  the periods of the position-dependent force; infinite: proportional to the position
    bends    True to include the last term. Well below its resonance f, a two-mass axis requires the force
             M (a ± d²a/dt² / (2πf)²), a the acceleration: + for an encoder at the load, since the motor is then ahead
    suspected  True if least squares finds elasticity that instruments do not confirm; it may be due to quantization
    """

    periods: tuple[float, ...] = ()
    bends: bool = False
    suspected: bool = False

    @property
    def names(self) -> list[str]:
        """The names of the parameters."""
        return [*place_names(self.periods), *(["bend"] if self.bends else [])]

    def columns(self, log: MotionLog, rows: Prepared, position: np.ndarray) -> np.ndarray:
        """Return the columns of the terms in the rows of a fit, for the given position over time."""
        parts = [place_columns(position, self.periods, _middle(log)[2])]
        if self.bends:
            acceleration = rows.differenced(position)[1]
            parts.append(_twice(acceleration, log.sample_time)[:, None])
        whole = np.hstack(parts)
        return rows.reduced(whole.T).T if whole.shape[1] else np.zeros((rows.time.size, 0))

    def instruments(self, log: MotionLog, rows: Prepared, instruments: np.ndarray | None) -> np.ndarray | None:
        """Return the instruments, with those of the terms appended, which are computed from the set position."""
        if instruments is None or log.set_position is None or not self.names:
            return instruments
        added = self.columns(log, rows, log.set_position)
        sizes = np.linalg.norm(added, axis=0)
        return np.column_stack([instruments, added[:, sizes > 0.0] / sizes[sizes > 0.0]])


def _twice(values: np.ndarray, T: float) -> np.ndarray:
    return motion_log.central_difference(motion_log.central_difference(values, T), T)


def place_names(periods: Sequence[float]) -> list[str]:
    """Return the names of the parameters of a position-dependent force."""
    names = []
    for period in periods:
        names += ["slope"] if np.isinf(period) else ["sine", "cosine"]
    return names


def place_columns(position: np.ndarray, periods: Sequence[float], middle: float) -> np.ndarray:
    """Return the columns of a position-dependent force, shape (n, p): x - middle, or sin and cos of 2π x / period."""
    columns = []
    for period in periods:
        turned = 2.0 * np.pi * position / period
        columns += [position - middle] if np.isinf(period) else [np.sin(turned), np.cos(turned)]
    return np.column_stack(columns) if columns else np.zeros((position.size, 0))


def _middle(log: MotionLog) -> tuple[float, float, float]:
    begin, end = float(np.min(log.position)), float(np.max(log.position))
    return begin, end, 0.5 * (begin + end)


def _by_evidence(log: MotionLog, rows: Prepared, used: np.ndarray, instruments: np.ndarray | None) -> Terms:
    """Return the terms that the log supports by evidence.

    The candidates are the elasticity of the axis, a force proportional to the position, and a force that is periodic in
    position. Its period is one turn of a rotary axis (the weight of an arm); on other axes it is the one that explains
    most of the residual. A term is accepted if it lowers the information criterion by `_EVIDENCE`, exceeds `_SURE_TERM`
    robust standard errors, and does not hide the mass (see `_hides`). Elasticity must be confirmed by instruments; if
    only least squares finds it, it is kept as a term while the others are tested, and then removed.
    """
    begin, end, _ = _middle(log)
    columns = columns_of(rows, "directional")
    columns = columns[:, np.any(columns[used] != 0.0, axis=0)]
    chosen, suspected = Terms(), False
    best = _solve(log, rows, columns, rows.how.delay, free=True, instruments=instruments, used=used)
    criterion = regression.information(best.residual, best.values.size)
    for kind in ("bend", "slope", "period"):
        tried = replace(chosen, bends=True)
        if kind != "bend":
            period = np.inf if kind == "slope" else 2.0 * np.pi
            if kind == "period" and log.frame is regression.TABLE:
                # the low pass of the rows shrinks a constant, and so a position
                places = rows.reduced(log.position) / rows.constant
                period = _strongest(places[used], best.columns, best.residual, end - begin)
            if not period or (np.isfinite(period) and end - begin < _LEAST_TURN * period):
                continue
            tried = replace(chosen, periods=(*chosen.periods, period))
        added = tried.columns(log, rows, log.position)
        wider = np.column_stack([columns, added])
        if _dependent(wider[used]) or _hides(columns[used], wider[used]):
            continue
        seen = tried.instruments(log, rows, instruments)
        solved = _solve(log, rows, wider, rows.how.delay, free=True, instruments=seen, used=used)
        lower = regression.information(solved.residual, solved.values.size)
        new = [columns.shape[1] + k for k, name in enumerate(tried.names) if name not in chosen.names]
        values, covariance = solved.values[new], solved.covariance[np.ix_(new, new)]
        # without any residual there is no error either, and no evidence
        known = np.linalg.matrix_rank(covariance) == len(new)
        sure = known and float(values @ np.linalg.solve(covariance, values)) > _SURE_TERM**2
        if not (criterion - lower > _EVIDENCE and sure):
            continue
        # through the control, counts of the readings look like bending; instruments do not hold them
        suspected = suspected or (kind == "bend" and not solved.instrumented)
        chosen, criterion, best = tried, lower, solved
    return replace(chosen, bends=chosen.bends and not suspected, suspected=suspected)


def _dependent(columns: np.ndarray) -> bool:
    """Return True if a column is a combination of the others, up to a part below `LEAST_INDEPENDENT` of its norm."""
    sizes = np.linalg.norm(columns, axis=0)
    if np.any(sizes == 0.0):
        return True
    variance = np.diag(regression.inverse_gram(columns / sizes))
    return bool(np.any(~(variance < 1.0 / LEAST_INDEPENDENT**2)))


def _hides(columns: np.ndarray, wider: np.ndarray) -> bool:
    """Return True if the added columns of `wider` increase the variance of the mass by a factor above `_MOST_LOSS`.

    The mass is the first column. On a circle x'' = -w² x: a force proportional to the position is then almost
    indistinguishable from the inertial force.
    """
    alone, beside = (float(regression.inverse_gram(x)[0, 0]) for x in (columns, wider))
    # negated, so that NaN counts
    return not beside <= _MOST_LOSS * alone


def _strongest(position: np.ndarray, columns: np.ndarray, residual: np.ndarray, travel: float) -> float:
    """Return the period in position that explains most of the residual beyond the columns, or 0 if none fits."""
    if travel <= 0.0:
        return 0.0
    # between the longest that repeats in the travel and the shortest whose rows still show its shape
    step = float(np.quantile(np.abs(np.diff(position)), 0.9))
    most = min(0.25 / max(step, 1e-4 * travel), _MOST_REPEATS / travel)
    width = 0.25 / travel
    orders = np.arange(_LEAST_REPEATS / travel, most, width)
    basis = np.linalg.qr(columns)[0]
    best = 0.0
    for _ in range(_FINER):
        if orders.size == 0:
            return 0.0
        angle = 2.0 * np.pi * position[:, None] * orders
        sine, cosine = (wave - basis @ (basis.T @ wave) for wave in (np.sin(angle), np.cos(angle)))
        a, b = np.sum(sine**2, axis=0), np.sum(cosine**2, axis=0)
        c, u, v = np.sum(sine * cosine, axis=0), residual @ sine, residual @ cosine
        # the decrease of the sum of squares by both waves at once
        gain = (b * u * u - 2.0 * c * u * v + a * v * v) / np.maximum(a * b - c * c, 1e-9 * a * b)
        best = float(orders[int(np.argmax(gain))])
        width /= 10.0
        orders = best + width * np.arange(-10, 11)
        orders = orders[orders >= _LEAST_REPEATS / travel]
    return 1.0 / best


def columns_of(rows: Prepared, friction: str) -> np.ndarray:
    """Return the columns of the inverse dynamics, shape (n, p), in the order of `NAMES`."""
    curve = regression.steady_curve(FRICTIONS[friction])
    # the curve is linear in its parameters, so that its slopes at 0 are the columns
    _, slopes = curve.at(dict.fromkeys(curve.names, 0.0), velocity=rows.filtered)
    columns = {"mass": rows.acceleration, "offset": rows.constant}
    columns |= dict(zip(curve.names, rows.reduced(slopes.T), strict=True))
    return np.column_stack([columns[name] for name in NAMES[friction]])


@dataclass(frozen=True)
class _Solved:
    """A solution of the inverse dynamics: values of the columns, and the delay of the force in samples.

    columns    regressors of the values; with `free`, the last one is minus the derivative of the force by the delay
    projected  the part of the columns that the instruments explain, shape (n, p)
    residual   force - columns · values, shape (n,)
    doubt      difference in samples between the delays found by weak instruments and by least squares
    """

    values: np.ndarray
    delay: float
    columns: np.ndarray
    projected: np.ndarray
    force: np.ndarray
    free: bool
    instrumented: bool
    doubt: float = 0.0

    @property
    def residual(self) -> np.ndarray:
        return self.force - self.columns @ self.values

    @property
    def covariance(self) -> np.ndarray:
        """The robust covariance; `doubt` is added as an error of the delay and of all values correlated with it."""
        plain = covariance_of(self.projected, self.residual)
        if not self.doubt:
            return plain
        along = regression.inverse_gram(self.columns)[:, -1]
        moved = self.doubt * along / along[-1]
        return plain + np.outer(moved, moved)


def instruments_of(log: MotionLog, rows: Prepared) -> np.ndarray | None:
    """Return instruments in these rows, columns of unit norm, shape (n, q); None if there is no set position.

    They are the set velocity in each direction, the set acceleration and the set jerk, each after the low passes of
    `FILTERED`, which span the usual responses of a position loop, and indicators of the two directions of motion.
    """
    if log.set_position is None:
        return None
    from scipy.signal import lfilter  # takes a second to import

    velocity, acceleration = rows.differenced(log.set_position)
    motion = np.array([velocity, acceleration, motion_log.central_difference(acceleration, log.sample_time)])
    forward = rows.filtered > 0.0
    signals = [forward.astype(float), (~forward).astype(float)]
    for constant in FILTERED:
        memory = np.exp(-log.sample_time / constant) if constant else 0.0
        v, a, j = np.asarray(lfilter([1.0 - memory], [1.0, -memory], motion))
        signals += [v * forward, v * ~forward, a, j]
    columns = rows.reduced(np.array(signals)).T
    sizes = np.linalg.norm(columns, axis=0)
    return columns[:, sizes > 0.0] / sizes[sizes > 0.0]


def _projected(columns: np.ndarray, instruments: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the columns as predicted by instruments in rows that were not used for the prediction.

        X̂(block) = Z(block) (Z'Z)⁻¹ Z'X of the other blocks,   projected = X̂ (X̂'X̂)⁻¹ X̂'X

    A prediction from the same rows would contain a fraction q / n of their noise, and hence of the bias of least
    squares. The second result is True if the instruments are strong: F = R² / (1 - R²) (n - p) > `_STRONG` for each
    column given the others. If no usable projection exists, the original columns and False are returned.
    Sources:
    Angrist, Imbens & Krueger 1999 (jackknife instruments; here by blocks, since the noise is autocorrelated); Staiger &
    Stock 1997.
    """
    n, p = columns.shape
    edges = np.linspace(0, n, BLOCKS + 1).astype(int)
    blocks = [slice(int(begin), int(end)) for begin, end in pairwise(edges)]
    grams = [(instruments[b].T @ instruments[b], instruments[b].T @ columns[b]) for b in blocks]
    whole = sum(gram for gram, _ in grams), sum(right for _, right in grams)
    # instruments that are nearly alike share what they explain
    ridge = _RANK * np.eye(instruments.shape[1])
    predicted = np.concatenate(
        [
            instruments[b] @ np.linalg.solve(whole[0] - gram + ridge, whole[1] - right)
            for b, (gram, right) in zip(blocks, grams, strict=True)
        ]
    )
    sizes = np.linalg.norm(predicted, axis=0)
    if np.any(sizes == 0.0):
        return columns, False
    basis, triangle = np.linalg.qr(predicted / sizes)
    if np.min(np.abs(np.diag(triangle))) < _RANK:
        return columns, False
    kept = basis @ (basis.T @ columns)
    gram = (kept / np.linalg.norm(columns, axis=0)).T @ (kept / np.linalg.norm(columns, axis=0))
    if np.linalg.cond(gram) > _MOST_CONDITION:
        return columns, False
    full, part = (np.diag(regression.inverse_gram(x)) for x in (columns, kept))
    share = np.clip(full / part, 0.0, 1.0 - 1e-12)
    return kept, bool(np.all(share / (1.0 - share) * (n - p) > _STRONG))


def _solve(
    log: MotionLog,
    rows: Prepared,
    columns: np.ndarray,
    delay: float,
    *,
    free: bool,
    instruments: np.ndarray | None,
    used: slice | np.ndarray = slice(None),
) -> _Solved:
    """Solve force(k - delay) = columns · values in the rows `used`; if `free`, also fit the delay by Gauss-Newton."""
    begin, inner = delay, columns[used]
    force, wide, projected, values = (np.zeros(0),) * 4
    strong, doubt = True, 0.0
    seen = None if instruments is None else instruments[used]
    for turn in range(_TURNS):
        wide = inner
        if not free:
            force = rows.force_with(log.force, delay)[used]
        else:
            sooner, force, later = rows.forces_about(delay)[:, used]
            slope = 0.5 * (later - sooner)
            # a motion of one frequency: a delay cannot be told from less mass and more damping
            if not np.any(slope) or _left(np.linalg.qr(inner)[0], slope) < LEAST_INDEPENDENT:
                free = False
            else:
                wide = np.column_stack([inner, -slope])
        strong, projected, doubt = True, wide, 0.0
        if seen is not None:
            projected, strong = _projected(wide, seen)
        values = np.linalg.lstsq(projected, force, rcond=None)[0]
        if not strong:
            weak, projected = values, wide
            values = np.linalg.lstsq(wide, force, rcond=None)[0]
            doubt = float(np.clip(weak[-1] - values[-1], -_LATEST_DOUBT, _LATEST_DOUBT)) if free else 0.0
        step = float(values[-1]) if free else 0.0
        if abs(step) < _SETTLED or turn == _TURNS - 1:
            break
        delay += float(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP))
        if abs(delay - motion_log.HOLD) > REACH:
            # no minimum nearby: the delay of the caller is as good as any
            return _solve(log, rows, columns, begin, free=False, instruments=instruments, used=used)
    return _Solved(values, delay, wide, projected, force, free, strong and seen is not None, doubt)


def _without_slow_rows(log: MotionLog, rows: Prepared, instruments: np.ndarray | None) -> Prepared:
    """Return the rows without those near standstill if friction there deviates from Coulomb plus viscous friction.

    From `_SLOW[0]` of the largest speed downwards, the force in each class of speeds is predicted by a fit to the
    faster rows. The signed residual is averaged over each passage through the class. In the first class whose mean over
    the passages differs from 0 at a significance level of `_DEVIATES` (Student's t), friction deviates from the model;
    all rows slower than the upper bound of this class are left out.
    """
    from scipy.special import stdtrit  # takes a second to import

    speed = np.abs(rows.velocity)
    top = float(np.max(np.abs(rows.filtered)))
    columns = columns_of(rows, "directional")
    columns = columns[:, np.any(columns != 0.0, axis=0)]
    how, force = rows.how, None
    faster = _SLOW[0]
    for slower in _SLOW[1:]:
        above = speed >= faster * top
        within = (speed >= slower * top) & ~above
        # few passages show no scatter: the class reaches further down
        if np.count_nonzero(above) < 4 * columns.shape[1] or len(_runs(within)) < _PASSAGES:
            continue
        if force is None:
            force = _solve(log, rows, columns, how.delay, free=True, instruments=instruments).force
        used = columns[above]
        if np.linalg.matrix_rank(used / np.maximum(np.linalg.norm(used, axis=0), 1e-300), tol=1e-3) < used.shape[1]:
            continue
        values = np.linalg.lstsq(used, force[above], rcond=None)[0]
        signed = np.sign(rows.velocity) * (force - columns @ values)
        passages = [signed[run].mean() for run in _runs(within)]
        # four passages may agree by chance, but not by more than the residual of the faster rows lets them
        usual = float(np.std(signed[above])) / np.sqrt(np.count_nonzero(within) / len(passages))
        error = max(float(np.std(passages, ddof=1)), usual) / np.sqrt(len(passages))
        least = float(stdtrit(len(passages) - 1, 1.0 - 0.5 * _DEVIATES)) * error
        if abs(float(np.mean(passages))) > max(least, _EXACT * float(np.sqrt(np.mean(force**2)))):
            try:
                return motion_log.prepare(log, replace(how, rest=faster))
            except NotIdentifiableError:
                return rows
        faster = slower
    return rows


def _without_pulses(log: MotionLog, rows: Prepared, instruments: np.ndarray | None) -> np.ndarray:
    """Return a mask of the rows that excludes those in which an unknown force acts for a short time.

    The residual of such a row exceeds `_PULSE` robust standard deviations, 1.4826 · median |r - median r|. Its
    neighbors, into which the low-pass filter spreads the force, are excluded, too. The fit is repeated without these
    rows until no more are found. All rows are kept if more than `_MOST_PULSES` of them would be excluded, since this is
    then the usual residual, or if a parameter depends on the excluded rows (see `_needs`), such as the ramps of an
    elastic axis.
    """
    columns = columns_of(rows, "directional")
    columns = columns[:, np.any(columns != 0.0, axis=0)]
    everything = np.ones(rows.time.size, bool)
    used = everything
    for _ in range(_PULSE_TURNS):
        if np.any(np.all(columns[used] == 0.0, axis=0)):
            return everything
        solved = _solve(log, rows, columns, rows.how.delay, free=True, instruments=instruments, used=used)
        left = rows.force_with(log.force, solved.delay) - columns @ solved.values[: columns.shape[1]]
        away = np.abs(left - np.median(left[used]))
        least = _EXACT * float(np.sqrt(np.mean(solved.force**2)))
        far = away > max(_PULSE * regression.median_spread(away[used]), least)
        # a row on both sides: the decimating low pass spreads a pulse by some 10 ms
        near = np.convolve(far, np.ones(2 * _PULSE_SPREAD + 1), "same") > 0.0
        if np.mean(near) > _MOST_PULSES or _needs(columns, near):
            return everything
        if np.array_equal(~near, used):
            break
        used = ~near
    return used


def _needs(columns: np.ndarray, left_out: np.ndarray) -> bool:
    """Return True if the value of a column is determined mainly by the rows `left_out`.

    Without them the variance of the value, from (X'X)⁻¹, increases by a factor above `_MOST_LOSS`.
    """
    whole, rest = (np.diag(regression.inverse_gram(x)) for x in (columns, columns[~left_out]))
    # negated, so that NaN of columns that are left empty counts
    return not bool(np.all(rest <= _MOST_LOSS * whole))


def _runs(flags: np.ndarray) -> list[slice]:
    """Return the ranges of successive true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [slice(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def _fit(
    log: MotionLog,
    rows: Prepared,
    used: np.ndarray,
    instruments: np.ndarray | None,
    friction: str,
    folds: int,
    terms: Terms,
    *,
    free: bool,
) -> RigidFit:
    names = (*NAMES[friction], *terms.names)
    columns = np.column_stack([columns_of(rows, friction), terms.columns(log, rows, log.position)])
    check_columns(log.name, columns[used], names)
    seen = terms.instruments(log, rows, instruments)
    solved = _solve(log, rows, columns, rows.how.delay, free=free, instruments=seen, used=used)
    bent = np.zeros(solved.values.size)
    if free and not terms.bends:
        bent = _shift_by_bending(log, rows, used, terms, solved, columns, instruments)
    columns = columns[used]
    p = len(names)
    values, residual, force = solved.values[:p], solved.residual, solved.force
    # rows that do not count may leave too few for as many stretches
    folds = min(folds, max(2, force.size // (4 * regression.GAP)))
    counted, shifts = _with_counts(log, rows, used, solved, names)
    size = float(np.sqrt(np.mean(force**2)))
    # the bias due to quantization is not removed but counts as an error, and so does that of doubtful bending
    robust = solved.covariance + np.outer(shifts, shifts) + np.outer(bent, bent)
    ols = regression.errors(regression.ols_covariance(solved.projected, residual))
    frame = log.frame
    special = {"mass": frame.inertia, "viscous": frame.viscous, "slope": f"{frame.force}/{frame.position}"}
    special["bend"] = f"{frame.inertia} s^2"
    units = [special.get(name.split("_")[0], frame.force) for name in names]
    estimates = tuple(
        Estimate(*row) for row in zip(names, values, units, regression.errors(robust)[:p], ols[:p], strict=True)
    )
    # at least as wide as the white ones, and not more than a residual with a long memory makes them
    widened = float(
        np.clip(
            np.max(regression.errors(solved.covariance)[:p] / np.maximum(ols[:p], np.finfo(float).tiny)), 1.0, _WIDEST
        )
    )
    check_mass(log.name, estimates[0].value, estimates[0].error, estimates[0].unit)
    late, _ = _dead_time(solved)
    error, white = (float(regression.errors(robust)[-1]), float(ols[-1])) if solved.free else (0.0, 0.0)
    return RigidFit(
        name=log.name,
        friction=friction,
        estimates=estimates,
        covariance=robust[:p, :p],
        residuals=Residuals(residual, force, float(np.linalg.cond(columns)), frame.force),
        validation=regression.cross_validated(columns, force, folds, frame.force, widened),
        criterion={friction: regression.information(residual, p)},
        time=rows.time[used],
        frame=frame,
        dead_time=Estimate("dead_time", late, "samples", error, white),
        how=replace(rows.how, delay=motion_log.HOLD + late),
        instruments=solved.instrumented,
        periods=terms.periods,
        bends=terms.bends,
        travel=_middle(log)[:2],
        left_out=rows.left_out | {"pulse": int(np.sum(~used))},
        # quantization acts alike in used and in unused rows
        counts=(counted / size, counted / size),
    )


def _shift_by_bending(
    log: MotionLog,
    rows: Prepared,
    used: np.ndarray,
    terms: Terms,
    solved: _Solved,
    columns: np.ndarray,
    instruments: np.ndarray | None,
) -> np.ndarray:
    """Return by how much elasticity that is not a term of the fit shifts each of its values.

    The shift d is that of one more column, reduced by what chance makes of it: d² - |error² - error_wider²|, or 0, as
    between two fits of which one is more precise (Hausman 1978). It is not reduced where elasticity is suspected.

    columns  the columns of the fit in all rows
    """
    bending = replace(terms, bends=True)
    bent = bending.columns(log, rows, log.position)[:, -1:]
    if terms.suspected:
        wide = np.column_stack([solved.columns, bent[used]])
        return np.linalg.lstsq(wide, solved.force, rcond=None)[0][:-1] - solved.values
    wider = np.column_stack([columns, bent])
    none = np.zeros(solved.values.size)
    if _dependent(wider[used]):
        return none
    seen = bending.instruments(log, rows, instruments)
    # counts that the control answers look like bending to least squares
    beside = _solve(log, rows, wider, solved.delay, free=solved.free, instruments=seen, used=used)
    if beside.free != solved.free or beside.instrumented != solved.instrumented:
        return none
    kept = np.delete(np.arange(beside.values.size), columns.shape[1])
    shift = beside.values[kept] - solved.values
    chance = np.abs(np.diag(solved.covariance) - np.diag(beside.covariance)[kept])
    return np.sqrt(np.maximum(shift**2 - chance, 0.0)) * np.sign(shift)


def _with_counts(
    log: MotionLog, rows: Prepared, used: np.ndarray, solved: _Solved, names: Sequence[str]
) -> tuple[float, np.ndarray]:
    """Return the RMS residual due to quantization, and the bias of each value; 0 if readings are not quantized.

    A second quantization is simulated by adding uniformly distributed errors to the readings; its effect on the columns
    equals that of the first one.
    Source: Cook & Stefanski 1994 (SIMEX, its first step).
    """
    count = motion_log.count_of(log.position)
    if count == 0.0:
        return 0.0, np.zeros(solved.values.size)
    # a fixed seed: the same log gives the same errors
    random = np.random.default_rng(0)
    velocity = rows.velocity[used]
    ways = {"viscous_positive": velocity > 0.0, "viscous_negative": velocity < 0.0}
    residuals, shifts = [], []
    for _ in range(_DRAWN):
        slow, changes = rows.differenced(count * random.uniform(-0.5, 0.5, log.position.size))
        bends = _twice(changes, log.sample_time) if "bend" in names else changes
        changes, slow, bends = rows.reduced(np.array([changes, slow, bends]))[:, used]
        in_column = {"mass": changes, "bend": bends} | {
            name: slow * ways.get(name, 1.0) for name in names if name.startswith("viscous")
        }
        noise = np.column_stack([in_column.get(name, np.zeros_like(slow)) for name in names])
        if solved.free:
            # the slope of the force holds no reading
            noise = np.column_stack([noise, np.zeros(noise.shape[0])])
        residuals.append(np.mean((noise @ solved.values) ** 2))
        # the projected columns span what the instruments explain, and are the columns without instruments
        inner = solved.projected if solved.instrumented else solved.columns + noise
        shifts.append(np.linalg.solve(inner.T @ (solved.columns + noise), inner.T @ solved.force) - solved.values)
    return float(np.sqrt(np.mean(residuals))), np.sqrt(np.mean(np.square(shifts), axis=0))


def covariance_of(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the robust covariance of the inverse dynamics; each error is the larger of two estimates.

        plain      S of the scores z(k), `robust_covariance`
        recolored  S of z(k) - rho z(k-1), divided by (1 - rho)²;  rho = Σ z(k) z(k-1) / Σ z(k)²

    Each may be too small: the window of the plain one truncates a slowly decaying correlation; the recolored one
    removes this correlation first, but encoder noise makes its rho too small.
    Sources: Newey & West 1987; Andrews & Monahan 1992; the maximum of both is ours.
    """
    plain = regression.robust_covariance(columns, residual)
    scores = regression.scores_of(columns[None], residual[None])
    rho = np.sum(scores[1:] * scores[:-1], axis=0) / np.maximum(np.sum(scores**2, axis=0), np.finfo(float).tiny)
    rho = np.clip(rho, -MOST_MEMORY, MOST_MEMORY)
    n, p = columns.shape
    whitened = np.diag(regression.long_run(scores[1:] - rho * scores[:-1])) * n / max(n - p, 1)
    ratio = whitened / (1.0 - rho) ** 2 / np.maximum(np.diag(plain), np.finfo(float).tiny)
    wider = np.sqrt(np.maximum(ratio, 1.0))
    return plain * np.outer(wider, wider)


def check_motion(name: str, velocity: np.ndarray, frame: Frame) -> None:
    """Raise NotIdentifiableError for a log without motion, or with motion in one direction only."""
    top = float(np.max(np.abs(velocity)))
    # below 5 % of the top speed an axis at rest with encoder noise would count as moving
    forward, backward = (int(np.sum(sign * velocity > 0.05 * top)) for sign in (1.0, -1.0))
    moving = forward + backward
    if not moving:
        raise NotIdentifiableError(f"{name}: the axis does not move; record a move to and fro")
    share = min(forward, backward) / moving
    if share < LEAST_REVERSAL:
        towards = "smaller" if backward < forward else "larger"
        raise NotIdentifiableError(
            f"{name}: not identifiable: only {Quantity(share, 'share'):2} of the motion goes towards {towards} "
            f"positions, at least {Quantity(LEAST_REVERSAL, 'share'):6} are needed: in one direction friction cannot "
            "be told from a constant force; record next a move to and fro over the same travel, at "
            f"{Quantity(top, frame.velocity):3} or more"
        )


def check_columns(name: str, columns: np.ndarray, names: tuple[str, ...]) -> None:
    """Raise NotIdentifiableError for a column that depends linearly on the others."""
    sizes = np.linalg.norm(columns, axis=0)
    for i, column_name in enumerate(names):
        if sizes[i] == 0.0:
            raise NotIdentifiableError(f"{name}: not identifiable: {_next(column_name)}")
        others = np.delete(columns, i, axis=1)
        left = columns[:, i] - others @ np.linalg.lstsq(others, columns[:, i], rcond=None)[0]
        independent = float(np.linalg.norm(left)) / float(sizes[i])
        if independent < LEAST_INDEPENDENT:
            raise NotIdentifiableError(
                f"{name}: {column_name} is not identifiable: {Quantity((1.0 - independent), 'share')} of its column is "
                f"a sum of the others; {_next(column_name)}"
            )


def check_mass(name: str, value: float, error: float, unit: str) -> None:
    """Raise NotIdentifiableError for a mass that is not positive or too uncertain."""
    if value < 0.0 and error < LARGEST_ERROR * -value:
        raise NotIdentifiableError(
            f"{name}: the sign of force or position is inverted: the axis moves against the force, as a mass of "
            f"{Quantity(value, unit, error)} would; invert one of them by a factor of -1, as --force 'f*-1' or "
            "--torque 'm*-1' on the command line, factor = -1.0 in a file for --channels"
        )
    if value <= 0.0 or error > LARGEST_ERROR * value:
        raise NotIdentifiableError(
            f"{name}: mass is not identifiable: {Quantity(value, unit):3} with a standard error of "
            f"{Quantity(error, unit):2}; {_next('mass')}"
        )


def _next(parameter: str) -> str:
    if parameter.startswith(("mass", "inertia")):
        return f"the log holds hardly any acceleration; {MORE_RAMPS}"
    if parameter.startswith("viscous"):
        return "the speed hardly changes; record next moves at three speeds at least, in both directions"
    return "record next moves at several speeds in both directions, with ramps between them"


REACH = 20  # samples to both sides that are tried
LATEST = 5e-3  # s: a force that acts later than that does not belong to this clock
CLEAR = 0.9  # largest ratio of the residuals of two delays at which the better one counts as certain
# s: unknown forces and counts shift the delay of a closed loop by as much
_EARLY = 1e-3
_CERTAIN = 4.0  # joint standard errors by which the delays of two halves differ if the clocks drift
_FASTER = (
    0.03  # of the largest speed: rows above it decide whether a delay that no drive has is a fault of the recorder
)
_DRIFT = 2  # times that, and samples, by which the delays of the two halves of a log differ if they drift


@dataclass(frozen=True, eq=False, repr=False)
class DelayFit(Result):
    """The dead time in samples, without the half sample of the zero-order hold, with its standard error.

    delays, residual  tried delays in samples, and the relative residual of the inverse dynamics with each, both of
                      shape (m,)
    """

    name: str
    dead_time: float
    error: float
    delays: np.ndarray
    residual: np.ndarray
    sample_time: float

    @property
    def nearest(self) -> int:
        """The whole number of samples with the smallest residual."""
        return int(self.delays[np.argmin(self.residual)])

    @property
    def clear(self) -> bool:
        """True if the residual of the best delay is 10 % smaller than without delay."""
        return self.tells(self.nearest, 0.0)

    def tells(self, better: float, other: float) -> bool:
        """Return True if the residual of the inverse dynamics at the delay `better` is 10 % smaller than at `other`.

        This test is also used for a ragged residual: if the force is mostly due to quantization, the delay with the
        smallest residual gives the better mass, whatever the true delay is.
        """
        return self.left(better) < CLEAR * self.left(other)

    def left(self, samples: float) -> float:
        """Return the relative residual of the inverse dynamics at a delay, interpolated between whole samples."""
        return float(np.interp(samples, self.delays, self.residual))

    def table(self) -> Table:
        """Return a table of the residuals at the delays around the best one."""
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

        force(k - 1/2 - dead_time) = inverse dynamics(k),   for the dead time with the smallest residual

    Whole samples are tried; near the best one the delay is an additional parameter of the least squares, with the
    derivative of the force as its column, which gives the fractional part and its standard error.  The logged force
    must be the one commanded in the same sample.

    Do not rely on it alone in a closed loop: there the force reacts to disturbances, and part of that reaction is
    mistaken for a delay. This error grows with the residual of the model.  `refine` then decides between whole samples.

    clocks  True if an impossible delay is an error; False if the law proves that both channels have the same clock

    Raises NotIdentifiableError if the delay is negative, exceeds 5 ms, or drifts: force and position were then recorded
    on two clocks.
    """
    how = replace(how or Preparation(), delay=motion_log.HOLD)
    try:
        return _delay(log, friction, how, clocks=clocks)
    except NotIdentifiableError as refusal:
        # friction that holds an axis while the force changes looks like a force on another clock: the log is refused
        # only if its faster rows say so, too
        try:
            return _delay(log, friction, replace(how, rest=max(how.rest, _FASTER)), clocks=clocks)
        except (LogError, NotIdentifiableError):
            raise refusal from None


def _delay(log: MotionLog, friction: str, how: Preparation, *, clocks: bool) -> DelayFit:
    """Find the delay in the rows of one preparation; for the rest see `find_delay`."""
    delays = np.arange(-REACH, REACH + 1)
    base = motion_log.prepare(log, how)
    columns = columns_of(base, friction)
    # a direction without motion has an empty column of friction
    columns = columns[:, np.any(columns != 0.0, axis=0)]
    basis = np.linalg.qr(columns)[0]
    # the force is shifted and not the motion, so that the columns and their factorization serve all delays
    forces = base.reduced(np.array([motion_log.delayed(log.force, motion_log.HOLD + d) for d in delays]))
    residual = np.array([_left(basis, force) for force in forces])
    _check_slope(log, basis, forces, residual)
    instruments = instruments_of(log, base)
    if instruments is not None and _projected(columns, instruments)[1]:
        # what the set motion explains of the force holds no reaction of the control to a disturbance
        residual = _explained_left(columns, forces, instruments)
    best = int(np.argmin(residual))

    def dead_time_in(part: slice | np.ndarray, delay: int) -> tuple[float, float]:
        kept = columns[:, np.any(columns[part] != 0.0, axis=0)]
        start = motion_log.HOLD + delay
        return _dead_time(_solve(log, base, kept, start, free=True, instruments=instruments, used=part))

    if clocks:
        # with all rows: clocks that differ leave a residual that looks like pulses
        _check(log, int(delays[best]), delays, residual, dead_time_in(slice(None), int(delays[best]))[1])
        _check_drift(log, columns, forces, delays, instruments, dead_time_in)
    # an unknown force of short duration is no evidence of a delay
    late, error = dead_time_in(_without_pulses(log, base, instruments), int(delays[best]))
    return DelayFit(log.name, late, error, delays, residual, log.sample_time)


def _dead_time(solved: _Solved) -> tuple[float, float]:
    """Return the dead time in samples, without that of the zero-order hold, and its standard error (0 if fixed)."""
    late = solved.delay - motion_log.HOLD
    if not solved.free:
        return late, 0.0
    return late + float(solved.values[-1]), float(regression.errors(solved.covariance)[-1])


def _explained_left(columns: np.ndarray, forces: np.ndarray, instruments: np.ndarray) -> np.ndarray:
    """Return the relative residual of each force, shape (m,), in the space spanned by the instruments."""
    u, s, _ = np.linalg.svd(instruments, full_matrices=False)
    basis = u[:, s > np.sqrt(_RANK) * s[0]]
    inner, explained = np.linalg.qr(basis.T @ columns)[0], forces @ basis
    off = explained - (explained @ inner) @ inner.T
    return np.linalg.norm(off, axis=1) / np.maximum(np.linalg.norm(explained, axis=1), np.finfo(float).tiny)


def _left(basis: np.ndarray, force: np.ndarray) -> float:
    """Return the relative residual of the force after projection on the columns."""
    off = force - basis @ (basis.T @ force)
    size = float(np.linalg.norm(force))
    return float(np.linalg.norm(off)) / size if size > 0.0 else np.nan


def _check_slope(log: MotionLog, basis: np.ndarray, forces: np.ndarray, residual: np.ndarray) -> None:
    """Raise NotIdentifiableError for a motion of one frequency, where a delay has the effect of less mass and more
    damping.
    """
    if not np.all(np.isfinite(residual)):
        raise NotIdentifiableError(
            f"{log.name}: the force is 0 wherever the axis moves: record the commanded force next, on the same clock"
        )
    middle = len(forces) // 2
    slope = forces[middle + 1] - forces[middle - 1]
    independent = _left(basis, slope) if np.any(slope) else 0.0
    if independent < LEAST_INDEPENDENT:
        raise NotIdentifiableError(
            f"{log.name}: the delay of the force is not identifiable: the motion has nearly one frequency only, where "
            f"a delay acts like less mass and more damping ({Quantity(independent, 'share'):2} of its effect is "
            f"independent, at least {Quantity(LEAST_INDEPENDENT, 'share'):6} are needed); record next moves to and fro "
            "at constant speeds, with ramps between"
        )


def _check(log: MotionLog, best: int, delays: np.ndarray, residual: np.ndarray, error: float = 0.0) -> None:
    """Raise NotIdentifiableError for a delay that no drive can have; `error` is its standard error in samples."""
    at_zero = float(residual[np.flatnonzero(delays == 0)[0]])
    # otherwise there is no evidence for a delay other than 0
    clear = float(np.min(residual)) < CLEAR * at_zero and at_zero - float(np.min(residual)) > _rough(residual)
    # what is left of a disturbance may move a delay by its error
    late = (best - _CERTAIN * error) * log.sample_time > LATEST
    early = best < -1 and -(best + _CERTAIN * error) * log.sample_time > _EARLY
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
    """Return twice the largest decrease of a residual going from its minimum toward longer or shorter delays.

    Around the true delay a residual increases on both sides. If quantization enters the force through a velocity gain,
    the residual is as ragged as the force, and its minimum says nothing about the offset of the clocks.
    """
    best = int(np.argmin(residual))
    sides = residual[best:], residual[best::-1]
    return 2.0 * float(max(np.max(np.maximum.accumulate(side) - side) for side in sides))


def _trails(log: MotionLog) -> bool:
    """Return True if the set position lags behind the position: (x_set - x) v < 0 on average."""
    if log.set_position is None:
        return False
    return float(np.mean((log.set_position - log.position) * np.gradient(log.set_position))) < 0.0


def _check_drift(
    log: MotionLog,
    columns: np.ndarray,
    forces: np.ndarray,
    delays: np.ndarray,
    instruments: np.ndarray | None,
    dead_time_in: Callable[[slice, int], tuple[float, float]],
) -> None:
    """Raise NotIdentifiableError if the delays in the two halves of a log differ, which indicates two clocks.

    dead_time_in  function that returns dead time and error (samples) in a slice of the rows, starting from a delay
    """
    half = columns.shape[0] // 2
    halves = (slice(0, half), slice(half, None))
    if instruments is None:
        left = [np.array([_left(np.linalg.qr(columns[h])[0], force[h]) for force in forces]) for h in halves]
    else:
        left = [_explained_left(columns[h], forces[:, h], instruments[h]) for h in halves]
    first, second = (int(np.argmin(residual)) for residual in left)
    other = left[0][second], left[1][first]
    least = left[0][first], left[1][second]
    sure = all(
        lowest < CLEAR * at and at - lowest > _rough(residual)
        for lowest, at, residual in zip(least, other, left, strict=True)
    )
    if not sure or abs(second - first) < _DRIFT * max(1.0, _EARLY / log.sample_time):
        return
    (early, before), (late, after) = (
        dead_time_in(h, int(delays[place])) for place, h in zip((first, second), halves, strict=True)
    )
    # a disturbance that the control answers scatters the delay of a half
    if abs(late - early) > _CERTAIN * np.hypot(before, after):
        raise NotIdentifiableError(
            f"{log.name}: force and position are not on one clock: the force acts {delays[first]} samples late in the "
            f"first half of the log and {delays[second]} in the second; record both channels with one recorder"
        )
