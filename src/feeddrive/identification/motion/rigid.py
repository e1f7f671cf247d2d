"""A rigid drive with friction, fitted to a motion log by inverse dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.identification.estimate import (
    SHAFT,
    TABLE,
    Estimate,
    Frame,
    estimates_table,
    lever,
    pulls,
    require_table,
)
from feeddrive.identification.motion.motion_log import MotionLog, count_of
from feeddrive.identification.motion.preparation import Preparation, Prepared, prepare
from feeddrive.identification.regression import (
    Residuals,
    Validation,
    cross_validated,
    errors,
    information,
    long_run,
    ols_covariance,
    robust_covariance,
    scores_of,
    steady_curve,
)
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text

FRICTIONS: dict[str, Friction] = {
    "symmetric": Coulomb(coulomb=1.0),
    "directional": Directional(coulomb_positive=1.0, coulomb_negative=1.0),
}  # by their structure alone
NAMES = {
    "symmetric": ("mass", "viscous", "coulomb", "offset"),
    "directional": ("mass", "viscous_positive", "coulomb_positive", "viscous_negative", "coulomb_negative"),
}
_DRAWN = 4  # sets of readings with other places within their counts
LEAST_REVERSAL = 0.05  # least share of the moving rows in each direction
LEAST_OWN = 0.02  # share of a column's size that the other columns must leave unexplained
MOST_MEMORY = 0.97  # correlation from row to row that is taken out of scores: as in Andrews' rule
LARGEST_ERROR = 0.5  # largest standard error over value of a mass that counts as identified


@dataclass(frozen=True, eq=False, repr=False)
class RigidFit(Result):
    """A rigid drive identified from a log; for a drive at a shaft the parameter `mass` is an inertia in kg m².

    estimates   every parameter with its standard errors
    covariance  robust, in the order of the estimates
    validation  prediction of rows that were not used
    criterion   by friction model: the information criterion (less is better), as far as they were compared
    counts      shares of the force that counts of the readings make of the residual, in rows that were used and unused
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
        """The share of the force that the model leaves beyond the effect of counts."""
        return float(np.sqrt(max(0.0, self.residuals.relative**2 - self.counts[0] ** 2)))

    @property
    def changed(self) -> bool:
        """True if unused rows are predicted worse than used ones by half, beyond the effect of counts."""
        beyond = np.sqrt(max(0.0, self.validation.relative**2 - self.counts[1] ** 2))
        return bool(beyond > 1.5 * self.residuals.relative)

    def __getitem__(self, parameter: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == parameter:
                return estimate
        raise ParameterError(f"the fit has no parameter '{parameter}'; it has {', '.join(NAMES[self.friction])}")

    def table(self) -> Table:
        """Return the parameters with both standard errors."""
        off = Text(
            f"residual {Quantity(self.residuals.relative, 'share'):3}, unused rows "
            f"{Quantity(self.validation.relative, 'share'):3}"
        )
        return estimates_table(f"{self.name}: rigid drive, {self.friction} friction; {off}", self.estimates)

    def at_table(self, lead: float, gear: float = 1.0) -> RigidFit:
        """Return the drive in kg and N at a table that a screw of `lead` (m) moves; `gear`: motor
        turns a screw turn.
        """
        if self.frame is not SHAFT:
            return self
        r = lever(lead, gear)
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
            frame=TABLE,
        )

    def plant(self) -> Rigid:
        """Return the moving mass as a plant."""
        require_table(self.frame, "the mass")
        return Rigid(mass=self["mass"].value)

    def friction_block(self) -> Friction:
        """Return the friction as a block; a negative viscous or Coulomb part becomes 0."""
        require_table(self.frame, "the friction")
        value = {estimate.name: max(0.0, estimate.value) for estimate in self.estimates}
        if self.friction == "symmetric":
            return Coulomb(coulomb=value["coulomb"], viscous=value["viscous"])
        return Directional(**{name: value[name] for name in NAMES["directional"][1:]})

    @property
    def is_pulled(self) -> bool:
        """True if the offset is a force of the axis (`pulls`)."""
        return self.friction == "symmetric" and pulls(self["offset"], self["coulomb"].value)

    def gravity(self) -> Gravity | None:
        """Return the constant force that the drive had to overcome, as it acts on the table; None for directional
        friction.
        """
        require_table(self.frame, "the offset")
        return Gravity(force=-self["offset"].value) if self.friction == "symmetric" else None


def identify_rigid(
    log: MotionLog, *, friction: str = "best", how: Preparation | None = None, folds: int = 5
) -> RigidFit:
    """Identify mass, friction and offset of a rigid drive by least squares on its inverse dynamics.

        symmetric:    force = mass a + viscous v + coulomb sign(v) + offset
        directional:  force = mass a + (viscous± v + coulomb± sign(v)),   ± the direction of v

    friction  "symmetric", "directional", or "best": the one with the smaller information criterion
    how       filters and delays; default: `Preparation()`
    folds     of the cross-validation: each stretch of the log is predicted by a fit of the others

    Standard errors are robust; those for a white residual are given as well.  When not to use: on an axis
    whose screw bends in the motion (fit its frequency response), or near standstill (fit constant-speed runs).
    Raises NotIdentifiableError with what to measure next, LogError for a log that is too short.
    Source: Janot, Gautier & Brunot 2019, with the force half a sample later, where its hold acts.
    """
    if friction not in (*FRICTIONS, "best"):
        raise ParameterError(f"friction = {friction!r} must be one of best, {', '.join(FRICTIONS)}")
    rows = prepare(log, how or Preparation())
    check_motion(log.name, rows.velocity, log.frame)
    asked = tuple(FRICTIONS) if friction == "best" else (friction,)
    fits = [_fit(log, rows, model, folds) for model in asked]
    criterion = {fit.friction: fit.criterion[fit.friction] for fit in fits}
    best = min(fits, key=lambda fit: criterion[fit.friction])
    return replace(best, criterion=criterion)


def columns_of(rows: Prepared, friction: str) -> np.ndarray:
    """Return the columns of the inverse dynamics, shape (n, p), in the order of `NAMES`; friction's by its steady
    curve.
    """
    curve = steady_curve(FRICTIONS[friction])
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
    robust = covariance_of(columns, residual) + np.outer(shifts, shifts)
    frame = log.frame
    units = [{"mass": frame.inertia, "viscous": frame.viscous}.get(name.split("_")[0], frame.force) for name in names]
    estimates = tuple(
        Estimate(*row)
        for row in zip(names, values, units, errors(robust), errors(ols_covariance(columns, residual)), strict=True)
    )
    check_mass(log.name, estimates[0].value, estimates[0].error, estimates[0].unit)
    return RigidFit(
        name=log.name,
        friction=friction,
        estimates=estimates,
        covariance=robust,
        residuals=Residuals(residual, rows.force, float(np.linalg.cond(columns)), frame.force),
        validation=cross_validated(columns, rows.force, folds, frame.force),
        criterion={friction: information(residual, len(names))},
        time=rows.time,
        frame=frame,
        counts=(counted / size, counted / size),
    )


def _with_counts(
    log: MotionLog, rows: Prepared, columns: np.ndarray, values: np.ndarray, friction: str
) -> tuple[float, np.ndarray]:
    """Return the RMS of the force that counts add to the residual, and the shift of each value; 0 without counts.

    Counts are drawn once more, as uniform errors of the readings: what they do to the columns they did before, too.
    Source: Cook & Stefanski 1994 (SIMEX, its first step).
    """
    count, names = count_of(log.position), NAMES[friction]
    if count == 0.0:
        return 0.0, np.zeros(len(names))
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
    """Return the robust covariance of the inverse dynamics; each error is the larger one of two estimates.

        plain      S of the scores z(k), `robust_covariance`
        recolored  S of z(k) - rho z(k-1), divided by (1 - rho)²;  rho = Σ z(k) z(k-1) / Σ z(k)²

    Both come out too small: the window of the plain one cuts off a memory that decays slowly; the recolored one takes
    it out first, but noise of the encoder on top makes its rho too small.
    Sources: Newey & West 1987; Andrews & Monahan 1992; the larger one of both is ours.
    """
    plain = robust_covariance(columns, residual)
    scores = scores_of(columns[None], residual[None])
    rho = np.sum(scores[1:] * scores[:-1], axis=0) / np.maximum(np.sum(scores**2, axis=0), np.finfo(float).tiny)
    rho = np.clip(rho, -MOST_MEMORY, MOST_MEMORY)
    n, p = columns.shape
    whitened = np.diag(long_run(scores[1:] - rho * scores[:-1])) * n / max(n - p, 1)
    ratio = whitened / (1.0 - rho) ** 2 / np.maximum(np.diag(plain), np.finfo(float).tiny)
    wider = np.sqrt(np.maximum(ratio, 1.0))
    return plain * np.outer(wider, wider)


def check_motion(name: str, velocity: np.ndarray, frame: Frame) -> None:
    """Raise NotIdentifiableError for a motion in one direction only, or without any."""
    top = float(np.max(np.abs(velocity)))
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
    """Raise NotIdentifiableError for a column that the others explain: its parameter can have any value."""
    sizes = np.linalg.norm(columns, axis=0)
    for i, column_name in enumerate(names):
        if sizes[i] == 0.0:
            raise NotIdentifiableError(f"{name}: not identifiable: {_next(column_name)}")
        others = np.delete(columns, i, axis=1)
        left = columns[:, i] - others @ np.linalg.lstsq(others, columns[:, i], rcond=None)[0]
        own = float(np.linalg.norm(left)) / float(sizes[i])
        if own < LEAST_OWN:
            raise NotIdentifiableError(
                f"{name}: {column_name} is not identifiable: {Quantity((1.0 - own), 'share')} of its column is a sum "
                f"of the others; {_next(column_name)}"
            )


def check_mass(name: str, value: float, error: float, unit: str) -> None:
    """Raise NotIdentifiableError for an inertia that is not positive, or too uncertain."""
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
