"""The rows of a sweep as arrays, a random sample of them, and shares of machines with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.study.chunk import REASON, VARIANT
from feeddrive.study.store import Store
from feeddrive.study.study import Study

if TYPE_CHECKING:
    import pyarrow


LEVEL = 0.95


@dataclass(frozen=True)
class Share:
    """A count of machines out of a total, with a confidence interval for the share of all machines that can be built.

    sampled  True if the machines were drawn at random: the points of a grid have no interval
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
        """The confidence interval at `LEVEL`, (low, high); None without a random sample."""
        if not self.sampled:
            return None
        low, high = clopper_pearson(self.kept, self.of)
        return float(low), float(high)


def clopper_pearson(kept: Any, of: Any, level: float = LEVEL) -> tuple[Any, Any]:
    """Return the Clopper-Pearson confidence interval of a share, from `kept` machines out of `of`.

        P(X >= kept | low) = P(X <= kept | high) = (1 - level) / 2,   X binomial

    It contains the true share in at least `level` of all studies, whatever the share and the number of machines.
    Wilson's and the mid-P interval are shorter but do not guarantee this: for a share of 0.9992 and 200 machines,
    Wilson's contains it in 85 %.

    Arguments are numbers or arrays.  Source: Clopper & Pearson 1934.
    """
    from scipy.special import betaincinv  # 60 ms import

    tail = 0.5 * (1.0 - level)
    kept, of = np.asarray(kept, dtype=np.float64), np.asarray(of, dtype=np.float64)
    low = np.where(kept > 0, betaincinv(np.maximum(kept, 1.0), of - kept + 1.0, tail), 0.0)
    high = np.where(kept < of, betaincinv(kept + 1.0, np.maximum(of - kept, 1.0), 1.0 - tail), 1.0)
    return low, high


@dataclass(frozen=True, eq=False)
class Judged:
    """Rows of a study with their figures, n in number, in SI.

    variant  numbers, shape (n,)
    varied   varied values by column, shape (n,); texts and counts as objects
    figures  by name, shape (n,); NaN for a variant without the figure
    reasons  the failure reason of a bad variant, else None
    """

    study: Study
    variant: np.ndarray
    varied: Mapping[str, np.ndarray]
    figures: Mapping[str, np.ndarray]
    reasons: np.ndarray

    @cached_property
    def bad(self) -> np.ndarray:
        """True for variants without figures, shape (n,)."""
        return np.array([reason is not None for reason in self.reasons], dtype=bool)

    @cached_property
    def kept(self) -> dict[str, np.ndarray]:
        """True for variants that satisfy a bound, by key of its figure; a variant without figures satisfies none."""
        return {
            bound.figure.key: bound.kept(self.figures[bound.figure.key]) & ~self.bad
            for bound in self.study.specification
        }

    @cached_property
    def inside(self) -> np.ndarray:
        """True for variants that satisfy the whole specification; without one, for those that have figures."""
        return np.logical_and.reduce([~self.bad, *self.kept.values()])

    @cached_property
    def drawn(self) -> np.ndarray:
        """True for variants that are independent draws.

        With the sampler saltelli, variants that recombine two others are not.
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
    """Return the rows of a table. Raise ParameterError for a table that lacks a column of the study."""
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
    """Yield all rows in chunks, so that memory is that of one chunk."""
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


MOST = 200_000  # rows: with 99 % probability a quantile is within 0.4 % of its rank


class Sampled:
    """A collector of a random sample of the drawn machines: all, or about `MOST` with equal probability."""

    def __init__(self, study: Study) -> None:
        self._study = study
        drawn = 2 * study.points if study.sampler == "saltelli" else study.count
        self._share = min(1.0, MOST / drawn)
        self._parts: list[Judged] = []

    def add(self, rows: Judged) -> None:
        """Add a random part of some rows; the selection depends only on the seed and the first variant of the rows."""
        chosen = rows.drawn
        if self._share < 1.0 and chosen.any():
            rng = np.random.default_rng([self._study.seed, int(rows.variant[0])])
            chosen = chosen & (rng.random(chosen.size) < self._share)
        if chosen.any() or not self._parts:
            self._parts.append(rows.some(chosen))

    def result(self) -> Judged:
        """Return the sample; at least one part must have been added."""
        return joined(self._parts)
