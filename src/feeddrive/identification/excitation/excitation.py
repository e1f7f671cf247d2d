"""A designed excitation: the signal to send to the drive, and the simulated response of the axis to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.identification.excitation.record import Record
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Result, Table
from feeddrive.language.text import Text
from feeddrive.language.units import turning
from feeddrive.loop.loop import Loop

OUTPUTS = {"reading_load": "m", "reading_motor": "m"}
_TRIALS = 5  # simulations to find an amplitude that keeps the limits
_HOPELESS = 100.0  # times the limit: an amplitude that keeps such a limit is too small to measure with


def said(value: float, unit: str) -> Quantity:
    """Return a figure in the unit that people read: lengths from 1 mm on in mm, angles in urad."""
    shown = {"m": "mm" if abs(value) >= 1e-3 else "um", "rad": "urad", "rad/s": "mrad/s"}.get(unit, "")
    return Quantity(value, unit, form=shown)


@dataclass(frozen=True)
class Limit:
    """One limit and the peak in the simulation; `most` is None if no limit was stated."""

    what: str
    got: float
    most: float | None
    unit: str

    @property
    def holds(self) -> bool:
        """Whether the limit is kept; True if none was stated."""
        return self.most is None or self.got <= self.most

    def cells(self) -> list[Cell]:
        """Return name, value, limit and verdict."""
        limit = "not stated" if self.most is None else said(self.most, self.unit)
        verdict = "–" if self.most is None else "holds" if self.holds else "BROKEN"
        return [self.what, said(self.got, self.unit), limit, verdict]


@dataclass(frozen=True, eq=False)
class Drawing:
    """One realization: the excitation to send, and the signals of its simulation, all of shape (n,).

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
    period           samples; `periods` of them in steady state, `fade` samples before and after in which it fades in
                     and out
    first            sample at which the first whole period begins
    offset_velocity  m/s under the excitation, so that the axis slides throughout
    turns            the axis turns: torques in N m, angles in rad
    least_velocity   m/s, smallest speed towards the offset during the periods; below 0 the axis reversed
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
    turns: bool = False

    @property
    def rotary(self) -> bool:
        """Whether the axis turns."""
        return self.turns

    @property
    def frequency(self) -> np.ndarray:
        """Of the excited lines, Hz."""
        return self.lines / (self.period * self.sample_time)

    @property
    def unit(self) -> str:
        """Of the excitation."""
        unit = "N" if self.where == "force" else "m"
        return turning(unit) if self.turns else unit

    def records(self, output: str = "reading_load") -> list[Record]:
        """The simulated measurements, cut to whole periods: `estimate_frf` of them predicts the measured result."""
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
        """The limits, and the peaks in the simulation."""
        title = Text(
            f"{self.name}: {self.lines.size} lines {Quantity(self.frequency[0], 'Hz', bare=True)} .. "
            f"{Quantity(self.frequency[-1], 'Hz')} on {self.where}, peak {said(self.amplitude, self.unit)}, crest "
            f"factor {Quantity(self.crest):.3f}, {self.periods} periods of "
            f"{Quantity(self.period * self.sample_time, 's'):SI}, {len(self.drawings)} realisation(s)"
        )
        return Table(title, ["in the simulation", "got", "limit", ""], [limit.cells() for limit in self.limits])


def limits(
    loop: Loop, drawings: list[Drawing], travel: float | None, speed: float | None, force: float | None
) -> list[Limit]:
    """Peaks over all realizations against the requested limits, or those of guard, control and motor."""
    guard, motor = loop.control.guard, loop.axis.actuator.motor
    peak, continuous = (None, None) if motor is None else motor.limits()
    if force is None:
        stated = [float(each) for each in (loop.control.force_limit, peak) if each is not None]
        force = min(stated) if stated else None
    if guard is not None:
        speed = guard.velocity_limit if speed is None else speed
        if travel is None and guard.travel_least is not None and guard.travel_most is not None:
            travel = guard.travel_most - guard.travel_least
    forces = [drawn.signals["force"] for drawn in drawings]
    speeds = [np.abs(drawn.signals[name]) for drawn in drawings for name in ("velocity_load", "velocity_motor")]
    stroke = max(float(np.ptp(drawn.signals["reading_load"])) for drawn in drawings)
    rms = max(float(np.sqrt(np.mean(each**2))) for each in forces)
    return [
        Limit("travel", stroke, travel, "m"),
        Limit("speed, peak", max(float(np.max(each)) for each in speeds), speed, "m/s"),
        Limit("force, peak", max(float(np.max(np.abs(each))) for each in forces), force, "N"),
        Limit("force, RMS", rms, None if continuous is None else float(continuous), "N"),
    ]


def _worst(found: Excitation) -> tuple[Limit, float]:
    """The limit that is exceeded most, and by what factor."""
    shares = {limit: limit.got / limit.most if limit.most else np.inf for limit in found.limits if not limit.holds}
    worst = max(shares, key=lambda limit: shares[limit])
    return worst, shares[worst]


def broken(found: Excitation) -> str:
    """The limit that is exceeded most, as the beginning of a sentence."""
    worst, share = _worst(found)
    assert worst.most is not None
    got, may = said(worst.got, worst.unit), said(worst.most, worst.unit)
    text = Text(f"{worst.what} reaches {got} in the simulation, the limit is {may}")
    if not np.isfinite(share):
        return text
    return (
        Text(f"{text}, {Quantity((share - 1.0), 'share'):3} too much")
        if share < 3.0
        else Text(f"{text}, {Quantity(share):3} times as much")
    )


def advice(found: Excitation, drawn: Callable[[float], Excitation]) -> str:
    """An amplitude that was simulated and keeps all limits, or what else to change."""
    other = ""
    worst, share = _worst(found)
    if worst.what == "travel" and found.offset_velocity:
        fitting = int(found.periods / share)
        other = f"{fitting} periods" if fitting >= 2 else "a smaller offset velocity"
    tried = found
    for _ in range(_TRIALS):
        _, share = _worst(tried)
        if share > _HOPELESS:
            break
        tried = drawn(0.98 * tried.amplitude / share)
        if all(limit.holds for limit in tried.limits):
            keeps = Text(f"an amplitude of {said(tried.amplitude, found.unit)} keeps it")
            return Text(f"{keeps}, or {other}") if other else keeps
    return f"take {other}" if other else "no amplitude keeps it; check the underlying motion and the limits"
