"""Identification of a rigid drive with friction by inverse dynamics, and of the dead time of its force."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.identification import regression
from feeddrive.identification.motion import motion_log
from feeddrive.identification.motion.motion_log import MotionLog, Preparation, Prepared
from feeddrive.identification.regression import Estimate, Frame, Residuals, Validation
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
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


@dataclass(frozen=True, eq=False, repr=False)
class RigidFit(Result):
    """A rigid drive identified from a log; in shaft units the parameter `mass` is an inertia in kg m².

    estimates   every parameter with its standard errors
    covariance  robust covariance, in the order of the estimates
    validation  prediction of unused rows
    criterion   information criterion (lower is better) of the friction models that were compared
    counts      residual due to quantization of the readings, relative to the force, in used and in unused rows
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
    counts: tuple[float, float] = (0.0, 0.0)

    @property
    def left(self) -> float:
        """The relative residual of the force without the effect of quantization."""
        return float(np.sqrt(max(0.0, self.residuals.relative**2 - self.counts[0] ** 2)))

    @property
    def changed(self) -> bool:
        """True if the error in unused rows is 50 % larger than in used ones, without the effect of quantization."""
        beyond = np.sqrt(max(0.0, self.validation.relative**2 - self.counts[1] ** 2))
        return bool(beyond > 1.5 * self.residuals.relative)

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
        )

    def plant(self) -> Rigid:
        """Return the moving mass as a plant."""
        regression.require_table(self.frame, "the mass")
        return Rigid(mass=self["mass"].value)

    def friction_block(self) -> Friction:
        """Return the friction as a block; a negative viscous or Coulomb part becomes 0."""
        regression.require_table(self.frame, "the friction")
        value = {estimate.name: max(0.0, estimate.value) for estimate in self.estimates}
        if self.friction == "symmetric":
            return Coulomb(coulomb=value["coulomb"], viscous=value["viscous"])
        return Directional(**{name: value[name] for name in NAMES["directional"][1:]})

    @property
    def is_pulled(self) -> bool:
        """True if the offset is large enough to be a constant force on the axis (see `pulls`)."""
        return self.friction == "symmetric" and regression.pulls(self["offset"], self["coulomb"].value)

    def gravity(self) -> Gravity | None:
        """Return the constant force on the table, derived from the offset, or None for direction-dependent friction."""
        regression.require_table(self.frame, "the offset")
        # the offset is the force of the drive, which balances the constant force on the table
        return Gravity(force=-self["offset"].value) if self.friction == "symmetric" else None


def identify_rigid(
    log: MotionLog, *, friction: str = "best", how: Preparation | None = None, folds: int = 5
) -> RigidFit:
    """Identify mass, friction and offset of a rigid drive by least squares on its inverse dynamics.

        symmetric:    force = mass a + viscous v + coulomb sign(v) + offset
        directional:  force = mass a + (viscous± v + coulomb± sign(v)),   ± the direction of v

    friction  "symmetric", "directional", or "best": the one with the lower information criterion
    how       filters and delays; default: `Preparation()`
    folds     number of stretches in the cross-validation, each predicted by a fit of the others

    Standard errors are robust; those for a white residual are also returned.  Not suitable for an axis with significant
    elastic deformation (fit its frequency response), or near standstill (fit constant-speed runs).
    Raises NotIdentifiableError with what to measure next, LogError for a log that is too short.
    Source: Janot, Gautier & Brunot 2019, with the force delayed by half a sample because of its hold.
    """
    if friction not in (*FRICTIONS, "best"):
        raise ParameterError(f"friction = {friction!r} must be one of best, {', '.join(FRICTIONS)}")
    rows = motion_log.prepare(log, how or Preparation())
    check_motion(log.name, rows.velocity, log.frame)
    models = tuple(FRICTIONS) if friction == "best" else (friction,)
    fits = [_fit(log, rows, model, folds) for model in models]
    criterion = {fit.friction: fit.criterion[fit.friction] for fit in fits}
    best = min(fits, key=lambda fit: criterion[fit.friction])
    return replace(best, criterion=criterion)


def columns_of(rows: Prepared, friction: str) -> np.ndarray:
    """Return the columns of the inverse dynamics, shape (n, p), in the order of `NAMES`."""
    curve = regression.steady_curve(FRICTIONS[friction])
    # the curve is linear in its parameters, so that its slopes at 0 are the columns
    _, slopes = curve.at(dict.fromkeys(curve.names, 0.0), velocity=rows.filtered)
    columns = {"mass": rows.acceleration, "offset": rows.constant}
    columns |= dict(zip(curve.names, rows.reduced(slopes.T), strict=True))
    return np.column_stack([columns[name] for name in NAMES[friction]])


def _fit(log: MotionLog, rows: Prepared, friction: str, folds: int) -> RigidFit:
    names, columns = NAMES[friction], columns_of(rows, friction)
    check_columns(log.name, columns, names)
    values = np.linalg.lstsq(columns, rows.force, rcond=None)[0]
    residual = rows.force - columns @ values
    counted, shifts = _with_counts(log, rows, columns, values, friction)
    size = float(np.sqrt(np.mean(rows.force**2)))
    # the bias due to quantization is not removed but counts as an error
    robust = covariance_of(columns, residual) + np.outer(shifts, shifts)
    frame = log.frame
    units = [{"mass": frame.inertia, "viscous": frame.viscous}.get(name.split("_")[0], frame.force) for name in names]
    estimates = tuple(
        Estimate(*row)
        for row in zip(
            names,
            values,
            units,
            regression.errors(robust),
            regression.errors(regression.ols_covariance(columns, residual)),
            strict=True,
        )
    )
    check_mass(log.name, estimates[0].value, estimates[0].error, estimates[0].unit)
    return RigidFit(
        name=log.name,
        friction=friction,
        estimates=estimates,
        covariance=robust,
        residuals=Residuals(residual, rows.force, float(np.linalg.cond(columns)), frame.force),
        validation=regression.cross_validated(columns, rows.force, folds, frame.force),
        criterion={friction: regression.information(residual, len(names))},
        time=rows.time,
        frame=frame,
        # quantization acts alike in used and in unused rows
        counts=(counted / size, counted / size),
    )


def _with_counts(
    log: MotionLog, rows: Prepared, columns: np.ndarray, values: np.ndarray, friction: str
) -> tuple[float, np.ndarray]:
    """Return the RMS residual due to quantization, and the bias of each value; 0 if readings are not quantized.

    A second quantization is simulated by adding uniformly distributed errors to the readings; its effect on the columns
    equals that of the first one.
    Source: Cook & Stefanski 1994 (SIMEX, its first step).
    """
    count, names = motion_log.count_of(log.position), NAMES[friction]
    if count == 0.0:
        return 0.0, np.zeros(len(names))
    # a fixed seed: the same log gives the same errors
    random = np.random.default_rng(0)
    ways = {"viscous_positive": rows.velocity > 0.0, "viscous_negative": rows.velocity < 0.0}
    residuals, shifts = [], []
    for _ in range(_DRAWN):
        changes, slow = rows.errors(count * random.uniform(-0.5, 0.5, log.position.size))
        noise = np.column_stack(
            [
                changes if name == "mass" else slow * ways.get(name, 1.0) if name.startswith("viscous") else 0.0 * slow
                for name in names
            ]
        )
        residuals.append(np.mean((noise @ values) ** 2))
        shifts.append(np.linalg.lstsq(columns + noise, rows.force, rcond=None)[0] - values)
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
    """Raise NotIdentifiableError for a log without motion or with motion in one direction only."""
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
        return (
            "the log holds hardly any acceleration; record next moves with short ramps: the inertial force should be "
            "at least as large as friction for a tenth of the time"
        )
    if parameter.startswith("viscous"):
        return "the speed hardly changes; record next moves at three speeds at least, in both directions"
    return "record next moves at several speeds in both directions, with ramps between them"


REACH = 20  # samples to both sides that are tried
LATEST = 5e-3  # s: a force that acts later than that does not belong to this clock
CLEAR = 0.9  # largest ratio of the residuals of two delays at which the better one counts as certain
# s: unknown forces and counts shift the delay of a closed loop by as much
_EARLY = 1e-3
_DRIFT = 2  # times that, and samples, by which the delays of the two halves of a log differ if they drift


@dataclass(frozen=True, eq=False, repr=False)
class DelayFit(Result):
    """The dead time in samples, without the half sample of the hold, with its standard error.

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
        """Return True if the residual of the inverse dynamics is 10 % smaller at delay `better` than at `other`.

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
    delays = np.arange(-REACH, REACH + 1)
    base = motion_log.prepare(log, how)
    columns = columns_of(base, friction)
    # a direction without motion has an empty column of friction
    columns = columns[:, np.any(columns != 0.0, axis=0)]
    basis = np.linalg.qr(columns)[0]
    # the force is shifted and not the motion, so that the columns and their factorization serve all delays
    forces = base.reduced(np.array([motion_log.delayed(log.force, motion_log.HOLD + d) for d in delays]))
    residual = np.array([_left(basis, force) for force in forces])
    best = int(np.argmin(residual))
    _check_slope(log, basis, forces, residual)
    if clocks:
        _check(log, int(delays[best]), delays, residual)
        _check_drift(log, columns, forces, delays)
    slope = 0.5 * (forces[min(best + 1, delays.size - 1)] - forces[max(best - 1, 0)])
    # negative: a later force is the force less its slope times the delay
    wide = np.column_stack([columns, -slope])
    values = np.linalg.lstsq(wide, forces[best], rcond=None)[0]
    error = float(regression.errors(covariance_of(wide, forces[best] - wide @ values))[-1])
    return DelayFit(log.name, float(delays[best]) + float(values[-1]), error, delays, residual, log.sample_time)


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
    """Return twice the largest decrease of a residual on the way from its minimum to longer or shorter delays.

    Around the true delay a residual increases on both sides. If quantization enters the force through a velocity gain,
    the residual is as ragged as the force, and its minimum is no evidence about clocks.
    """
    best = int(np.argmin(residual))
    sides = residual[best:], residual[best::-1]
    return 2.0 * float(max(np.max(np.maximum.accumulate(side) - side) for side in sides))


def _trails(log: MotionLog) -> bool:
    """Return True if the set position lags behind the position: (x_set - x) v < 0 on average."""
    if log.set_position is None:
        return False
    return float(np.mean((log.set_position - log.position) * np.gradient(log.set_position))) < 0.0


def _check_drift(log: MotionLog, columns: np.ndarray, forces: np.ndarray, delays: np.ndarray) -> None:
    """Raise NotIdentifiableError if the delays in the two halves of a log differ, which indicates two clocks."""
    half = columns.shape[0] // 2
    halves = (slice(0, half), slice(half, None))
    left = [np.array([_left(np.linalg.qr(columns[rows])[0], force[rows]) for force in forces]) for rows in halves]
    first, second = (int(np.argmin(residual)) for residual in left)
    other = left[0][second], left[1][first]
    least = left[0][first], left[1][second]
    sure = all(
        lowest < CLEAR * at and at - lowest > _rough(residual)
        for lowest, at, residual in zip(least, other, left, strict=True)
    )
    if sure and abs(second - first) >= _DRIFT * max(1.0, _EARLY / log.sample_time):
        raise NotIdentifiableError(
            f"{log.name}: force and position are not on one clock: the force acts {delays[first]} samples late in the "
            f"first half of the log and {delays[second]} in the second; record both channels with one recorder"
        )
