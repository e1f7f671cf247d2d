"""Friction with a smooth sign function, for gradients and for comparison with papers that use one."""

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Friction, Nothing
from feeddrive.blocks.friction.curve import check_pair, levels, stribeck_level
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, parameter

# With the start below, the third step leaves an error below rounding for mobility · level / transition_velocity
# from 1e-4 to 1e7; Newton's method needs eight steps for the same.
_STEPS = 3


class Regularised(Friction):
    """Coulomb or Stribeck friction with tanh in place of the sign function.

        F = -level(v) tanh(v / transition_velocity) - viscous · v
        level(v) = coulomb + (breakaway - coulomb) e^-(v / stribeck_velocity)²,    coulomb_negative for v < 0 if given

    The force over a substep is consistent with the velocity at its end, as with set-valued friction, so a steep
    tanh is stable. The equation u + c tanh u = |v_free| / transition_velocity with c = mobility level /
    transition_velocity has one root u = |v| / transition_velocity, found by a fixed number of Halley steps; F is then
    smooth in all parameters.

    Do not use it as a model of an axis at rest: it creeps under any force, and a substep in which the velocity
    crosses zero is inaccurate.
    Source: common practice in simulations; see `Stribeck` for the curve.
    """

    coulomb: Number = parameter("N", "level at speed", least=0)
    transition_velocity: Number = parameter("m/s", "velocity scale of the tanh", above=0)
    coulomb_negative: Number | None = parameter(
        "N", "level at speed for v < 0; absent if the same", least=0, default=None
    )
    breakaway: Number | None = parameter(
        "N", "level towards standstill; absent without Stribeck curve", least=0, default=None
    )
    stribeck_velocity: Number | None = parameter(
        "m/s", "velocity at which the extra level has fallen to 1/e", above=0, default=None
    )
    viscous: Number = parameter("N s/m", "viscous part", least=0, default=0)

    def check(self) -> None:
        """Raise ParameterError if only one parameter of the Stribeck curve is specified."""
        check_pair(self.kind, "breakaway", self.breakaway, "stribeck_velocity", self.stribeck_velocity)

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the breakaway level is not below the Coulomb levels."""
        yield from levels(self.kind, "coulomb", self.coulomb, "breakaway", self.breakaway)
        yield from levels(self.kind, "coulomb_negative", self.coulomb_negative, "breakaway", self.breakaway)

    def start(self, velocity: Number = 0.0) -> Nothing:
        return Nothing()

    def linear(self) -> Number:
        return self.viscous

    def _coulomb(self, direction: Number) -> Number:
        if self.coulomb_negative is None:
            return self.coulomb
        return ops.where(direction < 0.0, self.coulomb_negative, self.coulomb)

    def _level(self, direction: Number, velocity: Number) -> Number:
        coulomb = self._coulomb(direction)
        if self.breakaway is None or self.stribeck_velocity is None:
            return coulomb
        return stribeck_level(velocity, coulomb, self.breakaway, self.stribeck_velocity)

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Any, Number, Any]:
        """Compute the force with the friction level evaluated at the mid-substep velocity; the body never sticks."""
        if self.breakaway is None:
            level = self._coulomb(free_velocity)
        else:
            guess = free_velocity + mobility * self._force(self.breakaway, free_velocity, mobility)
            level = self._level(free_velocity, 0.5 * (velocity + guess))
        return state, self._force(level, free_velocity, mobility), False

    def _force(self, level: Number, free_velocity: Number, mobility: Number) -> Number:
        """Return the root F of F = -level tanh(v / transition_velocity) with v = v_free + mobility F."""
        c = mobility * level / self.transition_velocity
        s = ops.absolute(free_velocity) / self.transition_velocity
        # three estimates, each good in one range: both terms linear, tanh = 1, and u small against c tanh u
        ratio = s / (1.0 + c)
        held = ops.minimum(ratio, 1.0 - 1.0 / (2.0 + c))
        u = ops.maximum(ops.maximum(s - c, ratio), 0.5 * ops.log((1.0 + held) / (1.0 - held)))
        for _ in range(_STEPS):
            t = ops.tanh(u)
            fall = 1.0 - t * t
            residual = u + c * t - s
            slope = 1.0 + c * fall
            u = u - residual * slope / (slope * slope + residual * c * t * fall)
        force = level * ops.tanh(u)
        return ops.where(free_velocity < 0.0, force, -force)

    def steady(self, velocity: Number) -> Number:
        """Return level(v) tanh(v / transition_velocity) + viscous · v."""
        smooth = ops.tanh(velocity / self.transition_velocity)
        return self._level(velocity, velocity) * smooth + self.viscous * velocity
