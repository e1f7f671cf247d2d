"""`feeddrive force`: convert the signal that a drive logs or receives (percent, A, V, `pid.output`) to N or N m.

torque = signal · (rated torque / 100 | torque constant | value at full output / full output)
force  = torque / r,   r = lead / (2π gear)
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path

from feeddrive.files.atomic_io import write_whole
from feeddrive.files.columns import unit_of
from feeddrive.identification.regression import lever
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import UNIT, Result, Table
from feeddrive.language.text import Text
from feeddrive.workflow.command import Outcome, Request, argument, command, option

SIGNALS = ("percent", "per-mille", "A", "V", "pid.output", "N m", "N")


class DriveValues(Request):
    """Values of motor and drive that convert a signal in percent, A, V or pid.output to a force or a torque.

    They are options of every command that reads a log, so that the rated value can be given where a column requires it.
    """

    rated: str | None = option(
        "what 100 % is, as 3.2:Nm, 850:N or, of a current, 5.6:A: for columns in percent", default=None, last=True
    )
    torque_constant: float | None = option(
        "torque constant of the motor, for each A that is logged", unit="N m/A", above=0.0, default=None, last=True
    )
    motor_constant: float | None = option(
        "force constant of a linear motor, for each A that is logged", unit="N/A", above=0.0, default=None, last=True
    )
    amplitude: bool = option(
        "the log has the amplitude of the current, and the constant is for A RMS", default=False, last=True
    )
    full: float = option(
        "the command at full output: 10 for ±10 V, pwmgen.scale for pid.output", above=0.0, default=10.0, last=True
    )
    at_full: str | None = option(
        "output of the drive at full command, as 12:A, 9.6:Nm, 300:percent or 2500:N", default=None, last=True
    )

    def check(self) -> None:
        """Raise ParameterError for mutually exclusive constants."""
        if self.torque_constant is not None and self.motor_constant is not None:
            raise ParameterError("--torque-constant is of a rotary motor, --motor-constant of a linear one: give one")

    def drive_values(self) -> DriveValues:
        """Return only these values, without the other options of a request."""
        return DriveValues(**{name: getattr(self, name) for name in _VALUES})

    @property
    def any_given(self) -> bool:
        """True if a value that converts a signal was given."""
        return any(value is not None for value in (self.rated, self.torque_constant, self.motor_constant, self.at_full))


_VALUES = ("rated", "torque_constant", "motor_constant", "amplitude", "full", "at_full")


class ForceRequest(DriveValues):
    """The signal and its unit, and the data of motor, drive and screw."""

    signal: str = argument(f"What the column is in: {', '.join(SIGNALS[:-1])} or {SIGNALS[-1]}")
    column: str = option("name of the column in the log", default="signal")
    lead: float | None = option("lead of the screw, for a force at the table", unit="m", above=0.0, default=None)
    gear: float = option("turns of the motor in one turn of the screw", default=1.0, above=0.0)
    inverted: bool = option("a positive signal pushes towards smaller positions", default=False)
    out: Path | None = option("File for the lines (TOML), as --channels takes it", short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for an unknown signal, and for mutually exclusive constants."""
        if self.signal not in SIGNALS:
            raise ParameterError(f"signal = '{self.signal}' must be one of {', '.join(SIGNALS)}")
        super().check()


@dataclass(frozen=True, eq=False, repr=False)
class ForceScale(Result):
    """The conversion factor from a column to the force at the table in N, or the torque at the motor in N m.

    steps   the chain of conversions: for each, its name and the value and unit that a signal of 1 becomes
    """

    column: str
    role: str
    unit: str
    factor: float
    steps: tuple[tuple[str, float, str], ...]

    def table(self) -> Table:
        rows = [[what, Quantity(value, unit, form="6 SI"), UNIT] for what, value, unit in self.steps]
        title = f"1 of '{self.column}' is {Quantity(self.factor, self.unit):6}"
        return Table(title, ["step", "for 1 of the signal", "unit"], rows)

    def line(self) -> str:
        """Return the line for a --channels file."""
        # a JSON string is also a basic string of TOML
        return f"{self.role} = {{ column = {json.dumps(self.column, ensure_ascii=False)}, factor = {self.factor!r} }}"

    def option(self) -> str:
        """Return the equivalent option of the command line."""
        return f"--{self.role} '{self.column}*{self.factor!r}'"


@command(ForceRequest)
def force(request: ForceRequest, progress: Progress) -> Outcome[ForceScale]:
    """Compute, from data-sheet values, the factor that converts percent, A, V or pid.output to N or N m.

    The outcome states the factor in the form in which --channels accepts it.

    Raises ParameterError, which names the option, if a value is missing.
    """
    progress.step("computing")
    result = scale(request)
    section = f"[log.channels]\n{result.line()}\n"
    remarks = _remarks(request, result)
    files: dict[str, str | Path] = {}
    if request.out is not None:
        write_whole(request.out, section)
        files["Written"] = request.out
    verdict = f"On the command line: {result.option()}"
    return Outcome(result, [result.table()], remarks, verdict, section=section, files=files)


def scale(request: ForceRequest) -> ForceScale:
    """Return the conversion factors from the signal's unit to N or N m. Raise ParameterError for missing data."""
    return scale_of(request.signal, request.column, request, request.lead, request.gear, inverted=request.inverted)


def scale_of(
    signal: str,
    column: str,
    values: DriveValues,
    lead: float | None = None,
    gear: float = 1.0,
    *,
    inverted: bool = False,
) -> ForceScale:
    """Return the conversion factors from the signal in a column to N or, without a lead, to N m.

    signal  one of `SIGNALS`, or permille

    Raises ParameterError, which names the option, if a value is missing.
    """
    signal = "per-mille" if signal == "permille" else signal
    steps: list[tuple[str, float, str]] = []
    value, unit = 1.0, signal
    if unit in ("percent", "per-mille"):
        parts = 100.0 if unit == "percent" else 1000.0
        rated, unit = _size("--rated", values.rated, f"what 100 % is ('{signal}' of what?)")
        value = rated / parts
        steps.append((Text(f"rated {Quantity(rated, unit):6} / {number(parts)}"), value, unit))
    elif unit in ("V", "pid.output"):
        full = f"{number(values.full, 6)} {signal}"
        most, unit = _size("--at-full", values.at_full, f"what the drive gives at {full}")
        value = most / values.full
        steps.append((Text(f"{Quantity(most, unit):6} at {full}"), value, unit))
        if unit == "percent":
            rated, unit = _size("--rated", values.rated, "what 100 % is")
            value *= rated / 100.0
            steps.append((Text(f"rated {Quantity(rated, unit):6} / 100"), value, unit))
    if unit == "A":
        constant, of = values.torque_constant or values.motor_constant, "N m" if values.torque_constant else "N"
        if constant is None:
            raise ParameterError(
                "a current needs the constant of the motor: --torque-constant (N m/A), or --motor-constant (N/A) of a "
                "linear motor"
            )
        if values.amplitude:
            value /= math.sqrt(2.0)
            steps.append(("amplitude / √2 is RMS", value, "A"))
        value, unit = value * constant, of
        steps.append((Text(f"constant {Quantity(constant, f'{of}/A', stays=True):6}"), value, unit))
    if unit == "N m" and lead is not None:
        value, unit = value / lever(lead, gear), "N"
        steps.append((Text(f"lead {Quantity(lead, 'm'):6 mm}, gear {number(gear, 6)}"), value, unit))
    elif unit == "N" and lead is not None:
        raise ParameterError("--lead turns a torque into a force, and this is a force already: leave it out")
    if inverted:
        value = -value
        steps.append(("inverted", value, unit))
    steps = steps or [(f"as it is, in {unit}", value, unit)]
    # the factor is pasted into files: `decimal` removes digits that are rounding errors only
    return ForceScale(column, "force" if unit == "N" else "torque", unit, units.decimal(value), tuple(steps))


_SIZE = re.compile(r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*:?\s*(.*)")


def number_with_unit(flag: str, text: str, example: str) -> tuple[float, str]:
    """Parse `3.2:Nm`, `3.2Nm` or `3.2 Nm` into a number > 0 and its unit, which may be empty.

    Raises ParameterError, which shows the example, for any other string.
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise ParameterError(f"{flag} {text}: must be a number and a unit, as {example}")
    value, unit = float(match[1]), unit_of(match[2]) or match[2]
    # a reversed sign is the matter of --inverted alone
    if not (math.isfinite(value) and value > 0.0):
        raise ParameterError(f"{flag} {text}: must be > 0")
    return value, unit


def _size(flag: str, text: str | None, what: str) -> tuple[float, str]:
    """Parse a string such as `3.2:Nm` into a value and its unit: N m, N, A or, for --at-full, percent.

    Raises ParameterError for any other string.
    """
    if text is None:
        raise ParameterError(f"{flag} is missing: {what}; as {flag} {'12:A' if flag == '--at-full' else '3.2:Nm'}")
    value, unit = number_with_unit(flag, text, "3.2:Nm or 850:N")
    for known in ("N m", "N", "A", *(("percent",) if flag == "--at-full" else ())):
        try:
            return value * units.factor(unit, known), known
        except ParameterError:
            continue
    raise ParameterError(f"{flag} {text}: the unit must be one of a torque, a force or a current, as Nm, N or A")


def _remarks(request: ForceRequest, result: ForceScale) -> list[str]:
    """Return remarks on the assumptions behind the factor."""
    remarks: list[str] = []
    if any("constant" in step for step, _, _ in result.steps) and not request.amplitude:
        remarks.append(
            "Constants of catalogues are for A RMS; many drives log the amplitude, √2 times that: --amplitude."
        )
    if result.unit == "N m":
        remarks.append("It is a torque at the motor; --lead of the screw in m makes it a force at the table.")
    if request.signal == "pid.output":
        remarks.append(
            "pid.output is what HAL sends on: it is full where the scale of the output pin (pwmgen, DAC) says."
        )
    remarks.append(
        "Friction and efficiency of the screw are not in it: they belong to the friction that identify finds."
    )
    return remarks
