"""Sensitivity of figures: Sobol indices of a study of the sampler saltelli, and rank correlations of any other.

The first-order index of a factor is the share of the figure's variance that would be gone if the factor did not vary;
the total one what would be left if it alone varied.  Source: Saltelli et al. 2010, by `scipy.stats.sobol_indices`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.study.answers.judged import Judged
from feeddrive.study.answers.shares import LEVEL
from feeddrive.study.study import Study

INSIDE = "inside"
"""An output beside the figures: 1 for a machine inside the specification, else 0."""
_LEAST_POINTS = 32
_RESAMPLES, _WORK = 999, 4e9  # of the bootstrap at most, and how many numbers they may look at


@dataclass(frozen=True, eq=False)
class SobolIndices:
    """The indices of one output, each of shape (factors,), with an interval of `LEVEL`.

    points   on which they rest; `without` were left out, since a variant of theirs has no figure or an infinite one
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
        """Places of the factors, the largest total index first."""
        return np.argsort(-self.total, kind="stable")


@dataclass(frozen=True)
class RankCorrelation:
    """Spearman's rank correlation of an output with what varies, -1 to 1, with an interval of `LEVEL`.

    Its square is the share of the variance of the ranks that goes with the quantity, if what it does is monotone.
    """

    output: str
    column: str
    value: float
    interval: tuple[float, float] | None


class SaltelliRows:
    """Collects the outputs of all variants of a study of the sampler saltelli, part by part.

    Memory: 8 bytes for each variant and output.
    """

    def __init__(self, study: Study) -> None:
        self._study = study
        names = [figure.key for figure in study.measure] + ([INSIDE] if study.specification else [])
        self._values = {name: np.full(study.count, np.nan) for name in names if study.sampler == "saltelli"}

    def add(self, rows: Judged) -> None:
        """Keep the outputs of some rows."""
        for name, values in self._values.items():
            values[rows.variant] = rows.inside if name == INSIDE else rows.figures[name]

    def result(self) -> tuple[SobolIndices, ...]:
        """Return the indices of each output that varies and is finite in enough points."""
        factors = tuple(varied.name for varied in self._study.vary)
        indices = (sobol(name, values, factors, self._study.seed) for name, values in self._values.items())
        return tuple(row for row in indices if row is not None)


def sobol(output: str, values: np.ndarray, factors: tuple[str, ...], seed: int = 0) -> SobolIndices | None:
    """The indices of an output, from its values at A, B, AB_1 .. AB_k one after the other, shape ((k + 2) points,).

    None for an output that does not vary, or has finite values in fewer than 32 whole points.  The intervals are
    percentiles of a bootstrap over points, drawn with `seed`.
    """
    from scipy import stats  # 0.3 s that commands without answers need not wait for

    rows = values.reshape(len(factors) + 2, -1)
    whole = np.isfinite(rows).all(axis=0)
    points = 1 << (int(whole.sum()).bit_length() - 1) if whole.any() else 0  # scipy takes a power of 2
    if points < _LEAST_POINTS:
        return None
    rows = rows[:, np.flatnonzero(whole)[:points]]
    if np.ptp(rows[:2]) == 0.0:
        return None

    def indices(chosen: np.ndarray) -> np.ndarray:
        f = rows[:, chosen]
        of = {"f_A": f[None, 0], "f_B": f[None, 1], "f_AB": f[2:, None]}
        result: Any = stats.sobol_indices(func=of, n=points)
        return np.stack([np.atleast_1d(result.first_order), np.atleast_1d(result.total_order)])

    resamples = int(min(_RESAMPLES, max(99, _WORK / rows.size)))
    drawn = stats.bootstrap(
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
    """Correlate every figure with every varied number; the largest of each figure first."""
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
    if count < 4 or np.ptp(values[there]) == 0.0:
        return
    ranked = stats.rankdata(values[there])
    for column, drawn in numbers.items():
        if np.ptp(drawn[there]) == 0.0:
            continue
        value = float(np.corrcoef(ranked, stats.rankdata(drawn[there]))[0, 1])
        yield RankCorrelation(output, column, value, _fisher(value, count) if sampled else None)


def _fisher(value: float, count: int) -> tuple[float, float]:
    """The interval of a rank correlation by atanh, with the variance of Bonett & Wright 2000."""
    from scipy.special import ndtri

    if abs(value) >= 1.0:
        return value, value
    half = float(ndtri(0.5 + 0.5 * LEVEL)) * np.sqrt((1.0 + 0.5 * value * value) / (count - 3))
    middle = np.arctanh(value)
    return float(np.tanh(middle - half)), float(np.tanh(middle + half))
