"""The contents of a report that compares laws on the same task: an entry for each law, common facts, conclusions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.analysis.replay import Replay
from feeddrive.analysis.spectrum import Spectrum, spectrum
from feeddrive.analysis.stiffness import Stiffness, stiffness
from feeddrive.files.machine import MachineFile
from feeddrive.language.block import Block, declarations
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, root_mean_square
from feeddrive.machining.part_run import PartRun
from feeddrive.report.report import Part, Picture, Section

if TYPE_CHECKING:
    from feeddrive.path.planned import Planned

_LINES = 1500  # lines of a frequency response, from 1 Hz to Nyquist


def response_lines(loop: Loop) -> np.ndarray:
    """Return the frequencies in Hz at which the frequency responses of a loop are plotted."""
    nyquist = 0.5 / loop.sample_time
    # at least two decades, also where the Nyquist frequency is below 100 Hz
    return np.geomspace(min(1.0, 0.01 * nyquist), nyquist, _LINES)


def facts_of(machine: MachineFile, name: str, loop: Loop, velocity: float, work: Mapping[str, str]) -> dict[str, str]:
    """Return the facts for a report on laws, by heading: machine, task, and operating point of the linear model."""
    facts = {
        "Machine": name,
        "Source of its numbers": machine.source or "not stated",
        "Sample time": Text(f"{Quantity(loop.sample_time, 's'):6}, {loop.axis.substeps} substep(s) of exact hold"),
        **work,
        "Linear model": Text(f"sliding at {Quantity(velocity, 'm/s')}"),
    }
    return facts | ({"Remark": machine.remark} if machine.remark else {})


@dataclass(frozen=True, eq=False)
class Entry:
    """One law of the comparison: its loop, its run, and its frequency-domain results.

    The loop must be stable; check it first with `require_stable`.  The run must contain all signals.  With a `replay`,
    the run is the prediction, and the samples skipped by the replay are excluded from all results.  `no_model` states
    why the law has no linear model, if it has none; its stability is then not proven.
    """

    name: str
    description: str
    run: Run
    loop: Loop
    loop_gain: FRF | None = None
    compliance: FRF | None = None
    tracking: FRF | None = None
    no_model: str = ""
    replay: Replay | None = None
    together: Run | None = None  # the run of all axes together
    part: PartRun | None = None  # the figures along a part program

    def counted(self, signal: str) -> np.ndarray:
        """Return a signal in SI units, without the samples skipped by the replay."""
        return self.run[signal][0 if self.replay is None else self.replay.skipped :]

    @cached_property
    def shown(self) -> Run:
        """The run without the samples skipped by the replay, for plotting."""
        skip = 0 if self.replay is None else self.replay.skipped
        signals = {name: values[skip:] for name, values in self.run.signals.items()}
        # `first` moves too, so that the time axis still shows the time of the log
        return replace(self.run, signals=signals, samples=self.run.samples - skip, first=self.run.first + skip)

    def rms(self, signal: str) -> float:
        """Return the RMS of a signal in SI units, without the samples skipped by the replay."""
        return float(np.sqrt(np.mean(self.counted(signal) ** 2)))

    def peak(self, signal: str) -> float:
        """Return the peak absolute value of a signal in SI units, without the samples skipped by the replay."""
        return float(np.max(np.abs(self.counted(signal)), initial=0.0))

    @cached_property
    def margins(self) -> Margins | None:
        """The stability margins of the loop gain."""
        return None if self.loop_gain is None else margins(self.loop_gain)

    @cached_property
    def stiffness(self) -> Stiffness | None:
        """The dynamic stiffness: the inverse of the compliance."""
        return None if self.compliance is None else stiffness(self.compliance)

    @cached_property
    def spectrum(self) -> Spectrum:
        """The spectrum of the following error, without the samples skipped by the replay."""
        return spectrum(self.counted("following_error"), self.run.sample_time, name="following_error", unit="m")

    @cached_property
    def limits(self) -> dict[str, float]:
        """The force limits in N by name: the command limit and the motor's peak and continuous limits, if specified."""
        stated: dict[str, float] = {}
        limit = self.loop.control.force_limit
        motor = self.loop.axis.actuator.motor
        peak, continuous = (None, None) if motor is None else motor.limits()
        if peak is not None:
            stated["motor peak"] = float(peak)
        # a command limit set to the motor's peak is one limit and not two
        if limit is not None and (peak is None or abs(limit - peak) > 1e-6 * peak):
            stated["commanded limit"] = float(limit)
        if continuous is not None:
            stated["motor continuous (RMS)"] = float(continuous)
        return stated


@dataclass(frozen=True, eq=False)
class LawsContents:
    """The content of a report on laws. Its strings appear verbatim, with HTML escaped.

    entries   one for each law; the first is the baseline of the comparison
    facts     machine and run, by heading: machine, reference, load, noise, seed ...
    rule      a sentence that states why the laws are comparable
    job       the exact text of the job
    versions  versions of Python, feeddrive and its libraries, by name
    notes     the user's remarks
    command   the command that produced the results
    overview  the picture that illustrates the verdict; None: the first of the other pictures
    extras    additional tables, placed first in the result
    pictures  additional pictures, placed before all others
    planned   the planned part program that all laws followed, if any
    cuts      tables of the cuts by program line, with force and chatter
    details   additional folded sections
    """

    title: str
    entries: Sequence[Entry]
    facts: Mapping[str, str] = field(default_factory=dict[str, str])
    rule: str = ""
    job: str = ""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    notes: Sequence[str] = ()
    command: str = "feeddrive run"
    overview: Picture | None = None
    extras: Sequence[Part] = ()
    pictures: Sequence[Picture] = ()
    planned: Planned | None = None
    cuts: Sequence[Part] = ()
    details: Sequence[Section] = ()


# the usual bound on the sensitivity peak: Skogestad & Postlethwaite, section 2.4
MS_BOUND = 2.0


def result_sentences(contents: LawsContents) -> list[str]:
    """Return the conclusions of the comparison as sentences, the most important first."""
    replayed = next((entry for entry in contents.entries if entry.replay is not None), None)
    if replayed is not None and replayed.replay is not None:
        return _prediction(replayed.replay)
    if len(contents.entries) == 1:
        return _alone(contents.entries[0])
    return _compared(contents)


def _prediction(replay: Replay) -> list[str]:
    off, error = replay.rms("position_load"), root_mean_square(replay.measured["following_error"][replay.skipped :])
    peak = float(np.max(np.abs(replay.residual("position_load"))))
    share = off / error if error else 0.0
    sentences: list[str] = [
        Text(
            f"The model predicts the measured position to {Quantity(off, 'm'):3} RMS ({Quantity(peak, 'm'):3} at "
            f"most), while the axis itself follows its setpoint with {Quantity(error, 'm'):3} RMS: the residual is "
            f"{Quantity(share, 'share'):3} of the following error."
        )
    ]
    if "force" in replay.measured:
        share = replay.share("force")
        sentences.append(Text(f"The residual of the force is {Quantity(share, 'share'):3} of its RMS."))
    return sentences


def _alone(entry: Entry) -> list[str]:
    limit = next(iter(entry.limits.items()), None)
    peak = entry.peak("force")
    force = f"the largest force is {Quantity(peak, 'N'):3}"
    if limit is not None:
        force += f", {Quantity(peak / limit[1], 'share'):3} of the {limit[0]}"
    sentences: list[str] = [Text(f"{_quoted(entry)} follows its setpoint with {_errors(entry)}; {force}.")]
    if entry.margins is not None:
        ringing = number(entry.margins.sensitivity_peak, 3)
        sentences.append(Text(f"Its sensitivity peak is Ms = {ringing}, {_judged(entry)}."))
    return sentences


def _compared(contents: LawsContents) -> list[str]:
    first = contents.entries[0]
    best = min(contents.entries, key=lambda entry: entry.rms("following_error"))
    if best is first:
        return [Text(f"None of the others follows better than {_quoted(first)}: {_errors(first)}.")]
    ratio = first.rms("following_error") / (best.rms("following_error") or 1.0)
    # above three times, a factor reads better than a percentage: 67 % less, 75 % less, ...
    less = f"{number(ratio, 2)} times" if ratio >= 3.0 else f"{Quantity(1.0 - 1.0 / ratio, 'share'):3}"
    ranking = Text(
        f"Of {len(contents.entries)} laws {_quoted(best)} follows best: {_errors(best)}, {less} less RMS than "
        f"{_quoted(first)} ({_errors(first)})."
    )
    prices = [price for price in (_price_of_robustness(first, best), _price_of_stiffness(first, best)) if price]
    costs = [Text(f"What {_quoted(best)} costs: {joined('; ', prices)}.")] if prices else []
    return [*costs, ranking]


def _price_of_robustness(first: Entry, best: Entry) -> str:
    if first.margins is None or best.margins is None:
        return ""
    before, after = first.margins.sensitivity_peak, best.margins.sensitivity_peak
    # an Ms higher by two percent is no price that a reader would weigh
    if after <= 1.02 * before:
        return ""
    return f"its sensitivity peak is {number(after, 3)} in place of {number(before, 3)}, {_judged(best)}"


def _price_of_stiffness(first: Entry, best: Entry) -> str:
    if first.stiffness is None or best.stiffness is None:
        return ""
    before, after = first.stiffness.minimum, best.stiffness.minimum
    if after >= 0.98 * before:
        return ""
    fallen = Quantity(after, "N/m", form="3")
    return Text(f"the least dynamic stiffness falls from {Quantity(before, 'N/m', bare=True):3} to {fallen}")


def _judged(entry: Entry) -> str:
    peak = 0.0 if entry.margins is None else entry.margins.sensitivity_peak
    return f"{'above' if peak > MS_BOUND else 'within'} the usual bound of {number(MS_BOUND)}"


def remark_sentences(contents: LawsContents) -> list[str]:
    """Return warnings about robustness, force limits and guard trips, followed by the notes of the job."""
    listed: list[str] = []
    ringing = [
        f"{_quoted(entry)} ({number(entry.margins.sensitivity_peak, 3)})"
        for entry in contents.entries
        if entry.margins is not None and entry.margins.sensitivity_peak > MS_BOUND
    ]
    if ringing:
        listed.append(
            f"The sensitivity peak is above {number(MS_BOUND)}: {', '.join(ringing)}. A small change of the axis makes "
            "such a loop ring."
        )
    for entry in contents.entries:
        name = _quoted(entry)
        listed += _of_force(entry, name)
        tripped = np.flatnonzero(entry.run["trip"])
        if tripped.size:
            time = Quantity(entry.run.time[tripped[0]], "s", form="SI")
            listed.append(Text(f"{name}: the guard tripped at {time}."))
    # a note that repeats the rule of comparison would appear twice in the report
    return [*listed, *(note for note in contents.notes if note != contents.rule)]


def _of_force(entry: Entry, name: str) -> list[str]:
    listed: list[str] = []
    limit = entry.loop.control.force_limit
    if limit is not None:
        # 1 - 1e-9: the limited command equals the limit but for rounding of its unit
        at_limit = float(np.mean(np.abs(entry.counted("force")) >= limit * (1.0 - 1e-9)))
        if at_limit > 0.0:
            share = Quantity(at_limit, "share", form="3")
            listed.append(Text(f"{name}: the force is at its limit for {share} of the time."))
    for what, bound in entry.limits.items():
        if what == "motor peak" and entry.peak("force") > bound * (1.0 + 1e-9):
            listed.append(
                Text(
                    f"{name}: the largest force, {Quantity(entry.peak('force'), 'N'):3}, is above the motor's peak of "
                    f"{Quantity(bound, 'N'):3}: the model does not limit it there, the machine will."
                )
            )
        if what.startswith("motor continuous") and entry.rms("force") > bound:
            listed.append(
                Text(
                    f"{name}: the RMS force, {Quantity(entry.rms('force'), 'N'):3}, is above the motor's continuous "
                    f"{Quantity(bound, 'N'):3}: repeated without pause this work overheats the motor."
                )
            )
    return listed


def _errors(entry: Entry) -> str:
    rms, peak = (Quantity(value("following_error"), "m", form="3") for value in (entry.rms, entry.peak))
    return Text(f"{rms} RMS, {peak} at most")


def _quoted(entry: Entry) -> str:
    return f"'{entry.name}'"


def block_sentence(block: Block) -> Text:
    """Describe a block by its kind, its parameter values, and its parts in brackets."""
    declared = declarations(type(block))
    values = {name: getattr(block, name) for name in declared}
    parameters = [
        f"{name.replace('_', ' ')} {Quantity(value, declared[name].unit):6 SI}"
        for name, value in values.items()
        if isinstance(value, float)
    ]
    parts = [
        f"({block_sentence(part)})"
        for value in values.values()
        for part in (value if isinstance(value, tuple) else (value,))
        if isinstance(part, Block)
    ]
    return Text(f"{block.kind.replace('_', ' ')}: {joined(', ', [*parameters, *parts])}")


def described(control: Control) -> Text:
    """Describe the parts of a controller with their parameter values."""
    parts = [block_sentence(control.law)]
    parts += [Text(f"compensation {block_sentence(block)}") for block in control.compensation]
    parts += [Text(f"filter {block_sentence(block)}") for block in control.filters]
    parts += [Text(f"feedforward {block_sentence(block)}") for block in control.feedforward]
    if control.prefilter is not None:
        parts.append(Text(f"prefilter {block_sentence(control.prefilter)}"))
    if control.force_limit is not None:
        parts.append(Text(f"limit {Quantity(control.force_limit, 'N')}"))
    return joined("; ", parts)
