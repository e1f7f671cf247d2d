"""The result of a tuning: the control, old and new figures, active limits, verification, and a summary in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.analysis.stiffness import mean_compliance
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import FIGURES, LARGER, Figures
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
        rows: list[list[str]] = []
        fast, slow = (each.loop_gain.sample_time for each in (self.velocity, self.position))
        ran = "" if fast is None or slow is None or fast == slow else Text(f", every {Quantity(slow, 's'):6}")
        for name, m in (("velocity loop", self.velocity), (f"position loop{ran}", self.position)):
            cells = (m.crossover, m.phase_margin_deg, m.gain_increase_dB, m.sensitivity_peak)
            rows.append([name, *("-" if cell is None else f"{cell:.4g}" for cell in cells)])
        heads = ["loop", "crossover Hz", "phase margin deg", "gain may rise dB", "Ms"]
        return Table("the cascade, loop by loop", heads, rows)


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
        where = Text(f" at {Quantity(self.frequency, 'Hz')}") if self.frequency > 0.0 else ""
        return f"{self.what}{where} ({self.point}): a tenth more room would gain {self.gain:.2g} %"


@dataclass(frozen=True, eq=False, repr=False)
class Tuned(Result):
    """A control shaped for a goal within limits at all points.

    tunables, started    values by dotted name of the control, new and today's (NaN: new filter)
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
            return f"{self.recipe}; judged by {self.limits.sentence()}"
        noise = "" if not self.sure else f", kept with {self.sure:.3g} standard deviations of the measurement"
        return f"{aim(self)} subject to {self.limits.sentence()}{noise}"

    @property
    def at_drive(self) -> bool:
        """Whether the compliance is that against a force at the drive, since none on the table is known."""
        return any(each.at_drive for each in self.after)

    def gained(self) -> float | None:
        """By which factor the goal of the worst point is better than before; None without a stable before."""
        if not self.before or not all(each.stable for each in self.before):
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
            mark = f" ({after.point})" if len(self.after) > 1 else ""
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


_NOT_WORTH = 2.0  # percent: a smaller gain does not justify a change
_WORSE = 0.03  # relative change of a figure that counts as worse
TIMES = 3.0  # from which a figure is said as so many times, not as percent more
_LEAST_PHASE, _MOST_PEAK = 15.0, 5.0  # deg and Ms of a velocity loop alone that are a headline
_WHAT = {
    "rope-snap": "rope-snap error",
    "stiffness": "dynamic stiffness",
    "least-stiffness": "least stiffness",
    "integral-gain": "integral gain",
    "bandwidth": "bandwidth",
}


def aim(found: Tuned) -> str:
    """The goal."""
    band = "" if found.band == (0.0, np.inf) else Text(f" from {found.band[0]:g} to {Quantity(found.band[1], 'Hz'):6}")
    drive = " against a force at the drive" if found.at_drive and found.goal != "bandwidth" else ""
    return {
        "rope-snap": f"least rope-snap error{drive}",
        "stiffness": f"greatest dynamic stiffness{drive}{band}",
        "least-stiffness": f"greatest least stiffness{drive}{band}",
        "integral-gain": f"greatest integral gain{drive}{band}",
        "bandwidth": "greatest bandwidth",
    }[found.goal]


def recommendation(found: Tuned) -> str:
    """The recommendation with its reason, the limiting bounds, and the figures that are worse than today."""
    if found.verdict is Verdict.REFUSE:
        failed = [line for line in found.proof if line.holds is False]
        return f"Do not use this tuning: {failed[0].what} does not hold ({failed[0].said})."
    worse = _worse(found)
    price = f"Worse than today: {worse}." if worse else ""
    first, then = (_advised(found), price) if found.verdict is Verdict.LEAVE else (price, _advised(found))
    return " ".join(each for each in (_of_the_velocity_loop(found), first, then) if each) + _of_the_table(found)


def _of_the_velocity_loop(found: Tuned) -> str:
    """A headline if the new velocity loop alone is next to unstable, which the margins of the whole may hide."""
    if not found.cascade or found.verdict is Verdict.LEAVE:
        return ""
    alone = found.cascade[-1].velocity
    phase, peak = alone.phase_margin_deg, alone.sensitivity_peak
    if (phase is None or abs(phase) >= _LEAST_PHASE) and peak <= _MOST_PEAK:
        return ""
    margin = "" if phase is None else f"a phase margin of {two_digits(phase)} deg and "
    return f"The velocity loop alone is next to unstable, with {margin}Ms {two_digits(peak)}: it rings in manual mode."


def two_digits(value: float) -> str:
    """Two digits, without an exponent up to a million."""
    return f"{float(f'{value:.2g}'):g}"


def _of_the_table(found: Tuned) -> str:
    if not found.at_drive:
        return ""
    return (
        " The response to a force on the table is not known, and the table may become softer: strike the table or "
        "give a "
        "machine with its plant before cutting with it."
    )


def _advised(found: Tuned) -> str:
    limit = f"; {found.held[0].what} is the limit" if found.held else ""
    gained = found.gained()
    limits, new = found.limits.sentence(), _new_values(found)
    if gained is None:
        state = "there is no control to compare with" if not found.before else "today's loop is unstable"
        return f"{new} keep {limits}, and {state}{limit}."
    change, said = _change(found, gained), _gain_said(found, gained)
    broken = broken_limits(found.before, found.limits)
    if broken:
        return f"{new} keep {limits} with {said}, and today's {broken}{limit}."
    drive = " against a force at the drive" if found.at_drive and found.goal != "bandwidth" else ""
    if found.recipe and change < 0.0:
        return f"Leave the control as it is: this rule gives {said}{drive}{limit}."
    if found.verdict is Verdict.LEAVE:
        best = "this rule" if found.recipe else "the best that was found"
        return f"Leave the control as it is: {best} has only {said}{drive}{limit}."
    return f"{new} give {said} within {limits}{limit}."


def _gain_said(found: Tuned, gained: float) -> str:
    """`50 % more dynamic stiffness`, `570 times the dynamic stiffness`."""
    ratio = 1.0 / gained if found.goal == "rope-snap" else gained
    if ratio >= TIMES:
        return f"{two_digits(ratio)} times the {_WHAT[found.goal]}"
    return f"{two_digits(100.0 * abs(ratio - 1.0))} % {'more' if ratio >= 1.0 else 'less'} {_WHAT[found.goal]}"


def _change(found: Tuned, gained: float) -> float:
    """By how many percent the goal is better than before."""
    return 100.0 * (1.0 - 1.0 / gained if found.goal == "rope-snap" else gained - 1.0)


def _new_values(found: Tuned) -> str:
    """Recommended without reservation only if the response to a force on the table is known."""
    if not found.at_drive:
        return "Take the new values: they"
    return "The new values" if found.goal == "bandwidth" else "Against a force at the drive the new values"


def _worse(found: Tuned) -> str:
    """Figures that are worse than today at the point where they fell most, as a clause."""
    if not found.before or not all(each.stable for each in found.before):
        return ""
    said: list[str] = []
    for name, now in found.tunables.items():
        if name.rpartition(".")[2] == "Kv" and found.started[name] > (1.0 + _WORSE) * now:
            said.append(f"Kv {two_digits(found.started[name])} -> {two_digits(now)} 1/s")
    for head, unit, read in FIGURES:
        if head not in LARGER:
            continue
        pairs = [(read(a), read(b)) for a, b in zip(found.before, found.after, strict=True)]
        fell = [
            ((a / b if LARGER[head] else b / a), a, b)
            for a, b in pairs
            if a is not None and b is not None and a * b > 0
        ]
        if fell and max(fell)[0] > 1.0 + _WORSE:
            _, a, b = max(fell)
            said.append(f"{head} {two_digits(a)} -> {two_digits(b)} {unit}".rstrip())
    return ", ".join(said)


def goal_of(found: Tuned, row: Sequence[Figures]) -> float:
    """The value of the goal, which is minimized, at the worst point."""
    return max(_goal(each, found.goal, found.band) for each in row)


def _goal(each: Figures, goal: str, band: tuple[float, float]) -> float:
    f, size = each.compliance.frequency, each.compliance.magnitude
    inside = (f >= band[0]) & (f <= band[1])
    match goal:
        case "rope-snap":
            return each.rope_snap
        case "stiffness":
            return mean_compliance(f, each.compliance.response, band)
        case "least-stiffness":
            return float(np.max(size[inside]))
        case "integral-gain":
            return float(np.max((size / (2.0 * np.pi * f))[inside]))
        case _:
            return 1.0 / each.bandwidth if each.bandwidth else np.inf


def broken_limits(before: Sequence[Figures], limits: Limits, room: float = 0.02) -> str:
    """Which limit a control does not keep, as a clause; empty if it keeps all."""
    for each in before:
        for found in judged(limits, each.margins, each.peak_compliance, each.force_noise, room):
            if not found.keeps:
                return f"have {found}, not {limits.only(found.kind)}"
    return ""
