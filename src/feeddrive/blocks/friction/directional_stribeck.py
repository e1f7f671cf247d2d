"""Stribeck friction with different values for the two directions."""

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Friction, Nothing
from feeddrive.blocks.friction.curve import levels, stribeck_level
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter


class DirectionalStribeck(Friction):
    """Set-valued friction with a separate Stribeck curve for each direction.

        F ∈ -level(v) · Sgn(v) - viscous · v
        level(v) = coulomb± + (breakaway± - coulomb±) e^-|v / stribeck_velocity|^exponent,  + for v > 0, - for v < 0
        at rest F lies between -breakaway_positive and +breakaway_negative

    Both levels are evaluated at the velocity in the middle of the substep, predicted by a first solution with the
    breakaway levels.
    Source of the curve: Armstrong-Hélouvry, Dupont & Canudas de Wit 1994.
    """

    coulomb_positive: Number = parameter("N", "level at speed for v > 0", least=0)
    coulomb_negative: Number = parameter("N", "level at speed for v < 0", least=0)
    breakaway_positive: Number = parameter("N", "level at standstill towards v > 0", least=0)
    breakaway_negative: Number = parameter("N", "level at standstill towards v < 0", least=0)
    stribeck_velocity: Number = parameter("m/s", "velocity at which the extra level has fallen to 1/e", above=0)
    viscous: Number = parameter("N s/m", "viscous part", least=0, default=0)
    exponent: int = choice("2: Gaussian curve, 1: exponential curve (Tustin)", options=(1, 2), default=2)

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the breakaway levels are not below the Coulomb levels."""
        for way, coulomb, breakaway in (
            ("positive", self.coulomb_positive, self.breakaway_positive),
            ("negative", self.coulomb_negative, self.breakaway_negative),
        ):
            yield from levels(self.kind, f"coulomb_{way}", coulomb, f"breakaway_{way}", breakaway)

    def start(self, velocity: Number = 0.0) -> Nothing:
        return Nothing()

    def linear(self) -> Number:
        return self.viscous

    def levels(self, velocity: Number) -> tuple[Number, Number]:
        """Return the friction levels in N at the speed |v|, for positive and for negative motion."""
        v = self.stribeck_velocity
        return (
            stribeck_level(velocity, self.coulomb_positive, self.breakaway_positive, v, self.exponent),
            stribeck_level(velocity, self.coulomb_negative, self.breakaway_negative, v, self.exponent),
        )

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Compute F = clip(-v_free / mobility, -positive level, negative level)."""
        stopping = -free_velocity / mobility
        guess = free_velocity + mobility * ops.clip(stopping, -self.breakaway_positive, self.breakaway_negative)
        positive, negative = self.levels(0.5 * (velocity + guess))
        stuck = ops.both(stopping >= -positive, stopping <= negative)
        return state, ops.clip(stopping, -positive, negative), stuck

    def steady(self, velocity: Number) -> Number:
        """Return level(v) · sign(v) + viscous · v."""
        positive, negative = self.levels(velocity)
        dry = ops.where(velocity > 0.0, positive, ops.where(velocity < 0.0, -negative, 0.0))
        return dry + self.viscous * velocity
