"""A rotary motor that drives a screw, described by data-sheet values."""

from typing import ClassVar

from feeddrive.blocks.families import Motor
from feeddrive.blocks.plant.transmission import radians_per_metre
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter


class Screw(Motor):
    """A rotary motor that drives a screw: current gives torque, and torque gives force at the table.

        force = torque_constant · gear · (2π / lead) · current
        speed = rated_speed · lead / gear

    The drive's command is a current in A.  Losses of gear and screw are friction and belong to the friction blocks.
    """

    unit: ClassVar[str] = "A"
    torque_constant: Number = parameter("N m/A", "torque per current (both peak, or both RMS)", above=0)
    lead: Number = parameter("m", "table motion in one turn of the screw", above=0)
    gear: Number = parameter("", "turns of the motor in one turn of the screw", above=0, default=1)
    peak_current: Number | None = parameter("A", "largest current", above=0, default=None)
    continuous_current: Number | None = parameter("A", "largest RMS current over a long time", above=0, default=None)
    rated_speed: Number | None = parameter("rpm", "largest speed of the motor", above=0, default=None)

    def force_per_unit(self) -> Number:
        """Return the force at the table per ampere, N/A."""
        return self.torque_constant * self.gear * radians_per_metre(self.lead)

    def limits(self) -> tuple[Number | None, Number | None]:
        """Return the peak force and the continuous (RMS) force at the table in N; None for an unspecified limit."""
        peak, continuous = self.peak_current, self.continuous_current
        constant = self.force_per_unit()
        return None if peak is None else constant * peak, None if continuous is None else constant * continuous

    def velocity_limit(self) -> Number | None:
        """Return the table speed at the motor's rated speed, m/s; None if the latter is not specified."""
        if self.rated_speed is None:
            return None
        # π/30: data sheets state rpm
        return self.rated_speed * (ops.pi / 30.0) / (self.gear * radians_per_metre(self.lead))
