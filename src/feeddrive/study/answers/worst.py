"""The worst cases: by figure the variants with the worst values, and the first of those that have none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.study.answers.judged import Judged
from feeddrive.study.study import Study

WORST = 3  # variants of a figure
BAD = 10  # variants without figures that are named


@dataclass(frozen=True)
class WorstVariant:
    """A variant, the value of its figure, and what varies in it, all in SI."""

    variant: int
    value: float
    varied: Mapping[str, float | str]


@dataclass(frozen=True)
class Worst:
    """The worst variants of a figure, the worst first."""

    figure: Figure
    cases: tuple[WorstVariant, ...]


class WorstKept:
    """Collects the worst variants of the rows, part by part; of equal values the lower number."""

    def __init__(self, study: Study) -> None:
        self._cases: dict[Figure, list[WorstVariant]] = {figure: [] for figure in study.measure if figure.better}
        self.bad: list[tuple[int, str]] = []

    def add(self, rows: Judged) -> None:
        """Add some rows."""
        for figure, cases in self._cases.items():
            sign = 1.0 if figure.better == "higher" else -1.0
            values = sign * rows.figures[figure.key]
            some = np.flatnonzero(~np.isnan(values))
            some = some[np.argsort(values[some], kind="stable")[:WORST]]
            cases += [_case(rows, place, figure.key) for place in some.tolist()]
            cases.sort(key=lambda case: (sign * case.value, case.variant))
            del cases[WORST:]
        for place in np.flatnonzero(rows.bad)[: BAD - len(self.bad)].tolist():
            self.bad.append((int(rows.variant[place]), str(rows.reasons[place])))

    def result(self) -> tuple[Worst, ...]:
        """Return the worst variants of each figure for which one direction is better."""
        return tuple(Worst(figure, tuple(cases)) for figure, cases in self._cases.items() if cases)


def _case(rows: Judged, place: int, figure: str) -> WorstVariant:
    varied = {
        name: values[place] if values.dtype == object else float(values[place]) for name, values in rows.varied.items()
    }
    return WorstVariant(int(rows.variant[place]), float(rows.figures[figure][place]), varied)
