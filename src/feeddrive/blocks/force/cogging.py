"""Cogging force of a motor."""

from typing import Any

from feeddrive.blocks.families import Force, Plant
from feeddrive.blocks.force.harmonic import Harmonic, total
from feeddrive.blocks.signals import Motion
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import StructureError


class Cogging(Force):
    """A position-dependent force between the iron and the magnets of a motor, present even without current.

        F = force · Σ shareᵢ sin(2π orderᵢ x_motor / period + phaseᵢ)

    For a linear motor `period` is the length of a pole pair, for a rotary one the lead divided by the number of pole
    pairs and the gear ratio.
    Source: the Fourier series that is used for permanent-magnet linear motors, Otten, de Vries, van Amerongen, Rankers
    & Gaal 1997.
    """

    force: Number = parameter("N", "the force to which the shares of the harmonics refer", least=0)
    period: Number = parameter("m", "table motion after which the force repeats", above=0)
    harmonics: tuple[Harmonic, ...] = part("harmonics of the period", default=(Harmonic(order=1, share=1.0),))

    def check(self) -> None:
        """Raise StructureError unless there is at least one harmonic."""
        if not self.harmonics:
            raise StructureError("cogging.harmonics is empty: give at least one harmonic, or leave cogging out")

    def step(
        self, state: Any, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Any, Number, Number]:
        return state, self.at(motion.position_motor), 0.0

    def at(self, position: Any) -> Any:
        """Return the force at a position of the motor, N; also for an array of positions."""
        return self.force * total(self.harmonics, position, self.period)
