"""The contents of a report: the results and texts that its page shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.analysis.replay import Replay
from feeddrive.analysis.spectrum import Spectrum, spectrum
from feeddrive.analysis.stiffness import Stiffness, stiffness
from feeddrive.language.table import Table
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run

RESPONSE_LINES = 1500  # of the frequency responses of an entry, from 1 Hz to Nyquist


@dataclass(frozen=True)
class Shown:
    """A picture that is drawn when asked for: a key of letters, a headline, how to read it, what is seen."""

    key: str
    title: str
    caption: str
    alt: str
    draw: Callable[[], Any]


@dataclass(frozen=True)
class ShownTable:
    """A table of a report.

    best  the row that stands out, for each column after the first; None for none
    text  whether the cells are sentences
    """

    table: Table
    best: Sequence[int | None] = ()
    text: bool = False


@dataclass(frozen=True, eq=False)
class Entry:
    """One law of the comparison: its loop, its run, and what the frequency domain says about it.

    The loop is stable: check it before (`require_stable`).  The run has all signals recorded.  With a `replay` it is
    the prediction, and the samples that the replay skips do not count.
    """

    name: str
    description: str
    run: Run
    loop: Loop
    loop_gain: FRF | None = None
    compliance: FRF | None = None
    tracking: FRF | None = None
    replay: Replay | None = None
    together: Run | None = None  # all axes of a machine in the same run

    def counted(self, signal: str) -> np.ndarray:
        """The samples of a signal that count, in SI."""
        return self.run[signal][0 if self.replay is None else self.replay.skipped :]

    @cached_property
    def shown(self) -> Run:
        """The run without the samples that do not count: what the pictures show."""
        skip = 0 if self.replay is None else self.replay.skipped
        signals = {name: values[skip:] for name, values in self.run.signals.items()}
        return replace(self.run, signals=signals, samples=self.run.samples - skip, first=self.run.first + skip)

    def rms(self, signal: str) -> float:
        """RMS of the samples that count, SI."""
        return float(np.sqrt(np.mean(self.counted(signal) ** 2)))

    def peak(self, signal: str) -> float:
        """Largest size of the samples that count, SI."""
        return float(np.max(np.abs(self.counted(signal)), initial=0.0))

    @cached_property
    def margins(self) -> Margins | None:
        """Of the loop gain."""
        return None if self.loop_gain is None else margins(self.loop_gain)

    @cached_property
    def stiffness(self) -> Stiffness | None:
        """The inverse of the compliance."""
        return None if self.compliance is None else stiffness(self.compliance)

    @cached_property
    def spectrum(self) -> Spectrum:
        """Of the following error that counts."""
        return spectrum(self.counted("following_error"), self.run.sample_time, name="following_error", unit="m")

    @cached_property
    def limits(self) -> dict[str, float]:
        """Force limits in N by name: commanded, and the motor's peak and continuous one, as far as they are stated."""
        found: dict[str, float] = {}
        limit = self.loop.control.force_limit
        motor = self.loop.axis.actuator.motor
        peak, continuous = (None, None) if motor is None else motor.limits()
        if peak is not None:
            found["motor peak"] = float(peak)
        if limit is not None and (peak is None or abs(limit - peak) > 1e-6 * peak):
            found["commanded limit"] = float(limit)
        if continuous is not None:
            found["motor continuous (RMS)"] = float(continuous)
        return found


@dataclass(frozen=True, eq=False)
class Study:
    """The content of a report. Texts are shown unchanged, escaped.

    entries   one for each law, the first is the one that the others are compared with
    facts     what was run, by headline: machine, reference, load, noise, seed ...
    rule      by what the laws are comparable, as a sentence
    job       the exact text of the job
    versions  of Python, feeddrive and what they stand on, by name
    notes     remarks of the person who ran it
    extras    tables of its own, first in the result
    pictures  pictures of its own, before all others
    """

    title: str
    entries: Sequence[Entry]
    facts: Mapping[str, str] = field(default_factory=dict[str, str])
    rule: str = ""
    job: str = ""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    notes: Sequence[str] = ()
    extras: Sequence[ShownTable] = ()
    pictures: Sequence[Shown] = ()
