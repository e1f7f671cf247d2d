"""The order of the laws on common plants: bootstrap intervals, and which places are decided.

    d(a, b) = mean over plants and draws of ln(figure of b / figure of a), turned so that d > 0 means that a is better

The bootstrap resamples the plants with replacement and, at each of them, its draws.  All laws are resampled together:
they were judged on the same machines with the same noise, so that what they share cancels in their difference.
The order of two laws is decided if the interval of d lies on one side of 0, and on the same side in the rules and in
each of their variants.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import NamedTuple

import numpy as np

from feeddrive.figures.figure import Figure

_EQUAL = 1e-9  # of ln of a figure: laws that differ by less have the same feedback loop, and share a place

Logs = Mapping[str, Mapping[str, Sequence[float]]]
"""Of each law and plant, ln of the improvement factor over P-PI at each draw."""


class Standing(NamedTuple):
    """A law in the order: its score, the geometric mean over plants and draws, and its place, with their intervals."""

    law: str
    score: float
    low: float
    high: float
    place: int
    best: int
    worst: int


@dataclass(frozen=True, eq=False)
class Order:
    """The order of laws by one figure, on the plants on which all of them have a place.

    laws       the ranked laws, best first
    plants     the common plants
    means      mean ln of the improvement factor of each law
    resampled  the same in each resample, shape (laws, resamples)
    unsettled  laws whose search is not confirmed on one of the plants: they are at least so good
    """

    figure: Figure
    laws: tuple[str, ...]
    plants: tuple[str, ...]
    means: np.ndarray
    resampled: np.ndarray
    confidence: float
    unsettled: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls,
        figure: Figure,
        logs: Logs,
        plants: Sequence[str],
        resamples: int,
        confidence: float,
        seed: int,
        unsettled: Collection[str] = (),
    ) -> "Order":
        """Return the order of the laws that have a finite figure at every draw of all plants; others are left out."""
        whole = [law for law, rows in logs.items() if all(_finite(rows.get(plant, ())) for plant in plants)]
        if not whole or not plants:
            return cls(figure, (), tuple(plants), np.zeros(0), np.zeros((0, resamples)), confidence)
        means = {law: math.fsum(float(np.mean(logs[law][plant])) for plant in plants) / len(plants) for law in whole}
        # names decide between equal means, so that the order does not depend on that of the files
        laws = sorted(whole, key=lambda law: (-means[law], law))
        random = np.random.default_rng(seed)
        count = len(plants)
        chosen = random.integers(0, count, (resamples, count))
        resampled = np.zeros((len(laws), resamples))
        # plants may have different numbers of draws: each is resampled on its own
        for i, plant in enumerate(plants):
            values = np.array([logs[law][plant] for law in laws])
            for column in range(count):
                at = np.flatnonzero(chosen[:, column] == i)
                draws = random.integers(0, values.shape[1], (at.size, values.shape[1]))
                resampled[:, at] += np.mean(values[:, draws], axis=2) / count
        values = np.array([means[law] for law in laws])
        return cls(figure, tuple(laws), tuple(plants), values, resampled, confidence, frozenset(unsettled) & {*laws})

    def interval(self, values: np.ndarray) -> tuple[float, float]:
        """Return the percentile interval of resampled values."""
        tail = 50.0 * (1.0 - self.confidence)
        low, high = np.percentile(values, (tail, 100.0 - tail))
        return float(low), float(high)

    @cached_property
    def standings(self) -> tuple[Standing, ...]:
        """The laws with scores and places, best first."""
        rows: list[Standing] = []
        # place in each resample: one more than the number of laws that are better there
        places = 1 + np.sum(self.resampled[None] > self.resampled[:, None] + _EQUAL, axis=1)
        for i, law in enumerate(self.laws):
            low, high = self.interval(self.resampled[i])
            best, worst = self.interval(places[i])
            span = math.floor(best), math.ceil(worst)
            rows.append(Standing(law, math.exp(self.means[i]), math.exp(low), math.exp(high), i + 1, *span))
        return tuple(rows)

    def better(self, one: str, other: str) -> bool | None:
        """Return True if a law is better than another one, False if it is worse; None if that is open (`open_by`)."""
        if self.open_by(one, other):
            return None
        return self._apart(one, other)[0] > 0.0

    def tied(self, one: str, other: str) -> bool:
        """Return True if two laws have the same figure on every plant, as those with the same feedback loop have."""
        if one not in self.laws or other not in self.laws:
            return False
        apart = self.resampled[self.laws.index(one)] - self.resampled[self.laws.index(other)]
        return float(np.max(np.abs(apart))) < _EQUAL

    def open_by(self, one: str, other: str) -> str:
        """Return why the order of two laws is open; empty if it is not."""
        if one not in self.laws or other not in self.laws:
            return "one has no place on all plants"
        low, high = self._apart(one, other)
        if low <= 0.0 <= high:
            return "the interval of their ratio contains 1"
        # a better search may still lift the law that is behind
        behind = other if low > 0.0 else one
        return "the search of the one behind is not settled" if behind in self.unsettled else ""

    def _apart(self, one: str, other: str) -> tuple[float, float]:
        return self.interval(self.resampled[self.laws.index(one)] - self.resampled[self.laws.index(other)])


def _finite(values: Sequence[float]) -> bool:
    return bool(values) and all(map(math.isfinite, values))


class OpenPair(NamedTuple):
    """A pair of laws whose order is not decided, and the variants (or the rules themselves) that leave it open."""

    one: str
    other: str
    why: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Decision:
    """Which places of an order survive all variants.

    orders  the order by the rules and by each variant, by name; that of the rules is first; None: not computed
    """

    orders: Mapping[str, Order | None]

    @property
    def order(self) -> Order:
        """The order by the rules themselves."""
        order = next(iter(self.orders.values()))
        assert order is not None
        return order

    @property
    def missing(self) -> tuple[str, ...]:
        """The variants that were not computed."""
        return tuple(name for name, order in self.orders.items() if order is None or not order.laws)

    def decided(self, one: str, other: str) -> bool | None:
        """Return True if a law is better in all variants, False if it is worse in all of them, None if not decided."""
        answers = {None if order is None else order.better(one, other) for order in self.orders.values()}
        return answers.pop() if len(answers) == 1 else None

    def doubt(self, one: str, other: str) -> OpenPair | None:
        """Return why the order of two laws is not decided; None if it is."""
        if self.decided(one, other) is not None:
            return None
        base = self.order.better(one, other)
        why: list[str] = []
        for name, order in self.orders.items():
            if order is None or not order.laws:
                why.append(f"{name}: not computed")
            elif reason := order.open_by(one, other):
                why.append(f"{name}: {reason}")
            elif base is not None and order.better(one, other) != base:
                why.append(f"{name}: reversed")
        return OpenPair(one, other, tuple(why))

    def places(self, law: str) -> tuple[int, int]:
        """Return the best and the worst place that a law may have, by the pairs that are decided; equal: decided.

        Tied laws share a place.
        """
        answers = [self.decided(law, other) for other in self.order.laws if not self.order.tied(law, other)]
        return 1 + answers.count(False), 1 + len(answers) - answers.count(True)

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """All pairs of laws that are not tied, in the order of the laws."""
        return tuple(pair for pair in combinations(self.order.laws, 2) if not self.order.tied(*pair))

    @property
    def doubts(self) -> tuple[OpenPair, ...]:
        """All pairs whose order is not decided, in the order of the laws."""
        return tuple(doubt for pair in self.pairs if (doubt := self.doubt(*pair)) is not None)
