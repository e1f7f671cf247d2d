"""Stribeck friction: a breakaway level that falls to the Coulomb level as the axis starts to move."""

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Friction, Nothing
from feeddrive.blocks.friction.curve import levels, stribeck_level
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter


class Stribeck(Friction):
    """Set-valued friction with a Stribeck curve.

        F ∈ -level(v) · Sgn(v) - viscous · v
        level(v) = coulomb + (breakaway - coulomb) e^-|v / stribeck_velocity|^exponent

    The level is evaluated at the velocity in the middle of the substep, predicted by a first solution with the
    breakaway level, so an axis at rest is held exactly up to the breakaway level.  The force is then
    clip(-v_free / mobility, ±level).
    Source of the curve: Armstrong-Hélouvry, Dupont & Canudas de Wit 1994.
    """

    coulomb: Number = parameter("N", "level at speed", least=0)
    breakaway: Number = parameter("N", "level at standstill", least=0)
    stribeck_velocity: Number = parameter("m/s", "velocity at which the extra level has fallen to 1/e", above=0)
    viscous: Number = parameter("N s/m", "viscous part", least=0, default=0)
    exponent: int = choice("2: Gaussian curve, 1: exponential curve (Tustin)", options=(1, 2), default=2)

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rule that the breakaway level is not below the Coulomb level."""
        yield from levels(self.kind, "coulomb", self.coulomb, "breakaway", self.breakaway)

    def start(self, velocity: Number = 0.0) -> Nothing:
        return Nothing()

    def linear(self) -> Number:
        return self.viscous

    def level(self, velocity: Number) -> Number:
        """Return the value of the Stribeck curve, in N, at a velocity in m/s."""
        return stribeck_level(velocity, self.coulomb, self.breakaway, self.stribeck_velocity, self.exponent)

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Compute F = clip(-v_free / mobility, ±level(v_middle))."""
        stopping = -free_velocity / mobility
        guess = free_velocity + mobility * ops.clip(stopping, -self.breakaway, self.breakaway)
        level = self.level(0.5 * (velocity + guess))
        return state, ops.clip(stopping, -level, level), ops.absolute(stopping) <= level

    def steady(self, velocity: Number) -> Number:
        """Return level(v) · sign(v) + viscous · v."""
        return self.level(velocity) * ops.sign(velocity) + self.viscous * velocity
