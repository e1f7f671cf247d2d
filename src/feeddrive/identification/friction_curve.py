"""Friction from logs: a friction curve from constant-speed runs, and parallel elastic stops for presliding."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.blocks.feedforward.friction_stops import FrictionStops
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.identification import regression
from feeddrive.identification.motion.motion_log import MotionLog, Preparation, prepare
from feeddrive.identification.regression import Estimate, Frame, TracedForce
from feeddrive.language import tree
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text

WIDTHS = tuple(np.geomspace(0.5e-6, 200e-6, 15).tolist())  # m
# the last third of the log validates the fit to the other two
_UNUSED = 3
# spikes in a thousandth of the rows are not the largest force of the axis
_USUAL = 0.999
# stops cannot bear more than the axis is pushed with; a larger level only balances other columns of the fit
_MOST_LEVEL = 3.0
_RIDGE = 1e-3  # of the bells: their prior is so many times wider than the noise of a row


@dataclass(frozen=True, eq=False, repr=False)
class LearnedStops(Result):
    """The elastic stops fitted to the friction in a log, with the other parameters of the inverse dynamics.

    stops       the feedforward block
    estimates   mass (if it was not given), viscous friction, offset, total level Σ k δ and total stiffness Σ k
    left        RMS of the residual force in N: in the fitted rows, and in the last third, which was not fitted
    plain       the same two values for a fit of Coulomb and viscous friction only
    """

    name: str
    stops: FrictionStops
    estimates: tuple[Estimate, ...]
    left: tuple[float, float]
    plain: tuple[float, float]

    def __getitem__(self, parameter: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == parameter:
                return estimate
        raise ParameterError(f"there is no '{parameter}'; there are {', '.join(e.name for e in self.estimates)}")

    def table(self) -> Table:
        """Return a table of the estimates with both standard errors; its title states the number of stops and the
        residual.
        """
        title = Text(
            f"{self.name}: {len(self.stops.width)} stops leave {Quantity(self.left[0], 'N'):3} RMS, "
            f"{Quantity(self.left[1], 'N'):3} of rows not used; Coulomb and viscous friction "
            f"{Quantity(self.plain[0], 'N'):3} and {Quantity(self.plain[1], 'N'):3}"
        )
        return regression.estimates_table(title, self.estimates)


def stretches(position: np.ndarray, width: float) -> np.ndarray:
    """Return the elongation of an elastic stop, e(k) = clip(e(k-1) + x(k) - x(k-1), ±width) in m, from 0."""
    elongation, e = np.empty(position.size), 0.0
    for k, step in enumerate(np.diff(position, prepend=position[:1]).tolist()):
        e = min(max(e + step, -width), width)
        elongation[k] = e
    return elongation


def learned_stops(
    log: MotionLog,
    *,
    mass: float | None = None,
    widths: Sequence[float] = WIDTHS,
    bells: int = 0,
    how: Preparation | None = None,
) -> LearnedStops:
    """Fit elastic stops, mass, viscous friction and offset to a log by non-negative least squares.

        force = mass a + viscous v + offset + Σ k_i e_i,   all parameters but the offset >= 0

    mass    known mass in kg, 0 if the force is friction only; default: estimated
    widths  candidate stop widths in m; stops without stiffness are left out of the result
    bells   number of Gaussian basis functions of the velocity that are fitted to the residual of the stops; 0: none
    how     default: one row per millisecond, including rows at reversals; the position is filtered at 200 Hz

    The regressors are the elongations of the stops for the measured position, filtered in the same way as the force and
    scaled to equal RMS.  The heights of the bells are found by ridge regression, which gives the mean of a Gaussian
    process with these basis functions; the bells are equally spaced from the lowest to the highest velocity.  Standard
    errors are those of the regressors with nonzero parameters and are valid for autocorrelated residuals; they do not
    account for widths that are not among the candidates.

    Not suitable without reversals, or if the widest stop exceeds half of the travel (NotIdentifiableError).  Record
    back-and-forth motions with strokes from 1 um to several mm, both slow and fast.
    Source: Lawson & Hanson 1974 (non-negative least squares); the regressors: Al-Bender, Lampaert & Swevers 2004.
    """
    _check_stops(log, widths, mass, bells)
    # imported here: commands that only read a log start without it
    from scipy.optimize import nnls

    few = max(1, round(1e-3 / log.sample_time))
    prepared = prepare(log, how or Preparation(cutoff=200.0, decimation=few, reversals=True))
    rows = [prepared.reduced(stretches(log.position, width)) for width in widths]
    # non-negative least squares has no free sign: the offset is the difference of two columns
    free = {"viscous": prepared.velocity, "offset": prepared.constant, "less": -prepared.constant}
    if mass is None:
        free["mass"] = prepared.acceleration
    columns = np.column_stack([*rows, *free.values()])
    force = prepared.force - (0.0 if mass is None else mass) * prepared.acceleration
    # elongations are micrometers and accelerations m/s²: unscaled, the small columns vanish in the solver's tolerance
    size = np.sqrt(np.mean(columns * columns, axis=0))
    size = np.where(size > 0.0, size, 1.0)
    used = slice(0, force.size - force.size // _UNUSED)
    solution = nnls(columns[used] / size, force[used])[0] / size
    residual = force - columns @ solution
    counts = np.flatnonzero(solution > 0.0)
    kept = [int(i) for i in counts if i < len(widths)]
    level = float(sum(solution[i] * widths[i] for i in kept))
    most = float(np.quantile(np.abs(force), _USUAL))
    if not kept or level > _MOST_LEVEL * most:
        raise NotIdentifiableError(
            f"{log.name}: the stops found bear {Quantity(level, 'N'):3} together, where the friction of the log stays "
            f"within {Quantity(most, 'N'):3}: it does not show presliding; record slow moves to and fro of 1 um to "
            f"{Quantity(4.0 * max(widths), 'm'):2 mm}"
        )
    # `FrictionStops` is a table of at least two stops: a neighbor with stiffness 0 fills it
    if len(kept) == 1:
        kept = sorted([*kept, kept[0] - 1 if kept[0] else 1])
    stops = FrictionStops(width=np.array([widths[i] for i in kept]), stiffness=solution[kept])
    if bells:
        stops = _with_bells(stops, prepared.velocity, residual, used, bells)
        residual = residual - _bell_force(stops, prepared.velocity)
    estimates = _stop_estimates(columns[used][:, counts], residual[used], counts, solution, widths, list(free))
    sides = np.column_stack([np.sign(prepared.velocity), *free.values()])
    plain = force - sides @ np.linalg.lstsq(sides[used], force[used], rcond=None)[0]
    return LearnedStops(log.name, stops, estimates, _parts(residual, used), _parts(plain, used))


def _check_stops(log: MotionLog, widths: Sequence[float], mass: float | None, bells: int) -> None:
    if log.frame is regression.SHAFT:
        raise ParameterError(f"{log.name}: stops are learned where they are fed forward, at a table, not at a shaft")
    if len(widths) < 2 or not all(np.isfinite(width) and width > 0.0 for width in widths):
        raise ParameterError(f"widths = {list(widths)} m must be two or more lengths > 0")
    if mass is not None and not (np.isfinite(mass) and mass >= 0.0):
        raise ParameterError(f"mass = {Quantity(mass, 'kg'):6} must be >= 0; leave it out to estimate it")
    if bells < 0 or bells == 1:
        raise ParameterError(f"bells = {bells} must be 0 or at least 2")
    travel = float(np.ptp(log.position))
    if 2.0 * max(widths) > travel:
        raise NotIdentifiableError(
            f"{log.name}: the axis moves by {Quantity(travel, 'm')}, less than twice the widest stop of "
            f"{Quantity(max(widths), 'm')}, which never slips: move farther, or offer narrower stops (widths)"
        )


def _parts(residual: np.ndarray, used: slice) -> tuple[float, float]:
    """Return the RMS of a residual in the used rows and in the unused rows after them."""
    others = residual[used.stop :]
    return float(np.sqrt(np.mean(residual[used] ** 2))), float(np.sqrt(np.mean(others**2)))


def _with_bells(
    stops: FrictionStops, velocity: np.ndarray, residual: np.ndarray, used: slice, count: int
) -> FrictionStops:
    """Return the stops with Gaussian basis functions of the velocity, fitted to the residual of the stops."""
    v, left = velocity[used], residual[used]
    places = np.linspace(float(np.min(v)), float(np.max(v)), count)
    wide = float(places[1] - places[0])
    columns = np.exp(-0.5 * ((v[:, None] - places) / wide) ** 2)
    # neighboring bells are nearly dependent; the ridge grows with the rows as the normal equations do
    heights = np.linalg.solve(columns.T @ columns + _RIDGE * v.size * np.eye(count), columns.T @ left)
    return FrictionStops(
        width=stops.width,
        stiffness=stops.stiffness,
        residual_velocity=places,
        residual_force=heights,
        residual_width=wide,
        residual_limit=float(np.max(np.abs(left))),
    )


def _bell_force(stops: FrictionStops, velocity: np.ndarray) -> np.ndarray:
    return np.array([float(stops.residual(np.float64(v))) for v in velocity])


def _stop_estimates(
    columns: np.ndarray,
    residual: np.ndarray,
    counts: np.ndarray,
    solution: np.ndarray,
    widths: Sequence[float],
    names: list[str],
) -> tuple[Estimate, ...]:
    """Return the estimates, which are weighted sums of the nonzero parameters, with their standard errors."""
    scale, n = np.sqrt(np.mean(columns * columns, axis=0)), len(widths)
    sums = [
        ("level", "N", [widths[i] if i < n else 0.0 for i in counts]),
        ("stiffness", "N/m", [float(i < n) for i in counts]),
        *(
            (name, unit, [_share(names, i - n, name) for i in counts])
            for name, unit in (("mass", "kg"), ("viscous", "N s/m"), ("offset", "N"))
            if name in names
        ),
    ]
    shares = np.array([share for _, _, share in sums])
    robust, white = (
        regression.errors(shares / scale @ of(columns / scale, residual) @ (shares / scale).T)
        for of in (regression.robust_covariance, regression.ols_covariance)
    )
    return tuple(
        Estimate(name, float(value), unit, float(error), float(ols))
        for (name, unit, _), value, error, ols in zip(sums, shares @ solution[counts], robust, white, strict=True)
    )


def _share(names: list[str], place: int, name: str) -> float:
    """Return the weight of a parameter in an estimate; the two parameters of the offset have opposite signs."""
    if place < 0:
        return 0.0
    here = names[place]
    return 1.0 if here == name else -1.0 if here == "less" and name == "offset" else 0.0


# Constant-speed runs: stretches of a log with constant speed, and the mean force of each.

LEAST_ROWS = 20  # of a stretch
_CHANGE = 0.1  # share of the speed: a larger change ends a stretch
_SURE = 6.0  # standard errors: the change must also exceed these
_DRIFT = 0.02  # share of the speed by which a constant speed may rise or fall
_TRIM = 0.1  # share of a stretch that is cut off at an end where the speed changed


@dataclass(frozen=True, eq=False, repr=False)
class SteadyRuns(Result):
    """The mean velocity and force of constant-speed runs in both directions, shape (m,), sorted by velocity.

    error  standard error of each mean force, robust to its autocorrelation
    rows   number of rows in each mean
    remarks  remarks on outliers that were left out of the means
    """

    velocity: np.ndarray
    force: np.ndarray
    error: np.ndarray
    rows: np.ndarray
    frame: Frame = regression.TABLE
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.velocity.size == self.force.size == self.error.size == self.rows.size:
            raise LogError("constant-speed runs need one velocity, force, error and count each")
        # in ascending order the runs of one direction are a slice: `_sides` relies on it
        order = np.argsort(self.velocity)
        for name in ("velocity", "force", "error", "rows"):
            values = np.asarray(getattr(self, name), dtype=np.float64)[order]
            # a tabulated friction map has no standard errors: they are NaN
            if not np.all(np.isfinite(values)) and name != "error":
                raise LogError(
                    f"constant-speed runs: {name} is not finite in run {int(np.argmin(np.isfinite(values))) + 1}"
                )
            object.__setattr__(self, name, values)

    def table(self) -> Table:
        """Return a table with one row for each run."""
        columns = zip(self.velocity, self.force, self.error, self.rows, strict=True)
        rows = [[v, Quantity(f, self.frame.force, e, form="5"), e, int(n)] for v, f, e, n in columns]
        heads = [
            Column("velocity", self.frame.velocity, "5"),
            Column("force", self.frame.force, "5"),
            Column("standard error", self.frame.force, "2"),
            "rows",
        ]
        return Table(f"{self.velocity.size} constant-speed runs", heads, rows)

    def at_table(self, lead: float, gear: float = 1.0) -> SteadyRuns:
        """Return the runs in m/s and N at a table driven by a screw of `lead` (m)."""
        if self.frame is regression.TABLE:
            return self
        r = regression.lever(lead, gear)
        return replace(
            self, velocity=self.velocity * r, force=self.force / r, error=self.error / r, frame=regression.TABLE
        )


def runs_of(
    velocity: Sequence[float] | np.ndarray, force: Sequence[float] | np.ndarray, *, rotary: bool = False
) -> SteadyRuns:
    """Return a tabulated friction map as runs without standard errors."""
    v, f = np.asarray(velocity, dtype=np.float64), np.asarray(force, dtype=np.float64)
    return SteadyRuns(v, f, np.full(v.size, np.nan), np.ones(v.size), regression.frame_of(rotary))


def steady_runs(
    logs: Sequence[tuple[np.ndarray, np.ndarray]],
    *,
    rotary: bool = False,
    least_rows: int = LEAST_ROWS,
    names: Sequence[str] = (),
) -> SteadyRuns:
    """Extract the constant-speed runs of logs, each a pair of velocity and force of shape (n,).

    Units are m/s and N, or rad/s and N m.  A log is split recursively where its mean speed changes most, as long as
    the change exceeds 10 % of the speed and six standard errors.  Parts in which the speed has a trend or is zero are
    left out, as is a tenth of a part at each end where the speed changed.  Outliers of velocity or force
    (`regression.strays`) are excluded from the means; a remark states how many and where, by `names` of the logs.
    Raises LogError for logs with values that are not finite, NotIdentifiableError if no speed is held for `least_rows`
    rows.
    """
    means: list[tuple[float, float, float, int]] = []
    remarks: list[str] = []
    frame = regression.frame_of(rotary)
    for place, (velocity, force) in enumerate(logs):
        v, f = np.asarray(velocity, dtype=np.float64), np.asarray(force, dtype=np.float64)
        if v.shape != f.shape or v.ndim != 1:
            raise LogError(f"log {place + 1}: velocity has {v.size} rows, force {f.size}")
        if not (np.all(np.isfinite(v)) and np.all(np.isfinite(f))):
            raise LogError(f"log {place + 1}: velocity or force is not finite at a row; repair or cut it")
        bad_speed, bad_force = regression.strays(v), regression.strays(f)
        where = names[place] if names else f"log {place + 1}"
        remarks += regression.stray_remarks(f"{where}, velocity", v, bad_speed, frame.velocity)
        remarks += regression.stray_remarks(f"{where}, force", f, bad_force, frame.force)
        good = ~(bad_speed | bad_force)
        v, f = v[good], f[good]
        for begin, end in _stretches(v, 0, v.size, least_rows):
            if _is_held(v[begin:end], v):
                one, rest = np.ones((end - begin, 1)), f[begin:end] - np.mean(f[begin:end])
                error = float(regression.errors(regression.robust_covariance(one, rest))[0])
                means.append((float(np.mean(v[begin:end])), float(np.mean(f[begin:end])), error, end - begin))
    if not means:
        raise NotIdentifiableError(
            f"no constant speed is held for {least_rows} rows; record next runs at a constant speed, some seconds each"
        )
    columns = np.array(means).T
    return SteadyRuns(*columns, frame=frame, remarks=tuple(remarks))


def _stretches(v: np.ndarray, begin: int, end: int, least: int) -> Iterator[tuple[int, int]]:
    """Yield the parts of [begin, end) between changes of the mean speed, trimmed at these changes."""
    cut = _cut(v[begin:end], least)
    if cut is not None:
        yield from _stretches(v, begin, begin + cut, least)
        yield from _stretches(v, begin + cut, end, least)
        return
    trim = int(np.ceil(_TRIM * (end - begin)))
    first = begin + (trim if begin > 0 else 0)
    last = end - (trim if end < v.size else 0)
    if last - first >= least:
        yield first, last


def _cut(v: np.ndarray, least: int) -> int | None:
    """Return the row, not close to an end, at which the mean changes most; None if the change is not significant."""
    # a change point in the first rows would be noise of a mean over two of them
    few = max(3, least // 4)
    if v.size < 2 * few:
        return None
    n = np.arange(few, v.size - few + 1)
    total = np.concatenate([[0.0], np.cumsum(v)])
    left, right = total[n] / n, (total[-1] - total[n]) / (v.size - n)
    # the decrease of the sum of squares by two means instead of one
    gain = n * (v.size - n) / v.size * (left - right) ** 2
    best = int(np.argmax(gain))
    k = int(n[best])
    change = abs(float(left[best] - right[best]))
    within = np.sqrt((np.var(v[:k]) * k + np.var(v[k:]) * (v.size - k)) / v.size)
    error = float(within) * np.sqrt(1.0 / k + 1.0 / (v.size - k))
    larger = max(abs(float(left[best])), abs(float(right[best])))
    return k if change > _CHANGE * larger and change > _SURE * error else None


def _is_held(part: np.ndarray, whole: np.ndarray) -> bool:
    """Return True if a part of the velocities `whole` has a constant nonzero speed."""
    mean = abs(float(np.mean(part)))
    error = float(np.std(part)) / np.sqrt(part.size)
    # standstill: no mean speed beyond its noise, or one that only drift makes
    if mean <= 4.0 * error or mean < 1e-3 * float(np.max(np.abs(whole))):
        return False
    k = np.arange(part.size) - 0.5 * (part.size - 1)
    slope = float(k @ part) / float(k @ k)
    left = part - np.mean(part) - slope * k
    # a slope over n rows has the variance 12 s²/n³, and the drift over all of them 12 s²/n
    drift, error = abs(slope) * part.size, float(np.std(left)) * np.sqrt(12.0 / part.size)
    return drift <= max(_DRIFT * mean, _SURE * error)


# A friction curve from constant-speed runs: selection of the friction model, and its parameters.

_VELOCITY = "stribeck_velocity"
# Stribeck velocities that are tried: the best of them only brackets the minimum, which is then refined
_GRID = 60
# Kass & Raftery 1995: a difference of up to 2 is worth no more than a bare mention, so that the simpler model is taken
EQUAL = 2.0
# means of runs at one set speed differ slightly: two speeds count as different above this ratio
_SAME = 1.02
# Kass & Raftery 1995: a difference of 6 or more is strong evidence
CLEAR = 6.0


@dataclass(frozen=True)
class Candidate:
    """A candidate friction model, with or without a constant force (`offset`); values in the block are ignored.

    All its parameters except a Stribeck velocity enter its steady-state curve linearly.
    """

    name: str
    friction: Friction
    offset: bool = False

    @property
    def curve(self) -> TracedForce[Friction]:
        """The traced steady-state curve of the block."""
        return regression.steady_curve(self.friction)

    @property
    def stribeck(self) -> bool:
        """True if the block has a Stribeck velocity."""
        return _VELOCITY in self.curve.names

    @property
    def parameters(self) -> tuple[str, ...]:
        """The linear parameters, then the Stribeck velocity."""
        linear = tuple(name for name in self.curve.names if name != _VELOCITY)
        return (*linear, *(("offset",) if self.offset else ()), *((_VELOCITY,) if self.stribeck else ()))

    def slopes(self, velocity: np.ndarray, values: Mapping[str, Any]) -> np.ndarray:
        """Return d force / d parameter along the last axis, in the order of `parameters`; missing values count as 0."""
        _, slopes = self.curve.at({name: values.get(name, 0.0) for name in self.curve.names}, velocity=velocity)
        slopes = np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1)
        places = [self.curve.names.index(name) if name != "offset" else -1 for name in self.parameters]
        return slopes[..., places]

    def columns(self, velocity: np.ndarray, stribeck_velocity: Any = 1.0) -> np.ndarray:
        """Return the regressors of all linear parameters."""
        slopes = self.slopes(velocity, {_VELOCITY: stribeck_velocity})
        return slopes[..., :-1] if self.stribeck else slopes

    def block(self, values: Mapping[str, float]) -> Friction:
        """Return the friction block with these values; a negative viscous part becomes 0."""
        parameters = {name: value for name, value in values.items() if name != "offset"}
        parameters |= {name: max(0.0, value) for name, value in parameters.items() if name.startswith("viscous")}
        return replace(self.friction, **parameters)

    def is_sound(self, values: Mapping[str, float]) -> bool:
        """Return True if the values are valid: no negative level, and no breakaway level below the Coulomb level."""
        # the block itself checks its values, so that the bounds are stated once
        try:
            self.block(values)
        except ParameterError:
            return False
        return True


def _with_stribeck(exponent: int) -> tuple[Friction, Friction]:
    """Return a symmetric and a direction-dependent Stribeck block with this exponent."""
    levels = {f"{name}_{side}": 1.0 for name in ("coulomb", "breakaway") for side in ("positive", "negative")}
    return (
        Stribeck(coulomb=1.0, breakaway=1.0, stribeck_velocity=1.0, exponent=exponent),
        DirectionalStribeck(**levels, stribeck_velocity=1.0, exponent=exponent),
    )


CURVES = {"exponential": _with_stribeck(1), "gaussian": _with_stribeck(2)}
CANDIDATES = (
    Candidate("coulomb and viscous", Coulomb(coulomb=1.0)),
    Candidate("coulomb and viscous, offset", Coulomb(coulomb=1.0), offset=True),
    Candidate("directional", Directional(coulomb_positive=1.0, coulomb_negative=1.0)),
    *(
        Candidate(f"{name}, {curve}", friction, offset)
        for curve, (symmetric, directional) in CURVES.items()
        for name, friction, offset in (
            ("stribeck", symmetric, False),
            ("stribeck with offset", symmetric, True),
            ("directional stribeck", directional, False),
        )
    ),
)
# a separate curve for each direction, which no block can represent: if it is much better, the result says so
SEPARATE = tuple(Candidate(f"two curves, {curve}", symmetric) for curve, (symmetric, _) in CURVES.items())


@dataclass(frozen=True, eq=False, repr=False)
class Compared:
    """A candidate model: its information criterion (lower is better), RMS residual and number of parameters."""

    name: str
    criterion: float
    rms: float
    parameters: int


@dataclass(frozen=True, eq=False, repr=False)
class FrictionCurve(Result):
    """The friction model that constant-speed runs support best.

    compared    all candidates, the best first
    memory      correlation between the residuals of neighboring speeds
    remarks     remarks on the validity of the result
    covariance  covariance of the estimates, in their order; it accounts for this correlation
    """

    model: Candidate
    estimates: tuple[Estimate, ...]
    runs: SteadyRuns
    residual: np.ndarray
    memory: float
    compared: tuple[Compared, ...]
    remarks: tuple[str, ...]
    covariance: np.ndarray

    def __getitem__(self, parameter: str) -> Estimate:
        for estimate in self.estimates:
            if estimate.name == parameter:
                return estimate
        raise ParameterError(f"the curve has no '{parameter}'; it has {', '.join(self.model.parameters)}")

    @property
    def values(self) -> dict[str, float]:
        """The parameter values by name."""
        return {estimate.name: estimate.value for estimate in self.estimates}

    @property
    def frame(self) -> Frame:
        """The units of the curve: those of a table or of a shaft."""
        return self.runs.frame

    def at(self, velocity: np.ndarray) -> np.ndarray:
        """Return the friction force that opposes the motion, including the offset, at nonzero velocities."""
        return _predicted(self.model, self.values, velocity)

    def error(self, velocity: np.ndarray) -> np.ndarray:
        """Return the standard error of the curve at nonzero velocities: √(j Σ jᵀ), j = d force / d parameters, Σ their
        covariance.
        """
        columns = self.model.slopes(np.asarray(velocity, dtype=np.float64), self.values)
        return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", columns, self.covariance, columns), 0.0))

    def table(self) -> Table:
        """Return a table of the parameters with both standard errors."""
        rms = float(np.sqrt(np.mean(self.residual**2)))
        title = Text(
            f"{self.model.name}: RMS {Quantity(rms, self.frame.force):3}, memory {Quantity(self.memory):.2f} from "
            "speed to speed"
        )
        return regression.estimates_table(title, self.estimates)

    def comparison(self) -> Table:
        """Return a table of all candidate models, the best first."""
        best = self.compared[0].criterion
        rows = [
            [model.name, model.parameters, model.rms, model.criterion, model.criterion - best]
            for model in self.compared
        ]
        heads = [
            "model",
            "parameters",
            Column("RMS", self.frame.force),
            Column("criterion", form=".1f"),
            Column("worse by", form=".1f"),
        ]
        return Table("models of friction; a criterion worse by 6 is strong evidence against a model", heads, rows)

    def at_table(self, lead: float, gear: float = 1.0) -> FrictionCurve:
        """Return the curve at a table driven by a screw of `lead` (m), refitted to the same runs in m/s and N."""
        return fit_friction(self.runs.at_table(lead, gear), (self.model,)) if self.frame is regression.SHAFT else self

    def block(self) -> Friction:
        """Return the curve as a friction block; raises ParameterError for a curve of a shaft."""
        regression.require_table(self.frame, "the friction curve")
        return self.model.block(self.values)

    @property
    def is_pulled(self) -> bool:
        """True if the offset is large enough to indicate a constant force on the axis (see `pulls`)."""
        return self.model.offset and regression.pulls(self["offset"], self["coulomb"].value)

    def gravity(self) -> Gravity | None:
        """Return the offset as a constant force on the table, or None if the model has no offset."""
        regression.require_table(self.frame, "the offset")
        # the offset is the force of the drive, which balances the constant force on the table
        return Gravity(force=-self["offset"].value) if self.model.offset else None


def fit_friction(runs: SteadyRuns, candidates: Sequence[Candidate] = CANDIDATES) -> FrictionCurve:
    """Fit all candidates to constant-speed runs and select the best by the information criterion.

    Among models whose criteria differ by less than 2, the one with the fewest parameters is selected.

        force(v) = level(v) sign(v) + viscous v (+ offset)
        level(v) = coulomb + (breakaway - coulomb) e^-|v / stribeck_velocity|^exponent

    The parameters are estimated by least squares with equal weights.  The criterion and the standard errors account for
    residuals that are correlated from one speed to the next (`regression.information`). A curve of the wrong shape
    leaves such residuals, which are weaker evidence for further parameters than independent residuals. Separate curves
    for both directions are compared too. No block can represent them, so they are never selected, but a remark states
    if they are better.

    Not suitable for runs in which the speed is not constant (use `identify_rigid`).
    Raises NotIdentifiableError with the speeds to measure next.
    """
    _check(runs)
    fits = [fit for candidate in candidates if (fit := _fitted(runs, candidate)) is not None]
    if not fits:
        raise NotIdentifiableError(
            f"none of the friction models fits the {runs.velocity.size} runs with positive levels; is the sign of "
            f"force or velocity inverted? The force must point along the motion that it sustains"
        )
    fits.sort(key=lambda fit: fit[0].criterion)
    near = [fit for fit in fits if fit[0].criterion < fits[0][0].criterion + EQUAL]
    compared, model, values, residual = min(near, key=lambda fit: fit[0].parameters)
    others = [fit[0] for fit in fits]
    # a refit of a single model, as in `at_table`, compares nothing
    separate = [_separate(runs, candidate) for candidate in SEPARATE] if len(candidates) > 1 else []
    listed = sorted([*others, *(model for model in separate if model is not None)], key=lambda model: model.criterion)
    remarks = (*runs.remarks, *_remarks(compared, model.stribeck, listed, others, runs))
    rho = regression.likely_memory(residual, _sides(runs))
    estimates, covariance = _estimates(runs, model, values, residual, rho)
    return FrictionCurve(model, estimates, runs, residual, rho, tuple(listed), remarks, covariance)


def _check(runs: SteadyRuns) -> None:
    v = runs.velocity
    forward, backward = _speeds(v[v > 0.0]), _speeds(-v[v < 0.0])
    if forward < 3 or backward < 3:
        top = float(np.max(np.abs(v), initial=0.0))
        slow, slower, faster, fast = (
            Quantity(share * top, runs.frame.velocity, form="2") for share in (0.02, 0.1, 0.3, 1.0)
        )
        raise NotIdentifiableError(
            f"a friction curve needs at least 3 speeds in each direction, not {forward} forward and {backward} "
            f"backward; record next runs at {slow}, {slower}, {faster} and {fast} in both directions"
        )


def _speeds(speeds: np.ndarray) -> int:
    """Count the distinct speeds; means of the same set speed, which differ slightly, count once."""
    count, last = 0, 0.0
    for speed in np.sort(speeds):
        if speed > _SAME * last:
            count, last = count + 1, float(speed)
    return count


def _sides(runs: SteadyRuns) -> tuple[slice, slice]:
    """Return the rows of the negative and of the positive direction."""
    turn = int(np.searchsorted(runs.velocity, 0.0))
    return slice(0, turn), slice(turn, runs.velocity.size)


def _fitted(runs: SteadyRuns, model: Candidate) -> tuple[Compared, Candidate, dict[str, float], np.ndarray] | None:
    if runs.velocity.size <= len(model.parameters) + 1:
        return None
    values = _values(runs.velocity, runs.force, model)
    if values is None:
        return None
    residual = runs.force - _predicted(model, values, runs.velocity)
    return _judged(model.name, residual, len(model.parameters), runs), model, values, residual


def _values(v: np.ndarray, force: np.ndarray, model: Candidate) -> dict[str, float] | None:
    """Return the least-squares values, with a Stribeck velocity within the measured speeds; None if none are valid."""
    # imported here: commands that only read a log start without it
    from scipy.optimize import minimize_scalar

    if not model.stribeck:
        solution = np.linalg.lstsq(model.columns(v), force, rcond=None)[0]
        values = dict(zip(model.parameters, map(float, solution), strict=True))
        return values if model.is_sound(values) else None
    # beyond the measured speeds a Stribeck curve is flat or a straight line, and its velocity is not identifiable
    speeds = np.abs(v)
    grid = np.geomspace(float(np.min(speeds)), float(np.max(speeds)), _GRID)

    def linear(velocity: float, columns: np.ndarray) -> tuple[float, dict[str, float]]:
        solution = np.linalg.lstsq(columns, force, rcond=None)[0]
        values = dict(zip(model.parameters, [*map(float, solution), velocity], strict=True))
        return (float(np.sum((force - columns @ solution) ** 2)), values)

    def at(log_velocity: float) -> tuple[float, dict[str, float]]:
        velocity = float(np.exp(log_velocity))
        return linear(velocity, model.columns(v, velocity))

    tried = [linear(float(x), columns) for x, columns in zip(grid, model.columns(v, grid[:, None]), strict=True)]
    ranked = sorted(range(_GRID), key=lambda i: tried[i][0])
    # the squared residual has several minima over the Stribeck velocity, and some have levels that no friction has
    best = next((i for i in ranked if model.is_sound(tried[i][1])), None)
    if best is None:
        return None
    ends = np.log(grid[max(0, best - 1)]), np.log(grid[min(_GRID - 1, best + 1)])
    solution = minimize_scalar(lambda x: at(x)[0], bounds=ends, method="bounded", options={"xatol": 1e-9})
    values = at(float(solution.x))[1]  # type: ignore[attr-defined]
    return values if model.is_sound(values) else tried[best][1]


def _predicted(model: Candidate, values: dict[str, float], v: np.ndarray) -> np.ndarray:
    names = [name for name in model.parameters if name != _VELOCITY]
    return model.columns(v, values.get(_VELOCITY, 1.0)) @ np.array([values[name] for name in names])


def _judged(name: str, residual: np.ndarray, parameters: int, runs: SteadyRuns) -> Compared:
    rms = float(np.sqrt(np.mean(residual**2)))
    return Compared(name, regression.information(residual, parameters, _sides(runs)), rms, parameters)


def _separate(runs: SteadyRuns, model: Candidate) -> Compared | None:
    """Fit a separate curve to each direction."""
    residual = np.zeros(runs.velocity.size)
    for side in _sides(runs):
        v, force = runs.velocity[side], runs.force[side]
        # a Stribeck curve has four parameters: fewer speeds leave nothing to judge it by
        if v.size <= 5:
            return None
        values = _values(v, force, model)
        if values is None:
            return None
        residual[side] = force - _predicted(model, values, v)
    return _judged(model.name, residual, 2 * len(model.parameters), runs)


def _remarks(
    best: Compared, stribeck: bool, listed: list[Compared], others: list[Compared], runs: SteadyRuns
) -> tuple[str, ...]:
    remarks: list[str] = []
    close = [other.name for other in others if other is not best and abs(other.criterion - best.criterion) < EQUAL]
    if close:
        remarks.append(
            f"the runs hardly distinguish {best.name} from {', '.join(close)}: the criterion differs by less than "
            f"{number(EQUAL)}"
        )
    first = listed[0]
    if first.criterion < best.criterion - CLEAR:
        remarks.append(
            Text(
                "a separate curve for each direction fits better (criterion lower by "
                f"{Quantity(best.criterion - first.criterion):.1f} with {first.parameters} parameters, RMS "
                f"{Quantity(first.rms, runs.frame.force):3} for {Quantity(best.rms, runs.frame.force):3}): the "
                "directions differ by more than an offset, and no friction block represents that"
            )
        )
    slowest = float(np.min(np.abs(runs.velocity)))
    if not stribeck and slowest > 0.05 * float(np.max(np.abs(runs.velocity))):
        remarks.append(
            Text(
                "it is not known whether there is a Stribeck effect: the slowest run has "
                f"{Quantity(slowest, runs.frame.velocity):3}; record runs at a tenth of it"
            )
        )
    return tuple(remarks)


def _estimates(
    runs: SteadyRuns, model: Candidate, values: dict[str, float], residual: np.ndarray, rho: float
) -> tuple[tuple[Estimate, ...], np.ndarray]:
    """Return the estimates and their covariance to first order.

    (JᵀJ)⁻¹ Jᵀ Σ J (JᵀJ)⁻¹,   Σ(i, j) = s² rho^|i - j| within a direction
    """
    columns = model.slopes(runs.velocity, values)
    n, p = columns.shape
    inverse = np.linalg.pinv(columns.T @ columns, hermitian=True)
    s2 = float(residual @ residual) / (n - p)
    shared = np.zeros((n, n))
    for side in _sides(runs):
        k = np.arange(n)[side]
        shared[side, side] = rho ** np.abs(k[:, None] - k[None, :])
    covariance = s2 * inverse @ columns.T @ shared @ columns @ inverse
    robust = regression.errors(covariance)
    ols = regression.errors(s2 * inverse)
    frame = runs.frame
    shown = {"m/s": frame.velocity, "N s/m": frame.viscous, "N": frame.force}
    declared = {name: tree.declaration(model.friction, name).unit for name in model.curve.names}
    units = [shown[declared.get(name, "N")] for name in model.parameters]
    estimates = tuple(
        Estimate(*row)
        for row in zip(model.parameters, values.values(), units, map(float, robust), map(float, ols), strict=True)
    )
    return estimates, covariance
