"""The result of a tuning: the control, old and new figures, active limits, verification, and a summary in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.figures.figure import Figure, Goal
from feeddrive.language import tree
from feeddrive.language.quantity import USUAL, Quantity, number
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import Figures, reported
from feeddrive.tuning.limits import Limits, judged
from feeddrive.tuning.operating_point import OperatingPoint, position_loop, response_on
from feeddrive.tuning.proof import Checked
from feeddrive.tuning.tunables import readable

_OFF = 1e-9  # of Kv: a position loop that is open


@dataclass(frozen=True, eq=False, repr=False)
class CascadeLoops(Result):
    """Loop gains of the velocity loop alone, opened at the actuator, and of the position loop around it, closed."""

    velocity: Margins
    position: Margins

    def table(self) -> Table:
        """Crossover and margins of both."""
        rows: list[Sequence[Cell]] = []
        fast, slow = (loop.loop_gain.sample_time for loop in (self.velocity, self.position))
        ran = "" if fast is None or slow is None or fast == slow else Text(f", every {Quantity(slow, 's'):6}")
        for name, m in (("velocity loop", self.velocity), (f"position loop{ran}", self.position)):
            rows.append([name, m.crossover, m.phase_margin_deg, m.gain_increase_dB, m.sensitivity_peak])
        columns = [
            "loop",
            Column("crossover", "Hz"),
            Column("phase margin", "deg"),
            Column("gain may rise", "dB"),
            "Ms",
        ]
        return Table("the cascade, loop by loop", columns, rows)


def cascade_loops(control: Control, point: OperatingPoint) -> CascadeLoops | None:
    """Velocity and position loop of a P-PI control; None for another law.

    Lv is the gain at the actuator without position loop (Kv -> 0); the position loop is opened at the velocity command.
    """
    law = control.law
    if not isinstance(law, CascadePPI):
        return None
    whole, inner = (response_on(point, replace(control, law=replace(law, Kv=Kv))) for Kv in (law.Kv, _OFF * law.Kv))
    gain = -np.einsum("kl,kl->l", inner.value, point.by_force)
    velocity = FRF(point.frequency, gain, "cut", "force", "N/N", point.sample_time)
    return CascadeLoops(margins(velocity), margins(position_loop(point, whole, inner)))


class Verdict(Enum):
    """The recommendation: take the new control, keep today's, or reject the result because its proof fails."""

    TAKE = "take"
    LEAVE = "leave"
    REFUSE = "refuse"


@dataclass(frozen=True)
class HeldBack:
    """An active limit: the point and frequency, and the gain of the goal in percent if it is relaxed by a tenth."""

    what: str
    point: str
    frequency: float  # Hz
    gain: float

    def sentence(self) -> str:
        """The bound in one sentence."""
        where = f" at {Quantity(self.frequency, 'Hz')}" if self.frequency > 0.0 else ""
        gain = Quantity(0.01 * self.gain, "share")
        return Text(f"{self.what}{where} ({self.point}): a tenth more room would gain {gain:2}")


@dataclass(frozen=True, eq=False, repr=False)
class Tuned(Result):
    """A control shaped for a goal within limits at all points.

    tunables, started    values by dotted name of the control, new and today's (NaN: new filter)
    goal              the figure that is made best
    before, after     figures at each point; before is empty if today's control has none
    held              the bounds that limit the goal, the strongest first
    advice            advice on further improvements
    notches           the notches that were tried, and their effect on the goal
    sure, confidence  standard deviations kept to every bound, and with which probability all of them hold at once
    spread, unsettled by which share the worst end of the searches is above the best; why the best is not confirmed by
                      independent searches, empty if it is
    cost              by which share the goal is worse because of the noise of the measurement
    recipe            the rule that the control is made by, if nothing was searched
    cascade           velocity and position loop one by one, before and after, for a P-PI control
    """

    control: Control
    loops: tuple[Loop, ...]
    tunables: Mapping[str, float]
    started: Mapping[str, float]
    goal: Figure
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
    unsettled: str
    proof: tuple[Checked, ...]
    cascade: tuple[CascadeLoops, ...] = ()
    recipe: str = ""

    @property
    def rotary(self) -> bool:
        """Whether the axis turns; False where only responses are known."""
        return any(loop.axis.rotary for loop in self.loops)

    @property
    def settled(self) -> bool:
        """Whether independent searches came to within 5 % of the best, inside of the ranges."""
        return not self.unsettled

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
        """The goal of the tuning."""
        if self.recipe:
            return Text(f"{self.recipe}; judged by {self.limits.sentence()}")
        noise = f", kept with {Quantity(self.sure):3} standard deviations of the measurement" if self.sure else ""
        return Text(f"{aim(self)} subject to {self.limits.sentence()}{noise}")

    @property
    def at_drive(self) -> bool:
        """Whether the compliance is that against a force at the drive, since none on the table is known."""
        return any(loop.at_drive for loop in self.after)

    def gained(self) -> float | None:
        """By which factor the goal of the worst point is better than before; None without a stable before."""
        if not self.before or not all(loop.stable for loop in self.before):
            return None
        return goal_of(self, self.before) / goal_of(self, self.after)

    @property
    def verdict(self) -> Verdict:
        """What to do; the sentence of `recommendation` follows from it."""
        if not self.holds:
            return Verdict.REFUSE
        gained = self.gained()
        if gained is None or broken_limits(self.before, self.limits):
            return Verdict.TAKE
        return Verdict.LEAVE if _change(self, gained) < _NOT_WORTH else Verdict.TAKE

    def recommendation(self) -> str:
        """The recommendation with its reason, and the figures that are worse than today."""
        return recommendation(self)

    def table(self) -> Table:
        """Old and new figures, active limits, and the proof."""
        rows: list[Sequence[Cell]] = []
        for name, value in self.tunables.items():
            unit = tree.declaration(self.control, name).unit
            started = self.started[name]
            before = "–" if np.isnan(started) else Quantity(started, unit, form="5 SI")
            rows.append([readable(self.control, name), before, Quantity(value, unit, form="5 SI"), UNIT])
        for i, after in enumerate(self.after):
            before = self.before[i] if self.before else None
            mark = f" ({after.point})" if len(self.after) > 1 else ""
            rows += [
                [f"{figure.label or figure.title}{mark}", _figure(before, figure), _figure(after, figure), UNIT]
                for figure in reported()
                if figure.read(after) is not None
            ]
        rows += [["held back by", "", "", held.sentence()] for held in self.held]
        rows += [["to gain more", "", "", text] for text in self.advice]
        rows += [["notch", "", "", text] for text in self.notches]
        rows += [[f"proof: {line.what}", "", _verdict(line.holds), line.said] for line in self.proof]
        return Table(f"{self.rule}. {self.recommendation()}", ["what", "today", "new", "unit"], rows)


def _verdict(holds: bool | None) -> str:
    return "not proven" if holds is None else "holds" if holds else "DOES NOT HOLD"


def _figure(loop: Figures | None, figure: Figure) -> str | Quantity | None:
    if loop is None:
        return ""
    return figure.quantity(figure.read(loop)) if loop.stable else "unstable"


_NOT_WORTH = 2.0  # percent: a smaller gain does not justify a change
_WORSE = 0.03  # relative change of a figure that counts as worse
TIMES = 3.0  # from which a figure is said as so many times, not as percent more
_LEAST_PHASE, _MOST_PEAK = 15.0, 5.0  # deg and Ms of a velocity loop alone that are a headline


def declared_goal(tuned: Tuned) -> Goal:
    """Return how the figure of the goal is made best."""
    assert tuned.goal.goal is not None
    return tuned.goal.goal


def aim(tuned: Tuned) -> str:
    """Return the goal in words."""
    goal = declared_goal(tuned)
    band = (
        ""
        if tuned.band == (0.0, np.inf)
        else Text(f" from {Quantity(tuned.band[0], 'Hz', bare=True):6} to {Quantity(tuned.band[1], 'Hz'):6}")
    )
    best = "greatest" if tuned.goal.higher else "least"
    return Text(f"{best} {goal.what}{_against(tuned)}{band if goal.banded else ''}")


def _against(tuned: Tuned) -> str:
    return " against a force at the drive" if tuned.at_drive and declared_goal(tuned).on_table else ""


def recommendation(tuned: Tuned) -> str:
    """The recommendation with its reason, the limiting bounds, and the figures that are worse than today."""
    if tuned.verdict is Verdict.REFUSE:
        failed = [line for line in tuned.proof if line.holds is False]
        return Text(f"Do not use this tuning: {failed[0].what} does not hold ({failed[0].said}).")
    worse = _worse(tuned)
    price = Text(f"Worse than today: {worse}.") if worse else ""
    first, then = (_advised(tuned), price) if tuned.verdict is Verdict.LEAVE else (price, _advised(tuned))
    return joined(" ", filter(None, (_of_the_velocity_loop(tuned), first, then))) + _of_the_table(tuned)


def _of_the_velocity_loop(tuned: Tuned) -> str:
    """A headline if the new velocity loop alone is next to unstable, which the margins of the whole may hide."""
    if not tuned.cascade or tuned.verdict is Verdict.LEAVE:
        return ""
    alone = tuned.cascade[-1].velocity
    phase, peak = alone.phase_margin_deg, alone.sensitivity_peak
    if (phase is None or abs(phase) >= _LEAST_PHASE) and peak <= _MOST_PEAK:
        return ""
    margin = "" if phase is None else f"a phase margin of {_rough(phase, 'deg')} and "
    return Text(
        f"The velocity loop alone is next to unstable, with {margin}Ms {_rough(peak)}: it rings in manual mode."
    )


def _rough(value: float, unit: str = "") -> Quantity:
    """Return a quantity rounded to two digits, in the unit that it is usually read in."""
    size = USUAL.of(unit)[1]
    return Quantity(float(two_digits(size * value)) / size, unit, form="6")


def two_digits(value: float) -> str:
    """Return a number rounded to two digits, without an exponent up to a million."""
    return number(float(f"{value:.2g}"), 6)


def _of_the_table(tuned: Tuned) -> str:
    if not tuned.at_drive:
        return ""
    return (
        " The response to a force on the table is not known, and the table may become softer: strike the table or "
        "give a "
        "machine with its plant before cutting with it."
    )


def _advised(tuned: Tuned) -> str:
    limit = f"; {tuned.held[0].what} is the limit" if tuned.held else ""
    gained = tuned.gained()
    limits, new = tuned.limits.sentence(), _new_values(tuned)
    if gained is None:
        state = "there is no control to compare with" if not tuned.before else "today's loop is unstable"
        return Text(f"{new} keep {limits}, and {state}{limit}.")
    change, gain_text = _change(tuned, gained), _gain_text(tuned, gained)
    broken = broken_limits(tuned.before, tuned.limits)
    if broken:
        return Text(f"{new} keep {limits} with {gain_text}, and today's {broken}{limit}.")
    drive = _against(tuned)
    if tuned.recipe and change < 0.0:
        return Text(f"Leave the control as it is: this rule gives {gain_text}{drive}{limit}.")
    if tuned.verdict is Verdict.LEAVE:
        best = "this rule" if tuned.recipe else "the best that was found"
        return Text(f"Leave the control as it is: {best} has only {gain_text}{drive}{limit}.")
    return Text(f"{new} give {gain_text} within {limits}{limit}.")


def _gain_text(tuned: Tuned, gained: float) -> str:
    """`50 % more dynamic stiffness`, `570 times the dynamic stiffness`."""
    ratio = gained if tuned.goal.higher else 1.0 / gained
    if ratio >= TIMES:
        return Text(f"{_rough(ratio)} times the {declared_goal(tuned).what}")
    direction = "more" if ratio >= 1.0 else "less"
    return Text(f"{_rough(abs(ratio - 1.0), 'share')} {direction} {declared_goal(tuned).what}")


def _change(tuned: Tuned, gained: float) -> float:
    """By how many percent the goal is better than before."""
    return 100.0 * (gained - 1.0 if tuned.goal.higher else 1.0 - 1.0 / gained)


def _new_values(tuned: Tuned) -> str:
    """Recommended without reservation only if the response to a force on the table is known."""
    if not tuned.at_drive:
        return "Take the new values: they"
    return "Against a force at the drive the new values" if declared_goal(tuned).on_table else "The new values"


def _worse(tuned: Tuned) -> str:
    """Figures that are worse than today at the point where they fell most, as a clause."""
    if not tuned.before or not all(loop.stable for loop in tuned.before):
        return ""
    clauses: list[str] = []
    for name, now in tuned.tunables.items():
        if name.rpartition(".")[2] == "Kv" and tuned.started[name] > (1.0 + _WORSE) * now:
            clauses.append(_fall("Kv", tuned.started[name], now, "1/s"))
    for figure in reported():
        if not figure.compared:
            continue
        pairs = [(figure.read(a), figure.read(b)) for a, b in zip(tuned.before, tuned.after, strict=True)]
        fell = [
            ((a / b if figure.higher else b / a), a, b)
            for a, b in pairs
            if a is not None and b is not None and a * b > 0
        ]
        if fell and max(fell)[0] > 1.0 + _WORSE:
            clauses.append(_fall(figure.label or figure.title, *max(fell)[1:], figure.unit))
    return joined(", ", clauses)


def _fall(title: str, before: float, after: float, unit: str) -> str:
    return f"{title} {replace(_rough(before, unit), bare=True)} -> {_rough(after, unit)}"


def goal_of(tuned: Tuned, row: Sequence[Figures]) -> float:
    """The value of the goal, which is minimized, at the worst point."""
    of = declared_goal(tuned).of
    return max(of(loop, tuned.band) for loop in row)


def broken_limits(before: Sequence[Figures], limits: Limits, room: float = 0.02) -> str:
    """Which limit a control does not keep, as a clause; empty if it keeps all."""
    for loop in before:
        for verdict in judged(limits, loop, room):
            if not verdict.keeps:
                return Text(f"have {verdict.text}, not {limits.text(verdict.limit)}")
    return ""
