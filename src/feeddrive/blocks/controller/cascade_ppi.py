"""The P-PI cascade: what nearly every machine tool runs today."""

from __future__ import annotations

from typing import NamedTuple

from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language.block import Number, choice, parameter


class CascadePPI(Law):
    """P position loop around a PI velocity loop, with velocity feedforward.

        e     = Kv (x_set - x_load) + velocity_feedforward · v_set - v
        force = Kp (e + (1/Tn) Σ T e)
        v     = (x(k) - x(k-n)) / nT  of the velocity encoder,  v_set = (x_set(k) - x_set(k-1)) / T

    The integral follows back-calculation: what the limit cut off in the last sample is taken out of it, one step
    later, through `applied` and `requested`, which equals the in-step form.
    With two encoders position is closed on the load and velocity on the motor.

    When to use: always first; it is the baseline of every comparison.  When not: if the first mode of the axis lies
    within three times the wanted crossover, a law that damps it does better.
    Source: Altintas & Okwudire 2009, section 2 (the cascade), sign and timing as in papers.md 0.2 and 1.4.
    """

    Kv: Number = parameter("1/s", "position gain", above=0)
    Kp: Number = parameter("N s/m", "velocity gain", above=0)
    Tn: Number = parameter(
        "s", "integral time of the velocity loop; absent for a P velocity loop", above=0, default=None
    )
    velocity_feedforward: Number = parameter("", "share of the set velocity that is fed forward", default=1.0, least=0)
    velocity_samples: int = choice("samples over which the velocity is differenced", default=1, least=1)
    velocity_encoder: str = choice("encoder of the velocity loop", options=("motor", "load"), default="motor")

    class State(NamedTuple):
        """Past positions, newest first (m), and the integral (N)."""

        positions: tuple[Number, ...]
        integral: Number

    def start(self, setpoint: Setpoint, reading: Reading) -> State:
        """At rest at the reading, with the integral holding the force that acts."""
        return self.State((self._position(reading),) * self.velocity_samples, reading.applied)

    def _position(self, reading: Reading) -> Number:
        return reading.position_motor if self.velocity_encoder == "motor" else reading.position_load

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """The equations above."""
        position = self._position(reading)
        velocity = (position - state.positions[-1]) / (self.velocity_samples * T)
        wanted = self.Kv * (setpoint.position - reading.position_load)
        wanted = wanted + self.velocity_feedforward * setpoint.backward_velocity(T)
        e = wanted - velocity
        positions = (position, *state.positions[:-1])
        if self.Tn is None:
            return self.State(positions, state.integral), self.Kp * e
        integral = state.integral + (reading.applied - reading.requested)
        integral = integral + (self.Kp * T / self.Tn) * e
        return self.State(positions, integral), self.Kp * e + integral
