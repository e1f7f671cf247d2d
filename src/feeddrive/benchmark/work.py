"""The rows of a plant: every law with its stored design, and every recipe, at work on it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.benchmark.designs import STALE, Designs
from feeddrive.benchmark.rules import Plant, Rules
from feeddrive.comparison.judge import Competitor, alike, judged
from feeddrive.comparison.tune_all import Rule
from feeddrive.figures.catalogue import figures as catalogue
from feeddrive.figures.linear_loop import LinearLoop
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.quantity import number
from feeddrive.language.text import Text, joined, marked
from feeddrive.loop.control import Control
from feeddrive.loop.lifting import MOST
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate, candidates
from feeddrive.tuning.recipes import RECIPES
from feeddrive.tuning.tunables import own_tunables

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


def rows_of(rules: Rules, plant: Plant, designs: Designs, *, laws: Sequence[str] = (), own: int = 0) -> list[Row]:
    """The rows of a plant, P-PI first, then the recipes if no laws are named.

    Raises FileError for a damaged design.
    """
    possible, refused = candidates(plant.model)
    wanted = {PLAIN, *laws} if laws else {each.name for each in (*possible, *refused)}
    laws_there = {each.name: _control(each, designs) for each in possible if not each.like}
    plain = laws_there.get(PLAIN)
    noise = None
    if isinstance(plain, _Ready):
        loop = replace(plant.model, control=plain.control)
        noise = LinearLoop(loop, known=loop_model(loop, velocity=rules.rule(plant).velocity)).noise_gain
    rule = rules.rule(plant, noise)
    rows: list[Row] = []
    for each in possible:
        if each.name not in wanted:
            continue
        base = laws_there[each.like or each.name]
        if isinstance(base, str):
            rows.append(Row(plant.name, each.name, unplaced=base))
            continue
        rows.append(_row(rules, plant, each, base, rule, own))
    rows += [
        Row(plant.name, each.name, unplaced=Text(f"refused: {each.reason}")) for each in refused if each.name in wanted
    ]
    if not laws:
        rows += list(_recipes(rules, plant, rule, own))
    return rows


@dataclass(frozen=True)
class _Ready:
    """A control with its stored tunables, and what was said of the search."""

    control: Control
    tunables: Mapping[str, float] = field(default_factory=dict[str, float])
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    unsettled: str = ""
    spread: float | None = None
    held: tuple[str, ...] = ()


def _control(candidate: Candidate, designs: Designs) -> _Ready | str:
    """The control of a candidate as it was stored, or why there is none."""
    if not own_tunables(candidate.loop.control):
        return _Ready(candidate.loop.control)
    found = designs.known(candidate.name)
    if found is None:
        return "not searched: --retune searches it"
    if found.refused:
        return f"refused: {found.refused}"
    try:
        control = found.control(candidate)
    except FeeddriveError as error:
        return f"stale: {error}"
    return _Ready(control, found.tunables, found.figures, found.unsettled, found.spread, found.held)


def _row(rules: Rules, plant: Plant, candidate: Candidate, base: _Ready, rule: Rule, own: int) -> Row:
    """A law at work at every position, with every seed."""
    whole = replace(candidate, loop=replace(plant.loop, control=candidate.loop.control))
    control = base.control
    try:
        if candidate.like:
            control = alike(whole, base.control.law, plant.duty, rules.seed(plant, "learning", own)).control
        figures, unfit, outside, remark = _judged(rules, plant, candidate.name, control, rule, own)
    except FeeddriveError as error:
        return Row(plant.name, candidate.name, unplaced=Text(f"refused: {error}"))
    moved = _moved(base.figures, figures) if not candidate.like and len(plant.places) == 1 else ""
    why = unfit or (f"stale: {moved}" if moved else "")
    why = why or (f"not settled: {base.unsettled}" if base.unsettled else "")
    why = why or (Text(f"outside of the rule: {outside}") if outside else "")
    said = joined("; ", filter(None, (candidate.remark, remark)))
    return Row(
        plant.name, candidate.name, figures, why, said, tunables=base.tunables, spread=base.spread, held=base.held
    )


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


def _judged(
    rules: Rules, plant: Plant, name: str, control: Control, rule: Rule, own: int
) -> tuple[dict[str, float | None], str, str, str]:
    """Worst figures, why there are none, what is outside of the rule, and remarks."""
    found: list[Competitor] = []
    for (loop, model), run in product(plant.loops(control), range(rules.seeds)):
        found.append(judged(name, loop, None, "", plant.duty, rule, rules.seed(plant, f"run {run}", own), model))
        if found[-1].unfit:
            return dict(found[-1].figures), Text(f"unfit: {found[-1].unfit}"), "", ""
    figures = worst([each.figures for each in found])
    if control.law.period() <= MOST:
        figures[ROBUST] = max(robust_peak(model, rule.velocity, rules.varied) for _, model in plant.loops(control))
    remarks = dict.fromkeys(Text(marked(each.remark).strip("; ")) for each in found if each.remark)
    return figures, "", rule.broken(figures), joined("; ", remarks)


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


def _recipes(rules: Rules, plant: Plant, rule: Rule, own: int) -> Iterator[Row]:
    """P-PI by every rule of the trade, with the filters of the machine file; it may break the rule."""
    base = next(each for each in candidates(plant.model)[0] if each.name == PLAIN)
    for name, recipe in RECIPES.items():
        title = f"{PLAIN} by {name.replace('-', ' ')}"
        try:
            made = recipe(plant.model, base.loop.control)
            control = replace(base.loop.control, law=made.law)
            figures, unfit, outside, remark = _judged(rules, plant, title, control, rule, own)
        except FeeddriveError as error:
            yield Row(plant.name, title, unplaced=Text(f"refused: {error}"), recipe=True)
            continue
        why = unfit or (Text(f"outside of the rule: {outside}") if outside else "")
        yield Row(plant.name, title, figures, why, joined("; ", filter(None, (made.reason, remark))), recipe=True)
