"""A regenerative cutting force, which depends on the surface left by the previous cut."""

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Force, Plant
from feeddrive.blocks.signals import Motion
from feeddrive.language.block import Number, Rule, choice, parameter
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import History
from feeddrive.language.text import Text


class Regeneration(Force):
    """The cutting force on the load's body, proportional to the chip: the motion since the cut one delay earlier.

        F(t) = -stiffness · (x(t) - x(t - delay))

    x is the actual position in the middle of a substep, interpolated linearly between substeps; the axis is assumed at
    rest before the start.  This is the linear part of the force in turning and facing, and in a slot cut with many
    teeth.
    Do not use it where vibration lifts the tool out of the cut, or with substeps longer than a tenth of the delay.
    Source: Tobias & Fishwick 1958; Altintas 2012, section 4.2.
    """

    stiffness: Number = parameter("N/m", "force per thickness of the chip", least=0)
    delay: Number = parameter("s", "time from one cut of a place to the next", above=0)
    remembered: int = choice("substeps of motion that are stored; they must cover the delay", default=4096, least=2)

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the validity rule: the stored substeps cover the delay."""
        yield Rule(
            # the interpolation reads the two stored positions around the delay
            self.delay / h <= float(self.remembered - 1),
            "the substeps that the regeneration stores are not shorter than its delay",
            lambda: Text(
                f"regeneration.remembered = {self.remembered} substeps of {Quantity(h, 's'):6 SI} are shorter than the "
                f"delay of {Quantity(self.delay, 's'):6 SI}: at least {-int(-(self.delay / h) // 1) + 1}"
            ),
        )

    def start(self, plant: Plant, motion: Motion) -> History:
        """Return the state of an axis that has been at rest."""
        return History.start(self.remembered, motion.position_load)

    def step(
        self, state: History, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[History, Any, Any]:
        state = state.push(motion.position_load)
        return state, 0.0, -(self.stiffness * (motion.position_load - state.ago(self.delay / h)))
