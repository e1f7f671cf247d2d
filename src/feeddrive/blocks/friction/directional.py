"""Viscous and Coulomb friction with different values for the two directions."""

from typing import Any

from feeddrive.blocks.families import Friction, Nothing
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter


class Directional(Friction):
    """Coulomb and viscous friction with different values for each direction.

        F ∈ -[coulomb_positive, coulomb_negative](v) · Sgn(v) - [viscous_positive, viscous_negative](v) · v

    The smaller of the two viscous values is part of the linear core and is computed exactly; the additional part of the
    larger one is evaluated at the velocity in the middle of the substep.
    Source: Janot, Gautier & Brunot 2019, section on direction-dependent friction.
    """

    coulomb_positive: Number = parameter("N", "level for v > 0", least=0)
    coulomb_negative: Number = parameter("N", "level for v < 0", least=0)
    viscous_positive: Number = parameter("N s/m", "viscous part for v > 0", least=0, default=0)
    viscous_negative: Number = parameter("N s/m", "viscous part for v < 0", least=0, default=0)

    def start(self, velocity: Number = 0.0) -> Nothing:
        return Nothing()

    def linear(self) -> Number:
        """Return the smaller viscous coefficient, N s/m."""
        # the smaller one, so that the rest in `contact` always opposes the motion
        return ops.minimum(self.viscous_positive, self.viscous_negative)

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Compute F = clip(-v_free / mobility, -upper, lower); the bounds are the levels at the middle velocity."""
        stopping = -free_velocity / mobility
        guess = free_velocity + mobility * ops.clip(stopping, -self.coulomb_positive, self.coulomb_negative)
        middle = 0.5 * (velocity + guess)
        linear = self.linear()
        upper = self.coulomb_positive + (self.viscous_positive - linear) * ops.maximum(middle, 0.0)
        lower = self.coulomb_negative + (self.viscous_negative - linear) * ops.maximum(-middle, 0.0)
        stuck = ops.both(stopping >= -upper, stopping <= lower)
        return state, ops.clip(stopping, -upper, lower), stuck

    def steady(self, velocity: Number) -> Number:
        """Return the friction force in N at a constant velocity, from the values for the direction of motion."""
        forward = self.coulomb_positive + self.viscous_positive * velocity
        backward = -self.coulomb_negative + self.viscous_negative * velocity
        return ops.where(velocity > 0.0, forward, ops.where(velocity < 0.0, backward, 0.0))
