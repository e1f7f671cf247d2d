"""One structural mode."""

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter


class Mode(Block):
    """One structural mode η, scaled by its modal mass, with its shape at both ends of the axis.

        mass (η'' + 2 damping_ratio ω η' + ω² η) = motor f_motor + load f_load,      ω = 2π frequency
        it adds motor · η to the position of the motor's body and load · η to that of the load's

    If only the response of the load to the motor's force is known, set motor = 1 and load = ±1.
    """

    frequency: Number = parameter("Hz", "undamped natural frequency", above=0)
    damping_ratio: Number = parameter("", "damping ratio", least=0, default=0.02)
    mass: Number = parameter("kg", "modal mass", above=0)
    motor: Number = parameter("", "mode shape at the motor's body", default=1)
    load: Number = parameter("", "mode shape at the load's body", default=1)

    def stiffness(self) -> Number:
        """Return the stiffness mass ω², N/m."""
        omega = 2.0 * ops.pi * self.frequency
        return self.mass * omega * omega

    def damping(self) -> Number:
        """Return the damping 2 damping_ratio mass ω, N s/m."""
        return 4.0 * ops.pi * self.frequency * self.damping_ratio * self.mass
