"""Run all laws with their stored designs on all plants, and compute their scores.

    score(law, figure) = (Π over plants  r)^(1/n),    r = P-PI's figure / the law's (inverted if more is better)


so that 1 is P-PI and more is better; over the n plants on which both are ranked with a finite figure.  Figures are
neither summed nor weighted: stiffness, tracking and computing effort are separate columns.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.benchmark.designs import Design, Designs
from feeddrive.benchmark.rules import Plant, Rules, folder, read_rules
from feeddrive.comparison.figures import Values, frame_of_figures
from feeddrive.comparison.judge import Competitor, alike, judged
from feeddrive.comparison.tune_all import Rule
from feeddrive.evaluation.case import Case, content_digest
from feeddrive.evaluation.engine import Engine
from feeddrive.figures import of_loops, of_runs
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import LinearLoop
from feeddrive.files.run_files import versions
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError, nearest
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table, chart_of, frame_of
from feeddrive.language.text import Text, capitalized, joined, marked
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import MOST
from feeddrive.loop.loop import Loop
from feeddrive.plot.chart import Chart
from feeddrive.tuning.candidates import PLAIN, Candidate, candidates
from feeddrive.tuning.recipes import RECIPES
from feeddrive.tuning.tune import own_tunables

ROBUST = f"{of_loops.SENSITIVITY_PEAK.key}_varied"
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
_MANY = 1.02  # improvement factor over P-PI above which a law counts as better
# units of a plant's numbers that are wrong together, and the power of the share that they take: a frequency is a root
_WRONG = ({"kg": 1.0, "kg m2": 1.0}, {"N/m": 1.0, "Hz": 0.5})


@dataclass(frozen=True)
class Row:
    """A row for one law on one plant: its worst figures over positions and seeds in SI units, and why it is not ranked.

    recipe    True for gains from a tuning recipe: the row is shown separately and may violate the rule
    unplaced  empty for a ranked law
    """

    plant: str
    law: str
    figures: Values = field(default_factory=dict[str, float | None])
    unplaced: str = ""
    remark: str = ""
    recipe: bool = False
    tunables: Mapping[str, float] = field(default_factory=dict[str, float])
    spread: float | None = None
    held: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Trial(Case[Row]):
    """The case of one law on one plant, simulated with its stored design at every position and with every seed.

    candidate  the law with the tunables of its design; for a recipe, P-PI
    design     None for a law without tunables, and for a recipe
    recipe     name of the recipe that sets the gains; empty for a law
    rule       the rule of equal robustness, with the noise limit from P-PI
    own        a user's seed; 0 for the seeds of the rules
    """

    kind: ClassVar[str] = "law_on_plant"
    common: ClassVar[tuple[str, ...]] = ("rules",)

    rules: Rules
    plant: str
    candidate: Candidate
    design: Design | None
    rule: Rule
    own: int
    recipe: str = ""

    @property
    def name(self) -> str:
        """The name of the case: plant and law."""
        return f"{self.plant}: {self.law}"

    @property
    def law(self) -> str:
        """The name of the law, or of P-PI with its recipe."""
        return f"{PLAIN} by {self.recipe.replace('-', ' ')}" if self.recipe else self.candidate.name

    @property
    def digest(self) -> str:
        """The digest of the case; the plant enters through the files of the rules."""
        rules = self.rules.digest()
        return content_digest(rules, self.plant, self.candidate, self.design, self.rule, self.own, self.recipe)

    def record(self, outcome: Row) -> dict[str, Any]:
        """Return the row as a record, keeping the quantities in its texts."""
        return {name: marked(value) if isinstance(value, str) else value for name, value in asdict(outcome).items()}

    def restored(self, record: Any, progress: Progress) -> Row:
        """Restore the row from a record."""
        entries: dict[str, Any] = {
            name: Text(value) if isinstance(value, str) else value for name, value in record.items()
        }
        entries["held"] = tuple(map(Text, record["held"]))
        return Row(**entries)

    def outcome(self, progress: Progress) -> Row:
        """Evaluate the law and return its row."""
        plant, design = self.rules.plants[self.plant], self.design
        row = Row(plant.name, self.law, recipe=bool(self.recipe))
        try:
            control, remark = self._control(plant)
            law, figures = self._judged(plant, control)
        except FeeddriveError as error:
            return replace(row, unplaced=Text(f"refused: {error}"))
        row = replace(row, figures=figures, remark=joined("; ", filter(None, (remark, law.remark))))
        reasons = [Text(f"unfit: {law.unfit}") if law.unfit else ""]
        if design is not None:
            row = replace(row, tunables=design.tunables, spread=design.spread, held=design.held)
            nominal = not self.candidate.like and len(plant.places) == 1
            moved = design.moved(figures) if nominal else ""
            reasons.append(f"stale: {moved}: --retune searches it anew" if moved else "")
            reasons.append(f"not settled: {design.unsettled}" if design.unsettled else "")
        reasons.append(Text(f"outside of the rule: {law.outside}") if law.outside else "")
        return replace(row, unplaced=next(filter(None, reasons), ""))

    def _control(self, plant: Plant) -> tuple[Control, str]:
        """Return the controller adapted to the task, and a remark on it."""
        control = self.candidate.loop.control
        if self.recipe:
            recipe = RECIPES[self.recipe](plant.model, control)
            return replace(control, law=recipe.law), recipe.reason
        if self.candidate.like:
            whole = replace(self.candidate, loop=replace(plant.loop, control=control))
            seed = self.rules.seed(plant, "learning", self.own)
            control = alike(whole, control.law, plant.duty, seed).control
        return control, self.candidate.remark

    def _judged(self, plant: Plant, control: Control) -> tuple[Competitor, Values]:
        """Evaluate the law at all positions with all seeds; return it with its figures and the Ms of perturbed
        plants.
        """
        places = plant.loops(control)
        seeds = [self.rules.seed(plant, f"run {run}", self.own) for run in range(self.rules.seeds)]
        law = judged(Competitor(self.law, places[0][0], None, "", {}), places, plant.duty, self.rule, seeds)
        if law.unfit or control.law.period() > MOST:
            return law, law.figures
        peaks = (robust_peak(model, self.rule.velocity, self.rules.varied) for _, model in places)
        return law, {**law.figures, ROBUST: max(peaks)}


def trials(
    rules: Rules, plant: Plant, designs: Designs, *, laws: Sequence[str] = (), own: int = 0
) -> list[Trial | Row]:
    """Return the laws of a plant, P-PI first, then the recipes if no laws are named: as trials, or as rows if nothing
    has to be run.

    Raises FileError for a damaged design.
    """
    possible, refused = candidates(plant.model)
    wanted = {PLAIN, *laws} if laws else {law.name for law in (*possible, *refused)}
    tuned = {candidate.name: _tuned(candidate, designs) for candidate in possible if not candidate.like}
    plain, noise = tuned.get(PLAIN, ""), None
    if not isinstance(plain, str):
        loop = plain[0].loop
        noise = LinearLoop(loop, known=loop_model(loop, velocity=rules.rule(plant).velocity)).noise_gain
    rule = rules.rule(plant, noise)
    rows: list[Trial | Row] = []
    for candidate in possible:
        if candidate.name not in wanted:
            continue
        base = tuned[candidate.like or candidate.name]
        if isinstance(base, str):
            rows.append(Row(plant.name, candidate.name, unplaced=base))
            continue
        control = base[0].loop.control
        if candidate.like:
            control = replace(candidate.loop.control, law=control.law)
        ready = replace(candidate, loop=replace(candidate.loop, control=control))
        rows.append(Trial(rules, plant.name, ready, base[1], rule, own))
    rows += [
        Row(plant.name, refusal.name, unplaced=Text(f"refused: {refusal.reason}"))
        for refusal in refused
        if refusal.name in wanted
    ]
    if not laws:
        start = next(candidate for candidate in possible if candidate.name == PLAIN)
        rows += [Trial(rules, plant.name, start, None, rule, own, recipe) for recipe in RECIPES]
    return rows


def _tuned(candidate: Candidate, designs: Designs) -> tuple[Candidate, Design | None] | str:
    """Return a candidate with the tunables of its design, and the design; or the reason why there is none."""
    if not own_tunables(candidate.loop.control):
        return candidate, None
    design = designs.design(candidate.name)
    if design is None:
        return "not searched: --retune searches it"
    if design.refused:
        return f"refused: {design.refused}"
    try:
        control = design.control(candidate)
    except FeeddriveError as error:
        return f"stale: {error}"
    return replace(candidate, loop=replace(candidate.loop, control=control)), design


def robust_peak(loop: Loop, velocity: float, share: float) -> float:
    """Return the largest Ms with all masses, or all stiffnesses, of the plant perturbed by ±`share`; infinite if
    unstable.
    """
    peaks: list[float] = []
    for powers, factor in product(_WRONG, (1.0 - share, 1.0 + share)):
        plant = loop.axis.plant
        changes = {
            name: value * factor ** powers[unit]
            for name, value in tree.leaves(plant)
            if (unit := tree.declaration(plant, name).unit) in powers
        }
        if not changes:
            continue
        wrong = replace(loop, axis=replace(loop.axis, plant=tree.vary(plant, changes)))
        if not stability(wrong, velocity=velocity).stable:
            return math.inf
        both = loop_model(wrong, velocity=velocity)
        peaks.append(margins(both.loop_gain(both.lines(200))).sensitivity_peak)
    return max(peaks)


@dataclass(frozen=True)
class Score:
    """The score of a law by one figure: improvement factor over P-PI, number of plants, and number of further plants on
    which it never settles.
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


@dataclass(frozen=True, eq=False, repr=False)
class Benchmark(Result):
    """The result of the benchmark: all rows; `own` is a user's seed, 0 for the seeds of the rules."""

    rules: Rules
    plants: tuple[str, ...]
    rows: tuple[Row, ...]
    own: int
    versions: Mapping[str, str]

    @property
    def laws(self) -> tuple[str, ...]:
        """The laws that are ranked on at least one plant, least rope-snap error first."""
        return self._ordered(recipe=False)

    @property
    def recipes(self) -> tuple[str, ...]:
        """The tuning recipes, which set gains without a search."""
        return self._ordered(recipe=True)

    def _ordered(self, *, recipe: bool) -> tuple[str, ...]:
        names = dict.fromkeys(row.law for row in self.rows if row.recipe == recipe)
        return tuple(sorted(filter(self.counted, names), key=lambda law: -(self.score(law, FIGURES[0]).value or 0.0)))

    def row(self, plant: str, law: str) -> Row | None:
        """Return the row of a law on a plant; None if there is none."""
        return next((row for row in self.rows if (row.plant, row.law) == (plant, law)), None)

    def counted(self, law: str) -> list[Row]:
        """Return the rows of a law that count: all ranked ones, and for a recipe all with figures."""
        rows = [row for row in self.rows if row.law == law]
        return [row for row in rows if not row.unplaced or (row.recipe and FIGURES[0].key in row.figures)]

    def ratios(self, law: str, criterion: Figure) -> dict[str, float]:
        """Return by plant the improvement factor over P-PI; infinite where the law never settles but P-PI does."""
        ratios: dict[str, float] = {}
        for row in self.counted(law):
            plain = self.row(row.plant, PLAIN)
            ours = row.figures.get(criterion.key)
            theirs = None if plain is None or plain.unplaced else plain.figures.get(criterion.key)
            if ours and theirs and math.isfinite(theirs):
                ratios[row.plant] = ours if math.isinf(ours) else _times_better(criterion, ours, theirs)
        return ratios

    def score(self, law: str, criterion: Figure) -> Score:
        """Return the geometric mean over plants of the ratio to P-PI, as defined in the module docstring."""
        ratios = self.ratios(law, criterion).values()
        finite = [ratio for ratio in ratios if math.isfinite(ratio)]
        mean = math.exp(math.fsum(map(math.log, finite)) / len(finite)) if finite else None
        return Score(mean, len(finite), len(ratios) - len(finite))

    def robust(self, law: str) -> float | None:
        """Return the largest Ms over all plants with masses or stiffnesses perturbed by the share in the rules."""
        peaks = (row.figures.get(ROBUST) for row in self.counted(law))
        return max((peak for peak in peaks if peak is not None), default=None)

    def table(self) -> Table:
        """Return the scores of the tuned laws, at equal robustness."""
        return self.scores(self.laws, f"Rules {self.rules.version}: times better than {PLAIN} at equal robustness")

    def recipe_table(self) -> Table:
        """Return the scores of the recipes, which may violate the rule."""
        return self.scores(self.recipes, f"Recipes without a search, against tuned {PLAIN}; not at equal robustness")

    def tables(self) -> list[Table]:
        """Return the score tables of the laws, and of the recipes if there are any."""
        return [self.table(), *([self.recipe_table()] if self.recipes else [])]

    def scores(self, laws: Sequence[str], title: str) -> Table:
        """Return a table with one row per law: number of plants, score by each figure, robust Ms."""
        rows: list[list[Cell]] = []
        for law in laws:
            count = sum(not row.unplaced for row in self.counted(law))
            peak = self.robust(law)
            robust = "unstable" if peak is not None and math.isinf(peak) else peak
            scores = (self.score(law, figure).cell for figure in FIGURES)
            rows.append([law, f"{count}/{len(self.plants)}", *scores, robust])
        varied = Column(Text(f"Ms ±{Quantity(self.rules.varied, 'share'):6}"), form=".2f")
        return Table(title, ["law", "plants", *HEADS, varied], rows)

    def winners(self) -> Table:
        """Return a table of the best tuned law per plant and figure, with its improvement factor over P-PI."""
        rows = [[plant, *(self._winner(plant, criterion) for criterion in FIGURES[:-1])] for plant in self.plants]
        return Table("Best law by plant and figure, and how many times better than P-PI", ["plant", *HEADS[:-1]], rows)

    def _winner(self, plant: str, criterion: Figure) -> Cell:
        placed = (row for row in self.rows if row.plant == plant and not row.unplaced and not row.recipe)
        values = [(value, row.law) for row in placed if (value := row.figures.get(criterion.key)) is not None]
        finite = [entry for entry in values if math.isfinite(entry[0])]
        if not finite:
            return None
        value, law = (max if criterion.higher else min)(finite)
        plain = self.row(plant, PLAIN)
        theirs = None if plain is None else plain.figures.get(criterion.key)
        if law == PLAIN or not theirs or not value:
            return law
        return Text(f"{law} {Quantity(_times_better(criterion, value, theirs)):.2f}")

    def unplaced(self) -> dict[str, dict[str, list[str]]]:
        """Return, by law and reason, the plants on which the law is not ranked."""
        plants: dict[str, dict[str, list[str]]] = {}
        for row in self.rows:
            if row.unplaced and not row.recipe:
                plants.setdefault(row.law, {}).setdefault(row.unplaced, []).append(row.plant)
        return plants


def _times_better(criterion: Figure, ours: float, theirs: float) -> float:
    return ours / theirs if criterion.higher else theirs / ours


@chart_of.register
def _chart(benchmark: Benchmark) -> Chart:
    """Plot every law relative to P-PI, plant by plant."""
    from feeddrive.comparison import pictures

    def row(law: str, criterion: Figure) -> tuple[list[float], float | None]:
        finite = [ratio for ratio in benchmark.ratios(law, criterion).values() if math.isfinite(ratio)]
        return finite, benchmark.score(law, criterion).value

    panels = {figure.short: [row(law, figure) for law in benchmark.laws] for figure in FIGURES[:_DRAWN]}
    return pictures.scores_chart(benchmark.laws, panels)


@frame_of.register
def _frame(benchmark: Benchmark) -> Any:
    """Return a data frame with one row per law and plant, in SI units."""
    names = [f"{row.plant}: {row.law}" for row in benchmark.rows]
    keys = [*(figure.key for figure in FIGURES), ROBUST]
    return frame_of_figures("row", names, [row.figures for row in benchmark.rows], keys)


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
    laws      the laws to run, P-PI always included; default: all laws and the recipes
    designs   folders of designs that take precedence over those stored in the package
    own       a user's seed, from which all seeds of the runs are derived; 0 for the seeds of the rules
    engine    engine that runs the laws and stores finished ones; default: in this process

    The same rules, designs and seed give the same bits, for any number of workers.
    Raises ParameterError for an unknown law, CancelledError if cancelled.
    """
    rules = rules or read_rules()
    chosen = tuple(rules.plants.values()) if plants is None else tuple(plants)
    first, *also = (*designs, folder(rules.version) / "designs")
    work = [
        row
        for plant in chosen
        for row in trials(rules, plant, Designs(first, plant.name, rules.version, tuple(also)), laws=laws, own=own)
    ]
    names = {row.law for row in work}
    for law in laws:
        if law not in names:
            raise ParameterError(f"law '{law}' is not known here{nearest(law, names)}")
    judged_rows = iter((engine or Engine()).evaluate([row for row in work if isinstance(row, Trial)], progress))
    rows = tuple(next(judged_rows) if isinstance(row, Trial) else row for row in work)
    return Benchmark(rules, tuple(plant.name for plant in chosen), rows, own, versions())


def advice(benchmark: Benchmark, *, asked: bool = False) -> Advice:
    """State which law has the least rope-snap error over all plants, and on how many plants no law beats P-PI.

    asked  True if laws were named explicitly: it is then a failure if none of them is ranked
    """
    snap, laws, plants = FIGURES[0], benchmark.laws, benchmark.plants
    tried = {row.law for row in benchmark.rows if not row.recipe and row.law != PLAIN}
    if asked and tried and not tried & {*laws}:
        return Judgment.NO_PLACE.because("the table above says why")
    whole = [law for law in laws if len(benchmark.ratios(law, snap)) == len(plants)]
    if not whole:
        return Advice(Judgment.NONE_PLACED, f"{Judgment.NONE_PLACED.says}.")
    best = whole[0]
    ratio = benchmark.score(best, snap).value or 0.0
    least = "no law that has a place on all plants beats P-PI by 2 % in rope-snap error"
    if best != PLAIN and ratio >= _MANY:
        least = Text(
            f"of the laws with a place on all plants '{best}' has the least rope-snap error, "
            f"{Quantity(ratio):.2f} times better than P-PI"
        )
    beaten = sum(any(benchmark.ratios(law, snap).get(plant, 0.0) > _MANY for law in laws) for plant in plants)
    how = f"on {len(plants) - beaten} of {len(plants)} plants {Judgment.SCORED.says}"
    return Advice(Judgment.SCORED, Text(f"{capitalized(least)}; {how}."))
