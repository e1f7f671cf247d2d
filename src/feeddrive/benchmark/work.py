"""The rows of a plant: every law with its stored design, and every recipe, at work on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from typing import Any, ClassVar

from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.benchmark.designs import STALE, Design, Designs
from feeddrive.benchmark.rules import Plant, Rules
from feeddrive.comparison.judge import Competitor, alike, judged
from feeddrive.comparison.tune_all import Rule
from feeddrive.evaluation.case import Case, content_digest
from feeddrive.figures.catalogue import figures as catalogue
from feeddrive.figures.linear_loop import LinearLoop
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import number
from feeddrive.language.text import Text, joined, marked
from feeddrive.loop.control import Control
from feeddrive.loop.lifting import MOST
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate, candidates
from feeddrive.tuning.recipes import RECIPES
from feeddrive.tuning.tune import own_tunables

ROBUST = f"{SENSITIVITY_PEAK.key}_varied"
# units of a plant's numbers that are wrong together, and the power of the share that they take: a frequency is a root
_WRONG = ({"kg": 1.0, "kg m2": 1.0}, {"N/m": 1.0, "Hz": 0.5})


@dataclass(frozen=True)
class Row:
    """A law on a plant: its figures in SI, the worst over positions and seeds, and why it has no place.

    recipe    it follows a rule and was not tuned: its row is shown apart, and may be outside of the rule
    unplaced  empty for a law that counts
    """

    plant: str
    law: str
    figures: Mapping[str, float | None] = field(default_factory=dict[str, float | None])
    unplaced: str = ""
    remark: str = ""
    recipe: bool = False
    tunables: Mapping[str, float] = field(default_factory=dict[str, float])
    spread: float | None = None
    held: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Trial(Case[Row]):
    """The case of a law on a plant: with its stored design at work at every position, with every seed.

    candidate  with the tunables of its design; of a recipe that of P-PI
    design     None for a law with nothing to tune, and for a recipe
    recipe     the name of the rule that gives the gains; empty for a law
    rule       with the noise that P-PI makes
    own        a person's seed; 0: those of the rules
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
        """Plant and law."""
        return f"{self.plant}: {self.law}"

    @property
    def law(self) -> str:
        """The law, or P-PI and the recipe."""
        return f"{PLAIN} by {self.recipe.replace('-', ' ')}" if self.recipe else self.candidate.name

    @property
    def digest(self) -> str:
        """As of all cases; the plant by the files of the rules."""
        rules = self.rules.digest()
        return content_digest(rules, self.plant, self.candidate, self.design, self.rule, self.own, self.recipe)

    def record(self, outcome: Row) -> dict[str, Any]:
        """The row, with the quantities in its texts."""
        return {name: marked(value) if isinstance(value, str) else value for name, value in asdict(outcome).items()}

    def restored(self, record: Any, progress: Progress) -> Row:
        """The row of a record."""
        entries: dict[str, Any] = {
            name: Text(value) if isinstance(value, str) else value for name, value in record.items()
        }
        entries["held"] = tuple(map(Text, record["held"]))
        return Row(**entries)

    def outcome(self, progress: Progress) -> Row:
        """The row of the law."""
        plant = self.rules.plants[self.plant]
        row = Row(plant.name, self.law, recipe=bool(self.recipe))
        try:
            control, said = self._control(plant)
            figures, unfit, outside, remark = self._judged(plant, control)
        except FeeddriveError as error:
            return replace(row, unplaced=Text(f"refused: {error}"))
        row = replace(row, figures=figures, remark=joined("; ", filter(None, (said, remark))))
        why = unfit
        if self.design is not None:
            row = replace(row, tunables=self.design.tunables, spread=self.design.spread, held=self.design.held)
            nominal = not self.candidate.like and len(plant.places) == 1
            moved = _moved(self.design.figures, figures) if nominal else ""
            why = why or (f"stale: {moved}" if moved else "")
            why = why or (f"not settled: {self.design.unsettled}" if self.design.unsettled else "")
        return replace(row, unplaced=why or (Text(f"outside of the rule: {outside}") if outside else ""))

    def _control(self, plant: Plant) -> tuple[Control, str]:
        """The control at work, and what is said of it."""
        control = self.candidate.loop.control
        if self.recipe:
            made = RECIPES[self.recipe](plant.model, control)
            return replace(control, law=made.law), made.reason
        if self.candidate.like:
            whole = replace(self.candidate, loop=replace(plant.loop, control=control))
            seed = self.rules.seed(plant, "learning", self.own)
            control = alike(whole, control.law, plant.duty, seed).control
        return control, self.candidate.remark

    def _judged(self, plant: Plant, control: Control) -> tuple[dict[str, float | None], str, str, str]:
        """Worst figures, why there are none, what is outside of the rule, and remarks."""
        found: list[Competitor] = []
        for (loop, model), run in product(plant.loops(control), range(self.rules.seeds)):
            seed = self.rules.seed(plant, f"run {run}", self.own)
            found.append(judged(self.law, loop, None, "", plant.duty, self.rule, seed, model))
            if found[-1].unfit:
                return dict(found[-1].figures), Text(f"unfit: {found[-1].unfit}"), "", ""
        figures = worst([each.figures for each in found])
        if control.law.period() <= MOST:
            peaks = (robust_peak(model, self.rule.velocity, self.rules.varied) for _, model in plant.loops(control))
            figures[ROBUST] = max(peaks)
        remarks = dict.fromkeys(Text(marked(each.remark).strip("; ")) for each in found if each.remark)
        return figures, "", self.rule.broken(figures), joined("; ", remarks)


def trials(
    rules: Rules, plant: Plant, designs: Designs, *, laws: Sequence[str] = (), own: int = 0
) -> list[Trial | Row]:
    """The laws of a plant, P-PI first, then the recipes if no laws are named: trials, or rows that need none.

    Raises FileError for a damaged design.
    """
    possible, refused = candidates(plant.model)
    wanted = {PLAIN, *laws} if laws else {each.name for each in (*possible, *refused)}
    tuned = {each.name: _tuned(each, designs) for each in possible if not each.like}
    plain, noise = tuned.get(PLAIN, ""), None
    if not isinstance(plain, str):
        loop = plain[0].loop
        noise = LinearLoop(loop, known=loop_model(loop, velocity=rules.rule(plant).velocity)).noise_gain
    rule = rules.rule(plant, noise)
    found: list[Trial | Row] = []
    for each in possible:
        if each.name not in wanted:
            continue
        base = tuned[each.like or each.name]
        if isinstance(base, str):
            found.append(Row(plant.name, each.name, unplaced=base))
            continue
        control = replace(each.loop.control, law=base[0].loop.control.law) if each.like else base[0].loop.control
        ready = replace(each, loop=replace(each.loop, control=control))
        found.append(Trial(rules, plant.name, ready, base[1], rule, own))
    found += [
        Row(plant.name, each.name, unplaced=Text(f"refused: {each.reason}")) for each in refused if each.name in wanted
    ]
    if not laws:
        start = next(each for each in possible if each.name == PLAIN)
        found += [Trial(rules, plant.name, start, None, rule, own, recipe) for recipe in RECIPES]
    return found


def _tuned(candidate: Candidate, designs: Designs) -> tuple[Candidate, Design | None] | str:
    """A candidate with the tunables of its design, and that; or why there is none."""
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


def _moved(stored: Mapping[str, float], now: Mapping[str, float | None]) -> str:
    """Which figure of a stored design has moved with the code."""
    for key, value in stored.items():
        there = now.get(key)
        if there is None or abs(there - value) > STALE * abs(value):
            present = None if there is None else number(there, 6)
            return (
                f"{key} was {number(value, 6)} when its design was stored and is {present}: --retune searches it anew"
            )
    return ""


def worst(figures: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    """By key the worst value; None if one of them has none."""
    known, made = catalogue(), dict[str, float | None]()
    for key in figures[0]:
        values = [each.get(key) for each in figures]
        there = [value for value in values if value is not None]
        higher = key in known and known[key].higher
        made[key] = None if len(there) < len(values) else (min if higher else max)(there)
    return made


def robust_peak(loop: Loop, velocity: float, share: float) -> float:
    """The largest Ms with all masses, or all stiffnesses, of the plant wrong by a share; infinite if unstable."""
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
