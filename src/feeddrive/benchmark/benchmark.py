"""Run all laws with their stored designs on all plants, and compute their scores.

    score(law, figure) = (Π over plants  r)^(1/n),    r = P-PI's figure / the law's (inverted if more is better)

P-PI has the score 1, and more is better.  The product is over the n plants on which both are ranked with a finite
figure.  Figures are neither summed nor weighted: stiffness, tracking and computing effort are separate columns.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from feeddrive.benchmark.order import Logs, Order
from feeddrive.benchmark.rules import Rules, read_rules
from feeddrive.evaluation.competitor import UNFIT, AtWork, Competitor, Plant
from feeddrive.evaluation.designs import Designs
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.evaluation.lineup import Lineup, Trial, judged
from feeddrive.evaluation.robustness import Design, Rule, Tuning, tuned_all
from feeddrive.figures import of_loops, of_runs
from feeddrive.figures.figure import Figure
from feeddrive.figures.ranking import ROBUST
from feeddrive.files.run_files import versions
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table, chart_of, frame_of
from feeddrive.language.text import Text, capitalized
from feeddrive.plot.chart import Chart
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal
from feeddrive.tuning.recipes import RECIPES
from feeddrive.tuning.tune import Tuned

FIGURES = (
    of_loops.ROPE_SNAP,
    *of_loops.STIFFNESS_AT,
    of_runs.TRACKING_RMS,
    of_runs.CUTTING_RMS,
    of_runs.SNAP_SETTLING,
    of_loops.FORCE_NOISE,
    of_loops.EFFORT,
)
HEADS = tuple(figure.short for figure in FIGURES)
_DRAWN = 5  # number of figures in the picture, starting with the first
_AS_MUCH = 0.95  # of the noise of P-PI, above which a law has its control effort
_BY_GROUPS = (of_loops.ROPE_SNAP, of_runs.TRACKING_RMS, of_runs.CUTTING_RMS)  # figures drawn for groups of plants
_MANY = 1.02  # improvement factor over P-PI above which a law counts as better


def on_plant(rules: Rules, plant: Plant, designs: Designs, *, laws: Sequence[str] = (), own: int = 0) -> list[Trial]:
    """Return the trials on a plant: the laws, P-PI first, the refused laws, P-PI at the control effort of laws, and, if
    no laws are named and the rules show them, the recipes.

    Raises FileError for a damaged design.
    """
    lineup, plant = rules.lineup(plant), rules.seeded(plant, own)
    tunings = {law.name: design for law in lineup.searched if (design := designs.outcome(law.name)) is not None}
    plain = next(lineup.trials(tunings, plant)).law
    if isinstance(plain, AtWork) and not rules.draws:
        # the rule for all laws: the tuned P-PI sets the noise limit
        noise = plant.rule.figures(plain.candidate.loop)[of_loops.NOISE_GAIN.key]
        plant = replace(plant, rule=replace(plant.rule, noise=rules.noise_ratio * noise))
    listed = list(lineup.trials(tunings, plant))
    if laws:
        listed = [trial for trial in listed if trial.name in (PLAIN, *laws)]
    start = lineup.possible[0]
    if rules.draws:
        return [*listed, *_at_equal_effort(start, [trial.name for trial in listed], plant, designs)]
    if rules.recipes and not laws:
        for recipe in RECIPES:
            law = Candidate(f"{PLAIN} by {recipe.replace('-', ' ')}", start.loop)
            listed.append(Trial(AtWork(law, plant, recipe)))
    return listed


def _at_equal_effort(start: Candidate, laws: Sequence[str], plant: Plant, designs: Designs) -> Iterator[Trial]:
    """Yield a trial of P-PI at the control effort of each law for which it was tuned."""
    for law in laws:
        design = designs.design(effort_of(law))
        if design is not None and not design.refused:
            candidate = replace(start, name=design.law)
            yield Trial(AtWork(candidate.tuned(design.control(candidate)), plant), design)


@dataclass(frozen=True)
class Score:
    """The score of a law for one figure: the improvement factor over P-PI, the number of plants, and the number of
    further plants on which the law never settles.
    """

    value: float | None
    plants: int
    never: int = 0

    @property
    def cell(self) -> Quantity | str | None:
        """The score as a table cell."""
        value = None if self.value is None else Quantity(self.value, form=".2f")
        if not self.never:
            return value
        return Text(f"{'-' if value is None else value} ({self.never} never)")


class Group(NamedTuple):
    """Plants with the same number of encoders on which P-PI has a place, and on which laws are ranked together.

    A law that reads motor and table cannot control an axis with one encoder: its mean over all plants would be over
    other plants than that of the other laws.
    """

    name: str
    plants: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Benchmark(Result):
    """The result of the benchmark: all rows; `own` is a user's seed, 0 for the seeds of the rules.

    references   rows of P-PI at the control effort of other laws, by `effort_of`
    variants     the results by the variants of the rules, by name
    """

    rules: Rules
    plants: tuple[str, ...]
    rows: tuple[Competitor, ...]
    own: int
    versions: Mapping[str, str]
    references: tuple[Competitor, ...] = ()
    variants: Mapping[str, "Benchmark"] = field(default_factory=dict[str, "Benchmark"])

    @property
    def laws(self) -> tuple[str, ...]:
        """The laws that are ranked on at least one plant, least rope-snap error first."""
        return self._ordered(recipe=False)

    @property
    def recipes(self) -> tuple[str, ...]:
        """The tuning recipes, which set gains without a search."""
        return self._ordered(recipe=True)

    def _ordered(self, *, recipe: bool) -> tuple[str, ...]:
        names = dict.fromkeys(row.name for row in self.rows if row.recipe == recipe)
        # by the rope-snap error, which is the goal of all searches
        return tuple(sorted(filter(self.counted, names), key=lambda law: -(self.score(law, FIGURES[0]).value or 0.0)))

    def row(self, plant: str, law: str) -> Competitor | None:
        """Return the row of a law on a plant; None if there is none."""
        return next((row for row in self.rows if (row.plant, row.name) == (plant, law)), None)

    # recipes are shown as they are: gains without a search, which need not satisfy the rule
    def counted(self, law: str) -> list[Competitor]:
        """Return the rows of a law that enter its score: the ranked ones, and for a recipe all that have figures."""
        rows = [row for row in self.rows if row.name == law]
        return [row for row in rows if not row.unplaced or (row.recipe and FIGURES[0].key in row.figures)]

    def draws(self, law: str, criterion: Figure, *, effort: bool = False) -> dict[str, tuple[float, ...]]:
        """Return the improvement factors over P-PI at each draw of each plant; one a plant where none are drawn.

        effort  True: over P-PI at the control effort of the law

        An infinite value marks a machine on which the law never settles, but P-PI does.
        """
        factors: dict[str, tuple[float, ...]] = {}
        for row in self.counted(law):
            plain = self.reference(row) if effort else self.row(row.plant, PLAIN)
            if plain is None or plain.unplaced:
                continue
            pairs = zip(row.draws or (row.figures,), plain.draws or (plain.figures,), strict=True)
            values = [(ours.get(criterion.key), theirs.get(criterion.key)) for ours, theirs in pairs]
            # where P-PI never settles there is nothing to divide by
            if all(ours and theirs and math.isfinite(theirs) for ours, theirs in values):
                factors[row.plant] = tuple(
                    ours if math.isinf(ours) else _times_better(criterion, ours, theirs)
                    for ours, theirs in values
                    if ours and theirs
                )
        return factors

    def reference(self, row: Competitor) -> Competitor | None:
        """Return the row of P-PI at the control effort of a law; None if it was needed and not tuned."""
        quieter = next((r for r in self.references if (r.plant, r.name) == (row.plant, effort_of(row.name))), None)
        plain = self.row(row.plant, PLAIN)
        if quieter is not None or plain is None:
            return quieter
        # a law that takes the gains of another one has its tuning, and with it the name of the other
        like = row.tuned.law if isinstance(row.tuned, Design) else row.name
        other = next((r for r in self.references if (r.plant, r.name) == (row.plant, effort_of(like))), None)
        return other or (plain if _as_much(row.tuned, plain.tuned) else None)

    def ratios(self, law: str, criterion: Figure, *, effort: bool = False) -> dict[str, float]:
        """Return the improvement factor over P-PI for each plant, the geometric mean of its draws; infinite if the law
        does not settle at one of them.
        """
        draws = self.draws(law, criterion, effort=effort)
        return {plant: math.exp(math.fsum(map(math.log, values)) / len(values)) for plant, values in draws.items()}

    def score(
        self, law: str, criterion: Figure, plants: Collection[str] | None = None, *, effort: bool = False
    ) -> Score:
        """Return the geometric mean over plants of the ratio to P-PI, as defined in the module docstring."""
        every = self.ratios(law, criterion, effort=effort)
        ratios = [ratio for plant, ratio in every.items() if plants is None or plant in plants]
        finite = [ratio for ratio in ratios if math.isfinite(ratio)]
        # geometric: twice as good on one plant and half as good on another one is no gain
        mean = math.exp(math.fsum(map(math.log, finite)) / len(finite)) if finite else None
        return Score(mean, len(finite), len(ratios) - len(finite))

    def laws_on(self, group: Group) -> list[str]:
        """Return the tuned laws that were judged on at least one plant of a group, ranked or not."""
        rows = (row for row in self.rows if row.plant in group.plants and row.tuned is not None)
        return list(dict.fromkeys(row.name for row in rows))

    def mean_on(self, law: str, criterion: Figure, group: Group) -> float | None:
        """Return the score of a law on a group of plants; None if it has no finite figure on one of them."""
        found = self.score(law, criterion, group.plants)
        return found.value if found.plants == len(group.plants) else None

    def robust(self, law: str) -> float | None:
        """Return the largest Ms over all plants with masses or stiffnesses perturbed by the share in the rules."""
        peaks = (row.figures.get(ROBUST.key) for row in self.counted(law))
        return max((peak for peak in peaks if peak is not None), default=None)

    def table(self) -> Table:
        """Return the scores of the tuned laws, at equal robustness."""
        return self.scores(self.laws, f"Rules {self.rules.version}: times better than {PLAIN} at equal robustness")

    def tables(self) -> list[Table]:
        """Return the score table of the laws and, if any, that of the recipes, which may violate the rule."""
        title = f"Recipes without a search, against tuned {PLAIN}; not at equal robustness"
        return [self.table(), *([self.scores(self.recipes, title)] if self.recipes else [])]

    def groups(self) -> list[Group]:
        """Return the groups of plants with one and with two encoders on which P-PI has a place."""
        named: dict[str, list[str]] = {"one encoder": [], "two encoders": []}
        for plant in self.plants:
            plain = self.row(plant, PLAIN)
            if plain is not None and not plain.unplaced:
                axis = self.rules.plants[plant].loop.axis
                named["one encoder" if axis.encoders() == 1 else "two encoders"].append(plant)
        return [Group(name, tuple(plants)) for name, plants in named.items() if plants]

    def scores(self, laws: Sequence[str], title: str) -> Table:
        """Return a table with one row per law: number of plants, score for each figure, robust Ms."""
        rows: list[list[Cell]] = []
        for law in laws:
            count = sum(not row.unplaced for row in self.counted(law))
            peak = self.robust(law)
            robust = "unstable" if peak is not None and math.isinf(peak) else peak
            scores = (self.score(law, figure).cell for figure in FIGURES)
            rows.append([law, f"{count}/{len(self.plants)}", robust, *scores])
        varied = Column(Text(f"Ms ±{Quantity(self.rules.varied, 'share'):6}"), form=".2f")
        # beside the name: at the right end a terminal or a page may cut off that a law is unstable
        return Table(title, ["law", "plants", varied, *HEADS], rows)

    def on(self, plant: str) -> Table:
        """Return a table of all figures on one plant."""
        figures = (*FIGURES, ROBUST)
        rows: list[list[Cell]] = []
        for row in self.rows:
            if row.plant == plant and row.figures.get(FIGURES[0].key):
                values = (row.figures.get(figure.key) for figure in figures)
                cells = ("never" if value is not None and math.isinf(value) else value for value in values)
                rows.append([row.name, *cells, row.kind])
        return Table(f"{plant}: figures", ["law", *(figure.column() for figure in figures), ""], rows)

    def winners(self) -> Table:
        """Return a table of the best tuned law per plant and figure, with its improvement factor over P-PI."""
        placed = {row.plant for row in self.rows if not row.unplaced}
        shown = [plant for plant in self.plants if plant in placed]
        rows = [[plant, *(self._winner(plant, criterion) for criterion in FIGURES[:-1])] for plant in shown]
        return Table("Best law by plant and figure, and how many times better than P-PI", ["plant", *HEADS[:-1]], rows)

    def _winner(self, plant: str, criterion: Figure) -> Cell:
        placed = [row for row in self.rows if row.plant == plant and not row.unplaced and not row.recipe]
        ratios = {row.name: self.ratios(row.name, criterion).get(plant, math.nan) for row in placed}
        finite = sorted((-ratio, law) for law, ratio in ratios.items() if math.isfinite(ratio))
        if finite:
            ratio, law = finite[0]
            return law if law == PLAIN else Text(f"{law} {Quantity(-ratio):.2f}")
        # where P-PI has no finite figure there is nothing to divide by
        values = [(value, row.name) for row in placed if (value := row.figures.get(criterion.key)) is not None]
        known = [entry for entry in values if math.isfinite(entry[0])]
        return (max if criterion.higher else min)(known)[1] if known else None

    def unplaced(self) -> dict[str, dict[str, list[str]]]:
        """Return, by law and reason, the plants on which the law is not ranked."""
        plants: dict[str, dict[str, list[str]]] = {}
        for row in self.rows:
            if row.unplaced and not row.recipe:
                plants.setdefault(row.name, {}).setdefault(row.unplaced, []).append(row.plant)
        return plants


def _as_much(tuned: Tuned | Design | None, plain: Tuned | Design | None) -> bool:
    """Return True if a law has about the control effort of P-PI, by their stored designs."""
    if not isinstance(tuned, Design) or not isinstance(plain, Design):
        return False
    return (tuned.noise_gain or 0.0) >= _AS_MUCH * (plain.noise_gain or math.inf)


def _times_better(criterion: Figure, ours: float, theirs: float) -> float:
    return ours / theirs if criterion.higher else theirs / ours


def logs(benchmark: Benchmark, group: Group, figure: Figure, *, effort: bool = False) -> Logs:
    """Return ln of the improvement factors of all laws on the plants of a group."""
    factors = {law: benchmark.draws(law, figure, effort=effort) for law in benchmark.laws_on(group)}
    return {
        law: {plant: tuple(map(math.log, rows[plant])) for plant in group.plants if plant in rows}
        for law, rows in factors.items()
    }


def order_of(benchmark: Benchmark, group: Group, figure: Figure, *, effort: bool = False) -> Order:
    """Return the order of the laws by a figure on the common plants of a group."""
    rules = benchmark.rules
    values = logs(benchmark, group, figure, effort=effort)
    seed = rules.number(f"bootstrap, {group.name}, {figure.key}", benchmark.own)
    return Order.of(
        figure, values, group.plants, rules.resamples, float(rules.confidence), seed, unsettled(benchmark, group)
    )


def unsettled(benchmark: Benchmark, group: Group) -> set[str]:
    """Return the laws whose search is not confirmed on a plant of a group."""
    rows = (row for row in benchmark.rows if row.plant in group.plants)
    return {row.name for row in rows if row.tuned is not None and row.tuned.unsettled}


@chart_of.register
def _chart(benchmark: Benchmark) -> Chart:
    """Plot every law relative to P-PI, plant by plant: with drawn plants by groups of plants, a dot a drawn plant."""
    from feeddrive.plot.laws import ScoreRow, Scores, scores_chart

    def finite(values: Iterable[float]) -> list[float]:
        return [value for value in values if math.isfinite(value)]

    if not benchmark.rules.draws:
        panels = {
            figure.short: [
                ScoreRow(finite(benchmark.ratios(law, figure).values()), benchmark.score(law, figure).value)
                for law in benchmark.laws
            ]
            for figure in FIGURES[:_DRAWN]
        }
        return scores_chart((benchmark.laws, panels))
    rows: list[tuple[list[str], Scores]] = []
    for group in benchmark.groups():
        best, *_ = _BY_GROUPS
        # a mean over fewer plants than those of the laws beside it is not shown, and nothing is sorted by it
        mean = {law: benchmark.mean_on(law, best, group) for law in benchmark.laws_on(group)}
        laws = sorted(mean, key=lambda law, mean=mean: (mean[law] is None, -(mean[law] or 0.0), law))
        panels: Scores = {}
        for figure in _BY_GROUPS:
            ranked = {standing.law: standing for standing in order_of(benchmark, group, figure).standings}
            panels[f"{group.name}: {figure.short}"] = [
                ScoreRow(
                    finite(v for p, row in benchmark.draws(law, figure).items() if p in group.plants for v in row),
                    benchmark.mean_on(law, figure, group),
                    (ranked[law].low, ranked[law].high) if law in ranked else None,
                )
                for law in laws
            ]
        rows.append(([_with_unstable(benchmark, law, group) for law in laws], panels))
    return scores_chart(*rows)


def _with_unstable(benchmark: Benchmark, law: str, group: Group) -> str:
    """Return the name of a law, marked if its search is not settled somewhere, with the number of plants on which it is
    unstable: its dots alone would flatter it.
    """
    rows = [row for row in benchmark.rows if row.name == law and row.plant in group.plants]
    mark = " *" if any(row.tuned is not None and row.tuned.unsettled for row in rows) else ""
    count = sum(row.kind == UNFIT for row in rows)
    return f"{law}{mark}{f' (unstable on {count})' if count else ''}"


@frame_of.register
def _frame(benchmark: Benchmark) -> Any:
    """Return a data frame with one row per law and plant, in SI units."""
    from feeddrive.plot import frames

    names = [f"{row.plant}: {row.name}" for row in benchmark.rows]
    keys = [figure.key for figure in (*FIGURES, ROBUST)]
    return frames.laws(names, [row.figures for row in benchmark.rows], keys, "row")


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

    plants    default: all plants of the rules
    laws      names or kinds of the laws to run, P-PI always included; default: all laws and the recipes
    designs   folders of designs that take precedence over those stored in the package
    own       a user's seed, from which all seeds of the runs are derived; 0 for the seeds of the rules
    engine    engine that runs the laws and stores finished cases; default: in this process

    The same rules, designs and seed give the same bits, for any number of workers.
    Raises ParameterError for an unknown law, CancelledError if cancelled.
    """
    rules = rules or read_rules()
    chosen = tuple(rules.plants.values()) if plants is None else tuple(plants)
    laws, engine, progress = laws_of(chosen, laws, rules), engine or Engine(), progress or Progress()

    def scored(rules: Rules, plants: Iterable[Plant]) -> Benchmark:
        # designs of the user come first, those of the package fill the gaps
        first, *also = (*map(rules.designs, designs), rules.designs())
        listed = [
            trial
            for plant in plants
            for trial in on_plant(
                rules, plant, Designs(first, plant.name, rules.version, tuple(also)), laws=laws, own=own
            )
        ]
        rows = judged(listed, engine, Bar(progress, len(listed)))
        apart = {effort_of(row.name) for row in rows}
        return Benchmark(
            rules,
            tuple(plant.name for plant in chosen),
            tuple(row for row in rows if row.name not in apart),
            own,
            versions(),
            tuple(row for row in rows if row.name in apart),
        )

    found = scored(rules, chosen)
    variants = {
        variant.name: scored(varied, (varied.plants[plant.name] for plant in chosen))
        for variant in rules.variant
        if (varied := rules.varied_by(variant))
    }
    return replace(found, variants=variants)


def search(
    rules: Rules,
    plants: Sequence[Plant],
    keep: Path,
    *,
    laws: Sequence[str] = (),
    engine: Engine | None = None,
    progress: Progress | None = None,
) -> None:
    """Tune laws on plants, and write each design to `keep` as soon as it is found.

    laws  names of the laws to tune; default: all

    A law whose design in `keep` is not stale is not tuned again, so an interrupted search can be resumed.  P-PI, which
    sets the bound on the noise, is taken from the package unless it is among the laws: tuned again by a later version
    it may have another noise at nearly the same error, and the found designs would not belong to the stored ones.
    `engine` runs the searches; its store is replaced by the designs in `keep`.
    Raises FileError if the folder cannot be written, CancelledError if cancelled.
    """
    engine, progress = engine or Engine(), progress or Progress()
    for plant in plants:
        lineup = rules.lineup(plant)
        searched = (lineup.only(laws) if laws else lineup).searched
        designs = Designs(rules.designs(keep), plant.name, rules.version)
        if laws and PLAIN not in laws:
            designs = replace(designs, also=(rules.designs(),), shared=(PLAIN,))
        engine_of_plant = replace(engine, store=designs)
        bar = Bar(progress, Tuning.stages * len(searched))
        outcomes, _ = tuned_all(searched, plant.rule, engine_of_plant, bar)
        if rules.draws:
            quieter = matched(searched, outcomes, plant.rule)
            engine_of_plant.evaluate(quieter, Bar(progress, Tuning.stages * len(quieter)))


def matched(laws: Sequence[Candidate], outcomes: Mapping[str, Tuned | Refusal], rule: Rule) -> list[Tuning]:
    """Return the tunings of P-PI at the control effort of each law that needs clearly less of it than P-PI.

    P-PI at the effort of a law has the noise in the force of that law, at its worst plant, as its bound.  A law with
    as much noise as P-PI needs none: the optimum of P-PI takes no more than it has, and is its own reference.
    """
    plain = next((law for law in laws if law.name == PLAIN), None)
    if plain is None:
        return []
    own = rule.with_noise_of(outcomes[PLAIN]).noise
    tunings: list[Tuning] = []
    for law in laws:
        bounded = replace(rule, noise_ratio=1.0).with_noise_of(outcomes[law.name])
        if law.name != PLAIN and own and bounded.noise and bounded.noise < _AS_MUCH * own / rule.noise_ratio:
            tunings.append(Tuning(replace(plain, name=effort_of(law.name)), bounded))
    return tunings


def effort_of(law: str) -> str:
    """Return the name of P-PI at the control effort of a law."""
    return f"{PLAIN} at the effort of {law}"


def laws_of(plants: Sequence[Plant], laws: Sequence[str], rules: Rules | None = None) -> tuple[str, ...]:
    """Return the names of laws that are given by name or kind. Raises ParameterError for a law that is unknown, or that
    takes no part by the rules.
    """
    # of all plants: a law may fit only some of them
    lineups = [Lineup.of(plant.model) if rules is None else rules.lineup(plant) for plant in plants] if laws else []
    possible = tuple(law for lineup in lineups for law in lineup.possible)
    return Lineup(possible, tuple(law for lineup in lineups for law in lineup.refused)).names(laws)


def advice(benchmark: Benchmark, *, asked: bool = False) -> Advice:
    """State which law has the least rope-snap error over all plants, and on how many plants no law beats P-PI.

    asked  True if laws were named explicitly: it is then a failure if none of them is ranked
    """
    snap, laws = FIGURES[0], benchmark.laws
    # where P-PI has no place there is nothing to compare with
    plants = [p for p in benchmark.plants if (plain := benchmark.row(p, PLAIN)) is not None and not plain.unplaced]
    tried = {row.name for row in benchmark.rows if not row.recipe and row.name != PLAIN}
    if asked and tried and not tried & {*laws}:
        return Judgment.NO_PLACE.because("the table above says why")
    whole = [law for law in laws if len(benchmark.ratios(law, snap)) == len(plants)]
    if not whole or not plants:
        return Advice(Judgment.NONE_PLACED, f"{Judgment.NONE_PLACED.says}.")
    best = whole[0]
    ratio = benchmark.score(best, snap).value or 0.0
    least = "no law that has a place on all plants beats P-PI by 2 % in rope-snap error"
    if best != PLAIN and ratio >= _MANY:
        least = Text(
            f"of the laws with a place on all plants '{best}' has the least rope-snap error, "
            f"{Quantity(ratio):.2f} times better than P-PI"
        )
        if math.isinf(benchmark.robust(best) or 0.0):
            off = Quantity(benchmark.rules.varied, "share")
            least = Text(f"{least}, but is unstable on a plant with masses or stiffnesses {off} off")
    beaten = sum(any(benchmark.ratios(law, snap).get(plant, 0.0) > _MANY for law in laws) for plant in plants)
    how = f"on {len(plants) - beaten} of {len(plants)} plants {Judgment.SCORED.says}"
    return Advice(Judgment.SCORED, Text(f"{capitalized(least)}; {how}."))
