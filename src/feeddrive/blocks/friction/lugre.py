"""The LuGre model: friction from the deflection of bristles, with presliding and hysteresis."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from feeddrive.blocks.families import Friction
from feeddrive.blocks.friction.curve import levels, stribeck_level
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, parameter


class Lugre(Friction):
    """LuGre friction with the bristle deflection z as its state.

        z' = v - bristle_stiffness |v| z / level(v),      level(v) = coulomb + (breakaway - coulomb) e^-(v/v_s)²
        F  = -bristle_stiffness z - bristle_damping z' - viscous v

    Over a substep h both z and v are evaluated at its end (backward Euler, stable for any stiffness), but the level is
    evaluated at the velocity in its middle.  With w = |v| the two equations reduce to one quadratic equation in w,
    which is solved in closed form:

        a = h bristle_stiffness / level,   A = mobility (bristle_stiffness + bristle_damping / h)
        B = v_free + mobility bristle_damping z / h,   s = sign(B - A z)
        a w² + (1 + A h - s a B) w = |B - A z|,   v = s w

    The method is of first order: a substep should not be longer than a fifth of √(mass / bristle_stiffness), otherwise
    the presliding oscillation is damped too much.  Do not use it if presliding does not matter: `Stribeck` needs less
    computation and has an exact standstill, while an axis with LuGre creeps under oscillating forces below breakaway.
    Source: Canudas de Wit, Olsson, Åström & Lischinsky 1995, eqs. (1) to (4).
    """

    coulomb: Number = parameter("N", "level at speed", above=0)
    breakaway: Number = parameter("N", "level at standstill", above=0)
    stribeck_velocity: Number = parameter("m/s", "velocity at which the extra level has fallen to 1/e", above=0)
    bristle_stiffness: Number = parameter("N/m", "stiffness in presliding, σ0", above=0)
    bristle_damping: Number = parameter("N s/m", "damping in presliding, σ1", least=0, default=0)
    viscous: Number = parameter("N s/m", "viscous part, σ2", least=0, default=0)

    class State(NamedTuple):
        """The deflection of the bristles, m."""

        deflection: Number

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rule that the breakaway level is not below the Coulomb level."""
        yield from levels(self.kind, "coulomb", self.coulomb, "breakaway", self.breakaway)

    def start(self, velocity: Number = 0.0) -> State:
        """Return the state with undeflected bristles, whatever the velocity."""
        return self.State(0.0)

    def linear(self) -> Number:
        return self.viscous

    def level(self, velocity: Number) -> Number:
        """Return the value of the Stribeck curve, in N, at a velocity in m/s."""
        return stribeck_level(velocity, self.coulomb, self.breakaway, self.stribeck_velocity)

    def contact(
        self, step: Number, state: Any, velocity: Number, free_velocity: Number, mobility: Number
    ) -> tuple[State, Number, Any]:
        """Solve the equations in the class docstring, first with the level at the initial, then at the middle velocity.

        The body is never stuck.
        """
        guess, _ = self._solve(step, state.deflection, self.level(velocity), free_velocity, mobility)
        level = self.level(0.5 * (velocity + guess))
        _, deflection = self._solve(step, state.deflection, level, free_velocity, mobility)
        rate = (deflection - state.deflection) / step
        return self.State(deflection), -(self.bristle_stiffness * deflection + self.bristle_damping * rate), False

    def _solve(
        self, h: Number, z: Number, level: Number, free_velocity: Number, mobility: Number
    ) -> tuple[Number, Number]:
        """Return the velocity and deflection at the end of the substep for a given level."""
        a = h * self.bristle_stiffness / level
        A = mobility * (self.bristle_stiffness + self.bristle_damping / h)
        B = free_velocity + mobility * self.bristle_damping * z / h
        pull = B - A * z
        # not `sign`: at 0 it would make the velocity 0 for any B
        s = ops.where(pull < 0.0, -1.0, 1.0)
        b = 1.0 + A * h - s * a * B
        root = ops.sqrt(b * b + 4.0 * a * ops.absolute(pull))
        # the positive root in the form without cancellation for either sign of b
        falling = b > 0.0
        w = ops.where(falling, 2.0 * ops.absolute(pull) / ops.where(falling, b + root, 1.0), (root - b) / (2.0 * a))
        return s * w, (z + h * s * w) / (1.0 + a * w)

    def steady(self, velocity: Number) -> Number:
        """Return level(v) · sign(v) + viscous · v."""
        return self.level(velocity) * ops.sign(velocity) + self.viscous * velocity
