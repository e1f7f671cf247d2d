"""Force ripple of a motor."""

from typing import Any

from feeddrive.blocks.families import Force, Plant
from feeddrive.blocks.force.harmonic import Harmonic, total
from feeddrive.blocks.signals import Motion
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import StructureError


class Ripple(Force):
    """Variation of the force constant with position: part of the drive force depends on the position.

        F = drive · Σ shareᵢ sin(2π orderᵢ x_motor / period + phaseᵢ)

    `drive` is the mean of the drive force over the substep.
    Source: Otten, de Vries, van Amerongen, Rankers & Gaal 1997 (force ripple in addition to cogging).
    """

    period: Number = parameter("m", "table motion after which the ripple repeats", above=0)
    harmonics: tuple[Harmonic, ...] = part("harmonics of the period; their shares are of the drive force")

    def check(self) -> None:
        """Raise StructureError unless there is at least one harmonic."""
        if not self.harmonics:
            raise StructureError("ripple.harmonics is empty: give at least one harmonic, or leave ripple out")

    def step(
        self, state: Any, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Any, Number, Number]:
        return state, drive * total(self.harmonics, motion.position_motor, self.period), 0.0
