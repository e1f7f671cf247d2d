"""Increments and thousandths of the rated torque into m and N at the table, and back."""

from __future__ import annotations

import math

from feeddrive.language.block import Block, Number, parameter
from feeddrive.language.errors import ParameterError


def interpolation_time(cycle_time: float) -> tuple[int, int]:
    """Object 0x60C2 for a bus cycle in s: value and power of ten; the nearest that its eight bits hold."""
    found = [(round(cycle_time / 10.0**power), power) for power in range(-6, 1)]
    fitting = [(value, power) for value, power in found if 0 < value <= 255]
    return min(fitting, key=lambda each: (round(abs(each[0] * 10.0 ** each[1] / cycle_time - 1.0), 6), each[1]))


class DriveScaling(Block):
    """What one increment and one thousandth of the rated torque are at the table.

        increment = lead / (gear · counts_per_turn)                       of a motor that turns
        force     = torque_per_mille / 1000 · rated_torque · gear · 2π / lead

    A linear motor is given by `increment` and `rated_force` in place of the other five.  Raises ParameterError for a
    description that is neither.
    """

    increment: Number | None = parameter("m", "length of one increment at the table", above=0, default=None)
    rated_force: Number | None = parameter("N", "rated force (linear motor)", above=0, default=None)
    counts_per_turn: Number | None = parameter("", "increments in one turn of the motor", above=0, default=None)
    lead: Number | None = parameter("m", "table motion in one turn of the screw", above=0, default=None)
    gear: Number = parameter("", "turns of the motor in one turn of the screw", above=0, default=1)
    rated_torque: Number | None = parameter("N m", "rated torque of the motor, object 0x6076", above=0, default=None)

    def check(self) -> None:
        """Either of the two descriptions, whole."""
        turning = {"counts_per_turn": self.counts_per_turn, "lead": self.lead, "rated_torque": self.rated_torque}
        linear = {"increment": self.increment, "rated_force": self.rated_force}
        missing = [name for name, value in (turning if self.turns else linear).items() if value is None]
        doubled = self.turns and any(value is not None for value in linear.values())
        if missing or doubled:
            raise ParameterError(
                "scaling needs counts_per_turn, lead and rated_torque of a motor that turns, or increment and "
                "rated_force of a linear motor" + (f"; {', '.join(missing)} is missing" if missing else ", not both")
            )

    @property
    def turns(self) -> bool:
        """Whether the motor turns."""
        return any(value is not None for value in (self.counts_per_turn, self.lead, self.rated_torque))

    @property
    def metre(self) -> float:
        """m at the table per increment."""
        if self.increment is not None:
            return self.increment
        assert self.lead is not None
        assert self.counts_per_turn is not None
        return self.lead / (self.gear * self.counts_per_turn)

    @property
    def newton(self) -> float:
        """N at the table per thousandth of the rated torque."""
        if self.rated_force is not None:
            return 1e-3 * self.rated_force
        assert self.lead is not None
        assert self.rated_torque is not None
        return 1e-3 * self.rated_torque * self.gear * 2.0 * math.pi / self.lead

    @property
    def rated_milli(self) -> int:
        """Object 0x6076: mN m of a motor that turns, mN of a linear one."""
        rated = self.rated_torque if self.rated_force is None else self.rated_force
        assert rated is not None
        return round(1e3 * rated)

    def increments(self, metres: float) -> int:
        """The nearest whole number of increments, also for m/s and m/s²."""
        return round(metres / self.metre)

    def per_mille(self, newtons: float) -> int:
        """The nearest thousandth of the rated torque."""
        return round(newtons / self.newton)
