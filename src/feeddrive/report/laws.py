"""The contents of a report that compares laws on the same task: an entry for each law, and their common facts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.analysis.replay import Replay
from feeddrive.analysis.spectrum import Spectrum, spectrum
from feeddrive.analysis.stiffness import Stiffness, stiffness
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run
from feeddrive.machining.part_run import PartRun
from feeddrive.path.planned import Planned
from feeddrive.report.report import Part, Picture, Section

RESPONSE_LINES = 1500  # lines of a frequency response, from 1 Hz to Nyquist


@dataclass(frozen=True, eq=False)
class Entry:
    """One law of the comparison: its loop, its run, and its figures in the frequency domain.

    The loop must be stable: check it first (`require_stable`).  The run must have all signals recorded.  With a
    `replay`, the run is the prediction, and the samples that the replay skips do not count. `no_model` is the reason if
    the law has no linear model; its stability is then not proven.
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
        """Return the samples of a signal that count, in SI."""
        return self.run[signal][0 if self.replay is None else self.replay.skipped :]

    @cached_property
    def shown(self) -> Run:
        """The run without the samples that do not count, for the pictures."""
        skip = 0 if self.replay is None else self.replay.skipped
        signals = {name: values[skip:] for name, values in self.run.signals.items()}
        return replace(self.run, signals=signals, samples=self.run.samples - skip, first=self.run.first + skip)

    def rms(self, signal: str) -> float:
        """Return the RMS of the samples that count, SI."""
        return float(np.sqrt(np.mean(self.counted(signal) ** 2)))

    def peak(self, signal: str) -> float:
        """Return the peak absolute value of the samples that count, SI."""
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
        """The spectrum of the following error, without samples that do not count."""
        return spectrum(self.counted("following_error"), self.run.sample_time, name="following_error", unit="m")

    @cached_property
    def limits(self) -> dict[str, float]:
        """The stated force limits in N by name: the commanded limit, and the motor's peak and continuous limits."""
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
    """The content of a report on laws. Texts are shown verbatim, with HTML escaped.

    entries   one for each law; the first is the baseline of the comparison
    facts     machine and run, by headline: machine, reference, load, noise, seed ...
    rule      a sentence on what makes the laws comparable
    job       the exact text of the job
    versions  of Python, feeddrive and its libraries, by name
    notes     remarks by the user
    command   the command that ran it
    overview  the picture that shows the verdict; None: the first of the other pictures
    extras    additional tables, first in the result
    pictures  additional pictures, before all others
    planned   the part program that all laws ran, if any
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
