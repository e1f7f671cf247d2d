"""Viscous friction alone."""

from typing import Any

from feeddrive.blocks.families import Friction, Nothing
from feeddrive.language.block import Number, parameter


class Viscous(Friction):
    """F = -viscous · v, computed exactly by the linear core.

    Use it for an air guideway and for linear studies.  Do not use it where the axis reverses or stands still; without a
    dry part it has no reversal error and never sticks.
    """

    viscous: Number = parameter("N s/m", "viscous friction", least=0)

    def start(self, velocity: Number = 0.0) -> Nothing:
        return Nothing()

    def linear(self) -> Number:
        """Return the viscous coefficient, N s/m: all of this friction is in the linear core."""
        return self.viscous

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Return no force beyond that of the linear core; the body is never stuck."""
        return state, 0.0, False

    def steady(self, velocity: Number) -> Number:
        """Return viscous · v."""
        return self.viscous * velocity
