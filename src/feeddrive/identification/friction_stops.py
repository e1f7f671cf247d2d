"""Friction with its presliding from a log: stops in parallel, by non-negative least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.feedforward.friction_stops import FrictionStops
from feeddrive.identification.estimate import SHAFT, Estimate, estimates_table
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.preparation import Preparation, prepare
from feeddrive.identification.regression import errors, ols_covariance, robust_covariance
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text

WIDTHS = tuple(np.geomspace(0.5e-6, 200e-6, 15).tolist())  # m
_UNUSED = 3  # one of so many parts of the log, the last, tests what the others gave
_USUAL = 0.999  # of the rows, whose largest force is that of the axis
_MOST_LEVEL = 3.0  # times that force, which no sum of stops can exceed
_RIDGE = 1e-3  # of the bells: their prior is so many times wider than the noise of a row


@dataclass(frozen=True, eq=False, repr=False)
class LearnedStops(Result):
    """The elastic stops that explain the friction of a log, and what else moved the axis.

    stops       the feedforward block
    estimates   mass (where it was not given), viscous friction, offset, the level Σ k δ and the stiffness Σ k of all
    left        RMS of the force that is left in N: of the rows that were used, and of the last third, which was not
    plain       the same two of Coulomb and viscous friction
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
        """Return the estimates with both standard errors; the note states the number of stops and their residual."""
        title = Text(
            f"{self.name}: {len(self.stops.width)} stops leave {Quantity(self.left[0], 'N'):3} RMS, "
            f"{Quantity(self.left[1], 'N'):3} of rows not used; Coulomb and viscous friction "
            f"{Quantity(self.plain[0], 'N'):3} and {Quantity(self.plain[1], 'N'):3}"
        )
        return estimates_table(title, self.estimates)


def stretches(position: np.ndarray, width: float) -> np.ndarray:
    """Return e(k) = clip(e(k-1) + x(k) - x(k-1), ±width) in m, from e = 0 on; shape of the position."""
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
    """Fit   force = mass a + viscous v + offset + Σ k_i e_i,   all but the offset >= 0,   to a log.

    mass    kg that is known, 0 where the force is friction alone; default: estimated with the rest
    widths  m of the stops that are offered; those that get no stiffness are left out of the result
    bells   how many Gaussian bells over the speed take what the stops leave; 0: none
    how     default: rows of a millisecond, reversals kept, the position filtered at 200 Hz

    Columns are the stops' stretches on the measured position, reduced as the force is, and scaled to the same size.
    Bells are a ridge regression, which is the mean of a Gaussian process with that kernel; they stand at equal
    distances from the least to the largest speed.  Standard errors are those of the columns that count, and hold for
    autocorrelated residuals; they know nothing of widths that were not offered.

    When not: without reversals, or with the widest stop wider than half of the travel (NotIdentifiableError).  Move to
    and fro over 1 um to some mm, slowly and fast.
    Source: Lawson & Hanson 1974 (non-negative least squares); the columns: Al-Bender, Lampaert & Swevers 2004.
    """
    _check(log, widths, mass, bells)
    from scipy.optimize import nnls  # not for commands that only read

    few = max(1, round(1e-3 / log.sample_time))
    prepared = prepare(log, how or Preparation(cutoff=200.0, decimation=few, reversals=True))
    rows = [prepared.reduced(stretches(log.position, width)) for width in widths]
    free = {"viscous": prepared.velocity, "offset": prepared.constant, "less": -prepared.constant}
    if mass is None:
        free["mass"] = prepared.acceleration
    columns = np.column_stack([*rows, *free.values()])
    force = prepared.force - (0.0 if mass is None else mass) * prepared.acceleration
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
    if len(kept) == 1:  # a table has two entries at least: its neighbor, without stiffness
        kept = sorted([*kept, kept[0] - 1 if kept[0] else 1])
    stops = FrictionStops(width=np.array([widths[i] for i in kept]), stiffness=solution[kept])
    if bells:
        stops = _with_bells(stops, prepared.velocity, residual, used, bells)
        residual = residual - _bell_force(stops, prepared.velocity)
    estimates = _estimates(columns[used][:, counts], residual[used], counts, solution, widths, list(free))
    sides = np.column_stack([np.sign(prepared.velocity), *free.values()])
    plain = force - sides @ np.linalg.lstsq(sides[used], force[used], rcond=None)[0]
    return LearnedStops(log.name, stops, estimates, _parts(residual, used), _parts(plain, used))


def _check(log: MotionLog, widths: Sequence[float], mass: float | None, bells: int) -> None:
    if log.frame is SHAFT:
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
    """Return the RMS of the rows that were used, and of the others."""
    others = residual[used.stop :]
    return float(np.sqrt(np.mean(residual[used] ** 2))), float(np.sqrt(np.mean(others**2)))


def _with_bells(
    stops: FrictionStops, velocity: np.ndarray, residual: np.ndarray, used: slice, count: int
) -> FrictionStops:
    """Return the stops with bells over the speed, fitted to their residual."""
    v, left = velocity[used], residual[used]
    places = np.linspace(float(np.min(v)), float(np.max(v)), count)
    wide = float(places[1] - places[0])
    columns = np.exp(-0.5 * ((v[:, None] - places) / wide) ** 2)
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


def _estimates(
    columns: np.ndarray,
    residual: np.ndarray,
    counts: np.ndarray,
    solution: np.ndarray,
    widths: Sequence[float],
    names: list[str],
) -> tuple[Estimate, ...]:
    """Return sums over the columns that count, with the errors of these sums."""
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
        errors(shares / scale @ of(columns / scale, residual) @ (shares / scale).T)
        for of in (robust_covariance, ols_covariance)
    )
    return tuple(
        Estimate(name, float(value), unit, float(error), float(ols))
        for (name, unit, _), value, error, ols in zip(sums, shares @ solution[counts], robust, white, strict=True)
    )


def _share(names: list[str], place: int, name: str) -> float:
    """Return the weight of a column in an estimate: the two of the offset count against each other."""
    if place < 0:
        return 0.0
    here = names[place]
    return 1.0 if here == name else -1.0 if here == "less" and name == "offset" else 0.0
