"""All laws on all plants with their stored designs, and their scores.

    score(law, figure) = (Π over plants  r)^(1/n),    r = P-PI's figure / the law's, or its inverse where more is better

so that 1 is P-PI and more is better; over the n plants on which both have a place and a finite figure.  There is no
sum of figures and no weight: a law is stiff, or tracks, or is cheap, and the table says which.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.benchmark.designs import Designs
from feeddrive.benchmark.rules import Plant, Rules, folder, read_rules
from feeddrive.benchmark.work import ROBUST, Row, Trial, trials
from feeddrive.evaluation.engine import Engine
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import EFFORT, FORCE_NOISE, ROPE_SNAP, STIFFNESS_AT
from feeddrive.figures.of_runs import CUTTING_RMS, SNAP_SETTLING, TRACKING_RMS
from feeddrive.files.run_files import versions
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table, chart_of, frame_of
from feeddrive.language.text import Text
from feeddrive.plot.chart import Chart
from feeddrive.tuning.candidates import PLAIN

FIGURES = (ROPE_SNAP, *STIFFNESS_AT, TRACKING_RMS, CUTTING_RMS, SNAP_SETTLING, FORCE_NOISE, EFFORT)
HEADS = tuple(figure.short for figure in FIGURES)
_DRAWN = 5  # figures of the picture, from the first on


@dataclass(frozen=True)
class Score:
    """A law by one figure: how many times better than P-PI, over how many plants; on how many more it never settles."""

    value: float | None
    plants: int
    never: int = 0

    @property
    def cell(self) -> Quantity | str | None:
        """The score as a cell of a table."""
        value = None if self.value is None else Quantity(self.value, form=".2f")
        if not self.never:
            return value
        return Text(f"{'-' if value is None else value} ({self.never} never)")


@dataclass(frozen=True, eq=False, repr=False)
class Benchmark(Result):
    """All rows under the rules; `own` is a person's seed, 0 that of the rules."""

    rules: Rules
    plants: tuple[str, ...]
    rows: tuple[Row, ...]
    own: int
    versions: Mapping[str, str]

    @property
    def laws(self) -> tuple[str, ...]:
        """The laws that have a place on a plant, least rope-snap error first."""
        return self._ordered(recipe=False)

    @property
    def recipes(self) -> tuple[str, ...]:
        """The rules that gave gains without a search."""
        return self._ordered(recipe=True)

    def _ordered(self, *, recipe: bool) -> tuple[str, ...]:
        there = dict.fromkeys(each.law for each in self.rows if each.recipe == recipe)
        names = [law for law in there if self.counted(law)]
        return tuple(sorted(names, key=lambda law: -(self.score(law, FIGURES[0]).value or 0.0)))

    def row(self, plant: str, law: str) -> Row | None:
        """The row of a law on a plant."""
        return next((each for each in self.rows if (each.plant, each.law) == (plant, law)), None)

    def counted(self, law: str) -> list[Row]:
        """The rows of a law that count: all with a place, and of a recipe all with figures."""
        rows = [each for each in self.rows if each.law == law]
        return [each for each in rows if not each.unplaced or (each.recipe and FIGURES[0].key in each.figures)]

    def ratios(self, law: str, criterion: Figure) -> dict[str, float]:
        """By plant how many times better than P-PI; infinite where the law never comes to rest, and P-PI does."""
        found: dict[str, float] = {}
        for row in self.counted(law):
            plain = self.row(row.plant, PLAIN)
            ours = row.figures.get(criterion.key)
            theirs = None if plain is None or plain.unplaced else plain.figures.get(criterion.key)
            if ours and theirs and math.isfinite(theirs):
                found[row.plant] = ours / theirs if criterion.higher or math.isinf(ours) else theirs / ours
        return found

    def score(self, law: str, criterion: Figure) -> Score:
        """The geometric mean over plants of the ratio to P-PI, as at the top of this file."""
        all_ratios = self.ratios(law, criterion).values()
        finite = [each for each in all_ratios if math.isfinite(each)]
        mean = math.exp(math.fsum(map(math.log, finite)) / len(finite)) if finite else None
        return Score(mean, len(finite), len(all_ratios) - len(finite))

    def robust(self, law: str) -> float | None:
        """The largest Ms on any plant with masses or stiffness wrong by the share of the rules."""
        there = [value for each in self.counted(law) if (value := each.figures.get(ROBUST)) is not None]
        return max(there, default=None)

    def table(self) -> Table:
        """Scores of the laws that were tuned, at equal robustness."""
        return self.scores(self.laws, f"Rules {self.rules.version}: times better than {PLAIN} at equal robustness")

    def recipe_table(self) -> Table:
        """Scores of the recipes, which may be outside of the rule."""
        return self.scores(self.recipes, f"Recipes without a search, against tuned {PLAIN}; not at equal robustness")

    def scores(self, laws: Sequence[str], title: str) -> Table:
        """A row a law: how many plants, the score by each figure, the robust Ms."""
        rows: list[list[Cell]] = []
        for law in laws:
            count = len([each for each in self.counted(law) if not each.unplaced])
            peak = self.robust(law)
            cells = [self.score(law, figure).cell for figure in FIGURES]
            robust = "unstable" if peak is not None and math.isinf(peak) else peak
            rows.append([law, f"{count}/{len(self.plants)}", *cells, robust])
        varied = Column(Text(f"Ms ±{Quantity(self.rules.varied, 'share'):6}"), form=".2f")
        return Table(title, ["law", "plants", *HEADS, varied], rows)

    def winners(self) -> Table:
        """By plant and figure the law that was tuned with the best figure, and how far it is before P-PI."""
        rows: list[list[Cell]] = []
        for plant in self.plants:
            there = [each for each in self.rows if each.plant == plant and not each.unplaced and not each.recipe]
            plain = self.row(plant, PLAIN)
            cells: list[Cell] = []
            for criterion in FIGURES[:-1]:
                known = [(value, each.law) for each in there if (value := each.figures.get(criterion.key)) is not None]
                finite = [each for each in known if math.isfinite(each[0])]
                if not finite:
                    cells.append(None)
                    continue
                value, law = (max if criterion.higher else min)(finite)
                theirs = None if plain is None else plain.figures.get(criterion.key)
                ratio = None if not theirs or not value else value / theirs if criterion.higher else theirs / value
                cells.append(law if ratio is None or law == PLAIN else Text(f"{law} {Quantity(ratio):.2f}"))
            rows.append([plant, *cells])
        return Table("Best law by plant and figure, and how many times better than P-PI", ["plant", *HEADS[:-1]], rows)

    def unplaced(self) -> dict[str, dict[str, list[str]]]:
        """By law and reason the plants on which it has no place."""
        found: dict[str, dict[str, list[str]]] = {}
        for each in self.rows:
            if each.unplaced and not each.recipe:
                found.setdefault(each.law, {}).setdefault(each.unplaced, []).append(each.plant)
        return found


@chart_of.register
def _chart(found: Benchmark) -> Chart:
    """Every law against P-PI, plant by plant."""
    from feeddrive.benchmark import pictures

    def row(law: str, criterion: Figure) -> tuple[list[float], float | None]:
        finite = [each for each in found.ratios(law, criterion).values() if math.isfinite(each)]
        return finite, found.score(law, criterion).value

    drawn = dict(zip(HEADS[:_DRAWN], FIGURES[:_DRAWN], strict=True))
    return pictures.scores_chart(
        found.laws, {head: [row(law, each) for law in found.laws] for head, each in drawn.items()}
    )


@frame_of.register
def _frame(found: Benchmark) -> Any:
    """One row a law and plant, in SI."""
    from feeddrive.plot.frames import frame

    keys = [each.key for each in FIGURES] + [ROBUST]
    columns = {key: np.array([each.figures.get(key) for each in found.rows], float) for key in keys}
    return frame([f"{each.plant}: {each.law}" for each in found.rows], columns, "row")


def score(
    rules: Rules | None = None,
    plants: Sequence[Plant] | None = None,
    *,
    laws: Sequence[str] = (),
    designs: Sequence[Path] = (),
    own: int = 0,
    engine: Engine | None = None,
    progress: Progress | None = None,
) -> Benchmark:
    """Run every law with its stored design, and every recipe, on every plant.

    plants    default: all of the rules
    laws      those that are wanted, P-PI always among them; default: all, and the recipes
    designs   folders of designs that come before those that are stored in the package
    own       a seed of one's own, from which all seeds of the runs follow; 0: those of the rules
    engine    where laws are run, and where finished ones are kept; default: in this process

    The same rules, designs and seed give the same bits, for any number of workers.
    Raises ParameterError for a law that no plant knows, CancelledError at a cancel.
    """
    rules = rules or read_rules()
    chosen = tuple(rules.plants.values()) if plants is None else tuple(plants)
    first, *also = (*designs, folder(rules.version) / "designs")
    tried = [
        each
        for plant in chosen
        for each in trials(rules, plant, Designs(first, plant.name, rules.version, tuple(also)), laws=laws, own=own)
    ]
    there = {each.law for each in tried}
    for law in laws:
        if law not in there:
            raise ParameterError(f"law '{law}' is not known here{nearest(law, there)}")
    found = iter((engine or Engine()).evaluate([each for each in tried if isinstance(each, Trial)], progress))
    rows = tuple(next(found) if isinstance(each, Trial) else each for each in tried)
    return Benchmark(rules, tuple(plant.name for plant in chosen), rows, own, versions())
