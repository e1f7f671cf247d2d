"""The contents of a report about laws over the same work: an entry for each law, and their common facts."""

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

RESPONSE_LINES = 1500  # of the frequency responses of an entry, from 1 Hz to Nyquist


@dataclass(frozen=True, eq=False)
class Entry:
    """One law of the comparison: its loop, its run, and its figures in the frequency domain.

    The loop is stable: check it before (`require_stable`).  The run has all signals recorded.  With a `replay` it is
    the prediction, and the samples that the replay skips do not count. `no_model` is the reason if the law has no
    linear model; its stability is then not proven.
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
    together: Run | None = None  # all axes of a machine in the same run
    part: PartRun | None = None  # its figures along a part program

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
        """Return the largest size of the samples that count, SI."""
        return float(np.max(np.abs(self.counted(signal)), initial=0.0))

    @cached_property
    def margins(self) -> Margins | None:
        """The margins of the loop gain."""
        return None if self.loop_gain is None else margins(self.loop_gain)

    @cached_property
    def stiffness(self) -> Stiffness | None:
        """The inverse of the compliance."""
        return None if self.compliance is None else stiffness(self.compliance)

    @cached_property
    def spectrum(self) -> Spectrum:
        """The spectrum of the following error, without samples that do not count."""
        return spectrum(self.counted("following_error"), self.run.sample_time, name="following_error", unit="m")

    @cached_property
    def limits(self) -> dict[str, float]:
        """Force limits in N by name: commanded, and the motor's peak and continuous one, as far as they are stated."""
        stated: dict[str, float] = {}
        limit = self.loop.control.force_limit
        motor = self.loop.axis.actuator.motor
        peak, continuous = (None, None) if motor is None else motor.limits()
        if peak is not None:
            stated["motor peak"] = float(peak)
        if limit is not None and (peak is None or abs(limit - peak) > 1e-6 * peak):
            stated["commanded limit"] = float(limit)
        if continuous is not None:
            stated["motor continuous (RMS)"] = float(continuous)
        return stated


@dataclass(frozen=True, eq=False)
class LawsContents:
    """The content of a report. Texts are shown unchanged, escaped.

    entries   one for each law, the first is the one that the others are compared with
    facts machine and run, by headline: machine, reference, load, noise, seed ...
    rule what makes the laws comparable, as a sentence
    job       the exact text of the job
    versions of Python, feeddrive and its libraries, by name
    notes     remarks of the person who ran it
    command   that ran it
    overview  the picture that shows the verdict; None: the first of all others
    extras    tables of its own, first in the result
    pictures  pictures of its own, before all others
    planned   the part program that all laws ran, if one
    cuts      what cut while which lines ran, in cells
    details   sections of its own, folded
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
