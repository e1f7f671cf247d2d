"""What a shaping gives: the control, old against new, what holds it back, what would help, and its proof."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.engineer.tuning.shaping.cascade import CascadeLoops
from feeddrive.engineer.tuning.shaping.figures import Figures
from feeddrive.engineer.tuning.shaping.limits import Limits
from feeddrive.engineer.tuning.tuned import Checked
from feeddrive.language import tree
from feeddrive.language.table import Result, Table
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop


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
class ShapedLoop(Result):
    """A control shaped for a goal within limits at all sites.

    knobs, started    values by dotted name of the control, new and where the user stands today (nan: new filter)
    before, after     figures at each site; before is empty if today's control has none
    held              the bounds that hold the goal back, the strongest first
    advice            what else would help, in plain words
    notches           what was tried and what it brought
    sure, confidence  standard deviations kept to every bound, and with which probability all of them hold at once
    cost              by which share the goal is worse because of the noise of the measurement
    cascade           velocity and position loop one by one, before and after, for a P-PI control
    """

    control: Control
    loops: tuple[Loop, ...]
    knobs: Mapping[str, float]
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
    proof: tuple[Checked, ...]
    cascade: tuple[CascadeLoops, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether no line of the proof fails; a tuning that does not hold must not be used."""
        return all(line.holds is not False for line in self.proof)

    @property
    def rule(self) -> str:
        """What it was tuned for."""
        band = "" if self.band == (0.0, np.inf) else f" from {self.band[0]:g} to {self.band[1]:g} Hz"
        what = {
            "rope-snap": "least rope-snap error",
            "stiffness": f"greatest dynamic stiffness{band}",
            "least-stiffness": f"greatest least stiffness{band}",
            "bandwidth": "greatest bandwidth",
        }[self.goal]
        noise = "" if not self.sure else f", kept with {self.sure:.3g} standard deviations of the measurement"
        return f"{what} subject to {self.limits.sentence()}{noise}"

    def gained(self) -> float | None:
        """By which factor the goal of the worst site is better than before; None without a stable before."""
        if not self.before or not all(each.stable for each in self.before):
            return None
        old, new = (max(_goal(each, self.goal, self.band) for each in row) for row in (self.before, self.after))
        return old / new

    def recommendation(self) -> str:
        """One plain sentence, with its reason."""
        failed = [line for line in self.proof if line.holds is False]
        if failed:
            return f"Do not use this tuning: {failed[0].what} does not hold ({failed[0].said})."
        limit = f"; {self.held[0].what} holds it back" if self.held else ""
        gained = self.gained()
        if gained is None:
            state = "there is no control to compare with" if not self.before else "today's loop is unstable"
            return f"Take the new values: they keep {self.limits.sentence()}, and {state}{limit}."
        what = {"rope-snap": "rope-snap error", "stiffness": "dynamic stiffness", "least-stiffness": "least stiffness",
                "bandwidth": "bandwidth"}[self.goal]  # fmt: skip
        broken = _broken(self.before, self.limits)
        less = self.goal == "rope-snap"
        change = 100.0 * (1.0 - 1.0 / gained if less else gained - 1.0)
        word = ("less" if less else "more") if change >= 0.0 else ("more" if less else "less")
        if broken:
            return (
                f"Take the new values: today's {broken}; the new ones keep {self.limits.sentence()} with "
                f"{abs(change):.3g} % {word} {what}{limit}."
            )
        if change < 2.0:
            return f"Leave the control as it is: the best that was found has only {change:.2g} % {word} {what}{limit}."
        return f"Take the new values: they give {change:.3g} % {word} {what} within {self.limits.sentence()}{limit}."

    def table(self) -> Table:
        """Old against new, what holds it back, and the proof."""
        rows = [
            [name, _number(self.started[name]), _number(value), tree.declaration(self.control, name).unit]
            for name, value in self.knobs.items()
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

    def plot(self) -> Any:
        """Dynamic stiffness before and after at each site, as a matplotlib figure."""
        from feeddrive.artefacts import plot

        many = len(self.after) > 1
        curves = {}
        for name, row in (("today", self.before), ("new", self.after)):
            for each in row:
                if each.stable:
                    curves[f"{name}, {each.site}" if many else name] = each.stiffness
        return plot.stiffness(curves)

    def to_pandas(self) -> Any:
        """A DataFrame with one row a knob."""
        from feeddrive.artefacts.plot import frames

        names = list(self.knobs)
        columns = {
            "today": np.array([self.started[name] for name in names]),
            "new": np.array([self.knobs[name] for name in names]),
        }
        return frames.frame(names, columns, "knob")


def _number(value: float) -> str:
    return "none" if np.isnan(value) else f"{value:.5g}"


def _verdict(holds: bool | None) -> str:
    return "not proven" if holds is None else "holds" if holds else "DOES NOT HOLD"


def _figure(each: Figures, read: Callable[[Figures], float | None]) -> str:
    if not each.stable:
        return "unstable"
    value = read(each)
    return "-" if value is None else f"{value:.4g}"


def _at(each: Figures, frequency: float) -> float | None:
    f = each.compliance.frequency
    return 1e-6 * each.stiffness.at(frequency) if f[0] <= frequency <= f[-1] else None


# head, unit, how it is read off
FIGURES: tuple[tuple[str, str, Callable[[Figures], float | None]], ...] = (
    ("Ms", "", lambda each: each.margins.sensitivity_peak),
    ("its standard deviation", "", lambda each: each.deviation or None),
    ("crossover", "Hz", lambda each: each.margins.crossover),
    ("bandwidth (|S| at -3 dB)", "Hz", lambda each: each.bandwidth),
    ("phase margin", "deg", lambda each: each.margins.phase_margin_deg),
    ("gain may rise by", "dB", lambda each: each.margins.gain_increase_dB),
    ("delay margin", "samples", lambda each: each.margins.delay_margin_samples),
    ("least stiffness", "N/um", lambda each: 1e-6 * each.stiffness.minimum),
    ("stiffness at 10 Hz", "N/um", lambda each: _at(each, 10.0)),
    ("peak compliance", "um/N", lambda each: 1e6 * each.peak_compliance),
    ("rope-snap error", "nm s^1/2/N", lambda each: 1e9 * each.rope_snap),
    ("force noise", "N RMS", lambda each: each.force_noise),
)


def _goal(each: Figures, goal: str, band: tuple[float, float]) -> float:
    """What is to be small."""
    f, size = each.compliance.frequency, each.compliance.magnitude
    inside = (f >= band[0]) & (f <= band[1])
    match goal:
        case "rope-snap":
            return each.rope_snap
        case "stiffness":
            x = np.log(f[inside])
            return float(np.sqrt(np.trapezoid(size[inside] ** 2, x) / (x[-1] - x[0])))
        case "least-stiffness":
            return float(np.max(size[inside]))
        case _:
            return 1.0 / each.bandwidth if each.bandwidth else np.inf


def _broken(before: tuple[Figures, ...], limits: Limits) -> str:
    """Which limit today's control does not keep, as a clause; empty if it keeps all."""
    for each in before:
        m = each.margins
        if limits.sensitivity_peak is not None and m.sensitivity_peak > 1.02 * limits.sensitivity_peak:
            return f"have Ms = {m.sensitivity_peak:.3g}, more than {limits.sensitivity_peak:g}"
        phase, gain = m.phase_margin_deg, m.gain_increase_dB
        if limits.phase_margin_deg is not None and phase is not None and abs(phase) < 0.98 * limits.phase_margin_deg:
            return f"have {phase:.3g} deg of phase margin, less than {limits.phase_margin_deg:g}"
        if limits.gain_margin_dB is not None and gain is not None and gain < 0.98 * limits.gain_margin_dB:
            return f"have {gain:.3g} dB of gain margin, less than {limits.gain_margin_dB:g}"
        if limits.compliance_peak is not None and each.peak_compliance > 1.02 * limits.compliance_peak:
            return f"have a peak compliance of {1e6 * each.peak_compliance:.3g} um/N"
    return ""
