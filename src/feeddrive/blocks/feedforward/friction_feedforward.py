"""Friction feedforward from the set velocity."""

from collections.abc import Iterator
from typing import Any

from feeddrive.blocks.families import Feedforward
from feeddrive.blocks.friction.curve import check_pair, levels, stribeck_level
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, parameter


class FrictionFeedforward(Feedforward):
    """The dry friction expected for the set motion, from its direction and speed in the middle of the sample.

        force = level(v) · sgn(v),   v = v_set(t + T/2)
        level(v) = coulomb± (+ (breakaway - coulomb±) e^-(v / stribeck_velocity)²)
        sgn(v) = tanh(v / smoothing), or ±1 beyond the dead band and 0 within it

    The reading is not used: friction computed from the measured velocity would add the noise and lag of that velocity
    to the force.
    Do not use it with levels that drift (temperature, load), unless they are set a little too small, since
    overcompensation makes the reversal error worse than no compensation.
    Source: Erkorkmaz & Altintas 2001, part III (friction pre-compensation).
    """

    feeds = ("friction",)

    coulomb_positive: Number = parameter("N", "level at speed for v > 0", least=0)
    coulomb_negative: Number = parameter("N", "level at speed for v < 0", least=0)
    breakaway: Number | None = parameter(
        "N", "level towards standstill; absent without Stribeck curve", least=0, default=None
    )
    stribeck_velocity: Number | None = parameter(
        "m/s", "velocity at which the extra level has fallen to 1/e", above=0, default=None
    )
    smoothing: Number | None = parameter(
        "m/s", "velocity scale of a smooth sign; absent for a dead band", above=0, default=None
    )
    dead_band: Number = parameter("m/s", "speed below which the axis counts as at rest", least=0, default=1e-9)

    def check(self) -> None:
        """Raise ParameterError if only one parameter of the Stribeck curve is specified."""
        check_pair(self.kind, "breakaway", self.breakaway, "stribeck_velocity", self.stribeck_velocity)

    def rules(self) -> Iterator[Rule]:
        """Yield the validity rules: the breakaway level is not below the Coulomb levels."""
        yield from levels(self.kind, "coulomb_positive", self.coulomb_positive, "breakaway", self.breakaway)
        yield from levels(self.kind, "coulomb_negative", self.coulomb_negative, "breakaway", self.breakaway)

    def step(self, state: Any, setpoint: Setpoint, T: Number) -> tuple[Any, Number]:
        v = setpoint.shifted(0.5 * T).velocity
        level = ops.where(v < 0.0, self.coulomb_negative, self.coulomb_positive)
        if self.breakaway is not None and self.stribeck_velocity is not None:
            level = stribeck_level(v, level, self.breakaway, self.stribeck_velocity)
        if self.smoothing is not None:
            return state, level * ops.tanh(v / self.smoothing)
        return state, ops.where(v > self.dead_band, level, ops.where(v < -self.dead_band, -level, 0.0))
