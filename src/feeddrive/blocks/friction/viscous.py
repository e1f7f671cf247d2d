"""Viscous friction alone."""

from typing import Any

from feeddrive.blocks.families import Friction, Nothing
from feeddrive.language.block import Number, parameter


class Viscous(Friction):
    """Viscous friction, F = -viscous · v, computed exactly by the linear core.

    Use it for an air guideway and for linear studies.  Do not use it where the axis reverses or stands still; without
    dry friction an axis shows no reversal error and never sticks.
    """

    viscous: Number = parameter("N s/m", "viscous friction", least=0)

    def start(self, velocity: Number = 0.0) -> Nothing:
        return Nothing()

    def linear(self) -> Number:
        """Return the viscous coefficient, N s/m; the linear core applies all of this friction."""
        return self.viscous

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Return a force of zero, since the linear core applies all of this friction; the body never sticks."""
        return state, 0.0, False

    def steady(self, velocity: Number) -> Number:
        """Return viscous · v."""
        return self.viscous * velocity
