"""A learned feedforward force over time for one motion, as signal-based iterative learning control gives it."""

from __future__ import annotations

from typing import Any, NamedTuple

from feeddrive.blocks.families import Compensation
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, table


class LearnedForce(Compensation):
    """A table of forces, one a sample, counted from the sample in which the loop was enabled.

        force(k) = row k of the table,   its last row from then on: let it end with 0

    When to use: for one motion that repeats to the sample, as the result of `learn_signal`.  When not: for any other
    motion; the force fits the one it was learned for only, and DisturbanceCompensator is the tool then.
    Source: Arimoto, Kawamura & Miyazaki 1984 (learning control).
    """

    force: Any = table("N", "learned force, sample by sample")

    class State(NamedTuple):
        """The row that acts next."""

        sample: Number

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> State:
        """At the first row."""
        return self.State(ops.zero(reading.applied))

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Setpoint, Number]:
        """The equation above; the setpoint is not changed."""
        return self.State(state.sample + 1.0), setpoint, ops.gather(self.force, state.sample)
