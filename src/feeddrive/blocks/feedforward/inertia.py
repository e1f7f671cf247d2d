"""Acceleration and velocity feedforward of a rigid axis."""

from typing import Any

from feeddrive.blocks.families import Feedforward
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.block import Number, parameter


class Inertia(Feedforward):
    """The force that a rigid axis needs for the set motion, evaluated in the middle of the sample in which it acts.

    force = mass · a_set(t + T/2) + viscous · v_set(t + T/2)
    """

    feeds = ("acceleration", "velocity")

    mass: Number = parameter("kg", "mass that is fed forward", least=0)
    viscous: Number = parameter("N s/m", "viscous friction that is fed forward", least=0, default=0)

    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Number]:
        middle = setpoint.shifted(0.5 * T)
        return state, self.mass * middle.acceleration + self.viscous * middle.velocity
