"""Least squares with standard errors, model selection and cross-validation."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, Generic, Self, TypeVar, cast

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.blocks.plant.transmission import radians_per_metre
from feeddrive.language import tree
from feeddrive.language.block import Block, Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, Symbol
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.trace import evaluate

NORMAL = 1.959963985  # half width of a 95 % interval of a normal error, in standard errors
SIGNIFICANT = 3.0  # standard errors beyond which an offset is not 0
LEAST_PULL = 0.05  # share of Coulomb friction beyond which an offset is a force of the axis


@dataclass(frozen=True)
class Frame:
    """The SI units of position, velocity, force, inertia and viscous friction at a table or at a shaft.

    A shaft is described in rad, N m and kg m² until its `lever` r, the table's travel per rad, is known:

        x = r θ,   F = τ / r,   m = J / r²,   b = c / r²,   r = lead / (2π gear)

    A lead is never assumed: without one a result remains rotary and cannot be used as a block of an axis.
    """

    name: str
    position: str
    velocity: str
    force: str
    inertia: str
    viscous: str


TABLE = Frame("table", "m", "m/s", "N", "kg", "N s/m")
SHAFT = Frame("shaft", "rad", "rad/s", "N m", "kg m2", "N m s/rad")
# a rotary table: its blocks are in rad and N m already, so that no lead is needed
TURNING = Frame("rotary axis", "rad", "rad/s", "N m", "kg m2", "N m s/rad")


def frame_of(rotary: bool) -> Frame:
    """Return the frame of a shaft or of a table."""
    return SHAFT if rotary else TABLE


def lever(lead: float, gear: float = 1.0) -> float:
    """Return the travel of the table per rad of the motor, m/rad; `lead` in m, `gear` in motor turns per screw turn."""
    if not (math.isfinite(lead) and lead > 0.0 and math.isfinite(gear) and gear > 0.0):
        raise ParameterError(f"lead = {Quantity(lead, 'm', stays=True):6 SI} and gear = {Quantity(gear):6} must be > 0")
    return 1.0 / (gear * float(radians_per_metre(lead)))


def power(unit: str) -> int:
    """Return the exponent n that converts a rotary quantity of this unit to the table: value · lever^n."""
    powers = {"rad": 1, "rad/s": 1, "N m": -1, "kg m2": -2, "N m s/rad": -2, "N m/rad": -2}
    return powers[unit]


def table_unit(unit: str) -> str:
    """Return the unit that a quantity with this unit at a shaft has at the table."""
    pairs = {"rad": "m", "rad/s": "m/s", "N m": "N", "kg m2": "kg", "N m s/rad": "N s/m", "N m/rad": "N/m"}
    return pairs[unit]


def require_table(frame: Frame, what: str) -> None:
    """Raise ParameterError for a result in shaft units."""
    if frame is SHAFT:
        raise ParameterError(
            f"{what} is in {frame.force} and {frame.velocity} of a shaft; give the screw's lead with  "
            f".at_table(lead=..., gear=...)  before it becomes part of an axis"
        )


@dataclass(frozen=True)
class Estimate:
    """An estimated value in SI with two standard errors.

    error  robust to autocorrelation and heteroscedasticity of the residual; this is the one to use
    ols    valid for a white residual only, s² (XᵀX)⁻¹; most papers publish this one
    """

    name: str
    value: float
    unit: str
    error: float
    ols: float

    @property
    def quantity(self) -> Quantity:
        """The value with its unit and its robust standard error."""
        return Quantity(self.value, self.unit, self.error)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval, if the model is valid."""
        return self.value - NORMAL * self.error, self.value + NORMAL * self.error

    def beside(self, other: Self) -> Self:
        """Return the estimate with its error increased by its disagreement with another one from the same log.

            error² + max(0, d² - |error² - error_other²|),   d the difference of the two values

        If the model is correct, the variance of the difference between two fits to the same log is the difference of
        their variances; any excess is due to model error.
        Source: Hausman 1978.
        """
        beyond = (self.value - other.value) ** 2 - abs(self.error**2 - other.error**2)
        return replace(self, error=math.sqrt(self.error**2 + max(0.0, beyond)))

    def towards(self, other: Self, left: float, left_by_other: float) -> Self:
        """Return the estimate with its error increased by its distance to one that contradicts it.

            error² + (s d)²,   s = min(1/√3, r/(r_other - r)),   d the difference of the two values

        left, left_by_other  r and r_other: how much of the signal the two fits leave, r < r_other

        Two values of which at least one is wrong are off by as much as what their models lack, in the same direction or
        in opposite ones: the truth is up to d r/(r_other - r) from the better one. Where both lack about as much, it
        may lie anywhere between them, and d²/3 is the mean square of a number that is even between 0 and d.
        """
        share = 1.0 / math.sqrt(3.0)
        if left_by_other > left:
            share = min(share, left / (left_by_other - left))
        return replace(self, error=math.hypot(self.error, share * (self.value - other.value)))

    def at_table(self, lever: float) -> Self:
        """Return an estimate in shaft units referred to the table."""
        factor = lever ** power(self.unit)
        unit = table_unit(self.unit)
        return replace(self, value=factor * self.value, unit=unit, error=factor * self.error, ols=factor * self.ols)


def pulls(offset: Estimate, coulomb: float) -> bool:
    """Return True if an offset is a constant force: above 3 standard errors and above 5 % of Coulomb friction.

    A smaller offset cannot move the axis, and may be caused by encoder quantization at rest, whose error is constant
    over hundreds of rows; standard errors do not account for this.
    """
    return abs(offset.value) > max(SIGNIFICANT * offset.error, LEAST_PULL * coulomb)


def estimates_table(title: str, estimates: tuple[Estimate, ...]) -> Table:
    """Return a table of estimates, with one row for each parameter."""
    return Table(title, ESTIMATE_COLUMNS, [estimate_row(estimate) for estimate in estimates])


ESTIMATE_COLUMNS = (
    "parameter",
    "unit",
    Column("value", form="6"),
    Column("standard error", form="3"),
    Column("ols", form="3"),
    "95 % interval",
)


def estimate_row(estimate: Estimate) -> list[Cell]:
    """Return the table row of an estimate, in the order of `ESTIMATE_COLUMNS`."""
    error, ols = Quantity(estimate.error, estimate.unit), Quantity(estimate.ols, estimate.unit)
    low, high = (Quantity(bound, estimate.unit, form="4", bare=True) for bound in estimate.interval)
    return [estimate.name, UNIT, estimate.quantity, error, ols, Text(f"{low} .. {high}")]


# more rows of scores are summed in blocks, which bounds the cost of the sum over lags
MOST_ROWS = 5000
_MEMORIES = np.linspace(0.0, 0.98, 99)
SHOWN_LAGS = (1, 2, 5, 10, 20)
# rows next to a stretch that are left out of its fit, too: their residuals are correlated
GAP = 5
# of columns of unit size: a smaller singular value, a direction or a speed in one row of a thousand, says nothing
_ALIKE = 1e-3


# standard deviations from its neighbors beyond which a sample is no noise: one normal value in 1e15
_STRAY = 8.0
_RARE, _FURTHER = 0.02, 4.0  # share of the samples that may be strays, and how much further off than the others
# a fault of a line or of a recorder lasts three samples at most; what lasts longer may be the motion
_STRAY_ROWS = 3
_NEAR, _AROUND = 9, 61  # rows: of the median that a sample is held against, and of the spread about it


def strays(values: np.ndarray) -> np.ndarray:
    """Return a mask of outliers: up to three successive samples far from their neighbors, shape (n,).

        d = |x - median of 9 rows| > max(8 · 1.4826 median d, 4 times the 98 % quantile of d, 8 quanta)

    The median of d is taken over 61 rows, and the largest median nearby is used, so that noise in motion after a rest
    is not an outlier; the quantum is the smallest step of the values.  Steps, ramps and stick-slip contain no outliers.
    Source: Hampel 1974 (the median and its deviation); the windows and the other bounds are ours.
    """
    # imported here: commands that only read a log start without it
    from scipy.ndimage import maximum_filter, median_filter

    if values.size < _NEAR:
        return np.zeros(values.size, bool)
    away = np.abs(values - median_filter(values, _NEAR, mode="nearest"))
    spread = maximum_filter(median_filter(away, min(_AROUND, values.size), mode="nearest"), _AROUND, mode="nearest")
    quantum = float(np.min(np.diff(np.unique(values)), initial=np.inf))
    # coarse counts through a velocity gain make a whole force ragged: its usual deviation is no fault
    usual = _FURTHER * float(np.quantile(away, 1.0 - _RARE))
    far = away > np.maximum(_STRAY * np.maximum(1.4826 * spread, quantum), usual)
    return short_runs(far, _STRAY_ROWS)


def short_runs(flags: np.ndarray, most: int) -> np.ndarray:
    """Return the flags, with runs of more than `most` successive true values cleared."""
    kept = flags.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin > most:
            kept[begin:end] = False
    return kept


def stray_remarks(where: str, values: np.ndarray, stray: np.ndarray, unit: str) -> tuple[str, ...]:
    """Return a remark on omitted outliers: their number, and row and size of the worst."""
    rows = np.flatnonzero(stray)
    if not rows.size:
        return ()
    usual = np.interp(rows, np.flatnonzero(~stray), values[~stray])
    worst = int(np.argmax(np.abs(values[rows] - usual)))
    listed = ", ".join(str(int(row) + 1) for row in rows[:6]) + (", ..." if rows.size > 6 else "")
    remark = Text(
        f"{where}: {rows.size} single sample{'s' * (rows.size != 1)} of {values.size} far from "
        f"{'their' if rows.size != 1 else 'its'} neighbors {'are' if rows.size != 1 else 'is'} left out (row "
        f"{listed}), the worst {Quantity(values[rows[worst]], unit):3} where its neighbors have "
        f"{Quantity(usual[worst], unit):3}"
    )
    return (remark,)


def median_spread(values: np.ndarray) -> float:
    """Return the standard deviation of normal values about 0 by their median size, 1.4826 median |x|."""
    return 1.4826 * float(np.median(np.abs(values)))


def ols_covariance(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return s² (XᵀX)⁻¹ with s² = rᵀr / (n - p): valid only for a white residual of constant variance."""
    n, p = columns.shape
    return float(residual @ residual) / max(n - p, 1) * inverse_gram(columns)


def robust_covariance(
    columns: np.ndarray, residual: np.ndarray, lags: int | None = None, *, smooth: int = 1
) -> np.ndarray:
    """Return n / (n - p) (XᵀX)⁻¹ S (XᵀX)⁻¹, with S the long-run covariance of the scores z(k) = x(k) r(k):

        S = Γ(0) + Σ w(j) (Γ(j) + Γ(j)ᵀ),   Γ(j) = Σ z(k) z(k-j)ᵀ,   w(j) = 1 - j / (lags + 1)

    columns   shape (n, p), or (signals, n, p) for several signals with errors that are correlated at each time
    residual  shape (n,), or (signals, n)
    smooth    largest number of rows summed to reveal the correlation length of scores, which white noise may hide

    The residual may have any autocorrelation of finite length.  By default `lags` follows from that length: twice
    1.1447 (α n)^⅓ of Andrews 1991, with α from the first autocorrelation of each score.  S becomes more uncertain with
    more lags; the factor of `widening` compensates for this, so that 1.96 standard errors remain a 95 % interval.
    Sources: Newey & West 1987; Andrews 1991, eqs. (6.2) and (6.4); Kiefer & Vogelsang 2005.
    """
    stacked = columns if columns.ndim == 3 else columns[None]
    remains = residual if residual.ndim == 2 else residual[None]
    n, p = stacked.shape[1:]
    scores = scores_of(stacked, remains)
    if lags is None and smooth > 1:
        widths = [1 << power for power in range(smooth.bit_length())]
        lags = max(width * memory(_summed(scores, width)) for width in widths)
    return n / max(n - p, 1) * long_run(scores, lags)


def scores_of(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the influence of each sample on each parameter, in units of the estimates, shape (rows, p)."""
    inverse = inverse_gram(columns.reshape(-1, columns.shape[-1]))
    return _in_blocks(np.einsum("snp,sn->np", columns, residual) @ inverse)


def long_run(scores: np.ndarray, lags: int | None = None) -> np.ndarray:
    """Return the long-run covariance of the scores over `lags`, with a Bartlett window."""
    rows = scores.shape[0]
    # more lags than a quarter of the rows leave too few products for each
    lags = max(0, min(memory(scores) if lags is None else lags, rows // 4))
    # all lags at once: the scores are convolved with the Bartlett window
    window = 1.0 - np.abs(np.arange(-lags, lags + 1)) / (lags + 1.0)
    size = 1 << (rows + 2 * lags - 1).bit_length()
    spread = np.fft.rfft(scores, size, axis=0) * np.fft.rfft(window, size)[:, None]
    total = scores.T @ np.fft.irfft(spread, size, axis=0)[lags : lags + rows]
    # the rounding of the convolution is not symmetric, and a covariance must be
    total = 0.5 * (total + total.T)
    return widening(lags / rows) ** 2 * total


def _in_blocks(scores: np.ndarray) -> np.ndarray:
    """Sum consecutive rows so that at most `MOST_ROWS` remain, which leaves the long-run covariance practically
    unchanged.
    """
    return _summed(scores, -(-scores.shape[0] // MOST_ROWS))


def _summed(scores: np.ndarray, size: int) -> np.ndarray:
    return scores if size == 1 else np.add.reduceat(scores, np.arange(0, scores.shape[0], size), axis=0)


def widening(share: float) -> float:
    """Return the ratio of a 95 % interval to 1.96 standard errors if a `share` of all lags is used with a Bartlett
    window.

    (1.9600 + 2.9694 b + 0.4160 b² - 0.5324 b³) / 1.96, b = share.  Source: Kiefer & Vogelsang 2005, table 1.
    """
    return (1.9600 + 2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3) / 1.96


def memory(scores: np.ndarray) -> int:
    """Return the correlation length of scores of shape (n, p): twice Andrews' bandwidth for the Bartlett window."""
    n = scores.shape[0]
    alpha, weight = 0.0, 0.0
    for column in scores.T:
        size = float(column @ column)
        if size <= 0.0 or n < 3:
            continue
        # as Andrews bounds it: near 1 the bandwidth would exceed the record
        rho = min(0.97, max(-0.97, float(column[1:] @ column[:-1]) / size))
        spread = size * (1.0 - rho * rho)
        alpha += 4.0 * rho**2 * spread**2 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2)
        weight += spread**2 / (1.0 - rho) ** 4
    return int(np.ceil(2.0 * 1.1447 * (alpha / weight * n) ** (1.0 / 3.0))) if weight > 0.0 else 0


def errors(covariance: np.ndarray) -> np.ndarray:
    """Return standard errors, the square roots of the diagonal."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def inverse_gram(columns: np.ndarray) -> np.ndarray:
    """Return (XᵀX)⁻¹."""
    # columns of unit size: a mass in kg and a friction in N differ by powers of ten
    sizes = np.linalg.norm(columns, axis=0)
    scaled = columns / sizes
    gram = scaled.T @ scaled
    try:
        inverse = np.linalg.inv(gram)
    # columns that depend on each other: the checks of the fit name them
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(gram)
    return inverse / np.outer(sizes, sizes)


def information(residual: np.ndarray, parameters: int, stretches: Sequence[slice] | None = None) -> float:
    """Return the Bayesian information criterion of a first-order autoregressive residual; lower is better.

        r(k) = rho r(k-1) + e(k)

        -2 log L = n log(Σ e² / n) - m log(1 - rho²)
        criterion = -2 log L + k log n · n / (n - k - 1),   k = parameters + 2

    rho >= 0 is estimated by maximum likelihood; rho and the variance of e are the two additional parameters. The last
    factor corrects for few rows, where the plain criterion selects a superfluous parameter in one case out of five.
    The usual criterion without rho treats neighboring rows as independent, and so rewards a model that fits their
    correlated noise.
    `stretches` are m series of consecutive rows (default: all rows); rho does not apply across them.
    Sources: Schwarz 1978; McQuarrie 1999 for few rows; the likelihood of a first-order process, Box & Jenkins 1970.
    """
    parts = _parts(residual, stretches)
    best = min(_likelihood(parts, rho) for rho in _MEMORIES)
    n, k = residual.size, parameters + 2
    return float(best + k * np.log(n) * n / max(n - k - 1, 1))


def likely_memory(residual: np.ndarray, stretches: Sequence[slice] | None = None) -> float:
    """Return the maximum-likelihood value of rho >= 0."""
    parts = _parts(residual, stretches)
    return float(min(_MEMORIES, key=lambda rho: _likelihood(parts, rho)))


def _parts(residual: np.ndarray, stretches: Sequence[slice] | None) -> list[np.ndarray]:
    parts = [residual] if stretches is None else [residual[part] for part in stretches]
    return [part for part in parts if part.size]


def _likelihood(parts: list[np.ndarray], rho: float) -> float:
    """Return -2 log L up to a constant."""
    n = sum(part.size for part in parts)
    # the first row has the stationary variance s²/(1 - rho²)
    first = (1.0 - rho * rho) * sum(float(part[0]) ** 2 for part in parts)
    rest = sum(float(np.sum((part[1:] - rho * part[:-1]) ** 2)) for part in parts)
    # a residual that is only rounding counts as 0
    return n * float(np.log(max((first + rest) / n, 1e-300))) - len(parts) * float(np.log(1.0 - rho * rho))


@dataclass(frozen=True, eq=False, repr=False)
class Residuals(Result):
    """The residuals measured - fitted, shape (n,), of the fitted rows.

    norm       √(rᵀr);  relative: divided by the norm of the measured values
    condition  condition number of the columns in SI units
    """

    values: np.ndarray
    measured: np.ndarray
    condition: float
    unit: str

    @property
    def norm(self) -> float:
        """The norm √(rᵀr)."""
        return float(np.linalg.norm(self.values))

    @property
    def relative(self) -> float:
        """The relative norm |r| / |y|."""
        return self.norm / float(np.linalg.norm(self.measured))

    @property
    def deviation(self) -> float:
        """The standard deviation, in the unit of the force."""
        return float(np.std(self.values, ddof=1))

    def autocorrelation(self, lag: int) -> float:
        """Return the autocorrelation Σ r(k) r(k - lag) / Σ r(k)², which is within ±2/√n for a white residual."""
        r = self.values
        return float(r[lag:] @ r[: r.size - lag]) / float(r @ r)

    @property
    def white(self) -> bool:
        """True if the first autocorrelation is within the 95 % range of a white residual."""
        return abs(self.autocorrelation(1)) < 1.96 / np.sqrt(self.values.size)

    def table(self) -> Table:
        """Return a table of the norms and the autocorrelation."""
        rows: list[Sequence[Cell]] = [
            ["norm", UNIT, Quantity(self.norm, self.unit, form="6")],
            ["relative to the measured force", UNIT, Quantity(self.relative, "share")],
            ["standard deviation", UNIT, Quantity(self.deviation, self.unit)],
            ["condition of the columns", UNIT, Quantity(self.condition, form="6")],
        ]
        lags = [lag for lag in SHOWN_LAGS if lag < self.values.size]
        rows += [
            [f"autocorrelation at lag {lag}", UNIT, Quantity(self.autocorrelation(lag), form=".2f")] for lag in lags
        ]
        what = "white" if self.white else "not white: errors for a white residual (ols) are too small"
        return Table(f"residual of {self.values.size} rows, {what}", ["", "unit", "value"], rows)


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Result):
    """The result of a cross-validation: relative prediction errors of unused stretches, and the parameters of the fits.

    relative  RMS of all errors on unused rows over the RMS of the measured values
    values    shape (stretches, parameters)
    expected  the part of `relative` that the errors of the parameters of these fits explain
    """

    errors: np.ndarray
    relative: float
    values: np.ndarray
    unit: str
    expected: float = 0.0

    def table(self) -> Table:
        """Return a table with one row for each stretch."""
        rows = [[i + 1, float(error)] for i, error in enumerate(self.errors)]
        columns = ["stretch", Column("error", "share", "3")]
        return Table(f"unused rows: {Quantity(self.relative, 'share'):3} RMS", columns, rows)


def cross_validated(
    columns: np.ndarray, measured: np.ndarray, folds: int, unit: str, widened: float = 1.0
) -> Validation:
    """Predict each stretch of rows by a fit without it and without `GAP` rows on both sides.

    If only one stretch contains a direction or a speed, the fit without it lacks this information, and the
    prediction error is large; so is `expected`.

        expected² = Σ x' S x,   S = s² (X'X)⁻¹ widened²,   s² and X of the rows of each fit, x of the rows predicted

    widened  errors of the parameters over those for a white residual
    """
    n = measured.size
    if not 2 <= folds <= n // (4 * GAP):
        raise ParameterError(f"folds = {folds} must be >= 2 and <= {n // (4 * GAP)}, for {n} rows")
    edges = np.linspace(0, n, folds + 1).astype(int)
    squares, sizes, parameters, chance = [], [], [], 0.0
    for begin, end in pairwise(edges):
        used = np.ones(n, dtype=bool)
        used[max(0, begin - GAP) : end + GAP] = False
        values = np.linalg.lstsq(columns[used], measured[used], rcond=None)[0]
        off = measured[begin:end] - columns[begin:end] @ values
        left = measured[used] - columns[used] @ values
        sizes_of = np.linalg.norm(columns[used], axis=0)
        scaled = columns[used] / np.where(sizes_of > 0.0, sizes_of, 1.0)
        if np.linalg.matrix_rank(scaled, tol=_ALIKE) == values.size:
            variance = float(left @ left) / max(1, left.size - values.size) * inverse_gram(columns[used])
            chance += widened**2 * float(np.einsum("ip,pq,iq->", columns[begin:end], variance, columns[begin:end]))
        else:
            # the others hold hardly any motion in one direction, and say nothing of it
            chance += float(off @ off)
        squares.append(float(off @ off))
        sizes.append(float(measured[begin:end] @ measured[begin:end]))
        parameters.append(values)
    relative = np.sqrt(np.array(squares) / np.maximum(np.array(sizes), np.finfo(float).tiny))
    expected = float(np.sqrt(max(0.0, chance) / sum(sizes)))
    return Validation(relative, float(np.sqrt(sum(squares) / sum(sizes))), np.array(parameters), unit, expected)


B = TypeVar("B", bound=Block)


class TracedForce(Generic[B]):
    """A block's force as a function of its arguments, traced once together with its derivatives.

    `force` is called with the block, whose leaves are symbols, and with the arguments by name; `names`
    are the names of the leaves.
    """

    def __init__(self, block: B, arguments: Sequence[str], force: Callable[[B, Mapping[str, Number]], Number]) -> None:
        # imported late: a log is read and judged without derivatives
        from feeddrive.loop.gradient import push

        graph = Graph()
        self.names, self.arguments = tuple(name for name, _ in tree.leaves(block)), tuple(arguments)
        leaves = [graph.input(name) for name in self.names]
        symbolic = tree.rebuild(block, (cast(Number, leaf) for leaf in leaves))
        # the prefix keeps an argument apart from a parameter of the same name
        symbols = {name: cast(Number, graph.input(f"of {name}")) for name in self.arguments}
        end = graph.symbol(force(symbolic, symbols)).index
        values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
        slopes = [push(graph, [end], values, {leaf.index: 1.0})[0] for leaf in leaves]
        self.graph = graph
        self.ends = [end, *(graph.symbol(0.0 if slope is None else slope).index for slope in slopes)]

    def at(self, values: Mapping[str, Any], **arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the force and its derivatives along the last axis; leaf values are numbers or broadcastable arrays."""
        leaves = {name: np.asarray(values[name], np.float64) for name in self.names}
        leaves |= {f"of {name}": np.asarray(arguments[name], np.float64) for name in self.arguments}
        shape = np.broadcast_shapes(*(leaf.shape for leaf in leaves.values()))
        force, *slopes = evaluate(self.graph, self.ends, leaves)
        return np.broadcast_to(force, shape), np.stack([np.broadcast_to(slope, shape) for slope in slopes], axis=-1)


@lru_cache(maxsize=32)
def steady_curve(friction: Friction) -> TracedForce[Friction]:
    """Trace `friction.steady` as a function of "velocity"; the values in the block are ignored."""
    return TracedForce(friction, ("velocity",), lambda block, arguments: block.steady(arguments["velocity"]))


def solve(
    seen: np.ndarray, error: np.ndarray, mu: float, least: np.ndarray, most: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the step Δ within bounds that minimizes |Ψ Δ - e|² + mu |S Δ|², and the active bounds.

    Ψ is `seen`, of shape (samples, columns), and e is `error`; S scales the columns of Ψ to 1.  Without an active bound
    the step is (ΨᵀΨ + mu S²)⁻¹ Ψᵀ e.
    """
    # imported here: commands that only read a log start without it
    from scipy.optimize import lsq_linear

    if not seen.shape[1]:
        return np.zeros(0), np.zeros(0, dtype=bool)
    sizes = np.linalg.norm(seen, axis=0)
    rows = np.vstack([seen / sizes, np.sqrt(mu) * np.eye(sizes.size)])
    right = np.concatenate([error, np.zeros(sizes.size)])
    step = np.linalg.lstsq(rows, right, rcond=None)[0]
    low, high = least * sizes, most * sizes
    # the bounds are rarely active, and the unbounded solution needs no iteration
    if np.all(step >= low) and np.all(step <= high):
        return step / sizes, np.zeros(sizes.size, dtype=bool)
    # the triangular factor has the same minimum and only a few rows
    q, r = np.linalg.qr(rows)
    bounded = lsq_linear(r, q.T @ right, bounds=(low, high), method="bvls", tol=1e-14)
    return bounded.x / sizes, bounded.active_mask != 0


def standard_errors(seen: np.ndarray, residual: np.ndarray, lags: int) -> np.ndarray:
    """Return the standard error of each parameter, from the residual and its autocorrelation.

        cov = A⁻¹ [Σ_f S(f) Ψ(f) Ψ(f)ᴴ] A⁻¹,   A = ΨᵀΨ,   S: spectrum of the residual

    S follows from the autocorrelation of the residual up to `lags`, with a Bartlett window, which ensures S >= 0.  For
    a white residual this is the usual σ² A⁻¹.  The mean of the residual is not removed, since no column is a constant.
    Source: Newey & West 1987, for regressors that are not random.
    """
    n, count = seen.shape
    if not count:
        return np.zeros(0)
    # padded to twice the length, so that the correlation does not wrap around
    size = 1 << (2 * n - 1).bit_length()
    lags = max(1, min(lags, n // 4))
    spectrum = np.abs(np.fft.rfft(residual, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: lags + 1] / max(n - count, 1)
    correlation *= 1.0 - np.arange(lags + 1) / (lags + 1.0)
    even = np.zeros(size)
    even[: lags + 1], even[size - lags :] = correlation, correlation[1:][::-1]
    colour = np.maximum(np.fft.rfft(even).real, 0.0)
    sizes = np.linalg.norm(seen, axis=0)
    lines = np.fft.rfft(seen / sizes, size, axis=0)
    # a line between 0 Hz and Nyquist stands for its negative frequency, too
    weight = np.full(colour.size, 2.0)
    weight[0] = weight[-1] = 1.0
    inner = ((weight * colour)[:, None] * lines).T @ lines.conj()
    inverse = np.linalg.inv((seen / sizes).T @ (seen / sizes))
    covariance = inverse @ inner.real @ inverse / size
    return np.sqrt(np.maximum(np.diag(covariance), 0.0)) / sizes
