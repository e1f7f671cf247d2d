"""A motor described by one force constant: a linear motor, or a complete drive train identified as a whole."""

from typing import ClassVar

from feeddrive.blocks.families import Motor
from feeddrive.language.block import Number, parameter


class Direct(Motor):
    """A motor or complete drive train with force = force_constant · command."""

    unit: ClassVar[str] = "A or V"
    force_constant: Number = parameter("N", "force at the table per unit of the drive's command (A or V)", above=0)
    peak_force: Number | None = parameter("N", "largest force", above=0, default=None)
    continuous_force: Number | None = parameter("N", "largest RMS force over a long time", above=0, default=None)
    peak_velocity: Number | None = parameter("m/s", "largest speed", above=0, default=None)

    def force_per_unit(self) -> Number:
        return self.force_constant

    def limits(self) -> tuple[Number | None, Number | None]:
        """Return the peak force and the continuous (RMS) force in N; None for a limit that is not specified."""
        return self.peak_force, self.continuous_force

    def velocity_limit(self) -> Number | None:
        """Return the largest speed in m/s; None if it is not specified."""
        return self.peak_velocity
