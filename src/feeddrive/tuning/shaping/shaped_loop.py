"""What a shaping gives: the control, old against new, what holds it back, what would help, and its proof."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.language import tree
from feeddrive.language.table import Result, Table
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.shaping import words
from feeddrive.tuning.shaping.cascade import CascadeLoops
from feeddrive.tuning.shaping.evidence import Checked
from feeddrive.tuning.shaping.figures import FIGURES, Figures
from feeddrive.tuning.shaping.limits import Limits
from feeddrive.tuning.shaping.tunables import readable


@dataclass(frozen=True)
class HeldBack:
    """A bound that holds the search back: where, and what the goal gains in per cent if it is eased by a tenth."""

    what: str
    site: str
    frequency: float  # Hz
    gain: float

    def sentence(self) -> str:
        """In plain words."""
        where = f" at {self.frequency:.4g} Hz" if self.frequency > 0.0 else ""
        return f"{self.what}{where} ({self.site}): a tenth more room would gain {self.gain:.2g} %"


@dataclass(frozen=True, eq=False, repr=False)
class Tuned(Result):
    """A control shaped for a goal within limits at all sites.

    tunables, started    values by dotted name of the control, new and where the user stands today (nan: new filter)
    before, after     figures at each site; before is empty if today's control has none
    held              the bounds that hold the goal back, the strongest first
    advice            what else would help, in plain words
    notches           what was tried and what it brought
    sure, confidence  standard deviations kept to every bound, and with which probability all of them hold at once
    spread, settled   by which share the worst end of the searches is above the best; whether two ended near the best
    cost              by which share the goal is worse because of the noise of the measurement
    recipe            the rule that the control is made by, if nothing was searched
    cascade           velocity and position loop one by one, before and after, for a P-PI control
    """

    control: Control
    loops: tuple[Loop, ...]
    tunables: Mapping[str, float]
    started: Mapping[str, float]
    goal: str
    band: tuple[float, float]
    limits: Limits
    before: tuple[Figures, ...]
    after: tuple[Figures, ...]
    held: tuple[HeldBack, ...]
    advice: tuple[str, ...]
    notches: tuple[str, ...]
    sure: float
    confidence: float | None
    cost: float
    evaluations: int
    spread: float
    settled: bool
    proof: tuple[Checked, ...]
    cascade: tuple[CascadeLoops, ...] = ()
    recipe: str = ""

    @property
    def holds(self) -> bool:
        """Whether no line of the proof fails; a tuning that does not hold must not be used."""
        return all(line.holds is not False for line in self.proof)

    @property
    def proven(self) -> bool:
        """Whether all lines of the proof hold."""
        return all(line.holds is True for line in self.proof)

    @property
    def rule(self) -> str:
        """What it was tuned for."""
        if self.recipe:
            return f"{self.recipe}; judged by {self.limits.sentence()}"
        noise = "" if not self.sure else f", kept with {self.sure:.3g} standard deviations of the measurement"
        return f"{words.aim(self)} subject to {self.limits.sentence()}{noise}"

    @property
    def at_drive(self) -> bool:
        """Whether the compliance is that against a force at the drive, since none on the table is known."""
        return any(each.at_drive for each in self.after)

    def gained(self) -> float | None:
        """By which factor the goal of the worst site is better than before; None without a stable before."""
        if not self.before or not all(each.stable for each in self.before):
            return None
        return words.goal_of(self, self.before) / words.goal_of(self, self.after)

    @property
    def not_worth(self) -> bool:
        """Whether today's control keeps the limits and the new one is hardly better."""
        return words.recommendation(self).startswith("Leave")

    def recommendation(self) -> str:
        """What to do and why, with what is worse than today."""
        return words.recommendation(self)

    def table(self) -> Table:
        """Old against new, what holds it back, and the proof."""
        rows = [
            [
                readable(self.control, name),
                _number(self.started[name]),
                _number(value),
                tree.declaration(self.control, name).unit,
            ]
            for name, value in self.tunables.items()
        ]
        for i, after in enumerate(self.after):
            before = self.before[i] if self.before else None
            mark = f" ({after.site})" if len(self.after) > 1 else ""
            rows += [
                [f"{head}{mark}", "" if before is None else _figure(before, read), _figure(after, read), unit]
                for head, unit, read in FIGURES
                if read(after) is not None
            ]
        rows += [["held back by", "", "", held.sentence()] for held in self.held]
        rows += [["to gain more", "", "", text] for text in self.advice]
        rows += [["notch", "", "", text] for text in self.notches]
        rows += [[f"proof: {line.what}", "", _verdict(line.holds), line.said] for line in self.proof]
        return Table(f"{self.rule}. {self.recommendation()}", ["what", "today", "new", "unit"], rows)


def _number(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.5g}"


def _verdict(holds: bool | None) -> str:
    return "not proven" if holds is None else "holds" if holds else "DOES NOT HOLD"


def _figure(each: Figures, read: Callable[[Figures], float | None]) -> str:
    if not each.stable:
        return "unstable"
    value = read(each)
    return "-" if value is None else f"{value:.4g}"
