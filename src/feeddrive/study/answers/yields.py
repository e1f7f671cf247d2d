"""The yield: the share of the machines that keep the specification, by bound and by choice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.study.answers.judged import Judged
from feeddrive.study.answers.shares import Share
from feeddrive.study.specification import Bound
from feeddrive.study.study import Study

_MOST_VALUES = 50  # of a choice that are told apart


@dataclass(frozen=True)
class BoundYield:
    """One bound of the specification: the share that keeps it, and how many machines break it and no other one."""

    bound: Bound
    kept: Share
    alone: int


@dataclass(frozen=True)
class Yield:
    """Shares of the machines that were drawn.

    inside  those that keep the whole specification; without one those that have figures
    bad     how many have no figures: they keep nothing
    bounds  one each, in the order of the study file
    choices by column and value of what is chosen (law, machine, position): those inside
    """

    inside: Share
    bad: int
    bounds: tuple[BoundYield, ...]
    choices: Mapping[str, Mapping[str, Share]]

    @property
    def hardest(self) -> BoundYield | None:
        """The bound that most machines break; None if all keep all."""
        broken = [bound_yield for bound_yield in self.bounds if bound_yield.kept.kept < bound_yield.kept.of]
        return min(broken, key=lambda bound_yield: bound_yield.kept.kept, default=None)


class YieldCount:
    """Counts the machines that keep the bounds, part by part."""

    def __init__(self, study: Study) -> None:
        self._study = study
        self._all = self._inside = self._bad = 0
        self._kept = Counter[str]()
        self._alone = Counter[str]()
        self._choices: dict[str, Counter[tuple[str, bool]]] = {}

    def add(self, rows: Judged) -> None:
        """Count some rows; those that were not drawn do not count."""
        drawn = rows.drawn
        self._all += int(np.sum(drawn))
        self._inside += int(np.sum(rows.inside & drawn))
        self._bad += int(np.sum(rows.bad & drawn))
        broken = sum((~kept for kept in rows.kept.values()), np.zeros(drawn.size, dtype=np.int64))
        for name, kept in rows.kept.items():
            self._kept[name] += int(np.sum(kept & drawn))
            self._alone[name] += int(np.sum(~kept & (broken == 1) & ~rows.bad & drawn))
        for column, values in rows.varied.items():
            if values.dtype == object:
                count = self._choices.setdefault(column, Counter())
                count.update(zip(map(str, values[drawn]), rows.inside[drawn].tolist(), strict=True))

    def result(self) -> Yield:
        """Return the yield of all rows that were added."""
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
