"""Statistics of the rows of a sweep: rows as arrays, yield, worst cases, sensitivity, quantile bands and Pareto fronts.

The first-order index of a factor is the expected share of the figure's variance that would vanish if the factor were
fixed; the total index is the expected share that would remain if all other factors were fixed.  Source: Saltelli et al.
2010, by `scipy.stats.sobol_indices`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.figures import of_loops
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import StiffnessAt
from feeddrive.figures.of_runs import FOLLOWING_PEAK, FOLLOWING_RMS, TRACKING_END, TRACKING_PEAK, TRACKING_RMS
from feeddrive.language.errors import CancelledError, FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.simulate import Run
from feeddrive.study.chunk import REASON, VARIANT, run_of
from feeddrive.study.store import Store
from feeddrive.study.study import Bound, Study
from feeddrive.study.variants import variant_groups, variants

if TYPE_CHECKING:
    import pyarrow


LEVEL = 0.95


@dataclass(frozen=True)
class Share:
    """A number of machines out of a total, with a confidence interval for the share in the whole population.

    sampled  True if the machines were drawn at random; points of a grid have no confidence interval
    """

    kept: int
    of: int
    sampled: bool = True

    @property
    def value(self) -> float:
        """The share, 0 to 1."""
        return self.kept / self.of

    @property
    def interval(self) -> tuple[float, float] | None:
        """The confidence interval (low, high) at the level `LEVEL`, or None if the machines are not a random sample."""
        if not self.sampled:
            return None
        low, high = clopper_pearson(self.kept, self.of)
        return float(low), float(high)


def clopper_pearson(kept: Any, of: Any, level: float = LEVEL) -> tuple[Any, Any]:
    """Return the Clopper-Pearson confidence interval (low, high) of a share, from `kept` machines out of `of`.

        P(X >= kept | low) = P(X <= kept | high) = (1 - level) / 2,   X binomial

    It contains the true share in at least the fraction `level` of all studies, whatever the share and the number of
    machines.  Wilson's interval and the mid-P interval are shorter but do not guarantee this: for a true share of
    0.9992 and 200 machines, Wilson's interval contains it in only 85 % of all studies.

    Arguments are numbers or arrays.  Source: Clopper & Pearson 1934.
    """
    # Deferred: the import takes 60 ms.
    from scipy.special import betaincinv

    tail = 0.5 * (1.0 - level)
    kept, of = np.asarray(kept, dtype=np.float64), np.asarray(of, dtype=np.float64)
    # `where` evaluates both branches, and betaincinv needs positive parameters in the discarded one, too.
    low = np.where(kept > 0, betaincinv(np.maximum(kept, 1.0), of - kept + 1.0, tail), 0.0)
    high = np.where(kept < of, betaincinv(kept + 1.0, np.maximum(of - kept, 1.0), 1.0 - tail), 1.0)
    return low, high


@dataclass(frozen=True, eq=False)
class Judged:
    """The rows of a study with their figures, in SI units; n is the number of rows.

    variant  numbers of the variants, shape (n,)
    varied   varied values by column, shape (n,); dtype object for strings and counts
    figures  figures by key, shape (n,); NaN for a variant without the figure
    reasons  the failure reason of each variant; None if it has figures
    """

    study: Study
    variant: np.ndarray
    varied: Mapping[str, np.ndarray]
    figures: Mapping[str, np.ndarray]
    reasons: np.ndarray

    @cached_property
    def bad(self) -> np.ndarray:
        """True for variants whose figures could not be computed, shape (n,)."""
        return np.array([reason is not None for reason in self.reasons], dtype=bool)

    @cached_property
    def kept(self) -> dict[str, np.ndarray]:
        """Masks of the variants that satisfy each bound, by key of its figure; False for variants without figures."""
        return {
            bound.figure.key: bound.kept(self.figures[bound.figure.key]) & ~self.bad
            for bound in self.study.specification
        }

    @cached_property
    def inside(self) -> np.ndarray:
        """True for variants that satisfy the whole specification; if there is no specification, for all variants whose
        figures were computed.
        """
        return np.logical_and.reduce([~self.bad, *self.kept.values()])

    @cached_property
    def drawn(self) -> np.ndarray:
        """True for variants that are independent draws.

        With the sampler saltelli, variants that recombine two other variants are not independent.
        """
        count = 2 * self.study.points if self.study.sampler == "saltelli" else self.study.count
        return self.variant < count

    def some(self, chosen: np.ndarray) -> Judged:
        """Return the rows selected by a mask."""
        return Judged(
            self.study,
            self.variant[chosen],
            {name: values[chosen] for name, values in self.varied.items()},
            {name: values[chosen] for name, values in self.figures.items()},
            self.reasons[chosen],
        )


def judged(rows: pyarrow.Table, study: Study) -> Judged:
    """Convert a table of rows to arrays. Raise ParameterError for a table that lacks a column of the study."""
    figures = [figure.key for figure in study.measure]
    absent = sorted({VARIANT, REASON, *study.columns, *figures} - set(rows.column_names))
    if absent:
        raise ParameterError(f"these are not rows of {study.file.name}: there is no column '{absent[0]}'")

    def column(name: str) -> Any:
        return rows.column(name).to_numpy()

    return Judged(
        study,
        column(VARIANT),
        {name: column(name) for name in study.columns},
        {name: np.asarray(column(name), dtype=np.float64) for name in figures},
        column(REASON).astype(object),
    )


def parts(rows: Store | pyarrow.Table, study: Study) -> Iterator[Judged]:
    """Yield all rows chunk by chunk, so that only one chunk is in memory."""
    tables = rows.batches() if isinstance(rows, Store) else _cut(rows, study.chunk)
    for table in tables:
        yield judged(table, study)


def _cut(rows: pyarrow.Table, size: int) -> Iterator[pyarrow.Table]:
    for first in range(0, rows.num_rows, size):
        yield rows.slice(first, size)


def joined(several: list[Judged]) -> Judged:
    """Concatenate the rows of one or more parts."""
    first = several[0]
    return Judged(
        first.study,
        np.concatenate([part.variant for part in several]),
        {name: np.concatenate([part.varied[name] for part in several]) for name in first.varied},
        {name: np.concatenate([part.figures[name] for part in several]) for name in first.figures},
        np.concatenate([part.reasons for part in several]),
    )


# With 200,000 rows a quantile is within 0.4 % of its rank with 99 % probability.
MOST = 200_000


class Sampled:
    """A collector of a random sample of the drawn machines: all of them, or about `MOST`, each chosen with equal
    probability.
    """

    def __init__(self, study: Study) -> None:
        self._study = study
        drawn = 2 * study.points if study.sampler == "saltelli" else study.count
        self._share = min(1.0, MOST / drawn)
        self._parts: list[Judged] = []

    def add(self, rows: Judged) -> None:
        """Add a random selection of the given rows; it depends only on the seed and on the number of their first
        variant.
        """
        chosen = rows.drawn
        if self._share < 1.0 and chosen.any():
            rng = np.random.default_rng([self._study.seed, int(rows.variant[0])])
            chosen = chosen & (rng.random(chosen.size) < self._share)
        # One part is kept even if it is empty, since it defines the columns of the sample.
        if chosen.any() or not self._parts:
            self._parts.append(rows.some(chosen))

    def result(self) -> Judged:
        """Return the sample; at least one part must have been added."""
        return joined(self._parts)


_MOST_VALUES = 50  # values of a choice that are counted separately


@dataclass(frozen=True)
class BoundYield:
    """A bound of the specification, the share of machines that satisfy it, and the number that violate only it."""

    bound: Bound
    kept: Share
    alone: int


@dataclass(frozen=True)
class Yield:
    """The yield of the drawn machines.

    inside  machines that satisfy the whole specification; if there is no specification, all whose figures were computed
    bad     number of machines whose figures could not be computed: they satisfy no bound
    bounds  one entry per bound, in the order of the study file
    choices the share inside the specification, by the column and value of each choice (law, machine, position)
    """

    inside: Share
    bad: int
    bounds: tuple[BoundYield, ...]
    choices: Mapping[str, Mapping[str, Share]]

    @property
    def hardest(self) -> BoundYield | None:
        """The bound that most machines violate, or None if all machines satisfy all bounds."""
        broken = [bound_yield for bound_yield in self.bounds if bound_yield.kept.kept < bound_yield.kept.of]
        return min(broken, key=lambda bound_yield: bound_yield.kept.kept, default=None)


class YieldCount:
    """A collector that counts, part by part, the machines that satisfy the bounds."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._all = self._inside = self._bad = 0
        self._kept = Counter[str]()
        self._alone = Counter[str]()
        self._choices: dict[str, Counter[tuple[str, bool]]] = {}

    def add(self, rows: Judged) -> None:
        """Count these rows, except those that are not independent draws."""
        drawn = rows.drawn
        self._all += int(np.sum(drawn))
        self._inside += int(np.sum(rows.inside & drawn))
        self._bad += int(np.sum(rows.bad & drawn))
        broken = sum((~kept for kept in rows.kept.values()), np.zeros(drawn.size, dtype=np.int64))
        for name, kept in rows.kept.items():
            self._kept[name] += int(np.sum(kept & drawn))
            # A variant without figures counts as violating every bound: under a single bound it would look as if only
            # that failed.
            self._alone[name] += int(np.sum(~kept & (broken == 1) & ~rows.bad & drawn))
        for column, values in rows.varied.items():
            if values.dtype == object:
                # Choices, settings and counts are objects; continuous numbers have no values to count.
                count = self._choices.setdefault(column, Counter())
                count.update(zip(map(str, values[drawn]), rows.inside[drawn].tolist(), strict=True))

    def result(self) -> Yield:
        """Return the yield of all rows added."""
        sampled = self._study.sampler != "grid"
        bounds = tuple(
            BoundYield(bound, Share(self._kept[bound.figure.key], self._all, sampled), self._alone[bound.figure.key])
            for bound in self._study.specification
        )
        choices: dict[str, dict[str, Share]] = {}
        for column, count in self._choices.items():
            values = sorted({value for value, _ in count})[:_MOST_VALUES]
            choices[column] = {
                value: Share(count[value, True], count[value, True] + count[value, False], sampled) for value in values
            }
        return Yield(Share(self._inside, self._all, sampled), self._bad, bounds, choices)


WORST = 3  # worst variants kept per figure
BAD = 10  # variants without figures that are listed


@dataclass(frozen=True)
class WorstVariant:
    """A variant, the value of its figure, and its varied numbers, all in SI units."""

    variant: int
    value: float
    varied: Mapping[str, float | str]


@dataclass(frozen=True)
class Worst:
    """The worst variants of a figure, sorted with the worst one first."""

    figure: Figure
    cases: tuple[WorstVariant, ...]


class WorstKept:
    """A collector that finds the worst variants part by part; variants with equal values are sorted by number."""

    def __init__(self, study: Study) -> None:
        self._cases: dict[Figure, list[WorstVariant]] = {figure: [] for figure in study.measure if figure.better}
        self.bad: list[tuple[int, str]] = []

    def add(self, rows: Judged) -> None:
        """Add the rows of one chunk."""
        for figure, cases in self._cases.items():
            # With this sign the worst value is the smallest.
            sign = 1.0 if figure.better == "higher" else -1.0
            values = sign * rows.figures[figure.key]
            some = np.flatnonzero(~np.isnan(values))
            # A stable sort keeps the lower number of equal values, so that the result is the same for every size of the
            # chunks.
            some = some[np.argsort(values[some], kind="stable")[:WORST]]
            cases += [_case(rows, place, figure.key) for place in some.tolist()]
            cases.sort(key=lambda case: (sign * case.value, case.variant))
            del cases[WORST:]
        for place in np.flatnonzero(rows.bad)[: BAD - len(self.bad)].tolist():
            self.bad.append((int(rows.variant[place]), str(rows.reasons[place])))

    def result(self) -> tuple[Worst, ...]:
        """Return the worst variants for each figure for which either larger or smaller values are better."""
        return tuple(Worst(figure, tuple(cases)) for figure, cases in self._cases.items() if cases)


def _case(rows: Judged, place: int, figure: str) -> WorstVariant:
    varied = {
        name: values[place] if values.dtype == object else float(values[place]) for name, values in rows.varied.items()
    }
    return WorstVariant(int(rows.variant[place]), float(rows.figures[figure][place]), varied)


INSIDE = "inside"
"""An output in addition to the figures: 1 for a machine inside the specification, otherwise 0."""
_LEAST_POINTS = 32
_RESAMPLES, _WORK = 999, 4e9  # limits of the bootstrap: resamples, and numbers to process


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """The Sobol indices of one output, each of shape (factors,), with confidence intervals at the level `LEVEL`.

    points   number of points used
    without  number of points excluded because a variant of the point has no finite figure
    """

    output: str
    factors: tuple[str, ...]
    first: np.ndarray
    first_interval: np.ndarray  # (2, factors)
    total: np.ndarray
    total_interval: np.ndarray
    points: int
    without: int

    @property
    def order(self) -> np.ndarray:
        """The indices of the factors, sorted by decreasing total Sobol index."""
        return np.argsort(-self.total, kind="stable")


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's rank correlation of an output with a varied number, -1 to 1, and its interval at the level `LEVEL`.

    If the effect is monotone, its square is the fraction of the variance of the ranks that the number explains.
    """

    output: str
    column: str
    value: float
    interval: tuple[float, float] | None


class SaltelliRows:
    """A collector that stores the outputs of all variants of a study with the sampler saltelli, chunk by chunk.

    It needs 8 bytes per variant and output.
    """

    def __init__(self, study: Study) -> None:
        self._study = study
        names = [figure.key for figure in study.measure] + ([INSIDE] if study.specification else [])
        self._values = {name: np.full(study.count, np.nan) for name in names if study.sampler == "saltelli"}

    def add(self, rows: Judged) -> None:
        """Store the outputs of the rows of one chunk."""
        for name, values in self._values.items():
            values[rows.variant] = rows.inside if name == INSIDE else rows.figures[name]

    def result(self) -> tuple[SobolIndices, ...]:
        """Return the indices of each output that varies and is finite at enough points."""
        factors = tuple(varied.name for varied in self._study.vary)
        indices = (sobol(name, values, factors, self._study.seed) for name, values in self._values.items())
        return tuple(row for row in indices if row is not None)


def sobol(output: str, values: np.ndarray, factors: tuple[str, ...], seed: int = 0) -> SobolIndices | None:
    """Return the Sobol indices of an output from its values at all points of A, then of B, AB_1 .. AB_k.

    For k factors the values have the shape ((k + 2) points,).  The result is None if the output does not vary, or if
    fewer than 32 points have only finite values.  The intervals are percentiles of a bootstrap over points, drawn with
    `seed`.
    """
    # Deferred: the import takes 0.3 s, and only answers need it.
    from scipy import stats

    rows = values.reshape(len(factors) + 2, -1)
    whole = np.isfinite(rows).all(axis=0)
    # SciPy needs a power of 2.
    points = 1 << (int(whole.sum()).bit_length() - 1) if whole.any() else 0
    if points < _LEAST_POINTS:
        return None
    rows = rows[:, np.flatnonzero(whole)[:points]]
    # The variance is that of A and B: a constant output would divide 0 by 0.
    if np.ptp(rows[:2]) == 0.0:
        return None

    def indices(chosen: np.ndarray) -> np.ndarray:
        f = rows[:, chosen]
        # Values computed beforehand are passed as a dictionary; f_AB has the shape (factors, outputs, points).
        of = {"f_A": f[None, 0], "f_B": f[None, 1], "f_AB": f[2:, None]}
        result: Any = stats.sobol_indices(func=of, n=points)
        return np.stack([np.atleast_1d(result.first_order), np.atleast_1d(result.total_order)])

    resamples = int(min(_RESAMPLES, max(99, _WORK / rows.size)))
    drawn = stats.bootstrap(
        # Whole points are resampled: the k + 2 values of a point depend on each other.
        (np.arange(points),),
        indices,
        method="percentile",
        confidence_level=LEVEL,
        n_resamples=resamples,
        vectorized=False,
        rng=np.random.default_rng([seed, points]),
    )
    estimate = indices(np.arange(points))
    interval = np.stack([drawn.confidence_interval.low, drawn.confidence_interval.high])
    return SobolIndices(
        output,
        factors,
        estimate[0],
        interval[:, 0],
        estimate[1],
        interval[:, 1],
        points,
        values.size // len(rows) - points,
    )


def rank_correlations(sample: Judged) -> tuple[RankCorrelation, ...]:
    """Return the rank correlations of all figures with all varied numbers, sorted by magnitude for each figure."""
    numbers = {name: values.astype(float) for name, values in sample.varied.items() if _is_number(values)}
    outputs: Mapping[str, np.ndarray] = sample.figures
    if sample.study.specification:
        outputs = {**outputs, INSIDE: np.where(sample.bad, 0.0, sample.inside)}
    correlations: list[RankCorrelation] = []
    for output, values in outputs.items():
        own = list(_of_output(output, values, numbers, sample.study.sampler != "grid"))
        correlations += sorted(own, key=lambda rank: -abs(rank.value))
    return tuple(correlations)


def _is_number(values: np.ndarray) -> bool:
    return values.dtype != object


def _of_output(
    output: str, values: np.ndarray, numbers: Mapping[str, np.ndarray], sampled: bool
) -> Iterator[RankCorrelation]:
    from scipy import stats

    there = ~np.isnan(values)
    count = int(there.sum())
    # The variance of Fisher's transform has count - 3 in its denominator, and constant values have no ranks to
    # correlate.
    if count < 4 or np.ptp(values[there]) == 0.0:
        return
    ranked = stats.rankdata(values[there])
    for column, drawn in numbers.items():
        if np.ptp(drawn[there]) == 0.0:
            continue
        value = float(np.corrcoef(ranked, stats.rankdata(drawn[there]))[0, 1])
        yield RankCorrelation(output, column, value, _fisher(value, count) if sampled else None)


def _fisher(value: float, count: int) -> tuple[float, float]:
    """Return the confidence interval of a rank correlation: Fisher's transform, variance by Bonett & Wright 2000."""
    from scipy.special import ndtri

    # arctanh is infinite at ±1.
    if abs(value) >= 1.0:
        return value, value
    half = float(ndtri(0.5 + 0.5 * LEVEL)) * np.sqrt((1.0 + 0.5 * value * value) / (count - 3))
    middle = np.arctanh(value)
    return float(np.tanh(middle - half)), float(np.tanh(middle + half))


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_LEAST_LINES = 3  # fewest frequencies of a band
_RUNS, _FEWEST, _SAMPLES = 128, 16, 2e7  # machines to simulate again: most, fewest; total samples
_WINDOWS = 500


@dataclass(frozen=True, eq=False)
class Band:
    """Quantiles over the machines, shape (5, n), as a function of x, shape (n,): frequency (Hz) or window center (s).

    machines  number of machines
    unit      SI unit of the quantiles
    """

    x: np.ndarray
    quantiles: np.ndarray
    unit: str
    machines: int

    def at(self, quantile: float) -> np.ndarray:
        """Return one quantile, which must be one of `QUANTILES`, shape (n,)."""
        return self.quantiles[QUANTILES.index(quantile)]


def stiffness_band(sample: Judged) -> Band | None:
    """Return the quantile band of the figures stiffness_F_Hz_N_per_m; None if fewer than three of them are measured."""
    lines = {figure.of.frequency: figure.key for figure in sample.study.measure if isinstance(figure.of, StiffnessAt)}
    if len(lines) < _LEAST_LINES or sample.bad.all():
        return None
    frequency = np.array(sorted(lines))
    values = np.stack([sample.figures[lines[line]][~sample.bad] for line in frequency.tolist()], axis=1)
    return Band(frequency, np.nanquantile(values, QUANTILES, axis=0), "N/m", len(values))


def error_band(sample: Judged, progress: Progress | None = None) -> Band | None:
    """Return the quantile band of the peak following error in up to 500 time windows, over up to 128 machines.

    The machines are drawn at random from those whose figures were computed, and simulated again; motions of unequal
    length are truncated to the shortest one. The result is None if no machine can be run.
    """
    study, progress = sample.study, progress or Progress()
    good = sample.variant[~sample.bad]
    # Random, since the first variants of a grid or of a Saltelli design are no sample of the machines.
    rng = np.random.default_rng([study.seed, 1])
    order = rng.permutation(good)[:_RUNS].tolist()
    errors: list[np.ndarray] = []
    times: list[np.ndarray] = []
    most = _RUNS
    for done, variant in enumerate(order):
        if done >= most:
            break
        progress.step("following error over time", done, min(most, len(order)))
        run = _run(study, variant)
        if run is None:
            continue
        # The length of a motion is known only from its run, so the number of runs is adapted on the way.
        most = max(_FEWEST, min(_RUNS, int(_SAMPLES / run.samples)))
        width = -(-run.samples // _WINDOWS)
        edges = np.arange(0, run.samples, width)
        # The peak of each window, since a thinned signal would miss peaks.
        errors.append(np.maximum.reduceat(np.abs(run["following_error"]), edges))
        times.append(run.time[0] + (edges + 0.5 * width) * run.sample_time)
    if not errors:
        return None
    shortest = min(range(len(times)), key=lambda i: float(times[i][-1]))
    x = times[shortest]
    rows = [np.interp(x, time, error) for time, error in zip(times, errors, strict=True)]
    return Band(x, np.quantile(rows, QUANTILES, axis=0), "m", len(rows))


def _run(study: Study, variant: int) -> Run | None:
    """Simulate a variant and return its run, or None if it cannot be run."""
    try:
        group = next(variant_groups(study, variants(study, variant, 1)))
        return run_of(group, 0)
    except CancelledError:
        # CancelledError is a FeeddriveError as well, and must end the report.
        raise
    except FeeddriveError:
        return None


# candidate figures of each subject; the first one that a study measures is used
SUBJECTS = {
    "tracking": (TRACKING_RMS, TRACKING_PEAK, FOLLOWING_RMS, FOLLOWING_PEAK, TRACKING_END),
    "stiffness": (
        of_loops.STIFFNESS_LEAST,
        of_loops.STIFFNESS_OVER[1],
        *of_loops.STIFFNESS_AT,
        of_loops.STIFFNESS_OVER[0],
        of_loops.STIFFNESS_OVER[2],
        of_loops.ROPE_SNAP,
    ),
    "robustness": (of_loops.SENSITIVITY_PEAK, of_loops.DELAY_MARGIN, of_loops.PHASE_MARGIN, of_loops.GAIN_MARGIN),
}


def subjects(study: Study) -> dict[str, Figure]:
    """Return the figure that represents each subject (tracking, stiffness, robustness) that the study measures."""
    measured = {
        subject: next((figure for figure in figures if figure in study.measure), None)
        for subject, figures in SUBJECTS.items()
    }
    return {subject: figure for subject, figure in measured.items() if figure is not None}


@dataclass(frozen=True, eq=False)
class Front:
    """The rows of the Pareto-optimal variants, sorted by the figure of the first measured subject, usually tracking."""

    figures: dict[str, Figure]
    rows: Judged


class FrontKept:
    """A collector that builds the Pareto front part by part."""

    def __init__(self, study: Study) -> None:
        self._figures = subjects(study)
        self._rows: Judged | None = None

    def add(self, rows: Judged) -> None:
        """Add the rows of one chunk, except those in which one of the figures is missing."""
        if len(self._figures) < 2:
            return
        several = [*([] if self._rows is None else [self._rows]), rows]
        # The front of a union lies in the union of the fronts, so each part is reduced before they are compared.
        together = joined([part.some(front(_costs(part, self._figures))) for part in several])
        self._rows = together.some(front(_costs(together, self._figures)))

    def result(self) -> Front | None:
        """Return the front, or None if fewer than two subjects are measured, or no variant has all of their figures."""
        if self._rows is None or not self._rows.variant.size:
            return None
        order = np.argsort(_costs(self._rows, self._figures)[:, 0], kind="stable")
        return Front(self._figures, self._rows.some(order))


def _costs(rows: Judged, figures: dict[str, Figure]) -> np.ndarray:
    """Return the objectives, all of which are to be minimized, shape (n, subjects)."""
    return np.stack(
        [(-1.0 if figure.better == "higher" else 1.0) * rows.figures[figure.key] for figure in figures.values()], axis=1
    )


def front(costs: np.ndarray) -> np.ndarray:
    """Return True for Pareto-optimal rows, that is, rows that no other row dominates; (n, m) -> (n,).

    A row dominates another one if no entry is larger and at least one is smaller. Rows with NaN are excluded; equal
    rows are either all included or all excluded.
    """
    there = np.flatnonzero(~np.isnan(costs).any(axis=1))
    # In this order a dominating row precedes the rows that it dominates. The last key of lexsort is the primary one.
    left = there[np.lexsort(costs[there].T[::-1])]
    undominated = np.zeros(len(costs), dtype=bool)
    while left.size:
        # Nothing before this row is left, so nothing dominates it: there are as many passes as rows on the front.
        first = costs[left[0]]
        equal = (costs[left] == first).all(axis=1)
        undominated[left[equal]] = True
        left = left[~equal & (costs[left] < first).any(axis=1)]
    return undominated
