"""Coulomb friction with exact standstill."""

from typing import Any

from feeddrive.blocks.families import Friction, Nothing
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter


class Coulomb(Friction):
    """Coulomb and viscous friction.

        F ∈ -coulomb · Sgn(v) - viscous · v,      Sgn(0) = [-1, 1]

    The force over a substep is consistent with the velocity at its end (Moreau 1988, eq. of the implicit step):
    F = clip(-v_free / mobility, ±coulomb); the body sticks as long as the force is not clipped.
    """

    coulomb: Number = parameter("N", "level of the friction force", least=0)
    viscous: Number = parameter("N s/m", "viscous part", least=0, default=0)

    def start(self, velocity: Number = 0.0) -> Nothing:
        return Nothing()

    def linear(self) -> Number:
        return self.viscous

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Compute F = clip(-v_free / mobility, ±coulomb)."""
        stopping = -free_velocity / mobility
        # <=: a force at exactly the level still brings the velocity to 0
        return state, ops.clip(stopping, -self.coulomb, self.coulomb), ops.absolute(stopping) <= self.coulomb

    def steady(self, velocity: Number) -> Number:
        """Return coulomb · sign(v) + viscous · v."""
        return self.coulomb * ops.sign(velocity) + self.viscous * velocity
