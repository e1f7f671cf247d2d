"""What to send to a drive to measure its frequency response, and what a simulation says that it does to the axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.excitation.record import Record
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table, shown

OUTPUTS = {"reading_load": "m", "reading_motor": "m"}


def said(value: float, unit: str) -> str:
    """A figure in the unit that people read, lengths from 1 mm on in mm."""
    if unit == "m" and abs(value) >= 1e-3:
        return f"{1e3 * value:.4g} mm"
    name, factor = shown(unit)
    return f"{factor * value:.4g} {name}"


@dataclass(frozen=True)
class Limit:
    """One limit and what the simulation came to; `most` is None where nobody stated a limit."""

    what: str
    got: float
    most: float | None
    unit: str

    @property
    def holds(self) -> bool:
        """Whether it is kept; a limit that nobody stated is."""
        return self.most is None or self.got <= self.most

    def cells(self) -> list[str]:
        """What, got, limit and verdict as texts, in the unit that people read."""
        limit = "not stated" if self.most is None else said(self.most, self.unit)
        verdict = "–" if self.most is None else "holds" if self.holds else "BROKEN"
        return [self.what, said(self.got, self.unit), limit, verdict]


@dataclass(frozen=True, eq=False)
class Drawing:
    """One realisation: what is sent, and the signals of its simulation, all of shape (n,).

    excitation    N or m, added to the force command or to the set position
    set_position  m, of the motion underneath, without excitation
    signals       `set_position`, `force` (excitation and command together), readings and velocities, as simulated
    """

    time: np.ndarray
    excitation: np.ndarray
    set_position: np.ndarray
    signals: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(Result):
    """A multisine for a measurement, drawn once or with several phases, and the limits that were checked.

    where            "force" (added to the command, N) or "setpoint" (added to the set position, m)
    period           samples; `periods` of them in steady state, `fade` samples before and after in which it swells
    first            sample at which the first whole period begins
    offset_velocity  m/s under the excitation, so that the axis slides throughout
    least_velocity   m/s, smallest speed towards the offset during the periods; below 0 the axis turned round
    """

    name: str
    where: str
    amplitude: float
    crest: float
    sample_time: float
    period: int
    periods: int
    fade: int
    first: int
    lines: np.ndarray
    grid: str
    offset_velocity: float
    least_velocity: float
    drawings: tuple[Drawing, ...]
    limits: tuple[Limit, ...]
    remarks: tuple[str, ...] = ()

    @property
    def frequency(self) -> np.ndarray:
        """Of the excited lines, Hz."""
        return self.lines / (self.period * self.sample_time)

    @property
    def unit(self) -> str:
        """Of the excitation."""
        return "N" if self.where == "force" else "m"

    def records(self, output: str = "reading_load") -> list[Record]:
        """The simulated measurements, cut to whole periods: what `estimate_frf` makes of them is what to expect."""
        if output not in OUTPUTS:
            raise ParameterError(f"output = {output!r} must be one of {', '.join(OUTPUTS)}")
        kept = slice(self.first, self.first + self.periods * self.period)
        return [
            Record(
                input=drawn.signals["force"][kept],
                output=drawn.signals[output][kept],
                references=(drawn.excitation[kept],),
                sample_time=self.sample_time,
                input_name="force",
                output_name=output,
                unit=f"{OUTPUTS[output]}/N",
                name=f"{self.name} {i + 1}",
            )
            for i, drawn in enumerate(self.drawings)
        ]

    def table(self) -> Table:
        """The limits, and what the simulation came to."""
        title = (
            f"{self.name}: {self.lines.size} lines {self.frequency[0]:.4g} .. {self.frequency[-1]:.4g} Hz on "
            f"{self.where}, peak {said(self.amplitude, self.unit)}, crest factor {self.crest:.3f}, "
            f"{self.periods} periods of {self.period * self.sample_time:.4g} s, {len(self.drawings)} realisation(s)"
        )
        return Table(title, ["in the simulation", "got", "limit", ""], [limit.cells() for limit in self.limits])
