"""A force pulse after each reversal to reduce the quadrant glitch."""

from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import Feedforward
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter


class ReversalPulse(Feedforward):
    """A pulse that begins where the set velocity changes its sign and decays exponentially.

        F = s · force · e^(-t / decay_time),   s = sign of the new set velocity, t = time since the reversal

    The pulse helps the drive through presliding, where the feedforward of a constant Coulomb force acts too late.  The
    set velocity is evaluated in the middle of the sample; a standstill between two moves in the same direction is not a
    reversal.
    Do not use it with a friction feedforward that was learned on reversals and thus contains the pulse.
    Source: the amplitude-adaptive quadrant compensation of CNC controls; Erkorkmaz & Altintas 2001, section 5.
    """

    force: Number = parameter("N", "height of the pulse", least=0)
    decay_time: Number = parameter("s", "time after which it has fallen to 1/e", above=0)

    class State(NamedTuple):
        """The last direction of motion (-1 or 1; 0 before the first motion) and the force (N) of the last sample."""

        direction: Number
        level: Number

    def start(self, setpoint: Setpoint) -> State:
        """Return the state for motion at the set velocity, long after a reversal."""
        return self.State(ops.sign(setpoint.velocity), ops.zero(setpoint.velocity))

    def step(self, state: State, setpoint: Setpoint, T: Number) -> tuple[State, Any]:
        direction = ops.sign(setpoint.shifted(0.5 * T).velocity)
        reversed_now = direction * state.direction < 0.0
        level = ops.where(reversed_now, direction * self.force, state.level * ops.exp(-(T / self.decay_time)))
        # standstill keeps the direction: two moves in one direction with a dwell between them are no reversal
        direction = ops.where(ops.equal(direction, 0.0), state.direction, direction)
        return self.State(direction, level), level

    def retune(self, state: State, old: Self) -> State:
        """Return the state unchanged: a pulse continues from its present force."""
        return state
