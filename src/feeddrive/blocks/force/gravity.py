"""A constant force on the load: the weight of a vertical axis, or the force offset of an identified model."""

from typing import Any

from feeddrive.blocks.families import Force, Plant
from feeddrive.blocks.signals import Motion
from feeddrive.language.block import Number, parameter


class Gravity(Force):
    """A constant force on the load's body, F = force; negative if it pulls towards smaller positions.

    For a vertical axis it is -mass · 9.81 m/s², reduced by the force of a counterweight.
    """

    force: Number = parameter("N", "constant force, positive towards larger positions")

    def step(
        self, state: Any, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Any, Number, Number]:
        return state, 0.0, self.force
